"""Table 5 of Shim et al. 2019 on the simulated walkers: the seven subjects on the terrains of Table 4.

A case is one trial of one subject: level, stair and three ramps, each walked once (stair and ramps up and down). Steps
belong to a case of the table by their mode, which includes those onto and off a terrain. The estimators get a nominal
exoskeleton with measurement errors (`exo_geometry.simulate_measurement`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from heapq import merge

import numpy as np

from stridetwin.batch.jobs import Row
from stridetwin.estimators import registry
from stridetwin.estimators.base import Options
from stridetwin.estimators.contact_terrain import METHODS, MODES, ContactTerrain, Exoskeleton, StepEstimate, TerrainSvm
from stridetwin.estimators.contact_terrain.geometry import METADATA_KEY, to_text
from stridetwin.outputs.parameters import parameter_keywords
from stridetwin.outputs.steps.scores import (
    ScoredStep,
    StepRow,
    align_yaw,
    displacement_errors,
    false_steps,
    percent,
    score_steps,
    step_figures,
)
from stridetwin.reference.norms import read_reference, read_reference_rows
from stridetwin.scenarios.exo_geometry import nominal_geometry
from stridetwin.sim.twin import Twin
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Footprint, Sample
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.result import CaseRow, Collected
from stridetwin.studies.tables import table_lines

ESTIMATORS = ("contact_terrain",)
"""Estimators whose parameters `--set` changes here."""

CASES = {
    "LW": ("shim_level", ""),
    "SA": ("shim_stairs", "SA"),
    "SD": ("shim_stairs", "SD"),
    **{
        f"{mode}{i}": (walk, mode)
        for i, walk in enumerate(("shim_ramp_5", "shim_ramp_6", "shim_ramp_14"), start=1)
        for mode in ("RA", "RD")
    },
}
"""Case of the table to walk and mode; "" takes the whole walk."""
_CLASSES = "classification_accuracy_pct"  # figure of the share of right classes
_Trials = list[tuple[int, dict[str, list[ScoredStep]]]]  # of each trial: subject, and walk to steps by one method
FIGURES = ("d_rmse_mm", "h_rmse_mm", "y_rmse_mm", "slope_rmse_deg", "elevation_rmse_mm")
"""RMS errors of the table: displacement per step forward, up and left, slope, and elevation."""


CaseFigures = dict[str, dict[str, float]]
"""Figures by case of the table; `all` is over all steps."""


class TrialRow(CaseRow):
    """The row of a trial, see `run_case`.

    Attributes:
        subject: Number of the subject.
        fell: Walks that ended by a fall.
        walks: Walk to method to the rows of its steps.
        false_steps: Method to the number of estimated steps that did not happen.
    """

    subject: int
    fell: list[str]
    walks: dict[str, dict[str, list[StepRow]]]
    false_steps: dict[str, int]


class ShimCollected(Collected[dict[str, CaseFigures], dict[str, CaseFigures]]):
    """Figures by method and case beside those of `Shim et al. 2019`.

    Attributes:
        by_subject: By method and subject, such as `S1`, the figures by case.
    """

    by_subject: dict[str, dict[str, CaseFigures]]


class ShimResult(ShimCollected):
    """The result of the experiment, with the rows of its trials."""

    cases: list[TrialRow]


def run_case(case: ExperimentCase) -> Row:
    """Runs every method on one trial of one subject.

    Returns:
        The case's row with `fell`, `walks`: walk to method to the rows of its steps; and `false_steps`: method to the
        number of estimated steps that did not happen.
    """
    methods = (*METHODS, *case.estimators)
    fell = []  # names of the walks that ended by a fall
    walks: dict[str, dict[str, list[StepRow]]] = {}
    false_counts = dict.fromkeys(methods, 0)
    for walk in case.walks():
        twin = Twin(walk.config, case.seed)
        samples, footprints = simulate_walk(twin)
        exo = nominal_geometry(twin.size, twin.rig, case.seed, ())
        walks[walk.config.name] = {}
        for method in methods:
            estimates = estimate_steps(method, twin.rig, exo, samples)
            walks[walk.config.name][method] = [s.row() for s in score_steps(footprints, estimates)]
            false_counts[method] += false_steps(footprints, estimates)
        if twin.fell_at is not None:
            fell.append(walk.config.name)
    return case.row(fell=fell, walks=walks, false_steps=false_counts)


def estimate_steps(name: str, rig: Rig, exo: Exoskeleton, samples: Iterable[Sample]) -> list[StepEstimate]:
    """Runs one of `METHODS`, or an installed estimator of steps, on the samples of a walk.

    Args:
        name: The method or the estimator.
        rig: Nominal rig.
        exo: Nominal geometry of the exoskeleton.
        samples: In time order.

    Returns:
        The last estimate of each step, in order.
    """
    if name in METHODS:
        keywords = parameter_keywords(ContactTerrain, name)
        return ContactTerrain(rig, options=Options(method=name), exoskeleton=exo, **keywords).run(iter(samples))
    # an installed estimator runs with the first of its methods, and gets the geometry as metadata, as from a recording
    estimator_class = registry.estimator(name)
    options = Options(method=estimator_class.declaration.methods[0], metadata={METADATA_KEY: to_text(exo)})
    estimator = estimator_class(rig, options=options, **parameter_keywords(estimator_class, options.method))
    last: dict[int, StepEstimate] = {}  # last estimate by number of the step; 0 is standing at the start
    for sample in samples:
        estimate = estimator.update(sample)
        if isinstance(estimate, StepEstimate) and estimate.step > 0:
            last[estimate.step] = estimate
    return [last[step] for step in sorted(last)]


def simulate_walk(twin: Twin) -> tuple[list[Sample], list[Footprint]]:
    """Simulates a walk without writing a recording.

    Returns:
        The sensors' samples in time order, and the true footprints.
    """
    samples: list[Sample] = []
    footprints = []
    for chunk in twin.blocks():  # what happens in one stretch of the walk: blocks of samples by topic, and footprints
        blocks = [item for item in chunk if isinstance(item, Block) and not item.topic.startswith("/truth")]
        samples += merge(*blocks, key=lambda s: s.t_ns)
        footprints += [item for item in chunk if isinstance(item, Footprint)]
    return samples, footprints


def collect(results: list[TrialRow]) -> ShimCollected:
    """Figures by method and case beside the paper's totals; `by_subject` has those of each subject."""
    summary: dict[str, CaseFigures] = {}
    by_subject: dict[str, dict[str, CaseFigures]] = {}
    for method in results[0]["false_steps"]:
        # of each row the steps of this method: walk to method to rows becomes walk to steps
        trials = [
            (
                r["subject"],
                {
                    walk: [ScoredStep(**row) for row in rows_of_method[method]]
                    for walk, rows_of_method in r["walks"].items()
                },
            )
            for r in results
        ]
        subjects = {who for who, _ in trials}
        # the published method has no classes of its own: a support vector machine gives them; `classed` are the
        # subjects whose steps have classes
        trials, classed = _classify_steps(trials) if method == "published" else (trials, subjects)
        summary[method] = _figures_by_case(trials, classed)
        summary[method]["all"]["false_steps"] = sum(r["false_steps"][method] for r in results)
        by_subject[method] = {
            f"S{who}": _figures_by_case([(w, walks) for w, walks in trials if w == who], classed)
            for who in sorted(subjects)
        }
    return {"summary": summary, "paper": {"Shim et al. 2019": read_paper_figures("Stotal")}, "by_subject": by_subject}


