"""How level the floors of the recorded walks are: heights of feet that rest, by place.

`python -m benchmarks.recorded_floors [--json]`. Recordings: `foot_imu_vicon` (position of the sensor) and the heels of
`dual_foot_walk`. A rest is a span of at least 0.15 s in which the foot is slower than 0.15 m/s below 10 Hz; its height
is the median. Rows: number of rests, scatter of their heights, slope of the plane that fits them and scatter about it,
and the scatter from rest to rest beside the floor's. Over the walks of `foot_imu_vicon`: scatter of the heights by
distance (medians); the slope that the IMU itself shows, by which a sloping floor differs from a tilted frame of the
cameras; and the unevenness of a floor as the twin draws it (`sim.world.uneven_floor`) that explains the heights, with
and without that tilt. Its standard error is that of walks drawn anew.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import nnls
from scipy.signal import butter, sosfiltfilt

from benchmarks.command import answer, command
from benchmarks.real_walks import ViconWalk, data_folder, load_markers, load_vicon
from stridetwin.estimators.foot_ins import FootIns, FootInsParameters
from stridetwin.sim.world.uneven_floor import APART_M, GROWTH
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array

REST_MPS, REST_S, SMOOTH_HZ = 0.15, 0.15, 10.0
SAME_LEVEL_M = 0.03  # rests farther from the median height are on something, or no rests
BINS_M = (0.0, 0.2, 0.5, 1.0, 2.0, 4.0)
LEAST_PAIRS = 8
_DRAWS = 200


def find_rests(t: Array, p: Array) -> tuple[Array, Array]:
    """Rests of a foot on one level: (K,) middle rows, and (K, 3) m, places.

    Args:
        t: (N,) s.
        p: (N, 3) m.
    """
    hz = 1.0 / float(np.median(np.diff(t)))
    smooth = sosfiltfilt(butter(2, SMOOTH_HZ, fs=hz, output="sos"), p, axis=0)
    still = np.linalg.norm(np.gradient(smooth, t, axis=0), axis=1) < REST_MPS
    spans = np.flatnonzero(np.diff(np.r_[0, still.astype(int), 0])).reshape(-1, 2)
    spans = spans[t[spans[:, 1] - 1] - t[spans[:, 0]] >= REST_S]
    places = np.array([np.median(p[a:b], axis=0) for a, b in spans]).reshape(-1, 3)
    level = abs(places[:, 2] - np.median(places[:, 2])) < SAME_LEVEL_M
    return spans.mean(axis=1).astype(int)[level], places[level]


def fit_plane(places: Array) -> tuple[Array, Array]:
    """Slopes (2,) m/m of the plane that fits places (K, 3) m best, and heights (K,) m above it."""
    A = np.column_stack([places[:, :2] - places[:, :2].mean(0), np.ones(len(places))])
    plane = np.linalg.lstsq(A, places[:, 2], rcond=None)[0]
    return plane[:2], places[:, 2] - A @ plane


def pairs(places: Array) -> Array:
    """(P, 2) of all pairs of rests: distance in the plane, m, and half the squared difference of height, m²."""
    i, j = np.triu_indices(len(places), 1)
    away = np.linalg.norm(places[i, :2] - places[j, :2], axis=1)
    return np.column_stack([away, 0.5 * (places[i, 2] - places[j, 2]) ** 2])


def fit_unevenness(walks: Sequence[Array]) -> tuple[float, Array]:
    """Unevenness of one floor, and (W,) scatter from rest to rest of each walk, m, by least squares.

    The expected half squared difference of two rests of walk w is n_w² + u² (r / 3 m)^(2 H) / 2. A row counts by the
    inverse of its own expected square, in five rounds.

    Args:
        walks: `pairs` of each walk.
    """
    rows = np.concatenate(walks)
    of_walk = np.repeat(np.eye(len(walks)), [len(w) for w in walks], axis=0)
    A = np.column_stack([of_walk, 0.5 * (rows[:, 0] / APART_M) ** (2.0 * GROWTH)])
    expected = np.ones(len(rows))
    variances = np.zeros(A.shape[1])
    for _ in range(5):
        variances = nnls(A / expected[:, None], rows[:, 1] / expected)[0]
        expected = A @ variances + 1e-7
    return float(np.sqrt(variances[-1])), np.sqrt(variances[:-1])


def untilt(places: Array, slope: Array) -> Array:
    """Places (K, 3) m without a slope (2,) m/m of the frame in which they are given."""
    return np.column_stack([places[:, :2], places[:, 2] - places[:, :2] @ slope])


def rises_of_imu(walk: ViconWalk, rows: Array) -> Array:
    """(K - 1,) m, what the foot INS with every floor new rises between the rests at these rows."""
    path = FootIns(parameters=FootInsParameters(same_floor=0.0)).run(walk.imu).trajectory
    return np.diff(np.interp(walk.imu.t_ns[rows], path.t_ns, path.p_frame_in_world[:, 2]))


def slope_seen(walks: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Common slope (2,) m/m that rises show, each walk with a drift of its own, and its standard errors.

    Args:
        walks: Of each walk (K, 2) m, ways in the plane, and (K,) m, rises. Walks count by the scatter of their rises.
    """
    H, b = np.zeros((2, 2)), np.zeros(2)
    for way, rise in walks:
        A = way - way.mean(0)
        y = rise - rise.mean()
        residual = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
        variance = float(residual @ residual) / (len(y) - 3)
        H += A.T @ A / variance
        b += A.T @ y / variance
    return np.linalg.solve(H, b), np.sqrt(np.diag(np.linalg.inv(H)))


