"""Campaign files (YAML): the scenarios, the distributions of their values, the people, and the number of walks.

Files that a campaign names must be in its folder or below it. The output folder is not part of a campaign.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, Discriminator, Field, StrictInt, Tag

from stridetwin.scenarios.built_in import campaigns as campaigns
from stridetwin.scenarios.campaign.distributions import Choice, Distribution, DistributionInFile, Fixed
from stridetwin.scenarios.campaign.named_files import Base, NamedFiles, Variable, WeighedBase
from stridetwin.scenarios.scenario_file import catalogue
from stridetwin.sim.config import Person
from stridetwin.sim.people import PEOPLE
from stridetwin.streams.errors import FieldLocation, StrideTwinError, check_type
from stridetwin.streams.fields import FileModel, Number, OneOf, ReadAs, Text, check_unique, field_error
from stridetwin.streams.validation import suggest, validate
from stridetwin.streams.yaml_file import LARGEST_FILE_VALUES, read_yaml

SAMPLINGS = ("sobol", "latin_hypercube")
_WHETHER = ("reject", "keep")  # what happens to walks of some kind
MOST_WALKS = 1_000_000
_SUFFIXES = (".yaml", ".yml")
_CAMPAIGNS_ONLY = {"campaign", "scenarios", "walks"}  # keys that no scenario file has
_MOST_PEOPLE = 10_000
_NOWHERE = FieldLocation(source="")
_BODY = ("bmi", "sex", "height_m", "mass_kg", "shoe_mm")  # keys of a drawn body, in the file
_MASS_KG = (45.0, 110.0)  # valid masses; that of a body mass index is limited to them
_MM = 1e-3
_WORD = re.compile(r"[a-z][a-z0-9_]{0,30}")  # a valid name of a part


def _check_shares(shares: dict[str, float]) -> dict[str, float]:
    """Returns shares that add up to 1 and whose parts have plain names; refuses others."""
    for name in shares:
        if not _WORD.fullmatch(name):
            raise field_error(name, "names of lower-case letters, digits and _")
    if abs(sum(shares.values()) - 1.0) > 1e-6:
        raise field_error(shares, "shares whose sum is 1")
    return shares


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Which walks are rejected.

    Attributes:
        falls: Walks that end with a fall: `reject` or `keep`.
        sensors: Walks with a stream that `check` finds invalid: `reject` or `keep`.
        help_pct: Largest mean external force at the root, % of the body weight; walks above it are rejected.
    """

    falls: Annotated[str, OneOf(_WHETHER)] = "reject"
    sensors: Annotated[str, OneOf(_WHETHER)] = "reject"
    help_pct: Annotated[Number, Field(ge=0, le=1000)] = 3.0


@dataclass(frozen=True, kw_only=True)
class Splits:
    """Division of the walks into parts, such as for training and test.

    Attributes:
        shares: Share of each part, by name.
        terrain_by: Property in which two terrains differ: their `geometry`, or the `scenario` that they come from.
    """

    shares: Annotated[
        dict[str, Annotated[Number, Field(ge=0.001, le=1)]], Field(min_length=1), AfterValidator(_check_shares)
    ] = field(default_factory=lambda: {"train": 0.7, "validation": 0.15, "test": 0.15})
    terrain_by: Annotated[str, OneOf(("geometry", "scenario"))] = "geometry"


@dataclass(frozen=True, kw_only=True)
class Group:
    """People whose bodies are drawn from the same distributions.

    Attributes:
        count: Number of people.
        body: Distribution of each key of a person, and of `bmi` (kg/m²), which gives the mass.
        names: Predefined people by name, instead of drawn ones.
        at: Position of the group in the file.
    """

    count: int
    body: dict[str, Distribution]
    names: tuple[str, ...] = ()
    at: FieldLocation = _NOWHERE

    def with_position(self, node: Iterable[str], at: FieldLocation) -> Group:
        """The group with its position, and its keys in the order of the file, which is that of the draws."""
        return replace(self, body={key: self.body[key] for key in node if key in self.body}, at=at)

    @property
    def varying_keys(self) -> tuple[str, ...]:
        """Keys of a person that vary between the members."""
        return tuple(key for key, distribution in self.body.items() if not isinstance(distribution, Fixed))

    def person(self, quantiles: Mapping[str, float]) -> dict[str, object]:
        """A member of the group, in the form of a scenario file's person.

        Args:
            quantiles: Number from 0 to 1 for each key that varies.
        """
        # a key that does not vary has the same value at every quantile
        body = {key: distribution.at(quantiles.get(key, 0.0)) for key, distribution in self.body.items()}
        if "bmi" in body:
            # a scenario's person has a mass, not an index: mass = index × height²
            bmi, height_m = body.pop("bmi"), body.get("height_m", Person.height_m)
            assert isinstance(bmi, (int, float))
            assert isinstance(height_m, (int, float))
            mass = float(f"{bmi * height_m**2:.6g}")
            least_kg, most_kg = _MASS_KG
            body["mass_kg"] = min(max(mass, least_kg), most_kg)
        return body


