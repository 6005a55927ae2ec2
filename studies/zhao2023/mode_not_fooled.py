"""False-positive test: short level walks, each with a trap that resembles a stair or ramp, from rendered images on.

Poses come from the visual-inertial odometry on the same images. Every step of every walk is LG, also those over a kerb
of 4 cm. Seeds alternate between head and chest.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from stridetwin.estimators.locomotion_mode import METHODS, MODES, ModeEstimate
from stridetwin.outputs.modes.scores import ScoredMode
from stridetwin.sim.config import Gait, Gaze, Level, Person, Route, Segment, Stairs, Thing, TwinConfig
from stridetwin.sim.faults.injection import FaultPlan
from stridetwin.sim.wearer.body import wearer
from stridetwin.studies.case import Case
from stridetwin.studies.fault_injection import FaultCase, Samples
from stridetwin.studies.tables import table_lines
from stridetwin.studies.walks import falls, fell_at_s, recorded
from stridetwin.studies.zhao2023.mode_walks import MOUNTS, SENSORS, posed, predict, scored

SEEDS = range(1000, 1004)
KERB_M = 0.04
STOP_M = 0.45
"""Distance at which the walker stops before the obstacle."""
_MIRROR = {"kind": "mirror_floor", "topic": "/*/depth", "at_s": 0, "holes": 0.3, "mirrored": 0.12}


@dataclass(frozen=True, kw_only=True)
class Trap:
    """One trap.

    Attributes:
        words: Description.
        segments: Terrain segments.
        things: Objects on the ground.
        bystanders: Number of people walking about.
        faults: As in the key `faults` of a scenario file.
    """

    words: str
    segments: tuple[Segment, ...] = (Level(length_m=6.0),)
    things: tuple[Thing, ...] = ()
    bystanders: int = 0
    faults: tuple[Mapping[str, Any], ...] = ()


TRAPS = {
    "stripe": Trap(
        words="painted stripes, half of them black without depth",
        things=(Thing(kind="stripe", at_m=2.5), Thing(kind="stripe", at_m=4.2)),
    ),
    "shadow": Trap(
        words="shadows", things=(Thing(kind="shadow", at_m=2.0), Thing(kind="shadow", at_m=4.2)),
    ),
    "kerb": Trap(
        words="a kerb of 4 cm, up and down",
        segments=(
            Level(length_m=3.0), Stairs(risers=1, riser_m=KERB_M), Level(length_m=2.0),
            Stairs(risers=1, riser_m=KERB_M, down=True), Level(length_m=2.5),
        ),
    ),
    "table": Trap(
        words="a table beside the way, and one at its end",
        things=(Thing(kind="table", at_m=2.0, left_m=1.15), Thing(kind="table", at_m=6.0 + STOP_M)),
    ),
    "wall": Trap(words="a wall at the end of the way", things=(Thing(kind="wall", at_m=6.0 + STOP_M),)),
    "leg": Trap(words="legs of four bystanders", bystanders=4),
    "mirror": Trap(words="a floor that mirrors in blotches", faults=(_MIRROR,)),
}  # fmt: skip


def run_case(case: Case) -> dict[str, Any]:
    """One walk per trap.

    Returns:
        `seed`, `physics`, `mount`, `fell`, and `traps`: name to method to `steps` (rows of `ScoredMode`) and
        `alarms_pct`, the share of the estimates that predict any other mode than LG.
    """
    mount = MOUNTS[case.seed % len(MOUNTS)]
    person = Person()
    sole_m = wearer(person, with_exo=False).body.shoe_length_m
    found: dict[str, dict[str, Any]] = {}
    fell = []
    for name, trap in TRAPS.items():
        route = Route(segments=trap.segments, things=trap.things, bystanders=trap.bystanders)
        config = TwinConfig(
            name=name, route=route, person=person, exo=None, sensors=SENSORS, rig_mount=mount, physics=case.physics,
            gait=Gait(gaze=Gaze(kind="terrain")),
        )  # fmt: skip
        with recorded(config, case, name) as recording:
            plan = FaultCase.of(trap.words, *trap.faults).plan(recording.rig, case.seed, recording.duration)
            inject = partial(_inject, plan, recording.samples([f"/truth/{mount}/imu/odometry"]))
            predictions = predict(posed(recording, mount, "dvio", inject), recording)
            rows = scored(predictions, recording, sole_m)
            if fell_at_s(recording) is not None:
                fell.append(name)
        found[name] = {
            m: {"steps": rows[m].rows()["steps"], "alarms_pct": _alarms(predictions.estimates[m])} for m in METHODS
        }
    return case.row(mount=mount, fell=fell, traps=found)


def _inject(plan: FaultPlan, truth: Samples, samples: Samples) -> Samples:
    """The samples with the faults, some of which need the true path."""
    return plan.samples(heapq.merge(truth, samples, key=lambda s: s.t_ns))


def _alarms(estimates: list[ModeEstimate]) -> float:
    wrong = sum(e.change is not None or any(s.mode != "LG" for s in e.steps) for e in estimates)
    return 100.0 * wrong / max(len(estimates), 1)


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """By method and trap, over all walks; the paper has no such table."""
    return {
        "summary": {m: {name: _figures([r["traps"][name][m] for r in results]) for name in TRAPS} for m in METHODS},
        "paper": {},
    }


def _figures(walks: list[dict[str, Any]]) -> dict[str, Any]:
    steps = [ScoredMode(**row) for w in walks for row in w["steps"]]
    predicted = Counter(s.predicted for s in steps)
    probabilities = [s.probabilities[MODES.index(s.mode)] for s in steps if s.probabilities]
    return {
        "steps": len(steps),
        "accuracy_pct": 100.0 * sum(s.right for s in steps) / max(len(steps), 1),
        "predicted": {m: predicted[m] for m in (*MODES, "")},
        "least_probability": min(probabilities, default=None),
        "alarms_pct": float(np.mean([w["alarms_pct"] for w in walks])),
    }


_COLUMNS = (
    ("steps", 7, "{steps}"),
    *((mode, 6, f"{{predicted[{mode}]}}") for mode in MODES),
    ("none", 6, "{none}"),
    ("least p of LG", 15, "{least_probability:.3f}"),
    ("alarms %", 10, "{alarms_pct:.1f}"),
    ("published: LG %", 17, "{published:.1f}"),
)


def table(result: dict[str, Any]) -> list[str]:
    """Predicted modes by trap, as lines of text; every true one is LG."""
    ours, published = (result["summary"][m] for m in METHODS)
    rows = [
        (
            trap.words,
            {**ours[name], "none": ours[name]["predicted"][""], "published": published[name]["accuracy_pct"]},
        )
        for name, trap in TRAPS.items()
    ]
    return [
        f"{len(result['cases'])} walks per trap; every step is LG; alarms: estimates that predict any other mode",
        falls(result["cases"]),
        *table_lines(_COLUMNS, rows, 52),
    ]
