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
from typing import Annotated

from pydantic import BeforeValidator, Field, StrictInt

from stridetwin.scenarios.campaign.distributions import Fixed
from stridetwin.scenarios.campaign.field_paths import FieldPath, set_values
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
from stridetwin.streams.fields import FileModel, Text
from stridetwin.streams.validation import suggest
from stridetwin.studies.seeds import SeedsInFile

_SCENARIO, _FAULTS = "scenario", "faults"  # names of these two factors, and keys of a file
_RESERVED_COLUMNS = (_SCENARIO, _FAULTS, "seed", "method", "score", "value")  # of the tables; no factor's name
_MAX_COMBINATIONS = 10_000
_FAULT = re.compile(r"faults\[(\d+)\]\.?(.*)")  # field of a scenario's error: number of the fault, and field in it
_Values = dict[str, object]
"""Paths into the scenarios, each with a value."""


def _name_levels(node: object) -> object:
    """The levels of a factor that a file only names: they set nothing by themselves."""
    return {str(name): {} for name in node} if isinstance(node, list) else node


_Levels = Annotated[
    dict[str, _Values],
    Field(min_length=1),
    BeforeValidator(_name_levels, json_schema_input_type=dict[str, _Values] | list[str]),
]


class LevelSchedule(FileModel):
    """How the levels of a factor take turns: walk i has level (i // every + numbers of the levels of `add`) % count.

    Attributes:
        every: Walks with one level before the next one.
        add: Other factors that take turns; the level moves on with theirs, as in a Latin square.
    """

    every: Annotated[StrictInt, Field(ge=1, le=10_000)] = 1
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

    study: Text
    scenarios: tuple[Text, ...] = Field(default=())
    seeds: SeedsInFile
    set: _Values = Field(default={})
    vary: dict[str, _Levels] = Field(default={})
    turns: dict[str, LevelSchedule] = Field(default={})
    faults: dict[str, tuple[FaultInFile, ...]] = Field(default={})


