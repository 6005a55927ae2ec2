"""One figure of a data sheet: how a part file names it, in which unit, and between which bounds it makes sense."""

from __future__ import annotations

import dataclasses
import math
import typing
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, TypeVar, get_type_hints

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model

from stridetwin.streams.errors import Missing
from stridetwin.streams.fields import enum_field, field_error, float_field
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2

DEG = math.pi / 180
G = STANDARD_GRAVITY_MPS2
_FIGURE = "figure"
_SOURCED = ("value", "source")


@dataclass(frozen=True, kw_only=True)
class Figure:
    """How one attribute of a part is written in its file.

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

    @property
    def type(self) -> Any:
        """Type of the value in the file: bare, or `{value: ..., source: ...}`."""
        if self.words:
            bare: Any = Annotated[str, enum_field(self.words)]
        else:
            bare = Annotated[float, float_field(self.low, self.high, scale=self.scale)]
            if self.count:
                bare = tuple[(bare,) * self.count]  # type: ignore[misc]
        return Annotated[bare, BeforeValidator(_strip_source, json_schema_input_type=bare | _type_with_source(bare))]


def _type_with_source(bare: Any) -> Any:
    """Type of a figure with its source, `{value: ..., source: ...}`, as an alternative to the bare value."""
    return create_model("Sourced", __config__=ConfigDict(extra="forbid"), value=(bare, ...), source=(str, ""))


def _strip_source(node: object) -> object:
    """Value of a figure that may be written with its source; rejects other keys and a missing value."""
    if not isinstance(node, dict):
        return node
    for key in node:
        if key not in _SOURCED:
            raise field_error(key, f"keys {', '.join(_SOURCED)}")
    if "value" not in node:
        raise field_error(Missing(), "this key", "value")
    return node["value"]


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
    entry: str = _field(Figure(key=key, words=words, ideal=ideal), words[0])
    return entry


def _field(entry: Figure, default: Any) -> Any:
    """Dataclass field with a `Figure` in its metadata."""
    metadata = {_FIGURE: entry}
    if default is dataclasses.MISSING:
        return dataclasses.field(metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


D = TypeVar("D")


@cache
def file_model(kind: type) -> type[BaseModel]:
    """Pydantic model of the keys that a part file has for a dataclass of figures.

    Dataclasses inside it become nested mappings. The name of a part is that of its file, so it is no key.

    Args:
        kind: Dataclass whose fields are made by `figure`, `numbers` or `word`, or are such dataclasses, or plain text.
    """
    hints, model_fields = get_type_hints(kind), dict[str, Any]()
    for entry in dataclasses.fields(kind):
        if entry.name == "name":  # of the part: the file's
            continue
        if _FIGURE in entry.metadata:
            field_type = entry.metadata[_FIGURE].type
        else:
            field_type = (
                file_model(hints[entry.name]) if dataclasses.is_dataclass(hints[entry.name]) else hints[entry.name]
            )
        model_fields[entry.name] = (field_type, _file_field(entry))
    model: type[BaseModel] = create_model(kind.__name__, __config__=ConfigDict(extra="forbid"), **model_fields)
    model.__doc__ = kind.__doc__
    return model


def _file_field(entry: dataclasses.Field[Any]) -> Any:
    """Field of the file model, with the name in the file and the default value."""
    default = ... if entry.default is dataclasses.MISSING else entry.default
    return Field(default, alias=entry.metadata[_FIGURE].key) if _FIGURE in entry.metadata else Field(default)


def build_part(kind: type[D], read: BaseModel, **attributes: Any) -> D:
    """Dataclass of figures from what its file model has read.

    Args:
        kind: The dataclass.
        read: Result of its `file_model`.
        attributes: Attributes that the file lacks, such as the name.
    """
    hints = get_type_hints(kind)
    values = {name: getattr(read, name) for name in type(read).model_fields}
    inner = {name: build_part(hints[name], v) for name, v in values.items() if isinstance(v, BaseModel)}
    return kind(**values | inner | attributes)


def make_ideal(part: D) -> D:
    """Noise-free version of a part: with its rate, size and place, but without error, limit or delay."""
    changes: dict[str, Any] = {}
    for entry in dataclasses.fields(part):  # type: ignore[arg-type]
        value = getattr(part, entry.name)
        if dataclasses.is_dataclass(value):
            changes[entry.name] = make_ideal(value)
        elif _FIGURE in entry.metadata and entry.metadata[_FIGURE].ideal is not None:
            changes[entry.name] = entry.metadata[_FIGURE].ideal
    return dataclasses.replace(part, **changes)  # type: ignore[type-var]
