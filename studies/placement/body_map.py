"""The body map of a placement: the rendered wearer with a dot at each sensor position, coloured by score."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.config import TwinConfig
from stridetwin.sim.rendering.renderer import FilmCamera
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.sim.wearer.body import add_wearer, compile_model
from stridetwin.sim.wearer.limbs import shapes
from stridetwin.sim.wearer.sensor_bodies import UPPERS, add_rig
from stridetwin.streams.rig import Mount
from stridetwin.streams.samples import Array
from stridetwin.studies.placement.free import Free
from stridetwin.studies.placement.measure import Measured
from stridetwin.studies.placement.problem_file import Place, Problem, scenario_at

_SIZE = 620
_BAR = 110  # pixels for the legend
_MARGIN = 1.7  # shown extent over the extent of the dots
_LEAST_M = 0.13
_BEST_PX = 9
_FAINT = 0.1
_MANY = 150  # more dots than this are drawn smaller
_RAY_M = 0.05  # from a sensor to the dot of a viewing direction
_INK = (46, 28, 15)  # BGR
_MOVED = ("position_mm", ".mount", ".board", "camera_mount")
_SUN = (0.4, 0.3, 1.5)

Rgb = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyImage:
    """A map.

    Attributes:
        png: The file's bytes.
        words: Description of the content.
    """

    png: bytes
    words: str


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


def body_map(problem: Problem, folder: Path, searched: Measured, losses: Array, best: Place) -> BodyImage | None:
    """The map, with the losses (P,) of all places and the sensors of the best one; None if no place moves a sensor."""
    dots = _dots(problem, folder, searched, losses)
    if not dots:
        return None
    weighing = [i for i, s in enumerate(problem.scores) if s.weight]
    alone = problem.scores[weighing[0]] if len(weighing) == 1 and problem.scores[weighing[0]].weight == 1 else None
    sign = -1.0 if alone is not None and alone.higher_is_better else 1.0
    name = alone.name if alone is not None else "weighted sum"
    config = scenario_at(problem, problem.bases[0], best, folder).config
    bodies = sorted({dot.body for dot in dots})
    span = min(d.loss for d in dots), max(d.loss for d in dots)
    panels = [_panel(config, body, [d for d in dots if d.body == body], turn, span)
              for body in bodies for turn in ((0.0, -8.0), (65.0, -32.0))[: 1 if len(bodies) > 2 else 2]]  # fmt: skip
    image = np.concatenate([*panels, _key(sign * span[0], sign * span[1], name)], axis=1)
    _, data = cv2.imencode(".png", image)
    where = "Sensor positions: circles are cameras and IMUs, squares are boards"
    if any(dot.origin is not None for dot in dots):
        where += ", dots at the end of a line are viewing directions"
    words = (
        f"{where}. The colour is the best {name} found with a sensor there; yellow is the best. The body shows the "
        "sensors of the best place."
    )
    return BodyImage(png=data.tobytes(), words=words)


def _dots(problem: Problem, folder: Path, searched: Measured, losses: Array) -> list[_Dot]:
    """One dot per sensor and position, or viewing direction if there is one position; worst first.

    Sensors with one of each have none.
    """
    moving = [knob.name for free in problem.free if _moves(free) for knob in free.knobs]
    if not moving:
        return []
    known: dict[str, dict[str, tuple[Mount, bool]]] = {}
    positions: dict[tuple[str, str, str], _Dot] = {}
    directions: dict[tuple[str, str, str], _Dot] = {}
    for i in np.flatnonzero(np.isfinite(losses)).tolist():
        place = searched.places[i]
        key = json.dumps([place.values.get(name) for name in moving])
        if key not in known:
            config = scenario_at(problem, problem.bases[0], place, folder).config
            known[key] = dict(_mounts(config))
        for name, (mount, board) in known[key].items():
            p, ahead = mount.T_body_sensor[:3, 3], mount.T_body_sensor[:3, 2]
            dot = _Dot(body=mount.body, p_in_body=p, loss=float(losses[i]), board=board)
            _keep_better(positions, name, dot)
            _keep_better(directions, name, replace(dot, p_in_body=p + _RAY_M * ahead, origin=p))
    moved, turned = (Counter(name for name, _, _ in dots) for dots in (positions, directions))
    several = [dot for (name, _, _), dot in positions.items() if moved[name] > 1]
    several += [dot for (name, _, _), dot in directions.items() if moved[name] == 1 < turned[name]]
    return sorted(several, key=lambda dot: -dot.loss)


def _keep_better(best: dict[tuple[str, str, str], _Dot], name: str, dot: _Dot) -> None:
    """Keeps the dot if it is the first of its sensor at this place, or better."""
    at = name, dot.body, json.dumps(np.round(dot.p_in_body, 4).tolist())
    if at not in best or dot.loss < best[at].loss:
        best[at] = dot


def _moves(free: Free) -> bool:
    return any(word in f".{path.text}" for path in free.paths for word in _MOVED)


def _mounts(config: TwinConfig) -> Iterator[tuple[str, tuple[Mount, bool]]]:
    """Mounts on the left side or in the middle, by name; the right side is the mirror image."""
    rig = sensor_rig(config).rig
    for kind in (rig.imus, rig.cameras, rig.others):
        for topic, sensor in kind.items():
            inside = any(c.depth_topic and c.imu_topic == topic for c in rig.cameras.values())
            if not sensor.mount.body.endswith("_r") and not inside and not sensor.mount.body.startswith("exo_"):
                yield "head or chest" if topic in rig.cameras and "_l/" not in topic else topic, (sensor.mount, False)
    for name, board in rig.boards.items():
        if not name.endswith("_r"):
            yield "board", (board.mount, True)


def _panel(
    config: TwinConfig, body: str, dots: list[_Dot], view_deg: tuple[float, float], span: tuple[float, float]
) -> Rgb:
    """A view of the dots on one opaque body; the best and the worst loss of all dots span the colours.

    The view is given by azimuth, relative to the dots' side, and elevation, deg.
    """
    model, data = _standing(config, body)
    T = data.body(body)
    rotation = T.xmat.reshape(3, 3)
    points = np.array([d.p_in_body for d in dots]) @ rotation.T + T.xpos
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    axis = T.xpos + rotation @ _within(model, body)
    out = (points - axis).mean(axis=0)[:2]
    facing = math.degrees(math.atan2(-out[1], -out[0]))
    azimuth, elevation = facing + view_deg[0], view_deg[1]
    lookat = (middle + np.array([*axis[:2], middle[2]])) / 2
    reach = max(float(np.linalg.norm(points - lookat, axis=1).max()), _LEAST_M / _MARGIN) * _MARGIN
    half = math.radians(model.vis.global_.fovy / 2)
    distance = reach / math.tan(half)
    with FilmCamera(model, _SIZE, _SIZE) as camera:
        view = camera.frame(data, lookat, azimuth, elevation, distance)
    image: Rgb = np.ascontiguousarray(view[..., ::-1])
    focal = _SIZE / 2 / math.tan(half)
    uv = _pixels(points, lookat, azimuth, elevation, distance, focal)
    colours = _colours(np.array([d.loss for d in dots]), *span)
    eyes = [d.p_in_body if d.origin is None else d.origin for d in dots]
    from_uv = _pixels(np.array(eyes) @ rotation.T + T.xpos, lookat, azimuth, elevation, distance, focal)
    for (u, v), (u0, v0), colour, dot in zip(uv, from_uv, colours, dots):
        cv2.line(image, (round(u0), round(v0)), (round(u), round(v)), colour, 1, cv2.LINE_AA)
        size = _BEST_PX if dot is dots[-1] else 6 if len(dots) < _MANY else 4
        _mark(image, (u, v), size, colour, dot.board)
    return image


def _within(model: mujoco.MjModel, body: str) -> Array:
    """(3,) centre of a body's shapes, in its frame."""
    return np.asarray(np.mean([shape.p for shape in shapes(model, {model.body(body).id})], axis=0))


