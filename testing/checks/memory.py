"""What an estimator keeps: a bounded amount of memory, no sample of the caller, and no change of one."""

from __future__ import annotations

import gc
import os
import tracemalloc
from pathlib import Path

import numpy as np

from stridetwin.estimators.base import Estimator
from stridetwin.streams.samples import Array, Odometry, Sample, copy_sample
from stridetwin.testing.samples import shift_sample
from stridetwin.testing.subject import ConformanceError, Subject, call_update, require_equal

_MOST_PASSES = 15
_LEAST_TRACED = 8_000
_LEAST_RESIDENT = 2_000_000
"""Growth per pass that counts, bytes: of Python's and NumPy's memory, and of the process, whose pages are larger."""
_STATM = Path("/proc/self/statm")


def check_leaves_sample(subject: Subject) -> None:
    """`update` does not change the arrays of the sample."""
    if subject.buffer_run.changed:
        raise ConformanceError(f"update changed {subject.buffer_run.changed}: copy an array before you change it")


def check_keeps_no_reference(subject: Subject) -> None:
    """The caller may reuse the arrays of a sample after `update`."""
    require_equal(
        subject.buffer_run.returned, subject.reference,
        "the estimates differ if the caller reuses the arrays of a sample after update; copy what you keep or return",
    )  # fmt: skip


def check_bounded_memory(subject: Subject) -> None:
    """Memory does not grow from pass to pass while the walk is fed again and again, time and way going on."""
    samples, duration_ns = _whole_seconds(subject.walk.samples)
    estimator = subject.create()
    _feed_pass(estimator, samples, duration_ns, 0)
    was_tracing = tracemalloc.is_tracing()
    if not was_tracing:
        tracemalloc.start()
    try:
        _feed_pass(estimator, samples, duration_ns, 1)
        traced, resident = _traced_bytes(), _resident_bytes()
        growth: list[int] = []
        python_grows, process_grows = True, bool(resident)
        for number in range(2, _MOST_PASSES):
            _feed_pass(estimator, samples, duration_ns, number)
            traced_before, resident_before = traced, resident
            traced, resident = _traced_bytes(), _resident_bytes()
            growth.append(max(traced - traced_before, 0))
            python_grows = python_grows and traced - traced_before > _LEAST_TRACED
            process_grows = process_grows and resident - resident_before > _LEAST_RESIDENT
            if not (python_grows or process_grows):
                return
    finally:
        if not was_tracing:
            tracemalloc.stop()
    where = f"{np.mean(growth) / 1000:.0f} kB of Python's memory" if python_grows else "several MB of the process"
    raise ConformanceError(
        f"memory grew in each of {_MOST_PASSES - 2} passes of the walk, by {where} per {len(samples)} samples: keep a "
        "window of constant length, such as collections.deque(maxlen=...)"
    )


def _whole_seconds(samples: tuple[Sample, ...]) -> tuple[tuple[Sample, ...], int]:
    """Samples of as many full seconds as there are, so that rates stay the same where one pass follows another.

    Returns:
        The samples, and their duration, ns.
    """
    first_ns = samples[0].t_ns
    duration_ns = max((samples[-1].t_ns - first_ns) // 10**9, 1) * 10**9
    return tuple(sample for sample in samples if sample.t_ns < first_ns + duration_ns), duration_ns


def _feed_pass(estimator: Estimator, samples: tuple[Sample, ...], duration_ns: int, number: int) -> None:
    """Feeds the samples of one pass: each `duration_ns` later than those of the one before, and farther on the way."""
    way = number * _way(samples)
    for sample in samples:
        call_update(estimator, copy_sample(shift_sample(sample, number * duration_ns, way)))


def _way(samples: tuple[Sample, ...]) -> Array:
    """(3,) m, horizontal translation between the first and the last pose; zero without poses."""
    poses = [sample for sample in samples if isinstance(sample, Odometry)]
    if not poses:
        return np.zeros(3)
    return (poses[-1].p_frame_in_world - poses[0].p_frame_in_world) * [1.0, 1.0, 0.0]


def _traced_bytes() -> int:
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


def _resident_bytes() -> int:
    """Resident memory of the process; 0 where the system does not provide it."""
    if not _STATM.exists():
        return 0
    return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