class _Named(FileModel):
    """Predefined people.

    Attributes:
        named: Their names.
    """

    named: Annotated[
        tuple[Annotated[str, OneOf(tuple(PEOPLE))], ...], Field(min_length=1), AfterValidator(check_unique)
    ]

    def build(self) -> Group:
        """The group of these predefined people."""
        return Group(count=len(self.named), body={}, names=self.named)


class _Drawn(FileModel):
    """People whose bodies are drawn from distributions.

    Attributes:
        count: Number of people.
        bmi: Body mass index, kg/m², 15-45, which gives the mass; instead of mass_kg.
        sex: `male` or `female`.
        height_m: Standing height without shoes.
        mass_kg: Body mass.
        shoe_mm: Shoe size, as the length of a fitting foot.
    """

    count: Annotated[StrictInt, Field(ge=1, le=_MOST_PEOPLE)]
    bmi: DistributionInFile = None
    sex: DistributionInFile = None
    height_m: DistributionInFile = None
    mass_kg: DistributionInFile = None
    shoe_mm: DistributionInFile = None

    def build(self) -> Group:
        """The group with the distributions that the file sets.

        It refuses `bmi` beside `mass_kg`, and a `bmi` out of range. The ranges of the other keys are those of a
        scenario's person and are checked by `extremes.check_extremes`.
        """
        body = {key: getattr(self, key) for key in _BODY if key in self.model_fields_set}
        if {"bmi", "mass_kg"} <= body.keys():
            raise field_error(body["bmi"].description, "either bmi or mass_kg", "bmi")
        # the ends of the distribution of `bmi`, if there is one; those of a choice may have any type
        for end in body["bmi"].ends if "bmi" in body else ():
            if isinstance(end, bool) or not isinstance(end, (int, float)) or not 15 <= end <= 45:
                raise field_error(end, "15-45 (kg/m²)", "bmi")
        return Group(count=self.count, body=body)


_GroupInFile = Annotated[
    Annotated[_Named, AfterValidator(_Named.build), Tag("=named")]
    | Annotated[_Drawn, AfterValidator(_Drawn.build), Tag("=drawn")],
    Discriminator(lambda node: "=named" if isinstance(node, dict) and "named" in node else "=drawn"),
]
GroupInFile = Annotated[Group, ReadAs(_GroupInFile)]
"""Type of an item of the list `people`; it becomes a `Group`."""


