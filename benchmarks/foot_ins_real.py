"""The one-foot inertial navigation on real recordings: one parameter set, three data sets, four disturbances.

`python -m benchmarks.foot_ins_real [--json] [--days]`. `real_walks` finds the recordings. With `--days` the
parameters are tuned without the walks of a day and scored on those (`foot_ins_days`).
"""

from __future__ import annotations

import json
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import foot_ins_days, real_walks
from benchmarks.command import answer, command
from benchmarks.consistency import means, nees
from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns, FootInsParameters, FootInsPath, StartPose
from stridetwin.estimators.foot_to_foot import FootToFoot
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Array, Block, Imu

PUBLISHED = {  # 2-D ARMSE in m on the same walks (pyshoe's filter, one threshold for all)
    "pyshoe_shoe": {"armse_m": {"mean": 0.266, "median": 0.155, "p95": 0.842}},
    "pyshoe_ared": {"armse_m": {"mean": 0.303, "median": 0.244, "p95": 0.735}},
    "zupt_9_states": {
        "stance_rmse_m": {"left": 0.15, "right": 0.16},
        "height_error_m": {"left": 0.73, "right": 0.38},
    },
}

LAG_S = 1.0  # of the smoother


def halved_rate(walk: real_walks.ViconWalk) -> real_walks.ViconWalk:
    """The samples of a sensor of half the rate: means over pairs of samples."""
    n = len(walk.imu) // 2 * 2
    columns = {k: v[:n].reshape(-1, 2, 3).mean(1) for k, v in walk.imu.columns.items()}
    return replace(walk, imu=replace(walk.imu, t_ns=walk.imu.t_ns[1:n:2], columns=columns), truth=walk.truth[1:n:2])


def stretched(walk: real_walks.ViconWalk, factor: float) -> real_walks.ViconWalk:
    """The same path, walked in `factor` times the time: rates / factor, accelerations / factor².

    The filter's own attitude separates gravity from the specific force.
    """
    p = FootInsParameters()
    path = FootIns(parameters=p).run(walk.imu)
    R = Rotation.from_quat(path.trajectory.q_world_frame, scalar_first=True)
    up = np.array([0.0, 0.0, p.gravity_mps2])
    force = R.inv().apply((R.apply(walk.imu.columns["specific_force"]) - up) / factor**2 + up)
    columns = {"angular_rate": walk.imu.columns["angular_rate"] / factor, "specific_force": force}
    return replace(walk, imu=replace(walk.imu, t_ns=(walk.imu.t_ns * factor).astype(np.int64), columns=columns))


def biased(walk: real_walks.ViconWalk, bias: float, rng: np.random.Generator) -> real_walks.ViconWalk:
    """With a constant gyro bias of size `bias` (rad/s) in a random direction."""
    direction = rng.standard_normal(3)
    rate = walk.imu.columns["angular_rate"] + bias * direction / np.linalg.norm(direction)
    return replace(walk, imu=replace(walk.imu, columns={**walk.imu.columns, "angular_rate": rate}))


def estimate(imu: Block[Imu]) -> FootInsPath:
    """The path with the single parameter set and unknown calibration."""
    return FootIns().run(imu)


def armse_of(walks: Iterable[real_walks.ViconWalk]) -> dict[str, float]:
    """2-D ARMSE in m of each walk."""
    return {w.name: real_walks.armse(estimate(w.imu).trajectory.p_frame_in_world, w.truth) for w in walks}


def climb(path: Array) -> float:
    """Height gained from the first sample to the last, m."""
    return float(path[-1, 2] - path[0, 2])


def marker_errors(feet: Sequence[real_walks.MarkerWalk], paths: Sequence[FootInsPath]) -> dict[str, dict[str, float]]:
    """Errors of each foot of `dual_foot_walk` at its rests, by name; see `stance_error`."""
    figures = {
        f.name: real_walks.stance_error(p.trajectory.t_ns * 1e-9, p.trajectory.p_frame_in_world, f)
        for f, p in zip(feet, paths)
    }
    return {
        "stance_rmse_m": {name: value[0] for name, value in figures.items()},
        "height_error_m": {name: value[1] for name, value in figures.items()},
    }


def loop_errors(imu: Block[Imu]) -> dict[str, float]:
    """End errors of a walk that ends where it began, with their standard deviations, m."""
    path = estimate(imu).trajectory
    assert path.covariance is not None
    way, variance = path.p_frame_in_world[-1] - path.p_frame_in_world[0], np.diag(path.covariance[-1])
    return {
        "horizontal_m": float(np.hypot(way[0], way[1])),
        "horizontal_sd_m": float(np.sqrt(variance[0] + variance[1])),
        "height_m": float(way[2]),
        "height_sd_m": float(np.sqrt(variance[2])),
    }


def climb_of(imu: Block[Imu]) -> dict[str, float]:
    """Height gained in a walk of unknown truth, and its standard deviation, m."""
    path = estimate(imu).trajectory
    assert path.covariance is not None
    return {"height": climb(path.p_frame_in_world), "sd": float(np.sqrt(path.covariance[-1, 2, 2]))}


