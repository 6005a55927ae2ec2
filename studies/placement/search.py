"""Search of places: a full grid, or CMA-ES (Hansen & Ostermeier 2001), deterministic by its seed."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable, Sequence

import numpy as np

from stridetwin.scenarios.campaign.plan import quasi_random_points
from stridetwin.streams.errors import explain_import_error
from stridetwin.studies.placement.free import Knob
from stridetwin.studies.placement.problem_file import Optimise, Place

_SPREAD = 0.25  # initial standard deviation of the search, as a share of every range
_WORST = 1e12  # loss of a place without a score: only the order of losses counts
_KEY = 7  # key of the search's random numbers
_MORE_STARTS = 8  # most starts over the requested number, as starts that end early leave budget for others


def grid(knobs: Sequence[Knob]) -> list[Place]:
    """Every place of a sweep, the last value changing fastest."""
    names = [knob.name for knob in knobs]
    return [Place(values=dict(zip(names, values))) for values in itertools.product(*(knob.grid for knob in knobs))]


def optimise(
    knobs: Sequence[Knob], options: Optimise, seed: int, loss: Callable[[list[Place]], list[float]]
) -> list[Place]:
    """Searches places of low loss.

    For every combination of choices CMA-ES starts from points that fill the ranges of the numbers evenly; the budget
    is shared out evenly.

    Args:
        knobs: The free values, with at least one number.
        options: Budget and starts.
        seed: Seed of everything random in the search.
        loss: Losses of places, infinite or NaN if missing; equal places must get equal losses.

    Returns:
        All tried places without repetition, in order.

    Raises:
        StrideTwinError: The library is not installed.
    """
    with explain_import_error("optimise needs it", "placement"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its warning that it cannot plot without matplotlib
        import cma
    numbers, choices = [k for k in knobs if not k.values], [k for k in knobs if k.values]
    combinations = list(itertools.product(*(k.values for k in choices)))  # one, without values, if there is no choice
    size = max(len(numbers), 2)  # the method needs two dimensions; the second one is then a dummy
    # (starts, size) points of the unit cube, whose edges are the ranges of the numbers
    starts = quasi_random_points("sobol", _MORE_STARTS * options.starts, size, seed, (_KEY,))
    starts[0] = 0.5  # the first start is the middle of all ranges
    # places are dealt out one after the other: combination i has those from ends[i] to ends[i + 1] as its budget
    ends = [options.budget * i // len(combinations) for i in range(len(combinations) + 1)]
    tried: dict[str, Place] = {}  # by `Place.key`
    for number, (combination, budget_left) in enumerate(zip(combinations, np.diff(ends).tolist())):
        chosen = dict(zip((knob.name for knob in choices), combination))
        for k, start in enumerate(starts):  # the unused budget of a converged start goes to the next one
            # what is left for the combination is shared by this start and the remaining ones of the requested number
            left = budget_left // max(options.starts - k, 1)
            budget_left -= left
            if not left:
                continue
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_KEY, number * len(starts) + k)))
            cma_options = {
                "bounds": [0.0, 1.0],
                "seed": math.nan,  # leaves NumPy's global generator alone; `randn` below draws instead
                "randn": lambda *shape, rng=rng: rng.standard_normal(shape),
                "verbose": -9,
                "maxfevals": left,
                # a start ends once losses or places hardly differ, or after five generations of equal losses
                "tolfun": 1e-9,
                "tolx": 1e-4,
                "tolflatfitness": 5,
            }
            search = cma.CMAEvolutionStrategy(start, _SPREAD, cma_options)
            while left > 0 and not search.stop():
                points = search.ask()
                places = [Place(values=_values_at(numbers, point) | chosen) for point in points[:left]]
                losses = [x if math.isfinite(x) else _WORST for x in loss(places)]
                tried |= {place.key: place for place in places}
                left -= len(places)
                if len(places) < len(points):
                    break  # the budget ends within a generation
                search.tell(points, losses)
            budget_left += left  # what this start has not used
    return list(tried.values())


def _values_at(knobs: Sequence[Knob], point: Sequence[float]) -> dict[str, object]:
    """Values of the knobs at a point of the unit cube, by name."""
    return {knob.name: knob.at_share(float(u)) for knob, u in zip(knobs, point)}
