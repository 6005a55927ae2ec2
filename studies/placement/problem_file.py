"""Placement files (YAML): what is free, on which walks, by which scores, and how it is searched; checked key by key.

Files that it names lie in its folder or below it; nothing in it says where anything is written.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag

from stridetwin.scenarios.campaign.distributions import DistributionInFile
from stridetwin.scenarios.campaign.field_paths import field_path
from stridetwin.scenarios.campaign.named_files import Base, NamedBase, NamedFiles, Variable, names_files, short_base
from stridetwin.streams.errors import StrideTwinError, Where
from stridetwin.streams.fields import OneKey, refused, text, whole, words
from stridetwin.streams.validation import suggest, validated
from stridetwin.streams.yaml_file import LARGEST_FILE_VALUES, read_yaml
from stridetwin.studies.placement.free import Among, Between, Free, FreeInFile, Knob, Over, free_field, grid_size
from stridetwin.studies.placement.scores import Score, ScoresInFile
from stridetwin.studies.placement.sight import Seeing

MOST_PLACES = 100_000
_SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True, kw_only=True)
class Optimise:
    """A search by CMA-ES.

    Attributes:
        budget: Total number of places to try.
        starts: Number of restarts, among which the budget is divided.
    """

    budget: Annotated[int, whole(1, MOST_PLACES)]
    starts: Annotated[int, whole(1, 100)] = 3


@dataclass(frozen=True, kw_only=True)
class Confirm:
    """Evaluation of the best places on further walks, which the search did not use.

    Attributes:
        places: Number of places.
        walks: Walks of each scenario.
    """

    places: Annotated[int, whole(1, 20)] = 5
    walks: Annotated[int, whole(1, 1000)] = 8


@dataclass(frozen=True, kw_only=True)
class Problem:
    """What a placement file says.

    Attributes:
        path: The file.
        description: One line.
        bases: Scenarios.
        variables: Set at every place.
        free: What is chosen.
        scores: By which places are told apart; the search makes their weighted sum small.
        seeds: Of the walks of each scenario, the same at every place.
        seeing: When a board counts as seen.
        search: How places are found; None for a sweep over all.
        confirm: The best places once more; None without.
        own: Files of the user's own by the names that they get in the output folder.
    """

    path: Path
    description: str
    bases: tuple[Base, ...]
    variables: tuple[Variable, ...] = ()
    free: tuple[Free, ...]
    scores: tuple[Score, ...]
    seeds: tuple[int, ...] = (0,)
    seeing: Seeing = field(default_factory=Seeing)
    search: Optimise | None = None
    confirm: Confirm | None = None
    own: dict[str, Path] = field(default_factory=dict)

    @property
    def knobs(self) -> list[Knob]:
        """Every value to choose."""
        return [knob for free in self.free for knob in free.knobs]


def _unique(seeds: tuple[int, ...]) -> tuple[int, ...]:
    if len(set(seeds)) < len(seeds):
        raise refused(list(seeds), "every seed once")
    return seeds


_Seeds = Annotated[
    Annotated[int, whole(1, 10_000), AfterValidator(lambda count: tuple(range(count))), Tag("=count")]
    | Annotated[
        tuple[Annotated[int, whole(0, 2**31)], ...], Field(min_length=1), AfterValidator(_unique), Tag("=list")
    ],
    Discriminator(lambda node: "=list" if isinstance(node, list) else "=count"),
]
_Method = Annotated[
    Annotated[Any, words({"sweep": None}), Tag("=sweep")]
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

    model_config = ConfigDict(extra="forbid", frozen=True)
    placement: Annotated[str, text()]
    scenarios: Annotated[tuple[_Base, ...], Field(min_length=1)]
    set: dict[str, DistributionInFile] = {}
    free: Annotated[dict[str, FreeInFile], Field(min_length=1)]
    scores: ScoresInFile
    seeds: _Seeds = (0,)
    seeing: Seeing = Seeing()
    method: _Method = None
    confirm: Confirm | None = None


def problems() -> dict[str, Path]:
    """The placements that come with the project, name to file, sorted by name."""
    folder = Path(str(resources.files("stridetwin.studies.placement"))) / "catalogue"
    return {p.stem: p for p in sorted(folder.glob("*.yaml"))}


def find_problem(name: str) -> Path:
    """The file of a placement: of the catalogue, or a path.

    Raises:
        StrideTwinError: There is none; the message lists those there are.
    """
    if name in problems():
        return problems()[name]
    path = Path(name)
    if path.suffix.lower() in _SUFFIXES or path.parent != Path("."):
        return path
    raise StrideTwinError(f"there is no placement {name!r}; valid: {suggest(name, problems())}, or a .yaml file")


def read_problem(path: Path) -> Problem:
    """Reads one placement file.

    Raises:
        ConfigError: The message names the file, the field, the value and what is valid.
        StrideTwinError: A file cannot be read.
    """
    where = Where(source=str(path))
    data = read_yaml(path, most_values=LARGEST_FILE_VALUES)
    file = validated(PlacementFile, data, path)
    files = NamedFiles(path, "the placement's folder")
    bases = files.bases(file.scenarios, data["scenarios"], where.key("scenarios"))
    common = files.variables(file.set, where.key("set"))
    for variable in (*common, *(v for base in bases for v in base.variables)):
        if variable.varies:
            raise variable.at.error("a distribution", "one value; what is to be chosen stands in free")
    problem = Problem(
        path=path,
        description=file.placement,
        bases=bases,
        variables=common,
        free=tuple(_free(files, name, said, where.key("free").key(name)) for name, said in file.free.items()),
        **{name: getattr(file, name) for name in ("scores", "seeds", "seeing", "confirm")},
        search=file.method,
        own=files.own,
    )
    names = [knob.name for knob in problem.knobs]
    if twice := [name for name in names if names.count(name) > 1]:
        raise where.key("free").error(twice[0], "every field once")
    if problem.search is None:
        if (count := grid_size(problem.knobs)) > MOST_PLACES:
            raise where.key("free").error(f"{count} places", f"up to {MOST_PLACES} places")
    elif all(knob.values for knob in problem.knobs):
        raise where.key("method").error("optimise", "sweep, as there is nothing but choices")
    check_budget(problem, where.key("method").key("optimise").key("budget"))
    return problem


def check_budget(problem: Problem, at: Where) -> None:
    """Whether a search comes to every start, and to every combination of choices.

    Raises:
        ConfigError: Its budget is too small; with the smallest one that is valid.
    """
    if problem.search is None:
        return
    combinations = math.prod(len(knob.values) for knob in problem.knobs if knob.values)
    least = max(combinations, problem.search.starts)
    if problem.search.budget < least:
        told = f"{combinations} combinations of choices, {problem.search.starts} starts"
        raise at.error(problem.search.budget, f"{least} or more ({told})")


def _free(files: NamedFiles, name: str, said: Between | Among | Over, at: Where) -> Free:
    """A free field, with the names that files get in the output folder."""
    paths = tuple(field_path(part.strip(), at) for part in name.split(","))
    if isinstance(said, Among) and names_files(paths):
        said = Among(choice=tuple(files.own_files(list(said.choice), at)))
    return free_field(", ".join(p.text for p in paths), paths, said, at)
