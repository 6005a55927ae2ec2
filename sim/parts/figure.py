"""One figure of a data sheet: how a part file names it, in which unit, and between which bounds it makes sense."""

from __future__ import annotations

import dataclasses
import math
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
        return Annotated[bare, BeforeValidator(_bare, json_schema_input_type=bare | _sourced(bare))]


def _sourced(bare: Any) -> Any:
    """A figure that says where it comes from."""
    return create_model("Sourced", __config__=ConfigDict(extra="forbid"), value=(bare, ...), source=(str, ""))


def _bare(node: object) -> object:
    if not isinstance(node, dict):
        return node
    for key in node:
        if key not in _SOURCED:
            raise field_error(key, f"keys {', '.join(_SOURCED)}")
    if "value" not in node:
        raise field_error(Missing(), "this key", "value")
    return node["value"]


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


@cache
def file_model(kind: type) -> type[BaseModel]:
    """The pydantic model of what a file says of a dataclass of figures; dataclasses inside it are mappings within.

    Args:
        kind: Dataclass whose fields are made by `figure`, `numbers` or `word`, or are such dataclasses, or plain text.
    """
    hints, made = get_type_hints(kind), dict[str, Any]()
    for entry in dataclasses.fields(kind):
        if entry.name == "name":  # of the part: the file's
            continue
        if _FIGURE in entry.metadata:
            of = entry.metadata[_FIGURE].type
        else:
            of = file_model(hints[entry.name]) if dataclasses.is_dataclass(hints[entry.name]) else hints[entry.name]
        made[entry.name] = (of, _file_field(entry))
    model: type[BaseModel] = create_model(kind.__name__, __config__=ConfigDict(extra="forbid"), **made)
    model.__doc__ = kind.__doc__
    return model


def _file_field(entry: dataclasses.Field[Any]) -> Any:
    default = ... if entry.default is dataclasses.MISSING else entry.default
    return Field(default, alias=entry.metadata[_FIGURE].key) if _FIGURE in entry.metadata else Field(default)


def built(kind: type[D], read: BaseModel, **given: Any) -> D:
    """The dataclass from what its file model has read; `given` are attributes that the file lacks."""
    hints = get_type_hints(kind)
    values = {name: getattr(read, name) for name in type(read).model_fields}
    inner = {name: built(hints[name], v) for name, v in values.items() if isinstance(v, BaseModel)}
    return kind(**values | inner | given)


def ideal(part: D) -> D:
    """The noise-free version: same rate, size and place, but no error, limit or delay."""
    changes: dict[str, Any] = {}
    for entry in dataclasses.fields(part):  # type: ignore[arg-type]
        value = getattr(part, entry.name)
        if dataclasses.is_dataclass(value):
            changes[entry.name] = ideal(value)
        elif _FIGURE in entry.metadata and entry.metadata[_FIGURE].ideal is not None:
            changes[entry.name] = entry.metadata[_FIGURE].ideal
    return dataclasses.replace(part, **changes)  # type: ignore[type-var]
