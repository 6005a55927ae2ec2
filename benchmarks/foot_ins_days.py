"""Whether the one-foot filter's parameters are overfitted to the walks on which they were chosen.

`python -m benchmarks.foot_ins_real --days`. The walks of each day are left out in turn: on those of the other days, the
parameters of `START` are tuned from round values by coordinate search, and scored on the day left out, beside the
values in `FootInsParameters`. All other parameters keep their values there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from benchmarks.real_walks import ViconWalk, armse, spread
from stridetwin.estimators.foot_ins import FootIns, FootInsParameters

START = {  # typical orders of magnitude for a consumer sensor and a shoe
    "gyro_noise_radps_rthz": 0.003,
    "accel_noise_mps2_rthz": 0.003,
    "accel_motion_noise_per_rthz": 0.003,
    "lever_sd_m": 0.03,
    "stationary_speed_mps": 0.01,
    "stationary_level": 1000.0,
    "stationary_share": 0.01,
    "floor_sd_m": 0.01,
}
STEPS = (3.0, 3.0**0.5, 3.0**0.25)  # factors, one sweep each
BOUND = 10.0  # largest factor between a parameter and its start
THRIFT = 0.01  # share of the error that a factor of 3 in one parameter must gain, because a day has few walks


def errors(walks: Sequence[ViconWalk], parameters: FootInsParameters) -> list[float]:
    """2-D ARMSE of each walk, m."""
    return [armse(FootIns(parameters=parameters).run(w.imu).trajectory.p_frame_in_world, w.truth) for w in walks]


def tuned(walks: Sequence[ViconWalk]) -> dict[str, float]:
    """The parameters of `START` with the least mean error on some walks, which `THRIFT` holds near the start.

    Each in turn is changed by a factor, repeatedly while the cost decreases; the factor shrinks from sweep to sweep.
    """
    best = dict(START)
    least = _cost(walks, best)
    for factor in STEPS:
        for name in START:
            for step in (factor, 1.0 / factor):
                gained = False
                while abs(math.log(best[name] * step / START[name])) <= math.log(BOUND) * 1.001:
                    tried = best | {name: best[name] * step}
                    if (cost := _cost(walks, tried)) >= least:
                        break
                    best, least, gained = tried, cost, True
                if gained:
                    break
    return best


def _cost(walks: Sequence[ViconWalk], values: dict[str, float]) -> float:
    walk_errors = errors(walks, FootInsParameters(**values))
    moved = sum(math.log(values[name] / START[name], 3.0) ** 2 for name in START)
    return sum(walk_errors) / len(walk_errors) * (1.0 + THRIFT * moved)


def measure(walks: Sequence[ViconWalk]) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON: 2-D ARMSE in m, and the parameters tuned without each day."""
    days = sorted({day(w) for w in walks})
    sets = {left_out: tuned([w for w in walks if day(w) != left_out]) for left_out in days}
    unseen = {d: errors([w for w in walks if day(w) == d], FootInsParameters(**sets[d])) for d in days}
    return {
        "experiment": "foot_ins_days",
        "summary": {
            "fixed": spread(errors(walks, FootInsParameters())),
            "round_values": spread(errors(walks, FootInsParameters(**START))),
            "days_left_out": spread([error for day_errors in unseen.values() for error in day_errors]),
        },
        "cases": [{"day": d, "armse_m": unseen[d], "tuned_without": sets[d]} for d in days],
    }


def day(walk: ViconWalk) -> str:
    """The date in the name of its file, `2017-11-22-11-22-03`."""
    return walk.name[:10]
