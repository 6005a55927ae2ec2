"""Files that another file names, a campaign's or a placement's: scenarios, and sensors' parts of the user's own.

They lie in that file's folder or below it, and get names of their own in the output folder.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stridetwin.scenarios.campaign.distributions import Distribution, Fixed, distribution
from stridetwin.scenarios.campaign.field_paths import FieldPath, field_path
from stridetwin.scenarios.fields import Where, suggest
from stridetwin.scenarios.scenario_file import catalogue
from stridetwin.scenarios.strict_yaml import read_plain

PARTS = "parts"
_SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A value that is set in every walk.

    Attributes:
        name: As the file writes it.
        paths: Where it goes, one place or several.
        distribution: How it varies.
        at: Where it stands in the file.
    """

    name: str
    paths: tuple[FieldPath, ...]
    distribution: Distribution
    at: Where

    @property
    def varies(self) -> bool:
        """Whether it is drawn."""
        return not isinstance(self.distribution, Fixed)


@dataclass(frozen=True, kw_only=True)
class Base:
    """A scenario that walks start from.

    Attributes:
        name: Of the catalogue, or of the file.
        scenario: Plain data of its file.
        weight: How often, against the others.
        variables: Of its own, set after those of all.
        at: Where it stands in the file.
    """

    name: str
    scenario: dict[str, Any]
    weight: float
    variables: tuple[Variable, ...]
    at: Where


class NamedFiles:
    """What a file names of other files.

    Args:
        path: The file, such as a campaign's.
        kind: What it is, in errors.

    Attributes:
        parts: Sensors' parts of the user's own: files by the names that they get in the output folder.
    """

    def __init__(self, path: Path, kind: str) -> None:
        self._home, self._kind = path.resolve().parent, kind
        self.parts: dict[str, Path] = {}

    def base(self, item: dict[str, Any], where: Where) -> Base:
        """A scenario and its own variables."""
        name, known = item["scenario"], catalogue()
        at = where if item["short"] else where.key("scenario")
        if name in known:
            path = known[name]
        elif name.endswith(_SUFFIXES):
            path = self._inside(self._home, name, at)
        else:
            raise at.error(name, f"{suggest(name, known)}, or the path of a .yaml file in the {self._kind}'s folder")
        scenario = read_plain(path)
        if not isinstance(scenario, dict):
            raise at.error(name, "a scenario file")
        if "sensors" in scenario:
            scenario["sensors"] = self.own_parts(scenario["sensors"], at, path.resolve().parent)
        variables = self.variables(item.get("set", {}), where.key("set"))
        return Base(name=path.stem, scenario=scenario, weight=item.get("weight", 1.0), variables=variables, at=at)

    def variables(self, node: dict[str, Any], where: Where) -> tuple[Variable, ...]:
        """The block `set`."""
        found = []
        for name, value in node.items():
            at = where.key(name)
            paths = tuple(field_path(part.strip(), at) for part in name.split(","))
            read = distribution(self.own_parts(value, at) if _of_sensors(paths) else value, at)
            found.append(Variable(name=", ".join(p.text for p in paths), paths=paths, distribution=read, at=at))
        return tuple(found)

    def own_parts(self, node: Any, where: Where, home: Path | None = None) -> Any:
        """What is said of sensors, with the names that parts of the user's own get in the output folder.

        Args:
            node: Plain data.
            where: Its place.
            home: Folder that paths start from; None for that of the file.
        """
        home = home or self._home
        if isinstance(node, dict):
            return {key: self.own_parts(value, where, home) for key, value in node.items()}
        if isinstance(node, list):
            return [self.own_parts(value, where, home) for value in node]
        if not isinstance(node, str) or not node.endswith(_SUFFIXES):
            return node
        path = self._inside(home, node, where)
        if self.parts.setdefault(path.name, path) != path:
            raise where.error(node, f"parts of different names ({path.name} is {self.parts[path.name]}, too)")
        return f"../{PARTS}/{path.name}"

    def _inside(self, home: Path, name: str, where: Where) -> Path:
        """A file of the folder or below it."""
        path = (home / name).resolve()
        if not path.is_relative_to(self._home):
            raise where.error(name, f"a file in the {self._kind}'s folder, {self._home}, or below it")
        if not path.is_file():
            raise where.error(name, "a file that there is")
        return path


def _of_sensors(paths: tuple[FieldPath, ...]) -> bool:
    return any(path.keys[0] == "sensors" for path in paths)
