"""One figure of a data sheet: how a part file names it, in which unit, and between which bounds it makes sense."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar, get_type_hints

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2
from stridetwin.streams.yaml_node import Node

DEG = math.pi / 180
G = STANDARD_GRAVITY_MPS2
_FIGURE = "figure"
_SOURCED = ("value", "source")


@dataclass(frozen=True, kw_only=True)
class Figure:
    """How one attribute of a part stands in its file.

    Attributes:
        key: Name in the file, with the unit.
        low: Smallest value that makes sense, in the file's unit.
        high: Largest one.
        scale: From the file's unit to SI.
        ideal: What an ideal twin of the part has instead, in SI; None: what the part itself has.
        words: The valid words, where the value is one.
        count: Number of values where it is a list; 0 for one.
    """

    key: str
    low: float = -math.inf
    high: float = math.inf
    scale: float = 1.0
    ideal: Any = None
    words: tuple[str, ...] = ()
    count: int = 0

    def read(self, node: Node) -> Any:
        """The value in SI of a node `{value: ..., source: ...}` or a bare value."""
        if isinstance(node.value, Mapping):
            node.only(_SOURCED)
            node = node.at("value")
        if self.words:
            return node.choice(self.words)
        if self.count:
            values = node.numbers(self.count)
            if not all(self.low <= v <= self.high for v in values):
                raise node.error(f"{self.count} numbers, {self.low:g} to {self.high:g}")
            return tuple(v * self.scale for v in values)
        value = node.number()
        if not self.low <= value <= self.high:
            raise node.error(f"{self.low:g} to {self.high:g}")
        return value * self.scale


def figure(
    key: str, low: float, high: float, *, scale: float = 1.0, ideal: Any = None, default: Any = dataclasses.MISSING
) -> Any:
    """A dataclass field that is a number in the file; one without default must stand there."""
    return _field(Figure(key=key, low=low, high=high, scale=scale, ideal=ideal), default)


def numbers(key: str, count: int, low: float, high: float, *, ideal: Any = None) -> Any:
    """A dataclass field that is a list of numbers in the file, zeros where it does not stand there."""
    return _field(Figure(key=key, low=low, high=high, count=count, ideal=ideal), (0.0,) * count)


def word(key: str, *words: str, ideal: str | None = None) -> Any:
    """A dataclass field that is one of a few words in the file, the first where it does not stand there."""
    return _field(Figure(key=key, words=words, ideal=ideal), words[0])


def _field(entry: Figure, default: Any) -> Any:
    metadata = {_FIGURE: entry}
    if default is dataclasses.MISSING:
        return dataclasses.field(metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


D = TypeVar("D")


def read_figures(kind: type[D], node: Node, **given: Any) -> D:
    """A dataclass of figures from a mapping; a field that is such a dataclass itself is a mapping within.

    Args:
        kind: Dataclass whose fields are made by `figure`, `numbers` or `word`, or are dataclasses.
        node: Mapping of the file.
        given: Attributes that do not stand in the file.

    Raises:
        ConfigError: An unknown or missing key, or a value that makes no sense; names file, key, value and what is
            valid.
    """
    hints = get_type_hints(kind)
    entries = {_key(f): f for f in dataclasses.fields(kind) if f.name not in given}  # type: ignore[arg-type]
    for key in node.mapping():
        if key not in entries:
            raise ConfigError(node.source, _at(node, key), node.mapping()[key], f"the keys {', '.join(entries)}")
    values: dict[str, Any] = dict(given)
    for key, entry in entries.items():
        if key in node:
            inner = node.at(key)
            read = entry.metadata[_FIGURE].read if _FIGURE in entry.metadata else partial(read_figures, hints[key])
            values[entry.name] = read(inner)
        elif entry.default is dataclasses.MISSING:
            raise ConfigError(node.source, _at(node, key), "nothing", "a value, because this key is required")
    return kind(**values)


def idealised(part: D) -> D:
    """The ideal twin: every figure that is an error, a limit or a delay replaced by its perfect value."""
    changes: dict[str, Any] = {}
    for entry in dataclasses.fields(part):  # type: ignore[arg-type]
        value = getattr(part, entry.name)
        if dataclasses.is_dataclass(value):
            changes[entry.name] = idealised(value)
        elif _FIGURE in entry.metadata and entry.metadata[_FIGURE].ideal is not None:
            changes[entry.name] = entry.metadata[_FIGURE].ideal
    return dataclasses.replace(part, **changes)  # type: ignore[type-var]


def _key(entry: dataclasses.Field[Any]) -> str:
    return entry.metadata[_FIGURE].key if _FIGURE in entry.metadata else entry.name


def _at(node: Node, key: str) -> str:
    return f"{node.path}.{key}" if node.path else key
