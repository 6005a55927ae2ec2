"""False-positive test: short level walks, each with a trap that resembles a stair or ramp, from rendered images on.

Poses come from the visual-inertial odometry on the same images. Every step of every walk is LG, also those over a kerb
of 4 cm. Seeds alternate between head and chest.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.estimators.locomotion_mode import METHODS, MODES, ModeEstimate
from stridetwin.outputs.modes.scores import ScoredMode
from stridetwin.scenarios.scenario_file import scenario_of
from stridetwin.sim.config import Gait, Gaze
from stridetwin.sim.wearer.body import wearer
from stridetwin.streams.yaml_file import read_yaml
from stridetwin.studies.case import Case
from stridetwin.studies.tables import table_lines
from stridetwin.studies.walks import falls, fell_at_s, recorded
from stridetwin.studies.zhao2023.mode_walks import MOUNTS, SENSORS, posed, predict, scored

SEEDS = range(1000, 1004)
_FILE = Path(__file__).with_suffix(".yaml")
TRAPS = {name: scenario_of(node, _FILE.with_stem(name)) for name, node in read_yaml(_FILE).items()}


def run_case(case: Case) -> dict[str, Any]:
    """One walk per trap.

    Returns:
        `seed`, `physics`, `mount`, `fell`, and `traps`: name to method to `steps` (rows of `ScoredMode`) and
        `alarms_pct`, the share of the estimates that predict any other mode than LG.
    """
    mount = MOUNTS[case.seed % len(MOUNTS)]
    found: dict[str, dict[str, Any]] = {}
    fell = []
    for name, trap in TRAPS.items():
        config = replace(
            trap.config,
            exo=None,
            sensors=SENSORS,
            rig_mount=mount,
            physics=case.physics,
            gait=Gait(gaze=Gaze(kind="terrain")),
        )
        with recorded(config, case, name) as recording:
            predictions = predict(posed(recording, mount, "dvio"), recording)
            sole_m = wearer(config.person, with_exo=False).body.shoe_length_m
            rows = scored(predictions, recording, sole_m)
            if fell_at_s(recording) is not None:
                fell.append(name)
        found[name] = {
            m: {"steps": rows[m].rows()["steps"], "alarms_pct": _alarms(predictions.estimates[m])} for m in METHODS
        }
    return case.row(mount=mount, fell=fell, traps=found)


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
            trap.description,
            {**ours[name], "none": ours[name]["predicted"][""], "published": published[name]["accuracy_pct"]},
        )
        for name, trap in TRAPS.items()
    ]
    return [
        f"{len(result['cases'])} walks per trap; every step is LG; alarms: estimates that predict any other mode",
        falls(result["cases"]),
        *table_lines(_COLUMNS, rows, 52),
    ]
