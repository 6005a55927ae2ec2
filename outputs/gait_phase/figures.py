"""Figures of gait phases: true and estimated phase over time, and the error over the cycle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from stridetwin.estimators.base import FOOT_NAMES
from stridetwin.outputs.gait_phase.scores import (
    RAMP,
    SCORES,
    STAIRS,
    EvaluatedPhases,
    PhaseSeries,
    Stride,
    phase_errors,
    true_phase,
)
from stridetwin.outputs.score_rows import score_table
from stridetwin.pages.html import boxes, section
from stridetwin.pages.plot import INK, PALETTE, Plot, data_range
from stridetwin.streams.samples import Array

_TERRAIN_COLORS = {"level": PALETTE[2], STAIRS: PALETTE[0], RAMP: PALETTE[5]}


def phase_over_time(series: PhaseSeries, strides: Sequence[Stride]) -> Markup:
    """The true and the estimated phase of one leg, and the parts of the walk whose strides count."""
    t_s = series.t_ns * 1e-9
    plot = Plot(
        title=f"Gait phase, {FOOT_NAMES[series.foot]} leg",
        x=data_range(t_s, margin=0.01),
        y=(-2.0, 102.0),
        x_label="time, s",
        y_label="phase, %",
        height=240,
        hover="x",
    )
    for stride in strides:
        if not stride.is_pause:
            # until just before the next touch-down, where the phase falls from 1 to 0
            true_t_ns = np.array([stride.begin_ns, stride.end_ns - 1])
            plot.line(true_t_ns * 1e-9, 100.0 * true_phase(true_t_ns, stride), INK, width=3.0, label="truth")
    estimated = np.where(series.walking, 100.0 * series.phase, np.nan)
    plot.line(t_s, _break_at_wraps(estimated), PALETTE[1], label="estimate")
    return plot.html()


def _break_at_wraps(phase_pct: Array) -> Array:
    """(N,) phases, %, with NaN for the first sample of each new cycle, so that no line is drawn from 100 to 0 %."""
    curve = phase_pct.copy()
    curve[1:][np.diff(phase_pct) < -50.0] = np.nan
    return curve


def error_over_cycle(series: PhaseSeries, strides: Sequence[Stride]) -> Markup:
    """Errors of the phase over the true phase, one curve per stride, by terrain."""
    curves: dict[str, list[Array]] = {}  # by terrain, a curve per stride: (N, 2) true phase and error, %
    for stride in strides:
        if stride.is_pause:
            continue
        # (N,) errors and true phases of the stride's samples, shares of the cycle
        errors, _ = phase_errors(series, stride)
        begin, end = np.searchsorted(series.t_ns, (stride.begin_ns, stride.end_ns))
        true_phases = true_phase(series.t_ns[begin:end], stride)
        curves.setdefault(stride.terrain, []).append(100.0 * np.column_stack([true_phases, errors]))
    all_errors = [curve[:, 1] for of_terrain in curves.values() for curve in of_terrain]
    plot = Plot(
        title=f"Error over the cycle, {FOOT_NAMES[series.foot]} leg",
        x=(0.0, 100.0),
        x_label="true phase, %",
        y=data_range(*all_errors, include=(-5.0, 5.0)),
        y_label="estimated minus true, %",
        height=240,
    )
    for terrain, of_terrain in curves.items():
        plot.curves(of_terrain, _TERRAIN_COLORS[terrain], width=1.0, label=terrain)
    return plot.html()


def phase_section(legs: Sequence[EvaluatedPhases]) -> str:
    """Section of a report: phase over time, error over the cycle, and scores of each leg."""
    figures = [figure(leg.estimates, leg.strides) for leg in legs for figure in (phase_over_time, error_over_cycle)]
    scores = score_table(SCORES, {leg.name: leg.scores for leg in legs})
    lead = (
        "From the IMU of each foot alone: 0 % where the foot touches down, 100 % where it does so again. The truth "
        "grows linearly between the true touch-downs."
    )
    return section("Gait phase", lead, boxes([*figures, scores]), "stack")
