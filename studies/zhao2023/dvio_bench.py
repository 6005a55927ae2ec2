"""Ten walks whose motion follows the difficulty of the EuRoC sequences of Zhao et al. 2023, Table IV.

EuRoC was recorded by a drone with two cameras, and is not part of this project: our sequences are walks of the twin
with an RGB-D camera on the head, from a slow stroll past rich texture to a shaken head and white walls. The paper's
figures are listed for the ranking of its methods, not for their values. To score EuRoC itself: `stridetwin import
MH_01_easy -o mh_01.mcap`, `stridetwin score mh_01.mcap`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.reference.norms import read_reference
from stridetwin.studies.result import Collected, Figures, LabelledFigures, Result, Summary, get_figures
from stridetwin.studies.tables import table_lines
from stridetwin.studies.zhao2023.odometry_walks import FigureName, OdometryFigures, OdometryRow, mean, summarize_time


@dataclass(frozen=True, kw_only=True)
class Sequence:
    """One of the ten walks and what it stands for.

    Attributes:
        like: The sequence of EuRoC of similar difficulty.
        description: What is difficult in it, for the table.
    """

    like: str
    description: str


SEQUENCES = {
    "dvio_stroll": Sequence(like="MH_01", description="slow stroll"),
    "dvio_walk": Sequence(like="MH_02", description="usual speed"),
    "dvio_brisk": Sequence(like="MH_03", description="brisk"),
    "dvio_jog": Sequence(like="MH_04", description="fastest walk, dim"),
    "dvio_white": Sequence(like="MH_05", description="all white, dim, abrupt turns"),
    "dvio_stairs": Sequence(like="V1_01", description="stairs up and down"),
    "dvio_look": Sequence(like="V1_02", description="looks about, 0.9 rad/s"),
    "dvio_shake": Sequence(like="V1_03", description="head shaken, 2 rad/s"),
    "dvio_wander": Sequence(like="V2_01", description="wanders, quick glances"),
    "dvio_crowd": Sequence(like="V2_02", description="among four people"),
}
"""Sequences by the name of the walk in the catalogue."""


PaperErrors = dict[str, dict[str, dict[str, float]]]
"""Published errors by method, `ape_rmse_m`, and sequence of EuRoC."""


class BenchRow(OdometryRow):
    """The row of a walk, with the name of its sequence.

    Attributes:
        sequence: Key of `SEQUENCES`.
    """

    sequence: str


def collect(results: list[BenchRow]) -> Collected[Summary, PaperErrors]:
    """Means by method over the walks of each sequence and over the sequences, beside the paper's figures on EuRoC."""
    summary: Summary = {}
    for method in results[0]["methods"]:
        walks_of_sequence: dict[str, list[OdometryFigures]] = {}
        for r in results:
            walks_of_sequence.setdefault(r["sequence"], []).append(r["methods"][method])
        # in the order of `SEQUENCES`
        ordered = {name: walks_of_sequence[name] for name in SEQUENCES if name in walks_of_sequence}
        summary[method] = {
            "ape_rmse_m": _means_by_sequence(ordered, "ape_rmse_m"),
            "rpe_5m_pct": _means_by_sequence(ordered, "rpe_5m_pct"),
            # number of walks on which the odometry failed
            "failures": {name: sum(bool(w["failure"]) for w in walks) for name, walks in ordered.items()},
        }
    summary["time_ms"] = summarize_time(r["methods"]["proposed"] for r in results)
    summary["walks_that_fell"] = sum(r["fell_at_s"] is not None for r in results)
    return {"summary": summary, "paper": read_paper_figures()}


def _means_by_sequence(walks: dict[str, list[OdometryFigures]], figure: FigureName) -> dict[str, float | None]:
    """Mean of a figure over the walks of each sequence, by its name, and over these means as `mean`.

    A mean is None if no walk has the figure.

    Args:
        walks: Sequence to the figures of its walks.
        figure: Name of the figure.
    """
    values = {name: mean(sequence_walks, figure) for name, sequence_walks in walks.items()}
    defined = [v for v in values.values() if v is not None]
    return {**values, "mean": float(np.mean(defined)) if defined else None}


def read_paper_figures() -> PaperErrors:
    """Table IV of the paper: errors on EuRoC by method and sequence, and the mean of the ten."""
    figures_of_method: PaperErrors = {}
    for method, figures in read_reference("zhao2023")["dvio_bench"].items():
        ape = figures["ape_rmse_m"]
        figures_of_method[method] = {"ape_rmse_m": {**ape, "mean": float(np.mean(list(ape.values())))}}
    return figures_of_method


def table(result: Result[Summary, PaperErrors, BenchRow]) -> list[str]:
    """The sequences as lines of text, each beside the one of EuRoC of similar difficulty."""
    summary, paper_figures = result["summary"], result["paper"]
    methods = list(result["cases"][0]["methods"])
    time_ms = get_figures(summary, "time_ms")  # per frame
    # angular rates of head or chest, by sequence: of several walks of one the last counts
    rates = {r["sequence"]: r["rate_radps"] for r in result["cases"]}
    columns = [("as", 8, "{like}"), ("rad/s p95", 11, "{rate[p95]:.1f}")]
    # for each method ours, and the paper's in brackets
    columns += [column for m in methods for column in ((m, 12, f"{{{m}}}"), ("EuRoC", 9, f"({{paper_{m}:.2f}})"))]
    rows: list[LabelledFigures] = []
    for name in [*(n for n in SEQUENCES if n in rates), "mean"]:
        sequence = SEQUENCES.get(name, Sequence(like="mean", description=""))
        # the last line has the means, which are like no sequence; the paper's mean is under the name `mean`
        figures: dict[str, object] = {"like": sequence.like.removeprefix("mean"), "rate": rates.get(name)}
        for m in methods:
            figures[m] = _error_text(get_figures(summary, m), name)
            figures[f"paper_{m}"] = paper_figures.get(m, {}).get("ape_rmse_m", {}).get(sequence.like)
        rows.append((f"{name:<13}{sequence.description}", figures))
    return [
        "RMS of the absolute position error, m; x: lost or over 2 m away. In brackets the paper's results on EuRoC;",
        "its motion and cameras differ, so compare the order of the methods.",
        f"proposed: {time_ms['mean']:.1f} ms per frame, 99th percentile {time_ms['p99']:.1f}; "
        f"{summary['walks_that_fell']} of {len(result['cases'])} walks ended by a fall",
        "",
        *table_lines(columns, rows, 43),
    ]


def _error_text(figures: Figures, name: str) -> str:
    """The absolute position error of a sequence as text, with an x if a walk failed; - if no walk has an error.

    Args:
        figures: Figures of a method in the summary.
        name: Name of the sequence, or `mean`.
    """
    value = get_figures(figures, "ape_rmse_m").get(name)
    assert value is None or isinstance(value, (int, float))
    text = "-" if value is None else f"{value:.3f}" if value < 10.0 else ">10"
    return text + ("x" if get_figures(figures, "failures").get(name) else " ")
