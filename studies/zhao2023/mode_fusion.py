"""Contribution of an exoskeleton's legs: modes of coming steps from the camera, from the legs, and from both.

A stair and a ramp are walked once per seed in the exoskeleton, and evaluated in light and in darkness, where images
have no depth from the first step up on. Poses come from the visual-inertial odometry with light in both cases. The legs
alone (`contact_terrain`) know a step only after it: they predict that the next one is like the last.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from stridetwin.estimators.contact_terrain import ContactTerrain, StepEstimate
from stridetwin.outputs.modes.scores import ModeScores, mode_figures
from stridetwin.outputs.truth import true_footprints
from stridetwin.scenarios.exo_geometry import of_recording
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Depth, Sample
from stridetwin.studies.case import Case
from stridetwin.studies.fault_injection import Samples
from stridetwin.studies.tables import table_lines
from stridetwin.studies.walks import falls, fell_at_s
from stridetwin.studies.zhao2023.mode_walks import MOUNTS, SENSORS, posed, predict, scored, stair_and_ramp

WALKS = ("zhao_stair_20cm", "zhao_ramp_15_8")
LIGHTS = ("light", "dark")
BY = ("camera", "both", "legs")
SEEDS = range(1000, 1006)
_LEGS = (*SENSORS, "ahrs", "encoder")
_WORDS = {
    "light": "in the light", "dark": "dark from the first step up on",
    "camera": "camera", "both": "camera and legs", "legs": "legs alone",
}  # fmt: skip


def run_case(case: Case) -> dict[str, Any]:
    """Both walks, in light and in darkness.

    Returns:
        `seed`, `physics`, `mount`, `fell`, `predicted`: light to `camera` and `both` to the rows of each walk, and
        `legs`: true mode, that of the previous step, and the legs' prediction, for every step.
    """
    mount = MOUNTS[case.seed % len(MOUNTS)]
    found: dict[str, dict[str, list[Any]]] = {light: {by: [] for by in BY[:2]} for light in LIGHTS}
    legs: list[tuple[str, str, str]] = []
    fell = []
    for scenario, recording, sole_m in stair_and_ramp(case, WALKS, mount, _LEGS, with_exo=True):
        seen = list(posed(recording, mount, "dvio"))
        steps = leg_steps(recording)
        for light in LIGHTS:
            samples = seen if light == "light" else list(_dark(seen, _first_up_ns(recording)))
            for by in BY[:2]:
                both: list[Sample | StepEstimate] = [*samples, *(steps if by == "both" else ())]
                both.sort(key=lambda s: s.t_ns)
                rows = scored(predict(both, recording, ("proposed",)), recording, sole_m)
                found[light][by].append(rows["proposed"].rows())
        legs += _like_the_last(recording, steps)
        if fell_at_s(recording) is not None:
            fell.append(scenario)
    return case.row(mount=mount, fell=fell, predicted=found, legs=legs)


def leg_steps(recording: Recording) -> list[StepEstimate]:
    """All step estimates from the legs, in time order."""
    exo = of_recording(recording)
    legs = ContactTerrain(recording.rig, exoskeleton=exo)
    return [step for s in recording.samples(list(exo.topics)) if (step := legs.update(s)) is not None]


def _first_up_ns(recording: Recording) -> int:
    return next(f.t_ns for f in true_footprints(recording) if f.mode in ("SA", "RA"))


def _dark(samples: Iterable[Sample], since_ns: int) -> Samples:
    for s in samples:
        yield replace(s, depth=np.zeros_like(s.depth)) if isinstance(s, Depth) and s.t_ns >= since_ns else s


def _like_the_last(recording: Recording, steps: list[StepEstimate]) -> list[tuple[str, str, str]]:
    """True mode of each step, that of the previous one, and the last mode estimated from the legs before touch-down."""
    t_ns = np.array([s.t_ns for s in steps])
    found, before = [], "LG"
    for print_ in true_footprints(recording)[2:]:
        last = int(np.searchsorted(t_ns, print_.t_ns)) - 1
        found.append((print_.mode, before, steps[last].mode if last >= 0 else "LG"))
        before = print_.mode
    return found


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """By light and by source, over all walks; no paper has such a table."""
    summary: dict[str, Any] = {
        light: {
            by: mode_figures([ModeScores.of(w) for r in results for w in r["predicted"][light][by]]) for by in BY[:2]
        }
        for light in LIGHTS
    }
    seen = [s for r in results for w in r["predicted"]["light"]["camera"] for s in ModeScores.of(w).steps]
    predicted = [mode for r in results for _, _, mode in r["legs"]]
    right = [(mode in s.allowed, s.transition) for s, mode in zip(seen, predicted, strict=True)]  # as for the camera
    summary["legs"] = {
        "steps": len(predicted),
        "accuracy_pct": 100.0 * float(np.mean([ok for ok, _ in right])),
        "transition_accuracy_pct": 100.0 * float(np.mean([ok for ok, transition in right if transition])),
    }
    return {"summary": summary, "paper": {}}


_COLUMNS = (
    ("steps", 6, "{steps}"),
    ("correct %", 11, "{accuracy_pct:.1f}"),
    ("transitions %", 15, "{transition_accuracy_pct:.1f}"),
    ("lead s", 8, "{lead_time_s[median]:.1f}"),
    ("5 %", 6, "{lead_time_s[p5]:.1f}"),
    ("footprint mm", 14, "{footprint_steady_rmse_m[forward]!m:.0f}"),
    ("cal. error", 12, "{calibration_error:.3f}"),
)


def table(result: dict[str, Any]) -> list[str]:
    """As lines of text."""
    summary = result["summary"]
    rows = [(f"{_WORDS[light]}, {_WORDS[by]}", summary[light][by]) for light in LIGHTS for by in BY[:2]]
    return [
        f"{len(result['cases'])} walks each of {' and '.join(WALKS)} in the exoskeleton",
        falls(result["cases"]),
        *table_lines(_COLUMNS, [*rows, (_WORDS["legs"], summary["legs"])], 50),
    ]
