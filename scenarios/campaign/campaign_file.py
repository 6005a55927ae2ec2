"""Campaign files (YAML): which scenarios, how their values vary, how many walks; checked key by key.

Files that a campaign names, scenarios and parts of the user's own, lie in the campaign's folder or below it; nothing in
a campaign says where anything is written.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from stridetwin.scenarios.campaign.named_files import Base, NamedFiles, Variable, base_item
from stridetwin.scenarios.campaign.people import Group, group
from stridetwin.scenarios.fields import Field, Where, integer, mapping, number, one_word, sequence, suggest, text
from stridetwin.scenarios.scenario_file import catalogue
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.yaml_file import LARGEST_FILE_VALUES, read_yaml

SAMPLINGS = ("sobol", "latin_hypercube")
MOST_WALKS = 1_000_000
_SUFFIXES = (".yaml", ".yml")
_CAMPAIGNS_ONLY = {"campaign", "scenarios", "walks"}
_WORD = re.compile(r"[a-z][a-z0-9_]{0,30}")


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Which walks are rejected.

    Attributes:
        falls: Those that end by a fall: `reject` or `keep`.
        sensors: Those of which `check` says that something would spoil an estimate: `reject` or `keep`.
        help_pct: Those in which the help at the root is more than this in the mean, % of the body weight.
    """

    falls: str = "reject"
    sensors: str = "reject"
    help_pct: float = 3.0


@dataclass(frozen=True, kw_only=True)
class Splits:
    """How walks are divided.

    Attributes:
        shares: Of each part, by its name.
        terrain_by: What makes two terrains different: their `geometry`, or the `scenario` that they come from.
    """

    shares: dict[str, float] = field(default_factory=lambda: {"train": 0.7, "validation": 0.15, "test": 0.15})
    terrain_by: str = "geometry"


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """What a campaign file says.

    Attributes:
        path: The file.
        description: One line.
        walks: How many.
        seed: Of everything random.
        sampling: Of `SAMPLINGS`.
        bases: Scenarios.
        people: Groups of people; none where the scenarios say who walks.
        variables: Set in the walks of all scenarios.
        quality: Which walks are rejected.
        splits: How walks are divided.
        own: Files of the user's own by the names that they get in the output folder.
    """

    path: Path
    description: str
    walks: int
    seed: int = 0
    sampling: str = "sobol"
    bases: tuple[Base, ...]
    people: tuple[Group, ...] = ()
    variables: tuple[Variable, ...] = ()
    quality: Quality = Quality()
    splits: Splits = Splits()
    own: dict[str, Path] = field(default_factory=dict)


def campaigns() -> dict[str, Path]:
    """The campaigns that come with the project, name to file, sorted by name."""
    folder = Path(str(resources.files("stridetwin.scenarios.campaign"))) / "catalogue"
    return {p.stem: p for p in sorted(folder.glob("*.yaml"))}


def find_campaign(name: str) -> Path | None:
    """The file of a campaign, None where the name is that of a scenario (or of nothing).

    Args:
        name: Of the catalogue, or path of a file, which is a campaign where it has keys that only campaigns have.

    Raises:
        StrideTwinError: A file that cannot be read, or is no YAML.
    """
    if name in catalogue():
        return None
    if name in campaigns():
        return campaigns()[name]
    path = Path(name)
    if path.suffix.lower() not in _SUFFIXES or not path.is_file():
        return None
    node = read_yaml(path, most_values=LARGEST_FILE_VALUES)
    return path if isinstance(node, dict) and _CAMPAIGNS_ONLY & set(node) else None


def read_campaign(path: Path) -> Campaign:
    """Reads one campaign file.

    Raises:
        ConfigError: The message names the file, the field, the value and what is valid.
        StrideTwinError: A file cannot be read.
    """
    where = Where(source=str(path))
    found: dict[str, Any] = mapping(_FIELDS, dict)(read_yaml(path, most_values=LARGEST_FILE_VALUES), where)
    files = NamedFiles(path, "the campaign's folder")
    common, bases = found.get("variables", {}), found["bases"]
    campaign = Campaign(
        path=path,
        bases=tuple(files.base(item, where.key("scenarios").item(i)) for i, item in enumerate(bases)),
        variables=files.variables(common, where.key("set")),
        **{key: value for key, value in found.items() if key not in ("bases", "variables")},
        own=files.own,
    )
    if campaign.people:
        for variable in (*campaign.variables, *(v for base in campaign.bases for v in base.variables)):
            if any(p.keys[0] == "person" for p in variable.paths):
                raise variable.at.error(variable.name, "no person here, as there is people")
    return campaign


def _set(node: object, where: Where) -> dict[str, Any]:
    if not isinstance(node, dict):
        raise where.error(node, "paths into the scenario, each with a value or a distribution")
    return node


def _shares(node: object, where: Where) -> dict[str, float]:
    if not isinstance(node, dict) or not node:
        raise where.error(node, "names, each with its share")
    for name in node:
        if not _WORD.fullmatch(name):
            raise where.error(name, "names of small letters, digits and _")
    shares = {name: number(0.001, 1)(value, where.key(name)) for name, value in node.items()}
    if abs(sum(shares.values()) - 1.0) > 1e-6:
        raise where.error(node, "shares whose sum is 1")
    return shares


def _required(attribute: str, read: Callable[[object, Where], Any]) -> Field:
    return Field(attribute=attribute, read=read, required=True)


_BASE = base_item(weight=Field(attribute="weight", read=number(1e-6, 1e6)), set=Field(attribute="set", read=_set))
_WHETHER = one_word(("reject", "keep"))
_FIELDS = {
    "campaign": _required("description", text),
    "walks": _required("walks", integer(1, MOST_WALKS)),
    "seed": Field(attribute="seed", read=integer(0, 2**31)),
    "sampling": Field(attribute="sampling", read=one_word(SAMPLINGS)),
    "scenarios": _required("bases", sequence(_BASE)),
    "people": Field(attribute="people", read=sequence(group)),
    "set": Field(attribute="variables", read=_set),
    "quality": Field(
        attribute="quality",
        read=mapping(
            {
                "falls": Field(attribute="falls", read=_WHETHER),
                "sensors": Field(attribute="sensors", read=_WHETHER),
                "help_pct": Field(attribute="help_pct", read=number(0, 1000)),
            },
            Quality,
        ),
    ),
    "splits": Field(
        attribute="splits",
        read=mapping(
            {
                "shares": Field(attribute="shares", read=_shares),
                "terrain_by": Field(attribute="terrain_by", read=one_word(("geometry", "scenario"))),
            },
            Splits,
        ),
    ),
}


def load_campaign(name: str) -> Campaign:
    """Reads a campaign by its name in the catalogue, or from a YAML file.

    Raises:
        StrideTwinError: As `read_campaign`, or there is none of this name; the message lists those there are.
    """
    path = find_campaign(name)
    if path is None:
        raise StrideTwinError(f"there is no campaign {name!r}; valid: {suggest(name, campaigns())}, or a .yaml file")
    return read_campaign(path)
