"""What contact terrain makes of faults: a stair and a ramp of Shim et al. 2019, walked once a manner, spoilt anew.

Faults of samples are those of `sim.faults`, or done to the samples of a walk; what is wrongly measured is done to the
geometry that the estimator is told. A manner of walking and the actuation modules need a walk of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from heapq import merge
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.contact_terrain import UNKNOWN, ContactTerrain, Exoskeleton
from stridetwin.scenarios.exo_geometry import geometry, measured
from stridetwin.scenarios.experiments.case import Case
from stridetwin.scenarios.experiments.shim_table5 import SENSORS, subject
from stridetwin.scenarios.experiments.spoilt import Samples, Spoilt
from stridetwin.scenarios.experiments.walks import falls
from stridetwin.scenarios.footprints import FOOTPRINTS
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.scenarios.step_scores import percent, step_figures
from stridetwin.scenarios.steps import ScoredStep, false_steps, score_steps
from stridetwin.sim.config import Exo, TwinConfig
from stridetwin.sim.people import PEOPLE
from stridetwin.sim.sample_faults import DeadCell, Dropout
from stridetwin.sim.twin import Twin
from stridetwin.streams.samples import Ahrs, Block, Encoder, Footprint, Insole, Sample

WALKS = ("shim_stairs", "shim_ramp_6")
SEEDS = range(1000, 1007)
AT_S = 6.0
"""When a fault begins that is not there from the start: in the approach to stair or ramp."""
LADEN_MPS = 1.0
"""How fast people walk with all four modules; without them 1.2 m/s."""


@dataclass(frozen=True, kw_only=True)
class Wrong(Spoilt):
    """One thing that goes wrong.

    Attributes:
        told: What the estimator is told of the exoskeleton.
        walk: How the walk itself differs.
    """

    told: Callable[[Exoskeleton], Exoskeleton] = lambda exo: exo
    walk: Callable[[TwinConfig], TwinConfig] = lambda config: config


@dataclass(frozen=True, kw_only=True, eq=False)
class _Walk:
    """A walk as it was sensed, before any fault; samples in order of time."""

    twin: Twin
    samples: list[Sample]
    footprints: list[Footprint]


def _drifting(newton_per_s: float, most: float) -> Callable[[Samples], Samples]:
    """The cells of the left insole creep."""

    def spoil(samples: Samples) -> Iterator[Sample]:
        for s in samples:
            if isinstance(s, Insole) and s.topic == "/foot_l/insole":
                s = replace(s, force=s.force + min(newton_per_s * 1e-9 * s.t_ns, most))
            yield s

    return spoil


def _zero_low(newton: float) -> Callable[[Samples], Samples]:
    """The cells of the left insole tell less than there is, and less than none in the air."""

    def spoil(samples: Samples) -> Iterator[Sample]:
        for s in samples:
            if isinstance(s, Insole) and s.topic == "/foot_l/insole":
                s = replace(s, force=s.force - newton)
            yield s

    return spoil


def _encoder_off(degrees: float, from_s: float) -> Callable[[Samples], Samples]:
    """The left knee's encoder tells more than there is, from an instant on."""

    def spoil(samples: Samples) -> Iterator[Sample]:
        for s in samples:
            if isinstance(s, Encoder) and s.topic == "/exo/knee_l/encoder" and s.t_ns >= from_s * 1e9:
                s = replace(s, angle=s.angle + math.radians(degrees))
            yield s

    return spoil


_YAW_DRIFT = {"back": 1.0, "thigh_l": -1.0, "thigh_r": 0.6, "foot_l": 0.8, "foot_r": -0.8}
"""Degrees a minute: ten times the paper's, each AHRS for itself."""


def _yawing(samples: Samples) -> Iterator[Sample]:
    for s in samples:
        if isinstance(s, Ahrs):
            turn = math.radians(_YAW_DRIFT[s.topic.split("/")[2]]) / 60.0 * 1e-9 * s.t_ns
            told = Rotation.from_rotvec([0.0, 0.0, turn]) * Rotation.from_quat(s.q_world_sensor, scalar_first=True)
            s = replace(s, q_world_sensor=told.as_quat(scalar_first=True))
        yield s


