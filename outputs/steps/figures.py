"""Figures of steps estimated from the legs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from stridetwin.outputs.base import Scores
from stridetwin.outputs.route_figures import FOOT_M, draw_profile, draw_slabs
from stridetwin.outputs.steps.scores import ScoredStep
from stridetwin.outputs.truth import project_on_way
from stridetwin.pages.html import boxes, number_text, section
from stridetwin.pages.plot import INK, PALETTE, Plot, data_range
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array
from stridetwin.streams.terrain_truth import Layout, terrain_layout

_NORMAL_M = 0.16  # length of a drawn normal
_PLANE, _NORMAL = PALETTE[2], PALETTE[1]  # colours


def steps_from_aside(
    layout: Layout | None, steps: Sequence[ScoredStep], title: str = "Planes under the feet"
) -> Markup:
    """Side view of one walk: the true ground along the route, and the estimated plane and normal of each footprint.

    Args:
        layout: The true terrain; without it, the world's x counts as the place along the route.
        steps: Steps of the walk; those with an estimate are drawn.
        title: Title of the figure.
    """
    true, estimated, slopes = _step_positions(steps)  # (N, 3) m, (N, 3) m and (N,) rad, in the true world
    s = true[:, 0] if layout is None else project_on_way(true, layout)
    heading = np.zeros(len(s)) if layout is None else layout.way.heading(s)
    error = estimated - true
    # (N, 2) estimated places in the figure: along the route, height; shifted by the error along the route
    at = np.column_stack([s + error[:, 0] * np.cos(heading) + error[:, 1] * np.sin(heading), estimated[:, 2]])
    profile = layout.profile if layout else ()
    # the figure shows 0.8 m before the first step and after the last, 0.1 m below the ground and 0.3 m above the feet
    span_s = data_range(s, at[:, 0], include=(float(s[0]) - 0.8, float(s[-1]) + 0.8), margin=0.0)
    floor = min((strip.z0 for strip in profile), default=float(true[:, 2].min())) - 0.1
    span_z = data_range(true[:, 2], at[:, 1], include=(floor, float(at[:, 1].max()) + 0.3), margin=0.0)
    plot = Plot(title=title, x=span_s, y=span_z, x_label="along the route, m", y_label="height, m", to_scale=True)
    draw_profile(plot, profile, span_s, span_z[0])
    # (N, 2) unit vectors along each plane and normal to it; a foot reaches from a tenth of its length behind the place
    # (`heel`) forward (`toe`), and the normal stands on its middle
    along = np.column_stack([np.cos(slopes), np.sin(slopes)])
    up = along[:, ::-1] * [-1.0, 1.0]
    middle = at + 0.4 * FOOT_M * along
    heel, toe = at - 0.1 * FOOT_M * along, at + 0.9 * FOOT_M * along
    plot.curves(np.stack([heel, toe], axis=1), _PLANE, width=2.4, label="estimated plane")
    plot.curves(np.stack([middle, middle + _NORMAL_M * up], axis=1), _NORMAL, width=1.4, label="its normal")
    return plot.html()


def steps_from_above(layout: Layout | None, steps: Sequence[ScoredStep], title: str = "The path from above") -> Markup:
    """Plan view: the ground, the true footprints, and the path through the estimated ones.

    Args:
        layout: The true terrain; None draws no ground.
        steps: Steps of the walk; those with an estimate are drawn.
        title: Title of the figure.
    """
    true, estimated, _ = _step_positions(steps)
    x = data_range(true[:, 0], estimated[:, 0])
    y = data_range(true[:, 1], estimated[:, 1], margin=0.1)
    plot = Plot(title=title, x=x, y=y, x_label="x, m", y_label="y, m", to_scale=True)
    draw_slabs(plot, layout, x, y)
    plot.dots(true[:, 0], true[:, 1], INK, size=5, label="true footprints")
    plot.line(estimated[:, 0], estimated[:, 1], _PLANE, label="estimated from the legs")
    return plot.html()


def _step_positions(steps: Sequence[ScoredStep]) -> tuple[Array, Array, Array]:
    """Positions and slopes of the steps that have an estimate.

    The estimated positions are shifted so that the first one agrees with the true one; their heading stays that of the
    AHRS.

    Returns:
        (N, 3) m, true positions; (N, 3) m, estimated positions in the true world; and (N,) rad, estimated slopes.
    """
    matched = [s for s in steps if s.is_matched]
    true, estimated = np.array([s.place for s in matched]), np.array([s.estimated_place for s in matched])
    return true, estimated - estimated[0] + true[0], np.array([s.estimated_slope for s in matched])


def step_section(steps: Sequence[ScoredStep], scores: Scores, recording: Recording) -> str:
    """Section of a report: the steps of one estimator from the side and from above, and their main scores."""
    layout = terrain_layout(recording.metadata)
    figures = (steps_from_aside(layout, steps), steps_from_above(layout, steps))
    end = f"end error {number_text(scores['end_error_m'], 2)} m" if "end_error_m" in scores else "the end is missed"
    lead = (
        "Only from the exoskeleton's AHRS, encoders and insoles: the plane under each footprint and its normal, over "
        f"the true ground. RMS errors: slope {number_text(scores['slope_rmse_deg'], 2)}°, elevation "
        f"{number_text(scores['elevation_rmse_mm'], 1)} mm; "
        f"{number_text(scores['classification_accuracy_pct'], 1)} % of "
        f"{scores['steps']:.0f} steps classified correctly; {end}."
    )
    return section("Terrain estimated from the legs", lead, boxes(figures), "stack")