def both_feet(feet: Sequence[real_walks.MarkerWalk], start: dict[str, StartPose] | None) -> dict[str, Any]:
    """Errors of both feet of `dual_foot_walk` in one filter with unknown calibration, and of their distance.

    Args:
        feet: Left and right.
        start: By `l` and `r`; None assumes that they are side by side.

    Returns:
        `marker_errors`, and how far the horizontal distance of the sensors differs from that of the feet's middles, m.
    """
    imus = [
        ImuCalibration(
            topic=f"/foot_{side}/imu",
            part="unknown",
            rate_hz=204.8,
            mount=Mount(body=f"foot_{side}"),
            gyroscope_noise_density=0.0,
            gyroscope_random_walk=0.0,
            accelerometer_noise_density=0.0,
            accelerometer_random_walk=0.0,
        )
        for side in "lr"
    ]
    filter_of_both = FootToFoot(Rig(imus={imu.topic: imu for imu in imus}), start=start)
    paths = list(filter_of_both.run({"l": feet[0].imu, "r": feet[1].imu}).values())
    apart = np.subtract(*(p.trajectory.p_frame_in_world[:, :2] for p in paths))
    truly = np.linalg.norm(np.subtract(*(f.middle[:, :2] for f in feet)), axis=1)
    seen = np.isfinite(truly)
    t = paths[0].trajectory.t_ns * 1e-9
    error = np.interp(feet[0].t[seen], t, np.linalg.norm(apart, axis=1)) - truly[seen]
    distance = {"distance_error_rms_m": float(np.sqrt(np.mean(error**2))), "distance_error_end_m": float(error[-1])}
    return marker_errors(feet, paths) | distance


def known_start(foot: real_walks.MarkerWalk) -> StartPose:
    """Start pose from the markers; its heading aligns the one-foot path with theirs at the farthest point."""
    path, t = estimate(foot.imu).trajectory.p_frame_in_world, foot.imu.t_ns * 1e-9
    way = foot.middle - foot.middle[0]
    far = int(np.nanargmax(np.linalg.norm(way, axis=1)))
    out = np.array([np.interp(foot.t[far], t, path[:, i]) for i in range(3)]) - path[0]
    q = Rotation.from_euler("z", real_walks.bearing(way[far]) - real_walks.bearing(out)).as_quat(scalar_first=True)
    return StartPose(p_imu_in_world=foot.middle[0], q_world_imu=q)


def measure(folder: Path) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    walks, feet = real_walks.load_vicon(folder), real_walks.load_markers(folder)
    rng = np.random.default_rng(3)
    variants: dict[str, Callable[[real_walks.ViconWalk], real_walks.ViconWalk]] = {
        "rate_100hz": halved_rate,
        "time_x0.8": lambda w: stretched(w, 0.8),
        "time_x1.3": lambda w: stretched(w, 1.3),
        "gyro_bias_0.01": lambda w: biased(w, 0.01, rng),
    }
    estimate(walks[0].imu)  # compiles
    recorded_s = sum(int(w.imu.t_ns[-1] - w.imu.t_ns[0]) for w in walks) * 1e-9
    filters = {w.name: FootIns() for w in walks}
    begin = time.perf_counter()
    estimates = {w.name: filters[w.name].run(w.imu).trajectory for w in walks}
    elapsed_s = time.perf_counter() - begin
    paths = {name: path.p_frame_in_world for name, path in estimates.items()}
    consistent = {w.name: nees(estimates[w.name], w.truth) for w in walks}
    innovations = {name: {f"nis_{k}": v for k, v in f.nis.items()} for name, f in filters.items()}
    error = {w.name: real_walks.armse(paths[w.name], w.truth) for w in walks}
    height = {w.name: climb(paths[w.name]) - climb(w.truth) for w in walks}
    ours = {
        "armse_m": real_walks.spread(error.values()),
        "end_height_error_m": real_walks.spread(abs(h) for h in height.values()),
        "consistency": means([*consistent.values()]) | means([*innovations.values()]),
        **marker_errors(feet, [estimate(f.imu) for f in feet]),
        "loop": loop_errors(real_walks.load_loop(folder)),
        "stairs_m": {side: climb_of(imu) for side, imu in real_walks.load_stairs(folder).items()},
        "both_feet_start_known": both_feet(feet, {f.name[0]: known_start(f) for f in feet}),
        "both_feet_side_by_side": both_feet(feet, None),
        "times_real_time": recorded_s / elapsed_s,
    }
    ours |= {
        f"armse_{name}_m": real_walks.spread(armse_of(map(make, walks)).values()) for name, make in variants.items()
    }
    smoothed = ((FootIns.batch(None, Options(lag_s=LAG_S)).run(w.imu).trajectory, w.truth) for w in walks)
    ours["armse_smoothed_m"] = real_walks.spread(
        real_walks.armse(path.p_frame_in_world, truth) for path, truth in smoothed
    )
    return {
        "experiment": "foot_ins_real",
        "summary": {"proposed": ours},
        "paper": PUBLISHED,
        "cases": [
            {"walk": n, "armse_m": error[n], "end_height_error_m": height[n], **consistent[n], **innovations[n]}
            for n in error
        ],
    }


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--days", action="store_true", help="tune without the walks of a day, score on those")

    def measured(arguments: Namespace) -> dict[str, Any]:
        folder = real_walks.data_folder()
        if folder is None:
            raise StrideTwinError("no recordings: set STRIDETWIN_DATA to the folder that holds foot_imu_vicon")
        return foot_ins_days.measure(real_walks.load_vicon(folder)) if arguments.days else measure(folder)

    return answer(parser, measured, lambda result: print(json.dumps(result, indent=2)))


if __name__ == "__main__":
    sys.exit(main())
