"""What limits the one-foot filter on each real recording, and the twin's parts that show the same.

`python -m benchmarks.reality [--json]`. Every foot goes through the filter with each floor taken as new, so that the
height drift shows. A stance is a span in which the filter takes the foot as stationary; a rest is one that lasts for
0.5 s. The recordings are those of `real_walks`; the twin's walks are 20 m over level ground.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.command import answer, command
from benchmarks.foot_ins_twin import feet_of_walk
from benchmarks.real_walks import data_folder, load_loop, load_markers, load_stairs, load_vicon
from stridetwin.estimators.foot_ins import FootIns, FootInsParameters, FootInsPath
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array, Block, Imu

EACH_FLOOR_NEW = FootInsParameters(same_floor=0.0)
PARTS = ("ADIS16485", "MPU-9250", "NGIMU-uncalibrated", "MTw-uncalibrated")
STATIONARY_MPS, SAME_STANCE_S, LEAST_STANCE_S, REST_S, LANDING_S = 0.02, 0.15, 0.03, 0.5, 0.1
COLUMNS = {
    "rate_hz": "Hz",
    "peak_force_mps2": "peak f",
    "peak_rate_radps": "peak w",
    "rest_force_mps2": "rest |f|",
    "rest_force_range_mps2": "range",
    "rest_rate_radps": "rest |w|",
    "stance_force_mps2": "stance |f|",
    "stance_rate_radps": "stance w",
    "stance_tilt_deg": "tilt",
    "landing_correction_mps": "landing",
    "step_height_m": "step",
    "height_drift_pct": "drift %",
    "nis_standing": "nis",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Stances:
    """A filtered walk with its samples, and the first and last row of each stance."""

    path: FootInsPath
    rate: Array
    force: Array
    spans: list[tuple[int, int]]

    @property
    def t(self) -> Array:
        """(N,) s."""
        return self.path.trajectory.t_ns * 1e-9

    @property
    def rotation(self) -> Rotation:
        """N attitudes, world <- sensor."""
        return Rotation.from_quat(self.path.trajectory.q_world_frame, scalar_first=True)


def stances(imu: Block[Imu], path: FootInsPath) -> Stances:
    """Finds the stances of a walk; every sample must have been used."""
    t, standing = path.trajectory.t_ns * 1e-9, path.standing_speed_sd < STATIONARY_MPS
    spans: list[tuple[int, int]] = []
    for first, end in np.flatnonzero(np.diff(np.r_[0, standing, 0])).reshape(-1, 2):
        if spans and t[first] - t[spans[-1][1]] < SAME_STANCE_S:
            spans[-1] = (spans[-1][0], int(end) - 1)
        elif t[end - 1] - t[first] > LEAST_STANCE_S:
            spans.append((int(first), int(end) - 1))
    return Stances(path=path, rate=imu.columns["angular_rate"], force=imu.columns["specific_force"], spans=spans)


def velocity_corrections(walk: Stances, gravity: float) -> Array:
    """(N, 3) change of velocity by the updates at each sample, m/s: what propagation does not explain."""
    dt = np.diff(walk.t)[:, None]
    middle = walk.rotation[:-1] * Rotation.from_rotvec(0.5 * dt * walk.rate[1:])
    propagated = dt * (middle.apply(walk.force[1:]) - [0.0, 0.0, gravity])
    return np.vstack([np.zeros(3), np.diff(walk.path.v_imu_in_world, axis=0) - propagated])


def causes(imu: Block[Imu]) -> dict[str, float]:
    """The figures of `COLUMNS` of one foot: medians over stances or strides, unless the name says otherwise."""
    estimator = FootIns(parameters=EACH_FLOOR_NEW)
    walk = stances(imu, estimator.run(imu))
    t, p = walk.t, walk.path.trajectory.p_frame_in_world
    mean_force = [float(np.linalg.norm(walk.force[a : b + 1].mean(axis=0))) for a, b in walk.spans]
    rests = [f for f, (a, b) in zip(mean_force, walk.spans) if t[b] - t[a] > REST_S] or [np.nan]
    resting = [np.linalg.norm(walk.rate[a : b + 1].mean(axis=0)) for a, b in walk.spans if t[b] - t[a] > REST_S]
    middle = np.array([(a + b) // 2 for a, b in walk.spans])
    up = walk.rotation[middle].inv().apply([0.0, 0.0, 1.0])
    correction = velocity_corrections(walk, EACH_FLOOR_NEW.gravity_mps2)[:, 2]
    landings = [correction[(t > t[a] - LANDING_S) & (t <= t[m])].sum() for (a, _), m in zip(walk.spans, middle)]
    step = np.diff(p[middle], axis=0)
    way = float(np.linalg.norm(step, axis=1).sum())
    return {
        "rate_hz": 1.0 / float(np.median(np.diff(t))),
        "peak_force_mps2": float(abs(walk.force).max()),
        "peak_rate_radps": float(abs(walk.rate).max()),
        "rest_force_mps2": float(np.median(rests)),
        "rest_force_range_mps2": float(np.ptp(rests)),
        "rest_rate_radps": float(np.median(resting)) if resting else np.nan,
        "stance_force_mps2": float(np.median(mean_force)),
        "stance_rate_radps": float(
            np.median([np.linalg.norm(walk.rate[a : b + 1], axis=1).mean() for a, b in walk.spans])
        ),
        "stance_tilt_deg": float(np.degrees(np.median(np.arccos(np.clip(up @ up[0], -1.0, 1.0))))),
        "landing_correction_mps": float(np.median(landings)),
        "step_height_m": float(np.median(step[:, 2])),
        "height_drift_pct": 100.0 * float(step[:, 2].sum()) / way,
        "nis_standing": estimator.nis.get("standing", np.nan),
    }


def recordings() -> Iterator[tuple[str, Block[Imu]]]:
    """Each foot of every real recording.

    Raises:
        StrideTwinError: There are none.
    """
    folder = data_folder()
    if folder is None:
        raise StrideTwinError("no recordings: set STRIDETWIN_DATA to the folder that holds foot_imu_vicon")
    for walk in load_vicon(folder):
        yield walk.name, walk.imu
    for foot in load_markers(folder):
        yield f"dual_foot_walk {foot.name}", foot.imu
    yield "ngimu_short_walk", load_loop(folder)
    for side, imu in load_stairs(folder).items():
        yield f"gaitmap_stair_up {side}", imu


def twin_walks() -> Iterator[tuple[str, Block[Imu]]]:
    """The left foot of a level walk, measured by each of `PARTS`; seed 1."""
    for name in PARTS:
        _, imu, _ = feet_of_walk("level_20m", 1, name)["l"]
        yield f"twin {name}", imu


def measure() -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    walks = [*recordings(), *twin_walks()]
    return {"experiment": "reality", "cases": [{"recording": name, **causes(imu)} for name, imu in walks]}


def show(result: dict[str, Any]) -> None:
    """One line per recording."""
    print(f"{'recording':26s}" + "".join(f"{title:>11s}" for title in COLUMNS.values()))
    for case in result["cases"]:
        print(f"{case['recording']:26s}" + "".join(f"{case[name]:11.3f}" for name in COLUMNS))


def main() -> int:
    """Command line."""
    return answer(command(__doc__), lambda _: measure(), show)


if __name__ == "__main__":
    sys.exit(main())
