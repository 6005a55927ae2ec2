"""YAML from a user: safely loaded, every key once, and nothing in it but plain data of a bounded size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from stridetwin.scenarios.fields import Where
from stridetwin.streams.bounded import LARGEST_SETTING, read_text
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.yaml_node import UNFIT, check_yaml

_VALUES, _DEPTH = 100_000, 40


class _StrictLoader(yaml.SafeLoader):
    """YAML as the standard library of it reads, but a key that stands twice is an error."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [self.construct_object(k, deep=True) for k, _ in node.value]
        for i, key in enumerate(keys):
            if key in keys[:i]:
                mark = node.value[i][0].start_mark
                raise yaml.constructor.ConstructorError(problem=f"the key {key!r} stands twice", problem_mark=mark)
        return super().construct_mapping(node, deep)


def read_yaml(path: Path) -> Any:
    """What a YAML file holds, safely loaded; aliases share what they name.

    Raises:
        StrideTwinError: The file cannot be read, or is no such YAML.
    """
    try:
        text = read_text(path, LARGEST_SETTING)
        check_yaml(text, str(path), most_values=_VALUES)
        return yaml.load(text, _StrictLoader)
    except OSError as error:
        raise StrideTwinError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise StrideTwinError(f"{path}: is not text in UTF-8") from error
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise StrideTwinError(f"{path}: line {line}: {error.problem}") from error
    except (yaml.YAMLError, *UNFIT) as error:
        raise StrideTwinError(f"{path}: is not YAML: {' '.join(str(error).split())}") from error


def read_plain(path: Path) -> Any:
    """The plain data of a YAML file; no two places of it share an object.

    Raises:
        ConfigError: A value that is no plain data.
        StrideTwinError: As `read_yaml`.
    """
    return _Copy().of(read_yaml(path), Where(source=str(path)), 0)


class _Copy:
    """Copies value by value: aliases may name one thing a million times, or a thing inside itself."""

    def __init__(self) -> None:
        self._left = _VALUES

    def of(self, node: Any, where: Where, depth: int) -> Any:
        self._left -= 1
        if self._left < 0 or depth > _DEPTH:
            raise where.error("...", f"up to {_VALUES} values in all, {_DEPTH} inside each other")
        if isinstance(node, dict):
            for key in node:
                if not isinstance(key, str):
                    raise where.error(key, "keys that are text")
            return {key: self.of(value, where.key(key), depth + 1) for key, value in node.items()}
        if isinstance(node, list):
            return [self.of(value, where.item(i), depth + 1) for i, value in enumerate(node)]
        if node is None or isinstance(node, (str, bool, int, float)):
            return node
        raise where.error(str(node), "text, numbers, true, false, lists and keys with values")