def _lossy(samples: Samples) -> Iterator[Sample]:
    rng = np.random.default_rng(0)
    return (s for s in samples if rng.random() >= 0.05)


def _turned_foot(exo: Exoskeleton) -> Exoskeleton:
    """The left foot's AHRS sits 2° about the foot's lateral axis from where it is told to: it errs in pitch."""
    leg = exo.legs["l"]
    turn = Rotation.from_rotvec(math.radians(2.0) * leg.sole.T_foot_sole[:3, 1]).as_matrix()
    foot = replace(leg.foot, R_frame_sensor=turn @ leg.foot.R_frame_sensor)
    return replace(exo, legs={**exo.legs, "l": replace(leg, foot=foot)})


def _long_thigh(exo: Exoskeleton) -> Exoskeleton:
    """The left thigh is told 10 mm longer than it is."""
    leg = exo.legs["l"]
    rows = list(leg.rows)
    rows[leg.knee.frame - 1] = replace(rows[leg.knee.frame - 1], a=rows[leg.knee.frame - 1].a + 0.010)
    return replace(exo, legs={**exo.legs, "l": replace(leg, rows=tuple(rows))})


def _shuffling(config: TwinConfig) -> TwinConfig:
    return replace(config, gait=replace(config.gait, shuffle=1.0))


def _with_modules(config: TwinConfig) -> TwinConfig:
    """Whoever carries 6 kg more on hips and thighs walks more slowly."""
    return replace(config, exo=Exo(mode=1, drive="assist"), gait=replace(config.gait, speed_mps=LADEN_MPS))


_HEEL, _TOE = "heel", "toe"
FAULTS = {
    "none": Wrong(words="nothing wrong"),
    "heel_dead": Wrong(
        words="heel cell of the left insole dead", faults=(DeadCell(topic="/foot_l/insole", cell=_HEEL, at_s=0.0),)
    ),
    "toe_stuck": Wrong(
        words="toe cell of the left insole stuck",
        faults=(DeadCell(topic="/foot_l/insole", cell=_TOE, at_s=AT_S, stuck=True),),
    ),
    "insole_drift": Wrong(words="left insole creeps 3 N/s, to 60 N", samples=_drifting(3.0, 60.0)),
    "insole_low": Wrong(words="left insole's zero 3 N low", samples=_zero_low(3.0)),
    "encoder_offset": Wrong(words="left encoder 2° off", samples=_encoder_off(2.0, 0.0)),
    "encoder_slip": Wrong(words="left encoder slips 2° on the way", samples=_encoder_off(2.0, AT_S)),
    "yaw_drift": Wrong(words="AHRS yaw drifts 1°/min", samples=_yawing),
    "mount_2deg": Wrong(words="left foot's AHRS told 2° off", told=_turned_foot),
    "ahrs_dead": Wrong(words="left thigh's AHRS dead", faults=(Dropout(topic="/exo/thigh_l/ahrs", at_s=AT_S),)),
    "link_10mm": Wrong(words="left thigh told 10 mm long", told=_long_thigh),
    "lost_5pct": Wrong(words="5 % of all packets lost", samples=_lossy),
    "shuffle": Wrong(words="shuffling gait", walk=_shuffling),
    "mode_1": Wrong(words="actuation modules of mode 1", walk=_with_modules),
}


def run_case(case: Case) -> dict[str, Any]:
    """One subject's walks, spoilt in every way.

    Returns:
        `seed`, `physics`, `subject`, `fell`, `faults`: name to the rows of all steps; and `false_steps`: name to how
        many were told that are none.
    """
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in FAULTS}
    false = dict.fromkeys(FAULTS, 0)
    fell = []
    for scenario in WALKS:
        config = replace(
            load_scenario(scenario).config,
            sensors=SENSORS,
            physics=case.physics,
            person=PEOPLE[f"shim_s{subject(case.seed)}"],
        )
        plain = _walked(config, case.seed)
        for name, wrong in FAULTS.items():
            own = wrong.walk(config)
            walk = plain if own == config else _walked(own, case.seed)
            steps, none = _steps(wrong, walk, case.seed)
            found[name] += [s.row() for s in steps]
            false[name] += none
            if walk.twin.fell_at is not None:
                fell.append(f"{scenario} {name}")
    return {
        "seed": case.seed,
        "physics": case.physics,
        "subject": subject(case.seed),
        "fell": fell,
        "faults": found,
        "false_steps": false,
    }


