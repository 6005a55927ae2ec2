"""The body map of a placement: the rendered wearer with a dot at each sensor position, coloured by score."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.config import TwinConfig
from stridetwin.sim.rendering.renderer import FilmCamera
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.sim.wearer.body import add_wearer, compile_model
from stridetwin.sim.wearer.limbs import find_shapes
from stridetwin.sim.wearer.sensor_bodies import UPPERS, add_rig
from stridetwin.streams.rig import Mount
from stridetwin.streams.samples import Array
from stridetwin.studies.placement.measure import MeasuredPlaces
from stridetwin.studies.placement.problem_file import Place, PlacementProblem, scenario_at

_SIZE = 620  # pixels, width and height of a panel
_BAR = 150  # pixels, width of the legend
_MARGIN = 1.7  # shown extent over the extent of the dots
_LEAST_M = 0.13  # least extent that a panel shows around its middle
_BEST_PX = 9  # half width of the mark of the best place
_FAINT = 0.1  # opacity of the bodies without dots
_MANY = 150  # more dots than this are drawn smaller
_RAY_M = 0.05  # from a sensor to the dot of a viewing direction
_INK = (46, 28, 15)  # BGR
_MOVED = (
    "position_mm",
    ".mount",
    ".board",
    "camera_mount",
    ".body_imu",
)  # parts of the paths of fields that move a sensor
_SUN = (0.4, 0.3, 1.5)  # m, a light; it shines towards the origin
_VIEWS = ((0.0, -8.0), (65.0, -32.0))
"""Azimuth, relative to the side of the dots, and elevation, deg."""

Rgb = NDArray[np.uint8]


class BodyImage(NamedTuple):
    """A map: the bytes of its PNG file, and a description of the content."""

    png: bytes
    description: str


@dataclass(frozen=True, kw_only=True, eq=False)
class _Dot:
    """A sensor position or viewing direction, and the best mean score of all places with it.

    Attributes:
        body: The body that carries the sensor.
        p_in_body: (3,) m, the position, or a point in the viewing direction from `origin`.
        loss: The score as a loss.
        board: Whether it is a board.
        origin: (3,) m, the sensor's only position; None for a dot at a position.
    """

    body: str
    p_in_body: Array
    loss: float
    board: bool
    origin: Array | None = None


def body_map(problem: PlacementProblem, folder: Path, searched: MeasuredPlaces, best: Place) -> BodyImage | None:
    """The map of all places, with the sensors of the best one; None if no place moves a sensor.

    Args:
        problem: The placement.
        folder: Its output folder, which contains the user's parts.
        searched: All measured places.
        best: The best one.
    """
    dots = _collect_dots(problem, folder, searched)
    if not dots:
        return None
    # with one weighing score the colours show its values: a loss times `sign` is the value
    name, sign = "weighted sum", 1.0
    weighing = [score for score in problem.scores if score.weight]
    if len(weighing) == 1 and weighing[0].weight == 1:
        name = weighing[0].name
        sign = -1.0 if weighing[0].higher_is_better else 1.0
    config = scenario_at(problem, problem.bases[0], best, folder).config
    bodies = sorted({dot.body for dot in dots})
    span = min(d.loss for d in dots), max(d.loss for d in dots)
    # one picture per body and view, side by side; with three or more bodies only the first view
    panels = [
        _draw_panel(config, body, [d for d in dots if d.body == body], view, span)
        for body in bodies
        for view in _VIEWS[: 1 if len(bodies) > 2 else 2]
    ]
    image = np.concatenate([*panels, _draw_color_key(sign * span[0], sign * span[1], name)], axis=1)
    caption = "Sensor positions: circles are cameras and IMUs, squares are boards"
    if any(dot.origin is not None for dot in dots):
        caption += ", dots at the end of a line are viewing directions"
    description = (
        f"{caption}. The colour is the best {name} found with a sensor there; yellow is the best. The body shows the "
        "sensors of the best place."
    )
    return BodyImage(cv2.imencode(".png", image)[1].tobytes(), description)


def _collect_dots(problem: PlacementProblem, folder: Path, searched: MeasuredPlaces) -> list[_Dot]:
    """The dots of all sensors that the placement moves, worst first.

    A sensor with several positions has a dot at each. One with a single position, but several viewing directions, has a
    dot per direction. Any other sensor has none.

    Args:
        problem: The placement.
        folder: Its output folder, which contains the user's parts.
        searched: All measured places.
    """
    # names of the knobs that move a sensor
    moving = [
        knob.name
        for free in problem.free
        for knob in free.knobs
        if any(word in f".{path.text}" for path in free.paths for word in _MOVED)
    ]
    # a choice of places on the body moves one IMU from place to place, which has a topic of its own at each
    changes_place = any(path.keys == ("sensors", "body_imu") for free in problem.free for path in free.paths)
    # by the values of these knobs, as text: name and mount of each sensor, and whether it is a board
    mounts_by_values: dict[str, list[tuple[str, Mount, bool]]] = {}
    # by name of the sensor, its body, and the point in the body's frame, as text: the dot with the lowest loss
    positions: dict[tuple[str, ...], _Dot] = {}
    directions: dict[tuple[str, ...], _Dot] = {}
    for i in np.flatnonzero(np.isfinite(searched.losses)).tolist() if moving else ():
        place, loss = searched.places[i], float(searched.losses[i])
        # places that differ in other values alone have the same mounts, which are then computed once
        key = json.dumps([place.values.get(name) for name in moving])
        if key not in mounts_by_values:
            mounts_by_values[key] = list(
                _list_mounts(scenario_at(problem, problem.bases[0], place, folder).config, changes_place)
            )
        for name, mount, board in mounts_by_values[key]:
            # position, and viewing direction: the sensor's z axis
            p, ahead = mount.T_body_sensor[:3, 3], mount.T_body_sensor[:3, 2]
            position_dot = _Dot(body=mount.body, p_in_body=p, loss=loss, board=board)
            for best, dot in (
                (positions, position_dot),
                (directions, replace(position_dot, p_in_body=p + _RAY_M * ahead, origin=p)),
            ):
                key_of_dot = name, dot.body, json.dumps(np.round(dot.p_in_body, 4).tolist())
                if key_of_dot not in best or loss < best[key_of_dot].loss:
                    best[key_of_dot] = dot
    # by name of the sensor, how many positions and how many viewing directions it has
    moved, turned = (Counter(name for name, *_ in dot_by_key) for dot_by_key in (positions, directions))
    dots = [dot for (name, *_), dot in positions.items() if moved[name] > 1]
    dots += [dot for (name, *_), dot in directions.items() if moved[name] == 1 < turned[name]]
    return sorted(dots, key=lambda dot: -dot.loss)


def _list_mounts(config: TwinConfig, changes_place: bool) -> Iterator[tuple[str, Mount, bool]]:
    """Yields name and mount of each sensor on the left side or in the middle of the body, and whether it is a board.

    The right side mirrors the left one, so its sensors are left out; so are sensors on the exoskeleton.

    Args:
        config: The scenario of a place.
        changes_place: Whether all IMUs on the body count as one sensor.
    """
    rig = sensor_rig(config).rig
    # an IMU inside a depth camera has no mark of its own
    inside = {camera.imu_topic for camera in rig.cameras.values() if camera.depth_topic}
    mounts = {topic: sensor.mount for kind in (rig.imus, rig.cameras, rig.others) for topic, sensor in kind.items()}
    for topic, mount in mounts.items():
        if topic not in inside and not mount.body.endswith("_r") and not mount.body.startswith("exo_"):
            # a camera that is not on the left shoe is on head or chest; the topic would tell on which, and places may
            # differ in that
            is_on_upper_body = topic in rig.cameras and "_l/" not in topic
            is_body_imu = changes_place and topic.startswith("/body/")
            yield "head or chest" if is_on_upper_body else "body IMU" if is_body_imu else topic, mount, False
    for name, board in rig.boards.items():
        if not name.endswith("_r"):
            yield "board", board.mount, True


def _draw_panel(
    config: TwinConfig, body: str, dots: list[_Dot], view_deg: tuple[float, float], span: tuple[float, float]
) -> Rgb:
    """A view of the wearer with the dots on one opaque body; the best and the worst loss of all dots span the colours.

    Args:
        config: The wearer and the sensors of the best place.
        body: The body with the dots.
        dots: Dots on this body, worst first.
        view_deg: Azimuth relative to the side of the dots, and elevation.
        span: Lowest and highest loss of all dots.
    """
    model, data = _pose_standing(config, body)
    posed_body = data.body(body)
    rotation = posed_body.xmat.reshape(3, 3)  # from the body's axes to the world's
    points = np.array([d.p_in_body for d in dots]) @ rotation.T + posed_body.xpos  # (N, 3) m in the world
    # (3,) m, middle of the body's shapes
    shape_positions = [shape.p for shape in find_shapes(model, {model.body(body).id})]
    body_middle = posed_body.xpos + rotation @ np.mean(shape_positions, axis=0)
    slope = math.tan(math.radians(model.vis.global_.fovy / 2))  # tangent of half the angle of view
    view = _aim_camera(points, body_middle, view_deg, slope)
    with FilmCamera(model, _SIZE, _SIZE) as camera:
        image: Rgb = np.ascontiguousarray(camera.frame(data, *view)[..., ::-1])  # blue, green, red, as OpenCV draws
    # (N, 2) pixels of the dots, and of the sensors from which lines lead to dots of viewing directions; a dot at a
    # position is its own sensor
    uv = _pixels(points, *view, _SIZE / 2 / slope)
    eyes = np.array([d.p_in_body if d.origin is None else d.origin for d in dots])
    from_uv = _pixels(eyes @ rotation.T + posed_body.xpos, *view, _SIZE / 2 / slope)
    best, worst = span
    losses = np.array([d.loss for d in dots])
    # share 1, yellow, for the lowest loss
    colours = _viridis((worst - losses) / (worst - best) if worst > best else np.ones(len(dots)))
    usual_px = 6 if len(dots) < _MANY else 4
    for at, start, colour, dot in zip(uv, from_uv, colours, dots):
        cv2.line(image, np.rint(start).astype(int), np.rint(at).astype(int), colour, 1, cv2.LINE_AA)
        _draw_mark(image, at, _BEST_PX if dot is dots[-1] else usual_px, colour, dot.board)  # the last dot is the best
    return image


def _aim_camera(
    points: Array, body_middle: Array, view_deg: tuple[float, float], slope: float
) -> tuple[Array, float, float, float]:
    """Aims a camera at dots with the body behind them, from so far that all dots are in the picture.

    Args:
        points: (N, 3) m, the dots in the world.
        body_middle: (3,) m, middle of the body.
        view_deg: Azimuth relative to the side of the dots, and elevation.
        slope: Tangent of half the angle of view.

    Returns:
        (3,) m, the point that the camera looks at; azimuth and elevation of its viewing direction, deg; and its
        distance from that point, m.
    """
    middle = (points.max(axis=0) + points.min(axis=0)) / 2  # of the dots
    # (2,) the horizontal direction from the body to the dots: the camera looks against it
    out = (points - body_middle).mean(axis=0)[:2]
    azimuth, elevation = math.degrees(math.atan2(-out[1], -out[0])) + view_deg[0], view_deg[1]
    # between the dots and the body, at the dots' height
    lookat = (middle + np.array([*body_middle[:2], middle[2]])) / 2
    # half of what the picture shows, m: the farthest dot with a margin, but at least `_LEAST_M`
    reach = max(float(np.linalg.norm(points - lookat, axis=1).max()), _LEAST_M / _MARGIN) * _MARGIN
    return lookat, azimuth, elevation, reach / slope


def _pose_standing(config: TwinConfig, body: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The wearer with straight legs and sensors; all but one body and its parts are translucent."""
    spec = mujoco.MjSpec()
    spec.add_texture(  # a white background
        name="paper",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=[1, 1, 1],
        rgb2=[1, 1, 1],
        width=8,
        height=8,
    )
    spec.worldbody.add_light(pos=_SUN, dir=[-x for x in _SUN], diffuse=[0.5] * 3, castshadow=False)
    add_wearer(spec, config.person, config.exo)
    add_rig(spec, sensor_rig(config).rig)
    model = compile_model(spec)
    model.vis.headlight.ambient[:] = 0.35
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    # the body, its shoe's upper, and its toes; the parts worn on them are opaque, too
    shown = {model.body(name).id for name in (body, UPPERS.get(body, body), body.replace("foot", "toe"))}
    for geom in range(model.ngeom):
        carrier = model.geom_bodyid[geom]
        # a part that is worn is fixed to its parent: it has no joint
        is_worn = model.body_parentid[carrier] in shown and not model.body_jntnum[carrier]
        if carrier in shown or is_worn:
            continue
        material, name = model.geom_matid[geom], model.body(carrier).name
        colour = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        # sensors on other bodies vanish, and an exoskeleton is fainter than the wearer
        opacity_without_sensors = _FAINT / 3 if name.startswith("exo_") else _FAINT
        opacity = 0.0 if name.startswith("rig_") else opacity_without_sensors
        model.geom_matid[geom] = -1  # without material the colour below counts
        model.geom_rgba[geom] = [*colour[:3], opacity]
    return model, data


