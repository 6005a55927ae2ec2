"""Units of time, specific force and angular rate in any usual spelling, and their factors to s, m/s² and rad/s."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Mapping

from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2

TIME, ACCEL, GYRO = "time", "accel", "gyro"
"""Quantities of the columns of a table: time, specific force and angular rate."""
UNITS: Mapping[str, Mapping[str, float]] = {
    TIME: {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "ns": 1e-9, "0.1ms": 1e-4, "min": 60.0, "h": 3600.0, "d": 86400.0},
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
_LONGEST = 40
"""Most characters of a unit."""
_CHANGES = (
    (re.compile(r"[\s()\[\]{}\"']"), ""),
    (re.compile(r"μ"), "µ"),  # the Greek letter becomes the micro sign
    (re.compile(r"град"), "deg"),
    (re.compile(r"рад"), "rad"),
    (re.compile(r"[cс]ек|с(?![а-я])"), "s"),  # Cyrillic letters
    (re.compile(r"м(?![а-я])"), "m"),
    (re.compile(r"\*\*"), "^"),
    (re.compile(r"squared"), "^2"),
    (re.compile(r"â(?=[°µ²])|^[?\ufffd¡ø](?=/s)"), ""),  # signs that were saved in another encoding
    (re.compile(r"(?<=/s)ý$"), "²"),
    (re.compile(r"^/s"), "deg/s"),
    (re.compile(r"milli-?"), "m"),
    (re.compile(r"micro-?"), "µ"),
    (re.compile(r"nano-?"), "n"),
    (re.compile(r"met(?:er|re)s?"), "m"),
    (re.compile(r"seconds?|secs?|sek"), "s"),
    (re.compile(r"^min(?:ute)?s?$"), "min"),
    (re.compile(r"^(?:hours?|hrs?)$"), "h"),
    (re.compile(r"^days?$"), "d"),
    (re.compile(r"deg(?:ree)?s?(?![a-z])|°|º|˚"), "deg"),
    (re.compile(r"radians?"), "rad"),
    (re.compile(r"per"), "/"),
    (re.compile(r"^us$"), "µs"),
    (re.compile(r"^(?:d|grad)/s$"), "deg/s"),
    (re.compile(r"^(m?)dps$"), r"\1deg/s"),
    (re.compile(r"^(m?)degps$"), r"\1deg/s"),
    (re.compile(r"^(?:rps|radps)$"), "rad/s"),
    # gees, mgees, Gs
    (re.compile(r"^(m?)gees$|^(m?)gs$"), r"\1\2g"),
    # m/s/s, m/s2, mps2, mpss, m*s^-2, ms2
    (re.compile(r"^([mc]?m)(?:/s(?:\^?[2²]|/s)|ps\^?[2²]|pss|[*.·⋅]?s\^?[-⁻−]\^?[2²]|s[2²])$"), r"\1/s²"),
    # deg*s^-1, rads^-1
    (re.compile(r"^(m?(?:deg|rad)|rev)[*.·⋅]?s\^?[-⁻−]\^?[1¹]$"), r"\1/s"),
)
"""Changes that make the usual spelling of other ones in lower case, in this order."""


_SCALED = (
    re.compile(r"(?P<unit>.+?)\s*/\s*(?P<divisor>\d+(?:\.\d+)?)"),
    re.compile(r"(?P<unit>.+?)\s*[*·]\s*(?P<factor>\d*\.?\d+(?:e[+-]?\d+)?)"),
    re.compile(r"(?P<factor>\d*\.?\d+(?:e[+-]?\d+)?)(?:\s*/\s*(?P<divisor>\d+(?:\.\d+)?))?\s*[*·]?\s*(?P<unit>\D.*)"),
)
"""Units with a scale, as the data sheets of raw counts give them: `g/16384`, `deg/s/131`, `mg*0.061`, `0.061 mg`."""
COUNTS = re.compile(r"(?:raw|adc|lsb|digits?|counts?|no[ _]?units?|lsb/.*)", re.IGNORECASE)
"""Texts in place of a unit that say that the numbers are raw counts."""


def factor_of(text: str, quantity: str) -> float | None:
    """Factor to m/s² or rad/s of a unit, which may have a scale as `g/16384`; None for an unknown one.

    Args:
        text: As in a mapping of the user; `G` is the unit g of a force.
        quantity: `accel` or `gyro`.
    """
    text = text.lower() if quantity == ACCEL else text
    if unit_of(text) is not None:
        spelling = spell_unit(text, quantity)
        return None if spelling is None else UNITS[quantity][spelling]
    for pattern in _SCALED:
        matched = pattern.fullmatch(text.strip())
        spelling = spell_unit(matched["unit"], quantity) if matched is not None else None
        if matched is None or spelling is None:
            continue
        parts = {name: float(value) for name, value in matched.groupdict().items() if name != "unit" and value}
        if all(parts.values()):
            return UNITS[quantity][spelling] * parts.get("factor", 1.0) / parts.get("divisor", 1.0)
    return None


def spell_unit(text: str, quantity: str) -> str | None:
    """Usual spelling of a unit of a quantity, such as `m/s²` for `m/s^2`; None for an unknown one or another quantity.

    Args:
        text: As in a header; `G` is the unit g of a force.
        quantity: `time`, `accel` or `gyro`.
    """
    known = unit_of(text.lower() if quantity == ACCEL else text)
    return known[1] if known is not None and known[0] == quantity else None


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
"""Units of other quantities, and marks of columns without one, as `[uT]`, `hPa`, `°C`, `-` and `no units`."""
