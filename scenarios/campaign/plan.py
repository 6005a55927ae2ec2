"""The walks of a campaign: whose they are, from which scenario, with which values, before any of them is walked."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from stridetwin.scenarios.campaign.campaign_file import Campaign
from stridetwin.scenarios.campaign.distributions import Choice
from stridetwin.scenarios.campaign.field_paths import field_path, put
from stridetwin.scenarios.campaign.named_files import Base, Variable
from stridetwin.scenarios.campaign.sampling import cube

_SEEDS = 1_000_000  # of one campaign: walk i of seed s has the seed s * _SEEDS + i
_WALKS, _PEOPLE = 0, 1
_CAMERAS = ("foot_camera", "head_camera")


@dataclass(frozen=True, kw_only=True)
class Walk:
    """One walk.

    Attributes:
        name: Of its files.
        seed: Of everything random in it.
        base: Name of the scenario that it comes from.
        values: What was drawn, by the names in the campaign's file; without what a later line replaces.
        scenario: Plain data of its own scenario file.
    """

    name: str
    seed: int
    base: str
    values: dict[str, Any]
    scenario: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Extra:
    """What the command line asks of every walk.

    Attributes:
        physics: How the body moves; None as the scenarios say.
        cameras: False: every camera is off.
    """

    physics: str | None = None
    cameras: bool = True

    @property
    def places(self) -> Iterator[tuple[str | int, ...]]:
        """What it sets in a scenario, after all else."""
        if self.physics is not None:
            yield ("physics",)
        if not self.cameras:
            yield from (("sensors", group) for group in _CAMERAS)


def people(campaign: Campaign) -> list[Any]:
    """The people of a campaign, as scenario files have them; none where the scenarios say who walks.

    Those of a group stand by the first of their values, so that walks that are spread evenly over the people are so
    over that value, too: in the order in which they are drawn it goes up and down as the walks' own values do.
    """
    found: list[Any] = []
    for i, group in enumerate(campaign.people):
        points = cube(campaign.sampling, group.count, len(group.drawn), campaign.seed, (_PEOPLE, i))
        found += group.names or [group.person(dict(zip(group.drawn, row))) for row in sorted(points.tolist())]
    return found


def plan(campaign: Campaign, extra: Extra) -> list[Walk]:
    """The walks of a campaign, in order.

    Which scenario each walk is of comes first. Then each scenario has a cube of its own, with a dimension for the
    person and one for each value that varies there, whose points its walks take in their order: what varies within a
    scenario fills its ranges together, whatever the others ask for.
    """
    crowd, sampling = people(campaign), campaign.sampling
    order = Choice(values=campaign.bases, weights=tuple(base.weight for base in campaign.bases))
    which = [order.index(row[0]) for row in cube(sampling, campaign.walks, 1, campaign.seed, (_WALKS,)).tolist()]
    varied = [[v for v in in_force(campaign, base, Extra()) if v.varies] for base in campaign.bases]
    points = [
        iter(cube(sampling, which.count(i), 1 + len(own), campaign.seed, (_WALKS, i)).tolist())
        for i, own in enumerate(varied)
    ]
    told = [{v.name for v in in_force(campaign, base, extra)} for base in campaign.bases]
    walks = []
    for i, k in enumerate(which):
        base, (who, *row) = campaign.bases[k], next(points[k])
        drawn = {name: value for name, value in _drawn(varied[k], row) if name in told[k]}
        person = crowd[int(who * len(crowd))] if crowd else None
        walks.append(
            Walk(
                name=f"walk_{i:05d}",
                seed=campaign.seed * _SEEDS + i,
                base=base.name,
                values=drawn,
                scenario=scenario_of(campaign, base, person, drawn, extra),
            )
        )
    return walks


def in_force(campaign: Campaign, base: Base, extra: Extra) -> list[Variable]:
    """What is set in a scenario's walks, in order, without the lines of which later ones replace all."""
    found: list[Variable] = []
    later = list(extra.places)
    for variable in reversed((*campaign.variables, *base.variables)):
        if not all(any(path.keys[: len(keys)] == keys for keys in later) for path in variable.paths):
            found.insert(0, variable)
            later += [path.keys for path in variable.paths]
    return found


def scenario_of(campaign: Campaign, base: Base, person: Any, drawn: dict[str, Any], extra: Extra) -> dict[str, Any]:
    """Plain data of one walk's scenario.

    Args:
        campaign: Whose variables are set, then the scenario's own.
        base: The scenario.
        person: Who walks; None as the scenario says.
        drawn: Value of each variable in force that varies.
        extra: What the command line asks.

    Raises:
        ConfigError: A variable that has no place in this scenario.
    """
    scenario: dict[str, Any] = _copied(base.scenario)
    for variable in in_force(campaign, base, extra):
        value = drawn[variable.name] if variable.varies else variable.distribution.at(0.0)
        for path in variable.paths:
            put(scenario, path, _copied(value), variable.at)
    if person is not None:
        scenario["person"] = _copied(person)
    if extra.physics is not None:
        scenario["physics"] = extra.physics
    if not extra.cameras:
        for group in _CAMERAS:
            put(scenario, field_path(f"sensors.{group}", base.at), False, base.at)
    return scenario


def _drawn(variables: Sequence[Variable], quantiles: Sequence[float]) -> Iterator[tuple[str, Any]]:
    for variable, u in zip(variables, quantiles):
        yield variable.name, variable.distribution.at(u)


def _copied(value: Any) -> Any:
    """A copy that shares nothing."""
    return json.loads(json.dumps(value))
