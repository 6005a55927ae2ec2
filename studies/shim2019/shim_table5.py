"""Table 5 of Shim et al. 2019 on the simulated walkers: the seven subjects on the terrains of Table 4.

A case is one trial of one subject: level, stair and three ramps, each walked once (stair and ramps up and down). Steps
belong to a case of the table by their mode, which includes those onto and off a terrain. The estimators get a nominal
exoskeleton with measurement errors (`exo_geometry.measured`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from heapq import merge
from typing import Any

import numpy as np

from stridetwin.estimators.base import Options
from stridetwin.estimators.contact_terrain import METHODS, MODES, ContactTerrain, TerrainSvm
from stridetwin.evaluation.norms import reference, reference_rows
from stridetwin.evaluation.step_scores import (
    ScoredStep,
    displacement_errors,
    false_steps,
    percent,
    score_steps,
    step_figures,
    yaw_aligned,
)
from stridetwin.scenarios.exo_geometry import geometry, measured
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.anthropometry import PEOPLE
from stridetwin.streams.samples import Block, Footprint, Sample
from stridetwin.studies.case import Case

SUBJECTS, TRIALS = 7, 10
SEEDS = range(1000, 1000 + SUBJECTS * TRIALS)
SENSORS = ("ahrs", "encoder", "insole")
WALKS = ("shim_level", "shim_stairs", "shim_ramp_5", "shim_ramp_6", "shim_ramp_14")
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
_CLASSES = "classification_accuracy_pct"
_Trials = list[tuple[int, dict[str, list[ScoredStep]]]]  # subject, and walk to steps
FIGURES = ("d_rmse_mm", "h_rmse_mm", "y_rmse_mm", "slope_rmse_deg", "elevation_rmse_mm")


def subject(seed: int) -> int:
    """Number of the subject, 1-7, in turn."""
    return seed % SUBJECTS + 1


def run_case(case: Case) -> dict[str, Any]:
    """One trial of one subject.

    Returns:
        `seed`, `physics`, `subject`, `fell`, `walks`: walk to method to the rows of its steps; and `false_steps`:
        method to the number of estimated steps that did not happen.
    """
    who, fell = subject(case.seed), []
    walks: dict[str, dict[str, list[dict[str, Any]]]] = {}
    false = dict.fromkeys(METHODS, 0)
    for name in WALKS:
        config = load_scenario(name).config
        twin = Twin(
            replace(config, sensors=SENSORS, physics=case.physics, person=PEOPLE[f"shim_s{who}"]), case.seed
        )  # fmt: skip
        rows, footprints = walked(twin)
        told = measured(geometry(twin.size, twin.rig), np.random.default_rng([case.seed, 4]))
        walks[name] = {}
        for method in METHODS:
            estimates = ContactTerrain(twin.rig, options=Options(method=method), exoskeleton=told).run(iter(rows))
            walks[name][method] = [s.row() for s in score_steps(footprints, estimates)]
            false[method] += false_steps(footprints, estimates)
        if twin.fell_at is not None:
            fell.append(name)
    return {
        "seed": case.seed,
        "physics": case.physics,
        "subject": who,
        "fell": fell,
        "walks": walks,
        "false_steps": false,
    }


def walked(twin: Twin) -> tuple[list[Sample], list[Footprint]]:
    """The samples of a walk in time order, and the true footprints."""
    samples: list[Sample] = []
    footprints = []
    for chunk in twin.blocks():
        blocks = [item for item in chunk if isinstance(item, Block) and not item.topic.startswith("/truth")]
        samples += merge(*blocks, key=lambda s: s.t_ns)
        footprints += [item for item in chunk if isinstance(item, Footprint)]
    return samples, footprints


def collect(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Totals by method and case, with the paper's; `by_subject` is the whole table."""
    summary, by_subject = {}, {}
    for method in METHODS:
        trials = [
            (r["subject"], {walk: [ScoredStep(**row) for row in of[method]] for walk, of in r["walks"].items()})
            for r in results
        ]
        subjects = {who for who, _ in trials}
        trials, classed = _classified(trials) if method == "published" else (trials, subjects)
        summary[method] = _table(trials, classed)
        summary[method]["all"]["false_steps"] = sum(r["false_steps"][method] for r in results)
        by_subject[method] = {
            f"S{who}": _table([(w, walks) for w, walks in trials if w == who], classed) for who in sorted(subjects)
        }
    return {"summary": summary, "paper": {"Shim et al. 2019": paper("Stotal")}, "by_subject": by_subject}


