"""Contact terrain under injected faults, on a stair and a ramp of Shim et al. 2019.

Measurement errors change the geometry that the estimator reads. A manner of walking and the actuation modules need a
walk of their own.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from stridetwin.estimators.contact_terrain import UNKNOWN, ContactTerrain
from stridetwin.outputs.steps.scores import ScoredStep, false_steps, percent, score_steps, step_figures
from stridetwin.scenarios.exo_geometry import nominal_geometry
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import Exo, TwinConfig
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.anthropometry import PEOPLE
from stridetwin.streams.samples import Footprint, Sample
from stridetwin.studies.case import Case
from stridetwin.studies.fault_injection import by_fault, fault_table, read_cases
from stridetwin.studies.shim2019.shim_table5 import SENSORS, subject, walked
from stridetwin.studies.walks import falls

WALKS = ("shim_stairs", "shim_ramp_6")
SEEDS = range(1000, 1007)
FAULTS = read_cases(__file__)


def walk_of(name: str, config: TwinConfig) -> TwinConfig:
    """The walk of a case: shuffling, or with the modules (6 kg on hips and thighs) at 1.0 m/s instead of 1.2 m/s."""
    if name == "shuffle":
        return replace(config, gait=replace(config.gait, shuffle=1.0))
    if name == "mode_1":
        return replace(config, exo=Exo(mode=1, drive="assist"), gait=replace(config.gait, speed_mps=1.0))
    return config


_COLUMNS = (
    ("slope °", 9, "{slope_rmse_deg:.2f}"),
    ("most", 7, "{slope_max_deg:.1f}"),
    ("elev. mm", 10, "{elevation_rmse_mm:.1f}"),
    ("most", 7, "{elevation_max_mm:.0f}"),
    ("in 95 %", 12, "{slope_in_95_pct:>6.0f}{elevation_in_95_pct:>6.0f}"),
    ("class %", 9, "{classification_accuracy_pct:.1f}"),
    ("unknown", 9, "{unknown_pct:.1f}"),
    ("wrong", 7, "{wrong_pct:.1f}"),
    ("steps", 7, "{steps}"),
    ("missed", 8, "{steps_missed}"),
    ("false", 7, "{false_steps}"),
)


def run_case(case: Case) -> dict[str, Any]:
    """One subject's walks, with each fault.

    Returns:
        `seed`, `physics`, `subject`, `fell`, `faults`: name to the rows of all steps; and `false_steps`: name to the
        number of estimated steps that did not happen.
    """
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in FAULTS}
    false = dict.fromkeys(FAULTS, 0)
    fell = []
    for scenario in WALKS:
        person = PEOPLE[f"shim_s{subject(case.seed)}"]
        config = replace(load_scenario(scenario).config, sensors=SENSORS, physics=case.physics, person=person)
        walks: dict[str, tuple[Twin, list[Sample], list[Footprint]]] = {}
        for name, fault in FAULTS.items():
            own = walk_of(name, config)
            which = "" if own == config else name
            if which not in walks:
                twin = Twin(own, case.seed)
                walks[which] = twin, *walked(twin)
            twin, samples, footprints = walks[which]
            plan = fault.plan(twin.rig, case.seed, twin.duration_s)
            exo = nominal_geometry(twin.size, plan.rig, case.seed, fault.faults)
            estimates = ContactTerrain(plan.rig, exoskeleton=exo).run(plan.samples(samples))
            found[name] += [s.row() for s in score_steps(footprints, estimates)]
            false[name] += false_steps(footprints, estimates)
            if twin.fell_at is not None:
                fell.append(f"{scenario} {name}")
    return case.row(subject=subject(case.seed), fell=fell, faults=found, false_steps=false)


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """By fault, over the steps of all walks: errors, coverage and classes."""
    collected = by_fault(FAULTS, results, lambda cases: _figures([ScoredStep(**row) for rows in cases for row in rows]))
    for name, figures in collected["summary"].items():
        figures["false_steps"] = sum(r["false_steps"][name] for r in results)
    return collected


def _figures(steps: list[ScoredStep]) -> dict[str, float]:
    seen = [s for s in steps if s.seen]
    return {
        **step_figures(steps, []),
        "slope_max_deg": max((abs(math.degrees(s.slope_error)) for s in seen), default=0.0),
        "elevation_max_mm": max((abs(1e3 * s.elevation_error) for s in seen), default=0.0),
        "unknown_pct": percent(s.estimated_mode == UNKNOWN for s in steps),
        "wrong_pct": percent(s.seen and s.estimated_mode not in (s.mode, UNKNOWN) for s in steps),
    }


def table(result: dict[str, Any]) -> list[str]:
    """As lines of text; classes are % of all steps, including those without estimate because a sensor is missing."""
    return [
        f"{len(result['cases'])} subjects on {' and '.join(WALKS)}",
        falls(result["cases"]),
        *fault_table(FAULTS, result["summary"], _COLUMNS, 46),
    ]
