"""Floors that are not exactly level: a smooth height over the exact ground, and slabs that follow it.

Heights of built floors are self-affine between the length of a foot and that of a hall: the standard deviation of the
difference between two places grows with their distance r as r^`GROWTH`. The exponent follows from two numbers of one
floor. A conventional slab (F_F 20, F_L 15 in ACI 117) has, by ASTM E1155, curvatures of 1.9 mm over 0.3 m and
differences of 7 mm over 3 m (standard deviations): F_F = 116 mm / 3 σ_q and F_L = 317.5 mm / 3 σ_z. As waves shorter
than 0.7 m are left out, the curvature of the drawn floor is 1.4 mm (F_F 27).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import j0

from stridetwin.streams.samples import Array
from stridetwin.streams.terrain_truth import Layout, Slab

APART_M = 3.0  # distance of the two places whose difference in height the unevenness is
GROWTH = 0.65  # exponent of the distance; the ratio of curvature and difference above gives 0.65
_WAVES = 96
_SHORTEST_M, _LONGEST_M = 0.7, 60.0  # waves; shorter ones would not be seen by a foot, longer ones are a tilt
_PIECE_M = 0.35  # longest piece of a slab that is one plane
_ASIDE_M = 0.3  # to both sides of a slab's axis, where its tilt is that of the floor
_STREAM = 7  # of the random numbers of a walk (`sim.twin` has the others)


@dataclass(frozen=True, kw_only=True, eq=False)
class UnevenFloor:
    """Height of a floor above the exact ground: a sum of waves in all directions, 0 at the world's origin.

    Attributes:
        wave: (K, 2) rad/m, wave vectors.
        phase: (K,) rad.
        amplitude_m: (K,) m.
    """

    wave: Array
    phase: Array
    amplitude_m: Array

    @classmethod
    def draw(cls, unevenness_m: float, seed: int) -> UnevenFloor:
        """The floor of a walk.

        Args:
            unevenness_m: Standard deviation of the difference in height of two places `APART_M` apart, m.
            seed: Seed of the walk.
        """
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM,)))
        # one wave in each of equal shares of the logarithm of the wavelength
        share = (np.arange(_WAVES) + rng.uniform(size=_WAVES)) / _WAVES
        length_m = _SHORTEST_M * (_LONGEST_M / _SHORTEST_M) ** share
        k = 2.0 * np.pi / length_m
        toward = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
        amplitude = length_m**GROWTH
        # a wave of amplitude a in a random direction has the mean squared difference a² (1 − J0(k r)) at a distance r
        amplitude *= unevenness_m / math.sqrt(float((amplitude**2 * (1.0 - j0(k * APART_M))).sum()))
        wave = k[:, None] * np.stack([np.cos(toward), np.sin(toward)], axis=1)
        return cls(wave=wave, phase=rng.uniform(0.0, 2.0 * np.pi, _WAVES), amplitude_m=amplitude)

    def height(self, xy: ArrayLike) -> Array:
        """(...) m above the exact ground, at (..., 2) points of the world."""
        angle = np.asarray(xy, dtype=float) @ self.wave.T + self.phase
        return np.asarray((np.cos(angle) - np.cos(self.phase)) @ self.amplitude_m)

    def bend(self, layout: Layout) -> Layout:
        """The layout with slabs that follow the floor; way and profile stay those of the plan.

        Each slab becomes planes of at most `_PIECE_M` along its axis, which meet on the axis; risers keep their
        heights within what the floor changes over a tread.
        """
        slabs = [self._settle(piece) for slab in layout.slabs for piece in _cut(slab)]
        return replace(layout, slabs=tuple(slabs))

    def _settle(self, slab: Slab) -> Slab:
        """A slab whose ends are raised, and which is tilted sideways, as the floor is there."""
        ends = self.height(slab.point([0.0, slab.length], [0.0, 0.0])[:, :2])
        left, right = min(slab.left, _ASIDE_M), min(slab.right, _ASIDE_M)
        sides = self.height(slab.point([slab.length / 2] * 2, [left, -right])[:, :2])
        tilt = float(sides[0] - sides[1]) / (left + right)
        return replace(
            slab,
            z0=slab.z0 + float(ends[0]),
            z1=slab.z1 + float(ends[1]),
            cross_slope=math.atan(math.tan(slab.cross_slope) + tilt),
        )


def _cut(slab: Slab) -> Iterator[Slab]:
    """Equal pieces of a slab along its axis; a plank over a riser stays whole."""
    count = 1 if slab.recess else max(1, math.ceil(slab.length / _PIECE_M - 1e-9))
    at = np.linspace(0.0, slab.length, count + 1)
    points = slab.point(at, np.zeros(count + 1))
    for i in range(count):
        (x, y, z0), (_, _, z1) = points[i].tolist(), points[i + 1].tolist()
        yield replace(
            slab,
            x=x,
            y=y,
            length=float(at[i + 1] - at[i]),
            z0=z0,
            z1=z1,
            start_radius=slab.start_radius if i == 0 else 0.0,
            end_radius=slab.end_radius if i == count - 1 else 0.0,
        )