def measure(arguments: Namespace) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON.

    Raises:
        StrideTwinError: There are no recordings.
    """
    folder = data_folder()
    if folder is None:
        raise StrideTwinError("no recordings: set STRIDETWIN_DATA to the folder that holds foot_imu_vicon")
    cases, of_walks, true_rises, imu_rises = [], [], [], []
    for walk in load_vicon(folder):
        rows, places = find_rests(walk.imu.t_ns * 1e-9, walk.truth)
        if len(places) < 8:
            continue
        cases.append(_figures(f"vicon {walk.name}", places))
        of_walks.append(places)
        step = np.diff(places, axis=0)
        true_rises.append((step[:, :2], step[:, 2]))
        imu_rises.append((step[:, :2], rises_of_imu(walk, rows)))
    for foot in load_markers(folder):
        seen = np.isfinite(foot.heel).all(1)
        cases.append(_figures(f"dual_foot_walk {foot.name}", find_rests(foot.t[seen], foot.heel[seen])[1]))
    marked, seen_by_imu = slope_seen(true_rises), slope_seen(imu_rises)
    upright = [untilt(places, marked[0] - seen_by_imu[0]) for places in of_walks]
    for case, scatter in zip(cases, fit_unevenness([pairs(p) for p in upright])[1]):
        case["rest_to_rest_mm"] = 1e3 * float(scatter)
    summary = {
        "scatter_by_distance_mm": scatter_by_distance([pairs(p) for p in of_walks]),
        "scatter_without_tilt_mm": scatter_by_distance([pairs(p) for p in upright]),
        "unevenness_mm": _with_error([pairs(p) for p in of_walks]),
        "unevenness_without_tilt_mm": _with_error([pairs(p) for p in upright]),
        "slope_of_rests_mm_per_m": (1e3 * np.stack(marked)).tolist(),
        "slope_of_imu_mm_per_m": (1e3 * np.stack(seen_by_imu)).tolist(),
    }
    return {"experiment": "recorded_floors", "summary": summary, "paper": {}, "cases": cases}


def scatter_by_distance(walks: Sequence[Array]) -> list[float]:
    """Scatter of the heights of rests, mm, in each of `BINS_M`: the median of the walks, from their `pairs`."""
    each = np.full((len(walks), len(BINS_M) - 1), np.nan)
    for row, walk in zip(each, walks):
        for k, (low, high) in enumerate(pairwise(BINS_M)):
            inside = (walk[:, 0] >= low) & (walk[:, 0] < high)
            if inside.sum() >= LEAST_PAIRS:
                row[k] = 1e3 * np.sqrt(walk[inside, 1].mean())
    return [float(v) for v in np.nanmedian(each, axis=0)]


def _with_error(walks: Sequence[Array]) -> list[float]:
    """Unevenness, its standard error, and the scatter from rest to rest, mm."""
    rng = np.random.default_rng(0)
    drawn = [fit_unevenness([walks[i] for i in rng.integers(len(walks), size=len(walks))])[0] for _ in range(_DRAWS)]
    unevenness, scatter = fit_unevenness(walks)
    return [1e3 * unevenness, 1e3 * float(np.std(drawn)), 1e3 * float(np.median(scatter))]


def _figures(name: str, places: Array) -> dict[str, Any]:
    slope, above = fit_plane(places)
    return {
        "recording": name,
        "rests": len(places),
        "scatter_mm": 1e3 * float(places[:, 2].std()),
        "slope_mm_per_m": (1e3 * slope).tolist(),
        "about_plane_mm": 1e3 * float(np.sqrt(above @ above / max(len(above) - 3, 1))),
    }


def show(result: dict[str, Any]) -> None:
    """One line per recording, and what all together show."""
    titles = ("scatter, mm", "slope x, y, mm/m", "about plane, mm", "rest to rest, mm")
    print(f"{'recording':32}{'rests':>6}" + "".join(f"{title:>18}" for title in titles))
    for case in result["cases"]:
        slope = "".join(f"{value:8.1f}" for value in case["slope_mm_per_m"])
        row = f"{case['recording']:32}{case['rests']:6d}{case['scatter_mm']:18.1f}{slope:>18}"
        print(f"{row}{case['about_plane_mm']:18.1f}{case.get('rest_to_rest_mm', np.nan):18.1f}")
    summary = result["summary"]
    ranges = ", ".join(f"{low:g}-{high:g} m" for low, high in pairwise(BINS_M))
    for name in ("scatter_by_distance_mm", "scatter_without_tilt_mm"):
        print(f"{name} ({ranges}): " + ", ".join(f"{v:.1f}" for v in summary[name]))
    for name in ("unevenness_mm", "unevenness_without_tilt_mm"):
        print("{}: {:.1f} +- {:.1f}, beside {:.1f} from rest to rest".format(name, *summary[name]))
    for name in ("slope_of_rests_mm_per_m", "slope_of_imu_mm_per_m"):
        (x, y), (sd_x, sd_y) = summary[name]
        print(f"{name}: x {x:.1f} +- {sd_x:.1f}, y {y:.1f} +- {sd_y:.1f}")


def main() -> int:
    """Command line."""
    return answer(command(__doc__), measure, show)


if __name__ == "__main__":
    sys.exit(main())
