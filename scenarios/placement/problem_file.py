"""Placement files (YAML): what is free, on which walks, by which scores, and how it is searched; checked key by key.

Files that it names lie in its folder or below it; nothing in it says where anything is written.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from stridetwin.scenarios.campaign.field_paths import field_path
from stridetwin.scenarios.campaign.named_files import Base, NamedFiles, Variable, base_item, names_files
from stridetwin.scenarios.fields import Field, Where, integer, mapping, number, sequence, suggest, text
from stridetwin.scenarios.placement.free import Free, Knob, free_field, grid_size
from stridetwin.scenarios.placement.scores import Score, read_scores
from stridetwin.scenarios.placement.sight import Seeing
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.yaml_file import LARGEST_FILE_VALUES, read_yaml

MOST_PLACES = 100_000
_SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True, kw_only=True)
class Optimise:
    """A search by CMA-ES.

    Attributes:
        budget: How many places are tried in all.
        starts: How often it starts, each time with its share of them.
    """

    budget: int
    starts: int = 3


@dataclass(frozen=True, kw_only=True)
class Confirm:
    """The best places once more, on walks that the search has not seen.

    Attributes:
        places: How many.
        walks: Walks of each scenario.
    """

    places: int = 5
    walks: int = 8


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


def problems() -> dict[str, Path]:
    """The placements that come with the project, name to file, sorted by name."""
    folder = Path(str(resources.files("stridetwin.scenarios.placement"))) / "catalogue"
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
    found: dict[str, Any] = mapping(_FIELDS, dict)(read_yaml(path, most_values=LARGEST_FILE_VALUES), where)
    files = NamedFiles(path, "the placement's folder")
    bases = tuple(files.base(item, where.key("scenarios").item(i)) for i, item in enumerate(found.pop("bases")))
    common = files.variables(found.pop("variables", {}), where.key("set"))
    for variable in (*common, *(v for base in bases for v in base.variables)):
        if variable.varies:
            raise variable.at.error("a distribution", "one value; what is to be chosen stands in free")
    free = []
    for name, node in found.pop("free").items():
        at = where.key("free").key(name)
        paths = tuple(field_path(part.strip(), at) for part in name.split(","))
        if names_files(paths):
            node = files.own_files(node, at)
        free.append(free_field(", ".join(p.text for p in paths), paths, node, at))
    problem = Problem(path=path, bases=bases, variables=common, free=tuple(free), own=files.own, **found)
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


def _paths(node: object, where: Where) -> dict[str, Any]:
    if not isinstance(node, dict) or not node:
        raise where.error(node, "paths into the scenario, each with what is said of it")
    return node


def _seeds(node: object, where: Where) -> tuple[int, ...]:
    """How many, from 0 on; or a list of them."""
    if not isinstance(node, list):
        return tuple(range(integer(1, 10_000)(node, where)))
    seeds = sequence(integer(0, 2**31))(node, where)
    if len(set(seeds)) < len(seeds):
        raise where.error(node, "every seed once")
    return seeds


def _method(node: object, where: Where) -> Optimise | None:
    if node == "sweep":
        return None
    if not isinstance(node, dict):
        raise where.error(node, "sweep, or {optimise: {budget: N}}")
    asked = Field(attribute="asked", read=_OPTIMISE, required=True)
    found: Optimise = mapping({"optimise": asked}, dict)(node, where)["asked"]
    return found


_BASE = base_item(set=Field(attribute="set", read=_paths))
_OPTIMISE = mapping(
    {
        "budget": Field(attribute="budget", read=integer(1, MOST_PLACES), required=True),
        "starts": Field(attribute="starts", read=integer(1, 100)),
    },
    Optimise,
)
_FIELDS = {
    "placement": Field(attribute="description", read=text, required=True),
    "scenarios": Field(attribute="bases", read=sequence(_BASE), required=True),
    "set": Field(attribute="variables", read=_paths),
    "free": Field(attribute="free", read=_paths, required=True),
    "scores": Field(attribute="scores", read=read_scores, required=True),
    "seeds": Field(attribute="seeds", read=_seeds),
    "seeing": Field(
        attribute="seeing",
        read=mapping(
            {
                "least_px": Field(attribute="least_px", read=number(0.1, 1000)),
                "incidence_deg": Field(attribute="incidence_rad", read=number(1, 89.9, scale=math.pi / 180)),
                "blur_squares": Field(attribute="blur_squares", read=number(0.001, 100)),
            },
            Seeing,
        ),
    ),
    "method": Field(attribute="search", read=_method),
    "confirm": Field(
        attribute="confirm",
        read=mapping(
            {
                "places": Field(attribute="places", read=integer(1, 20)),
                "walks": Field(attribute="walks", read=integer(1, 1000)),
            },
            Confirm,
        ),
    ),
}
