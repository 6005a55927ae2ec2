"""Distributions of values over walks; each maps a number of [0, 1) to a value (inverse transform sampling).

Drawn numbers are rounded to six digits: scenario files stay readable, and the last bit of a quantile function, which
may differ between machines, changes no walk.
"""

from __future__ import annotations

import bisect
import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, Discriminator, Field, StrictInt, Tag, WithJsonSchema, model_validator

from stridetwin.streams.fields import TAG, FileModel, Number, field_error

_MAX_SIZE = 1e9  # largest size of a number
_TAIL_SD = 6.0  # a truncated normal density must have a limit within so many standard deviations
_Number = Annotated[Number, Field(ge=-_MAX_SIZE, le=_MAX_SIZE)]
_Above0 = Annotated[Number, Field(ge=1e-9, le=_MAX_SIZE)]
_Whole = Annotated[StrictInt, Field(ge=-int(_MAX_SIZE), le=int(_MAX_SIZE))]


def _check_order(span: tuple[float, float]) -> tuple[float, float]:
    """Returns two numbers if the first is lower; refuses others."""
    if not span[0] < span[1]:
        raise field_error(list(span), "two numbers, the lower first")
    return span


class Distribution(FileModel, ABC):
    """A distribution of a value; its fields are the keys of a file."""

    @abstractmethod
    def at(self, u: float) -> object:
        """The value whose cumulative probability is `u`, 0 <= u < 1 (inverse transform sampling)."""

    @property
    def ends(self) -> tuple[object, ...]:
        """Lowest and highest value, or all values where they have no order: those of its own key, the first one."""
        first_key = next(iter(type(self).model_fields))  # the key that names the distribution, such as `uniform`
        ends: tuple[object, ...] = getattr(self, first_key)
        return ends

    @property
    @abstractmethod
    def description(self) -> str:
        """The distribution as text for the manifest, such as `uniform 1 to 2`."""


class Fixed(Distribution):
    """One value for every walk.

    Attributes:
        fixed: The value, which may have keys.
    """

    fixed: object

    def at(self, u: float) -> object:
        """The fixed value, whatever the quantile."""
        return self.fixed

    @property
    def ends(self) -> tuple[object, ...]:
        """The fixed value alone."""
        return (self.fixed,)

    @property
    def description(self) -> str:
        """The value as text, such as `2.4`."""
        return str(self.fixed)


class Uniform(Distribution):
    """A number between two others, each equally likely.

    Attributes:
        uniform: Lowest and highest.
        step: Only the lowest plus multiples of this step.
    """

    uniform: Annotated[tuple[_Number, _Number], AfterValidator(_check_order)]
    step: _Above0 | None = None

    def at(self, u: float) -> float:
        """The number at a quantile: low + u (high - low), or one of equally likely steps."""
        low, high = self.uniform
        if self.step is None:
            return _round_and_clamp(low + u * (high - low), self.uniform)
        # number of steps that fit, with a tolerance for rounding; steps + 1 values are equally likely
        steps = math.floor((high - low) / self.step + 1e-9)
        return _round_and_clamp(low + math.floor(u * (steps + 1)) * self.step, self.uniform)

    @property
    def description(self) -> str:
        """The range as text, such as `uniform 1 to 2`."""
        return f"uniform {_span_text(self.uniform)}" + (f" in steps of {self.step:g}" if self.step else "")


class LogUniform(Distribution):
    """A number between two others above 0, whose logarithm is uniformly distributed.

    Attributes:
        log_uniform: Lowest and highest.
    """

    log_uniform: Annotated[tuple[_Above0, _Above0], AfterValidator(_check_order)]

    def at(self, u: float) -> float:
        """The number at a quantile: low (high / low)^u."""
        low, high = self.log_uniform
        return _round_and_clamp(low * (high / low) ** u, self.log_uniform)

    @property
    def description(self) -> str:
        """The range as text, such as `log-uniform 1 to 2`."""
        return f"log-uniform {_span_text(self.log_uniform)}"


