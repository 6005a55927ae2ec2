"""Figures of predicted steps: from above, modes over time, lead times; and the section of a report with them."""

from __future__ import annotations

import math
from itertools import groupby

import numpy as np
from markupsafe import Markup

from stridetwin.estimators.locomotion_mode import MODES, ModeEstimate
from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.base import Scores
from stridetwin.outputs.modes.scores import SCORES, ModeScores
from stridetwin.outputs.modes.true_steps import first_steps, predictions_by_step
from stridetwin.outputs.route_figures import StraightenedRoute, outline
from stridetwin.outputs.score_rows import score_rows
from stridetwin.outputs.terrain.grid import CLASS_COLORS, CLASS_NAMES, GROUND_CLASSES
from stridetwin.pages.html import boxes, section, table
from stridetwin.pages.plot import ERROR, INK, MUTED, Plot, faint
from stridetwin.reference.norms import read_reference
from stridetwin.streams.samples import Array

# colour of each mode, such as "#46aa5a"
_HEX = {name: "#" + bytes(rgb).hex() for name, rgb in zip(GROUND_CLASSES, CLASS_COLORS)}
_WITHIN_95 = 2.448  # standard deviations that contain 95 % of a normal density in the plane
_ANGLES = np.linspace(0.0, 2.0 * math.pi, 25)  # of the points of an ellipse, rad; the first one comes again at the end
_LEAD = (
    "From depth camera, visual-inertial odometry and insoles: the mode of each coming step, and the footprints "
    "predicted one step before, with their 95 % ellipses. Drift of the odometry counts as an error of its path only."
)
_NOTE = (
    "Zhao et al. 2023, tables II and III: mean and standard deviation over 540 walks of real people; the paper "
    "reports none of the other scores. For orientation, not for ranking."
)


def ellipse(middle: Array, covariance: Array) -> Array:
    """(25, 2) m, closed outline of the ellipse that contains 95 % of a normal density in the plane.

    They are m + 2.448 E diag(√λ) (cos φ, sin φ), with eigenvalues λ and eigenvectors E of the covariance.

    Args:
        middle: (2,) or (3,) m, mean m of the density; a height is ignored.
        covariance: (2, 2) m².
    """
    variances, axes = np.linalg.eigh(covariance)
    half_axes = _WITHIN_95 * np.sqrt(np.maximum(variances, 0.0))  # rounding may leave a variance just below 0
    unit_circle = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
    return np.asarray(middle[:2] + (unit_circle * half_axes) @ axes.T)


def steps_from_above(estimates: list[ModeEstimate], scores: ModeScores, walk: AlignedWalk) -> Markup:
    """The true terrain and footprints along the straightened route, and each footprint as predicted one step before.

    The route is cut into rows, true to scale.

    Args:
        estimates: In time order.
        scores: The scored steps, which tell the wrong modes.
        walk: The walk beside the truth.
    """
    straight = StraightenedRoute(walk)
    predicted = _straighten_predictions(straight, estimates, walk)
    rows, title = straight.rows(straight.span_m), "Coming steps from above"
    return Markup("").join(_draw_row(straight, predicted, scores, title, rows, number) for number in range(len(rows)))


_Predicted = tuple[Array, Array, str]
"""A footprint, (4, 2) m along the route and to the left of it, its covariance in these axes, and its mode."""


def _straighten_predictions(
    straight: StraightenedRoute, estimates: list[ModeEstimate], walk: AlignedWalk
) -> list[_Predicted | None]:
    """Each true footprint as predicted when the previous foot had landed, along the straightened route.

    None for a footprint without such a prediction, such as the two initial ones.

    Args:
        straight: The straightened route.
        estimates: In time order.
        walk: The walk beside the truth.
    """
    straightened: list[_Predicted | None] = [None] * len(walk.footprints)
    # from footprint 2 on: the two initial ones are not steps
    for i, first_prediction in enumerate(first_steps(walk.footprints, estimates), 2):
        if first_prediction is None:
            continue
        estimate, step = first_prediction
        alignment = walk.alignment.at(estimate.t_ns)
        # the true outline, shifted by the error of the predicted place
        shift = alignment.to_true(step.p_foot_in_world[:2]) - walk.footprints[i].p_foot_in_world[:2]
        # (2, 2) from the odometry's world over the true one to the axes along and across the route
        rotation = straight.rotation(i) @ alignment.rotation
        place = straight.straighten(i, outline(walk.footprints[i]) + shift)
        straightened[i] = place, rotation @ step.covariance @ rotation.T, step.mode
    return straightened


