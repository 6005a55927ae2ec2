"""A mesh as terrain: its levels, ramps and risers along a straight way are replaced by exact boxes and wedges.

The mesh is cut along five parallel lines. On the middle one, height steps are risers, and straight lines between them
are levels or ramps (Douglas-Peucker); equal treads in a row become stairs. The layout of these segments is compared
with the mesh over the whole width of the way; a mesh that differs too much is rejected. Errors give the mesh's size
and, if there is one, another unit, axis, start or direction that gives a way.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Annotated, Any

import numpy as np
from pydantic import Discriminator, Field, Tag

from stridetwin.sim.config import Level, Ramp, Route, Stairs
from stridetwin.sim.world.mesh_files import GLTF_SUFFIXES, read_triangles
from stridetwin.sim.world.route_checks import MAX_RAMP_RAD, MIN_TREAD_M, RISER_RANGE_M
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.fields import DEGREES, InputFile, Number, OneOf, ReadAs
from stridetwin.streams.samples import Array

_FARTHEST_M = 1000.0  # largest coordinate


# How a profile is divided into levels, ramps and stairs; chosen by hand for meshes with errors of millimetres.
_MAX_ERROR_M = 0.010  # of the mesh from its replacement, anywhere on the way but beside risers
_BESIDE_RISER_M = 0.025  # on both sides of a riser, where the error is not checked
_SAMPLE_M = 0.005  # spacing of the samples along the way
_MIN_JUMP_M = 0.015  # between neighbouring samples: steeper than any ramp
_MAX_STRAIGHT_ERROR_M = 0.003  # largest distance of a sample from a level or ramp
_MAX_LEVEL_RISE_M = 0.004  # largest rise of a level
_HEADROOM_M = (0.02, 1.9)  # a surface between these above the ground leaves no room to walk
_MIN_NORMAL_UP = 0.5  # least upward part of a walkable triangle's normal
_REACH_M = 0.45  # surfaces higher than this above the last sample are not ground
_MAX_TREAD_DIFFERENCE_M = 0.01  # largest difference of equal treads
_MAX_TREAD_M = 0.6  # deeper ones are levels
_MIN_HALF_WAY_M = 0.5  # half of the shortest way
_ROWS: tuple[float, ...] = (-0.9, -0.45, 0.0, 0.45, 0.9)  # lines along the way, in half widths from its middle
MeshSegment = Level | Ramp | Stairs
UP_AXES = ("z", "y", "x", "-z", "-y", "-x")
"""Axes of a mesh that may point up."""
_COMMON_UP = UP_AXES[:2]
"""Those of CAD programs and of films and games."""
_FARTHEST_START_M = 1000.0
_Start = Annotated[Number, Field(ge=-1000, le=1000)]
_UNITS = {"m": 1.0, "mm": 1e-3, "cm": 0.01, "in": 0.0254, "inch": 0.0254, "ft": 0.3048}
"""Metres per unit of a mesh, by the unit's name in a file."""
_Unit = Annotated[
    Annotated[Any, OneOf(_UNITS), Tag("=name")] | Annotated[Number, Field(gt=0, le=1000), Tag("=metres")],
    Discriminator(lambda node: "=name" if isinstance(node, str) else "=metres"),
]


@dataclass(frozen=True, kw_only=True)
class MeshWay:
    """The way on a mesh.

    In scenario files, `heading_rad` is `heading_deg`, whose limits are in degrees.

    Attributes:
        path: The mesh.
        scale: Metres per unit of the mesh: m, cm, mm, in, inch, ft, or a number.
        up: The axis that points up: `z`, `y`, `x`, `-z`, `-y` or `-x`; by default `y` for glTF, whose format says so,
            else `z`.
        start_m: Start of the way, in the plane across that axis.
        heading_rad: Its direction there.
        length_m: Length of the way; None for the rest of the mesh.
    """

    path: Annotated[InputFile, Field(alias="file")]
    scale: Annotated[float, ReadAs(_Unit), Field(alias="unit")] = 1.0
    up: Annotated[str | None, OneOf(UP_AXES)] = None
    start_m: tuple[_Start, _Start] = (0.0, 0.0)
    heading_rad: Annotated[Number, Field(ge=-360, le=360, alias="heading_deg"), DEGREES] = 0.0
    length_m: Annotated[Number | None, Field(ge=1, le=500)] = None

    @property
    def vertical_axis(self) -> str:
        """The axis of the mesh that points up, one of `UP_AXES`."""
        return self.up or ("y" if self.path.suffix.lower() in GLTF_SUFFIXES else "z")


