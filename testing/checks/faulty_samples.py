"""Faulty samples: no exception, no number that is not finite, and estimates again when the fault is over."""

from __future__ import annotations

from stridetwin.testing.faults import FaultCase, inject
from stridetwin.testing.leaves import field_of
from stridetwin.testing.subject import ConformanceError, Subject, feed, skip


def check_fault(subject: Subject, case: FaultCase) -> None:
    """Checks an estimator on a walk with one kind of fault.

    Raises:
        ConformanceError: `update` raised an exception, returned a number that is not finite though it is finite without
            the fault, or returns nothing after the fault.
        SkipTest: The fault concerns no stream of the estimator.
    """
    faulty = inject(case, subject.walk.samples, subject.walk.rig)
    if faulty is None:
        raise skip("no stream of the estimator can have this fault")
    try:
        returned = feed(subject.create(), faulty.samples)
    except ConformanceError as error:
        raise ConformanceError(f"where {case.summary}, {error}: return None for samples that you cannot use") from error
    for one in returned:
        for leaf in one.leaves:
            # fields that are not finite even without the fault are left to the check of finite values
            if not leaf.is_finite and field_of(leaf) not in subject.fields_not_finite:
                raise ConformanceError(
                    f"where {case.summary}, {leaf.path or 'the estimate'} at {one.t_ns * 1e-9:.3f} s is not finite: "
                    "leave out such samples before they reach the state"
                )
    if not any(one.index >= faulty.over_at for one in returned):
        raise ConformanceError(
            f"where {case.summary}, update returns nothing more when it is over: leave the bad samples out and go on, "
            "or start anew"
        )
