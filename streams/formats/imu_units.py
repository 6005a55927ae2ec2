"""Units of time, specific force and angular rate in any usual spelling, and their factors to s, m/s² and rad/s."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Mapping

from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2

TIME, ACCEL, GYRO = "time", "accel", "gyro"
UNITS: Mapping[str, Mapping[str, float]] = {
    TIME: {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "ns": 1e-9, "0.1ms": 1e-4},
    ACCEL: {
        "m/s²": 1.0,
        "g": STANDARD_GRAVITY_MPS2,
        "mg": STANDARD_GRAVITY_MPS2 * 1e-3,
        "cm/s²": 1e-2,
        "mm/s²": 1e-3,
    },
    GYRO: {
        "rad/s": 1.0,
        "deg/s": math.pi / 180,
        "mdeg/s": math.pi / 180e3,
        "mrad/s": 1e-3,
        "rpm": math.pi / 30,
        "rev/s": 2 * math.pi,
    },
}
"""Factor to s, m/s² and rad/s of each unit, by quantity."""
_LONGEST = 24
"""Most characters of a unit."""
_CHANGES = (
    (re.compile(r"[\s()\[\]{}\"']"), ""),
    (re.compile(r"μ"), "µ"),  # the Greek letter becomes the micro sign
    (re.compile(r"\*\*"), "^"),
    (re.compile(r"â(?=[°µ²])|^[?\ufffd](?=/s)"), ""),  # signs that were saved in another encoding
    (re.compile(r"^/s"), "deg/s"),
    (re.compile(r"milli-?"), "m"),
    (re.compile(r"micro-?"), "µ"),
    (re.compile(r"nano-?"), "n"),
    (re.compile(r"met(?:er|re)s?"), "m"),
    (re.compile(r"seconds?|secs?"), "s"),
    (re.compile(r"deg(?:ree)?s?(?![a-z])|°|º|˚"), "deg"),
    (re.compile(r"radians?"), "rad"),
    (re.compile(r"per"), "/"),
    (re.compile(r"^us$"), "µs"),
    (re.compile(r"^(m?)dps$"), r"\1deg/s"),
    (re.compile(r"^(m?)degps$"), r"\1deg/s"),
    (re.compile(r"^(?:rps|radps)$"), "rad/s"),
    (re.compile(r"^(m?)gees$|^(m?)gs$"), r"\1\2g"),
    (re.compile(r"^([mc]?m)(?:/s(?:\^?[2²]|/s)|ps\^?[2²]|pss|[*.·⋅]?s\^?[-⁻−]\^?[2²]|s[2²])$"), r"\1/s²"),
    (re.compile(r"^(m?(?:deg|rad)|rev)[*.·⋅]?s\^?[-⁻−]\^?[1¹]$"), r"\1/s"),
)
"""Changes that make the usual spelling of other ones in lower case, in this order."""


@functools.lru_cache(maxsize=4096)
def unit_of(text: str) -> tuple[str, str] | None:
    """Quantity and usual spelling of a unit, such as (`accel`, `m/s²`) for `m/s^2`; None for an unknown one.

    Args:
        text: As in a header, of any case but for `G`, which is also gauss.
    """
    if text.strip() == "G" or len(text) > _LONGEST:
        return None
    unit = text.lower()
    for pattern, usual in _CHANGES:
        unit = pattern.sub(usual, unit)
    return next(((quantity, unit) for quantity, units in UNITS.items() if unit in units), None)


def is_unit_like(text: str) -> bool:
    """Whether a cell below the names of columns may be a unit: one of ours or of another quantity, or none."""
    return unit_of(text) is not None or bool(_OTHER_UNITS.fullmatch(text.strip()))


_OTHER_UNITS = re.compile(
    r"[\[(]?(?:-|n/?a|none|no[ _]units?|units?|1|#|counts?|g|[µu]?t|[mn]t|gauss|mgauss|local[ _]?flux|h?k?pa|m?bar|hz|%"
    r"|m?v|v|°|deg|degrees|rad|°?c|deg ?c|celsius|k|n\.?u\.?|int|bool|string|text|date|datetime|yyyy.*|hh.*)?[\])]?",
    re.IGNORECASE,
)
