"""Low-discrepancy points of the unit cube: one point per walk, one dimension per varying value."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import qmc

from stridetwin.streams.samples import Array


def cube(sampling: str, count: int, dimensions: int, seed: int, key: tuple[int, ...]) -> Array:
    """Points of the unit cube.

    The first points of a Sobol sequence (scrambled: Owen 1998, as in Matoušek 1998) do not depend on `count`; those of
    a Latin hypercube (McKay et al. 1979), which has one point in each of `count` layers of every dimension, do.

    Args:
        sampling: `sobol` or `latin_hypercube`.
        count: Number of points.
        dimensions: Of the cube.
        seed: Of the campaign.
        key: Identifies this cube among those of the campaign.

    Returns:
        (count, dimensions) in [0, 1).
    """
    if 0 in (count, dimensions):
        return np.zeros((count, dimensions))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
    if sampling == "sobol":
        points = qmc.Sobol(dimensions, rng=rng).random_base2(math.ceil(math.log2(count)))[:count]
    else:
        points = qmc.LatinHypercube(dimensions, rng=rng).random(count)
    return np.minimum(points, np.nextafter(1.0, 0.0))
