"""CDR messages as fixed-layout records.

A ROS 2 message whose strings and sequences keep their lengths has its numbers at fixed offsets. `layout_of`
finds those offsets in one pass over a serialised message, and returns them as a numpy structured dtype. With it,
thousands of messages are encoded or decoded by assigning or reading columns. CDR as ROS 2 uses it: OMG CORBA 3.0,
chapter 9.3 (each primitive is aligned to its size, counted from the end of the 4-byte encapsulation header).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc

ENCAPSULATION = 4
"""Bytes of the header before a message; the second one is 1 for little-endian numbers and 0 for big-endian ones."""

_CODES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "octet": "u1",
    "int8": "i1",
    "int16": "i2",
    "int32": "i4",
    "int64": "i8",
    "uint8": "u1",
    "uint16": "u2",
    "uint32": "u4",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
"""NumPy's code, without byte order, of each ROS type of a number."""

_Form = np.dtype[np.generic] | tuple[np.dtype[np.generic], tuple[int, ...]]
"""NumPy type of a field: of one number, or of an array with its shape."""


@dataclass(frozen=True, eq=False)
class MessageLayout:
    """Memory layout of the numbers in one kind of message.

    Attributes:
        dtype: Structured type of a whole message; a field per number, array or vector, named by its dotted
            path (`header.stamp.sec`, `angular_velocity`). A nested message of float64s only is one vector.
        lengths: (offset, value) of every string and sequence length; messages with equal lengths share the layout.
        strings: Value of every string by its dotted path (a list for a sequence of strings).
        head: Encapsulation header, which contains the byte order.
    """

    dtype: np.dtype[np.void]
    lengths: tuple[tuple[int, int], ...]
    strings: dict[str, str | list[str]]
    head: bytes

    @cached_property
    def marks(self) -> tuple[tuple[int, bytes], ...]:
        """Offset and 4 bytes of the values that determine the layout: the encapsulation header and every length."""
        u32 = "<I" if self.head[1] else ">I"  # in the byte order that the header says
        return ((0, self.head), *((at, struct.pack(u32, value)) for at, value in self.lengths))

    def fits(self, messages: NDArray[np.void]) -> bool:
        """Whether all of `messages`, (N,) raw items of this item size, have this layout: equal lengths everywhere."""
        data = messages.view(np.uint8).reshape(len(messages), -1)
        return all(bool(np.all(data[:, at : at + 4] == np.frombuffer(word, np.uint8))) for at, word in self.marks)

    def fits_message(self, payload: bytes) -> bool:
        """Whether one message has this layout; much faster than `fits` for one."""
        same_size = len(payload) == self.dtype.itemsize
        return same_size and all(payload.startswith(word, at) for at, word in self.marks)