class Normal(Distribution):
    """A truncated normal distribution.

    Attributes:
        normal: Mean and standard deviation, before truncation.
        within: Lowest and highest value.
    """

    normal: tuple[_Number, _Number]
    within: Annotated[tuple[_Number, _Number], AfterValidator(_check_order)]

    @model_validator(mode="after")
    def _check(self) -> Normal:
        """Refuses a standard deviation of 0 or less, and limits that hardly any number lies between."""
        (mean, sd), (low, high) = self.normal, self.within
        if sd <= 0:
            raise field_error([mean, sd], "mean and standard deviation, above 0", "normal")
        if high < mean - _TAIL_SD * sd or low > mean + _TAIL_SD * sd:
            raise field_error([low, high], f"limits no farther than {_TAIL_SD:g} SD from the mean", "within")
        return self

    def at(self, u: float) -> float:
        """The number at a quantile of the truncated distribution: mean + sd Φ⁻¹(Φ(low) + u (Φ(high) - Φ(low)))."""
        from scipy.special import ndtr, ndtri  # takes long to import, and only a draw needs it

        (mean, sd), (low, high) = self.normal, self.within
        # probabilities below the two limits, between which `u` is mapped
        first, last = ndtr((low - mean) / sd), ndtr((high - mean) / sd)
        return _round_and_clamp(mean + sd * float(ndtri(first + u * (last - first))), self.within)

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest value of the truncated distribution."""
        return self.within

    @property
    def description(self) -> str:
        """The distribution as text, such as `normal 1 ± 0.1 within 0.8 to 1.2`."""
        return f"normal {self.normal[0]:g} ± {self.normal[1]:g} within {_span_text(self.within)}"


class Integer(Distribution):
    """A whole number between two others, both included, each equally likely.

    Attributes:
        integer: Lowest and highest.
    """

    integer: Annotated[tuple[_Whole, _Whole], AfterValidator(_check_order)]

    def at(self, u: float) -> int:
        """The whole number at a quantile; each from low to high is equally likely."""
        low, high = self.integer
        steps = min(int(u * (high - low + 1)), high - low)  # rounding up to u = 1 must not pass the end
        return low + steps

    @property
    def description(self) -> str:
        """The range as text, such as `whole number 1 to 4`."""
        return f"whole number {self.integer[0]} to {self.integer[1]}"


class Choice(Distribution):
    """One of several values.

    Attributes:
        choice: The values, of any type that a scenario file may hold.
        weights: Relative probability of each; equal by default.
    """

    choice: Annotated[tuple[object, ...], Field(min_length=1)]
    weights: Annotated[tuple[_Above0, ...], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Choice:
        """Refuses weights that are more or fewer than the values."""
        if self.weights is not None and len(self.weights) != len(self.choice):
            raise field_error(list(self.weights), f"{len(self.choice)} numbers, one for each value", "weights")
        return self

    def at(self, u: float) -> object:
        """The value at a quantile, with probabilities proportional to the weights."""
        return self.choice[index_at_quantile(self._weights, u)]

    @property
    def _weights(self) -> tuple[float, ...]:
        """The weight of each value; without weights all are equal."""
        return self.weights or (1.0,) * len(self.choice)

    @property
    def description(self) -> str:
        """The values with their weights as text, such as `one of male (1), female (2)`."""
        return "one of " + ", ".join(f"{value} ({weight:g})" for value, weight in zip(self.choice, self._weights))


def index_at_quantile(weights: Sequence[float], u: float) -> int:
    """Index of the item at a quantile `u` (0-1), where each item has a probability proportional to its weight."""
    sums = list(itertools.accumulate(weights))
    # the first item whose sum of weights exceeds u times the whole sum
    return min(bisect.bisect_right(sums, u * sums[-1]), len(sums) - 1)


def _round_and_clamp(value: float, bounds: tuple[float, float]) -> float:
    """The number rounded to six digits and limited to the range."""
    return float(min(max(float(f"{value:.6g}"), bounds[0]), bounds[1]))


def _span_text(ends: tuple[float, float]) -> str:
    """A range as text."""
    return f"{ends[0]:g} to {ends[1]:g}"


_KEYS = ("uniform", "log_uniform", "normal", "integer", "choice", "fixed")


def _distribution_tag(node: object) -> str | None:
    """The tag by which pydantic chooses the type of a value in a file.

    It is that of a distribution if a mapping has the key of one, such as `uniform`, and `=value` for anything but a
    mapping, which is the same in every walk. Any other mapping has none, which is an error of the file.
    """
    if not isinstance(node, dict):
        return "=value"
    return next((TAG + key for key in node if key in _KEYS), None)


_SameValue = Annotated[
    Any,
    WithJsonSchema({"type": ["string", "number", "boolean", "array", "null"]}),
    AfterValidator(lambda value: Fixed(fixed=value)),
]
DistributionInFile = Annotated[
    Annotated[Uniform, Tag("=uniform")]
    | Annotated[LogUniform, Tag("=log_uniform")]
    | Annotated[Normal, Tag("=normal")]
    | Annotated[Integer, Tag("=integer")]
    | Annotated[Choice, Tag("=choice")]
    | Annotated[Fixed, Tag("=fixed")]
    | Annotated[_SameValue, Tag("=value")],
    Discriminator(_distribution_tag),
]
"""Type of a value of a file that may vary from walk to walk; it becomes a `Distribution`."""
