"""Whether the one-foot filter's parameters are overfitted to the walks on which they were chosen.

`python -m benchmarks.foot_ins_real --halves`. The walks are split alternately into two halves. On each half, the
parameters of `START` are tuned from round values by coordinate search and scored on the other half, beside the values
in `FootInsParameters`. All other parameters keep their values there.
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


def errors(walks: Sequence[ViconWalk], parameters: FootInsParameters) -> list[float]:
    """2-D ARMSE of each walk, m."""
    return [armse(FootIns(parameters=parameters).run(w.imu).trajectory.p_frame_in_world, w.truth) for w in walks]


def tuned(walks: Sequence[ViconWalk]) -> dict[str, float]:
    """The parameters of `START` with the least mean error on some walks.

    Each in turn is changed by a factor, repeatedly while the error decreases; the factor shrinks from sweep to sweep.
    """
    best = dict(START)
    least = _mean(walks, best)
    for factor in STEPS:
        for name in START:
            for step in (factor, 1.0 / factor):
                gained = False
                while abs(math.log(best[name] * step / START[name])) <= math.log(BOUND) * 1.001:
                    tried = best | {name: best[name] * step}
                    if (mean := _mean(walks, tried)) >= least:
                        break
                    best, least, gained = tried, mean, True
                if gained:
                    break
    return best


def _mean(walks: Sequence[ViconWalk], values: dict[str, float]) -> float:
    found = errors(walks, FootInsParameters(**values))
    return sum(found) / len(found)


def measure(walks: Sequence[ViconWalk]) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON: 2-D ARMSE in m on each half and on both."""
    halves = {"even": walks[0::2], "odd": walks[1::2]}
    sets = {f"tuned_on_{name}": tuned(half) for name, half in halves.items()}

    def scored(parameters: FootInsParameters) -> dict[str, dict[str, float]]:
        return {name: spread(errors(half, parameters)) for name, half in halves.items()}

    summary = {name: scored(FootInsParameters(**values)) for name, values in sets.items()}
    unseen = [
        *errors(halves["odd"], FootInsParameters(**sets["tuned_on_even"])),
        *errors(halves["even"], FootInsParameters(**sets["tuned_on_odd"])),
    ]
    return {
        "experiment": "foot_ins_halves",
        "summary": summary
        | {"fixed": scored(FootInsParameters()) | {"all": spread(errors(walks, FootInsParameters()))}}
        | {"round_values": scored(FootInsParameters(**START))}
        | {"each_on_the_other_half": {"all": spread(unseen)}},
        "parameters": sets,
    }
