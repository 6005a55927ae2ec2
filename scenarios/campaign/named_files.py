"""Files that a campaign or a placement names: scenarios, and the user's sensor parts, exoskeletons and meshes.

They are in the folder of the naming file or below it, and get the same relative paths in the output folder.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import yaml
from pydantic import BaseModel, BeforeValidator, Field

from stridetwin.scenarios.campaign.distributions import Choice, Distribution, DistributionInFile, Fixed
from stridetwin.scenarios.campaign.field_paths import FieldPath, PlainScenario, field_path
from stridetwin.scenarios.scenario_file import Scenario, catalogue, read_scenario
from stridetwin.streams.errors import ConfigError, ConfigFileError, FieldLocation, StrideTwinError
from stridetwin.streams.fields import FileModel, Number, Text
from stridetwin.streams.files import atomic_file
from stridetwin.streams.validation import suggest
from stridetwin.streams.yaml_file import LARGEST_FILE_VALUES, Dumper, read_yaml

FILES, SCENARIOS = "files", "scenarios"
"""Folders of the output: copies of the user's files, and the scenario file of each walk."""
_PARSED = "parsed.yaml"  # file through which a scenario is tried
_SUFFIXES = (".yaml", ".yml")
_MODELS = (".xml", ".urdf")
_RECORDINGS = (".trc", ".c3d", ".mot", ".sto", ".bvh", ".npz")  # of motion, also packed by gzip
# endings of the user's files: YAML, models, meshes and recordings
_OWN = (*_SUFFIXES, *_MODELS, ".stl", ".obj", ".ply", *_RECORDINGS, *(f"{ending}.gz" for ending in _RECORDINGS))
_NAMING = ("sensors", "exo", "terrain", "motion")
"""Keys of a scenario that may name files."""


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A value that is set in every walk, fixed or drawn from a distribution.

    Attributes:
        name: As the file writes it.
        paths: Its fields in the scenario, one or several.
        distribution: How it varies.
        at: Its position in the file.
    """

    name: str
    paths: tuple[FieldPath, ...]
    distribution: Distribution
    at: FieldLocation

    @property
    def varies(self) -> bool:
        """Whether it differs from walk to walk."""
        return not isinstance(self.distribution, Fixed)


@dataclass(frozen=True, kw_only=True)
class Base:
    """A scenario that walks of a campaign, placement or study start from.

    Attributes:
        name: Of the catalogue, or of the file; a number is appended where the name is already used.
        scenario: Plain data of its file.
        weight: Its frequency relative to the others.
        variables: Its own, set after those of all scenarios.
        at: Its position in the file.
        file: The scenario's file.
        written: How the naming file calls it.
    """

    name: str
    scenario: PlainScenario
    weight: float
    variables: tuple[Variable, ...]
    at: FieldLocation
    file: Path
    written: str


class NamedBase(BaseModel):
    """A scenario with values of its own.

    Attributes:
        scenario: Name in the catalogue, or path of a file.
        set: Paths into the scenario, each with a value or a distribution.
    """

    model_config = FileModel.model_config
    scenario: Text
    set: dict[str, DistributionInFile] = {}


class _Weighed(NamedBase):
    """A scenario with values and a weight of its own.

    Attributes:
        weight: Frequency relative to the other scenarios.
    """

    weight: Annotated[Number, Field(ge=1e-6, le=1e6)] = 1.0


def short_base(node: object) -> object:
    """A scenario's name as a mapping with the key `scenario`; mappings stay."""
    return {"scenario": node} if isinstance(node, str) else node


WeighedBase = Annotated[_Weighed, BeforeValidator(short_base, json_schema_input_type=str | _Weighed)]
"""Type of an item of a campaign's list `scenarios`."""


