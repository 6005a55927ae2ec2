"""The plan of a campaign: person, scenario and values of each walk.

Low-discrepancy points of the unit cube: one point per walk, one dimension per varying value.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass

import numpy as np

from stridetwin.scenarios.campaign.campaign_file import Campaign
from stridetwin.scenarios.campaign.distributions import index_at_quantile
from stridetwin.scenarios.campaign.field_paths import PlainScenario, field_path, set_value, set_values
from stridetwin.scenarios.campaign.named_files import Base, Variable
from stridetwin.streams.samples import Array


def quasi_random_points(sampling: str, count: int, dimensions: int, seed: int, key: tuple[int, ...]) -> Array:
    """Points of the unit cube.

    The first points of a Sobol sequence (scrambled: Owen 1998, as in Matoušek 1998) do not depend on `count`; those of
    a Latin hypercube (McKay et al. 1979), which has one point in each of `count` layers of every dimension, do.

    Args:
        sampling: `sobol` or `latin_hypercube`.
        count: Number of points.
        dimensions: Number of dimensions.
        seed: Seed of the campaign.
        key: Identifies this cube among those of the campaign.

    Returns:
        (count, dimensions) in [0, 1).
    """
    if 0 in (count, dimensions):
        return np.zeros((count, dimensions))
    from scipy.stats import qmc  # takes long to import, and only a plan needs it

    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
    if sampling == "sobol":
        # a power of two of points, as a Sobol sequence needs for its balance; the first `count` are taken
        points = qmc.Sobol(dimensions, rng=rng).random_base2(math.ceil(math.log2(count)))[:count]
    else:
        points = qmc.LatinHypercube(dimensions, rng=rng).random(count)
    return np.minimum(points, np.nextafter(1.0, 0.0))


_SEEDS = 1_000_000  # of one campaign: walk i of seed s has the seed s * _SEEDS + i
_WALKS, _PEOPLE = 0, 1  # first part of the key of a cube of random numbers
Walker = str | dict[str, object]
"""A walker in a scenario file: the name of a predefined person, or body measures."""


@dataclass(frozen=True, kw_only=True)
class PlannedWalk:
    """One walk of a campaign, ready to be simulated.

    Attributes:
        name: Name of its files.
        seed: Seed of all its random numbers.
        base: Name of the scenario that it comes from.
        values: Drawn values by their names in the campaign's file, without those that a later line replaces.
        scenario: Plain data of its own scenario file.
    """

    name: str
    seed: int
    base: str
    values: dict[str, object]
    scenario: PlainScenario


@dataclass(frozen=True, kw_only=True)
class Extra:
    """Overrides for every walk that the command line sets.

    Attributes:
        physics: Replaces that of the scenarios; None leaves it.
        off: Groups of sensors that are off.
    """

    physics: str | None = None
    off: tuple[str, ...] = ()

    @property
    def places(self) -> Iterator[tuple[str | int, ...]]:
        """Fields of a scenario that these options set, after all others."""
        if self.physics is not None:
            yield ("physics",)
        yield from (("sensors", group) for group in self.off)


def draw_people(campaign: Campaign) -> list[Walker]:
    """The people of a campaign, in the form of scenario files; empty where the scenarios name the walker.

    The members of a group are sorted by their first varying value, so that walks that cover the people evenly cover
    that value evenly, too.
    """
    members: list[Walker] = []
    for i, group in enumerate(campaign.people):
        points = quasi_random_points(
            campaign.sampling, group.count, len(group.varying_keys), campaign.seed, (_PEOPLE, i)
        )
        # a predefined group has names and no points
        quantiles = [dict(zip(group.varying_keys, row)) for row in sorted(points.tolist())]
        members += group.names or [group.person(of_member) for of_member in quantiles]
    return members


def plan_walks(campaign: Campaign, extra: Extra) -> list[PlannedWalk]:
    """The walks of a campaign, in order.

    The scenario of each walk is drawn first. Each scenario then has a unit cube of its own, with one dimension for the
    person and one per varying value; its walks take the points in order. So the values of a scenario fill their ranges
    jointly, independent of the other scenarios.
    """
    members, sampling = draw_people(campaign), campaign.sampling
    # number of the scenario of each walk
    base_numbers = [
        index_at_quantile([base.weight for base in campaign.bases], row[0])
        for row in quasi_random_points(sampling, campaign.walks, 1, campaign.seed, (_WALKS,)).tolist()
    ]
    # without the overrides of the command line, so that these do not change the values drawn for the other variables
    varied = [[v for v in effective_variables(campaign, base, Extra()) if v.varies] for base in campaign.bases]
    # per scenario, an iterator over the points of its cube: its walks take one after the other
    points = []
    for i, variables in enumerate(varied):
        walk_count, dimensions = base_numbers.count(i), 1 + len(variables)
        points.append(iter(quasi_random_points(sampling, walk_count, dimensions, campaign.seed, (_WALKS, i)).tolist()))
    # per scenario, the names of the variables that the overrides leave in place
    effective = [{v.name for v in effective_variables(campaign, base, extra)} for base in campaign.bases]
    walks = []
    for i, k in enumerate(base_numbers):
        # the first coordinate of the point gives the person, the others the values
        base, (person_quantile, *quantiles) = campaign.bases[k], next(points[k])
        drawn = {v.name: v.distribution.at(u) for v, u in zip(varied[k], quantiles) if v.name in effective[k]}
        person = members[int(person_quantile * len(members))] if members else None
        walks.append(
            PlannedWalk(
                name=f"walk_{i:05d}",
                seed=campaign.seed * _SEEDS + i,
                base=base.name,
                values=drawn,
                scenario=scenario_of(campaign, base, person, drawn, extra),
            )
        )
    return walks


def effective_variables(campaign: Campaign, base: Base, extra: Extra) -> list[Variable]:
    """The variables that are set in a scenario's walks, in order, without those that later ones replace entirely.

    Args:
        campaign: Its variables are set first.
        base: The scenario, whose own variables follow.
        extra: Overrides of the command line, which come last.
    """
    variables: list[Variable] = []
    later = list(extra.places)  # fields that are set later on, as keys; a field inside one of them is replaced, too
    for variable in reversed((*campaign.variables, *base.variables)):
        # for each of its fields, whether one of the later fields is that field or contains it
        is_replaced = [any(path.keys[: len(keys)] == keys for keys in later) for path in variable.paths]
        if not all(is_replaced):
            variables.insert(0, variable)
            later += [path.keys for path in variable.paths]
    return variables


def scenario_of(
    campaign: Campaign, base: Base, person: Walker | None, drawn: Mapping[str, object], extra: Extra
) -> PlainScenario:
    """Plain data of one walk's scenario.

    The campaign's variables are set first, then those of the base, then person and overrides.

    Args:
        campaign: The campaign.
        base: Scenario that the walk starts from.
        person: The walker as in a scenario file; None leaves that of the base.
        drawn: Value of each varying variable by name.
        extra: Overrides for every walk.

    Raises:
        ConfigError: This scenario lacks the field of a variable.
    """
    scenario = deepcopy(base.scenario)
    for variable in effective_variables(campaign, base, extra):
        # a fixed value is the same at every quantile
        value = drawn[variable.name] if variable.varies else variable.distribution.at(0.0)
        set_values(scenario, variable.paths, value, variable.at)
    if person is not None:
        scenario["person"] = deepcopy(person)
    if extra.physics is not None:
        scenario["physics"] = extra.physics
    for group in extra.off:
        set_value(scenario, field_path(f"sensors.{group}", base.at), False, base.at)
    return scenario
