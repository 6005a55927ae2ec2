"""One value inside a YAML file with its location, for error messages."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array
from stridetwin.streams.yaml_file import parse_yaml, read_yaml

LARGEST_INTEGER = 2**31 - 1
_MISSING: Any = object()


def parse_node(text: str, source: str) -> Node:
    """A YAML text as its root node; errors as those of `yaml_file.parse_yaml`."""
    return Node(source, "", parse_yaml(text, source))


def read_node(path: str | Path) -> Node:
    """A YAML file as its root node; errors as those of `yaml_file.read_yaml`."""
    return Node(str(path), "", read_yaml(path))


@dataclass(frozen=True)
class Node:
    """A value with its file and key path; the getters check what they return.

    Attributes:
        source: File.
        path: Dotted key path.
        value: Its plain value.
    """

    source: str
    path: str
    value: Any

    def error(self, valid: str) -> ConfigError:
        """The error that this value is invalid."""
        return ConfigError(self.source, self.path, self.value, valid)

    def __contains__(self, key: str) -> bool:
        return key in self.mapping()

    def __iter__(self) -> Iterator[str]:
        return iter(self.mapping())

    def mapping(self) -> Mapping[str, Any]:
        """The value as a mapping with text keys."""
        if not isinstance(self.value, Mapping) or not all(isinstance(k, str) for k in self.value):
            raise self.error("a mapping")
        return self.value

    def only(self, valid: Collection[str]) -> None:
        """Refuses keys that mean nothing."""
        for key in self.mapping():
            if key not in valid:
                raise ConfigError(self.source, self._join(key), self.value[key], f"one of the keys {', '.join(valid)}")

    def at(self, key: str, default: Any = _MISSING) -> Node:
        """The value under a key."""
        value = self.mapping().get(key, default)
        if value is _MISSING:
            raise ConfigError(self.source, self._join(key), None, f"this key must be there, beside {', '.join(self)}")
        return Node(self.source, self._join(key), value)

    def items(self) -> list[Node]:
        """The values of a list."""
        if not isinstance(self.value, list):
            raise self.error("a list")
        return [Node(self.source, f"{self.path}[{i}]", v) for i, v in enumerate(self.value)]

    def text(self) -> str:
        """The value as text."""
        if not isinstance(self.value, str):
            raise self.error("text")
        return self.value

    def choice(self, valid: Collection[str]) -> str:
        """The value as one of a few texts."""
        if self.value not in valid:
            raise self.error(" or ".join(valid))
        return str(self.value)

    def number(self, low: float = -math.inf, *, above: bool = False) -> float:
        """The value as a finite number, at least (or above) `low`; 1e-3, which YAML reads as text, is one."""
        try:
            number = math.nan if isinstance(self.value, bool) else float(self.value)
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not math.isfinite(number) or number < low or (above and number == low):
            bound = "" if low == -math.inf else f" above {low:g}" if above else f" of at least {low:g}"
            raise self.error(f"a number{bound}")
        return number

    def integer(self, low: int) -> int:
        """The value as an integer, at least `low`, that any machine can count to."""
        if isinstance(self.value, bool) or not isinstance(self.value, int) or self.value < low:
            raise self.error(f"an integer of at least {low}")
        if self.value > LARGEST_INTEGER:
            raise self.error(f"an integer of up to {LARGEST_INTEGER}")
        return self.value

    def numbers(self, count: int) -> tuple[float, ...]:
        """The value as a list of `count` finite numbers."""
        if not isinstance(self.value, list) or len(self.value) != count:
            raise self.error(f"a list of {count} numbers")
        return tuple(item.number() for item in self.items())

    def transform(self) -> Array:
        """The value as a (4, 4) rigid transform."""
        if not isinstance(self.value, list) or len(self.value) != 4:
            raise self.error("4 rows of 4 numbers")
        T = np.array([row.numbers(4) for row in self.items()])
        R = T[:3, :3]
        is_rotation = np.allclose(R @ R.T, np.eye(3), atol=1e-4) and np.linalg.det(R) > 0
        if not is_rotation or not np.array_equal(T[3], (0, 0, 0, 1)):
            raise self.error("a rigid transform: a rotation matrix, a translation, and a last row 0 0 0 1")
        return T

    def _join(self, key: str) -> str:
        return f"{self.path}.{key}" if self.path else key
