"""The keys of another tool's calibration, taken one by one, so that those that are not used can be named."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from stridetwin.streams.errors import FieldLocation, Missing
from stridetwin.streams.matrix_fields import to_matrix_rows
from stridetwin.streams.samples import Array

Section = dict[str, object]
"""One section of a Kalibr file: the keys of a camera or an IMU."""


class Keys:
    """A mapping in a file whose keys are taken one by one; `unused` names the others."""

    def __init__(self, node: Mapping[str, object], place: FieldLocation) -> None:
        """Begins with all keys of `node`; `place` is where the mapping is in its file, for errors."""
        self._node, self.place = dict(node), place
        self._inside: list[Keys] = []

    def __contains__(self, key: str) -> bool:
        """Whether the key is there and has not been taken."""
        return key in self._node

    def __iter__(self) -> Iterator[str]:
        """The keys that have not been taken."""
        return iter(list(self._node))

    def list_unused(self) -> list[str]:
        """Dotted paths of the keys that have not been taken, those of taken mappings among them."""
        return [self.place.key(key).path for key in self._node] + [
            path for k in self._inside for path in k.list_unused()
        ]

    def take(self, key: str) -> object:
        """The value of a key, as it is in the file; None if the file lacks it."""
        return self._node.pop(key, None)

    def take_number(self, key: str, default: float | None = None) -> float:
        """A finite number.

        Raises:
            ConfigError: It is none, or the key is missing and has no default.
        """
        if key not in self._node and default is not None:
            return default
        return self._to_number(key, self._node.pop(key, Missing()))

    def take_numbers(self, keys: tuple[str, ...]) -> list[float]:
        """The finite numbers of several keys, all of them required."""
        return [self.take_number(key) for key in keys]

    def take_list(self, key: str) -> list[float]:
        """A list of finite numbers; OpenCV's matrices are flat, and one number is a list of one.

        Raises:
            ConfigError: It is none, or missing.
        """
        node = self._node.pop(key, Missing())
        if isinstance(node, dict) and isinstance(node.get("data"), list):
            node = node["data"]
        items = node if isinstance(node, list) else [node]
        flat = [value for item in items for value in (item if isinstance(item, list) else [item])]
        return [self._to_number(key, value) for value in flat]

    def take_text(self, key: str, default: str) -> str:
        """A text; the default if the key is missing.

        Raises:
            ConfigError: It is no text.
        """
        node = self._node.pop(key, default)
        if not isinstance(node, str):
            raise self.place.key(key).error(node, "text")
        return node

    def take_transform(self, key: str, *, translation: str = "") -> object:
        """The four rows of a transform in any of the forms of `to_matrix_rows`; None if the key is missing.

        Args:
            key: Key of the transform, or of its rotation.
            translation: Key of the translation, if the transform is in two parts.
        """
        if key not in self._node:
            return None
        if not translation:
            return to_matrix_rows(self._node.pop(key))
        R, p = self.take_list(key), self.take_list(translation)
        if len(R) != 9 or len(p) != 3:
            raise self.place.key(key).error(R, f"9 numbers, and 3 of {translation}")
        return [[*R[0:3], p[0]], [*R[3:6], p[1]], [*R[6:9], p[2]], [0.0, 0.0, 0.0, 1.0]]

    def take_keys(self, key: str) -> Keys:
        """The mapping of a key, whose unused keys count as unused here.

        Raises:
            ConfigError: It is no mapping, or missing.
        """
        node = self._node.pop(key, Missing())
        if not isinstance(node, dict):
            raise self.place.key(key).error(node, "keys with values")
        return self._enter(node, self.place.key(key))

    def take_items(self, key: str) -> list[Keys]:
        """The mappings in the list of a key, whose unused keys count as unused here.

        Raises:
            ConfigError: It is no list of mappings, or missing.
        """
        node, place = self._node.pop(key, Missing()), self.place.key(key)
        if not isinstance(node, list) or not all(isinstance(item, dict) for item in node):
            raise place.error(node, "a list of keys with values")
        return [self._enter(item, place.item(i)) for i, item in enumerate(node)]

    def drop(self, *keys: str) -> None:
        """Counts keys as used that no calibration depends on."""
        for key in keys:
            self._node.pop(key, None)

    def _enter(self, node: dict[str, object], place: FieldLocation) -> Keys:
        """The keys of a mapping inside this one."""
        keys = Keys(node, place)
        self._inside.append(keys)
        return keys

    def _to_number(self, key: str, node: object) -> float:
        """A value as a float.

        Raises:
            ConfigError: It is no finite number.
        """
        if isinstance(node, bool) or not isinstance(node, (int, float)) or not abs(node) < 1e300:
            raise self.place.key(key).error(node, "a number")
        number = float(node)
        if not math.isfinite(number):
            raise self.place.key(key).error(node, "a number")
        return number


def has_no_effect(node: object) -> bool:
    """Whether a value of a calibration says nothing: empty, zeros, or an identity."""
    if node in (None, "", [], {}) or (isinstance(node, (int, float)) and node == 0):
        return True
    if isinstance(node, dict):
        return all(has_no_effect(item) for item in node.values())
    if not isinstance(node, list):
        return False
    matrix = _to_matrix(node)
    if matrix is None:
        return False
    is_identity = (
        matrix.ndim == 2 and matrix.shape[0] == matrix.shape[1] and np.array_equal(matrix, np.eye(len(matrix)))
    )
    return bool(is_identity or not np.any(matrix))


def _to_matrix(node: list[object]) -> Array | None:
    """The array of nested lists of numbers; None for anything else."""
    try:
        return np.array(node, float)
    except (ValueError, TypeError, OverflowError):
        return None
