"""Places, and their scenarios."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stridetwin.scenarios.campaign.field_paths import put
from stridetwin.scenarios.campaign.named_files import FILES, SCENARIOS, Base
from stridetwin.scenarios.scenario_file import Scenario, scenario_of
from stridetwin.sim.config import Person
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.studies.placement.free import Free, Knob
from stridetwin.studies.placement.problem_file import Problem

AS_IT_IS = "as it is"


@dataclass(frozen=True, kw_only=True)
class Place:
    """Values of all knobs; empty for the unchanged scenario.

    Attributes:
        values: By the knobs' names.
    """

    values: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """A text that is equal for equal places."""
        return json.dumps(self.values, sort_keys=True)

    @property
    def label(self) -> str:
        """Its name in tables and figures."""
        return ", ".join(f"{name} {format_value(value)}" for name, value in self.values.items()) or AS_IT_IS


def format_value(value: Any) -> str:
    """A value as text for tables."""
    if isinstance(value, float):
        return f"{value:g}"
    text = value if isinstance(value, str) else json.dumps(value)
    return text.removeprefix(f"../{FILES}/")


def plain_of(problem: Problem, base: Base, place: Place) -> dict[str, Any]:
    """Plain data of a place's scenario file.

    Raises:
        ConfigError: This scenario lacks a field that is set or free.
    """
    plain: dict[str, Any] = json.loads(json.dumps(base.scenario))
    for variable in (*problem.variables, *base.variables):
        for path in variable.paths:
            put(plain, path, json.loads(json.dumps(variable.distribution.at(0.0))), variable.at)
    if place.values:
        person = _person(plain, problem.free, base)
        for free in problem.free:
            value = free.value(place.values, person)
            for path in free.paths:
                put(plain, path, json.loads(json.dumps(value)), free.at)
    return plain


def scenario_at(problem: Problem, base: Base, place: Place, folder: Path) -> Scenario:
    """A place's scenario.

    Args:
        problem: The placement problem.
        base: The scenario.
        place: The place.
        folder: Contains the user's parts.
    """
    return scenario_of(plain_of(problem, base, place), folder / SCENARIOS / f"{base.name}.yaml")


def _person(plain: dict[str, Any], free: Sequence[Free], base: Base) -> Person:
    """The walker; the default person where no field is on a surface."""
    if all(f.surface is None for f in free):
        return Person()
    steps = {"description": "a few steps", "terrain": [{"level": {"length_m": 2}}]}
    return scenario_of({**steps, **{k: plain[k] for k in ("person",) if k in plain}}, Path(base.name)).config.person


def check_ends(problem: Problem, folder: Path) -> None:
    """Checks the unchanged scenarios, then the ends of every range with the other values at their middle.

    Raises:
        ConfigError: The message names file, field, value and what is valid.
    """
    middle = {knob.name: knob.middle for knob in problem.knobs}
    for base in problem.bases:
        try:
            scenario_at(problem, base, Place(), folder)
        except ConfigError as error:
            raise base.at.error(base.name, f"a scenario that takes what is set ({_inner(error)})") from error
        for knob in problem.knobs:
            for end in knob.ends:
                try:
                    scenario_at(problem, base, Place(values=middle | {knob.name: end}), folder)
                except ConfigError as error:
                    raise _about(knob, end, base, error) from error


def _about(knob: Knob, end: Any, base: Base, error: ConfigError) -> StrideTwinError:
    if error.source == knob.at.source:
        return error
    return knob.at.error(end, f"what {base.name} can have ({_inner(error)})")


def _inner(error: ConfigError) -> str:
    return f"{error.field}: {error.value!r} is not valid; valid: {error.valid}"
