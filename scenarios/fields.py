"""Fields of a YAML file: each reads one node, checks it and converts it to SI.

Errors name the file, the path of keys, the bad value and what is valid.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from stridetwin.streams.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Where:
    """Place of a node: the file as the user named it, and the path of keys inside it."""

    source: str
    path: str = ""

    def key(self, name: str) -> Where:
        """The place of a key below this one."""
        return Where(source=self.source, path=f"{self.path}.{name}" if self.path else name)

    def item(self, index: int) -> Where:
        """The place of a list's item."""
        return Where(source=self.source, path=f"{self.path}[{index}]")

    def error(self, value: object, valid: str) -> ConfigError:
        """The error to raise about a bad value at this place."""
        return ConfigError(self.source, self.path, value, valid)


Reader = Callable[[object, Where], Any]


@dataclass(frozen=True, kw_only=True)
class Field:
    """One key of a mapping.

    Attributes:
        attribute: Name of the dataclass attribute that it sets.
        read: Checks and converts the node.
        required: The key must be present; otherwise the dataclass has the default.
    """

    attribute: str
    read: Reader
    required: bool = False


def suggest(value: object, names: Iterable[str]) -> str:
    """The valid names in words, with the nearest to `value` pointed out."""
    names = list(names)
    near = difflib.get_close_matches(str(value), names, n=1)
    return ", ".join(names) + (f" (did you mean {near[0]!r}?)" if near else "")


def number(low: float, high: float, *, scale: float = 1.0) -> Reader:
    """A number in [low, high] as written in the file; multiplied by `scale` to SI."""

    def read(node: object, where: Where) -> float:
        if isinstance(node, bool) or not isinstance(node, (int, float)) or not low <= node <= high:
            raise where.error(node, f"{low:g}-{high:g}" if low >= 0 else f"{low:g} to {high:g}")
        return float(node) * scale

    return read


def integer(low: int, high: int) -> Reader:
    """A whole number in [low, high]."""

    def read(node: object, where: Where) -> int:
        if isinstance(node, bool) or not isinstance(node, int) or not low <= node <= high:
            raise where.error(node, f"a whole number, {low}-{high}")
        return node

    return read


def flag(node: object, where: Where) -> bool:
    """`true` or `false`."""
    if not isinstance(node, bool):
        raise where.error(node, "true, false")
    return node


def text(node: object, where: Where) -> str:
    """A non-empty line of text."""
    if not isinstance(node, str) or not node.strip():
        raise where.error(node, "text")
    return " ".join(node.split())


def choice(names: Mapping[str, Any]) -> Reader:
    """One of the names; yields what it stands for."""

    def read(node: object, where: Where) -> Any:
        if not isinstance(node, str) or node not in names:
            raise where.error(node, suggest(node, names))
        return names[node]

    return read


def one_word(names: Iterable[str]) -> Reader:
    """One of the names, which stands for itself."""
    return choice({name: name for name in names})


def names_of(valid: Iterable[str]) -> Reader:
    """A list of different names out of `valid`."""
    valid = tuple(valid)

    def read(node: object, where: Where) -> tuple[str, ...]:
        if not isinstance(node, list):
            raise where.error(node, f"a list of {', '.join(valid)}")
        for i, name in enumerate(node):
            if name not in valid:
                raise where.item(i).error(name, suggest(name, valid))
            if name in node[:i]:
                raise where.item(i).error(name, "every name once")
        return tuple(node)

    return read


def mapping(fields: Mapping[str, Field], build: Callable[..., Any]) -> Reader:
    """A mapping with the given keys and no others; yields `build(**attributes)`."""

    def read(node: object, where: Where) -> Any:
        if not isinstance(node, dict):
            raise where.error(node, f"keys {', '.join(fields)}")
        for name in node:
            if name not in fields:
                raise where.error(name, f"keys {suggest(name, fields)}")
        for name, entry in fields.items():
            if entry.required and name not in node:
                raise where.error(f"no {name}", f"the key {name} is required")
        return build(**{fields[k].attribute: fields[k].read(v, where.key(k)) for k, v in node.items()})

    return read


def triple(item: Reader) -> Reader:
    """A list of three items that `item` reads."""
    return _exactly(3, "three", item)


def pair(item: Reader) -> Reader:
    """A list of two items that `item` reads."""
    return _exactly(2, "two", item)


def _exactly(count: int, words: str, item: Reader) -> Reader:
    read_all = sequence(item)

    def read(node: object, where: Where) -> Any:
        if not isinstance(node, list) or len(node) != count:
            raise where.error(node, f"a list of {words} items")
        return read_all(node, where)

    return read


def one_of(kinds: Mapping[str, Reader]) -> Reader:
    """A mapping of exactly one key, which says how to read its value."""

    def read(node: object, where: Where) -> Any:
        if not isinstance(node, dict) or len(node) != 1:
            raise where.error(node, f"one of the keys {', '.join(kinds)}")
        ((kind, value),) = node.items()
        if kind not in kinds:
            raise where.error(kind, suggest(kind, kinds))
        return kinds[kind](value, where.key(kind))

    return read


def sequence(item: Reader) -> Reader:
    """A non-empty list whose items `item` reads."""

    def read(node: object, where: Where) -> tuple[Any, ...]:
        if not isinstance(node, list) or not node:
            raise where.error(node, "a list with at least one item")
        return tuple(item(v, where.item(i)) for i, v in enumerate(node))

    return read
