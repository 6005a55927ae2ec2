"""Appearance of the terrain: textured surfaces, sky and sun.

All of it is purely visual: nothing here collides. One mesh per material keeps rendering fast. Helpers compute the part
of a convex polygon that others do not cover.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from stridetwin.sim.world.obstacles import GLASS
from stridetwin.sim.world.solids import Solid, SolidSet, corners
from stridetwin.sim.world.textures import FINISHES, PERIOD_M, SIZE, TEXTURES, Pixels
from stridetwin.streams.samples import Array

_TINY_M = 1e-6  # tolerance for rounding


def subtract_holes(polygon: Array, holes: Iterable[Array]) -> list[Array]:
    """Convex parts, without overlap, of a polygon outside all holes; all are (N, 2), convex and anticlockwise."""
    parts = [polygon]
    for hole in holes:
        low, high = hole.min(axis=0), hole.max(axis=0)
        remaining = []
        for part in parts:
            is_clear = np.any((part.max(axis=0) < low) | (part.min(axis=0) > high))  # their bounding boxes are apart
            remaining += [part] if is_clear else _cut_outside(part, hole)
        parts = remaining
    return parts


def split_into_quads(polygon: Array) -> list[Array]:
    """Cuts a convex polygon (N, 2) into quadrilaterals (4, 2).

    The diagonal from the first to the third corner of each has areas on both sides, as two triangles need it.
    """
    remaining, quads = polygon, []
    # four corners at a time; the next part begins with the first and the last of them
    while len(remaining) > 4:
        quads.append(remaining[:4])
        remaining = np.concatenate([remaining[:1], remaining[3:]])
    if len(remaining) == 3:  # a triangle gets a fourth corner in the middle of a side
        remaining = np.array([remaining[0], remaining[1], (remaining[1] + remaining[2]) / 2, remaining[2]])
    return [*quads, remaining]


def _cut_outside(part: Array, hole: Array) -> list[Array]:
    """Convex parts of the convex polygon `part` outside a convex hole, both anticlockwise.

    What lies beyond each side of the hole is cut off as one part, side after side.
    """
    parts: list[Array] = []
    for a, b in zip(hole, np.roll(hole, -1, axis=0)):
        beyond = _clip_half_plane(part, a, b, -1.0)
        if beyond is not None:
            parts.append(beyond)
        inside = _clip_half_plane(part, a, b, 1.0)
        if inside is None:
            return parts  # nothing remains on the hole's side of this line
        part = inside  # goes on to the next side; what remains at the end is inside the hole
    return parts


def _clip_half_plane(polygon: Array, a: Array, b: Array, side: float) -> Array | None:
    """The part of a convex polygon on one side of a line; None if it is empty.

    Args:
        polygon: (N, 2) corners, anticlockwise.
        a: (2,) first point of the line.
        b: (2,) second point.
        side: 1 for what lies to the left of the line from a to b, -1 for what lies to its right.
    """
    # `away`: distance of each corner from the line, positive on the wanted side
    run = (b - a) / np.linalg.norm(b - a)
    away = side * (run[0] * (polygon[:, 1] - a[1]) - run[1] * (polygon[:, 0] - a[0]))
    if away.max() < _TINY_M:
        return None  # nothing of it is on the wanted side
    if away.min() > -_TINY_M:
        return polygon  # all of it is
    points = []
    for i, j in zip(range(len(polygon)), np.roll(np.arange(len(polygon)), -1)):
        # keep corners on the wanted side, and add the point where an edge crosses the line
        if away[i] > -_TINY_M:
            points.append(polygon[i])
        if (away[i] > _TINY_M and away[j] < -_TINY_M) or (away[i] < -_TINY_M and away[j] > _TINY_M):
            points.append(polygon[i] + away[i] / (away[i] - away[j]) * (polygon[j] - polygon[i]))
    return np.array(points) if len(points) > 2 else None


# materials of tops by terrain, of sides, and of the pale strip along an edge with a drop
_TOP = {"level": "concrete", "stair": "wood", "ramp": "brick"}
_SIDE = "stone"
_NOSING = "nosing"
# colours and opacity of materials without a texture
_COLOURS = {
    _NOSING: (0.93, 0.87, 0.68),
    "white_paint": (0.92, 0.92, 0.90),
    "black_paint": (0.02, 0.02, 0.02),
    GLASS: (0.72, 0.84, 0.82),
}
_ALPHA = {GLASS: 0.18}
_SHADOW, _SHADE = "shadow", 0.25  # of concrete, and the remaining light
_NOSING_M = 0.03  # width of the pale strip
_RISER_M = 0.019  # least height of a drop
_SEED = 20260  # the world looks the same in every walk


@dataclass(frozen=True, eq=False)
class Quad:
    """A textured rectangle.

    Attributes:
        corners: (4, 3) m in the world, anticlockwise as seen from outside.
        uv: (4, 2) m, texture coordinates of the corners.
        material: Name of its material.
    """

    corners: Array
    uv: Array
    material: str


def paint_slabs(solids: Sequence[Solid], surface: SolidSet) -> list[Quad]:
    """Textured faces of walkable solids; treads and landings get a pale strip along edges with a drop."""
    quads: list[Quad] = []
    for i, solid in enumerate(solids):
        # where tops coincide, one face would shine through the other; a loop comes back to its height within rounding
        painted = [
            corners(earlier)[4:]
            for earlier in solids[:i]
            if (abs(earlier.start - solid.start) < _TINY_M and abs(earlier.end - solid.end) < _TINY_M)
            or _is_in_plane(earlier, solid)
        ]
        # width of the pale strip at both ends; 0 without a drop
        low, high = (min(_NOSING_M, solid.length) * _has_drop(solid, end, surface) for end in (-1.0, 1.0))
        quads += _side_quads(solid, _SIDE)
        # parts of the top: (from, to) along the length, m, and material
        for start, end, material in (
            (0.0, low, _NOSING),
            (low, solid.length - high, _TOP[solid.terrain]),
            (solid.length - high, solid.length, _NOSING),
        ):
            if end > start:
                quads += _top_quads(solid, start, end, material, painted)
    return quads


def _is_in_plane(a: Solid, b: Solid) -> bool:
    """Whether the tops of two solids are parts of one plane, such as a plank's and that of the body under it."""

    def gradient(solid: Solid) -> tuple[float, float]:
        """Rise of the top along the world's x and y, m/m."""
        along, cos, sin = (solid.end - solid.start) / solid.length, math.cos(solid.yaw), math.sin(solid.yaw)
        return along * cos - solid.cross * sin, along * sin + solid.cross * cos

    (ax, ay), (bx, by) = gradient(a), gradient(b)
    above = 0.5 * (b.start + b.end - a.start - a.end) - ax * (b.x - a.x) - ay * (b.y - a.y)
    return abs(above) < _TINY_M and abs(ax - bx) < _TINY_M and abs(ay - by) < _TINY_M