def mesh_terrain(way: MeshWay, width_m: float) -> tuple[tuple[MeshSegment, ...], str]:
    """Segments that replace a mesh along a way of a width, and a summary of the replacement and its error in words.

    Args:
        way: The mesh, and where the way is on it.
        width_m: Width of the way.

    Raises:
        ConfigError: The mesh cannot be read, walked, or replaced closely enough; the message says where and why.
        StrideTwinError: The file cannot be read.
    """
    triangles = read_triangles(way.path)
    try:
        segments, summary = _replace_mesh(triangles, way, width_m)
        return segments, summary + _say_if_upside_down(triangles, way, width_m, segments)
    except ConfigError as error:
        advice = _describe_place(triangles, way, width_m)
        raise ConfigError(error.source, error.field, error.value, f"{error.valid}; {advice}") from error


def _replace_mesh(triangles: Array, way: MeshWay, width_m: float) -> tuple[tuple[MeshSegment, ...], str]:
    """Segments that replace a mesh along a way of a width, and a summary of the replacement and its error in words.

    Args:
        triangles: (T, 3, 3) corners, in the unit and axes of the file.
        way: Where the way is on the mesh.
        width_m: Width of the way.

    Raises:
        ConfigError: The mesh cannot be walked, or replaced closely enough; the message says where and why.
    """
    corners = _to_way_frame(way.scale * triangles, way)
    if not np.all(np.abs(corners) < _FARTHEST_M):
        raise ConfigError(
            way.path, "coordinates", "far away", f"numbers within {_FARTHEST_M:g} m; move the mesh to its origin"
        )
    length = way.length_m or float(corners[:, :, 0].max()) - _SAMPLE_M
    if not 2 * _MIN_HALF_WAY_M < length < 500.0:
        raise ConfigError(way.path, "length of the way", round(length, 3), f"{2 * _MIN_HALF_WAY_M:g}-500 m")
    s = np.arange(0.0, length, _SAMPLE_M)
    facing = _find_facing(_cut_surfaces(corners, s, 0.0))
    heights = np.column_stack([_cut_profile(corners, s, 0.5 * width_m * share, facing, way) for share in _ROWS])
    # (N, 5) m, relative to the start of the middle line
    heights -= heights[0, len(_ROWS) // 2]
    segments = _divide_into_segments(s, heights[:, len(_ROWS) // 2], way)
    errors = _replacement_error(segments, s, heights, width_m, way)
    kinds = [type(part).__name__.lower() for part in segments]
    counts = ", ".join(f"{kinds.count(k)} {k}" for k in ("level", "ramp", "stairs") if k in kinds)
    summary = (
        f"{way.path}: replaced by exact boxes and wedges ({counts}) over {length:.2f} m; the mesh lies up to "
        f"{1e3 * errors.max():.1f} mm off, {1e3 * math.sqrt(np.mean(errors**2)):.1f} mm RMS (up to "
        f"{1e3 * _MAX_ERROR_M:g} mm is accepted; {1e3 * _BESIDE_RISER_M:g} mm beside risers are excluded)"
    )
    return segments, summary


def _say_if_upside_down(triangles: Array, way: MeshWay, width_m: float, segments: Sequence[MeshSegment]) -> str:
    """A part of the summary for a mesh without stairs that has some on its underside; "" for any other mesh."""
    if any(isinstance(segment, Stairs) for segment in segments) or len(triangles) > _MOST_TRIED_TRIANGLES:
        return ""
    axis = way.vertical_axis
    opposite = replace(way, up=axis.removeprefix("-") if axis.startswith("-") else f"-{axis}")
    try:
        other, _ = _replace_mesh(triangles, opposite, width_m)
    except ConfigError:
        return ""
    has_stairs = any(isinstance(segment, Stairs) for segment in other)
    return f"; there are stairs on its underside: `up: {opposite.up}` if it is upside down" if has_stairs else ""


# Which other ways are tried on a mesh without a way, for the message.
_MOST_TRIED_TRIANGLES = 20_000
_LONGEST_TRIED_M = 60.0
_TRIED_UNITS = ("m", "cm", "mm", "in", "ft")
_INSET_M = 0.01  # of a start from the edge of the mesh


def _describe_place(triangles: Array, way: MeshWay, width_m: float) -> str:
    """The size and place of a mesh, the keys that say how it lies, and values of them that give a way.

    Args:
        triangles: (T, 3, 3) corners, in the unit and axes of the file.
        way: The way that the mesh lacks.
        width_m: Width of the way.
    """
    low, high = way.scale * triangles.min((0, 1)), way.scale * triangles.max((0, 1))
    size = " x ".join(f"{v:.4g}" for v in high - low)
    place = ", ".join(f"{a:.4g} to {b:.4g}" for a, b in zip(low, high))
    keys = "`up: y` or another axis, `unit` (m, cm, mm, in, ...), `start_m` and `heading_deg` say how it lies"
    other_way = _choose_way(_find_ways(triangles, way, width_m))
    advice = (
        f"there is a way with {other_way}" if other_way else f"there is no way of `width_m: {width_m:g}` with others"
    )
    reading = f"with up: {way.vertical_axis} and a unit of {way.scale:g} m"
    return f"the mesh is {size} m along its x, y, z ({place}), {reading}; {keys}: {advice}"


def _choose_way(ways: Iterable[tuple[str, bool]]) -> str:
    """The first of some ways that has stairs, else the first of all; "" without any."""
    first = ""
    for text, has_stairs in ways:
        if has_stairs:
            return text
        first = first or text
    return first


def _find_ways(triangles: Array, way: MeshWay, width_m: float) -> Iterator[tuple[str, bool]]:
    """Yields the keys and values of a scenario that give a way where the user's do not, those nearest to them first.

    Beside each is whether the way has stairs, as levels alone may be a side or the underside of a mesh.

    Args:
        triangles: (T, 3, 3) corners, in the unit and axes of the file.
        way: The way that the mesh lacks.
        width_m: Width of the way.
    """
    if len(triangles) > _MOST_TRIED_TRIANGLES:
        return
    ups = sorted(UP_AXES, key=lambda up: up != way.vertical_axis)
    units = sorted(_TRIED_UNITS, key=lambda unit: _UNITS[unit] != way.scale)
    lying = [replace(way, up=up, scale=_UNITS[unit]) for unit, up in product(units, ups)]
    started = [start for lie in lying for start in _start_at_edges(triangles, lie)]
    for other_way in (*lying, *started):
        corners = _to_way_frame(other_way.scale * triangles, other_way)
        if not 1.0 <= np.ptp(corners[:, :, 0]) <= _LONGEST_TRIED_M or np.ptp(corners[:, :, 1]) < width_m:
            continue
        try:
            segments, _ = _replace_mesh(triangles, other_way, width_m)
        except ConfigError:
            continue
        has_stairs = any(isinstance(segment, Stairs) for segment in segments)
        if has_stairs or other_way.vertical_axis in _COMMON_UP:  # a side or the underside of most meshes is level
            yield _describe_keys(other_way, way), has_stairs


def _start_at_edges(triangles: Array, way: MeshWay) -> Iterator[MeshWay]:
    """Yields ways across the whole mesh: from the middle of each of its four edges to the opposite one."""
    flat = replace(way, start_m=(0.0, 0.0), heading_rad=0.0)
    corners = _to_way_frame(way.scale * triangles, flat)[:, :, :2]
    low, high = corners.min((0, 1)), corners.max((0, 1))
    middle = 0.5 * (low + high)
    for axis, sign in product((0, 1), (1, -1)):
        start = middle.copy()
        start[axis] = low[axis] + _INSET_M if sign > 0 else high[axis] - _INSET_M
        place = (round(float(start[0]), 3), round(float(start[1]), 3))
        if max(map(abs, place)) > _FARTHEST_START_M:
            continue
        heading = math.atan2(*(sign * (axis == k) for k in (1, 0)))
        yield replace(way, start_m=place, heading_rad=heading, length_m=None)


def _describe_keys(way: MeshWay, given: MeshWay) -> str:
    """The keys and values of a scenario in which a way differs from the given one."""
    unit = next(name for name, scale in _UNITS.items() if scale == way.scale)
    texts = {
        f"`up: {way.vertical_axis}`": way.vertical_axis != given.vertical_axis,
        f"`unit: {unit}`": way.scale != given.scale,
        f"`start_m: [{way.start_m[0]:g}, {way.start_m[1]:g}]`": way.start_m != given.start_m,
        f"`heading_deg: {math.degrees(way.heading_rad):g}`": way.heading_rad != given.heading_rad,
    }
    return ", ".join(text for text, differs in texts.items() if differs)


def _to_way_frame(corners: Array, way: MeshWay) -> Array:
    """(T, 3, 3) m, triangles in a frame with its origin at the start of the way, x along it, y to its left and z up."""
    x, y, z = np.moveaxis(corners, -1, 0)
    axis = way.vertical_axis
    if axis.endswith("y"):  # rotated about x by a right angle
        y, z = (-z, y) if axis == "y" else (z, -y)
    elif axis.endswith("x"):
        x, y, z = (y, z, x) if axis == "x" else (y, -z, -x)
    elif axis == "-z":
        y, z = -y, -z
    cos, sin = math.cos(way.heading_rad), math.sin(way.heading_rad)
    dx, dy = x - way.start_m[0], y - way.start_m[1]  # from the start of the way
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, z], -1)


_Surfaces = list[list[tuple[float, bool]]]
"""Height, m, and whether it faces up, of each surface above or below each of some points."""


def _cut_surfaces(corners: Array, s: Array, left: float) -> _Surfaces:
    """All surfaces of a mesh that are about level, above and below the points of a line parallel to the way.

    Args:
        corners: (T, 3, 3) m, triangles in the frame of the way.
        s: (N,) m along the way.
        left: Distance of the line to the left of the way, m.
    """
    # triangles that have an area, are level, nearly, and that the line crosses
    edges = corners[:, 1:] - corners[:, :1]
    normal = np.cross(edges[:, 0], edges[:, 1])  # not of unit length; `size` is its length
    size = np.linalg.norm(normal, axis=1)
    flat = (size > 1e-12) & (np.abs(normal[:, 2]) > _MIN_NORMAL_UP * size)
    near = flat & (corners[:, :, 1].min(1) <= left) & (corners[:, :, 1].max(1) >= left)
    surfaces: _Surfaces = [[] for _ in s]
    for (a, b, c), n in zip(corners[near], normal[near]):  # corners and normal of a triangle
        # samples between its ends
        first, last = np.searchsorted(s, [min(a[0], b[0], c[0]), max(a[0], b[0], c[0]) + 1e-9])
        x = s[first:last]
        # a point is in the triangle, seen from above, if it is on the same side of all three edges
        sides = np.array(
            [(q[0] - o[0]) * (left - o[1]) - (q[1] - o[1]) * (x - o[0]) for o, q in ((a, b), (b, c), (c, a))]
        )
        inside = np.flatnonzero((sides.min(0) >= -1e-9) | (sides.max(0) <= 1e-9))
        # height of the triangle's plane at each sample
        z = a[2] - (n[0] * (x[inside] - a[0]) + n[1] * (left - a[1])) / n[2]
        faces_up = bool(n[2] > 0)
        for i, height in zip((first + inside).tolist(), z.tolist()):
            surfaces[i].append((height, faces_up))
    return surfaces


def _find_facing(surfaces: _Surfaces) -> bool:
    """Whether surfaces that face up are the ground, as on any sound mesh; False for a mesh that is inside out.

    It is inside out if at most points nothing faces up, or only what has a surface above it that faces down and leaves
    no room to walk, as the undersides of its treads then do.
    """
    inside_out = [_is_covered(at_point) for at_point in surfaces if at_point]
    return not inside_out or sum(inside_out) <= 0.5 * len(inside_out)


def _is_covered(surfaces: Sequence[tuple[float, bool]]) -> bool:
    """Whether no surface of a point faces up, or the highest one that does has no room above it."""
    highest = max((z for z, faces_up in surfaces if faces_up), default=None)
    if highest is None:
        return True
    low, high = _HEADROOM_M
    return any(low < z - highest < high for z, faces_up in surfaces if not faces_up)


def _cut_profile(corners: Array, s: Array, left: float, facing: bool, way: MeshWay) -> Array:
    """(N,) m, height of the ground on the mesh along a line parallel to the way.

    The first height is the surface nearest to 0. Then it is the highest surface that one step reaches from the last
    height.

    Args:
        corners: (T, 3, 3) m, triangles in the frame of the way.
        s: (N,) m along the way.
        left: Distance of the line to the left of the way, m.
        facing: Whether the ground faces up, see `_find_facing`.
        way: The way, for messages.

    Raises:
        ConfigError: A hole in the mesh, or no ground in reach.
    """
    surfaces = _cut_surfaces(corners, s, left)
    heights = np.empty(len(s))
    last_z = min((z for z, faces_up in surfaces[0] if faces_up == facing), default=0.0, key=abs)
    for i, at_point in enumerate(surfaces):
        reachable = [z for z, faces_up in at_point if faces_up == facing and abs(z - last_z) <= _REACH_M]
        if not reachable:
            where = f"{s[i]:.2f} m along, {left:+.2f} m to the left"
            valid = f"ground all along the way, without steps of more than {_REACH_M:g} m"
            if any(abs(z - last_z) <= _REACH_M for z, _ in at_point):
                valid += "; a surface there faces down: are some normals inverted (trimesh.repair.fix_normals)?"
            has_ground = any(faces_up == facing for _, faces_up in at_point)
            raise ConfigError(way.path, where, "no ground that can be stepped onto" if has_ground else "a hole", valid)
        heights[i] = last_z = max(reachable)
    return heights


def _divide_into_segments(s: Array, z: Array, way: MeshWay) -> tuple[MeshSegment, ...]:
    """Levels, ramps and stairs of a height profile (N,) that begins at 0.

    Steps between neighbouring samples are risers. Short levels between risers of one direction are treads.

    Args:
        s: (N,) m along the way.
        z: (N,) m, heights.
        way: The way, for messages.

    Raises:
        ConfigError: A riser, tread or slope that cannot be walked, or a way that does not begin and end on a level.
    """
    parts: list[MeshSegment] = []
    jumps = np.flatnonzero(np.abs(np.diff(z)) > _MIN_JUMP_M)
    starts, ends = [0, *(jumps + 1).tolist()], [*jumps.tolist(), len(s) - 1]  # samples of each part between risers
    # risers and treads of the present flight, m
    risers: list[float] = []
    treads: list[float] = []
    for i, (a, b) in enumerate(zip(starts, ends)):
        if i:  # a riser leads to every part but the first
            rise, at = float(z[a] - z[a - 1]), f"riser at {s[a]:.2f} m"
            if not RISER_RANGE_M[0] <= abs(rise) <= RISER_RANGE_M[1]:
                valid = f"{1e3 * RISER_RANGE_M[0]:g}-{1e3 * RISER_RANGE_M[1]:g} mm"
                raise ConfigError(way.path, at, f"{1e3 * rise:.0f} mm", valid)
            if risers and risers[-1] * rise < 0:
                raise ConfigError(way.path, at, f"{1e3 * rise:.0f} mm", "one direction per flight")
            risers.append(rise)
        run = _segment_length(s, ends[i - 1] if i else None, a, b, ends[i] < len(s) - 1)  # m, from riser to riser
        flat = abs(z[b] - z[a]) < _MAX_LEVEL_RISE_M and np.ptp(z[a : b + 1]) < 2 * _MAX_LEVEL_RISE_M
        tread = flat and run <= _MAX_TREAD_M
        # between two risers of one direction, a short level is a tread of the present flight
        if i and i < len(starts) - 1 and tread and (z[starts[i + 1]] - z[b]) * risers[-1] > 0:
            if run < MIN_TREAD_M:
                valid = f"at least {1e3 * MIN_TREAD_M:g} mm"
                raise ConfigError(way.path, f"tread at {s[a]:.2f} m", f"{1e3 * run:.0f} mm", valid)
            treads.append(run)
            continue
        parts += _build_flight(risers, treads)  # the flight, if there is one, ends here
        risers, treads = [], []
        parts += _fit_lines(s, z, a, b, run, way)
    if not isinstance(parts[0], Level) or not isinstance(parts[-1], Level):
        raise ConfigError(way.path, "start and end", "no level", "a level to start from, and one to stop on")
    return tuple(parts)


def _segment_length(s: Array, before: int | None, a: int, b: int, riser_after: bool) -> float:
    """Length of a segment, m, from the middle of the step before it to the middle of the one after it.

    Args:
        s: (N,) m along the way.
        before: Last sample of the segment before; None at the start.
        a: First sample of the segment.
        b: Last sample of the segment.
        riser_after: Whether a riser follows; otherwise the way ends.
    """
    start = s[a] if before is None else 0.5 * (s[before] + s[a])
    return float((0.5 * (s[b] + s[b + 1]) if riser_after else s[b]) - start)


def _build_flight(risers: list[float], treads: list[float]) -> list[MeshSegment]:
    """Segments for risers and the treads between them: one stair if all treads are equal, otherwise one per riser.

    Args:
        risers: Heights, m, negative downwards.
        treads: Depths of the treads between them, m.
    """
    if not risers:
        return []
    down, heights = risers[0] < 0, tuple(abs(r) for r in risers)
    if not treads or max(treads) - min(treads) < _MAX_TREAD_DIFFERENCE_M:
        tread = float(np.mean(treads)) if treads else Stairs.tread_m
        return [Stairs(risers=len(risers), riser_m=heights, tread_m=tread, down=down)]
    parts: list[MeshSegment] = []
    for i, height in enumerate(heights):
        if i > 0:
            parts.append(Level(length_m=treads[i - 1]))
        parts.append(Stairs(risers=1, riser_m=(height,), down=down))
    return parts


def _fit_lines(s: Array, z: Array, a: int, b: int, run: float, way: MeshWay) -> list[MeshSegment]:
    """Levels and ramps between two risers.

    Args:
        s: (N,) m along the way.
        z: (N,) m, heights.
        a: First sample.
        b: Last sample.
        run: Length from riser to riser, m.
        way: The way, for messages.

    Raises:
        ConfigError: A slope that is too steep.
    """
    knots = _fit_polyline(s, z, a, b)
    parts: list[MeshSegment] = []
    for k, (i, j) in enumerate(pairwise(knots)):  # samples at the ends of a straight line
        length, rise = float(s[j] - s[i]), float(z[j] - z[i])
        # the half steps to the risers at both ends: one for the first and the last line, both for a single line
        if k in (0, len(knots) - 2):
            length += (run - float(s[b] - s[a])) / (2 if len(knots) > 2 else 1)
        if abs(rise) < _MAX_LEVEL_RISE_M:
            parts.append(Level(length_m=length))
            continue
        angle = math.atan2(abs(rise), length)
        if angle > MAX_RAMP_RAD:
            raise ConfigError(
                way.path,
                f"slope at {s[i]:.2f} m",
                f"{math.degrees(angle):.1f} deg",
                f"up to {math.degrees(MAX_RAMP_RAD):g} deg",
            )
        parts.append(Ramp(angle_rad=angle, rise_m=abs(rise), down=rise < 0))
    return parts


def _fit_polyline(s: Array, z: Array, a: int, b: int) -> list[int]:
    """Vertices of a piecewise linear fit to a part of the profile (Douglas & Peucker 1973).

    Args:
        s: (N,) m along the way.
        z: (N,) m, heights.
        a: First sample of the part.
        b: Last sample of the part.

    Returns:
        Numbers of the samples, from a to b, between which straight lines fit within `_MAX_STRAIGHT_ERROR_M`.
    """
    done, todo = [a], [b]  # vertices found so far, and ends of the parts to the right of them, the nearest one last
    while todo:
        i, j = done[-1], todo[-1]
        # m, distance of each sample between i and j from the straight line from i to j
        off = np.abs(z[i : j + 1] - (z[i] + (z[j] - z[i]) * (s[i : j + 1] - s[i]) / max(s[j] - s[i], 1e-9)))
        worst = int(np.argmax(off))
        # a part that is not straight is divided at its worst sample; a straight one is done
        if off[worst] > _MAX_STRAIGHT_ERROR_M and j - i > 1:
            todo.append(i + worst)
        else:
            done.append(todo.pop())
    return done


def _replacement_error(
    segments: tuple[MeshSegment, ...], s: Array, heights: Array, width_m: float, way: MeshWay
) -> Array:
    """(K,) m, vertical distance of the mesh from its replacement at all samples except those beside risers.

    Args:
        segments: The replacement.
        s: (N,) m along the way.
        heights: (N, 5) m, ground on the mesh along the lines of `_ROWS`.
        width_m: Width of the way.
        way: The way, for messages.

    Raises:
        ConfigError: The replacement cannot be built, or it differs by more than `_MAX_ERROR_M`.
    """
    from stridetwin.sim.world.terrain import Terrain  # imports the simulator, which is not needed without a mesh

    try:
        terrain = Terrain.from_route(Route(segments=segments, width_m=width_m))
    except ConfigError as error:
        raise ConfigError(way.path, f"the resulting {error.field}", error.value, error.valid) from error
    left = 0.5 * width_m * np.array(_ROWS)
    points = np.stack(np.broadcast_arrays(s[:, None], left), -1)
    edges = [a.s1 for a, b in pairwise(terrain.profile) if abs(a.z1 - b.z0) > 1e-6]
    edges += [float(s[i]) for i in np.flatnonzero(np.abs(np.diff(heights, axis=0)).max(1) > _MIN_JUMP_M)]
    # (N,) whether a sample is away from all risers, of the replacement and of the mesh
    away = np.all(np.abs(s[:, None] - edges) > _BESIDE_RISER_M, axis=1)
    errors = np.abs(terrain.height(points) - heights)[away]
    if errors.max() > _MAX_ERROR_M:
        row, column = np.unravel_index(int(np.argmax(errors)), errors.shape)
        where = f"{s[away][row]:.2f} m along, {left[column]:+.2f} m to the left"
        valid = f"up to {1e3 * _MAX_ERROR_M:g} mm from levels, ramps and stairs across the way"
        raise ConfigError(way.path, where, f"{1e3 * errors[row, column]:.0f} mm off", valid)
    return np.asarray(errors).ravel()
