"""Placement files (YAML): free fields, walks, scores and search; and the places that they describe.

Files that it names are in its folder or below it; it does not name the output folder.
"""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, Discriminator, Field, StrictInt, Tag

from stridetwin.scenarios.built_in import problems as problems
from stridetwin.scenarios.campaign.distributions import DistributionInFile
from stridetwin.scenarios.campaign.field_paths import PlainScenario, field_path, set_values
from stridetwin.scenarios.campaign.named_files import (
    FILES,
    SCENARIOS,
    Base,
    NamedBase,
    NamedFiles,
    Variable,
    errors_in_user_files,
    names_files,
    short_base,
)
from stridetwin.scenarios.scenario_file import Scenario, scenario_of
from stridetwin.sim.config import Person
from stridetwin.streams.errors import ConfigError, FieldLocation, StrideTwinError
from stridetwin.streams.fields import FileModel, OneKey, OneOf, Text
from stridetwin.streams.validation import suggest, validate
from stridetwin.streams.yaml_file import LARGEST_FILE_VALUES, read_yaml
from stridetwin.studies.placement.free import Among, Between, FreeField, FreeInFile, Knob, Over, free_field, grid_size
from stridetwin.studies.placement.scores import PlaceScore, ScoresInFile, Seeing
from stridetwin.studies.seeds import SeedsInFile

MAX_PLACES = 100_000
"""Most places of a sweep, and largest budget of a search."""
_SUFFIXES = (".yaml", ".yml")
AS_IT_IS = "as it is"
"""Label of the unchanged scenario."""


@dataclass(frozen=True, kw_only=True)
class Optimise:
    """A search by CMA-ES.

    Attributes:
        budget: Total number of places to try.
        starts: Number of restarts, among which the budget is divided.
    """

    budget: Annotated[StrictInt, Field(ge=1, le=MAX_PLACES)]
    starts: Annotated[StrictInt, Field(ge=1, le=100)] = 3


@dataclass(frozen=True, kw_only=True)
class Confirm:
    """Evaluation of the best places on further walks, which the search did not use.

    Attributes:
        places: Number of places.
        walks: Walks of each scenario.
    """

    places: Annotated[StrictInt, Field(ge=1, le=20)] = 5
    walks: Annotated[StrictInt, Field(ge=1, le=1000)] = 8


@dataclass(frozen=True, kw_only=True)
class PlacementProblem:
    """A placement as read from its file.

    Attributes:
        path: The file.
        description: Purpose of the placement, in one line.
        bases: Scenarios.
        variables: Values that are set at every place.
        free: Fields that are chosen.
        scores: Scores by which places are compared.
        seeds: Seeds of the walks of each scenario.
        seeing: When a board counts as seen.
        search: How places are found; None for a sweep over all.
        confirm: Further walks for the best places; None without.
        user_files: Files of the user's own by the names that they get in the output folder.
    """

    path: Path
    description: str
    bases: tuple[Base, ...]
    variables: tuple[Variable, ...]
    free: tuple[FreeField, ...]
    scores: tuple[PlaceScore, ...]
    seeds: tuple[int, ...]
    seeing: Seeing
    search: Optimise | None
    confirm: Confirm | None
    user_files: dict[str, Path]

    @property
    def knobs(self) -> list[Knob]:
        """Knobs of all free fields."""
        return [knob for free in self.free for knob in free.knobs]


_Method = Annotated[
    Annotated[Any, OneOf({"sweep": None}), Tag("=sweep")]
    | Annotated[Any, OneKey({"optimise": Optimise}), Tag("=optimise")],
    Discriminator(lambda node: "=optimise" if isinstance(node, dict) else "=sweep"),
]
_Base = Annotated[NamedBase, BeforeValidator(short_base, json_schema_input_type=str | NamedBase)]