def paint_box(box: Solid, material: str) -> list[Quad]:
    """Textured faces of a box of one material."""
    return [*_side_quads(box, material), *_top_quads(box, 0.0, box.length, material)]


def _has_drop(solid: Solid, end: float, surface: SolidSet) -> bool:
    """Whether the ground is a riser lower just beyond one end of a solid: -1 the low-x end, 1 the high-x end."""
    beyond = end * (solid.length / 2 + 0.01)  # m from the centre, just outside
    x, y = solid.x + beyond * math.cos(solid.yaw), solid.y + beyond * math.sin(solid.yaw)
    height, solid_index = surface.top_facet([x, y])  # -1 where the way ends and only the ground plane follows
    return bool(solid_index >= 0 and height < (solid.start if end < 0 else solid.end) - _RISER_M)


def _top_quads(solid: Solid, start: float, end: float, material: str, painted: Sequence[Array] = ()) -> list[Quad]:
    """Textured part of a solid's top between two distances along its length, without areas that are painted already.

    Args:
        solid: The solid.
        start: Distance from its low-x end, m.
        end: Distance from its low-x end, m.
        material: Material of the part.
        painted: Outlines of other tops at the same height.
    """
    cos, sin = math.cos(solid.yaw), math.sin(solid.yaw)
    axes = np.array([[cos, sin], [-sin, cos]])  # rows: own x and y axes in the world
    centre, half = np.array([solid.x, solid.y]), np.array([solid.length, solid.width]) / 2
    slope = np.array([(solid.end - solid.start) / solid.length, solid.cross])  # m/m along both axes
    # (4, 2) m, outline of the part from the centre, own axes
    local = np.array([[start, 0.0], [end, 0.0], [end, solid.width], [start, solid.width]]) - half
    quads = []
    for part in subtract_holes(centre + local @ axes, [outline[:, :2] for outline in painted]):
        for quad in split_into_quads(part):
            local_quad = (quad - centre) @ axes.T
            z = (solid.start + solid.end) / 2 + local_quad @ slope
            # level ground has texture coordinates of the world, so that adjacent slabs show one paving
            paved = solid.is_box and solid.terrain == "level"
            # otherwise they count from the corner of the solid, along its slopes
            uv = quad if paved else (local_quad + half) * np.hypot(1.0, slope)
            quads.append(Quad(np.column_stack([quad, z]), uv, material))
    return quads


