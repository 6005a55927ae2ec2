"""Visual-inertial odometry under injected faults.

A fault is tolerated (`borne`) if the drift is at most three times that without fault, or if the odometry reports that
it is lost and is healthy again at the end.
"""

from __future__ import annotations

from stridetwin.batch.jobs import Row
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.fault_injection import fault_plans, summarize_by_fault
from stridetwin.studies.result import Collected, FaultRow, Figures, NoPaper
from stridetwin.studies.walks import record_walk
from stridetwin.studies.zhao2023 import odometry_walks

ESTIMATORS = ("dvio",)
"""Estimators whose parameters `--set` changes here."""

DRIFT_RATIO = 3.0
"""A fault is tolerated up to this ratio of the drift to that without fault."""
# figures of which the means over walks are given
_FIGURES: tuple[odometry_walks.FigureName, ...] = (*odometry_walks.FIGURES, "unhealthy_s", "nees_within_95_pct")
NO_FAULT = "no fault"
"""Label of the walk without fault in the experiment's file."""


def run_case(case: ExperimentCase, make: odometry_walks.Maker = odometry_walks.make_odometer) -> Row:
    """Runs the odometry on one recorded walk with each fault.

    Args:
        case: With one walk.
        make: Makes the odometry from its name, the rig that it gets, and the mount of the camera.

    Returns:
        The case's row with `faults`: label of the fault to drift, failure and time (`odometry_walks.score_odometry`).
    """
    (walk,) = case.walks()
    mount = walk.config.rig_mount
    figures_of_fault = {}
    with record_walk(walk, case) as recording:
        truth = odometry_walks.true_path(recording, mount)
        for label, plan in fault_plans(case, recording.rig, recording.duration).items():
            samples = plan.samples(odometry_walks.odometry_samples(recording, mount))
            run = odometry_walks.run_odometry(make("proposed", plan.rig, mount), samples)
            figures_of_fault[label] = odometry_walks.score_odometry(run, truth)
    return case.row(faults=figures_of_fault)


def collect(results: list[FaultRow[odometry_walks.OdometryFigures]]) -> Collected[dict[str, Figures], NoPaper]:
    """Means by fault over the walks; `borne` counts the walks whose odometry tolerates the fault."""
    nominal = [r["faults"][NO_FAULT] for r in results]  # of each case, the figures without fault

    def fault_figures(walks: list[odometry_walks.OdometryFigures]) -> Figures:
        """Figures of one fault over the walks, which are in the order of `nominal`."""
        return {
            **{figure: odometry_walks.mean(walks, figure) for figure in _FIGURES},
            "failures": sum(bool(w["failure"]) for w in walks),
            "borne": sum(map(_is_tolerated, walks, nominal)),
            "time_ms": odometry_walks.summarize_time(walks),
        }

    return summarize_by_fault(results, fault_figures)


def _is_tolerated(walk: odometry_walks.OdometryFigures, nominal: odometry_walks.OdometryFigures) -> bool:
    """Whether the odometry recovers after a loss, or drifts at most `DRIFT_RATIO` times as far as without fault.

    Args:
        walk: Figures of a walk with the fault.
        nominal: Those of the same walk without fault.
    """
    if walk["failure"] == "lost":  # it has reported the loss itself
        return bool(walk["recovered"])
    # any other failure went unreported; without a nominal drift there is nothing to compare with
    if walk["failure"] or "loop_drift_m" not in nominal:
        return False
    return bool(walk["loop_drift_m"] <= DRIFT_RATIO * nominal["loop_drift_m"])
