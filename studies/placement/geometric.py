"""Scores of a place that need no recording: the true walk, the rig, and lines of sight between them."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from stridetwin.sim.parts.kinds import CameraPart, RgbdPart
from stridetwin.sim.rendering.cameras import board_seen_by
from stridetwin.sim.sensors.standard_rig import SensorRig
from stridetwin.streams.errors import StrideTwinError
from stridetwin.studies.placement.posed_walk import PosedWalk
from stridetwin.studies.placement.scores import GEOMETRIC
from stridetwin.studies.placement.sight import Seeing, look_ahead, see_board

_CELLS = {"insole": 4, "interaction": 2}
_WITHIN = ("head_imu", "exo_imu", "actuator")  # components of other parts, or of the exoskeleton


def geometric_scores(
    sensor_rig: SensorRig, walk: PosedWalk | None, names: Collection[str], seeing: Seeing
) -> dict[str, float]:
    """Scores by name; undefined scores (no board ever in view) are left out.

    Args:
        sensor_rig: Sensors of the place.
        walk: True motion; None where only weights are needed.
        names: Of `GEOMETRIC`.
        seeing: When a board counts as seen.

    Raises:
        StrideTwinError: A sensor that a score needs is off, or a part has no weight.
    """
    groups = {sensor.group for sensor in sensor_rig.sensors.values()}
    for name in names:
        needed = GEOMETRIC[name][0]
        if needed and needed not in groups:
            raise StrideTwinError(f"{name} needs {needed}, which is off")
    groups_needed = {GEOMETRIC[name][0] for name in names}
    found: dict[str, float] = {}
    if walk is not None and "foot_camera" in groups_needed:
        found |= _of_boards(sensor_rig, walk, seeing)
    if walk is not None and "head_camera" in groups_needed:
        found |= _of_the_way(sensor_rig, walk)
    if "weight_g" in names:
        found["weight_g"] = _weight_g(sensor_rig)
    if "foot_weight_g" in names:
        found["foot_weight_g"] = _weight_g(sensor_rig, "foot_l")
    return {name: found[name] for name in names if name in found}


def _of_boards(sensor_rig: SensorRig, walk: PosedWalk, seeing: Seeing) -> dict[str, float]:
    sights = []
    for topic, camera in sensor_rig.rig.cameras.items():
        board, part = board_seen_by(sensor_rig, topic), sensor_rig.sensors[topic].part
        if board is not None and isinstance(part, CameraPart):
            sights.append(see_board(walk, camera, board, part.imager.exposure_s, seeing))
    seen = np.array([s.seen for s in sights])
    in_view = sum(int(s.in_view.sum()) for s in sights)
    found = {
        "visibility_pct": 100.0 * float(seen.any(axis=0).mean()),
        "sharp_pct": 100.0 * float(np.array([s.sharp for s in sights]).any(axis=0).mean()),
    }
    if in_view:
        found["occlusion_pct"] = 100.0 * sum(int(s.behind_limbs.sum()) for s in sights) / in_view
    if seen.any():
        found["square_px"] = float(np.concatenate([s.px[s.seen] for s in sights]).mean())
    return found


def _of_the_way(sensor_rig: SensorRig, walk: PosedWalk) -> dict[str, float]:
    topic = next(t for t, camera in sensor_rig.rig.cameras.items() if camera.depth_topic)
    part = sensor_rig.sensors[topic].part
    assert isinstance(part, RgbdPart)
    outlook = look_ahead(walk, sensor_rig.rig.cameras[topic], (part.depth.range_min, part.depth.range_max))
    return {"ahead_pct": 100.0 * outlook.ahead, "own_body_pct": 100.0 * outlook.own_body}


def _weight_g(sensor_rig: SensorRig, body: str | None = None) -> float:
    """Weight of all sensors, or of those on one body, g."""
    total = 0.0
    for topic, sensor in sensor_rig.sensors.items():
        if sensor.group in _WITHIN or body not in (None, sensor.calibration.mount.body):
            continue
        if not sensor.part.mass_kg:
            raise StrideTwinError(f"the part of {topic}, {sensor.part.name}, has no mass_g, which weight asks for")
        total += 1e3 * sensor.part.mass_kg * _CELLS.get(sensor.group, 1)
    return total