class PlacementFile(BaseModel):
    """A placement: its free variables, walks, scores and search method.

    Attributes:
        placement: Purpose of the placement, in one line.
        scenarios: Scenarios, by name in the catalogue or path in the placement's folder.
        set: Paths into the scenarios, each with a value that all places share.
        free: Paths into the scenarios, each with the range or the values to choose from.
        scores: Scores by which places are compared; the search minimises their weighted sum.
        seeds: Seeds of the walks of each scenario: their number, from 0 on, or a list.
        seeing: When a board counts as seen.
        method: `sweep` over all places, or a search.
        confirm: The best places once more, on other walks.
    """

    model_config = FileModel.model_config
    placement: Text
    scenarios: Annotated[tuple[_Base, ...], Field(min_length=1)]
    set: dict[str, DistributionInFile] = {}
    free: Annotated[dict[str, FreeInFile], Field(min_length=1)]
    scores: ScoresInFile
    seeds: SeedsInFile = (0,)
    seeing: Seeing = Seeing()
    method: _Method = None
    confirm: Confirm | None = None


def find_problem(name: str) -> Path:
    """The file of a placement: of the catalogue, or a path.

    Raises:
        StrideTwinError: There is none; the message lists the valid ones.
    """
    if name in problems():
        return problems()[name]
    # a suffix or a folder tells a path from a name of the catalogue
    path = Path(name)
    if path.suffix.lower() in _SUFFIXES or path.parent != Path("."):
        return path
    raise StrideTwinError(f"invalid placement {name!r}: expected {suggest(name, problems())}, or a .yaml file")


def read_problem(path: Path) -> PlacementProblem:
    """Reads one placement file.

    Raises:
        ConfigError: The message names the file, the field, the value and what is valid.
        StrideTwinError: A file cannot be read.
    """
    where = FieldLocation(source=str(path))
    data = read_yaml(path, most_values=LARGEST_FILE_VALUES)
    file = validate(PlacementFile, data, path)
    assert isinstance(data, dict)  # it has been validated
    files = NamedFiles(path, "the placement's folder")
    bases = files.bases(file.scenarios, data["scenarios"], where.key("scenarios"))
    common = files.variables(file.set, where.key("set"))  # values that all scenarios share
    for variable in (*common, *(v for base in bases for v in base.variables)):
        if variable.varies:
            raise variable.at.error("a distribution", "one value; free variables belong in free")
    problem = PlacementProblem(
        path=path,
        description=file.placement,
        bases=bases,
        variables=common,
        free=tuple(
            _read_free_field(files, name, spec, where.key("free").key(name)) for name, spec in file.free.items()
        ),
        # these keys have the names of the attributes
        **{name: getattr(file, name) for name in ("scores", "seeds", "seeing", "confirm")},
        search=file.method,  # None for a sweep
        user_files=files.user_files,
    )
    names = [knob.name for knob in problem.knobs]
    if repeated_names := [name for name in names if names.count(name) > 1]:
        raise where.key("free").error(repeated_names[0], "every field once")
    if problem.search is None:
        if (count := grid_size(problem.knobs)) > MAX_PLACES:
            raise where.key("free").error(f"{count} places", f"up to {MAX_PLACES} places")
    elif all(knob.values for knob in problem.knobs):
        raise where.key("method").error("optimise", "sweep, as all free variables are choices")
    check_budget(problem, where.key("method").key("optimise").key("budget"))
    return problem


def check_budget(problem: PlacementProblem, at: FieldLocation) -> None:
    """Checks that the budget of a search suffices for one place per start, and per combination of choices.

    Args:
        problem: The placement.
        at: Position of the budget, for errors.

    Raises:
        ConfigError: The budget is too small; the message has the smallest valid one.
    """
    if problem.search is None:
        return
    combinations = math.prod(len(knob.values) for knob in problem.knobs if knob.values)
    min_budget = max(combinations, problem.search.starts)
    if problem.search.budget < min_budget:
        why = f"{combinations} combinations of choices, {problem.search.starts} starts"
        raise at.error(problem.search.budget, f"{min_budget} or more ({why})")


def _read_free_field(files: NamedFiles, name: str, spec: Between | Among | Over, at: FieldLocation) -> FreeField:
    """A free field of the block `free`, with the names that files get in the output folder.

    Args:
        files: Collects the files that the choices name.
        name: Key in the block: paths into the scenario, separated by commas.
        spec: A range, a choice, or a point on a surface.
        at: Position in the file.
    """
    paths = tuple(field_path(part.strip(), at) for part in name.split(","))
    if isinstance(spec, Among) and names_files(paths):
        spec = Among(choice=tuple(files.with_output_names(value, at) for value in spec.choice))
    return free_field(paths, spec, at)