def _classify_steps(trials: _Trials) -> tuple[_Trials, set[int]]:
    """Classifies each subject's steps by a support vector machine that is trained on all other subjects (Table 7).

    Args:
        trials: Subject, and walk to steps, of each trial.

    Returns:
        The trials with classified steps, and the subjects with a machine: training data from the other subjects may be
        insufficient.
    """
    machines = {}  # by subject, trained on the others
    for who in {subject for subject, _ in trials}:
        steps = [
            step
            for subject, walks in trials
            if subject != who
            for walk_steps in walks.values()
            for step in walk_steps
            if step.is_matched
        ]
        if len({s.mode for s in steps}) > 1:  # a machine needs at least two classes
            slopes, elevations = [s.estimated_slope for s in steps], [s.estimated_elevation for s in steps]
            machines[who] = TerrainSvm(slopes, elevations, [s.mode for s in steps])

    def classify(who: int, step: ScoredStep) -> ScoredStep:
        """The step with the class that the subject's machine gives it; unchanged without machine or estimate."""
        machine = machines.get(who)
        if machine is None or not step.is_matched:
            return step
        return replace(step, estimated_mode=machine.classify(step.estimated_slope, step.estimated_elevation))

    classified_trials = [
        (who, {walk: [classify(who, s) for s in walk_steps] for walk, walk_steps in walks.items()})
        for who, walks in trials
    ]
    return classified_trials, set(machines)


