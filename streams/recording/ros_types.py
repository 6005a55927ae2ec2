"""ROS 2 message types: the standard ones, our own four, and their definition texts.

Definitions are limited in size, because a malicious one may declare huge arrays or nesting: rosbags unrolls fixed
arrays into code, and reads sequences element by element. The size of an element bounds the iterations per message.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache, lru_cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict

LARGEST_TEXT = 1 << 16
"""Most characters of a definition; the longest standard one that is read has a sixth of it."""
LARGEST_TEXTS = 1 << 18
"""Most characters of all definitions of a file that are read; there are about 25 types of them."""
MOST_ELEMENTS = 1000
"""Most fields of a message with every fixed array of messages or texts unrolled; the largest standard one has 87."""
DEEPEST = 16
"""Most message types inside each other."""
_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*)*")
"""A valid name of a type or of a field."""


class RosMessage(Protocol):
    """A message whose type its definition in the recording makes: fields are attributes, known only while it is read.

    Raises:
        AttributeError: The definition has no such field.
    """

    def __getattr__(self, field: str, /) -> Any:
        """Value of a field: a number, a text, an array, a message, or a list of these."""


class Definitions:
    """Limits the definitions of one file, since each takes time to parse."""

    def __init__(self) -> None:
        self._known: set[str] = set()  # texts of the definitions so far

    def add(self, text: str) -> None:
        """Adds the text of a definition; texts that are known count once.

        Raises:
            ValueError: The definition is too long, or there are too many.
        """
        check_text(text)
        if text not in self._known:
            self._known.add(text)
            if sum(map(len, self._known)) > LARGEST_TEXTS:
                raise ValueError(f"definitions of more than {LARGEST_TEXTS} characters in all")


def check_text(text: str) -> None:
    """Rejects a definition that is too long.

    Raises:
        ValueError: The definition is too long.
    """
    if len(text) > LARGEST_TEXT:
        raise ValueError(f"a definition of {len(text)} characters: expected up to {LARGEST_TEXT}")


def check_types(types: Typesdict) -> None:
    """Rejects types that no real recording needs.

    Args:
        types: Field definitions by type, as returned by rosbags' parsers.

    Raises:
        ValueError: Invalid names, recursive types, too many fields, or sequences of empty types.
    """
    counts: dict[str, int] = {}  # number of fields of each type that is checked already
    for name in types:
        _count_fields(name, types, counts, ())  # for its errors alone


def _count_fields(name: str, types: Typesdict, counts: dict[str, int], around: tuple[str, ...]) -> int:
    """Number of fields of one message of a type, including those of its members.

    An array of messages or texts counts once per item; an array of numbers, and a sequence, counts as one item.

    Args:
        name: Name of the type; one that is not in `types` counts as one field.
        types: Field definitions by type.
        counts: Results so far, by type; extended.
        around: Names of the types that this one is nested in, the outermost first.

    Raises:
        ValueError: Invalid names, recursive types, too many fields, or sequences of empty types.
    """
    if name in counts or name not in types:
        return counts.get(name, 1)
    if name in around or len(around) >= DEEPEST or not _NAME.fullmatch(name):  # in `around`: the type contains itself
        raise ValueError(f"invalid type {name[:80]!r}: expected names of up to {DEEPEST} types inside each other")
    count = 0
    # rosbags describes the type of a field by its kind, and by the type of its items and their number for an array or a
    # sequence, or else by a name
    for field, description in types[name][1]:
        if not _NAME.fullmatch(field):
            raise ValueError(f"invalid field {field[:80]!r}: expected letters, digits and _")
        kind = description[0]
        if description[0] == Nodetype.NAME or description[0] == Nodetype.BASE:  # a message, or a number or text
            inner, size = description, 1
        else:
            inner, size = description[1]
        each = _count_fields(inner[1], types, counts, (*around, name)) if inner[0] == Nodetype.NAME else 1
        if kind == Nodetype.SEQUENCE and each == 0:  # any number of items would fit into no bytes
            raise ValueError(f"{name[:80]}.{field}: a sequence of a type without fields")
        is_number = inner[0] == Nodetype.BASE and inner[1][0] != "string"
        count += each * (size if kind == Nodetype.ARRAY and not is_number else 1)
        # an array of numbers counts as one item, so that its length needs a limit of its own
        if count > MOST_ELEMENTS or (kind == Nodetype.ARRAY and size > 1 << 20):
            raise ValueError(f"{name[:80]}.{field}: more fields than any message has ({MOST_ELEMENTS})")
    counts[name] = count
    return count


_MOST_STORES = 256
"""Most schemas of recordings whose parsed types are kept for the next topic or file."""
OWN_PACKAGE = "stridetwin_msgs"
"""ROS package of our own message types."""
OWN_TYPES = ("Insole", "Interaction", "Actuator", "Footprint")
"""Names of our own message types."""


@cache
def typestore() -> Typestore:
    """The types of our messages: those of ROS 2 Jazzy, and our own of `streams/recording/msgs`."""
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

    Args:
        typename: Message type of the schema.
        encoding: `ros2msg`, or IDL for any other.
        text: Text of the schema.

    Raises:
        ValueError: The schema cannot be parsed.
    """
    if encoding == "ros2msg" and text == _definition_or_empty(typename):  # the definition that is parsed already
        return typestore()
    store = get_typestore(Stores.EMPTY)
    try:
        check_text(text)
        types = get_types_from_msg(text, typename) if encoding == "ros2msg" else get_types_from_idl(text)
        check_types(types)
        store.register(types)
        store.generate_msgdef(typename, ros_version=2)  # visits all types that it contains
    except Exception as error:  # the parser raises several unrelated kinds
        reason = " ".join(str(error).split())
        raise ValueError(f"schema of {typename} cannot be parsed: {reason[:120]}") from error
    return store


