"""Units in the headers of tables, such as `g`, `deg/s` or `ms`, as factors to SI."""

from __future__ import annotations

import math
from collections.abc import Mapping

from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2

TIME, ACCEL, GYRO = "time", "accel", "gyro"
UNITS: Mapping[str, Mapping[str, float]] = {
    TIME: {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "ns": 1e-9},
    ACCEL: {"m/s²": 1.0, "g": STANDARD_GRAVITY_MPS2, "mg": STANDARD_GRAVITY_MPS2 * 1e-3},
    GYRO: {"rad/s": 1.0, "deg/s": math.pi / 180, "mdeg/s": math.pi / 180e3},
}
"""Factor to s, m/s² and rad/s of each unit, by quantity."""
_SPELLINGS = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "millisecond": "ms", "milliseconds": "ms",
    "us": "µs", "usec": "µs", "microseconds": "µs", "nanoseconds": "ns", "nsec": "ns",
    "m/s^2": "m/s²", "m/s2": "m/s²", "m/s/s": "m/s²", "ms^-2": "m/s²", "ms⁻²": "m/s²", "ms-2": "m/s²", "m.s-2": "m/s²",
    "ms^-²": "m/s²", "m/sec^2": "m/s²", "m*s^-2": "m/s²", "milli-g": "mg", "gees": "g",
    "rad/sec": "rad/s", "rads^-1": "rad/s", "rads-1": "rad/s", "rps": "rad/s",
    "°/s": "deg/s", "º/s": "deg/s", "degree/s": "deg/s", "degrees/s": "deg/s", "deg/sec": "deg/s", "dps": "deg/s",
    "degrees/second": "deg/s", "mdps": "mdeg/s",
}  # fmt: skip


def unit_of(text: str) -> tuple[str, str] | None:
    """Quantity and usual spelling of a unit, such as (`accel`, `m/s²`) for `m/s^2`; None for an unknown one.

    Args:
        text: As in a header, of any case but for `G`, which is also gauss.
    """
    word = text.strip().replace("μ", "µ").replace(" ", "").replace("**", "^")
    if word == "G":
        return None
    word = _SPELLINGS.get(word.lower(), word.lower())
    return next(((quantity, word) for quantity, units in UNITS.items() if word in units), None)


def factor_of(quantity: str, unit: str) -> float:
    """Factor to SI of a unit in its usual spelling."""
    return UNITS[quantity][unit]
