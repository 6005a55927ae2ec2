"""ROS 2 message types: the standard ones, our own four, and their definition texts."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from stridetwin.streams.schema_size import check_text, check_types

_MOST_STORES = 256
OWN_PACKAGE = "stridetwin_msgs"
OWN_TYPES = ("Insole", "Interaction", "Actuator", "Footprint")


@cache
def typestore() -> Typestore:
    """The types that are written: ROS 2 Jazzy's and those of `streams/msgs`."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in OWN_TYPES:
        text = files(__package__).joinpath("msgs", f"{name}.msg").read_text(encoding="utf-8")
        store.register(get_types_from_msg(text, f"{OWN_PACKAGE}/msg/{name}"))
    return store


@cache
def definition(typename: str) -> str:
    """Definition of a type with all types that it needs, in the form of an MCAP `ros2msg` schema."""
    text, _ = typestore().generate_msgdef(typename, ros_version=2)
    return text


@lru_cache(_MOST_STORES)
def typestore_for(typename: str, encoding: str, text: str) -> Typestore:
    """The types that a recording's own schema defines, which may be of another ROS release.

    Raises:
        ValueError: The schema cannot be parsed.
    """
    if encoding == "ros2msg" and text == _definition_or_empty(typename):
        return typestore()
    store = get_typestore(Stores.EMPTY)
    try:
        check_text(text)
        types = get_types_from_msg(text, typename) if encoding == "ros2msg" else get_types_from_idl(text)
        check_types(types)
        store.register(types)
        store.generate_msgdef(typename, ros_version=2)  # visits all types that it contains
    except Exception as error:  # the parser raises several unrelated kinds
        words = " ".join(str(error).split())
        raise ValueError(f"schema of {typename} cannot be parsed: {words[:120]}") from error
    return store


def deserialise(store: Typestore, payload: bytes, typename: str) -> Any:
    """The message in CDR bytes.

    Raises:
        ValueError: The bytes are not a message of this type.
    """
    try:
        return store.deserialize_cdr(payload, typename)
    except Exception as error:  # the generated code does not validate its input: struct, index, memory errors and more
        raise ValueError(f"not a {typename}: {' '.join(str(error).split())[:120]}") from error


def _definition_or_empty(typename: str) -> str:
    return definition(typename) if typename in typestore().fielddefs else ""


def message(typename: str, values: Mapping[str, Any]) -> Any:
    """A message of a type: zeros and empty strings, except for `values`, given by dotted path."""
    return _blank(typename, "", values)


def serialise(typename: str, values: Mapping[str, Any]) -> bytes:
    """The little-endian CDR bytes of `message(typename, values)`."""
    return bytes(typestore().serialize_cdr(message(typename, values), typename, little_endian=True))


def _blank(typename: str, path: str, values: Mapping[str, Any]) -> Any:
    store = typestore()
    members = {}
    description: Any
    for name, description in store.fielddefs[typename][1]:
        node, detail = description
        inner_path = f"{path}.{name}" if path else name
        if inner_path in values:
            members[name] = values[inner_path]
        elif node == Nodetype.NAME:
            members[name] = _blank(detail, inner_path, values)
        elif node == Nodetype.BASE:
            members[name] = "" if detail[0] == "string" else 0
        else:
            (inner, base), size = detail
            count = size if node == Nodetype.ARRAY else 0
            is_array = inner == Nodetype.BASE and base[0] != "string"
            members[name] = np.zeros(count, base[0]) if is_array else []
    return store.types[typename](**members)
