"""One walk of the zoo: rendered, followed by the odometry, predicted, and scored.

**Reporting set** (`terrain_zoo`): every kind, seven walks of each, seeds from 14000. **Tuning set**
(`terrain_zoo_tuning`): only the kinds on which parameters may be tuned, seeds below 1000. **Level set**
(`terrain_zoo_level`): twenty walks of the first kind, on which the odometry's height and tilt are scored. Consecutive
seeds are of consecutive kinds, so that a subset of as many walks as there are kinds has one of each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.locomotion_mode import METHODS
from stridetwin.estimators.terrain_map.depth_camera import camera_in_frame, transform
from stridetwin.outputs.path.scores import compare, score
from stridetwin.outputs.truth import TruePath
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.sensors.standard_rig import standard_rig
from stridetwin.sim.wearer.body import wearer
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array, Odometry
from stridetwin.streams.trajectory import Pose, trajectory_of
from stridetwin.studies.case import Case
from stridetwin.studies.terrain_zoo.kinds import drawn, names
from stridetwin.studies.walks import fell_at_s, recorded
from stridetwin.studies.zhao2023.mode_walks import posed, predict, scored_rows

_WALKS_PER_KIND, _LEVEL_WALKS = 7, 20
_SETTLED_M = 5.0
_EVERY = 20
"""Poses at the IMU's rate are scored at a twentieth of it."""
_Variant = tuple[range, tuple[str, ...]]


def _every(first: int, kinds: tuple[str, ...]) -> _Variant:
    return range(first, first + _WALKS_PER_KIND * len(kinds)), kinds


VARIANTS: dict[str, _Variant] = {
    "terrain_zoo": _every(14000, names(tuning=False)),
    "terrain_zoo_tuning": _every(0, names(tuning=True)),
    "terrain_zoo_level": (range(14300, 14300 + _LEVEL_WALKS), names(tuning=False)[:1]),
}
"""By experiment: its seeds and kinds."""


def kind_of(seed: int, kinds: Sequence[str]) -> str:
    """The kind of a seed's walk."""
    return kinds[seed % len(kinds)]


def run_case(kinds: Sequence[str], case: Case) -> dict[str, Any]:
    """One walk.

    Returns:
        `seed`, `physics`, `kind`, `mount`, `fell_at_s`, `odometry` (`odometry_figures`, and `mount_rad`), and
        `methods`: method to the rows of `ModeScores`, and `time_ms` per depth image.
    """
    kind = kind_of(case.seed, kinds)
    config = replace(drawn(kind, case.seed), physics=case.physics)
    sole_m = wearer(config.person, with_exo=False).body.shoe_length_m
    poses: list[Pose] = []
    with recorded(config, case, kind) as recording:
        predictions = predict(
            posed(recording, config.rig_mount, "dvio", seen=poses.append), recording, (*METHODS, *case.estimators)
        )
        return case.row(
            kind=kind, mount=config.rig_mount, fell_at_s=fell_at_s(recording),
            odometry=odometry_figures(poses[::_EVERY], recording, config.rig_mount)
            | {"mount_rad": mount_error(predictions.camera, config)},
            methods=scored_rows(predictions, recording, sole_m),
        )  # fmt: skip


def odometry_figures(poses: list[Pose], recording: Recording, mount: str) -> dict[str, float]:
    """Figures of an odometry whose first pose is given the true position and heading.

    Returns:
        `distance_m`; `end_height_m`, signed; `tilt_rad`, the RMS error of the vertical after 5 m; `inside_pct`, the
        share of the walk with the position within its own 95 % bound.
    """
    found = compare(trajectory_of(poses), TruePath.of(recording.block(f"/truth/{mount}/imu/odometry")))
    tilt = _tilt(found.estimate.q_world_frame, found.truth.q_world_frame)
    settled = found.distance_m - found.distance_m[0] > _SETTLED_M
    scores = score(found)
    return {
        "distance_m": scores["distance_m"],
        "end_height_m": scores["end_height_error_m"],
        "tilt_rad": float(np.sqrt(np.mean(tilt[settled] ** 2))) if settled.any() else math.nan,
        "inside_pct": scores["nees_position_within_95_pct"],
    }


def mount_error(estimated: Odometry | None, config: TwinConfig) -> float:
    """Rotation between the camera's estimated mount on its IMU and the true one, rad; NaN without an estimate."""
    if estimated is None:
        return math.nan
    rig, mount = standard_rig(config), config.rig_mount
    true = camera_in_frame(rig, rig.cameras[f"/{mount}/color"], f"{mount}/imu")
    return float(Rotation.from_matrix(true[:3, :3].T @ transform(estimated)[:3, :3]).magnitude())


def _tilt(estimated: Array, true: Array) -> Array:
    """(N,) rad, angle between the estimated and the true vertical, from (N, 4) quaternions."""
    est, ref = (Rotation.from_quat(q, scalar_first=True).inv().apply([0.0, 0.0, 1.0]) for q in (estimated, true))
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(est, ref), axis=1), np.sum(est * ref, axis=1)))