def plain_person(person: Person) -> dict[str, object]:
    """A person in the form of scenario file and manifest, with all defaults filled in."""
    body = asdict(person)
    shoe_m = body.pop("shoe_m")  # None if it follows from the height
    return body if shoe_m is None else body | {"shoe_mm": float(f"{shoe_m / _MM:.6g}")}


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """A campaign, as read from its file.

    Attributes:
        path: The file.
        description: Purpose of the campaign, in one line.
        walks: Number of walks.
        seed: Seed of all random numbers.
        sampling: Method that spreads the draws over their ranges: `sobol` or `latin_hypercube`.
        bases: Scenarios.
        people: Groups of people; empty if the scenarios define the walkers.
        variables: Values that are set in the walks of all scenarios.
        quality: Criteria by which walks are rejected.
        splits: Division of the walks.
        user_files: The user's files, by their names in the output folder.
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
    user_files: dict[str, Path] = field(default_factory=dict)


class CampaignFile(BaseModel):
    """A campaign: the scenarios, the distributions of their values, and the number of walks.

    Attributes:
        campaign: Purpose of the campaign, in one line.
        walks: Number of walks.
        seed: Seed of all random numbers.
        sampling: Method that spreads the draws over their ranges.
        scenarios: Scenarios, by name in the catalogue or path in the campaign's folder.
        people: Groups of people; left out if the scenarios define the walkers.
        motion: Recordings of people in the campaign's folder; each walk is played from one of them.
        set: Paths into the scenarios (`gait.speed_mps`, `terrain[1].stairs.riser_mm`), each with a value or a
            distribution.
        quality: Criteria by which walks are rejected.
        splits: Division of the walks.
    """

    model_config = FileModel.model_config
    campaign: Text
    walks: Annotated[StrictInt, Field(ge=1, le=MOST_WALKS)]
    seed: Annotated[StrictInt, Field(ge=0, le=2**31)] = 0
    sampling: Annotated[str, OneOf(SAMPLINGS)] = "sobol"
    scenarios: Annotated[tuple[WeighedBase, ...], Field(min_length=1)]
    people: Annotated[tuple[GroupInFile, ...], Field(min_length=1)] = ()
    motion: Annotated[tuple[Text, ...], Field(min_length=1), AfterValidator(check_unique)] = ()
    set: dict[str, DistributionInFile] = {}
    quality: Quality = Quality()
    splits: Splits = Splits()


def find_campaign(name: str) -> Path | None:
    """The file of a campaign; None if the name is not that of a campaign.

    Args:
        name: Name in the catalogue, or path of a file; a file is a campaign if it has keys that only campaigns have.

    Raises:
        StrideTwinError: The file cannot be read, or is not YAML.
    """
    if name in catalogue():  # a scenario
        return None
    if name in campaigns():
        return campaigns()[name]
    path = Path(name)
    if path.suffix.lower() not in _SUFFIXES or not path.is_file():
        return None
    node = read_yaml(path, most_values=LARGEST_FILE_VALUES)
    return path if isinstance(node, dict) and _CAMPAIGNS_ONLY & set(node) else None


def read_campaign(path: Path) -> Campaign:
    """Reads one campaign file and the files that it names.

    Raises:
        ConfigError: An invalid value; the message names file, field, value and what is valid.
        StrideTwinError: A file cannot be read.
    """
    where = FieldLocation(source=str(path))
    data = read_yaml(path, most_values=LARGEST_FILE_VALUES)
    file = validate(CampaignFile, data, path)
    assert isinstance(data, dict)  # as it is valid
    files = NamedFiles(path, "the campaign's folder")
    # the plain data is given, too: it has the order of the keys and the short form of an entry, which errors and draws
    # follow
    campaign = Campaign(
        path=path,
        description=file.campaign,
        bases=files.bases(file.scenarios, data["scenarios"], where.key("scenarios")),
        people=tuple(
            group.with_position(data["people"][i], where.key("people").item(i)) for i, group in enumerate(file.people)
        ),
        variables=(*_motion_variables(file, files, where), *files.variables(file.set, where.key("set"))),
        **{name: getattr(file, name) for name in ("walks", "seed", "sampling", "quality", "splits")},
        user_files=files.user_files,
    )
    if campaign.people:  # then no variable may set the person, too
        of_bases = [variable for base in campaign.bases for variable in base.variables]
        for variable in (*campaign.variables, *of_bases):
            if any(p.keys[0] == "person" for p in variable.paths):
                raise variable.at.error(variable.name, "no person, as the campaign has people")
    return campaign


def _motion_variables(file: CampaignFile, files: NamedFiles, where: FieldLocation) -> tuple[Variable, ...]:
    """The recording of each walk as a variable `motion.file`; none if the campaign has no recordings."""
    if not file.motion:
        return ()
    values: Distribution = Choice(choice=file.motion) if len(file.motion) > 1 else Fixed(fixed=file.motion[0])
    (variable,) = files.variables({"motion.file": values}, where)
    return (replace(variable, at=where.key("motion")),)


def load_campaign(name: str | Path) -> Campaign:
    """Reads a campaign by its name in the catalogue, or from a YAML file.

    Raises:
        ConfigError: An invalid value in the file.
        StrideTwinError: The name is unknown, and the message lists the known ones; or a file cannot be read.
    """
    check_type("load_campaign", "name", name, (str, Path), "a name in the catalogue or a path")
    name = str(name)
    path = find_campaign(name)
    if path is None and Path(name).suffix.lower() in _SUFFIXES:
        path = Path(name)  # a missing file, or one without the keys of a campaign, which reading it reports
    if path is None:
        raise StrideTwinError(f"invalid campaign {name!r}: expected {suggest(name, campaigns())}, or a .yaml file")
    return read_campaign(path)
