"""Figures of steps estimated from the legs: planes and normals from the side, footprints from above; true to scale."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stridetwin.evaluation.step_scores import ScoredStep
from stridetwin.evaluation.truth import along_way
from stridetwin.report.figures_path import GROUND, INK, to_scale
from stridetwin.report.svg import Plot, data_range, wide_and_narrow
from stridetwin.sim.world.route import Layout
from stridetwin.streams.samples import Array

_PLANE_M, _NORMAL_M = 0.26, 0.16
_TOLD, _NORMAL = "#0a7d7d", "#c92a2a"


def steps_from_aside(layout: Layout | None, steps: Sequence[ScoredStep], title: str = "Planes under the feet") -> str:
    """Side view: the true ground along the route, and the estimated plane and normal of each footprint.

    Args:
        layout: True ground; None draws the footprints alone.
        steps: Steps of one walk; missed ones are left out.
        title: Title of the figure.
    """
    true, told, slopes = _places(steps)
    s = true[:, 0] if layout is None else along_way(true, layout)
    heading = np.zeros(len(s)) if layout is None else layout.way.heading(s)
    error = told - true
    s_told = s + error[:, 0] * np.cos(heading) + error[:, 1] * np.sin(heading)
    profile = layout.profile if layout else ()
    span_s = data_range(s, s_told, include=(float(s[0]) - 0.8, float(s[-1]) + 0.8), margin=0.0)
    floor = min((strip.z0 for strip in profile), default=float(true[:, 2].min())) - 0.1
    span_z = data_range(true[:, 2], told[:, 2], include=(floor, float(told[:, 2].max()) + 0.3), margin=0.0)

    def draw(width: float) -> Plot:
        height, x, z = to_scale(width, span_s, span_z, least=90.0)
        plot = Plot(width=width, height=height, x=x, y=z, title=title, x_label="along, m", y_label=f"{title}, m")
        for strip in profile:
            ends = np.clip([strip.s0, strip.s1], *x)
            if ends[1] > ends[0]:
                ground = np.interp(ends, [strip.s0, strip.s1], [strip.z0, strip.z1])
                plot.polygon(np.r_[ends, ends[::-1]], np.r_[ground, z[0], z[0]], GROUND[strip.terrain])
        for at, up, slope in zip(s_told, told[:, 2], slopes):
            along = _PLANE_M * np.array([-0.1, 0.9])
            plot.line(at + along * np.cos(slope), up + along * np.sin(slope), _TOLD, stroke=2.4)
            foot = np.array([at, up]) + 0.4 * _PLANE_M * np.array([np.cos(slope), np.sin(slope)])
            tip = foot + _NORMAL_M * np.array([-np.sin(slope), np.cos(slope)])
            plot.line([foot[0], tip[0]], [foot[1], tip[1]], _NORMAL, stroke=1.2)
        return plot

    return wide_and_narrow(draw)


def steps_from_above(layout: Layout | None, steps: Sequence[ScoredStep], title: str = "The path from above") -> str:
    """Plan view: the ground, the true footprints, and the path through the estimated ones."""
    true, told, _ = _places(steps)
    span_x, span_y = data_range(true[:, 0], told[:, 0]), data_range(true[:, 1], told[:, 1], margin=0.1)

    def draw(width: float) -> Plot:
        height, x, y = to_scale(width, span_x, span_y)
        plot = Plot(width=width, height=height, x=x, y=y, title=title, x_label="x, m", y_label=f"{title}, m")
        for slab in layout.slabs if layout else ():
            corners = slab.point([0, slab.length, slab.length, 0], [-slab.right, -slab.right, slab.left, slab.left])
            plot.polygon(np.clip(corners[:, 0], *x), np.clip(corners[:, 1], *y), GROUND[slab.terrain])
        plot.dots(true[:, 0], true[:, 1], INK, radius=2.0, label="true footprints")
        plot.line(told[:, 0], told[:, 1], _TOLD, stroke=1.6, label="told by the legs")
        return plot

    return wide_and_narrow(draw)


def _places(steps: Sequence[ScoredStep]) -> tuple[Array, Array, Array]:
    """(N, 3) true and estimated positions of the estimated steps, both in the true world, and (N,) estimated slopes.

    The first estimated position is aligned with the true one; headings are those of the AHRS.
    """
    seen = [s for s in steps if s.seen]
    true, told = np.array([s.place for s in seen]), np.array([s.estimated_place for s in seen])
    return true, told - told[0] + true[0], np.array([s.estimated_slope for s in seen])
