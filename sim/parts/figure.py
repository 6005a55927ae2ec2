"""One figure of a data sheet: how a part file names it, in which unit, and between which bounds it makes sense."""

from __future__ import annotations

import dataclasses
import math
import typing
from dataclasses import dataclass
from typing import Any, TypeVar

from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2

DEG = math.pi / 180
G = STANDARD_GRAVITY_MPS2
FIGURE = "figure"
"""Key of the `Figure` in the metadata of a dataclass field."""


@dataclass(frozen=True, kw_only=True)
class Figure:
    """How one attribute of a part is written in its file.

    Attributes:
        key: Name in the file, with the unit.
        low: Smallest value that makes sense, in the file's unit.
        high: Largest one.
        scale: From the file's unit to SI.
        ideal: What an ideal twin of the part has instead, in SI; None: what the part itself has.
        choices: The valid words, where the value is one.
        count: Number of values where it is a list; 0 for one.
    """

    key: str
    low: float = -math.inf
    high: float = math.inf
    scale: float = 1.0
    ideal: Any = None
    choices: tuple[str, ...] = ()
    count: int = 0


def figure(
    key: str,
    low: float,
    high: float,
    *,
    scale: float = 1.0,
    ideal: float | None = None,
    default: object = dataclasses.MISSING,
) -> float:
    """Dataclass field of a part that is a number in its file.

    Args:
        key: Name in the file, with the unit.
        low: Smallest value that makes sense, in the file's unit.
        high: Largest one.
        scale: From the file's unit to SI.
        ideal: Value of an ideal part, in SI; None: the part's own.
        default: Value if the file has no such key; a figure without default must be there.
    """
    entry: float = _field(Figure(key=key, low=low, high=high, scale=scale, ideal=ideal), default)
    return entry


@typing.overload
def numbers(
    key: str, count: typing.Literal[2], low: float, high: float, *, ideal: tuple[float, float] | None = None
) -> tuple[float, float]: ...


@typing.overload
def numbers(
    key: str,
    count: typing.Literal[4],
    low: float,
    high: float,
    *,
    ideal: tuple[float, float, float, float] | None = None,
) -> tuple[float, float, float, float]: ...


def numbers(
    key: str, count: int, low: float, high: float, *, ideal: tuple[float, ...] | None = None
) -> tuple[float, ...]:
    """Dataclass field of a part that is a list of `count` numbers in its file; zeros if the file has no such key.

    Args:
        key: Name in the file.
        count: Number of values.
        low: Smallest value that makes sense.
        high: Largest one.
        ideal: Value of an ideal part; None: the part's own.
    """
    entry: tuple[float, ...] = _field(Figure(key=key, low=low, high=high, count=count, ideal=ideal), (0.0,) * count)
    return entry


def word(key: str, *words: str, ideal: str | None = None) -> str:
    """Dataclass field of a part that is one of a few words in its file; the first one if the file has no such key.

    Args:
        key: Name in the file.
        words: The valid words.
        ideal: Word of an ideal part; None: the part's own.
    """
    entry: str = _field(Figure(key=key, choices=words, ideal=ideal), words[0])
    return entry


def _field(entry: Figure, default: Any) -> Any:
    """Dataclass field with a `Figure` in its metadata; `dataclasses.MISSING` as default makes it a required one."""
    metadata = {FIGURE: entry}
    if default is dataclasses.MISSING:
        return dataclasses.field(metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


D = TypeVar("D")  # a dataclass


def make_ideal(part: D) -> D:
    """Noise-free version of a part: with its rate, size and place, but without error, limit or delay.

    Each figure that has an ideal value gets it; the others, and what is no figure, stay. `part` may also be a dataclass
    inside a part, such as a gyroscope.
    """
    changes: dict[str, Any] = {}
    for entry in dataclasses.fields(part):  # type: ignore[arg-type]
        # metadata[FIGURE] is the `Figure` of a field that is a figure
        value = getattr(part, entry.name)
        if dataclasses.is_dataclass(value):
            changes[entry.name] = make_ideal(value)
        elif FIGURE in entry.metadata and entry.metadata[FIGURE].ideal is not None:
            changes[entry.name] = entry.metadata[FIGURE].ideal
    return dataclasses.replace(part, **changes)  # type: ignore[type-var]
