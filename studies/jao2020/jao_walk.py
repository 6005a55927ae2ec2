"""The walks of Jao, Wang, Shkel 2020 (Tables II and III) and a flight of stairs, with rendered shoe cameras.

One walk per seed, recorded once (`walks`), in three cases: gyros without saturation, the part's own, which saturate at
450 °/s, and gyros without saturation while all images of every second step are lost.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Literal, TypedDict

import numpy as np

from stridetwin.batch.jobs import Row
from stridetwin.outputs.truth import FOOTPRINTS
from stridetwin.reference.norms import EndErrors, read_reference
from stridetwin.streams.samples import Array, Image, Sample
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.jao2020.two_feet import (
    COMPARED_METHODS,
    FootScores,
    MethodName,
    run_every_method,
    score_paths,
    true_start,
)
from stridetwin.studies.result import CaseRow, Collected, Figures, Result
from stridetwin.studies.tables import table_lines
from stridetwin.studies.walks import RecordedWalk, record_shoes

ESTIMATORS = ("foot_to_foot",)
"""Estimators whose parameters `--set` changes here."""

CASES = {
    "unclipped": "gyros without saturation",
    "clipped": "ADIS16485, gyros saturate at 450 °/s",
    "half_blind": "gyros without saturation, no image in every second step",
}
"""Cases of each walk, with their titles in the table."""


MethodFigures = dict[str, float | list[float]]
"""A figure by method; two numbers are of the left and the right foot, four of left y, left x, right y, right x."""
Summary = dict[str, MethodFigures | int]
"""Figures by name, each by method; and `walks_that_fell`, the number of walks that ended by a fall."""


class CaseScores(TypedDict):
    """Scores of every method in one of `CASES`, and the number of board observations (`sightings`)."""

    zupt: FootScores
    zupt_relative_distance: FootScores
    zupt_relative_position: FootScores
    proposed: FootScores
    sightings: int


class WalkRow(CaseRow):
    """The row of a walk: its scenario, when the walker fell, s, and the scores in each of `CASES`."""

    scenario: str
    fell_at_s: float | None
    cases: dict[str, CaseScores]


def run_case(case: ExperimentCase) -> Row:
    """Simulates one walk and runs every method on it, in each of `CASES`.

    Returns:
        The case's row with `scenario`, `fell_at_s`, and `cases`: case to `sightings` (the number of board observations)
        and, by method, the scores of both feet's paths (`two_feet.score_paths`).
    """
    with record_shoes(case) as walk:
        truth = walk.truth()  # by foot
        start = true_start(truth)
        figures_of_case: dict[str, Figures] = {}
        for name in CASES:
            wide = name != "clipped"  # takes the gyros without saturation
            samples = walk.samples(wide=wide)
            if name == "half_blind":
                samples = without_every_second_step(samples, touch_down_times_ns(walk))
            paths, observation_count = run_every_method(walk.rig(wide=wide), walk.imus(wide=wide), samples, start)
            figures_of_case[name] = {
                **{method: score_paths(of_feet, truth) for method, of_feet in paths.items()},
                "sightings": observation_count,
            }
        return case.row(scenario=walk.shoes.metadata["scenario"], fell_at_s=walk.fell_at_s, cases=figures_of_case)


def touch_down_times_ns(walk: RecordedWalk) -> Array:
    """(N,) times of the touch-downs of both feet, ns, in order."""
    return np.sort(walk.shoes.block(FOOTPRINTS).t_ns)


def without_every_second_step(samples: Iterable[Sample], touches: Array) -> Iterator[Sample]:
    """Samples without the images of every second step: touch-down 1 to 2, 3 to 4, and so on.

    Args:
        samples: In time order.
        touches: (T,) touch-downs of both feet, ns, in order; images after an odd number of them are left out.
    """
    for sample in samples:
        touch_count = np.searchsorted(touches, sample.t_ns)  # touch-downs before the sample
        if not (isinstance(sample, Image) and touch_count % 2 == 1):
            yield sample


def collect(results: list[WalkRow]) -> Collected[Summary, EndErrors]:
    """Figures by method for gyros without saturation, then with the name of the case before the unit for the others.

    Two numbers are of the left and the right foot.
    """
    summary: Summary = {}
    for case in CASES:
        suffix = "" if case == "unclipped" else f"_{case}"
        scores_of_method = {m: [r["cases"][case][m] for r in results] for m in COMPARED_METHODS}
        for name, values in _figures_over_walks(scores_of_method).items():
            # the suffix comes before the unit, such as `mean_end_error_clipped_m`
            stem, _, unit = name.rpartition("_")
            summary[f"{stem}{suffix}_{unit}"] = values
    summary["walks_that_fell"] = sum(r["fell_at_s"] is not None for r in results)
    return {"summary": summary, "paper": _read_paper_errors(results[0]["scenario"])}


def _read_paper_errors(scenario: str) -> EndErrors:
    """The paper's end errors on a walk; empty for walks that are not from the paper."""
    paper_errors = read_reference("jao2020")
    if scenario == "jao_straight_53m":
        return paper_errors["jao_straight_53m"]
    return paper_errors["jao_loop_126m"] if scenario == "jao_loop_126m" else {}


