"""Distributions of values over walks; each maps a number of [0, 1) to a value (inverse transform sampling).

Drawn numbers are rounded to six digits: scenario files stay readable, and the last bit of a quantile function, which
may differ between machines, changes no walk.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from scipy.special import ndtr, ndtri

from stridetwin.scenarios.fields import Field, Where, integer, mapping, number, pair, sequence

_MOST = 1e9
_TAIL_SD = 6.0
_NUMBER = number(-_MOST, _MOST)
_ABOVE_0 = number(1e-9, _MOST)


class Distribution(Protocol):
    """A distribution of a value."""

    def at(self, u: float) -> Any:
        """The value at a quantile, 0 <= u < 1."""

    @property
    def ends(self) -> tuple[Any, ...]:
        """Lowest and highest value, or all values where they have no order."""

    @property
    def words(self) -> str:
        """Description for the manifest."""


@dataclass(frozen=True, kw_only=True)
class Fixed:
    """One value for every walk; any value of a scenario file."""

    value: Any

    def at(self, u: float) -> Any:
        """The value."""
        return self.value

    @property
    def ends(self) -> tuple[Any, ...]:
        """The value."""
        return (self.value,)

    @property
    def words(self) -> str:
        """Such as `2.4`."""
        return str(self.value)


@dataclass(frozen=True, kw_only=True)
class Uniform:
    """Uniform between two numbers, or over the lower number plus multiples of a step."""

    low: float
    high: float
    step: float | None = None

    def at(self, u: float) -> float:
        """The number at a quantile."""
        if self.step is None:
            return _clamped(self.low + u * (self.high - self.low), self)
        steps = math.floor((self.high - self.low) / self.step + 1e-9)
        return _clamped(self.low + math.floor(u * (steps + 1)) * self.step, self)

    @property
    def ends(self) -> tuple[float, ...]:
        """Lowest and highest."""
        return (self.low, self.high)

    @property
    def words(self) -> str:
        """Such as `uniform 1 to 2`."""
        return f"uniform {self.low:g} to {self.high:g}" + (f" in steps of {self.step:g}" if self.step else "")


@dataclass(frozen=True, kw_only=True)
class LogUniform:
    """Log-uniform between two numbers above 0."""

    low: float
    high: float

    def at(self, u: float) -> float:
        """The number at a quantile."""
        return _clamped(self.low * (self.high / self.low) ** u, self)

    @property
    def ends(self) -> tuple[float, ...]:
        """Lowest and highest."""
        return (self.low, self.high)

    @property
    def words(self) -> str:
        """Such as `log-uniform 1 to 2`."""
        return f"log-uniform {self.low:g} to {self.high:g}"


@dataclass(frozen=True, kw_only=True)
class Normal:
    """Truncated normal distribution; mean and standard deviation are those before truncation."""

    mean: float
    sd: float
    low: float
    high: float

    def at(self, u: float) -> float:
        """The number at a quantile."""
        first, last = ndtr((self.low - self.mean) / self.sd), ndtr((self.high - self.mean) / self.sd)
        return _clamped(self.mean + self.sd * float(ndtri(first + u * (last - first))), self)

    @property
    def ends(self) -> tuple[float, ...]:
        """Lowest and highest."""
        return (self.low, self.high)

    @property
    def words(self) -> str:
        """Such as `normal 1 ± 0.1 within 0.8 to 1.2`."""
        return f"normal {self.mean:g} ± {self.sd:g} within {self.low:g} to {self.high:g}"


@dataclass(frozen=True, kw_only=True)
class Integer:
    """A whole number, uniform between two, both included."""

    low: int
    high: int

    def at(self, u: float) -> int:
        """The number at a quantile."""
        return self.low + min(int(u * (self.high - self.low + 1)), self.high - self.low)

    @property
    def ends(self) -> tuple[int, ...]:
        """Lowest and highest."""
        return (self.low, self.high)

    @property
    def words(self) -> str:
        """Such as `whole number 1 to 4`."""
        return f"whole number {self.low} to {self.high}"


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One of several values of any type, with weights."""

    values: tuple[Any, ...]
    weights: tuple[float, ...]

    def at(self, u: float) -> Any:
        """The value at a quantile."""
        return self.values[self.index(u)]

    def index(self, u: float) -> int:
        """Number of the value at a quantile."""
        sums = list(itertools.accumulate(self.weights))
        return min(bisect.bisect_right(sums, u * sums[-1]), len(sums) - 1)

    @property
    def ends(self) -> tuple[Any, ...]:
        """All values."""
        return self.values

    @property
    def words(self) -> str:
        """Such as `one of male (1), female (2)`."""
        return "one of " + ", ".join(f"{value} ({weight:g})" for value, weight in zip(self.values, self.weights))


