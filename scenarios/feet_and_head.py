"""Every estimate of a recording, and what lies ahead: feet beside the head, in two processes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from stridetwin.scenarios.ahead import Ahead, look_ahead, odometry_of
from stridetwin.scenarios.estimates import estimates_of_feet, estimates_of_head, feet_see
from stridetwin.scenarios.evaluate import Estimate
from stridetwin.scenarios.odometry import feeds_odometry
from stridetwin.scenarios.processes import processes
from stridetwin.streams.recording import Recording


def all_estimates(recording: Recording, progress: Callable[[str, float], None]) -> tuple[list[Estimate], Ahead | None]:
    """What `estimates` gives, and `look_ahead` where there is an odometry that can lead it.

    Args:
        recording: Any.
        progress: Is told how far the look ahead is.
    """
    with ExitStack() as stack:
        feet: Callable[[], list[Estimate]] = partial(estimates_of_feet, recording)
        long = recording.is_mcap and feet_see(recording) and feeds_odometry(recording)
        if long:
            pool = stack.enter_context(processes(1))
            feet = pool.submit(_of_feet, recording.path, recording.lenient).result
        head = estimates_of_head(recording)
        odometry = odometry_of(recording, head)
        ahead = look_ahead(recording, odometry, progress) if odometry is not None else None
        return feet() + head, ahead


def _of_feet(path: Path, lenient: bool) -> list[Estimate]:
    return estimates_of_feet(Recording(path, lenient))
