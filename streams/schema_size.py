"""Size limits of message definitions: a malicious one declares arrays, or nesting, that no real message has.

rosbags unrolls fixed arrays into code, and reads sequences element by element. The size of an element bounds the
number of iterations for a message.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from rosbags.interfaces import Nodetype

LARGEST_TEXT = 1 << 16
"""Most characters of a definition; the longest standard one that is read has a sixth of it."""
LARGEST_TEXTS = 1 << 18
"""Most characters of all definitions of a file that are read; there are about 25 types of them."""
MOST_ELEMENTS = 1000
"""Most fields of a message with every fixed array of messages or texts unrolled; the largest standard one has 87."""
DEEPEST = 16
_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*)*")


class Definitions:
    """The definitions of one file read so far; each takes time to parse."""

    def __init__(self) -> None:
        self._known: set[str] = set()

    def take(self, text: str) -> None:
        """Adds one.

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
        raise ValueError(f"a definition of {len(text)} characters; valid: up to {LARGEST_TEXT}")


def check_types(types: Mapping[str, Any]) -> None:
    """Rejects types that no real recording needs.

    Args:
        types: Field definitions by type, as returned by rosbags' parsers.

    Raises:
        ValueError: Invalid names, recursive types, too many fields, or sequences of empty types.
    """
    counts: dict[str, int] = {}
    for name in types:
        _elements(name, types, counts, ())


def _elements(name: str, types: Mapping[str, Any], counts: dict[str, int], around: tuple[str, ...]) -> int:
    """Number of fields of one message of a type, including those of its members."""
    if name in counts or name not in types:
        return counts.get(name, 1)
    if name in around or len(around) >= DEEPEST or not _NAME.fullmatch(name):
        raise ValueError(f"type {name[:80]!r} is not valid; valid: names of up to {DEEPEST} types inside each other")
    count = 0
    for field, (node, detail) in types[name][1]:
        if not _NAME.fullmatch(field):
            raise ValueError(f"field {field[:80]!r} is not valid; valid: letters, digits and _")
        inner, size = detail if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else ((node, detail), 1)
        each = _elements(inner[1], types, counts, (*around, name)) if inner[0] == Nodetype.NAME else 1
        if node == Nodetype.SEQUENCE and each == 0:
            raise ValueError(f"{name[:80]}.{field}: a sequence of a type without fields")
        is_plain = inner[0] == Nodetype.BASE and inner[1][0] != "string"
        count += each * (size if node == Nodetype.ARRAY and not is_plain else 1)
        if count > MOST_ELEMENTS or (node == Nodetype.ARRAY and size > 1 << 20):
            raise ValueError(f"{name[:80]}.{field}: more fields than any message has ({MOST_ELEMENTS})")
    counts[name] = count
    return count