def _figures_by_case(trials: _Trials, classed: set[int]) -> dict[str, dict[str, float]]:
    """Figures by case of the table, and over all walks (`all`).

    Args:
        trials: Subject, and steps by walk, of each trial.
        classed: Subjects whose classes count; without any, classes are left out.
    """
    rows = {}
    for case, (walk, mode) in CASES.items():
        # subject, and the steps of this mode ("" for all) of each trial
        chosen = [(who, [s for s in walks[walk] if not mode or s.mode == mode]) for who, walks in trials]
        # errors of the displacement per step, m: forward, up, left
        displacements = [error for _, walks in trials for error in displacement_errors(walks[walk], mode)]
        rows[case] = _figures(chosen, displacements, classed)
        # the sideways error after the best rotation of the whole path about the vertical
        sideways_mm = [1e3 * y for _, walks in trials for _, _, y in displacement_errors(align_yaw(walks[walk]), mode)]
        rows[case]["y_turned_rmse_mm"] = float(np.sqrt(np.mean(np.square(sideways_mm)))) if sideways_mm else 0.0
    all_walks = [(who, walk_steps) for who, walks in trials for walk_steps in walks.values()]
    rows["all"] = _figures(all_walks, [], classed)
    classified_steps = [s for who, walk_steps in all_walks if who in classed for s in walk_steps]
    if classified_steps:
        for mode in MODES:
            rows["all"][f"accuracy_{mode}_pct"] = percent(
                s.estimated_mode == s.mode for s in classified_steps if s.mode == mode
            )
    return rows


def _figures(
    walks: Sequence[tuple[int, list[ScoredStep]]],
    displacements: Sequence[tuple[float, float, float]],
    classed: set[int],
) -> dict[str, float]:
    """Errors and coverage of the steps of some walks (`step_figures`), with right classes only of some subjects.

    Args:
        walks: Subject and steps of each walk.
        displacements: Errors of the displacement per step, m, forward, up and left (`displacement_errors`); empty to
            leave them out.
        classed: Subjects whose classes count; without any of their steps, the classes are left out.
    """
    figures = step_figures([s for _, walk_steps in walks for s in walk_steps], displacements)
    classified_steps = [s for who, walk_steps in walks if who in classed for s in walk_steps]
    # the share of right classes of all subjects gives way to that of the subjects with classes
    del figures[_CLASSES]
    return figures | (
        {_CLASSES: percent(s.estimated_mode == s.mode for s in classified_steps)} if classified_steps else {}
    )


def read_paper_figures(who: str) -> dict[str, dict[str, float]]:
    """The paper's table: case to its RMS errors by name (`FIGURES`), as far as the paper reports them.

    Args:
        who: Subject, S1-S7, or Stotal.
    """
    rows = [row for row in read_reference_rows("shim2019_table5") if row["subject"] == who]
    return {row["case"]: {name: float(row[name]) for name in FIGURES if row[name]} for row in rows}


# header, width, and format of a case's figures: each error beside the paper's, then ours alone
_COLUMNS = (
    *(
        column
        for head, figure in zip(("d mm", "h mm", "y mm", "slope °", "elevation mm"), FIGURES)
        for column in (
            (head, 8 + 5 * (head == "elevation mm"), f"{{{figure}:.2f}}"),
            ("paper", 9, f"{{paper_{figure}:.2f}}"),
        )
    ),
    ("y, aligned", 12, "{y_turned_rmse_mm:.2f}"),
    ("slope in 95 %", 15, "{slope_in_95_pct:.0f}"),
    ("elev. in 95 %", 15, "{elevation_in_95_pct:.0f}"),
    ("class %", 9, f"{{{_CLASSES}:.1f}}"),
    ("steps", 7, "{steps}"),
    ("missed", 8, "{steps_missed}"),
)


