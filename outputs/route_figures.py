"""Drawing of the true terrain and footprints, which the figures of several kinds of output share."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from stridetwin.pages.plot import Plot, Range
from stridetwin.streams.samples import Array, Footprint
from stridetwin.streams.terrain_truth import Layout, Strip

GROUND = {"level": "#dde4ec", "stair": "#c7d6e6", "ramp": "#d3e3d2"}
"""Colour of the ground by terrain."""
FOOT_M, _HALF_FOOT_M = 0.26, 0.045
"""Length and half width of a drawn footprint."""


def draw_profile(plot: Plot, profile: Iterable[Strip], span: Range, floor: float) -> None:
    """The true ground along the route, down to a height, by terrain."""
    for terrain, color in GROUND.items():
        outlines = []
        for strip in profile:
            s0, s1 = np.clip([strip.s0, strip.s1], *span)
            if strip.terrain == terrain and s1 > s0:
                z0, z1 = np.interp([s0, s1], [strip.s0, strip.s1], [strip.z0, strip.z1])
                outlines.append([(s0, z0), (s1, z1), (s1, floor), (s0, floor)])
        plot.areas(outlines, color, label=terrain)


def draw_slabs(plot: Plot, layout: Layout | None, x: Range, y: Range) -> None:
    """The true ground from above, by terrain."""
    for terrain, color in GROUND.items():
        slabs = [slab for slab in (layout.slabs if layout else ()) if slab.terrain == terrain]
        corners = [
            slab.point([0, slab.length, slab.length, 0], [-slab.right, -slab.right, slab.left, slab.left])
            for slab in slabs
        ]
        plot.areas([np.clip(c[:, :2], [x[0], y[0]], [x[1], y[1]]) for c in corners], color, label=terrain)


def outline(footprint: Footprint) -> Array:
    """(4, 2) m, corners of a footprint in the true world, from above."""
    w, x, y, z = footprint.q_world_foot
    toes = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)])
    aside = np.array([-toes[1], toes[0]])
    local = [(0.0, -_HALF_FOOT_M), (FOOT_M, -_HALF_FOOT_M), (FOOT_M, _HALF_FOOT_M), (0.0, _HALF_FOOT_M)]
    return np.array([footprint.p_foot_in_world[:2] + u * toes + v * aside for u, v in local])