def _classified(trials: _Trials) -> tuple[_Trials, set[int]]:
    """Steps classified by a support vector machine, trained on every other subject (Table 7).

    Also the subjects with a result: training data from the other subjects may be insufficient.
    """
    machines = {}
    for who in {w for w, _ in trials}:
        steps = [s for w, walks in trials if w != who for own in walks.values() for s in own if s.seen]
        if len({s.mode for s in steps}) > 1:
            slopes, elevations = [s.estimated_slope for s in steps], [s.estimated_elevation for s in steps]
            machines[who] = TerrainSvm(slopes, elevations, [s.mode for s in steps])

    def told(who: int, step: ScoredStep) -> ScoredStep:
        machine = machines.get(who)
        if machine is None or not step.seen:
            return step
        return replace(step, estimated_mode=machine.classify(step.estimated_slope, step.estimated_elevation))

    found = [(who, {walk: [told(who, s) for s in own] for walk, own in walks.items()}) for who, walks in trials]
    return found, set(machines)


def _table(trials: _Trials, classed: set[int]) -> dict[str, dict[str, float]]:
    """Case to figures; classes come from the subjects in `classed`, and are left out if there are none."""
    rows = {}
    for case, (walk, mode) in CASES.items():
        chosen = [(who, [s for s in walks[walk] if not mode or s.mode == mode]) for who, walks in trials]
        places = [e for _, walks in trials for e in displacement_errors(walks[walk], mode)]
        rows[case] = _figures(chosen, places, classed)
        sideways = [1e3 * y for _, walks in trials for _, _, y in displacement_errors(yaw_aligned(walks[walk]), mode)]
        rows[case]["y_turned_rmse_mm"] = float(np.sqrt(np.mean(np.square(sideways)))) if sideways else 0.0
    everything = [(who, own) for who, walks in trials for own in walks.values()]
    rows["all"] = _figures(everything, [], classed)
    told = [s for who, own in everything if who in classed for s in own]
    if told:
        for mode in MODES:
            rows["all"][f"accuracy_{mode}_pct"] = percent(s.estimated_mode == s.mode for s in told if s.mode == mode)
    return rows


def _figures(
    walks: Sequence[tuple[int, list[ScoredStep]]], places: Sequence[tuple[float, float, float]], classed: set[int]
) -> dict[str, float]:
    """`step_figures`, but classes only from the subjects in `classed`."""
    figures = step_figures([s for _, own in walks for s in own], places)
    told = [s for who, own in walks if who in classed for s in own]
    del figures[_CLASSES]
    return figures | ({_CLASSES: percent(s.estimated_mode == s.mode for s in told)} if told else {})


def paper(who: str) -> dict[str, dict[str, float]]:
    """The paper's table: case to figures.

    Args:
        who: Subject, S1-S7, or Stotal.
    """
    rows = [row for row in reference_rows("shim2019_table5") if row["subject"] == who]
    return {row["case"]: {name: float(row[name]) for name in FIGURES if row[name]} for row in rows}


