"""Assistance by mode in closed loop: work saved by source of the mode, and falls caused by wrong modes.

Every variant walks the same walk with the same seed: without exoskeleton; with motors that only compensate their own
inertia; assisted by modes recognised from the legs, predicted by the camera, and true. Each seed is a subject of
Zhao et al. 2023.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.scenarios.exo_geometry import geometry
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.wearer.anthropometry import PEOPLE
from stridetwin.studies.case import Case
from stridetwin.studies.closed_loop.assisted_walk import WalkResult, assisted_walk, bare_walk, costs, truth_of
from stridetwin.studies.closed_loop.recognition import Measured, Predicted
from stridetwin.studies.tables import table_lines

SCENARIO = "helped_walk"
SUBJECTS = tuple(name for name in PEOPLE if name.startswith("zhao_"))
VARIANTS = {
    "assistance": (range(1000, 1010), ("none", "carried", "late", "predicted", "known")),
    "assistance_wrong": (range(1000, 1100), ("wrong",)),
}
"""By experiment: its seeds, and the first argument of `run_case`."""
WRONG = 0.01
NAMES = {
    "none": "no exoskeleton",
    "carried": "motors compensate their own inertia",
    "late": "assisted by modes from the legs",
    "predicted": "assisted by predicted modes",
    "known": "assisted by true modes",
    "wrong": f"assisted by true modes, {WRONG:.0%} of them wrong",
}
_MAKES: Mapping[str, Callable[[TwinConfig, int], WalkResult]] = {
    "none": bare_walk,
    "carried": lambda config, seed: assisted_walk(config, seed, None),
    "late": lambda config, seed: assisted_walk(
        config, seed, lambda rig, twin: Measured(geometry(twin.size, rig)), ("ahrs", "encoder")
    ),
    "predicted": lambda config, seed: assisted_walk(
        config, seed, lambda rig, twin: Predicted(rig), ("head_imu", "head_camera")
    ),
    "known": lambda config, seed: assisted_walk(config, seed, lambda rig, twin: truth_of(twin)),
    "wrong": lambda config, seed: assisted_walk(config, seed, lambda rig, twin: truth_of(twin, WRONG)),
}


def run_case(case: Case, ways: Sequence[str]) -> dict[str, Any]:
    """One walk, simulated in each variant.

    Returns:
        `seed`, `subject`, and `ways`: variant to `fell_at_s`, and `modes`, the cost of each mode's steps (`costs`).
    """
    (walk,) = case.walks()
    found = {}
    for way in ways:
        made = _MAKES[way](walk.config, case.seed)
        found[way] = {"fell_at_s": made.walk.fell_at, "modes": costs(made)}
    return case.row(ways=found)


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Summary over the walks without a fall in any variant.

    Returns:
        `summary`: variant to `walks`, `fell`, `work_j` per walk, and by mode `work_j_per_step`, `more_than_none_pct`,
        `rest_j_per_step` (`costs`), `rest_more_than_none_pct`,
        `cuff_n`; and for `predicted` the `gain_share`, its share of the truth's gain over recognition from the legs.
    """
    ways = [way for way in NAMES if all(way in r["ways"] for r in results)]
    ended = [r for r in results if all(r["ways"][way]["fell_at_s"] is None for way in ways)]
    summary: dict[str, Any] = {}
    for way in ways:
        fell = sum(r["ways"][way]["fell_at_s"] is not None for r in results)
        modes = {mode: _of_mode(ended, way, mode, "none" in ways) for mode in _modes(ended, way)}
        work = [sum(of["work_j"] for of in r["ways"][way]["modes"].values()) for r in ended]
        mean = float(np.mean(work)) if work else None
        summary[way] = {"walks": len(results), "fell": fell, "work_j": mean, "modes": modes}
    if ended and {"late", "predicted", "known"} <= set(ways):
        late, predicted, best = (summary[way]["work_j"] for way in ("late", "predicted", "known"))
        summary["predicted"]["gain_share"] = (late - predicted) / (late - best) if late > best else None
    return {"summary": summary, "paper": {}}


def _modes(rows: Iterable[Mapping[str, Any]], way: str) -> list[str]:
    there = {mode for row in rows for mode in row["ways"][way]["modes"]}
    return [mode for mode in MODES if mode in there]


def _of_mode(rows: list[dict[str, Any]], way: str, mode: str, beside_none: bool) -> dict[str, Any]:
    own = [row["ways"][way]["modes"][mode] for row in rows if mode in row["ways"][way]["modes"]]
    found: dict[str, Any] = {
        "work_j_per_step": sum(o["work_j"] for o in own) / sum(o["steps"] for o in own),
        "rest_j_per_step": sum(o["rest_j"] for o in own) / sum(o["steps"] for o in own),
        "cuff_n": float(np.mean([o["cuff_n"] for o in own])),
    }
    if beside_none:
        none = [row["ways"]["none"]["modes"][mode] for row in rows]
        bare = sum(o["work_j"] for o in none) / sum(o["steps"] for o in none)
        found["more_than_none_pct"] = 100.0 * (found["work_j_per_step"] / bare - 1.0)
        found["rest_more_than_none_pct"] = 100.0 * (found["rest_j_per_step"] / bare - 1.0)
    return found


_COLUMNS = (
    ("fell", 6, "{fell}"),
    ("J per walk", 12, "{work_j:.0f}"),
    *(
        (head, width, f"{{modes[{mode}]{figure}}}")
        for mode in MODES
        for head, width, figure in (
            (f"{mode} J", 9, "[work_j_per_step]:.1f"), ("change %", 10, "[more_than_none_pct]:+.1f"),
            ("cuffs N", 9, "[cuff_n]:.0f"),
        )
    ),
)  # fmt: skip


def table(result: dict[str, Any]) -> list[str]:
    """As lines of text."""
    summary = result["summary"]
    rows = [(NAMES[way], figures) for way, figures in summary.items()]
    if "carried" in summary:
        own = summary["carried"]["modes"]
        rest = {mode: {"more_than_none_pct": of.get("rest_more_than_none_pct")} for mode, of in own.items()}
        rows.append(("assisted without any loss", {"fell": "", "modes": rest}))
    share = summary.get("predicted", {}).get("gain_share")
    return [
        f"{len(result['cases'])} walks of {SCENARIO}; positive work of hips and knees per step, its change against no "
        "exoskeleton, and RMS of the cuffs' forces",
        *table_lines(_COLUMNS, rows, 46),
        *([] if share is None else [f"prediction gains {share:.0%} of what true modes gain over modes from the legs"]),
    ]