def _figures_over_walks(scores_of_method: dict[MethodName, list[FootScores]]) -> dict[str, MethodFigures]:
    """Means, standard deviations and largest values over walks, by figure and method.

    Args:
        scores_of_method: Method to the scores of each walk.
    """
    # end errors by method, (walks, feet, axes) m: left, right; x, y, z of the world
    ends = {m: np.array([w["end_error_m"] for w in walks]) for m, walks in scores_of_method.items()}

    def mean(
        name: Literal["end_error_pct", "feet_disagree_rms_m", "end_nees", "nees_within_95_pct"],
    ) -> MethodFigures:
        """Mean of a score over the walks, by method; of each foot where the score has two values."""
        return {m: np.mean([w[name] for w in walks], axis=0).tolist() for m, walks in scores_of_method.items()}

    return {
        # horizontal
        "mean_end_error_m": {m: np.linalg.norm(e[:, :, :2], axis=2).mean(axis=0).tolist() for m, e in ends.items()},
        # left y, left x, right y, right x: the order of the paper; of a single walk it is 0
        "end_position_sd_m": {
            m: [float(e[:, f, axis].std(ddof=min(1, len(e) - 1))) for f in range(2) for axis in (1, 0)]
            for m, e in ends.items()
        },
        "mean_abs_up_error_m": {m: np.abs(e[:, :, 2]).mean(axis=0).tolist() for m, e in ends.items()},
        "mean_end_error_pct": mean("end_error_pct"),
        "feet_disagree_rms_m": mean("feet_disagree_rms_m"),
        "feet_disagree_max_m": {
            m: max(w["feet_disagree_max_m"] for w in walks) for m, walks in scores_of_method.items()
        },
        "end_nees_mean": mean("end_nees"),
        "nees_within_95_pct": mean("nees_within_95_pct"),
    }


def _by_method(summary: Summary, name: str) -> MethodFigures:
    """A figure of a summary by method."""
    figures = summary[name]
    assert isinstance(figures, dict)
    return figures


# header, width, and format of a method's figures, whose short names `table` sets
_COLUMNS = (
    ("end error m", 15, "{end:.3f}"),
    ("paper m", 12, "{paper:.2f}"),
    ("height m", 14, "{up:.3f}"),
    ("of the distance %", 19, "{share:.2f}"),
    ("feet disagree, rms mm", 23, "{rms!m:.0f}"),
    ("largest mm", 12, "{largest!m:.0f}"),
    ("end NEES (3 if consistent)", 28, "{nees:.3g}"),
)


def table(result: Result[Summary, EndErrors, WalkRow]) -> list[str]:
    """Our figures beside the paper's, case by case, as lines of text; two numbers are of the left and right foot."""
    summary, paper_errors = result["summary"], result["paper"].get("mean_end_error_m", {})
    lines = [f"{len(result['cases'])} walks, {summary['walks_that_fell']} of them ended by a fall"]
    for case, description in CASES.items():
        suffix = "" if case == "unclipped" else f"_{case}"
        columns: dict[str, Mapping[str, object]] = {
            "end": _by_method(summary, f"mean_end_error{suffix}_m"),
            "up": _by_method(summary, f"mean_abs_up_error{suffix}_m"),
            "share": _by_method(summary, f"mean_end_error{suffix}_pct"),
            "rms": _by_method(summary, f"feet_disagree_rms{suffix}_m"),
            "largest": _by_method(summary, f"feet_disagree_max{suffix}_m"),
            "nees": _by_method(summary, f"end_nees{suffix}_mean"),
            "paper": {} if case == "half_blind" else paper_errors,  # the paper has no such case
        }
        # from columns by method to a row of all columns for each method
        rows = [(m, {name: by_method.get(m, "") for name, by_method in columns.items()}) for m in COMPARED_METHODS]
        lines += ["", description, *table_lines(_COLUMNS, rows, 24)]
    return lines