def _pixels(points: Array, lookat: Array, azimuth: float, elevation: float, distance: float, focal: float) -> Array:
    """(N, 2) pixels of points in MuJoCo's free camera, with u to the right and v down.

    Args:
        points: (N, 3) m in the world.
        lookat: (3,) m, the point that the camera looks at.
        azimuth: Of the viewing direction, deg.
        elevation: Of the viewing direction, deg.
        distance: From the camera to `lookat`, m.
        focal: Focal length, pixels.
    """
    a, e = math.radians(azimuth), math.radians(elevation)
    # the camera's axes in the world
    ahead = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([math.sin(a), -math.cos(a), 0.0])
    up = np.cross(right, ahead)
    away = points - (lookat - distance * ahead)  # (N, 3) m from the camera to the points
    return np.asarray(_SIZE / 2 + focal * np.column_stack([away @ right, -(away @ up)]) / (away @ ahead)[:, None])


def _viridis(share: Array) -> list[list[int]]:
    """Colours of (N,) values from 0, dark, to 1, yellow: N lists of blue, green and red, 0-255."""
    levels = np.round(255 * share).astype(np.uint8)
    colours: list[list[int]] = cv2.applyColorMap(levels[:, None], cv2.COLORMAP_VIRIDIS)[:, 0].tolist()
    return colours


