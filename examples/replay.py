"""A recording in place of hardware: its samples at the pace at which they were taken."""

import time
from collections.abc import Iterator, Sequence

from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Sample


def paced(recording: Recording, topics: Sequence[str], speed: float) -> Iterator[Sample]:
    """Samples of the topics that the recording has, each when it is due."""
    start_ns, first_ns = time.monotonic_ns(), None
    for sample in recording.samples([t for t in topics if t in recording.topics]):
        first_ns = sample.t_ns if first_ns is None else first_ns
        due_ns = start_ns + (sample.t_ns - first_ns) / speed
        time.sleep(max(0.0, (due_ns - time.monotonic_ns()) * 1e-9))
        yield sample
