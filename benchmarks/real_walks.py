"""Real walks with known truth, and their scores.

The recordings are in $STRIDETWIN_DATA, otherwise in `../shared/data` beside the checkout: `foot_imu_vicon` (walks under
motion capture, first published with pyshoe, Wagstaff & Kelly 2018) and `dual_foot_walk` (gaitmap's example data),
`foot_imu_other` (an x-io NGIMU, and gaitmap's stairs).
"""

from __future__ import annotations

import gzip
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2
from stridetwin.streams.samples import Array, Block, Imu


@dataclass(frozen=True, kw_only=True, eq=False)
class ViconWalk:
    """One walk of `foot_imu_vicon`: samples, and the truth (N, 3) m at their times."""

    name: str
    imu: Block[Imu]
    truth: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkerWalk:
    """One foot of `dual_foot_walk`: samples, and markers (M, 3) m at times (M,) s; `side` is the fifth metatarsal's."""

    name: str
    imu: Block[Imu]
    t: Array
    heel: Array
    toe: Array
    side: Array

    @property
    def middle(self) -> Array:
        """(M, 3) of the foot, m."""
        return (self.heel + self.toe) / 2


def data_folder(holding: str = "foot_imu_vicon") -> Path | None:
    """Folder of the recordings; None if no folder holds the requested ones."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("STRIDETWIN_DATA", beside))
    return folder if (folder / holding).is_dir() else None


def imu_block(t: Array, rate: Array, force: Array) -> Block[Imu]:
    """IMU samples from s, rad/s and m/s²."""
    columns = {"angular_rate": np.array(rate, float), "specific_force": np.array(force, float)}
    return Block(topic="/foot/imu", kind=Imu, t_ns=np.round(t * 1e9).astype(np.int64), columns=columns)


def despike(truth: Array, t: Array, max_speed: float = 9.0) -> Array:
    """Truth (N, 3) without the samples that would need more than `max_speed` (m/s) from the last good one.

    They are interpolated. If they are more than a tenth, the jump is permanent, and the truth stays as recorded.
    """
    good, last = np.ones(len(truth), bool), 0
    for i in range(1, len(truth)):
        good[i] = np.linalg.norm(truth[i] - truth[last]) <= max_speed * max(t[i] - t[last], 1e-3)
        last = i if good[i] else last
    if good.mean() < 0.9:
        return truth
    return np.column_stack([np.interp(t, t[good], truth[good, k]) for k in range(3)])


def armse(path: Array, truth: Array) -> float:
    """2-D ARMSE in m as in pyshoe: common start, heading aligned where the path is first 0.8 m away."""
    e, g = path[:, :2] - path[0, :2], truth[:, :2] - truth[0, :2]
    far = np.linalg.norm(e, axis=1) > 0.8
    i = int(np.argmax(far)) if far.any() else len(e) - 1
    turn = np.arctan2(g[i, 1], g[i, 0]) - np.arctan2(e[i, 1], e[i, 0])
    return float(np.mean(np.sqrt(((turned(e, turn) - g) ** 2).sum(1) / 2)))


def stance_error(t: Array, path: Array, truth: MarkerWalk) -> tuple[float, float]:
    """2-D RMSE over the rests after the best translation, rotation and offset in the foot; end height error; both m.

    Args:
        t: (N,) s.
        path: (N, 3) m.
        truth: Markers.
    """
    error, height = match_rests(t, path, truth)
    return float(np.sqrt((error**2).sum(1).mean())), height


def match_rests(t: Array, path: Array, truth: MarkerWalk) -> tuple[Array, float]:
    """(K, 2) m, errors at the K rests after the best translation, rotation and offset in the foot; end height error, m.

    Args:
        t: (N,) s.
        path: (N, 3) m.
        truth: Markers.
    """
    k = rests(truth)
    e = np.column_stack([np.interp(truth.t[k], t, path[:, i]) for i in range(3)])
    g = truth.middle[k]
    along = (truth.toe[k] - truth.heel[k])[:, :2]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.column_stack([-along[:, 1], along[:, 0]])
    offset, error = np.zeros(2), np.zeros_like(along)
    for _ in range(50):
        target = g[:, :2] + along * offset[0] + across * offset[1]
        centre_e, centre_t = e[:, :2].mean(0), target.mean(0)
        moved = turn_onto(e[:, :2] - centre_e, target - centre_t) + centre_t - g[:, :2]
        offset = np.array([np.mean((moved * along).sum(1)), np.mean((moved * across).sum(1))])
        error = moved - along * offset[0] - across * offset[1]
    height = (e[-1, 2] - e[0, 2]) - (g[-1, 2] - g[0, 2])
    return error, float(height)


def turned(xy: Array, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return xy @ np.array([[c, s], [-s, c]])


def turn_onto(xy: Array, target: Array) -> Array:
    """Places (N, 2) about their mean, turned so that they are nearest to others (N, 2) about theirs."""
    m = xy.T @ target
    return turned(xy, float(np.arctan2(m[0, 1] - m[1, 0], m[0, 0] + m[1, 1])))


def rests(truth: MarkerWalk, max_speed: float = 0.15, min_s: float = 0.15) -> list[int]:
    """Middles of the spans in which both markers are slow."""
    seen = np.isfinite(truth.heel).all(1) & np.isfinite(truth.toe).all(1)
    speeds = [
        np.linalg.norm(np.gradient(np.where(seen[:, None], m, 0.0), truth.t, axis=0), axis=1)
        for m in (truth.heel, truth.toe)
    ]
    still = seen & (np.maximum(*speeds) < max_speed)
    edges = np.flatnonzero(np.diff(np.r_[0, still.astype(int), 0])).reshape(-1, 2)
    return [(a + b) // 2 for a, b in edges if truth.t[b - 1] - truth.t[a] >= min_s]


def load_vicon(folder: Path, name: str = "foot_imu_vicon") -> list[ViconWalk]:
    """Walks of `foot_imu_vicon`, or of another set of its kind, despiked, in the order of their names."""
    walks = []
    for file in sorted((folder / name).glob("*.npz")):
        with np.load(file) as d:
            block = imu_block(d["t"], d["gyro"], d["accel"])
            walks.append(ViconWalk(name=file.stem, imu=block, truth=despike(d["position"], d["t"])))
    return walks


def load_markers(folder: Path) -> list[MarkerWalk]:
    """Both feet of `dual_foot_walk`."""
    imu_names, imu = _table(folder / "dual_foot_walk" / "imu_sample.csv.gz")
    names, mocap = _table(folder / "dual_foot_walk" / "mocap_sample.csv.gz")

    def pick(all_names: list[str], values: Array, prefix: str) -> Array:
        return values[:, [all_names.index(f"{prefix}{axis}") for axis in "xyz"]]

    return [
        MarkerWalk(
            name=side,
            imu=imu_block(
                np.arange(len(imu)) / 204.8,
                np.radians(pick(imu_names, imu, f"{side}_sensor gyr_")),
                pick(imu_names, imu, f"{side}_sensor acc_"),
            ),
            t=np.arange(len(mocap)) / 100.0,
            heel=pick(names, mocap, f"{side[0].upper()}_FCC ") / 1000.0,
            toe=pick(names, mocap, f"{side[0].upper()}_TOE ") / 1000.0,
            side=pick(names, mocap, f"{side[0].upper()}_FM5 ") / 1000.0,
        )
        for side in ("left", "right")
    ]


def load_loop(folder: Path) -> Block[Imu]:
    """The loop of `ngimu_short_walk`, which ends where it began; of repeated stamps the first sample counts."""
    with gzip.open(folder / "foot_imu_other" / "ngimu_short_walk.csv.gz", "rt") as f:
        table = np.genfromtxt(f, delimiter=",", skip_header=1)
    table = table[np.r_[True, np.diff(table[:, 0]) > 0.0]]
    return imu_block(table[:, 0], np.radians(table[:, 1:4]), table[:, 4:7] * STANDARD_GRAVITY_MPS2)


def load_stairs(folder: Path) -> dict[str, Block[Imu]]:
    """`left` and `right` foot up one staircase, of `gaitmap_stair_up`."""
    names, table = _table(folder / "foot_imu_other" / "gaitmap_stair_up.csv.gz")
    t = np.arange(len(table)) / 204.8

    def pick(prefix: str) -> Array:
        return table[:, [names.index(f"{prefix}{axis}") for axis in "xyz"]]

    return {
        side: imu_block(t, np.radians(pick(f"{side}_sensor gyr_")), pick(f"{side}_sensor acc_"))
        for side in ("left", "right")
    }


def _table(file: Path) -> tuple[list[str], Array]:
    with gzip.open(file, "rt") as f:
        sensor, axis = (f.readline().strip().split(",") for _ in range(2))
        return [f"{a} {b}" for a, b in zip(sensor, axis)], np.genfromtxt(f, delimiter=",")


def bearing(way: Array) -> float:
    """Direction of a path (2 or 3,) in the plane, rad."""
    return float(np.arctan2(way[1], way[0]))


def spread(values: Iterable[float]) -> dict[str, float]:
    """Mean, median and 95th percentile."""
    x = np.array(list(values))
    return {"mean": float(x.mean()), "median": float(np.median(x)), "p95": float(np.percentile(x, 95))}