def _clamped(value: float, within: Uniform | LogUniform | Normal) -> float:
    """The number rounded to six digits and limited to the range."""
    return float(min(max(float(f"{value:.6g}"), within.low), within.high))


def distribution(node: object, where: Where) -> Distribution:
    """A distribution by its key, or one value for every walk.

    Raises:
        ConfigError: Neither.
    """
    if not isinstance(node, dict):
        return Fixed(value=node)
    kind = next((key for key in node if key in _KINDS), None)
    if kind is None:
        raise where.error(node, f"a value, or one of the keys {', '.join(_KINDS)} (fixed: with keys and values below)")
    found: Distribution = _KINDS[kind](node, where)
    return found


def _span(item: Callable[[object, Where], Any]) -> Callable[[object, Where], Any]:
    """A reader of a range: two numbers, the lower first."""
    read_pair = pair(item)

    def read(node: object, where: Where) -> Any:
        low, high = read_pair(node, where)
        if not low < high:
            raise where.error(node, "two numbers, the lower first")
        return low, high

    return read


def _normal(node: object, where: Where) -> Normal:
    found = _NORMAL(node, where)
    (mean, sd), (low, high) = found["normal"], found["within"]
    if sd <= 0:
        raise where.key("normal").error([mean, sd], "mean and standard deviation, above 0")
    if high < mean - _TAIL_SD * sd or low > mean + _TAIL_SD * sd:
        raise where.key("within").error([low, high], f"limits no farther than {_TAIL_SD:g} SD from the mean")
    return Normal(mean=mean, sd=sd, low=low, high=high)


def _choice(node: object, where: Where) -> Choice:
    found = _CHOICE(node, where)
    values = found["choice"]
    weights = found.get("weights", (1.0,) * len(values))
    if len(weights) != len(values):
        raise where.key("weights").error(list(weights), f"{len(values)} numbers, one for each value")
    return Choice(values=values, weights=weights)


def _anything(node: object, where: Where) -> Any:
    return node


def _key(name: str, read: Callable[[object, Where], Any]) -> Field:
    return Field(attribute=name, read=read, required=True)


_NORMAL = mapping({"normal": _key("normal", pair(_NUMBER)), "within": _key("within", _span(_NUMBER))}, dict)
_CHOICE = mapping(
    {
        "choice": _key("choice", sequence(_anything)),
        "weights": Field(attribute="weights", read=sequence(_ABOVE_0)),
    },
    dict,
)
_WHOLE = integer(-int(_MOST), int(_MOST))
_KINDS: dict[str, Callable[[object, Where], Any]] = {
    "uniform": mapping(
        {"uniform": _key("ends", _span(_NUMBER)), "step": Field(attribute="step", read=_ABOVE_0)},
        lambda ends, step=None: Uniform(low=ends[0], high=ends[1], step=step),
    ),
    "log_uniform": mapping(
        {"log_uniform": _key("ends", _span(_ABOVE_0))}, lambda ends: LogUniform(low=ends[0], high=ends[1])
    ),
    "normal": _normal,
    "integer": mapping({"integer": _key("ends", _span(_WHOLE))}, lambda ends: Integer(low=ends[0], high=ends[1])),
    "choice": _choice,
    "fixed": mapping({"fixed": _key("value", _anything)}, Fixed),
}