def _walked(config: TwinConfig, seed: int) -> _Walk:
    twin = Twin(config, seed)
    by_topic: dict[str, list[Sample]] = {}
    for item in (item for chunk in twin.blocks() for item in chunk):
        by_topic.setdefault(item.topic, []).extend(item if isinstance(item, Block) else (item,))
    sensed = (samples for topic, samples in by_topic.items() if not topic.startswith("/truth"))
    footprints = [s for s in by_topic[FOOTPRINTS] if isinstance(s, Footprint)]
    return _Walk(twin=twin, samples=list(merge(*sensed, key=lambda s: s.t_ns)), footprints=footprints)


def _steps(wrong: Wrong, walk: _Walk, seed: int) -> tuple[list[ScoredStep], int]:
    """The steps of a walk as they are told with one fault, and how many are told that are none."""
    told = wrong.told(measured(geometry(walk.twin.size, walk.twin.rig), np.random.default_rng([seed, 4])))
    samples = wrong.arriving(walk.samples, walk.twin.rig, seed, walk.twin.duration_s)
    estimates = ContactTerrain(walk.twin.rig, exoskeleton=told).run(samples)
    return score_steps(walk.footprints, estimates), false_steps(walk.footprints, estimates)


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """By fault, over the steps of all walks: errors, coverage, classes; nothing of the paper's, which has no faults."""
    return {
        "summary": {
            name: {
                **_figures([ScoredStep(**row) for r in results for row in r["faults"][name]]),
                "false_steps": sum(r["false_steps"][name] for r in results),
            }
            for name in FAULTS
        },
        "paper": {},
    }


def _figures(steps: list[ScoredStep]) -> dict[str, float]:
    seen = [s for s in steps if s.seen]
    return {
        **step_figures(steps, []),
        "slope_max_deg": max((abs(math.degrees(s.slope_error)) for s in seen), default=0.0),
        "elevation_max_mm": max((abs(1e3 * s.elevation_error) for s in seen), default=0.0),
        "unknown_pct": percent(s.told_mode == UNKNOWN for s in steps),
        "wrong_pct": percent(s.seen and s.told_mode not in (s.mode, UNKNOWN) for s in steps),
    }


def table(result: dict[str, Any]) -> list[str]:
    """As lines of text; classes are % of all steps, those untold for want of a sensor too."""
    lines = [
        f"{len(result['cases'])} subjects on {' and '.join(WALKS)}",
        falls(result["cases"]),
        f"{'':<38}{'slope °':>9}{'most':>7}{'elev. mm':>10}{'most':>7}{'in 95 %':>12}{'class %':>9}"
        f"{'unknown':>9}{'wrong':>7}{'steps':>7}{'missed':>8}{'false':>7}",
    ]
    for name, wrong in FAULTS.items():
        of = result["summary"][name]
        inside = "".join(
            f"{of[k]:>6.0f}" if k in of else f"{'-':>6}" for k in ("slope_in_95_pct", "elevation_in_95_pct")
        )
        lines.append(
            f"{wrong.words:<38}{of['slope_rmse_deg']:>9.2f}{of['slope_max_deg']:>7.1f}{of['elevation_rmse_mm']:>10.1f}"
            f"{of['elevation_max_mm']:>7.0f}{inside}{of['classification_accuracy_pct']:>9.1f}"
            f"{of['unknown_pct']:>9.1f}{of['wrong_pct']:>7.1f}{of['steps']:>7}{of['steps_missed']:>8}"
            f"{of['false_steps']:>7}"
        )
    return lines