def table(result: ShimResult) -> list[str]:
    """Each method's figures by case beside the paper's, as lines of text, with classes by mode and by subject."""
    paper_figures = result["paper"]["Shim et al. 2019"]
    lines = [
        f"{len(result['cases'])} trials, walks that ended by a fall: {sum(len(c['fell']) for c in result['cases'])}",
        "d, h, y: RMS error of the displacement per step, forward, up and left",
        "y, aligned: the same after the whole path is rotated: its heading is that with which the AHRSs start",
    ]
    for method, summary in result["summary"].items():
        # label and figures of each line: the paper's under the name `paper_FIGURE`, then ours
        rows = [
            (case, {**{f"paper_{f}": paper_figures.get(case, {}).get(f, "") for f in FIGURES}, **row})
            for case, row in summary.items()
        ]
        lines += ["", *table_lines(_COLUMNS, rows, 12, method)]
        lines.append(f"estimated steps that did not happen: {summary['all']['false_steps']}")
        modes = "  ".join(f"{mode} {_percent(summary['all'], f'accuracy_{mode}_pct')}" for mode in MODES)
        lines.append(f"correct classes by mode, %: {modes}")
        people = result["by_subject"][method].items()
        by_subject = "  ".join(f"{who} {_percent(subject_figures['all'], _CLASSES)}" for who, subject_figures in people)
        lines.append(f"correct classes by subject, %: {by_subject}")
    return [*lines, "", *_mean_errors(result["summary"])]


def _mean_errors(summary: Mapping[str, CaseFigures]) -> list[str]:
    """Mean and standard deviation of our errors, the paper's, and those of Huo et al. that it quotes, as lines of text.

    Args:
        summary: By method, its figures by case.
    """
    paper_errors = read_reference("shim2019")
    huo = paper_errors["huo_et_al"]
    # figure, name of the line, its cases, and [mean, SD] of both papers
    quoted = [
        ("elevation_mm", "LW", ("LW",), paper_errors["elevation_error_mm"]["LW"], huo["elevation_error_mm"]["LW"]),
        ("elevation_mm", "SA", ("SA",), paper_errors["elevation_error_mm"]["SA"], huo["elevation_error_mm"]["SA_SD"]),
        ("elevation_mm", "SD", ("SD",), paper_errors["elevation_error_mm"]["SD"], huo["elevation_error_mm"]["SA_SD"]),
        (
            "slope_deg", "LW, SA, SD", ("LW", "SA", "SD"), paper_errors["slope_error_deg"]["LW_SA_SD"],
            huo["slope_error_deg"]["LW_SA_SD"],
        ),
    ]  # fmt: skip
    heads = [*summary, "Shim et al. 2019", "Huo et al."]
    lines = [f"{'error, mean ± sd':<26}" + "".join(f"{head:>19}" for head in heads)]
    for figure, case_names, cases, *papers in quoted:
        # mean and standard deviation of each of our methods, then of both papers
        pairs = [_mean_and_sd([rows[case] for case in cases], figure) for rows in summary.values()] + papers
        name, unit = figure.split("_")
        cells = "".join(f"{f'{mean:.2f} ± {sd:.2f}':>19}" for mean, sd in pairs)
        lines.append(f"{f'{name} {unit}, {case_names}':<26}{cells}")
    return lines


def _mean_and_sd(rows: Sequence[dict[str, float]], figure: str) -> tuple[float, float]:
    """Mean and standard deviation of the pooled errors of several cases: sd² = rms² - mean².

    Args:
        rows: Figures of each case.
        figure: Quantity and unit, such as `slope_deg`.

    Returns:
        Both in this unit; 0 without estimated steps.
    """
    name, unit = figure.split("_")
    # estimated steps of each case, which weigh its mean and its mean square
    counts = np.array([row["steps"] - row["steps_missed"] for row in rows])
    if not counts.sum():
        return 0.0, 0.0
    mean, square = (
        float(counts @ values / counts.sum())
        for values in (
            np.array([row[f"{name}_mean_{unit}"] for row in rows]),
            np.array([row[f"{name}_rmse_{unit}"] ** 2 for row in rows]),
        )
    )
    return mean, float(np.sqrt(max(square - mean**2, 0.0)))


def _percent(row: dict[str, float], name: str) -> str:
    """A figure of a row as text; - if the row lacks it."""
    return f"{row[name]:.1f}" if name in row else "-"
