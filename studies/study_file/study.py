"""Study files (YAML): the methods that are compared, the walks, and what is varied.

Files that a study names are in its folder or below it; it does not name the output folder.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from stridetwin.estimators import registry
from stridetwin.outputs.registry import kind_of
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
from stridetwin.streams.errors import ConfigError, StrideTwinError, Where
from stridetwin.streams.fields import FileModel, text
from stridetwin.streams.validation import suggest, validated
from stridetwin.streams.yaml_file import LARGEST_FILE_VALUES, read_yaml
from stridetwin.studies.seeds import SeedsInFile
from stridetwin.studies.study_file.methods import Method, make_method

_SCENARIO, _FAULTS = "scenario", "faults"
_OTHER_COLUMNS = (_SCENARIO, _FAULTS, "seed", "method", "score", "value")
_MAX_COMBINATIONS = 10_000
_NIS = "nis_"
"""Prefix of the scores of paths that are not declared one by one."""
_FAULT = re.compile(r"faults\[(\d+)\]\.?(.*)")


class MethodInFile(FileModel):
    """A method to compare.

    Attributes:
        estimator: Name of an installed estimator.
        method: One of its methods; the first by default.
        parameters: Values of its parameters, by name; of an inner group as GROUP.NAME.
    """

    estimator: Annotated[str, text()]
    method: str = ""
    parameters: dict[str, Any] = Field(default={})


_Values = dict[str, Any]


class StudyFile(FileModel):
    """A study: methods that are compared on walks under every combination of variations and faults.

    Attributes:
        study: What is compared, in one line.
        scenarios: Scenarios, by name in the catalogue or path in the study's folder.
        seeds: Seeds of the walks of each combination: their number, from 0 on, or a list.
        set: Paths into the scenarios, each with a value that all walks share.
        vary: Factors by name, each with its levels by name: paths into the scenarios, each with a value.
        faults: One more factor: levels by name, each a list of faults, which are added to those of the scenario.
        methods: The methods by name; the others are compared with the first.
        scores: Names of scores that the methods' estimators have.
    """

    study: Annotated[str, text()]
    scenarios: Annotated[tuple[Annotated[str, text()], ...], Field(min_length=1)]
    seeds: SeedsInFile
    set: _Values = Field(default={})
    vary: dict[str, Annotated[dict[str, _Values], Field(min_length=1)]] = Field(default={})
    faults: dict[str, tuple[FaultInFile, ...]] = Field(default={})
    methods: Annotated[dict[str, MethodInFile], Field(min_length=1)]
    scores: Annotated[tuple[str, ...], Field(min_length=1)]


@dataclass(frozen=True, kw_only=True)
class Level:
    """A level of a factor: its name and position in the file, the values that it sets, and the faults that it adds."""

    name: str
    at: Where
    variables: tuple[Variable, ...] = ()
    faults: tuple[Any, ...] = ()


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


@dataclass(frozen=True, kw_only=True)
class Study:
    """What a study file says; the other attributes are those of `StudyFile`.

    Attributes:
        path: The file.
        variables: Set in every walk.
        combinations: Every combination of scenarios and levels; the last factor, the faults, changes first.
        own: Files of the user's own by the names that they get in the output folder.
    """

    path: Path
    description: str
    variables: tuple[Variable, ...]
    combinations: tuple[Combination, ...]
    methods: tuple[Method, ...]
    scores: tuple[str, ...]
    seeds: tuple[int, ...]
    own: dict[str, Path]


def read_study(path: Path) -> Study:
    """Reads one study file.

    Raises:
        ConfigError: The message names the file, the field, the value and what is valid.
        StrideTwinError: A file cannot be read.
    """
    where = Where(source=str(path))
    data = read_yaml(path, most_values=LARGEST_FILE_VALUES)
    file = validated(StudyFile, data, path)
    files = NamedFiles(path, "the study's folder")
    methods = tuple(
        make_method(name, said.estimator, said.method, said.parameters, where.key("methods").key(name))
        for name, said in file.methods.items()
    )
    _check_scores(file, methods, where.key("scores"))
    named = [NamedBase(scenario=name) for name in file.scenarios]
    bases = files.bases(named, data["scenarios"], where.key("scenarios"))
    factors = _read_factors(file, data, files, where)
    names = [*factors, *([_SCENARIO] if len(bases) > 1 else [])]
    if (count := len(bases) * math.prod(map(len, factors.values()))) > _MAX_COMBINATIONS:
        raise where.key("vary").error(f"{count} combinations", f"up to {_MAX_COMBINATIONS}")
    combinations = tuple(
        Combination(base=base, levels=levels, labels=dict(zip(names, [*(level.name for level in levels), base.name])))
        for base in bases
        for levels in product(*factors.values())
    )
    return Study(
        path=path,
        description=file.study,
        variables=_read_values(file.set, files, where.key("set")),
        combinations=combinations,
        methods=methods,
        **{name: getattr(file, name) for name in ("scores", "seeds")},
        own=files.own,
    )


def _check_scores(file: StudyFile, methods: tuple[Method, ...], at: Where) -> None:
    kinds = [kind_of(registry.estimator(method.estimator).declaration) for method in methods]
    valid = list(dict.fromkeys(score.name for kind in kinds for score in kind.scores))
    for i, score in enumerate(file.scores):
        if score not in valid and not score.startswith(_NIS):
            raise at.item(i).error(score, suggest(score, valid))
        if score in file.scores[:i]:
            raise at.item(i).error(score, "every score once")


def _read_factors(file: StudyFile, data: Any, files: NamedFiles, where: Where) -> dict[str, tuple[Level, ...]]:
    factors = {}
    for name, levels in file.vary.items():
        if name in _OTHER_COLUMNS:
            raise where.key("vary").error(name, f"a name other than {', '.join(_OTHER_COLUMNS)}")
        at = where.key("vary").key(name)
        factors[name] = tuple(
            Level(name=level, at=at.key(level), variables=_read_values(values, files, at.key(level)))
            for level, values in levels.items()
        )
    if file.faults:
        at, lists = where.key(_FAULTS), data[_FAULTS]
        factors[_FAULTS] = tuple(Level(name=name, at=at.key(name), faults=tuple(lists[name])) for name in lists)
    return factors


def _read_values(values: _Values, files: NamedFiles, at: Where) -> tuple[Variable, ...]:
    return files.variables({path: Fixed(fixed=value) for path, value in values.items()}, at)


def make_scenario(study: Study, combination: Combination, folder: Path, physics: str | None = None) -> Scenario:
    """The scenario of a combination.

    Args:
        study: The study.
        combination: One of it.
        folder: The output folder, which contains the user's parts.
        physics: Replaces that of the scenario.

    Raises:
        ConfigError: The scenario is invalid with what is set; the message names the place in the study file.
    """
    base, plain = combination.base, json.loads(json.dumps(combination.base.scenario))
    variables = [*study.variables, *(v for level in combination.levels for v in level.variables)]
    for variable in variables:
        for path in variable.paths:
            put(plain, path, json.loads(json.dumps(variable.distribution.at(0.0))), variable.at)
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
        raise errors_in_user_files(error, study.own) or _locate(error, base, variables, places) from error


def _locate(error: ConfigError, base: Base, variables: list[Variable], faults: list[Where]) -> StrideTwinError:
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
