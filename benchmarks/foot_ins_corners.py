"""One foot on closed walks over measured corner points, with a real turn-on bias of the gyro.

`python -m benchmarks.foot_ins_corners`. Each walk of `foot_imu_corners` runs as `estimate --imu auto` does. How far it
ends from its start is compared with the reported covariance, and its stances at the corners with the corners' places,
after the best turn and shift. Then each walk runs with what each other one has taught about the sensor, as with
`--calibration-from`.
"""

from __future__ import annotations

import sys
import tempfile
from argparse import Namespace
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import answer, command, show_summary
from benchmarks.real_walks import data_folder, imu_block, turn_onto
from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns, FootInsPath
from stridetwin.estimators.foot_ins.learnt import write_learnt
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.measured_calibration import measure_imu
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Block, Imu

_DATA = "foot_imu_corners"
_WITHIN_95 = 5.991  # χ² of two degrees of freedom
_STANDING_MPS, _LEAST_STANCE_S, _LEAST_SWING_S = 0.05, 0.05, 0.2


@dataclass(frozen=True, kw_only=True, eq=False)
class CornerWalk:
    """A walk that ends where it began.

    Attributes:
        name: Of its file.
        imu: Samples.
        corners: (K, 2) m, places of corners on the floor.
        strides: (K,) number of the stride that ends at each of them.
    """

    name: str
    imu: Block[Imu]
    corners: Array
    strides: Array


def load_corner_walks(folder: Path) -> list[CornerWalk]:
    """The walks of a data folder."""
    walks = []
    for file in sorted((folder / _DATA).glob("*.npz")):
        values = np.load(file)
        imu = imu_block(values["t"], values["gyro"], values["accel"])
        walks.append(CornerWalk(name=file.stem, imu=imu, corners=values["gcp"], strides=values["stride"]))
    return walks


def find_stances(path: FootInsPath) -> list[int]:
    """Rows in the middle of the stances of a path."""
    seconds = path.trajectory.t_ns * 1e-9
    stands = path.standing_speed_sd < _STANDING_MPS
    stances: list[tuple[int, int]] = []  # first and last row
    for begin, end in np.flatnonzero(np.diff(np.r_[0, stands, 0])).reshape(-1, 2).tolist():
        if stances and seconds[begin] - seconds[stances[-1][1]] < _LEAST_SWING_S:
            stances[-1] = stances[-1][0], end - 1  # the same stance
        elif seconds[end - 1] - seconds[begin] > _LEAST_STANCE_S:
            stances.append((begin, end - 1))
    return [(begin + end) // 2 for begin, end in stances]


def fit_corners(places: Array, corners: Array) -> float:
    """RMS distance (m) of places (K, 2) from corners (K, 2) after the best turn and shift."""
    centred, target = places - places.mean(axis=0), corners - corners.mean(axis=0)
    return float(np.sqrt(((turn_onto(centred, target) - target) ** 2).sum(axis=1).mean()))


def score_walk(walk: CornerWalk, calibration_from: Path | None = None) -> tuple[FootIns, dict[str, Any]]:
    """Runs the filter on a walk; returns it, and its figures in m (`within_95_pct`: 100 or 0)."""
    rig = Rig(imus={"/foot_l/imu": measure_imu(walk.imu, "/foot_l/imu", "foot_l")})
    estimator = FootIns(rig, options=Options(calibration_from=calibration_from))
    path = estimator.run(walk.imu)
    p, P = path.trajectory.p_frame_in_world, path.trajectory.covariance
    way = p[-1] - p[0]
    stances = find_stances(path)
    at_corners = [stances[min(int(stride), len(stances) - 1)] for stride in walk.strides]
    return estimator, {
        "closure_m": float(np.hypot(way[0], way[1])),
        "closure_sd_m": float(np.sqrt(P[-1, 0, 0] + P[-1, 1, 1])),
        "within_95_pct": 100.0 * float(way[:2] @ np.linalg.solve(P[-1, :2, :2], way[:2]) < _WITHIN_95),
        "height_m": float(way[2]),
        "corners_m": fit_corners(p[at_corners, :2], walk.corners),
    }


def measure(_: Namespace) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON.

    Raises:
        StrideTwinError: The recordings are not there.
    """
    folder = data_folder(_DATA)
    if folder is None:
        raise StrideTwinError(f"no recordings: STRIDETWIN_DATA must name the folder that holds {_DATA}")
    walks = load_corner_walks(folder)
    summary = {}
    with tempfile.TemporaryDirectory() as temporary:
        for walk in walks:
            estimator, summary[walk.name] = score_walk(walk)
            write_learnt(estimator.learnt, Path(temporary, walk.name))
        for walk, earlier in permutations(walks, 2):
            _, summary[f"{walk.name} from {earlier.name}"] = score_walk(walk, Path(temporary, earlier.name))
    return {"experiment": "foot_ins_corners", "summary": summary}


if __name__ == "__main__":
    sys.exit(answer(command(__doc__), measure, show_summary(14, ".3f")))
