"""Assistance by mode in closed loop: work saved by source of the mode, and falls caused by wrong modes.

Every variant walks the same walk with the same seed: without exoskeleton; with motors that only compensate their own
inertia; assisted by modes recognised from the legs, predicted by the camera, and true. Each seed is a subject of
Zhao et al. 2023.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NotRequired, TypedDict

import numpy as np

from stridetwin.batch.jobs import Row
from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.scenarios.exo_geometry import true_geometry
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.closed_loop.assisted_walk import (
    Recogniser,
    compute_costs,
    simulate_assisted_walk,
    simulate_bare_walk,
    true_modes_of,
)
from stridetwin.studies.closed_loop.recognition import CameraRecognition, LegRecognition
from stridetwin.studies.result import CaseRow, Collected, LabelledFigures, NoPaper, Result
from stridetwin.studies.tables import table_lines

WRONG = 0.01
"""Share of the steps with a wrong mode in the variant `wrong`."""
VARIANT_NAMES = {
    "none": "no exoskeleton",
    "carried": "motors compensate their own inertia",
    "late": "assisted by modes from the legs",
    "predicted": "assisted by predicted modes",
    "known": "assisted by true modes",
    "wrong": f"assisted by true modes, {WRONG:.0%} of them wrong",
}
"""Variants of the walk by key, with their names in the table."""
_RECOGNISERS: Mapping[str, tuple[Recogniser | None, tuple[str, ...]]] = {
    "carried": (None, ()),
    "late": (lambda rig, twin: LegRecognition(true_geometry(twin.size, rig)), ("ahrs", "encoder")),
    "predicted": (lambda rig, twin: CameraRecognition(rig), ("head_imu", "head_camera")),
    "known": (lambda rig, twin: true_modes_of(twin), ()),
    "wrong": (lambda rig, twin: true_modes_of(twin, WRONG), ()),
}
"""How a variant with exoskeleton knows the modes, and the groups of sensors that this takes; None: no assistance."""


class VariantCosts(TypedDict):
    """One walk in one variant.

    Attributes:
        fell_at_s: When the walker fell; None without a fall.
        modes: By mode, the costs of its steps (`compute_costs`).
    """

    fell_at_s: float | None
    modes: dict[str, dict[str, float]]


class AssistanceRow(CaseRow):
    """The row of a case.

    Attributes:
        ways: What came of each variant, by its key in `VARIANT_NAMES`.
    """

    ways: dict[str, VariantCosts]


class VariantSummary(TypedDict):
    """Figures of one variant over walks.

    Attributes:
        walks: Number of walks.
        fell: Number of walks that ended by a fall.
        work_j: The wearer's work per walk, mean over the walks without a fall in any variant; None without any.
        modes: By mode, the figures of `_mode_figures`.
        gain_share: Only of `predicted`, see `collect`.
    """

    walks: int
    fell: int
    work_j: float | None
    modes: dict[str, dict[str, float]]
    gain_share: NotRequired[float | None]


def run_case(case: ExperimentCase, ways: Sequence[str]) -> Row:
    """Simulates one walk in each variant of the assistance.

    Args:
        case: Seed and walk.
        ways: Keys of `VARIANT_NAMES`.

    Returns:
        The case's row with `ways`: variant to `fell_at_s`, s, or None without a fall, and `modes`, the costs of each
        mode's steps to the wearer (`compute_costs`).
    """
    (walk,) = case.walks()
    figures = {}
    for way in ways:
        if way == "none":
            result = simulate_bare_walk(walk.config, case.seed)
        else:
            recogniser, sensors = _RECOGNISERS[way]
            result = simulate_assisted_walk(walk.config, case.seed, recogniser, sensors)
        figures[way] = {"fell_at_s": result.walk.fell_at, "modes": compute_costs(result)}
    return case.row(ways=figures)


def collect(results: list[AssistanceRow]) -> Collected[dict[str, VariantSummary], NoPaper]:
    """Summary of each variant: falls on all walks, and costs on the walks without a fall in any variant.

    Returns:
        `summary`: variant to `walks` and `fell`, the numbers of all walks and of those that ended by a fall; `work_j`,
        mean per walk; and `modes`: mode to `_mode_figures`. For `predicted` also `gain_share`: the work that predicted
        modes save against modes from the legs, as a share of what true modes save; None if true modes save nothing.
    """
    ways = [way for way in VARIANT_NAMES if all(way in r["ways"] for r in results)]
    # rows of the walks that no variant fell in, so that all variants have walked the whole route
    ended = [r for r in results if all(r["ways"][way]["fell_at_s"] is None for way in ways)]
    summary: dict[str, VariantSummary] = {}
    work_of_way: dict[str, float] = {}  # mean work per walk, J, by variant
    for way in ways:
        fell = sum(r["ways"][way]["fell_at_s"] is not None for r in results)
        walked_modes = {mode for row in ended for mode in row["ways"][way]["modes"]}
        modes = {mode: _mode_figures(ended, way, mode, "none" in ways) for mode in MODES if mode in walked_modes}
        work = [sum(costs["work_j"] for costs in r["ways"][way]["modes"].values()) for r in ended]  # J, per walk
        if work:
            work_of_way[way] = float(np.mean(work))
        summary[way] = {"walks": len(results), "fell": fell, "work_j": work_of_way.get(way), "modes": modes}
    if ended and {"late", "predicted", "known"} <= set(ways):
        late, predicted, best = (work_of_way[way] for way in ("late", "predicted", "known"))
        summary["predicted"]["gain_share"] = (late - predicted) / (late - best) if late > best else None
    return {"summary": summary, "paper": {}}


def _mode_figures(rows: list[AssistanceRow], way: str, mode: str, beside_none: bool) -> dict[str, float]:
    """Costs per step of one mode in one variant, over all walks, and their change against no exoskeleton, %.

    Args:
        rows: Rows of the walks, in at least one of which the mode occurs.
        way: The variant.
        mode: The locomotion mode.
        beside_none: Adds the changes; the variant `none` was walked, too.

    Returns:
        `work_j_per_step`, the wearer's positive work of hips and knees; `rest_j_per_step`, what would remain of it if
        the motors helped without loss; `cuff_n`, the RMS force of the cuffs, mean over walks; and with `beside_none`
        `more_than_none_pct` and `rest_more_than_none_pct`, the changes of the first two against the work of `none`, %.
    """

    def per_step(way: str, figure: str) -> float:
        """A cost of the mode's steps in a variant over all walks, divided by their number."""
        costs_of_mode = [row["ways"][way]["modes"][mode] for row in rows if mode in row["ways"][way]["modes"]]
        return sum(costs[figure] for costs in costs_of_mode) / sum(costs["steps"] for costs in costs_of_mode)

    cuffs = [row["ways"][way]["modes"][mode]["cuff_n"] for row in rows if mode in row["ways"][way]["modes"]]
    work, rest = per_step(way, "work_j"), per_step(way, "rest_j")
    figures = {"work_j_per_step": work, "rest_j_per_step": rest, "cuff_n": float(np.mean(cuffs))}
    if beside_none:
        bare = per_step("none", "work_j")
        figures["more_than_none_pct"] = 100.0 * (work / bare - 1.0)
        figures["rest_more_than_none_pct"] = 100.0 * (rest / bare - 1.0)
    return figures


# header, width, and format of a variant's figures; three columns for each mode, such as `{modes[LG][cuff_n]:.0f}`
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


def table(result: Result[dict[str, VariantSummary], NoPaper, AssistanceRow]) -> list[str]:
    """The summary as lines of text: one per variant, with costs and changes by mode."""
    summary = result["summary"]
    rows: list[LabelledFigures] = [(VARIANT_NAMES[way], figures) for way, figures in summary.items()]
    if "carried" in summary:
        carried_modes = summary["carried"]["modes"]
        # a further line from the same walks: what would remain if the motors helped without any loss
        rest = {
            mode: {"more_than_none_pct": figures.get("rest_more_than_none_pct")}
            for mode, figures in carried_modes.items()
        }
        rows.append(("assisted without any loss", {"fell": "", "modes": rest}))
    share = summary["predicted"].get("gain_share") if "predicted" in summary else None
    return [
        f"{len(result['cases'])} walks of helped_walk; positive work of hips and knees per step, its change against no "
        "exoskeleton, and RMS of the cuffs' forces",
        *table_lines(_COLUMNS, rows, 46),
        *([] if share is None else [f"prediction gains {share:.0%} of what true modes gain over modes from the legs"]),
    ]
