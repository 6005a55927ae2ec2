"""What an estimator keeps: a bounded amount of memory, no sample of the caller, and no change of one."""

from __future__ import annotations

import ctypes
import gc
import sys

import numpy as np

from stridetwin.estimators.base import AnyEstimator
from stridetwin.streams.samples import Array, Odometry, Sample, copy_sample
from stridetwin.testing.samples import shift_sample
from stridetwin.testing.subject import ConformanceError, Subject, call_update, require_equal

_MOST_PASSES = 15  # passes of the walk after which growth in every one of them is a failure
_LEAST_GROWTH = (60, 8_000)
"""Growth per pass that counts: Python's objects, and bytes of memory that arrays, libraries and compiled code hold."""


def check_leaves_sample(subject: Subject) -> None:
    """`update` does not change the arrays of the sample."""
    if subject.buffer_run.changed:
        raise ConformanceError(f"update changed {subject.buffer_run.changed}: copy an array before you change it")


def check_keeps_no_reference(subject: Subject) -> None:
    """The caller may reuse the arrays of a sample after `update`."""
    require_equal(
        subject.buffer_run.returned,
        subject.reference,
        "the estimates differ if the caller reuses the arrays of a sample after update; copy what you keep or return",
    )


def check_bounded_memory(subject: Subject) -> None:
    """Memory does not grow from pass to pass while the walk is fed again and again, time and way going on."""
    samples, duration_ns = _whole_seconds(subject.walk.samples)
    estimator = subject.create()
    sizes: list[tuple[int, int]] = []  # after each pass: Python's objects, and bytes beside them
    gc.freeze()  # so that collecting costs no time for all that there was before
    try:
        for number in range(_MOST_PASSES):
            _feed_pass(estimator, samples, duration_ns, number)
            gc.collect()
            sizes.append((sys.getallocatedblocks(), _count_allocated_bytes()))
            # (passes - 2, 2) growth of both sizes from pass to pass; that from the first pass to the second is left
            # out, because windows are still being filled
            growth = np.diff(sizes, axis=0)[1:]
            # neither objects nor bytes have grown by more than `_LEAST_GROWTH` in every pass so far: memory is bounded
            if len(growth) and not (growth > _LEAST_GROWTH).all(axis=0).any():
                return
    finally:
        gc.unfreeze()
    objects, n_bytes = growth.mean(axis=0)
    raise ConformanceError(
        f"memory grew in each of {len(growth)} passes of the walk, by {objects:.0f} objects and {n_bytes / 1000:.0f} "
        f"kB of arrays per {len(samples)} samples: keep a window of constant length, such as "
        "collections.deque(maxlen=...)"
    )


def _whole_seconds(samples: tuple[Sample, ...]) -> tuple[tuple[Sample, ...], int]:
    """Samples of the largest whole number of seconds, so that rates do not change where one pass follows another.

    Returns:
        The samples, and their duration, ns.
    """
    first_ns = samples[0].t_ns
    duration_ns = max((samples[-1].t_ns - first_ns) // 10**9, 1) * 10**9
    return tuple(sample for sample in samples if sample.t_ns < first_ns + duration_ns), duration_ns


def _feed_pass(estimator: AnyEstimator, samples: tuple[Sample, ...], duration_ns: int, number: int) -> None:
    """Feeds the samples of one pass, as if the walk went on: later and farther than those of the pass before.

    Args:
        estimator: The estimator.
        samples: Samples of one pass.
        duration_ns: Added to the stamps once per earlier pass.
        number: Number of the pass, from 0.
    """
    translation = number * _translation_of_pass(samples)
    for sample in samples:
        call_update(estimator, copy_sample(shift_sample(sample, number * duration_ns, translation)))


def _translation_of_pass(samples: tuple[Sample, ...]) -> Array:
    """(3,) m, horizontal translation from the first pose of the samples to the last one; zero without poses."""
    poses = [sample for sample in samples if isinstance(sample, Odometry)]
    if not poses:
        return np.zeros(3)
    return (poses[-1].p_frame_in_world - poses[0].p_frame_in_world) * [1.0, 1.0, 0.0]


class _HeapInfo(ctypes.Structure):
    """The answer of the C library's `mallinfo2`."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in (
            "arena",
            "ordblks",
            "smblks",
            "hblks",
            "hblkhd",
            "usmblks",
            "fsmblks",
            "uordblks",
            "fordblks",
            "keepcost",
        )
    )


def _count_allocated_bytes() -> int:
    """Memory that the process holds beside Python's small objects; 0 where the C library is not the GNU one."""
    ask = getattr(ctypes.CDLL(None), "mallinfo2", None)
    if ask is None:
        return 0
    ask.restype = _HeapInfo
    heap = ask()
    return int(heap.uordblks + heap.hblkhd)  # allocated blocks, and memory-mapped ones
