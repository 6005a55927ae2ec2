"""A walk that is told again and again, each time later."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from stridetwin.streams.samples import Sample


def again(read: Callable[[], Iterable[Sample]], times: int, span_ns: int) -> Iterator[tuple[int, Sample]]:
    """Which repetition, and its samples.

    Args:
        read: Begins the walk's samples anew.
        times: How often.
        span_ns: From one walk to the next.
    """
    for turn in range(times):
        for sample in read():
            yield turn, replace(sample, t_ns=sample.t_ns + turn * span_ns)
