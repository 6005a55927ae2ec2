"""Contact terrain under injected faults. Measurement errors change the geometry that the estimator reads."""

from __future__ import annotations

import math

from stridetwin.batch.jobs import Row
from stridetwin.estimators.base import PROPOSED
from stridetwin.estimators.contact_terrain import UNKNOWN, ContactTerrain
from stridetwin.outputs.parameters import parameter_keywords
from stridetwin.outputs.steps.scores import ScoredStep, StepRow, false_steps, percent, score_steps, step_figures
from stridetwin.scenarios.exo_geometry import nominal_geometry
from stridetwin.sim.twin import Twin
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.fault_injection import fault_plans, summarize_by_fault
from stridetwin.studies.result import Collected, FaultRow, NoPaper
from stridetwin.studies.shim2019.shim_table5 import simulate_walk

ESTIMATORS = ("contact_terrain",)
"""Estimators whose parameters `--set` changes here."""

USUAL = "usual"
"""The usual manner of walking; only on its walks faults are injected."""


class ShimFaultRow(FaultRow[list[StepRow]]):
    """The row of a case; `faults` has the rows of the steps by label of the fault, or by manner of walking.

    Attributes:
        false_steps: By the same labels, the number of estimated steps that did not happen.
    """

    false_steps: dict[str, int]


def run_case(case: ExperimentCase) -> Row:
    """One subject's walks: the usual manner of walking with each fault, any other manner without.

    Returns:
        The case's row with `fell`, `faults`: label of the fault or the manner to the rows of all steps; and
        `false_steps`: label to the number of estimated steps that did not happen.
    """
    rows_of_fault: dict[str, list[StepRow]] = {}
    false_counts: dict[str, int] = {}
    fell = []
    for walk in case.walks():
        twin = Twin(walk.config, case.seed)
        samples, footprints = simulate_walk(twin)
        manner = walk.labels["manner"]
        plans = fault_plans(case, twin.rig, twin.duration_s)
        if manner != USUAL:
            plans = {manner: next(iter(plans.values()))}  # the file's first entry is without fault
        for label, plan in plans.items():
            # the geometry as measured, with the errors that faults add to the measurement
            faults = [fault for fault, _ in plan.planned]  # without their events
            exo = nominal_geometry(twin.size, plan.rig, case.seed, faults)
            estimator = ContactTerrain(plan.rig, exoskeleton=exo, **parameter_keywords(ContactTerrain, PROPOSED))
            estimates = estimator.run(plan.samples(samples))
            rows_of_fault.setdefault(label, []).extend(s.row() for s in score_steps(footprints, estimates))
            false_counts[label] = false_counts.get(label, 0) + false_steps(footprints, estimates)
        if twin.fell_at is not None:
            fell.append(f"{walk.config.name} {manner}")
    return case.row(fell=fell, faults=rows_of_fault, false_steps=false_counts)


def collect(results: list[ShimFaultRow]) -> Collected[dict[str, dict[str, float]], NoPaper]:
    """Summary by fault over the steps of all walks: errors, coverage, classes, and steps that did not happen."""
    # `cases`: for one fault, the rows of the steps of each case
    collected = summarize_by_fault(
        results, lambda cases: _step_figures([ScoredStep(**row) for rows in cases for row in rows])
    )
    for name, figures in collected["summary"].items():
        figures["false_steps"] = sum(r["false_steps"][name] for r in results)
    return collected


def _step_figures(steps: list[ScoredStep]) -> dict[str, float]:
    """Figures of `step_figures` under one fault, with largest errors and shares of unknown and wrong classes."""
    matched = [s for s in steps if s.is_matched]  # steps with an estimate
    return {
        **step_figures(steps, []),
        "slope_max_deg": max((abs(math.degrees(s.slope_error)) for s in matched), default=0.0),
        "elevation_max_mm": max((abs(1e3 * s.elevation_error) for s in matched), default=0.0),
        "unknown_pct": percent(s.estimated_mode == UNKNOWN for s in steps),
        "wrong_pct": percent(s.is_matched and s.estimated_mode not in (s.mode, UNKNOWN) for s in steps),
    }
