"""Reorders samples of several streams by stamp, within a bounded delay."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator

from stridetwin.streams.live.receiver import Arrival
from stridetwin.streams.samples import Depth, Image, Imu, Sample


def rank_of(kind: type[Sample]) -> int:
    """Rank among samples of one instant: IMUs, which close an interval, then other small samples, then images."""
    return 0 if kind is Imu else 2 if kind in (Image, Depth) else 1


class Reorder:
    """Buffers samples until no older one can arrive, or the window has passed.

    A sample is released as soon as every stream has delivered one that is not older, or one stream is a window ahead of
    it, or it has waited for a window. A sample that arrives after newer ones were released follows at once and counts
    as late.

    Args:
        window_s: The window.

    Attributes:
        late: Number of late samples, by topic.
    """

    def __init__(self, window_s: float) -> None:
        self._window_ns = round(window_s * 1e9)
        self._held: list[tuple[tuple[int, int, str], int, Arrival]] = []
        self._newest: dict[str, int] = {}
        self._gone_ns = -1
        self._count = 0
        self.late: Counter[str] = Counter()

    def add(self, arrival: Arrival) -> None:
        """Adds a sample; stamps increase within a stream."""
        t_ns, topic = arrival.sample.t_ns, arrival.sample.topic
        if t_ns < self._gone_ns:
            self.late[topic] += 1
        self._newest[topic] = t_ns
        self._count += 1
        heapq.heappush(self._held, ((t_ns, rank_of(type(arrival.sample)), topic), self._count, arrival))

    def ready(self, now_ns: int) -> Iterator[Arrival]:
        """The released samples, in order.

        Args:
            now_ns: On the clock of `Arrival.since_ns`.
        """
        while self._held:
            t_ns, since_ns = self._held[0][0][0], self._held[0][2].since_ns
            passed = min(self._newest.values()) >= t_ns or max(self._newest.values()) - t_ns >= self._window_ns
            if not passed and now_ns - since_ns < self._window_ns:
                return
            yield self._pop()

    def rest(self) -> Iterator[Arrival]:
        """All buffered samples, in order."""
        while self._held:
            yield self._pop()

    def due_s(self, now_ns: int) -> float | None:
        """Seconds until the oldest sample is released; None if the buffer is empty."""
        return max(0.0, (self._held[0][2].since_ns + self._window_ns - now_ns) * 1e-9) if self._held else None

    def _pop(self) -> Arrival:
        arrival = heapq.heappop(self._held)[2]
        self._gone_ns = max(self._gone_ns, arrival.sample.t_ns)
        return arrival