def _side_quads(solid: Solid, material: str) -> list[Quad]:
    """Textured side faces of a solid; on each, the texture starts at the x or y of its first corner in the world."""
    c = corners(solid)
    quads = []
    for i, j in ((0, 1), (1, 2), (2, 3), (3, 0)):  # corners 0 to 3 are the underside, 4 to 7 the top above them
        face = np.array([c[i], c[j], c[4 + j], c[4 + i]])
        # from the first corner's x on the first and the third side, from its y on the others
        along = c[i, i % 2] + math.dist(c[i, :2], c[j, :2]) * np.array([0.0, 1.0, 1.0, 0.0])
        quads.append(Quad(face, np.column_stack([along, -face[:, 2]]), material))
    return quads


def add_quads(spec: mujoco.MjSpec, quads: Iterable[Quad], finish: str) -> None:
    """Adds textured rectangles to a model's world, one mesh and one geom per material.

    Args:
        spec: The model.
        quads: The rectangles.
        finish: Finish of the textures, a key of `textures.FINISHES`.
    """
    by_material = defaultdict(list)
    for quad in quads:
        by_material[quad.material].append(quad)
    for material, group in by_material.items():
        vertices = np.array([q.corners for q in group])
        normal = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        # two triangles per rectangle, by the numbers of their corners
        face = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(len(group))[:, None, None]
        name = f"scenery_{material}"
        spec.add_mesh(
            name=name,
            uservert=vertices.ravel(),
            usernormal=np.repeat(normal, 4, axis=0).ravel(),
            usertexcoord=np.array([q.uv for q in group]).ravel() / PERIOD_M,
            userface=face.ravel(),
            userfacenormal=face.ravel(),
            userfacetexcoord=face.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            material=_add_material(spec, material, finish).name,
            contype=0,
            conaffinity=0,
        )


def _add_material(spec: mujoco.MjSpec, name: str, finish: str) -> mujoco.MjsMaterial:
    """Adds a material of the scenery with its colour or texture, in a finish."""
    full = f"scenery_{name}"
    material = spec.add_material(name=full, specular=0.0, shininess=0.0)
    if name in _COLOURS:
        pixel = (np.array([[_COLOURS[name]]]) * 255).astype(np.uint8)  # an image of one pixel
        colour = FINISHES[finish](pixel)[0, 0] / 255.0
        material.rgba = (*colour.tolist(), _ALPHA.get(name, 1.0))
        return material
    texture = spec.add_texture(name=full, type=mujoco.mjtTexture.mjTEXTURE_2D, width=SIZE, height=SIZE, nchannel=3)
    texture.data = FINISHES[finish](_texture("concrete" if name == _SHADOW else name)).tobytes()
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = full
    if name == _SHADOW:  # the texture of concrete, darkened
        material.rgba = (_SHADE, _SHADE, _SHADE, 1.0)
    return material


@cache
def _texture(name: str) -> Pixels:
    """Texture of a material; its seed is fixed, so that the world looks the same in every walk."""
    return TEXTURES[name](np.random.default_rng([_SEED, *name.encode()]))


def add_ground(spec: mujoco.MjSpec, height: float, finish: str) -> None:
    """Adds the surrounding plane, `ground`, which collides."""
    lawn = _add_material(spec, "grass", finish)
    lawn.texuniform, lawn.texrepeat = True, (1 / PERIOD_M, 1 / PERIOD_M)  # a plane has no texture coordinates
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=(0.0, 0.0, height),
        size=(0.0, 0.0, 1.0),
        material=lawn.name,
    )


def add_sky(spec: mujoco.MjSpec, light: float) -> None:
    """Adds a sky gradient, a sun and ambient light; `light` 1 is a bright day."""
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.42, 0.62, 0.86),
        rgb2=(0.90, 0.93, 0.95),
        width=32,
        height=192,
    )
    # the sun casts shadows and makes highlights; the weaker light from the other side does neither
    for name, direction, colour, shadow in (
        ("sun", (0.35, 0.45, -0.82), (0.62, 0.60, 0.55), True),
        ("fill", (-0.6, -0.5, -0.3), (0.16, 0.17, 0.19), False),
    ):
        spec.worldbody.add_light(
            name=name,
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=(0.0, 0.0, 12.0),
            dir=direction,
            diffuse=tuple(light * c for c in colour),
            specular=(0.1 * shadow,) * 3,
            ambient=(0.0, 0.0, 0.0),
            castshadow=shadow,
        )
    # The headlight gives ambient light only: if it came from the camera, the brightness of a surface would depend on
    # the viewpoint.
    spec.visual.headlight.ambient = (0.46 * light, 0.47 * light, 0.50 * light)
    spec.visual.headlight.diffuse = spec.visual.headlight.specular = (0.0, 0.0, 0.0)
