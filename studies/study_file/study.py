"""Study files (YAML): the methods that are compared, and the walks on which they are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, cast

from pydantic import Field

from stridetwin.estimators import registry
from stridetwin.outputs.parameters import ParameterValues, check_used
from stridetwin.outputs.registry import kind_of
from stridetwin.streams.errors import FieldLocation
from stridetwin.streams.fields import FileModel, Text
from stridetwin.streams.validation import suggest, validate
from stridetwin.streams.yaml_file import LARGEST_FILE_VALUES, read_yaml
from stridetwin.studies.design import Design, DesignFile, read_design
from stridetwin.studies.study_file.methods import Method, make_method

_NIS = "nis_"
"""Prefix of the scores of the innovations (NIS) by kind of measurement, which are not declared one by one."""


class MethodInFile(FileModel):
    """A method to compare.

    Attributes:
        estimator: Name of an installed estimator.
        method: One of its methods; the first by default.
        parameters: Values of its parameters, by name; of an inner group as GROUP.NAME.
    """

    estimator: Text
    method: str = ""
    parameters: dict[str, object] = Field(default={})


class StudyFile(DesignFile):
    """A study: methods that are compared on walks under every combination of variations and faults.

    Attributes:
        methods: The methods by name; the others are compared with the first.
        scores: Names of scores that the methods' estimators have.
    """

    methods: Annotated[dict[str, MethodInFile], Field(min_length=1)]
    scores: Annotated[tuple[str, ...], Field(min_length=1)]


@dataclass(frozen=True, kw_only=True)
class Study(Design):
    """A study: its walks, the methods that are compared on them, and the scores by which they are.

    Attributes:
        methods: The methods; the others are compared with the first.
        scores: Names of the scores.
    """

    methods: tuple[Method, ...]
    scores: tuple[str, ...]


def read_study(path: Path, parameters: ParameterValues = MappingProxyType({})) -> Study:
    """Reads one study file and checks its methods and scores.

    Args:
        path: The file.
        parameters: Values for every method of their estimator, in place of the file's (`outputs.parameters`).

    Raises:
        ConfigError: The message names the file, the field, the value and what is valid.
        StrideTwinError: A file cannot be read.
    """
    where = FieldLocation(source=str(path))
    data = read_yaml(path, most_values=LARGEST_FILE_VALUES)
    file = validate(StudyFile, data, path)
    # `--set` may only name estimators of the study
    check_used(parameters, {spec.estimator for spec in file.methods.values()} & set(registry.names()))
    methods = tuple(
        make_method(
            name,
            spec.estimator,
            spec.method,
            {**spec.parameters, **parameters.get(spec.estimator, {})},  # those of `--set` replace the file's
            where.key("methods").key(name),
        )
        for name, spec in file.methods.items()
    )
    _check_scores(file, methods, where.key("scores"))
    design = read_design(file, cast("dict[str, object]", data), path)
    # a study has all attributes of its design
    return Study(**vars(design), methods=methods, scores=file.scores)


def _check_scores(file: StudyFile, methods: tuple[Method, ...], at: FieldLocation) -> None:
    """Raises ConfigError for a score that no method's kind of output has, or one that is named twice.

    Args:
        file: The study's file.
        methods: Its methods.
        at: Position of the list of scores.
    """
    kinds = [kind_of(registry.estimator(method.estimator).declaration) for method in methods]
    valid = list(dict.fromkeys(score.name for kind in kinds for score in kind.scores))
    for i, score in enumerate(file.scores):
        if score not in valid and not score.startswith(_NIS):
            raise at.item(i).error(score, suggest(score, valid))
        if score in file.scores[:i]:
            raise at.item(i).error(score, "every score once")
