"""One walk of the zoo: rendered, followed by the odometry, predicted, and scored.

**Reporting set** (`terrain_zoo`): every kind, seven walks of each, seeds from 6000. **Tuning set**
(`terrain_zoo_tuning`): only the kinds on which parameters may be tuned, seeds below 1000. Consecutive seeds are of
consecutive kinds, so that a subset of as many walks as there are kinds has one of each.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.locomotion_mode import METHODS
from stridetwin.evaluation.path_scores import compare, score
from stridetwin.evaluation.truth import TruePath
from stridetwin.sim.wearer.body import wearer
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Pose, trajectory_of
from stridetwin.studies.case import Case
from stridetwin.studies.terrain_zoo.kinds import drawn, names
from stridetwin.studies.walks import fell_at_s, recorded
from stridetwin.studies.zhao2023.mode_walks import posed, predict, scored_rows

_WALKS_PER_KIND = 7
_SETTLED_M = 5.0
_EVERY = 20
"""Poses at the IMU's rate are scored at a twentieth of it."""
_Variant = tuple[range, bool]


def _seeds(first: int, *, tuning: bool) -> range:
    return range(first, first + _WALKS_PER_KIND * len(names(tuning=tuning)))


VARIANTS: dict[str, _Variant] = {
    "terrain_zoo": (_seeds(6000, tuning=False), False),
    "terrain_zoo_tuning": (_seeds(0, tuning=True), True),
}
"""By experiment: its seeds, and whether it is the tuning set."""


def kind_of(seed: int, *, tuning: bool) -> str:
    """The kind of a seed's walk."""
    kinds = names(tuning=tuning)
    return kinds[seed % len(kinds)]


def run_case(tuning: bool, case: Case) -> dict[str, Any]:
    """One walk.

    Returns:
        `seed`, `physics`, `kind`, `mount`, `fell_at_s`, `odometry` (`odometry_figures`), and `methods`: method to the
        rows of `ModeScores`, and `time_ms` per depth image.
    """
    kind = kind_of(case.seed, tuning=tuning)
    config = replace(drawn(kind, case.seed), physics=case.physics)
    sole_m = wearer(config.person, with_exo=False).body.shoe_length_m
    poses: list[Pose] = []
    with recorded(config, case, kind) as recording:
        predictions = predict(
            posed(recording, config.rig_mount, "dvio", seen=poses.append), recording, (*METHODS, *case.estimators)
        )
        return case.row(
            kind=kind, mount=config.rig_mount, fell_at_s=fell_at_s(recording),
            odometry=odometry_figures(poses[::_EVERY], recording, config.rig_mount),
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


def _tilt(estimated: Array, true: Array) -> Array:
    """(N,) rad, angle between the estimated and the true vertical, from (N, 4) quaternions."""
    est, ref = (Rotation.from_quat(q, scalar_first=True).inv().apply([0.0, 0.0, 1.0]) for q in (estimated, true))
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(est, ref), axis=1), np.sum(est * ref, axis=1)))
