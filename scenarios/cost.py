"""Rough cost of walks, announced before they are simulated: seconds walked, size of the recordings, CPU time."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from datetime import timedelta

from stridetwin.sim.config import TwinConfig
from stridetwin.sim.world.route import lay_out

# MB and CPU seconds per second of walking, by group of cameras, and of everything else. They were measured with
# `generate` of 8 m of level ground with all sensors, with one camera and without any, on two Zen 4 cores; the walker
# stands for 2 s at both ends.
_MB_PER_S = {"head_camera": 7.7, "foot_camera": 0.3}
_REST_MB_PER_S = 0.45
_CPU_PER_S = {"head_camera": 0.85, "foot_camera": 0.25}
_REST_CPU_PER_S = 0.1
_START_CPU_S = 4.0  # CPU time of the start of the command
_DYNAMIC = 3.0  # factor on `_REST_CPU_PER_S` for `physics: dynamic`
_LONG_CPU_S = 60.0  # longer walks are announced


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Estimated cost of walks.

    Attributes:
        walks: Number of walks.
        walked_s: Time walked, s.
        size_mb: Size of the recordings, MB.
        cpu_s: CPU time, s, without the start of a process.
    """

    walks: int
    walked_s: float
    size_mb: float
    cpu_s: float

    @property
    def is_long(self) -> bool:
        """Whether the walks take a minute or more, so that a user wants to know beforehand."""
        return _START_CPU_S + self.cpu_s > _LONG_CPU_S

    def describe(self, workers: int = 1) -> str:
        """The cost as text, such as `3 walks: about 60 s of walking, 380 MB, 0:01:20 with 1 process`."""
        size = f"{self.size_mb / 1000:.1f} GB" if self.size_mb >= 1000 else f"{self.size_mb:.0f} MB"
        # a long time is rounded to ten seconds
        time = timedelta(seconds=round(_START_CPU_S + self.cpu_s / workers, -1 if self.is_long else 0))
        walks = f"{self.walks} walk{'s' * (self.walks != 1)}"
        names = f"{workers} process{'es' * (workers != 1)}"
        return f"{walks}: about {self.walked_s:.0f} s of walking, {size}, {time} with {names}"


def cost_of(configs: Iterable[TwinConfig]) -> Cost:
    """The estimated cost of walks: the time that the route takes at the gait's speed, times rates by sensor."""
    count, walked_s, size_mb, cpu_s = 0, 0.0, 0.0, 0.0
    for config in configs:
        # the route ends with its last segment; the walker also stands at both ends
        if config.motion is None:
            way_m = lay_out(config.route).way.segments[-1].s1
            seconds = way_m / config.gait.speed_mps + 2.0 * config.gait.stand_s
        elif config.motion.fitted_s is not None:
            seconds = config.motion.fitted_s
        else:
            from stridetwin.sim.motion.source import apply_motion  # MuJoCo, so imported when it is needed

            seconds = apply_motion(config)[1].duration_s
        count, walked_s = count + 1, walked_s + seconds
        size_mb += seconds * _rate(_MB_PER_S, _REST_MB_PER_S, config.sensors)
        other_cpu_per_s = _REST_CPU_PER_S * (_DYNAMIC if config.physics == "dynamic" else 1.0)
        cpu_s += seconds * _rate(_CPU_PER_S, other_cpu_per_s, config.sensors)
    return Cost(walks=count, walked_s=walked_s, size_mb=size_mb, cpu_s=cpu_s)


def scale_cost(cost: Cost, walks: int) -> Cost:
    """The cost of a number of walks, if each costs as much as the mean of those in `cost`."""
    factor = walks / cost.walks
    return Cost(walks=walks, walked_s=factor * cost.walked_s, size_mb=factor * cost.size_mb, cpu_s=factor * cost.cpu_s)


def _rate(by_group: dict[str, float], other_sensors: float, sensors: Collection[str]) -> float:
    """A quantity per second walked, MB or CPU seconds: the sum over the enabled cameras and everything else.

    Args:
        by_group: Quantity of each group of cameras.
        other_sensors: Quantity of everything else.
        sensors: Enabled groups of sensors.
    """
    return other_sensors + sum(rate for group, rate in by_group.items() if group in sensors)