@dataclass(frozen=True, kw_only=True)
class FactorLevel:
    """A level of a factor: the values, faults or scenario that it sets in a walk.

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
    faults: tuple[object, ...] = ()
    base: Base | None = None


@dataclass(frozen=True, kw_only=True)
class Combination:
    """A scenario and one level of each factor: one of the combinations that a study walks.

    Attributes:
        base: The scenario.
        levels: One of each factor.
        labels: Names of the levels by factor; the scenario is a factor if there are several.
    """

    base: Base
    levels: tuple[FactorLevel, ...]
    labels: Mapping[str, str]

    def with_levels(self, levels: Mapping[str, FactorLevel]) -> Combination:
        """This combination with levels of further factors, which are set before its own."""
        labels = {name: level.name for name, level in levels.items()}
        return Combination(base=self.base, levels=(*levels.values(), *self.levels), labels={**labels, **self.labels})


@dataclass(frozen=True, kw_only=True)
class Design:
    """The walks that a study file or an experiment describes.

    Attributes:
        path: The file.
        description: What is compared, in one line.
        variables: Set in every walk.
        combinations: Every combination of scenarios and levels of the factors that take no turns; the last factor, the
            faults, changes first.
        turns: By name of each other factor, how its levels take turns, and these levels.
        first: Seed of the walk in which each of these factors has its first level.
        seeds: Of the walks of each combination.
        user_files: Files of the user's own by the names that they get in the output folder.
    """

    path: Path
    description: str
    variables: tuple[Variable, ...]
    combinations: tuple[Combination, ...]
    turns: Mapping[str, tuple[LevelSchedule, tuple[FactorLevel, ...]]]
    first: int
    seeds: tuple[int, ...]
    user_files: Mapping[str, Path]

    def levels(self, seed: int) -> dict[str, FactorLevel]:
        """The level whose turn it is with a seed, for each factor that takes turns."""
        return {name: levels[self._level_number(name, seed)] for name, (_, levels) in self.turns.items()}

    def _level_number(self, name: str, seed: int) -> int:
        """Number of the level of a factor whose turn it is with a seed.

        It is (walk // every + Σ numbers of the added factors) % count, where walk is the number of the walk from the
        first seed on, and count the number of levels.
        """
        turn, levels = self.turns[name]
        walk = (seed - self.first) // turn.every
        return (walk + sum(self._level_number(added_factor, seed) for added_factor in turn.add)) % len(levels)

    def walks(self, seed: int) -> list[Combination]:
        """Every combination, with the levels whose turn it is with a seed."""
        levels = self.levels(seed)
        return [combination.with_levels(levels) for combination in self.combinations]


def read_design(file: DesignFile, data: Mapping[str, object], path: Path, *, cross_faults: bool = True) -> Design:
    """The walks that the keys of a file describe.

    Args:
        file: The validated keys.
        data: The keys as plain data, as the file has them; faults are kept in this form.
        path: The file.
        cross_faults: Faults are one more factor; otherwise they are left to the caller.

    Raises:
        ConfigError: The message names the file, the field, the value and what is valid.
    """
    where = FieldLocation(source=str(path))
    files = NamedFiles(path, "the study's folder")
    named = [NamedBase(scenario=name) for name in file.scenarios]
    nodes = data.get("scenarios", [])  # the same names as plain data
    assert isinstance(nodes, list)  # the file has been validated
    bases = files.bases(named, nodes, where.key("scenarios"))
    factors = _read_factors(file, files, where)
    # factors that take turns leave those that are combined
    turns = {name: (turn, factors.pop(name)) for name, turn in _check_turns(file, where).items()}
    if file.faults and cross_faults:
        # the faults are the last factor, which changes first; plain data of the lists of faults, by level
        at, lists = where.key(_FAULTS), data[_FAULTS]
        assert isinstance(lists, dict)
        factors[_FAULTS] = tuple(FactorLevel(name=name, at=at.key(name), faults=tuple(lists[name])) for name in lists)
    if not bases:
        bases = _first_scenario([*factors.values(), *(levels for _, levels in turns.values())], where)
    # the scenario is a factor, the last name, where there are several
    names = [*factors, *([_SCENARIO] if len(bases) > 1 else [])]
    if (count := len(bases) * math.prod(map(len, factors.values()))) > _MAX_COMBINATIONS:
        raise where.key("vary").error(f"{count} combinations", f"up to {_MAX_COMBINATIONS}")
    # `zip` leaves the scenario's name out where there is only one and `names` has no factor for it
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
        user_files=files.user_files,
    )


def _first_scenario(factors: Iterable[tuple[FactorLevel, ...]], where: FieldLocation) -> tuple[Base, ...]:
    """The scenario of a design without the key `scenarios`: that of a factor's first level, alone in a tuple.

    Args:
        factors: Levels of each factor; one factor must set a scenario in every level.
        where: Position of the file, for errors.

    Raises:
        ConfigError: No factor does.
    """
    for levels in factors:
        if levels[0].base is not None and all(level.base for level in levels):
            return (levels[0].base,)
    raise where.key("scenarios").error([], "one or more scenarios, or a factor of `vary` that sets `scenario`")


def _check_turns(file: DesignFile, where: FieldLocation) -> dict[str, LevelSchedule]:
    """Checks the block `turns` and returns it: the schedule of each factor that takes turns.

    Raises:
        ConfigError: A name is that of no factor, or a factor of `add` is not one above it in the block.
    """
    for name, turn in file.turns.items():
        at = where.key("turns").key(name)
        if name not in file.vary:
            raise at.error(name, suggest(name, file.vary) or "a factor of `vary`")
        before = list(file.turns)[: list(file.turns).index(name)]  # factors above it in the block
        for i, added_factor in enumerate(turn.add):
            if added_factor not in before:
                raise at.key("add").item(i).error(added_factor, f"a factor above it: {', '.join(before) or 'none'}")
    return file.turns


def _read_factors(file: DesignFile, files: NamedFiles, where: FieldLocation) -> dict[str, tuple[FactorLevel, ...]]:
    """The levels of each factor of the block `vary`.

    Args:
        file: The validated keys.
        files: Collects the files that the levels name.
        where: Position of the file, for errors.

    Raises:
        ConfigError: A factor has the name of a column of the tables, or a level is invalid.
    """
    factors = {}
    for name, levels in file.vary.items():
        if name in _RESERVED_COLUMNS:
            raise where.key("vary").error(name, f"a name other than {', '.join(_RESERVED_COLUMNS)}")
        at = where.key("vary").key(name)
        factors[name] = tuple(_read_level(level, values, files, at.key(level)) for level, values in levels.items())
    return factors


def _read_level(name: str, values: _Values, files: NamedFiles, at: FieldLocation) -> FactorLevel:
    """A level from its values; the key `scenario` among them replaces the whole scenario.

    Args:
        name: Name of the level.
        values: Paths into the scenarios, each with a value.
        files: Collects the files that they name.
        at: Position of the level in the file.
    """
    values = dict(values)
    scenario = values.pop(_SCENARIO, None)
    base = None
    if scenario is not None:
        base = files.base(NamedBase(scenario=str(scenario)), at.key(_SCENARIO), short=True)
    return FactorLevel(name=name, at=at, variables=_read_values(values, files, at), base=base)


def _read_values(values: _Values, files: NamedFiles, at: FieldLocation) -> tuple[Variable, ...]:
    """Variables that set fixed values in a scenario.

    Args:
        values: Paths into the scenarios, each with a value.
        files: Collects the files that the values name.
        at: Position of the values in the study file.
    """
    return files.variables({path: Fixed(fixed=value) for path, value in values.items()}, at)


def make_scenario(design: Design, combination: Combination, folder: Path, physics: str | None = None) -> Scenario:
    """Makes the scenario of a combination: its base with the design's values, then those of its levels, and its faults.

    Args:
        design: The design.
        combination: One of its combinations.
        folder: The output folder, which contains the user's parts.
        physics: How the body moves, in place of the scenario's; None leaves it.

    Raises:
        ConfigError: The scenario is invalid with what is set; the message names the place in the study file.
    """
    # the last level that sets a scenario replaces it
    base = next((level.base for level in reversed(combination.levels) if level.base), combination.base)
    plain = json.loads(json.dumps(base.scenario))  # a deep copy
    variables = [*design.variables, *(v for level in combination.levels for v in level.variables)]
    for variable in variables:
        value = json.loads(json.dumps(variable.distribution.at(0.0)))  # a fixed value, the same at any quantile
        set_values(plain, variable.paths, _fill_factors(value, combination.labels, variable.at), variable.at)
    if physics is not None:
        plain["physics"] = physics
    # position in the study file of each fault of the scenario; its own faults have that of its name
    places = [base.at] * len(plain.get(_FAULTS, ()))
    for level in combination.levels:
        for i, fault in enumerate(level.faults):
            plain.setdefault(_FAULTS, []).append(fault)
            places.append(level.at.item(i))
    try:
        return scenario_of(plain, folder / SCENARIOS / f"{base.name}.yaml")
    except ConfigError as error:
        raise errors_in_user_files(error, design.user_files) or _locate(error, base, variables, places) from error


def _fill_factors(value: object, labels: Mapping[str, str], at: FieldLocation) -> object:
    """A value with `{FACTOR}` in a text replaced by the level of that factor; other values come back as they are.

    Args:
        value: Plain data.
        labels: Names of the levels by factor.
        at: Position of the value in the file, for errors.

    Raises:
        ConfigError: The text names no factor, or is no format string.
    """
    if not isinstance(value, str) or "{" not in value:
        return value
    try:
        return value.format_map(labels)
    except (KeyError, ValueError, IndexError, AttributeError):
        raise at.error(value, f"names of factors between braces: {', '.join(labels)}") from None


def _locate(error: ConfigError, base: Base, variables: list[Variable], faults: list[FieldLocation]) -> StrideTwinError:
    """An error of a scenario at the place in the study file that causes it.

    Args:
        error: The error, whose field is a path in the scenario.
        base: The scenario.
        variables: Values that were set, in order; the last one that concerns the field causes the error.
        faults: Position of each fault of the scenario: `base.at` for one of its own.

    Returns:
        The error at the variable or at the fault, else at the scenario's name.
    """
    for variable in reversed(variables):
        if any(_is_about(path, error) for path in variable.paths):
            return variable.at.error(error.value, error.valid)
    fault_match = _FAULT.fullmatch(error.field)
    if fault_match:
        number, field_of_fault = fault_match.groups()
        at = faults[int(number)]
        if at != base.at:  # the study adds the fault
            return (at.key(field_of_fault) if field_of_fault else at).error(error.value, error.valid)
    return base.at.error(base.written, f"a scenario that takes what is set ({error.field}: {error.problem})")


def _is_about(path: FieldPath, error: ConfigError) -> bool:
    """Whether an error lies in the value of a path, or is about an unknown key in the path itself.

    The dots that are appended keep a field from matching another one whose name only begins like it.
    """
    # of an unknown key, `field` is the mapping that holds it, and `value` the key
    unknown_key = f"{error.field}.{error.value}.".lstrip(".")
    return f"{error.field}.".startswith(f"{path.text}.") or f"{path.text}.".startswith(unknown_key)
