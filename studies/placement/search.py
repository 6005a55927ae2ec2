"""Search of places: a full grid, or CMA-ES (Hansen & Ostermeier 2001), deterministic by its seed."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from stridetwin.scenarios.campaign.plan import quasi_random_points
from stridetwin.streams.errors import needing
from stridetwin.studies.placement.free import Knob
from stridetwin.studies.placement.problem_file import Optimise, Place

_SPREAD = 0.25
_WORST = 1e12  # a place without a score; only ranks count
_KEY = 7
_MORE_STARTS = 8  # times the requested number, if some end early


def grid(knobs: Sequence[Knob]) -> list[Place]:
    """Every place of a sweep, the last value changing fastest."""
    names = [knob.name for knob in knobs]
    return [Place(values=dict(zip(names, values))) for values in itertools.product(*(knob.grid for knob in knobs))]


def optimise(
    knobs: Sequence[Knob], options: Optimise, seed: int, loss: Callable[[list[Place]], list[float]]
) -> list[Place]:
    """Searches places of low loss.

    For every combination of choices CMA-ES starts from points that fill the ranges of the numbers evenly; the
    budget is shared out evenly.

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
    with needing("optimise needs it", "placement"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its warning that it cannot plot without matplotlib
        import cma
    numbers, choices = [k for k in knobs if not k.values], [k for k in knobs if k.values]
    combinations = list(itertools.product(*(k.values for k in choices)))
    size = max(len(numbers), 2)  # the method needs two dimensions; the second one is then a dummy
    most = _MORE_STARTS * options.starts
    starts = quasi_random_points("sobol", most, size, seed, (_KEY,))
    starts[0] = 0.5
    shares = [options.budget * (i + 1) // len(combinations) - options.budget * i // len(combinations)
              for i in range(len(combinations))]  # fmt: skip
    tried: dict[str, Place] = {}
    for run, (combination, start) in enumerate(itertools.product(combinations, starts)):
        k, at = run % most, run // most
        left = shares[at] // (options.starts - k) if k < options.starts - 1 else shares[at]
        shares[at] -= left
        if left == 0:
            continue
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_KEY, run)))
        cma_options: dict[str, Any] = {
            "bounds": [0.0, 1.0], "seed": math.nan, "randn": lambda *shape, rng=rng: rng.standard_normal(shape),
            "verbose": -9, "maxfevals": left, "tolfun": 1e-9, "tolx": 1e-4, "tolflatfitness": 5,
        }  # fmt: skip
        search = cma.CMAEvolutionStrategy(start, _SPREAD, cma_options)
        while left > 0 and not search.stop():
            asked_for = search.ask()
            places = [_place(numbers, point, choices, combination) for point in asked_for][:left]
            losses = [x if math.isfinite(x) else _WORST for x in loss(places)]
            tried |= {place.key: place for place in places}
            left -= len(places)
            if len(places) < len(asked_for):
                break  # the budget ends within a generation
            search.tell(asked_for, losses)
        shares[at] += left  # the unused budget of a converged start goes to the next one
    return list(tried.values())


def _place(numbers: Sequence[Knob], point: Sequence[float], choices: Sequence[Knob], chosen: Sequence[Any]) -> Place:
    values = {knob.name: knob.at_share(float(u)) for knob, u in zip(numbers, point)}
    return Place(values=values | {knob.name: value for knob, value in zip(choices, chosen)})