def table(result: dict[str, Any]) -> list[str]:
    """Each method and the paper, as lines of text."""
    theirs = result["paper"]["Shim et al. 2019"]
    lines = [
        f"{len(result['cases'])} trials, walks that ended by a fall: {sum(len(c['fell']) for c in result['cases'])}",
        "in brackets the paper; d, h, y: error of the displacement a step, forward, up and left",
        "y, turned: left, after the whole way is turned: its heading is that with which the AHRSs start",
    ]
    for method, rows in result["summary"].items():
        lines += [
            "",
            f"{method:<12}{'d mm':>15}{'h mm':>15}{'y mm':>15}{'y, turned':>11}{'slope °':>15}{'elevation mm':>15}"
            f"{'in 95 %':>12}{'class %':>9}{'steps':>7}{'missed':>8}",
        ]
        for case, row in rows.items():
            cells = [_cell(row.get(f), theirs.get(case, {}).get(f)) for f in FIGURES]
            aligned = f"{row['y_turned_rmse_mm']:>11.2f}" if "y_turned_rmse_mm" in row else f"{'':>11}"
            cells.insert(3, aligned)
            lines.append(
                f"{case:<12}{''.join(cells)}{_share(row, 'slope_in_95_pct')}{_share(row, 'elevation_in_95_pct')}"
                f"{_percent(row, _CLASSES):>9}{row['steps']:>7}{row['steps_missed']:>8}"
            )
        lines.append(f"steps told that are none: {rows['all']['false_steps']}")
        modes = "  ".join(f"{mode} {_percent(rows['all'], f'accuracy_{mode}_pct')}" for mode in MODES)
        lines.append(f"right classes by mode, %: {modes}")
        people = result["by_subject"][method].items()
        by_subject = "  ".join(f"{who} {_percent(own['all'], _CLASSES)}" for who, own in people)
        lines.append(f"right classes by subject, %: {by_subject}")
    return [*lines, "", *_mean_errors(result["summary"])]


def _mean_errors(summary: dict[str, Any]) -> list[str]:
    """Mean and standard deviation of errors, the paper's, and those of Huo et al. that it quotes."""
    theirs = reference("shim2019")
    huo = theirs["huo_et_al"]
    quoted = [
        ("elevation_mm", "LW", ("LW",), theirs["elevation_error_mm"]["LW"], huo["elevation_error_mm"]["LW"]),
        ("elevation_mm", "SA", ("SA",), theirs["elevation_error_mm"]["SA"], huo["elevation_error_mm"]["SA_SD"]),
        ("elevation_mm", "SD", ("SD",), theirs["elevation_error_mm"]["SD"], huo["elevation_error_mm"]["SA_SD"]),
        (
            "slope_deg", "LW, SA, SD", ("LW", "SA", "SD"), theirs["slope_error_deg"]["LW_SA_SD"],
            huo["slope_error_deg"]["LW_SA_SD"],
        ),
    ]  # fmt: skip
    heads = [*summary, "Shim et al. 2019", "Huo et al."]
    lines = [f"{'error, mean ± sd':<26}" + "".join(f"{head:>19}" for head in heads)]
    for figure, words, cases, *papers in quoted:
        pairs = [_mean_and_sd([rows[case] for case in cases], figure) for rows in summary.values()] + papers
        name, unit = figure.split("_")
        cells = "".join(f"{f'{mean:.2f} ± {sd:.2f}':>19}" for mean, sd in pairs)
        lines.append(f"{f'{name} {unit}, {words}':<26}{cells}")
    return lines


def _mean_and_sd(rows: Sequence[dict[str, float]], figure: str) -> tuple[float, float]:
    """Mean and standard deviation of the pooled errors of several cases."""
    name, unit = figure.split("_")
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


def _cell(ours: float | None, theirs: float | None) -> str:
    if ours is None:
        return f"{'':>15}"
    return f"{ours:>8.2f}{'' if theirs is None else f'({theirs:.2f})':>7}"


def _percent(row: dict[str, float], name: str) -> str:
    return f"{row[name]:.1f}" if name in row else "-"


def _share(row: dict[str, float], name: str) -> str:
    return f"{row[name]:>6.0f}" if name in row else f"{'-':>6}"
