"""Predicted steps as a table."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stridetwin.estimators.locomotion_mode import MODES, ModeEstimate, StepPrediction
from stridetwin.outputs.csv_tables import LiveTable, csv_row

MODE_COLUMNS = (
    "t_s",
    "step",
    "foot",
    "mode",
    "probability",
    *(f"p_{mode}" for mode in MODES),
    "steady_s",
    "touchdown_s",
    "touchdown_sd_s",
    "x_m",
    "y_m",
    "z_m",
    "forward_sd_m",
    "ground_slope_rad",
    "ground_slope_sd_rad",
    "change_mode",
    "change_distance_m",
    "change_distance_sd_m",
    "change_time_s",
    "riser_m",
    "riser_sd_m",
    "tread_m",
    "tread_sd_m",
    "slope_rad",
    "slope_sd_rad",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class PredictedStep:
    """The last prediction of a step before its foot touched down.

    Attributes:
        estimate: The last estimate before touch-down.
        step: The step in that estimate.
        steady_s: How long its predicted mode had not changed.
    """

    estimate: ModeEstimate
    step: StepPrediction
    steady_s: float


class CompletedSteps:
    """Collects, from consecutive estimates, the last prediction of each completed step.

    After a jump of the poses, where the number of steps falls, it starts again.
    """

    def __init__(self) -> None:
        self._since: dict[int, tuple[str, int]] = {}  # per number of a step: its predicted mode, and since when, ns
        self._before: ModeEstimate | None = None  # the previous estimate

    def add(self, estimate: ModeEstimate) -> PredictedStep | None:
        """Adds an estimate; returns the last prediction of a step completed since the previous estimate, if any.

        A step is completed when the number of landed steps, `ModeEstimate.step`, has grown. The method also notes since
        when each coming step has had its predicted mode (`_since`), which gives `PredictedStep.steady_s`.
        """
        if self._before is not None and estimate.step < self._before.step:  # the poses jumped: start again
            self._since, self._before = {}, None
        before, completed = self._before, None
        if before is not None and estimate.step > before.step:
            step = before.steps[0]  # the step that was the next one
            _, since_ns = self._since[step.step]
            completed = PredictedStep(estimate=before, step=step, steady_s=(before.t_ns - since_ns) * 1e-9)
            # forget the steps that have landed
            self._since = {number: noted for number, noted in self._since.items() if number > estimate.step}
        for step in estimate.steps:
            noted_mode, _ = self._since.get(step.step, ("", 0))  # "" for a step that was not predicted before
            if noted_mode != step.mode:
                self._since[step.step] = step.mode, estimate.t_ns
        self._before = estimate
        return completed

    def steady_s(self, estimate: ModeEstimate) -> float:
        """How long the predicted mode of the next step has not changed, s.

        Args:
            estimate: The last added estimate.
        """
        _, since_ns = self._since[estimate.steps[0].step]
        return (estimate.t_ns - since_ns) * 1e-9


def find_completed_steps(estimates: Iterable[ModeEstimate]) -> list[PredictedStep]:
    """The last prediction of each step that was completed before the last estimate; the estimates are in time order."""
    steps = CompletedSteps()
    return [step for estimate in estimates if (step := steps.add(estimate)) is not None]


def mode_cells(row: PredictedStep) -> list[str]:
    """The cells of `MODE_COLUMNS` for a predicted step; unknown values are empty."""
    step, change = row.step, row.estimate.change
    # unit vector of the walking direction, for the standard deviation of the footprint along it
    heading = np.array([math.cos(row.estimate.heading), math.sin(row.estimate.heading)])
    variance = float(heading @ step.covariance @ heading)
    forward_sd = math.sqrt(variance) if variance >= 0.0 else math.nan
    cells = [
        _cell(row.estimate.t_ns * 1e-9, 3),
        str(step.step),
        step.foot,
        step.mode,
        _cell(step.probability, 4),
        *(_cell(step.probabilities[mode], 4) for mode in MODES),
        _cell(row.steady_s, 3),
        _cell(step.t_ns * 1e-9, 3),
        _cell(step.t_sd_s, 3),
        *(_cell(x, 4) for x in step.p_foot_in_world),
        _cell(forward_sd, 4),
        _cell(step.slope, 4),
        _cell(step.slope_sd, 4),
    ]
    if change is None:  # no coming terrain change: its columns, the last ones, stay empty
        return [*cells, *[""] * (len(MODE_COLUMNS) - len(cells))]
    sizes = (
        change.distance,
        change.distance_sd,
        change.time_s,
        change.riser,
        change.riser_sd,
        change.tread,
        change.tread_sd,
        change.slope,
        change.slope_sd,
    )
    return [*cells, change.mode, *(_cell(size, 4) for size in sizes)]


def _cell(value: float, digits: int) -> str:
    """A number as text with fixed decimals; "" if it is not finite."""
    return f"{value:.{digits}f}" if math.isfinite(value) else ""


class LiveModes(LiveTable):
    """The next step of each estimate as a row in `live`, and a table with the last prediction of each step."""

    def __init__(self, file: Path | None) -> None:
        super().__init__(MODE_COLUMNS, file)
        self._steps = CompletedSteps()

    def add(self, estimate: object) -> str | None:
        """The row of the next step in an estimate as text; None for anything but a `ModeEstimate`.

        If the estimate completes a step, the step's last prediction is kept as a row of the file.
        """
        if not isinstance(estimate, ModeEstimate):
            return None
        if (completed := self._steps.add(estimate)) is not None:
            self.keep(len(self._kept), mode_cells(completed))
        steady_s = self._steps.steady_s(estimate)
        return csv_row(mode_cells(PredictedStep(estimate=estimate, step=estimate.steps[0], steady_s=steady_s)))
