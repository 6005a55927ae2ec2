"""Estimates as flat lists of named values, so that estimates of any type are compared and searched alike."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.estimators.locomotion_mode import ModeEstimate, NextChange, StepPrediction
from stridetwin.estimators.terrain_map import Stairs

_MAY_BE_UNKNOWN: dict[type, frozenset[str]] = {
    StepEstimate: frozenset({"covariance"}),
    Stairs: frozenset({"tread", "covariance", "edges"}),
    StepPrediction: frozenset({"p_foot_in_world", "covariance", "slope", "slope_sd"}),
    NextChange: frozenset({"riser", "riser_sd", "tread", "tread_sd", "slope", "slope_sd"}),
    ModeEstimate: frozenset({"step_length_sd"}),
}
"""Fields that are NaN or infinite where the value is unknown, as the docstrings of these types say."""
_STANDARD_DEVIATION = re.compile(r"(?:^|_)(?:sd|std)(?:_|$)")
_DEEPEST = 12  # nesting of objects beyond which only their types are compared


@dataclass(frozen=True, slots=True, eq=False)
class Leaf:
    """One value of an estimate.

    Attributes:
        path: Place of the value, such as `pose.covariance` or `steps[0].t_sd_s`.
        name: Name of the field.
        owner: Type of the object that has the field.
        value: A copy of the value: an array, a number, a text or None. Whole numbers and truth values are arrays
            without dimensions.
    """

    path: str
    name: str
    owner: type
    value: NDArray[np.generic] | float | str | None

    @property
    def is_standard_deviation(self) -> bool:
        """Whether the field's name has the part `sd` or `std`."""
        return _STANDARD_DEVIATION.search(self.name) is not None

    @property
    def is_covariance(self) -> bool:
        """Whether the field's name ends in `covariance` and it holds a square matrix."""
        if not self.name.endswith("covariance") or not isinstance(self.value, np.ndarray):
            return False
        return self.value.ndim == 2 and self.value.shape[0] == self.value.shape[1]

    @property
    def may_be_unknown(self) -> bool:
        """Whether NaN or infinity is a valid value of the field, and means that it is unknown."""
        return any(issubclass(self.owner, owner) and self.name in names for owner, names in _MAY_BE_UNKNOWN.items())

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite; a standard deviation may also be +inf, and unknown fields are left out."""
        if self.value is None or isinstance(self.value, str):
            return True
        if isinstance(self.value, float):
            if math.isfinite(self.value):
                return True
        elif self.value.dtype.kind not in "fc" or np.isfinite(self.value).all():  # f and c: floats, complex numbers
            return True
        # some number is not finite: only +inf as a standard deviation, or a value that may be unknown, is in order
        if self.is_standard_deviation:
            return self.may_be_unknown or bool(np.all(np.isfinite(self.value) | (np.asarray(self.value) == np.inf)))
        return self.may_be_unknown

    def equals(self, other: Leaf) -> bool:
        """Whether path and value are equal, bit by bit."""
        if self.path != other.path or type(self.value) is not type(other.value):
            return False
        if isinstance(self.value, np.ndarray) and isinstance(other.value, np.ndarray):
            same_form = self.value.shape == other.value.shape and self.value.dtype == other.value.dtype
            return same_form and self.value.tobytes() == other.value.tobytes()
        if isinstance(self.value, float) and isinstance(other.value, float):  # as bytes, so that NaN equals NaN
            return np.float64(self.value).tobytes() == np.float64(other.value).tobytes()
        return self.value == other.value


def flatten(estimate: object) -> list[Leaf]:
    """All values of an estimate: of dataclasses, mappings, sequences, and public attributes of other objects."""
    return list(_leaves(estimate, "", "", type(estimate), 0))


def field_of(leaf: Leaf) -> str:
    """The leaf's path without indices and keys: `steps.t_sd_s` for `steps[0].t_sd_s`."""
    return re.sub(r"\[[^\]]*\]", "", leaf.path)


def difference(leaves: Sequence[Leaf], expected: Sequence[Leaf]) -> str:
    """The first difference between two flattened estimates, in words; "" if they are equal bit by bit."""
    for leaf, other in zip(leaves, expected):
        if leaf.path != other.path:
            return f"it has {leaf.path or 'a value'} in place of {other.path or 'a value'}"
        if not leaf.equals(other):
            return f"{leaf.path or 'its value'} is {_show(leaf.value)} instead of {_show(other.value)}"
    if len(leaves) != len(expected):
        return f"it has {len(leaves)} values instead of {len(expected)}"
    return ""


def _leaves(value: object, path: str, name: str, owner: type, depth: int) -> Iterator[Leaf]:
    """The values in an object, in order of their paths.

    Args:
        value: The object.
        path: Place of the object in the estimate.
        name: Name of the field that holds it.
        owner: Type of the object that has this field.
        depth: How many objects deep it is; from `_DEEPEST` on only its type is taken.
    """
    if value is None or isinstance(value, str | bytes):
        yield Leaf(path, name, owner, value if not isinstance(value, bytes) else value.hex())
    elif isinstance(value, np.ndarray) and value.dtype != object:
        yield Leaf(path, name, owner, value.copy())
    elif isinstance(value, bool | np.bool_ | int | np.integer):
        yield Leaf(path, name, owner, np.asarray(value))
    elif isinstance(value, float | np.floating):
        yield Leaf(path, name, owner, float(value))
    elif depth >= _DEEPEST:  # also ends a cycle of references
        yield Leaf(path, name, owner, type(value).__name__)
    elif is_dataclass(value) and not isinstance(value, type):
        for attribute in _fields_of(type(value)):
            yield from _leaves(getattr(value, attribute), _join(path, attribute), attribute, type(value), depth + 1)
    elif isinstance(value, Mapping):
        if name.endswith("probabilities"):  # also as one array, whose sum can be checked
            yield Leaf(path, name, owner, np.array(list(value.values()), float))
        for key, item in value.items():
            yield from _leaves(item, f"{path}[{key}]", name, owner, depth + 1)
    elif isinstance(value, Sequence | np.ndarray):
        for i, item in enumerate(value):
            yield from _leaves(item, f"{path}[{i}]", name, owner, depth + 1)
    elif hasattr(value, "__dict__") and not callable(value):
        for attribute, item in vars(value).items():
            if not attribute.startswith("_"):
                yield from _leaves(item, _join(path, attribute), attribute, type(value), depth + 1)
    else:
        yield Leaf(path, name, owner, type(value).__name__)


@cache
def _fields_of(kind: type) -> tuple[str, ...]:
    """Names of the fields of a dataclass."""
    return tuple(field.name for field in fields(kind))


def _join(path: str, attribute: str) -> str:
    """The path of an attribute."""
    return f"{path}.{attribute}" if path else attribute


def _show(value: object) -> str:
    """A value in at most 120 characters."""
    text = np.array2string(value, precision=9, threshold=8) if isinstance(value, np.ndarray) else repr(value)
    return " ".join(text.split())[:120]