class NamedFiles:
    """Collects the files that a campaign, placement or study names, and checks that they are in its folder.

    Args:
        path: The file, such as a campaign's.
        folder: Description of its folder for errors, such as `the campaign's folder`.

    Attributes:
        user_files: The user's files by their names in the output folder.
    """

    def __init__(self, path: Path, folder: str) -> None:
        self._home, self._folder = path.resolve().parent, folder
        self._bases: set[str] = set()  # names of the scenarios so far
        self.user_files: dict[str, Path] = {}

    def bases(self, items: Sequence[NamedBase], nodes: Iterable[object], where: FieldLocation) -> tuple[Base, ...]:
        """The scenarios of a list, each with its own variables.

        Args:
            items: The validated items of the list.
            nodes: The items as the file has them.
            where: Position of the list.
        """
        return tuple(
            self.base(item, where.item(i), short=isinstance(node, str))
            for i, (item, node) in enumerate(zip(items, nodes))
        )

    def base(self, item: NamedBase, where: FieldLocation, *, short: bool) -> Base:
        """A scenario by its name in the catalogue or the path of its file, with its own variables.

        Args:
            item: Name and values.
            where: Position in the file.
            short: The file gives the name alone, so that errors are located at the item itself.

        Raises:
            ConfigError: There is no such scenario, or the file is outside of the folder.
        """
        name, built_in = item.scenario, catalogue()
        at = where if short else where.key("scenario")
        if name in built_in:
            path = built_in[name]
        elif name.lower().endswith(_SUFFIXES):
            path = self._find_file(self._home, name, at)
        else:
            raise at.error(name, f"{suggest(name, built_in)}, or the path of a .yaml file in {self._folder}")
        scenario = read_yaml(path, most_values=LARGEST_FILE_VALUES)
        if not isinstance(scenario, dict):
            raise at.error(name, "a scenario file")
        for key in _NAMING & scenario.keys():
            # names in a scenario file are relative to that file
            scenario[key] = self.with_output_names(scenario[key], at, path.resolve().parent)
        return Base(
            name=self._make_unique(path.stem),
            scenario=scenario,
            weight=getattr(item, "weight", 1.0),  # only the scenarios of a campaign have one
            variables=self.variables(item.set, where.key("set")),
            at=at,
            file=path,
            written=name,
        )

    def _make_unique(self, name: str) -> str:
        """The name, or the name with the first free number, since a scenario may be listed twice with other values."""
        names = (name, *(f"{name}_{i}" for i in range(2, len(self._bases) + 2)))
        unique_name = next(n for n in names if n not in self._bases)
        self._bases.add(unique_name)
        return unique_name

    def variables(self, values: Mapping[str, Distribution], where: FieldLocation) -> tuple[Variable, ...]:
        """The variables of a block `set`.

        Args:
            values: Field paths, several separated by commas, each with a distribution.
            where: Position of the block.

        Raises:
            ConfigError: An invalid path, the same paths given twice, or a file outside of the folder.
        """
        variables: list[Variable] = []
        for name, value in values.items():
            at = where.key(name)
            paths = tuple(field_path(part.strip(), at) for part in name.split(","))
            varied = self._with_output_names(value, at) if names_files(paths) else value
            canonical_name = ", ".join(p.text for p in paths)
            if any(variable.name == canonical_name for variable in variables):  # keys that differ in blanks alone
                raise at.error(name, "every place once")
            variables.append(Variable(name=canonical_name, paths=paths, distribution=varied, at=at))
        return tuple(variables)

    def _with_output_names(self, values: Distribution, at: FieldLocation) -> Distribution:
        """A distribution whose file names are replaced by those that the files get in the output folder."""
        if isinstance(values, Fixed):
            return Fixed(fixed=self.with_output_names(values.fixed, at))
        if isinstance(values, Choice):
            return Choice(
                choice=tuple(self.with_output_names(value, at) for value in values.choice), weights=values.weights
            )
        return values

    def with_output_names(self, node: object, where: FieldLocation, home: Path | None = None) -> object:
        """Plain data of sensors, exoskeleton, terrain or motion, with file names as in the output folder.

        The files, and those that they name in turn, are added to `user_files`.

        Args:
            node: Plain data.
            where: Its position.
            home: Folder of relative paths; None for that of the naming file.

        Raises:
            ConfigError: A file does not exist, or is outside of the folder.
        """
        home = home or self._home
        if isinstance(node, dict):
            return {key: self.with_output_names(value, where, home) for key, value in node.items()}
        if isinstance(node, list):
            return [self.with_output_names(value, where, home) for value in node]
        if not isinstance(node, str) or not node.lower().endswith(_OWN):
            return node
        return f"../{FILES}/{self._add_file(home, node, where)}"

    def _add_file(self, home: Path, name: str, where: FieldLocation) -> str:
        """Adds a file and the files that it names to `user_files`; returns its name in the output folder.

        Args:
            home: Folder that the name is relative to.
            name: The file, as written.
            where: Position of the name, for errors.
        """
        path = self._find_file(home, name, where)
        output_name = path.relative_to(self._home).as_posix()
        if output_name not in self.user_files:
            self.user_files[output_name] = path
            for inner_name in _find_named_files(path):
                self._add_file(path.parent, inner_name, where)
        return output_name

    def _find_file(self, home: Path, name: str, where: FieldLocation) -> Path:
        """Path of a file that must exist in the naming file's folder or below it.

        Args:
            home: Folder that the name is relative to.
            name: The file, as written.
            where: Position of the name, for errors.

        Raises:
            ConfigError: The file does not exist there.
        """
        path = (home / name).resolve()
        if not path.is_relative_to(self._home):
            raise where.error(name, f"a file in {self._folder}, {self._home}, or below it")
        if not path.is_file():
            raise where.error(name, "an existing file")
        return path


