"""Stamps in the cells of tables: numbers, and dates or times of day as text."""

from __future__ import annotations

import datetime
import re

import numpy as np

from stridetwin.streams.samples import Array

_DAY_S = 86400.0
_CLOCK = re.compile(
    r"(\d{1,2}):(\d{2}):(\d{2})(?:[.:,](\d+))?\s*([AP]M)?\s*(?:Z|UTC|[+-]\d{2}:?\d{2})?\s*$", re.IGNORECASE
)
_DATE = re.compile(r"\s*(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})[T\s_]")


def parse_stamp(cell: str) -> float:
    """Seconds in a text: since 1970 of a date `2024-01-31 ...` with its time, since midnight of a time alone.

    Dates in another order count as none, so that the stamps begin again at midnight (`unwrap_days`).

    Raises:
        ValueError: The text is no time.
    """
    clock = _CLOCK.search(cell)
    if clock is None:
        raise ValueError(cell)
    hour, minute, second = (int(clock[k]) for k in (1, 2, 3))
    if clock[5]:
        hour = hour % 12 + (12 if clock[5].upper() == "PM" else 0)
    seconds = 3600.0 * hour + 60.0 * minute + second + (float(f"0.{clock[4]}") if clock[4] else 0.0)
    if (date := _DATE.match(cell)) is not None:
        day = datetime.date(int(date[1]), int(date[2]), int(date[3]))
        seconds += _DAY_S * (day.toordinal() - datetime.date(1970, 1, 1).toordinal())
    return seconds


def is_stamp(cell: str) -> bool:
    """Whether a cell is a number, a date with its time, or a time of day."""
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return _CLOCK.search(cell) is not None
    return True


def unwrap_days(t: Array) -> Array:
    """Times of day (N,) s with a day added after each midnight."""
    midnights = np.cumsum(np.concatenate(([False], np.diff(t) < -_DAY_S / 2)))
    return np.asarray(t + _DAY_S * midnights)