@dataclass(frozen=True, kw_only=True)
class Place:
    """A place.

    Attributes:
        values: Values of all knobs by their names; empty for the unchanged scenario.
    """

    values: Mapping[str, object] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Text that is equal for equal places."""
        return json.dumps(self.values, sort_keys=True)

    @property
    def label(self) -> str:
        """Name of the place in tables and figures: its values, or `as it is`."""
        return ", ".join(f"{name} {format_value(value)}" for name, value in self.values.items()) or AS_IT_IS


def format_value(value: object) -> str:
    """A value as text for tables."""
    if isinstance(value, float):
        return f"{value:g}"
    # a file of the user's is shown without the folder that it has in the output
    text = value if isinstance(value, str) else json.dumps(value)
    return text.removeprefix(f"../{FILES}/")


def plain_of(problem: PlacementProblem, base: Base, place: Place) -> PlainScenario:
    """Plain data of a place's scenario file: the base with its values, then those of the place.

    Args:
        problem: The placement.
        base: The scenario.
        place: The place; one without values leaves the free fields as the scenario has them.

    Raises:
        ConfigError: This scenario lacks a field that is set or free.
    """
    plain = copy.deepcopy(base.scenario)
    for variable in (*problem.variables, *base.variables):
        set_values(plain, variable.paths, variable.distribution.at(0.0), variable.at)
    if place.values:
        person = _read_person(plain, problem.free, base)
        for free in problem.free:
            set_values(plain, free.paths, free.value(place.values, person), free.at)
    return plain


def scenario_at(problem: PlacementProblem, base: Base, place: Place, folder: Path) -> Scenario:
    """The scenario of a place; `folder` is the output folder with the user's files."""
    return scenario_of(plain_of(problem, base, place), folder / SCENARIOS / f"{base.name}.yaml")


def _read_person(plain: PlainScenario, free: Sequence[FreeField], base: Base) -> Person:
    """The walker of a scenario's plain data; the default person where no free field is on a surface.

    The whole scenario may be invalid before the free fields are set. So its `person` is read alone, on a few steps.

    Args:
        plain: Plain data of the scenario.
        free: The free fields.
        base: The scenario, which names the file in errors.
    """
    if all(f.surface is None for f in free):
        return Person()
    valid_scenario = {"description": "a few steps", "terrain": [{"level": {"length_m": 2}}]}
    person = {"person": plain["person"]} if "person" in plain else {}
    return scenario_of({**valid_scenario, **person}, Path(base.name)).config.person


def check_ends(problem: PlacementProblem, folder: Path) -> None:
    """Checks the unchanged scenarios, then the ends of every range with the other values at their middle.

    Raises:
        ConfigError: The message names file, field, value and what is valid.
    """
    middle = {knob.name: knob.middle for knob in problem.knobs}
    ends = [(knob, end) for knob in problem.knobs for end in knob.ends]
    # the unchanged scenario, then one place per end
    places = [Place(), *(Place(values=middle | {knob.name: end}) for knob, end in ends)]
    for base in problem.bases:
        for changed, place in zip([None, *ends], places):  # `changed`: knob and end of the place
            try:
                scenario_at(problem, base, place, folder)
            except ConfigError as error:
                located_error = errors_in_user_files(error, problem.user_files) or _locate_error(base, changed, error)
                raise located_error from error


def _locate_error(base: Base, changed: tuple[Knob, object] | None, error: ConfigError) -> StrideTwinError:
    """The error of a scenario at the place in the placement's file that causes it.

    Args:
        base: The scenario.
        changed: Knob and value that were set last; None for the unchanged scenario.
        error: Error of the scenario.
    """
    why = f"({error.field}: {error.problem})"
    if changed is None:
        return base.at.error(base.written, f"a scenario that takes what is set {why}")
    knob, end = changed
    if error.source == knob.at.source:  # it is located in the placement's file already
        return error
    # the scenario does not have a key of the path: `field` is the mapping that lacks it, and `value` the key
    if f"{knob.at.path}.".startswith(f"free.{error.field}.{error.value}."):
        return knob.at.error(error.value, error.valid)
    return knob.at.error(end, f"what {base.name} can have {why}")