class _LayoutParser:
    """Records the offsets of numbers, lengths and strings in one pass over a serialised message.

    Args:
        payload: CDR bytes.
        store: Definitions of the types.

    Attributes:
        at: Offset of the next byte.
        fields: NumPy type and offset of each number, array or vector, by its dotted path.
        lengths: Offset and value of every length.
        strings: Every string by its dotted path.

    Raises:
        ValueError: The bytes do not begin with plain CDR encapsulation.
    """

    def __init__(self, payload: bytes, store: Typestore) -> None:
        """Checks the encapsulation header, whose second byte says the byte order, and begins after it."""
        if len(payload) < ENCAPSULATION or payload[0] != 0 or payload[1] not in (0, 1):
            raise ValueError("no plain CDR encapsulation")
        self.payload, self.store = payload, store
        self.order = "<" if payload[1] else ">"
        self.at = ENCAPSULATION
        self.fields: dict[str, tuple[_Form, int]] = {}
        self.lengths: list[tuple[int, int]] = []
        self.strings: dict[str, str | list[str]] = {}

    def align_to(self, size: int) -> None:
        """Moves to the next multiple of `size` bytes after the encapsulation header, unless it is at one."""
        self.at += -(self.at - ENCAPSULATION) % size  # bytes that are missing up to the multiple

    def read_length(self) -> int:
        """Reads the length of a string or sequence, u32, and records its offset.

        Raises:
            ValueError: The length exceeds that of the message.
        """
        self.align_to(4)
        (value,) = struct.unpack_from(self.order + "I", self.payload, self.at)
        if value > len(self.payload):  # before anything loops over so many items
            raise ValueError(f"a length of {value} in a message of {len(self.payload)} bytes")
        self.lengths.append((self.at, value))
        self.at += 4
        return int(value)

    def read_string(self) -> str:
        """Reads a string: its length with the terminating NUL, then UTF-8."""
        n = self.read_length()
        text = self.payload[self.at : self.at + n].rstrip(b"\0").decode()
        self.at += n
        return text

    def record_numbers(self, path: str, base: str, shape: tuple[int, ...]) -> None:
        """Records the offset and the NumPy type of numbers, and skips them.

        Args:
            path: Dotted path of the field.
            base: ROS type of each number, such as `float64`.
            shape: Shape of the array; empty for one number.
        """
        number = np.dtype(self.order + _CODES[base])
        count = int(np.prod(shape))  # 1 for an empty shape
        if count:  # CDR does not align an empty array
            self.align_to(number.itemsize)
        self.fields[path] = ((number, shape) if shape else number, self.at)
        self.at += count * number.itemsize

    def record_message(self, path: str, typename: str) -> None:
        """Records everything in a message; a nested one of float64s alone, such as a vector, becomes one field.

        Args:
            path: Dotted path of the message; "" for the outermost one.
            typename: Its ROS type.
        """
        members = self.store.fielddefs[typename][1]  # pairs of a field's name and rosbags' description of its type
        is_vector = all(kind == Nodetype.BASE and detail[0] == "float64" for _, (kind, detail) in members)
        if path and is_vector:
            self.record_numbers(path, "float64", (len(members),))
            return
        for name, description in members:
            self.record_member(f"{path}.{name}" if path else name, description)

    def record_member(self, path: str, description: FieldDesc) -> None:
        """Records a field of a message: a number, string, message, or an array or sequence of these.

        Args:
            path: Dotted path of the field.
            description: rosbags' description of its type. Its first entry is the kind; its second one the name of a
                message type (NAME), the ROS type of a number or string with its longest length (BASE), or the
                description and the number of the items (ARRAY, SEQUENCE).
        """
        if description[0] == Nodetype.NAME:
            self.record_message(path, description[1])
        elif description[0] == Nodetype.BASE:
            if description[1][0] == "string":
                self.strings[path] = self.read_string()
            else:
                self.record_numbers(path, description[1][0], ())
        else:  # an array of fixed length, or a sequence, before whose items the message has their number
            inner, size = description[1]
            count = size if description[0] == Nodetype.ARRAY else self.read_length()
            if inner[0] == Nodetype.NAME:
                for i in range(count):
                    self.record_message(f"{path}.{i}", inner[1])
            elif inner[1][0] == "string":
                self.strings[path] = [self.read_string() for _ in range(count)]
            else:
                self.record_numbers(path, inner[1][0], (count,))


def layout_of(payload: bytes, typename: str, store: Typestore) -> MessageLayout:
    """Finds the layout of one serialised message in one pass over its bytes.

    Args:
        payload: CDR bytes.
        typename: ROS 2 type, such as `sensor_msgs/msg/Imu`.
        store: Definitions of the types.

    Raises:
        ValueError: The bytes are not a message of this type.
    """
    parser = _LayoutParser(payload, store)
    try:
        parser.record_message("", typename)
    except (struct.error, UnicodeDecodeError, KeyError) as error:  # KeyError: an undefined type
        raise ValueError(f"not a {typename}: {error}") from error
    if not parser.at <= len(payload) < parser.at + 4:  # writers may fill up to a multiple of 4 bytes
        raise ValueError(f"a {typename} of {len(payload)} bytes where {parser.at} were expected")
    dtype = np.dtype(
        {
            "names": list(parser.fields),
            "formats": [form for form, _ in parser.fields.values()],
            "offsets": [at for _, at in parser.fields.values()],
            "itemsize": len(payload),
        }
    )
    return MessageLayout(dtype, tuple(parser.lengths), parser.strings, payload[:ENCAPSULATION])