def _draw_row(
    straight: StraightenedRoute,
    predicted: list[_Predicted | None],
    scores: ModeScores,
    title: str,
    rows: list[tuple[float, float]],
    number: int,
) -> Markup:
    """One row of the figure: terrain, true and predicted footprints, 95 % ellipses, and marks for wrong modes.

    Args:
        straight: The straightened route.
        predicted: Prediction of each true footprint; None where there was none.
        scores: The scored steps, which tell the wrong modes.
        title: Of the whole figure.
        rows: Begin and end of each row along the route, m.
        number: Number of this row.
    """
    span = rows[number]
    plot = straight.plot_row(title, number, rows)
    if number == 0:
        straight.draw_terrain_keys(plot)
    straight.draw_terrain(plot, span)
    straight.draw_footprints(plot, span)
    shown = straight.footprints_within(span)
    predictions = [prediction for i in shown if (prediction := predicted[i]) is not None]
    ellipses = [
        ellipse(corners.mean(axis=0), covariance)
        for corners, covariance, _ in predictions
        if np.isfinite(covariance).all()
    ]
    plot.areas(ellipses, faint(MUTED, 0.2), label="95 % ellipse")
    for mode in dict.fromkeys(mode for _, _, mode in predictions):
        # closed: the first corner comes again at the end
        of_mode = [corners for corners, _, predicted_mode in predictions if predicted_mode == mode]
        outlines = [np.vstack([corners, corners[:1]]) for corners in of_mode]
        plot.curves(outlines, _HEX[mode], width=2.0, label="predicted footprint, in its mode's colour")
    steps = scores.steps
    # the two initial footprints are not steps: footprint i belongs to step i - 2
    wrong = [
        straight.footprints[i].mean(axis=0) for i in shown if 2 <= i < len(steps) + 2 and not steps[i - 2].is_correct
    ]
    _draw_crosses(plot, np.reshape(wrong, (-1, 2)))
    return plot.html()


def _draw_crosses(plot: Plot, at: Array) -> None:
    """Marks errors by crosses.

    Args:
        plot: The figure.
        at: (N, 2) x and y of each cross in the figure; without any, the legend has no entry.
    """
    if len(at):
        plot.dots(at[:, 0], at[:, 1], ERROR, size=10, symbol="x", label="wrong")


def mode_ribbon(estimates: list[ModeEstimate], scores: ModeScores, walk: AlignedWalk) -> str:
    """Figure over time: the true mode of each step, the predicted next mode with its probability, and the errors.

    It is "" without steps or predictions.

    Args:
        estimates: In time order.
        scores: The scored steps.
        walk: The walk beside the truth.
    """
    steps = scores.steps
    estimates = [e for e in estimates if e.steps]
    if not steps or not estimates:
        return ""
    runs = prediction_runs(estimates, scores, walk)
    first_begin, *_ = runs[0]
    begin, end = min(first_begin, steps[0].t_s), steps[-1].t_s + 0.3  # of the time axis, s
    t = np.array([e.t_ns * 1e-9 for e in estimates])
    # (N,) probability of the next step's predicted mode
    p = np.array([e.steps[0].probability for e in estimates])
    plot = Plot(
        title="Modes over time",
        x=(begin, end),
        y=(-0.08, 3.9),
        x_label="time, s",
        y_label="mode, probability",
        height=270,
        y_names={3.4: "true", 2.4: "predicted", 1.6: "p = 1", 0.8: "p = 0.5", 0.0: "p = 0"},
    )
    # bars of true modes at heights 3.0-3.8, of predicted ones at 2.0-2.8, of errors below these; the curve of the
    # probability p is at 0 to 1.6
    # the bar of a step reaches from the previous touch-down to its own
    touched = np.array([begin, *(step.t_s for step in steps)])
    for mode in MODES:
        true = np.array([step.mode == mode for step in steps])
        plot.bars(touched[:-1][true], touched[1:][true], 3.0, 3.8, _HEX[mode], label=CLASS_NAMES[mode])
        spans = np.array([(since, min(until, end)) for since, until, m, _ in runs if m == mode]).reshape(-1, 2)
        plot.bars(spans[:, 0], spans[:, 1], 2.0, 2.8, _HEX[mode], label=CLASS_NAMES[mode])
    wrong = np.array([(since, min(until, end)) for since, until, _, right in runs if not right]).reshape(-1, 2)
    plot.bars(wrong[:, 0], wrong[:, 1], 1.86, 1.98, ERROR, label="wrong")
    _draw_crosses(plot, np.array([(step.t_s, 2.4) for step in steps if not step.is_correct]).reshape(-1, 2))
    plot.line(t[t < end], 1.6 * p[t < end], INK, width=1.0, label="probability")
    return plot.html()


