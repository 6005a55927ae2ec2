"""Part files: a pydantic model of the keys of each kind of part, from the figures of its dataclass.

It takes a tenth of a second to build them, so this module is imported when the first part is read.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

from pydantic import BaseModel, BeforeValidator, Field, create_model

from stridetwin.sim.parts.figure import FIGURE, Figure
from stridetwin.sim.parts.kinds import PART_CLASSES, Part
from stridetwin.streams.errors import Missing
from stridetwin.streams.fields import FileModel, Number, OneKind, OneOf, Unit, field_error
from stridetwin.streams.validation import validate
from stridetwin.streams.yaml_file import read_yaml

_SOURCED = ("value", "source")  # keys of a figure that is written with its source
D = TypeVar("D")  # a dataclass of figures


def _figure_type(entry: Figure) -> Any:
    """Type of a figure in the file: the bare value, or `{value: ..., source: ...}`.

    It checks the bounds and converts from the file's unit to SI.
    """
    if entry.choices:
        bare: Any = Annotated[str, OneOf(entry.choices)]
    else:
        bare = Annotated[Number, Field(ge=entry.low, le=entry.high), Unit(entry.scale)]
        if entry.count:
            bare = tuple[(bare,) * entry.count]  # type: ignore[misc]
    return Annotated[bare, BeforeValidator(_strip_source, json_schema_input_type=bare | _type_with_source(bare))]


def _type_with_source(bare: Any) -> Any:
    """Type of a figure with its source, `{value: ..., source: ...}`, as an alternative to the bare value."""
    return create_model("Sourced", __base__=FileModel, value=(bare, ...), source=(str, ""))


def _strip_source(node: object) -> object:
    """Bare value of a figure that may be written with its source; rejects other keys and a missing value.

    `node` is what the file has: a mapping with the value, or the value itself, which comes back unchanged.
    """
    if not isinstance(node, dict):
        return node
    for key in node:
        if key not in _SOURCED:
            raise field_error(key, f"keys {', '.join(_SOURCED)}")
    if "value" not in node:
        raise field_error(Missing(), "this key", "value")
    return node["value"]


@cache
def file_model(kind: type) -> type[BaseModel]:
    """Pydantic model of the keys that a part file has for a dataclass of figures.

    Dataclasses inside it become nested mappings. The name of a part is that of its file, so it is no key.

    Args:
        kind: Dataclass whose fields are made by `figure`, `numbers` or `word`, or are such dataclasses, or plain text.
    """
    hints, model_fields = get_type_hints(kind), dict[str, Any]()  # types, and (type, field) pairs, by attribute
    for entry in dataclasses.fields(kind):
        if entry.name == "name":  # of the part: it is the name of the file
            continue
        if FIGURE in entry.metadata:
            field_type = _figure_type(entry.metadata[FIGURE])
        else:
            # a dataclass inside, or another type as it is
            field_type = (
                file_model(hints[entry.name]) if dataclasses.is_dataclass(hints[entry.name]) else hints[entry.name]
            )
        model_fields[entry.name] = (field_type, _file_field(entry))
    model: type[BaseModel] = create_model(kind.__name__, __base__=FileModel, **model_fields)
    model.__doc__ = kind.__doc__
    return model


def _file_field(entry: dataclasses.Field[Any]) -> Any:
    """Field of the file model, with the name in the file and the default value; `...` stands for a required key."""
    default = ... if entry.default is dataclasses.MISSING else entry.default
    return Field(default, alias=entry.metadata[FIGURE].key) if FIGURE in entry.metadata else Field(default)


def build_part(kind: type[D], read: BaseModel, **attributes: Any) -> D:
    """Dataclass of figures from what its file model has read.

    Args:
        kind: The dataclass.
        read: Result of its `file_model`.
        attributes: Attributes that the file lacks, such as the name.
    """
    hints = get_type_hints(kind)
    values = {name: getattr(read, name) for name in type(read).model_fields}
    # dataclasses inside it, which the file has as nested mappings
    inner = {name: build_part(hints[name], v) for name, v in values.items() if isinstance(v, BaseModel)}
    return kind(**values | inner | attributes)


PartFile = Annotated[Any, OneKind({name: file_model(kind) for name, kind in PART_CLASSES.items()})]
"""Type of the data in a part file."""


def read_part_file(path: Path) -> Part:
    """The part that a file describes, named after the file.

    Raises:
        ConfigError: Unknown or missing keys, an unknown kind, or an invalid value; the message names file, key, value
            and what is valid.
        StrideTwinError: The file cannot be read or is not YAML.
    """
    read = validate(PartFile, read_yaml(path), path)
    # class of the part by the model that has read it
    models = {file_model(kind): kind for kind in PART_CLASSES.values()}  # type: ignore[arg-type]  # they are hashable
    part_class = models[type(read)]
    return build_part(part_class, read, name=path.stem)
