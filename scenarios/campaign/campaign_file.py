"""Campaign files (YAML): which scenarios, how their values vary, how many walks; checked key by key.

Files that a campaign names, scenarios and parts of the user's own, lie in the campaign's folder or below it; nothing in
a campaign says where anything is written.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from stridetwin.scenarios.campaign.distributions import DistributionInFile
from stridetwin.scenarios.campaign.named_files import Base, NamedFiles, Variable, WeighedBase
from stridetwin.scenarios.campaign.people import Group, GroupInFile
from stridetwin.scenarios.scenario_file import catalogue
from stridetwin.streams.errors import StrideTwinError, Where
from stridetwin.streams.fields import number, refused, text, whole, words
from stridetwin.streams.validation import suggest, validated
from stridetwin.streams.yaml_file import LARGEST_FILE_VALUES, read_yaml

SAMPLINGS = ("sobol", "latin_hypercube")
_WHETHER = ("reject", "keep")
MOST_WALKS = 1_000_000
_SUFFIXES = (".yaml", ".yml")
_CAMPAIGNS_ONLY = {"campaign", "scenarios", "walks"}
_WORD = re.compile(r"[a-z][a-z0-9_]{0,30}")


def _whole(shares: dict[str, float]) -> dict[str, float]:
    """Shares that together are 1, of parts with plain names."""
    for name in shares:
        if not _WORD.fullmatch(name):
            raise refused(name, "names of small letters, digits and _")
    if abs(sum(shares.values()) - 1.0) > 1e-6:
        raise refused(shares, "shares whose sum is 1")
    return shares


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Which walks are rejected.

    Attributes:
        falls: Those that end by a fall: `reject` or `keep`.
        sensors: Those of which `check` says that something would spoil an estimate: `reject` or `keep`.
        help_pct: Those in which the help at the root is more than this in the mean, % of the body weight.
    """

    falls: Annotated[str, words(_WHETHER)] = "reject"
    sensors: Annotated[str, words(_WHETHER)] = "reject"
    help_pct: Annotated[float, number(0, 1000)] = 3.0


@dataclass(frozen=True, kw_only=True)
class Splits:
    """How walks are divided.

    Attributes:
        shares: Of each part, by its name.
        terrain_by: What makes two terrains different: their `geometry`, or the `scenario` that they come from.
    """

    shares: Annotated[dict[str, Annotated[float, number(0.001, 1)]], Field(min_length=1), AfterValidator(_whole)] = (
        field(default_factory=lambda: {"train": 0.7, "validation": 0.15, "test": 0.15})
    )
    terrain_by: Annotated[str, words(("geometry", "scenario"))] = "geometry"


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


class CampaignFile(BaseModel):
    """A campaign: which scenarios, how their values vary, how many walks.

    Attributes:
        campaign: One line that says what it is for.
        walks: How many.
        seed: Of everything random.
        sampling: How the draws are spread.
        scenarios: Scenarios, by name of the catalogue or path in the campaign's folder.
        people: Groups of people; none where the scenarios say who walks.
        set: Paths into the scenarios (`gait.speed_mps`, `terrain[1].stairs.riser_mm`), each with a value or a
            distribution.
        quality: Which walks are rejected.
        splits: How walks are divided.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    campaign: Annotated[str, text()]
    walks: Annotated[int, whole(1, MOST_WALKS)]
    seed: Annotated[int, whole(0, 2**31)] = 0
    sampling: Annotated[str, words(SAMPLINGS)] = "sobol"
    scenarios: Annotated[tuple[WeighedBase, ...], Field(min_length=1)]
    people: Annotated[tuple[GroupInFile, ...], Field(min_length=1)] = ()
    set: dict[str, DistributionInFile] = {}
    quality: Quality = Quality()
    splits: Splits = Splits()


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
    data = read_yaml(path, most_values=LARGEST_FILE_VALUES)
    file = validated(CampaignFile, data, path)
    files = NamedFiles(path, "the campaign's folder")
    campaign = Campaign(
        path=path,
        description=file.campaign,
        bases=files.bases(file.scenarios, data["scenarios"], where.key("scenarios")),
        people=tuple(
            group.placed(data["people"][i], where.key("people").item(i)) for i, group in enumerate(file.people)
        ),
        variables=files.variables(file.set, where.key("set")),
        **{name: getattr(file, name) for name in ("walks", "seed", "sampling", "quality", "splits")},
        own=files.own,
    )
    if campaign.people:
        for variable in (*campaign.variables, *(v for base in campaign.bases for v in base.variables)):
            if any(p.keys[0] == "person" for p in variable.paths):
                raise variable.at.error(variable.name, "no person here, as there is people")
    return campaign


def load_campaign(name: str) -> Campaign:
    """Reads a campaign by its name in the catalogue, or from a YAML file.

    Raises:
        StrideTwinError: As `read_campaign`, or there is none of this name; the message lists those there are.
    """
    path = find_campaign(name)
    if path is None:
        raise StrideTwinError(f"there is no campaign {name!r}; valid: {suggest(name, campaigns())}, or a .yaml file")
    return read_campaign(path)
