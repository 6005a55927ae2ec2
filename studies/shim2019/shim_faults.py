"""Contact terrain under injected faults, on a stair and a ramp of Shim et al. 2019.

Measurement errors change the geometry that the estimator reads. A manner of walking and the actuation modules need a
walk of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.contact_terrain import UNKNOWN, ContactTerrain, Exoskeleton
from stridetwin.outputs.steps.scores import ScoredStep, false_steps, percent, score_steps, step_figures
from stridetwin.scenarios.exo_geometry import geometry, measured
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import Exo, TwinConfig
from stridetwin.sim.faults.sample_faults import DeadCell, Dropout
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.anthropometry import PEOPLE
from stridetwin.streams.samples import Ahrs, Encoder, Footprint, Insole, Sample
from stridetwin.studies.case import Case
from stridetwin.studies.fault_injection import InjectedFault, Samples, by_fault, changed, fault_table
from stridetwin.studies.shim2019.shim_table5 import SENSORS, subject, walked
from stridetwin.studies.walks import falls

WALKS = ("shim_stairs", "shim_ramp_6")
SEEDS = range(1000, 1007)
AT_S = 6.0
"""Start of the faults that are not present from the start, s: in the approach to stair or ramp."""
LOADED_MPS = 1.0
"""Walking speed with all four modules; without them 1.2 m/s."""


def _insole(offset_n: Callable[[float], float]) -> Callable[[Samples], Samples]:
    """The left insole's cells have an offset, N, as a function of time, s."""
    return changed(lambda s: replace(s, force=s.force + offset_n(1e-9 * s.t_ns)), kinds=Insole, topic="/foot_l/insole")


def _encoder(offset_deg: float, from_s: float) -> Callable[[Samples], Samples]:
    """The left knee's encoder has an offset from an instant on."""

    def change(s: Encoder) -> Encoder:
        return replace(s, angle=s.angle + math.radians(offset_deg)) if s.t_ns >= from_s * 1e9 else s

    return changed(change, kinds=Encoder, topic="/exo/knee_l/encoder")


_YAW_DRIFT = {"back": 1.0, "thigh_l": -1.0, "thigh_r": 0.6, "foot_l": 0.8, "foot_r": -0.8}
"""Degrees per minute: ten times the paper's, different for each AHRS."""


def _yaw_drift(s: Ahrs) -> Ahrs:
    yaw = math.radians(_YAW_DRIFT[s.topic.split("/")[2]]) / 60.0 * 1e-9 * s.t_ns
    q = Rotation.from_rotvec([0.0, 0.0, yaw]) * Rotation.from_quat(s.q_world_sensor, scalar_first=True)
    return replace(s, q_world_sensor=q.as_quat(scalar_first=True))


def _lossy(samples: Samples) -> Samples:
    rng = np.random.default_rng(0)
    return (s for s in samples if rng.random() >= 0.05)


def _rotated_foot(exo: Exoskeleton) -> Exoskeleton:
    """The nominal mount of the left foot's AHRS is 2° off about the foot's lateral axis: an error in pitch."""
    leg = exo.legs["l"]
    rotation = Rotation.from_rotvec(math.radians(2.0) * leg.sole.T_foot_sole[:3, 1]).as_matrix()
    foot = replace(leg.foot, R_frame_sensor=rotation @ leg.foot.R_frame_sensor)
    return replace(exo, legs={**exo.legs, "l": replace(leg, foot=foot)})


def _long_thigh(exo: Exoskeleton) -> Exoskeleton:
    """The nominal left thigh is 10 mm longer than the true one."""
    leg = exo.legs["l"]
    rows = list(leg.rows)
    rows[leg.knee.frame - 1] = replace(rows[leg.knee.frame - 1], a=rows[leg.knee.frame - 1].a + 0.010)
    return replace(exo, legs={**exo.legs, "l": replace(leg, rows=tuple(rows))})


def _shuffling(config: TwinConfig) -> TwinConfig:
    return replace(config, gait=replace(config.gait, shuffle=1.0))


def _with_modules(config: TwinConfig) -> TwinConfig:
    """The modules, 6 kg on hips and thighs, and a lower walking speed."""
    return replace(config, exo=Exo(mode=1, drive="assist"), gait=replace(config.gait, speed_mps=LOADED_MPS))


_HEEL, _TOE = "heel", "toe"
FAULTS = {
    "none": InjectedFault(words="no fault"),
    "heel_dead": InjectedFault(
        words="heel cell of the left insole dead", faults=(DeadCell(topic="/foot_l/insole", cell=_HEEL, at_s=0.0),)
    ),
    "toe_stuck": InjectedFault(
        words="toe cell of the left insole stuck",
        faults=(DeadCell(topic="/foot_l/insole", cell=_TOE, at_s=AT_S, stuck=True),),
    ),
    "insole_drift": InjectedFault(
        words="left insole drifts 3 N/s, up to 60 N", samples=_insole(lambda t_s: min(3.0 * t_s, 60.0))
    ),
    "insole_low": InjectedFault(words="left insole's zero 3 N low", samples=_insole(lambda t_s: -3.0)),
    "encoder_offset": InjectedFault(words="left encoder 2° off", samples=_encoder(2.0, 0.0)),
    "encoder_slip": InjectedFault(words="left encoder slips 2° on the way", samples=_encoder(2.0, AT_S)),
    "yaw_drift": InjectedFault(words="AHRS yaw drifts 1°/min", samples=changed(_yaw_drift, kinds=Ahrs)),
    "mount_2deg": InjectedFault(words="left foot's AHRS mount 2° off in the geometry", calibration=_rotated_foot),
    "ahrs_dead": InjectedFault(words="left thigh's AHRS dead", faults=(Dropout(topic="/exo/thigh_l/ahrs", at_s=AT_S),)),
    "link_10mm": InjectedFault(words="left thigh 10 mm too long in the geometry", calibration=_long_thigh),
    "lost_5pct": InjectedFault(words="5 % of all packets lost", samples=_lossy),
    "shuffle": InjectedFault(words="shuffling gait", walk=_shuffling),
    "mode_1": InjectedFault(words="actuation modules of mode 1", walk=_with_modules),
}
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
            own = fault.walk(config)
            which = "" if own == config else name
            if which not in walks:
                twin = Twin(own, case.seed)
                walks[which] = twin, *walked(twin)
            twin, samples, footprints = walks[which]
            exo = measured(geometry(twin.size, twin.rig), np.random.default_rng([case.seed, 4]))
            faulty = fault.inject(samples, twin.rig, case.seed, twin.duration_s)
            estimates = ContactTerrain(twin.rig, exoskeleton=fault.calibration(exo)).run(faulty)
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
    words = {name: fault.words for name, fault in FAULTS.items()}
    return [
        f"{len(result['cases'])} subjects on {' and '.join(WALKS)}",
        falls(result["cases"]),
        *fault_table(words, result["summary"], _COLUMNS, 46),
    ]
