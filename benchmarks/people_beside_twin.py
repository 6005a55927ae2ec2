"""Height drift, clipping, consistency and stair heights of the foot INS: recorded walks beside walks of the twin.

`python -m benchmarks.people_beside_twin [--json] [--cache DIR] [--workers 2] [--seed 1] [--walks 30] [--data DIR]`.
People and twin are the walks of `benchmarks.transfer`, whose seeds and cache it shares. The figures of the stances are
those of `benchmarks.reality`, in which each floor is new; the rest is of the filter as it is used, without calibration.
docs/transfer.md has the results.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks import reality, transfer
from benchmarks.command import answer
from benchmarks.consistency import nees
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.streams.samples import Array

STAIR_M, LEVEL_M = 0.08, 0.03  # a stride rises at least, and at most, by this on a stair, and on level ground
CLIPPED_RADPS, CLIPPED_SHARE = 9.0, 0.99  # a rate beyond both, the second of the axis's greatest rate, is clipped
FIGURES = {
    "drift_pct": "height drift, each floor new, % of distance (size)",
    "step_mm": "height of a stride, each floor new, mm (median, size)",
    "tilt_deg": "tilt in stance against that at the first, °",
    "excess_force_mps2": "force in stance above that at rest, m/s²",
    "landing_mps": "vertical correction at landing, m/s (size)",
    "nis_standing": "NIS of zero velocity",
    "clipped_pct": "samples at the gyro's limit, %",
    "plane_within_95_pct": "plane within its 95 % bound, % of the time",
    "height_within_95_pct": "height within its 95 % bound, % of the time",
    "nees_plane": "NEES in the plane (2 if consistent)",
    "nees_height": "NEES in height (1 if consistent)",
    "level_stride_mm": "height error of a level stride, mm (RMS)",
    "stair_stride_mm": "height error of a stride on a stair, mm (RMS)",
}


def clipped_pct(rate: Array) -> float:
    """Share of the samples whose rate is at the limit of an axis, in percent.

    Args:
        rate: (N, 3) rad/s.
    """
    size = abs(rate)
    at_limit = (size > CLIPPED_RADPS) & (size >= CLIPPED_SHARE * size.max(axis=0))
    return 100.0 * float(at_limit.any(axis=1).mean())


def stride_height_errors(walk: transfer.FootWalk, spans: Sequence[tuple[int, int]], path: Array) -> dict[str, float]:
    """RMS error of the height of strides from one stance's middle to the next's, in mm, where there are such strides.

    Args:
        walk: With its truth.
        spans: First and last row of each stance.
        path: (N, 3) estimated positions, m.
    """
    middle = [(first + last) // 2 for first, last in spans]
    true_rise, rise = np.diff(walk.truth[middle, 2]), np.diff(path[middle, 2])
    kinds = {"level_stride_mm": abs(true_rise) < LEVEL_M, "stair_stride_mm": abs(true_rise) > STAIR_M}
    return {
        name: 1e3 * float(np.sqrt(np.mean((rise - true_rise)[rows] ** 2))) for name, rows in kinds.items() if rows.any()
    }


def figures_of(walk: transfer.FootWalk) -> dict[str, float]:
    """The `FIGURES` of one foot's walk; those of stairs are missing where it has none."""
    causes = reality.causes(walk.imu)
    estimate = FootIns().run(walk.imu)
    spans = reality.stances(walk.imu, estimate).spans
    return {
        "drift_pct": abs(causes["height_drift_pct"]),
        "step_mm": 1e3 * abs(causes["step_height_m"]),
        "tilt_deg": causes["stance_tilt_deg"],
        "excess_force_mps2": causes["stance_force_mps2"] - causes["rest_force_mps2"],
        "landing_mps": abs(causes["landing_correction_mps"]),
        "nis_standing": causes["nis_standing"],
        "clipped_pct": clipped_pct(walk.imu.columns["angular_rate"]),
        **{name: value for name, value in nees(estimate.trajectory, walk.truth).items() if name in FIGURES},
        **stride_height_errors(walk, spans, estimate.trajectory.p_frame_in_world),
    }


def quartiles(rows: Sequence[dict[str, float]], figure: str) -> dict[str, float]:
    """Quartiles of a figure over the walks that have it, and their number."""
    values = [row[figure] for row in rows if np.isfinite(row.get(figure, np.nan))]
    low, median, high = np.percentile(values, (25, 50, 75)) if values else (np.nan, np.nan, np.nan)
    return {"walks": len(values), "low": float(low), "median": float(median), "high": float(high)}


def measure(arguments: Namespace) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    people = [figures_of(walk) for walk in transfer.recorded_walks(arguments)]
    with transfer.workers(arguments) as run:
        jobs = transfer.twin_jobs(arguments.seed, arguments.walks)
        walks = [*run(partial(transfer.twin_walk, cause="", cache=arguments.cache), jobs)]
        twin = [*run(figures_of, walks)]
    cases = [
        {"figure": figure, "people": quartiles(people, figure), "twin": quartiles(twin, figure)} for figure in FIGURES
    ]
    return {"experiment": "people_beside_twin", "paper": {}, "cases": cases}


def show(result: dict[str, Any]) -> None:
    """One row per figure: quartiles of people and of the twin."""
    print(f"{'':58}{'people, quartiles (walks)':>34}{'twin':>34}")
    for case in result["cases"]:
        sides = [case[side] for side in ("people", "twin")]
        cells = [f"{s['low']:8.3f}{s['median']:9.3f}{s['high']:9.3f}  ({s['walks']:2d})" for s in sides]
        print(f"{FIGURES[case['figure']]:58}" + "".join(f"{cell:>34}" for cell in cells))


def main() -> int:
    """Command line."""
    return answer(transfer.parser_of_walks(__doc__), measure, show)


if __name__ == "__main__":
    sys.exit(main())