def deserialise(store: Typestore, payload: bytes, typename: str) -> RosMessage:
    """The message in CDR bytes, as an object with the fields of its type.

    Raises:
        ValueError: The bytes are not a message of this type.
    """
    try:
        return cast(RosMessage, store.deserialize_cdr(payload, typename))
    except Exception as error:  # the generated code does not validate its input: struct, index, memory errors and more
        raise ValueError(f"not a {typename}: {' '.join(str(error).split())[:120]}") from error


def _definition_or_empty(typename: str) -> str:
    """The definition of a standard type or one of ours; "" for any other."""
    return definition(typename) if typename in typestore().fielddefs else ""


def build_message(typename: str, values: Mapping[str, object]) -> RosMessage:
    """Builds a message of a type: zeros and empty strings, except for `values`, given by dotted path."""
    return _build_message(typename, "", values)


def serialise(typename: str, values: Mapping[str, object]) -> bytes:
    """The little-endian CDR bytes of a message with the given values, and zeros and empty strings elsewhere."""
    return bytes(typestore().serialize_cdr(build_message(typename, values), typename, little_endian=True))


def _build_message(typename: str, path: str, values: Mapping[str, object]) -> RosMessage:
    """Builds the message at a dotted path inside another one; "" is the outermost.

    Args:
        typename: Type of the message.
        path: Its dotted path in the outermost message.
        values: Values by dotted path from the outermost message; all others are 0, "" or empty.
    """
    store = typestore()
    members: dict[str, Any] = {}
    for name, description in store.fielddefs[typename][1]:
        inner_path = f"{path}.{name}" if path else name
        if inner_path in values:
            members[name] = values[inner_path]
        elif description[0] == Nodetype.NAME:  # a message
            members[name] = _build_message(description[1], inner_path, values)
        elif description[0] == Nodetype.BASE:  # a number or a text
            members[name] = "" if description[1][0] == "string" else 0
        else:  # an array of fixed length, or a sequence: the description has the type of the items, and their number
            inner, size = description[1]
            count = size if description[0] == Nodetype.ARRAY else 0
            has_numbers = inner[0] == Nodetype.BASE and inner[1][0] != "string"
            members[name] = np.zeros(count, inner[1][0]) if has_numbers else []
    return cast(RosMessage, store.types[typename](**members))
