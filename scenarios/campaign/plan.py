"""The walks of a campaign: whose they are, from which scenario, with which values, before any of them is walked."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stridetwin.scenarios.campaign.campaign_file import Campaign
from stridetwin.scenarios.campaign.distributions import Choice
from stridetwin.scenarios.campaign.field_paths import field_path, put
from stridetwin.scenarios.campaign.named_files import Base, Variable
from stridetwin.scenarios.campaign.sampling import cube
from stridetwin.streams.samples import Array

_SEEDS = 1_000_000  # of one campaign: walk i of seed s has the seed s * _SEEDS + i
_WALKS, _PEOPLE = 0, 1


@dataclass(frozen=True, kw_only=True)
class Walk:
    """One walk.

    Attributes:
        name: Of its files.
        seed: Of everything random in it.
        base: Name of the scenario that it comes from.
        values: What was drawn, by the names in the campaign's file.
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


def people(campaign: Campaign) -> list[Any]:
    """The people of a campaign, as scenario files have them; none where the scenarios say who walks."""
    found: list[Any] = []
    for i, group in enumerate(campaign.people):
        points = cube(campaign.sampling, group.count, len(group.drawn), campaign.seed, (_PEOPLE, i))
        found += group.names or [group.person(dict(zip(group.drawn, row))) for row in points.tolist()]
    return found


def plan(campaign: Campaign, extra: Extra) -> list[Walk]:
    """The walks of a campaign, in order.

    Each value that varies is a dimension of one cube, after those of scenario and person. The values that only one
    scenario has are taken from the points in the order of its own walks, so that they fill their ranges there.
    """
    crowd, common = people(campaign), [v for v in campaign.variables if v.varies]
    own = [[v for v in base.variables if v.varies] for base in campaign.bases]
    ends = np.cumsum([2 + len(common), *map(len, own)]).tolist()

    def points(count: int) -> Array:
        return cube(campaign.sampling, count, ends[-1], campaign.seed, (_WALKS,))

    order = Choice(values=campaign.bases, weights=tuple(base.weight for base in campaign.bases))
    rows = points(campaign.walks).tolist()
    which = [order.index(row[0]) for row in rows]
    own_rows = [
        iter(points(count)[:, ends[i] : ends[i + 1]].tolist() if (count := which.count(i)) else ())
        for i in range(len(own))
    ]
    walks = []
    for i, (row, k) in enumerate(zip(rows, which)):
        base = campaign.bases[k]
        drawn = dict(_drawn(common, row[2:])) | dict(_drawn(own[k], next(own_rows[k])))
        person = crowd[int(row[1] * len(crowd))] if crowd else None
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


def scenario_of(campaign: Campaign, base: Base, person: Any, drawn: dict[str, Any], extra: Extra) -> dict[str, Any]:
    """Plain data of one walk's scenario.

    Args:
        campaign: Whose variables are set, then the scenario's own.
        base: The scenario.
        person: Who walks; None as the scenario says.
        drawn: Value of each variable that varies.
        extra: What the command line asks.

    Raises:
        ConfigError: A variable that has no place in this scenario.
    """
    scenario: dict[str, Any] = _copied(base.scenario)
    for variable in (*campaign.variables, *base.variables):
        value = drawn[variable.name] if variable.varies else variable.distribution.at(0.0)
        for path in variable.paths:
            put(scenario, path, _copied(value), variable.at)
    if person is not None:
        scenario["person"] = _copied(person)
    if extra.physics is not None:
        scenario["physics"] = extra.physics
    if not extra.cameras:
        for group in ("foot_camera", "head_camera"):
            put(scenario, field_path(f"sensors.{group}", base.at), False, base.at)
    return scenario


def _drawn(variables: Sequence[Variable], quantiles: Sequence[float]) -> Iterator[tuple[str, Any]]:
    for variable, u in zip(variables, quantiles):
        yield variable.name, variable.distribution.at(u)


def _copied(value: Any) -> Any:
    """A copy that shares nothing."""
    return json.loads(json.dumps(value))