def names_files(paths: tuple[FieldPath, ...]) -> bool:
    """Whether a value of these fields may name the user's files."""
    return any(path.keys[0] in _NAMING for path in paths)


def _find_named_files(path: Path) -> Iterable[str]:
    """Files that a user's file names in turn: meshes of a model, parts of a rig file; none for any other file."""
    if path.suffix.lower() in _SUFFIXES:
        return _find_part_files(read_yaml(path, most_values=LARGEST_FILE_VALUES))
    if path.suffix.lower() in _MODELS:
        from stridetwin.sim.wearer.own_exo_model import files_of  # takes the simulator

        return files_of(path)
    return ()


def _find_part_files(node: object) -> Iterator[str]:
    """Names of the sensor parts in the plain data of a rig file."""
    for key, value in node.items() if isinstance(node, dict) else ():
        if key == "part" and isinstance(value, str) and value.lower().endswith(_SUFFIXES):
            yield value
        else:
            yield from _find_part_files(value)


def scenario_text(scenario: PlainScenario) -> str:
    """A scenario's plain data as YAML."""
    return yaml.dump(scenario, Dumper=Dumper, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)


def copy_files(folder: Path, user_files: Mapping[str, Path]) -> None:
    """Copies the user's files to the paths that the walks' scenarios name."""
    for name, source in user_files.items():
        place = folder / FILES / name
        place.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(place) as file:
            shutil.copyfile(source, file)


def errors_in_user_files(
    error: StrideTwinError, user_files: Mapping[str, Path], scenario: Path | None = None
) -> StrideTwinError | None:
    """Errors located in the user's files, with the user's paths; None if there are none.

    Args:
        error: Of a scenario that was parsed from the output folder.
        user_files: The user's files by their names there.
        scenario: The user's scenario file, where the scenario is as in that file.
    """
    # the user's file by the end of the path of its copy
    files = {f"/{FILES}/{name}": path for name, path in user_files.items()}
    if scenario is not None and scenario not in catalogue().values():
        files[f"/{SCENARIOS}/{_PARSED}"] = scenario
    located: list[StrideTwinError] = []
    # a `ConfigFileError` holds several errors
    for single_error in error.errors if isinstance(error, ConfigFileError) else (error,):
        if not isinstance(single_error, ConfigError):
            continue
        file = next((path for end, path in files.items() if single_error.source.endswith(end)), None)
        if file is not None:  # else the error is in a file of ours, such as the scenario of one walk
            working_folder = Path.cwd()
            shown_path = file.relative_to(working_folder) if file.is_relative_to(working_folder) else file
            located.append(ConfigError(shown_path, single_error.field, single_error.value, single_error.valid))
    if not located:
        return None
    return located[0] if len(located) == 1 else ConfigFileError(located)


def parse_scenario(folder: Path, scenario: PlainScenario) -> Scenario:
    """Parses and validates a scenario's plain data, through a file in the folder that has `SCENARIOS` and user files.

    Raises:
        StrideTwinError: It is invalid.
    """
    path = folder / SCENARIOS / _PARSED
    path.write_text(scenario_text(scenario), encoding="utf-8")
    return read_scenario(path)
