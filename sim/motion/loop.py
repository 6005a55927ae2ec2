"""A short recording looped to a wanted length."""

from __future__ import annotations

from stridetwin.sim.motion.fit import FittedWalk
from stridetwin.streams.errors import ConfigError


def loop_walk(fitted: FittedWalk, duration_s: float, source: str) -> FittedWalk:
    """The walk, repeated until it lasts long enough."""
    raise ConfigError(source, "duration_s", duration_s, "nothing yet")
