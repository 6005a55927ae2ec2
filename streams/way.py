"""The way: the plane curve that a walk follows, made of lines and arcs, as a function of its arc length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from stridetwin.streams.samples import Array

_PROJECTION_M = 0.02  # spacing of the candidate points


@dataclass(frozen=True, kw_only=True)
class CurveSegment:
    """A line or an arc of the way.

    Attributes:
        s0, s1: Arc length of its start and end, m.
        x, y: Start in the world, m.
        heading: Direction at its start, rad; unwrapped, so that it is continuous along the way.
        curvature: 1/m, left positive; 0 for a line.
    """

    s0: float
    s1: float
    x: float
    y: float
    heading: float
    curvature: float


@dataclass(frozen=True, kw_only=True)
class Way:
    """Segments in order; before the first and after the last the way continues straight.

    Attributes:
        segments: Segments; each begins where the previous one ends.
    """

    segments: tuple[CurveSegment, ...]

    @cached_property
    def _columns(self) -> Array:
        """The segments as (6, N): start and end of arc length, x, y, heading and curvature."""
        return np.array([(p.s0, p.s1, p.x, p.y, p.heading, p.curvature) for p in self.segments]).T

    def _locate(self, s: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """Where the way is at arc lengths; beyond an end it is taken at that end.

        Args:
            s: (...) arc lengths, m.

        Returns:
            (..., 2) points in the world, m; (...) heading, rad; (...) curvature, 1/m; (...) distance of s beyond the
            end of the way, m, negative before the start, 0 on it.
        """
        s = np.asarray(s, dtype=float)
        s0, s1, x, y, heading, curvature = self._columns
        i = np.clip(np.searchsorted(s0, s, side="right") - 1, 0, len(s0) - 1)  # (...) number of the segment at s
        inside = np.clip(s, s0[0], s1[-1])
        run, k = inside - s0[i], curvature[i]  # (...) arc length from the start of the segment, and its curvature
        # an arc by its chord, from the start of the segment: NumPy's sinc(h / π) is sin(h) / h
        half = 0.5 * k * run  # half of the angle by which the arc turns
        chord = run * np.sinc(half / np.pi)
        toward = heading[i] + half
        point = np.stack([x[i] + chord * np.cos(toward), y[i] + chord * np.sin(toward)], -1)
        return point, heading[i] + k * run, k, s - inside

    def heading(self, s: ArrayLike) -> Array:
        """Direction of the way at arc lengths (...), m: (...) rad, left positive, continuous along the way."""
        return self._locate(s)[1]

    def curvature(self, s: ArrayLike) -> Array:
        """Curvature of the way at arc lengths (...), m: (...) 1/m, left positive."""
        return self._locate(s)[2]

    def point(self, s: ArrayLike, left: ArrayLike = 0.0) -> Array:
        """Points in the world, (..., 2) m, at arc lengths (...) and distances (...) to the left of the way, m."""
        point, heading, _, beyond = self._locate(s)
        along = np.stack([np.cos(heading), np.sin(heading)], -1)
        aside = np.stack([-np.sin(heading), np.cos(heading)], -1)
        return np.asarray(point + beyond[..., None] * along + np.asarray(left, dtype=float)[..., None] * aside)

    def project(self, path: ArrayLike, reach_m: float = 0.6, begin: float = 0.0) -> Array:
        """(N,) arc lengths, m, of the points of the way that are nearest to an (N, 2) path in order of time.

        The path is followed from its start, near arc length `begin`, which resolves ambiguities where two parts of the
        way meet; consecutive samples are up to `reach_m` apart along the way.

        Args:
            path: (N, 2) m, points in the world.
            reach_m: Largest distance of two consecutive samples along the way, m.
            begin: Arc length near which the path begins, m.
        """
        path = np.asarray(path, dtype=float)
        s0, s1 = self.segments[0].s0, self.segments[-1].s1
        # candidates every 2 cm of the way: arc length (G,), point (G, 2) and heading (G,)
        grid = np.linspace(s0, s1, max(2, int((s1 - s0) / _PROJECTION_M)))
        points, heading = self.point(grid), self.heading(grid)
        window = int(np.ceil(reach_m / (grid[1] - grid[0])))  # number of candidates that a sample may move
        at = int(np.argmin(np.abs(grid - begin)))  # number of the candidate nearest to the previous sample
        nearest = np.empty(len(path), dtype=int)  # that of each sample
        for k, p in enumerate(path):
            low = max(at - window, 0)
            away = points[low : at + window + 1] - p
            at = low + int(np.argmin(away[:, 0] ** 2 + away[:, 1] ** 2))
            nearest[k] = at
        # from the nearest candidate to the sample, along the direction of the way there
        along = np.stack([np.cos(heading), np.sin(heading)], -1)[nearest]
        return np.asarray(grid[nearest] + np.sum((path - points[nearest]) * along, axis=1))


def join_segments(segments: Sequence[CurveSegment]) -> Way:
    """The way that consists of these segments, with neighbouring lines of one direction merged."""
    merged: list[CurveSegment] = []
    for segment in segments:
        last = merged[-1] if merged else None
        if last is not None and last.curvature == segment.curvature == 0.0 and last.heading == segment.heading:
            merged[-1] = CurveSegment(
                s0=last.s0, s1=segment.s1, x=last.x, y=last.y, heading=last.heading, curvature=0.0
            )
        else:
            merged.append(segment)
    return Way(segments=tuple(merged))
