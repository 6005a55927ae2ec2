"""Points of the unit cube that fill it evenly: one a walk, one dimension a value that varies."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import qmc

from stridetwin.streams.samples import Array


def cube(sampling: str, count: int, dimensions: int, seed: int, key: tuple[int, ...]) -> Array:
    """Points of the unit cube.

    A Sobol sequence (scrambled: Owen 1998, as in Matoušek 1998) begins alike however many points are asked for; a
    Latin hypercube (McKay et al. 1979), which has one point in each of `count` layers of every dimension, does not.

    Args:
        sampling: `sobol` or `latin_hypercube`.
        count: How many points.
        dimensions: Of the cube.
        seed: Of the campaign.
        key: Tells this cube from the others of the campaign.

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