def _draw_mark(image: Rgb, at: Array, size: int, colour: Sequence[int], board: bool) -> None:
    """Draws the mark of a place at a pixel: a square for a board, else a disc.

    Args:
        image: Changed in place.
        at: (2,) pixel.
        size: Half its width, pixels; the mark of the best place, `_BEST_PX`, has a thicker outline.
        colour: Its colour.
        board: Whether the place is that of a board.
    """
    line = 2 if size == _BEST_PX else 1
    # OpenCV's fixed-point coordinates with 4 binary digits, so that marks lie between pixels
    u, v = np.rint(16 * at).astype(int).tolist()
    if board:
        shape = np.round(16 * (at + size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))).astype(np.int32)
        cv2.fillConvexPoly(image, shape, colour, cv2.LINE_AA, 4)
        cv2.polylines(image, [shape], True, _INK, line, cv2.LINE_AA, 4)
    else:
        # a filled disc (thickness -1), then its outline
        for paint, thickness in ((colour, -1), (_INK, line)):
            cv2.circle(image, (u, v), 16 * size, paint, thickness, cv2.LINE_AA, 4)


def _draw_color_key(best: float, worst: float, name: str) -> Rgb:
    """(H, W, 3) the colour bar with its values, best on top, and the score's name.

    Args:
        best: Value at the top.
        worst: Value at the bottom.
        name: The score's name, shown on two lines of 18 characters.
    """
    image = np.full((_SIZE, _BAR, 3), 255, np.uint8)
    top, bottom, left = 70, _SIZE - 40, 18  # pixels, of the bar
    image[top:bottom, left : left + 24] = np.array(_viridis(np.linspace(1.0, 0.0, bottom - top)))[:, None]
    # text, its corner at the lower left, pixels, and scale of the font
    texts = [(name[:18], (6, 30), 0.42), (name[18:36], (6, 48), 0.42)]
    for y, value in zip(np.linspace(top, bottom, 5), np.linspace(best, worst, 5)):
        # + 0.0 turns -0 into 0
        texts.append((f"{value + 0.0:.3g}", (left + 32, int(y) + 5), 0.5))
    for text, corner, scale in texts:
        cv2.putText(image, text, corner, cv2.FONT_HERSHEY_SIMPLEX, scale, _INK, 1, cv2.LINE_AA)
    return image