def prediction_runs(
    estimates: list[ModeEstimate], scores: ModeScores, walk: AlignedWalk
) -> list[tuple[float, float, str, bool]]:
    """Time spans in which the predicted mode of the coming step stays the same.

    A span ends where an estimate with another mode follows, at the latest at touch-down. The one that ends at
    touch-down is scored.

    Args:
        estimates: In time order.
        scores: The scored steps of the walk.
        walk: The walk, whose first two footprints are the initial ones.

    Returns:
        For each span its begin and end, s, the mode, and whether it is right.
    """
    steps = scores.steps
    by_step = predictions_by_step(walk.footprints[2:], estimates)
    runs = []
    before = -math.inf  # touch-down of the previous step, s
    for step, predictions in zip(steps, by_step):
        # time and predicted mode of each estimate since the previous touch-down; an estimate e predicts the step as
        # e.steps[k]
        timed_modes = [(e.t_ns * 1e-9, e.steps[k].mode) for e, k in predictions if e.t_ns * 1e-9 > before]
        ends = [*(t for t, _ in timed_modes[1:]), step.t_s]  # an estimate holds until the next one
        intervals = [(begin, end, mode) for (begin, mode), end in zip(timed_modes, ends)]
        for mode, consecutive in groupby(intervals, key=lambda interval: interval[2]):
            of_mode = list(consecutive)
            (run_begin, _, _), (_, run_end, _) = of_mode[0], of_mode[-1]
            runs.append((run_begin, run_end, mode, mode in step.allowed))
        before = step.t_s
    return runs


def lead_times(scores: ModeScores) -> str:
    """Bars of how long before each touch-down its mode was finally predicted right, s; "" without steps.

    A dot marks a step that changes the mode, a cross one whose mode was predicted wrong.
    """
    steps = scores.steps
    if not steps:
        return ""
    t, lead = np.array([s.t_s for s in steps]), np.array([s.lead_s for s in steps])
    # half width of a bar, from the usual time between two steps
    half = 0.3 * float(np.median(np.diff(t))) if len(steps) > 1 else 0.2
    top = 1.1 * max(1.0, float(lead.max()))
    plot = Plot(
        title="Lead time",
        x=(t[0] - 0.6, t[-1] + 0.6),
        y=(0.0, top),
        height=250,
        x_label="touch-down, s",
        y_label="lead time, s",
    )
    for mode in MODES:
        is_right = np.array([s.mode == mode and s.lead_s > 0 for s in steps])
        plot.bars(t[is_right] - half, t[is_right] + half, 0.0, lead[is_right], _HEX[mode], label=CLASS_NAMES[mode])
    changes = np.array([s.is_transition for s in steps])
    if changes.any():
        plot.dots(t[changes], lead[changes], INK, label="changes the mode")
    # crosses stand just above the axis
    _draw_crosses(plot, np.array([(s.t_s, 0.06 * top) for s in steps if not s.is_correct]).reshape(-1, 2))
    return plot.html()


def mode_section(estimates: list[ModeEstimate], modes: ModeScores, walk: AlignedWalk, scores: Scores) -> str:
    """The steps from above, modes over time, lead times, and the scores of one estimator beside the paper's.

    Args:
        estimates: Predictions in time order.
        modes: Every true step and terrain change, with its prediction.
        walk: The walk beside the truth.
        scores: Scores of the walk.
    """
    figures = [steps_from_above(estimates, modes, walk), mode_ribbon(estimates, modes, walk), lead_times(modes)]
    return section("Coming steps", _LEAD, boxes([*figures, _score_table(scores)]), "stack")


def _score_table(scores: Scores) -> str:
    """A table of the scores of a walk, with the accuracy that Zhao 2023 reports beside ours."""
    paper = read_reference("zhao2023")["generality"]["accuracy_pct"]
    published = {"accuracy_pct": f"{paper['mean']:.2f} ± {paper['sd']:.2f}"}
    rows = []
    for score in SCORES:
        for row in score_rows([score], [scores]):  # one row, or none without a label or a value
            rows.append((*row, published.get(score.name, "\N{EN DASH}")))
    return table(("Score", "this walk", "Zhao et al. 2023"), rows, (1, 2), note=_NOTE)
