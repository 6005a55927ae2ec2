"""Usual mistakes in the angular rates of a recording, and what corrects each."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from stridetwin.streams.samples import Array

_DEGREE = math.pi / 180  # rad
_SHIFTS_S = (-0.5, -0.2, -0.1, -0.05, 0.05, 0.1, 0.2, 0.5)
"""Shifts of the rates against the forces that are tried, s."""
IN_DEGREES = "the rates are in °/s"
"""The most usual mistake."""
_SCALES = (
    (IN_DEGREES, _DEGREE),
    ("the rates are in rad/s, and were taken for °/s", 1 / _DEGREE),
    ("the rates are 1000 times too large", 1e-3),
    ("the rates are 1000 times too small", 1e3),
    ("the rates are twice too large", 0.5),
    ("the rates are twice too small", 2.0),
)
"""Wrong units and ranges, and the factor that corrects each."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Correction:
    """A usual mistake, and what corrects it.

    Attributes:
        cause: The mistake.
        matrix: (3, 3), multiplies the rates.
        shift_s: Time by which the rates are moved to later, s.
    """

    cause: str
    matrix: Array
    shift_s: float = 0.0


def list_corrections() -> list[Correction]:
    """Wrong units and factors, swapped and mirrored axes, and clocks of their own, in the order of likelihood."""
    return list_products() + [correct_shift(shift) for shift in _SHIFTS_S]


def list_products() -> list[Correction]:
    """Wrong units and factors, and swapped and mirrored axes, in the order of likelihood: products with a matrix."""
    result = list_units()
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            axes = ", ".join(f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in zip(order, signs))
            if axes != "x, y, z":
                # rows: axes of the forces; each entry picks an axis of the rates
                matrix = np.diag(signs) @ np.eye(3)[list(order)]
                result.append(
                    Correction(cause=f"the axes x, y, z of the forces are {axes} of the rates", matrix=matrix)
                )
    return result


def list_units() -> list[Correction]:
    """Wrong units and ranges of the rates, in the order of likelihood."""
    return [Correction(cause=cause, matrix=factor * np.eye(3)) for cause, factor in _SCALES]


def correct_shift(shift_s: float) -> Correction:
    """The correction of rates that fit the forces once they are moved to later by a time, s."""
    when = "later" if shift_s > 0 else "earlier"
    cause = f"the rates belong {1000 * abs(shift_s):.0f} ms {when} than they are stamped"
    return Correction(cause=cause, matrix=np.eye(3), shift_s=shift_s)


def correct_scale(factor: float) -> Correction:
    """The correction of rates that fit the forces once they are multiplied by a factor, or the time."""
    size, span = ("large", "long") if factor < 1 else ("small", "short")
    times = f"{max(factor, 1 / factor):.2g}"
    cause = f"the rates are {times} times too {size}, or the time between samples is {times} times too {span}"
    return Correction(cause=cause, matrix=factor * np.eye(3))


def shift_rates(t: Array, rates: Array, shift_s: float) -> Array:
    """Rates (N, 3) at times (N,) s, moved to later by a shift; those before the first are the first one."""
    return np.column_stack([np.interp(t - shift_s, t, rates[:, axis]) for axis in range(3)])
