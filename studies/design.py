"""The walks of a study: scenarios under every combination of varied values, and values that take turns by seed.

Study files (`studies.study_file`) and the experiments of the catalogue (`studies.experiment`) share these keys. Files
that they name are in their folder or below it.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from stridetwin.scenarios.campaign.distributions import Fixed
from stridetwin.scenarios.campaign.field_paths import FieldPath, put
from stridetwin.scenarios.campaign.named_files import (
    SCENARIOS,
    Base,
    NamedBase,
    NamedFiles,
    Variable,
    errors_in_user_files,
)
from stridetwin.scenarios.scenario_file import Scenario, scenario_of
from stridetwin.scenarios.scenario_model import FaultInFile
from stridetwin.streams.errors import ConfigError, FieldLocation, StrideTwinError
from stridetwin.streams.fields import FileModel, int_field, text_field
from stridetwin.streams.validation import suggest
from stridetwin.studies.seeds import SeedsInFile

_SCENARIO, _FAULTS = "scenario", "faults"
_OTHER_COLUMNS = (_SCENARIO, _FAULTS, "seed", "method", "score", "value")
_MAX_COMBINATIONS = 10_000
_FAULT = re.compile(r"faults\[(\d+)\]\.?(.*)")
_Values = dict[str, Any]


def _name_levels(node: Any) -> Any:
    """The levels of a factor that a file only names: they set nothing by themselves."""
    return {str(name): {} for name in node} if isinstance(node, list) else node


_Levels = Annotated[
    dict[str, _Values],
    Field(min_length=1),
    BeforeValidator(_name_levels, json_schema_input_type=dict[str, _Values] | list[str]),
]


class Turn(FileModel):
    """How the levels of a factor take turns: walk i has level (i // every + numbers of the levels of `add`) % count.

    Attributes:
        every: Walks with one level before the next one.
        add: Other factors that take turns; the level moves on with theirs, as in a Latin square.
    """

    every: Annotated[int, int_field(1, 10_000)] = 1
    add: tuple[str, ...] = ()


class DesignFile(FileModel):
    """The walks of a study.

    Attributes:
        study: What is compared, in one line.
        scenarios: Scenarios, by name in the catalogue or path in the study's folder.
        seeds: Seeds of the walks of each combination: their number, from 0 on, `{first, count}`, or a list.
        set: Paths into the scenarios, each with a value that all walks share.
        vary: Factors by name, each with its levels by name: paths into the scenarios, each with a value, or a list of
            levels that set nothing by themselves. The path `scenario` replaces the whole scenario. `{FACTOR}` in a text
            is the level of that factor.
        turns: Factors of `vary` whose levels take turns from seed to seed, instead of being combined with all others.
        faults: Levels by name, each a list of faults, which are added to those of the scenario.
    """

    study: Annotated[str, text_field()]
    scenarios: tuple[Annotated[str, text_field()], ...] = Field(default=())
    seeds: SeedsInFile
    set: _Values = Field(default={})
    vary: dict[str, _Levels] = Field(default={})
    turns: dict[str, Turn] = Field(default={})
    faults: dict[str, tuple[FaultInFile, ...]] = Field(default={})


@dataclass(frozen=True, kw_only=True)
class Level:
    """A level of a factor.

    Attributes:
        name: Its name.
        at: Its position in the file.
        variables: Values that it sets.
        faults: Faults that it adds, as plain data.
        base: The scenario that it sets; None leaves it.
    """

    name: str
    at: FieldLocation
    variables: tuple[Variable, ...] = ()
    faults: tuple[Any, ...] = ()
    base: Base | None = None


@dataclass(frozen=True, kw_only=True)
class Combination:
    """A scenario and one level of each factor.

    Attributes:
        base: The scenario.
        levels: One of each factor.
        labels: Names of the levels by factor; the scenario is a factor if there are several.
    """

    base: Base
    levels: tuple[Level, ...]
    labels: Mapping[str, str]

    def with_levels(self, levels: Mapping[str, Level]) -> Combination:
        """This one with levels of other factors, which come first."""
        labels = {name: level.name for name, level in levels.items()}
        return Combination(base=self.base, levels=(*levels.values(), *self.levels), labels={**labels, **self.labels})


@dataclass(frozen=True, kw_only=True)
class Design:
    """The walks that a file describes.

    Attributes:
        path: The file.
        description: What is compared, in one line.
        variables: Set in every walk.
        combinations: Every combination of scenarios and levels of the factors that take no turns; the last factor, the
            faults, changes first.
        turns: How the levels of the other factors take turns, and these levels.
        first: Seed of the walk in which each of these factors has its first level.
        seeds: Of the walks of each combination.
        own: Files of the user's own by the names that they get in the output folder.
    """

    path: Path
    description: str
    variables: tuple[Variable, ...]
    combinations: tuple[Combination, ...]
    turns: Mapping[str, tuple[Turn, tuple[Level, ...]]]
    first: int
    seeds: tuple[int, ...]
    own: Mapping[str, Path]

    def levels(self, seed: int) -> dict[str, Level]:
        """Whose turn it is with a seed: a level of each factor that takes turns."""
        return {name: self.turns[name][1][self._number(name, seed)] for name in self.turns}

    def _number(self, name: str, seed: int) -> int:
        turn, levels = self.turns[name]
        walk = (seed - self.first) // turn.every
        return (walk + sum(self._number(other, seed) for other in turn.add)) % len(levels)

    def walks(self, seed: int) -> list[Combination]:
        """Every combination, with the levels whose turn it is."""
        levels = self.levels(seed)
        return [combination.with_levels(levels) for combination in self.combinations]


def read_design(file: DesignFile, data: Any, path: Path, *, cross_faults: bool = True) -> Design:
    """The walks that the keys of a file describe.

    Args:
        file: Its keys.
        data: The same as plain data.
        path: Of the file.
        cross_faults: Faults are one more factor; otherwise they are left to the caller.

    Raises:
        ConfigError: The message names the file, the field, the value and what is valid.
    """
    where = FieldLocation(source=str(path))
    files = NamedFiles(path, "the study's folder")
    named = [NamedBase(scenario=name) for name in file.scenarios]
    bases = files.bases(named, data.get("scenarios", []), where.key("scenarios"))
    factors = _read_factors(file, files, where)
    turns = {name: (turn, factors.pop(name)) for name, turn in _check_turns(file, where).items()}
    if file.faults and cross_faults:
        at, lists = where.key(_FAULTS), data[_FAULTS]
        factors[_FAULTS] = tuple(Level(name=name, at=at.key(name), faults=tuple(lists[name])) for name in lists)
    if not bases:
        bases = _first_scenario([*factors.values(), *(levels for _, levels in turns.values())], where)
    names = [*factors, *([_SCENARIO] if len(bases) > 1 else [])]
    if (count := len(bases) * math.prod(map(len, factors.values()))) > _MAX_COMBINATIONS:
        raise where.key("vary").error(f"{count} combinations", f"up to {_MAX_COMBINATIONS}")
    combinations = tuple(
        Combination(base=base, levels=levels, labels=dict(zip(names, [*(level.name for level in levels), base.name])))
        for base in bases
        for levels in product(*factors.values())
    )
    return Design(
        path=path,
        description=file.study,
        variables=_read_values(file.set, files, where.key("set")),
        combinations=combinations,
        turns=turns,
        first=file.seeds[0],
        seeds=file.seeds,
        own=files.own,
    )


def _first_scenario(factors: Iterable[tuple[Level, ...]], where: FieldLocation) -> tuple[Base, ...]:
    """The scenario of a design without the key `scenarios`: a factor sets it."""
    for levels in factors:
        if levels[0].base is not None and all(level.base for level in levels):
            return (levels[0].base,)
    raise where.key("scenarios").error([], "one or more scenarios, or a factor of `vary` that sets `scenario`")


def _check_turns(file: DesignFile, where: FieldLocation) -> dict[str, Turn]:
    """The factors that take turns, after those that move them on."""
    for name, turn in file.turns.items():
        at = where.key("turns").key(name)
        if name not in file.vary:
            raise at.error(name, suggest(name, file.vary) or "a factor of `vary`")
        before = list(file.turns)[: list(file.turns).index(name)]
        for i, other in enumerate(turn.add):
            if other not in before:
                raise at.key("add").item(i).error(other, f"a factor above it: {', '.join(before) or 'none'}")
    return file.turns


def _read_factors(file: DesignFile, files: NamedFiles, where: FieldLocation) -> dict[str, tuple[Level, ...]]:
    factors = {}
    for name, levels in file.vary.items():
        if name in _OTHER_COLUMNS:
            raise where.key("vary").error(name, f"a name other than {', '.join(_OTHER_COLUMNS)}")
        at = where.key("vary").key(name)
        factors[name] = tuple(_read_level(level, values, files, at.key(level)) for level, values in levels.items())
    return factors


def _read_level(name: str, values: _Values, files: NamedFiles, at: FieldLocation) -> Level:
    values = dict(values)
    scenario = values.pop(_SCENARIO, None)
    base = None
    if scenario is not None:
        base = files.base(NamedBase(scenario=str(scenario)), at.key(_SCENARIO), short=True)
    return Level(name=name, at=at, variables=_read_values(values, files, at), base=base)


def _read_values(values: _Values, files: NamedFiles, at: FieldLocation) -> tuple[Variable, ...]:
    return files.variables({path: Fixed(fixed=value) for path, value in values.items()}, at)


def make_scenario(design: Design, combination: Combination, folder: Path, physics: str | None = None) -> Scenario:
    """The scenario of a combination.

    Args:
        design: The design.
        combination: One of it.
        folder: The output folder, which contains the user's parts.
        physics: Replaces that of the scenario.

    Raises:
        ConfigError: The scenario is invalid with what is set; the message names the place in the study file.
    """
    base = next((level.base for level in reversed(combination.levels) if level.base), combination.base)
    plain = json.loads(json.dumps(base.scenario))
    variables = [*design.variables, *(v for level in combination.levels for v in level.variables)]
    for variable in variables:
        value = json.loads(json.dumps(variable.distribution.at(0.0)))
        for path in variable.paths:
            put(plain, path, _fill(value, combination.labels, variable.at), variable.at)
    if physics is not None:
        plain["physics"] = physics
    places = [base.at] * len(plain.get(_FAULTS, ()))  # of each fault in the file
    for level in combination.levels:
        for i, fault in enumerate(level.faults):
            plain.setdefault(_FAULTS, []).append(fault)
            places.append(level.at.item(i))
    try:
        return scenario_of(plain, folder / SCENARIOS / f"{base.name}.yaml")
    except ConfigError as error:
        raise errors_in_user_files(error, design.own) or _locate(error, base, variables, places) from error


def _fill(value: Any, labels: Mapping[str, str], at: FieldLocation) -> Any:
    """A value with `{FACTOR}` in a text replaced by the level of that factor."""
    if not isinstance(value, str) or "{" not in value:
        return value
    try:
        return value.format_map(labels)
    except (KeyError, ValueError, IndexError, AttributeError):
        raise at.error(value, f"names of factors between braces: {', '.join(labels)}") from None


def _locate(error: ConfigError, base: Base, variables: list[Variable], faults: list[FieldLocation]) -> StrideTwinError:
    """An error of a scenario at the place in the study file that causes it."""
    for variable in reversed(variables):
        if any(_concerns(path, error) for path in variable.paths):
            return variable.at.error(error.value, error.valid)
    fault = _FAULT.fullmatch(error.field)
    if fault and (at := faults[int(fault[1])]) != base.at:
        return (at.key(fault[2]) if fault[2] else at).error(error.value, error.valid)
    return base.at.error(base.written, f"a scenario that takes what is set ({error.field}: {error.problem})")


def _concerns(path: FieldPath, error: ConfigError) -> bool:
    """Whether an error lies in the value of a path, or is about an unknown key in the path itself."""
    unknown_key = f"{error.field}.{error.value}.".lstrip(".")
    return f"{error.field}.".startswith(f"{path.text}.") or f"{path.text}.".startswith(unknown_key)
