"""Fault studies: a recorded walk is replayed once per fault, and a table has one line per fault."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from stridetwin.sim.faults.faults import Fault, FaultPlan, check_faults
from stridetwin.streams.rig import Rig
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.result import Collected, FaultRow, FiguresT, NoPaper, SummaryT


def fault_plans(
    case: ExperimentCase, rig: Rig, duration_s: float, times: Callable[[Fault], Iterable[Fault]] = lambda fault: [fault]
) -> dict[str, FaultPlan]:
    """The faults of a case in one of its walks, by label.

    Args:
        case: The case.
        rig: Of the walk.
        duration_s: Of the walk.
        times: From a fault of the study to the faults that happen in this walk, such as the same one at several times;
            by default the fault itself.

    Raises:
        ConfigError: A fault matches no sensor of the rig.
    """
    assert case.setup is not None
    plans = {}
    for label, faults_of_label in case.setup.faults.items():
        faults = tuple(timed_fault for fault in faults_of_label for timed_fault in times(fault))
        check_faults(label, faults, rig)
        plans[label] = FaultPlan.of(faults, rig, case.seed, duration_s)
    return plans


def summarize_by_fault(
    results: Sequence[FaultRow[FiguresT]], figures: Callable[[list[FiguresT]], SummaryT]
) -> Collected[dict[str, SummaryT], NoPaper]:
    """Summary of a fault study by fault, and an empty `paper`, because no paper has faults.

    Args:
        results: Rows of all cases, each with `faults`: label to a result.
        figures: From the results of one fault in all cases to its figures.
    """
    labels = results[0]["faults"]  # the same in all cases
    # for each label, `figures` gets what all cases have under it
    return {"summary": {label: figures([r["faults"][label] for r in results]) for label in labels}, "paper": {}}