def _standing(config: TwinConfig, body: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The wearer with straight legs and sensors; all but one body and its parts are translucent."""
    spec = mujoco.MjSpec()
    spec.add_texture(
        name="paper", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=[1, 1, 1], rgb2=[1, 1, 1], width=8, height=8,
    )  # fmt: skip
    spec.worldbody.add_light(pos=_SUN, dir=[-x for x in _SUN], diffuse=[0.5] * 3, castshadow=False)
    add_wearer(spec, config.person, config.exo)
    add_rig(spec, sensor_rig(config).rig)
    model = compile_model(spec)
    model.vis.headlight.ambient[:] = 0.35
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    shown = {model.body(name).id for name in (body, UPPERS.get(body, body), body.replace("foot", "toe"))}
    for geom in range(model.ngeom):
        carrier = model.geom_bodyid[geom]
        worn = model.body_parentid[carrier] in shown and not _is_limb(model, carrier)
        if carrier in shown or worn:
            continue
        material = model.geom_matid[geom]
        colour = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        model.geom_matid[geom] = -1
        model.geom_rgba[geom] = [*colour[:3], _faint(str(model.body(carrier).name))]
    return model, data


def _is_limb(model: mujoco.MjModel, body: int) -> bool:
    return model.body_jntnum[body] > 0


def _faint(body: str) -> float:
    """Opacity of the other bodies."""
    return 0.0 if body.startswith("rig_") else _FAINT / 3 if body.startswith("exo_") else _FAINT


def _pixels(points: Array, lookat: Array, azimuth: float, elevation: float, distance: float, focal: float) -> Array:
    """(N, 2) pixels of (N, 3) points in MuJoCo's free camera."""
    a, e = math.radians(azimuth), math.radians(elevation)
    ahead = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([math.sin(a), -math.cos(a), 0.0])
    up = np.cross(right, ahead)
    away = points - (lookat - distance * ahead)
    return _SIZE / 2 + focal * np.column_stack([away @ right, -(away @ up)]) / (away @ ahead)[:, None]


def _colours(losses: Array, low: float, high: float) -> list[tuple[int, ...]]:
    return _viridis((high - losses) / (high - low) if high > low else np.ones(len(losses)))


def _viridis(share: Array) -> list[tuple[int, ...]]:
    """BGR colours of values from 0, dark, to 1, yellow."""
    levels = np.round(255 * np.asarray(share, float)).astype(np.uint8)
    return [tuple(int(c) for c in row[0]) for row in cv2.applyColorMap(levels[:, None], cv2.COLORMAP_VIRIDIS)]


def _mark(image: Rgb, uv: tuple[float, float], size: int, colour: tuple[int, ...], board: bool) -> None:
    (u, v), line = uv, 2 if size == _BEST_PX else 1
    at = round(16 * u), round(16 * v)
    if board:
        corners = np.array([[u - size, v - size], [u + size, v - size], [u + size, v + size], [u - size, v + size]])
        shape = np.round(16 * corners).astype(np.int32)
        cv2.fillConvexPoly(image, shape, colour, cv2.LINE_AA, 4)
        cv2.polylines(image, [shape], True, _INK, line, cv2.LINE_AA, 4)
    else:
        cv2.circle(image, at, 16 * size, colour, -1, cv2.LINE_AA, 4)
        cv2.circle(image, at, 16 * size, _INK, line, cv2.LINE_AA, 4)


def _key(best: float, worst: float, name: str) -> Rgb:
    """The colour bar with its values."""
    image = np.full((_SIZE, _BAR + 40, 3), 255, np.uint8)
    top, bottom, left = 70, _SIZE - 40, 18
    for y, colour in zip(range(top, bottom), _viridis(np.linspace(1.0, 0.0, bottom - top))):
        image[y, left : left + 24] = colour
    for y, value in zip(np.linspace(top, bottom, 5), np.linspace(best, worst, 5)):
        cv2.putText(
            image, f"{value + 0.0:.3g}", (left + 32, int(y) + 5), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _INK, 1, cv2.LINE_AA
        )
    cv2.putText(image, name[:18], (6, 30), cv2.FONT_HERSHEY_SIMPLEX, 0.42, _INK, 1, cv2.LINE_AA)
    cv2.putText(image, name[18:36], (6, 48), cv2.FONT_HERSHEY_SIMPLEX, 0.42, _INK, 1, cv2.LINE_AA)
    return image
