"""The size of an experiment or a study, said before it starts: walks, estimates, and a rough time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta

from stridetwin.scenarios.cost import Cost, cost_of, scale_cost
from stridetwin.sim.config import TwinConfig

SAMPLED = 10
"""Cases whose walks are laid out for the time; the others are taken to be like them."""
# CPU time per second walked of one estimate, by camera and for the rest; and the time to start
_CPU_PER_S = {"head_camera": 0.5, "foot_camera": 0.2}
_OTHER_CPU_PER_S = 0.02
_START_CPU_S = 60.0
# An estimate of `run` on the walks of `cost`, the images decoded for it alone: two Zen 4 cores. At the start, the
# estimators are loaded, and compiled if they have changed.


@dataclass(frozen=True, kw_only=True)
class Size:
    """What a batch of walks takes.

    Attributes:
        walks: Number of walks; 0 if none is simulated.
        estimates: Number of estimates, one per estimator, walk and fault.
        walked_s: Time walked, s.
        cpu_s: CPU time of walks and estimates, s, without the start.
    """

    walks: int
    estimates: int
    walked_s: float
    cpu_s: float

    def describe(self, cases: int, workers: int = 1) -> str:
        """The size as text, such as `60 cases: 60 walks (1500 s), 120 estimates, roughly 0:50:00 with 1 process`.

        Args:
            cases: Number of cases.
            workers: Number of processes that share the time.
        """
        counted = f"{cases} case{'s' * (cases != 1)}"
        if not self.walks:
            return f"{counted}, {self.estimates} estimate{'s' * (self.estimates != 1)}"
        time = timedelta(seconds=round(_START_CPU_S + self.cpu_s / workers, -1))  # to 10 s
        processes = f"{workers} process{'es' * (workers != 1)}"
        walks = f"{self.walks} walk{'s' * (self.walks != 1)} ({self.walked_s:.0f} s)"
        return f"{counted}: {walks}, {self.estimates} estimates, roughly {time} with {processes}"


def size_of(sampled_configs: Sequence[Sequence[TwinConfig]], cases: int, estimates_per_walk: int) -> Size:
    """The size of a batch of cases, from the walks of some of them.

    Args:
        sampled_configs: The walks of each of some cases, at least one; empty lists if no body walks.
        cases: Number of cases in all.
        estimates_per_walk: Number of estimates of each walk.
    """
    configs = [config for of_case in sampled_configs for config in of_case]
    if not configs:
        return Size(walks=0, estimates=cases * estimates_per_walk, walked_s=0.0, cpu_s=0.0)
    # the other cases are taken to have as many walks as the sampled ones on average
    walks = round(cases * len(configs) / len(sampled_configs))
    cost: Cost = scale_cost(cost_of(configs), walks)  # time walked and CPU time of all walks, without estimates
    # CPU time of one estimate per second walked, for each sampled walk
    rates = [
        _OTHER_CPU_PER_S + sum(rate for group, rate in _CPU_PER_S.items() if group in config.sensors)
        for config in configs
    ]
    estimates_cpu_s = cost.walked_s * estimates_per_walk * sum(rates) / len(rates)
    return Size(
        walks=walks,
        estimates=walks * estimates_per_walk,
        walked_s=cost.walked_s,
        cpu_s=cost.cpu_s + estimates_cpu_s,
    )
