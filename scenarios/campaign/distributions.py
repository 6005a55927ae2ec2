"""Distributions of values over walks; each maps a number of [0, 1) to a value (inverse transform sampling).

Drawn numbers are rounded to six digits: scenario files stay readable, and the last bit of a quantile function, which
may differ between machines, changes no walk.
"""

from __future__ import annotations

import bisect
import itertools
import math
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema
from scipy.special import ndtr, ndtri

from stridetwin.streams.fields import TAG, number, refused, whole

_MOST = 1e9
_TAIL_SD = 6.0


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


class _Keys(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


_Number = Annotated[float, number(-_MOST, _MOST)]
_Above0 = Annotated[float, number(1e-9, _MOST)]
_Whole = Annotated[int, whole(-int(_MOST), int(_MOST))]


def _ordered(span: tuple[float, float]) -> tuple[float, float]:
    if not span[0] < span[1]:
        raise refused(list(span), "two numbers, the lower first")
    return span


class _Uniform(_Keys):
    """Between two numbers, every one as likely.

    Attributes:
        uniform: Lowest and highest.
        step: Only the lowest and its multiples above it.
    """

    uniform: Annotated[tuple[_Number, _Number], AfterValidator(_ordered)]
    step: _Above0 | None = None

    def build(self) -> Uniform:
        """The distribution."""
        return Uniform(low=self.uniform[0], high=self.uniform[1], step=self.step)


class _LogUniform(_Keys):
    """Between two numbers above 0, every ratio as likely.

    Attributes:
        log_uniform: Lowest and highest.
    """

    log_uniform: Annotated[tuple[_Above0, _Above0], AfterValidator(_ordered)]

    def build(self) -> LogUniform:
        """The distribution."""
        return LogUniform(low=self.log_uniform[0], high=self.log_uniform[1])


class _Normal(_Keys):
    """A normal distribution between limits.

    Attributes:
        normal: Mean and standard deviation.
        within: Lowest and highest value.
    """

    normal: tuple[_Number, _Number]
    within: Annotated[tuple[_Number, _Number], AfterValidator(_ordered)]

    def build(self) -> Normal:
        """The distribution."""
        (mean, sd), (low, high) = self.normal, self.within
        if sd <= 0:
            raise refused([mean, sd], "mean and standard deviation, above 0", "normal")
        if high < mean - _TAIL_SD * sd or low > mean + _TAIL_SD * sd:
            raise refused([low, high], f"limits no farther than {_TAIL_SD:g} SD from the mean", "within")
        return Normal(mean=mean, sd=sd, low=low, high=high)


class _Integer(_Keys):
    """A whole number between two, every one as likely.

    Attributes:
        integer: Lowest and highest.
    """

    integer: Annotated[tuple[_Whole, _Whole], AfterValidator(_ordered)]

    def build(self) -> Integer:
        """The distribution."""
        return Integer(low=self.integer[0], high=self.integer[1])


class _Choice(_Keys):
    """One of some values.

    Attributes:
        choice: The values; anything that a scenario file may say.
        weights: How likely each is, against the others.
    """

    choice: Annotated[tuple[Any, ...], Field(min_length=1)]
    weights: Annotated[tuple[_Above0, ...], Field(min_length=1)] | None = None

    def build(self) -> Choice:
        """The distribution."""
        weights = self.weights or (1.0,) * len(self.choice)
        if len(weights) != len(self.choice):
            raise refused(list(weights), f"{len(self.choice)} numbers, one for each value", "weights")
        return Choice(values=self.choice, weights=weights)


class _Fixed(_Keys):
    """One value for every walk.

    Attributes:
        fixed: The value, which may have keys.
    """

    fixed: Any

    def build(self) -> Fixed:
        """The distribution."""
        return Fixed(value=self.fixed)


_KINDS: dict[str, Any] = {
    "uniform": _Uniform, "log_uniform": _LogUniform, "normal": _Normal, "integer": _Integer, "choice": _Choice,
    "fixed": _Fixed,
}  # fmt: skip


class _OneValue:
    """Annotation: a value without keys, which is the same in every walk."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Anything; in the JSON Schema anything but a mapping."""
        return core_schema.no_info_after_validator_function(lambda v: Fixed(value=v), core_schema.any_schema())

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Text, a number, true or false, or a list."""
        return {"type": ["string", "number", "boolean", "array", "null"]}


class _Distributed:
    """Annotation: a distribution by its key, or a value that is the same in every walk."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """A union that is tagged by the key of the distribution."""
        kinds = {
            TAG + key: handler.generate_schema(Annotated[kind, AfterValidator(kind.build)])
            for key, kind in _KINDS.items()
        }
        value = handler.generate_schema(Annotated[Any, _OneValue()])
        return core_schema.tagged_union_schema({**kinds, _VALUE: value}, discriminator=_tag)


_VALUE = f"{TAG}value"


def _tag(node: Any) -> str | None:
    if not isinstance(node, dict):
        return _VALUE
    return next((TAG + key for key in node if key in _KINDS), None)


DistributionInFile = Annotated[Any, _Distributed()]
"""Type of a value of a file that may vary from walk to walk; it becomes a `Distribution`."""
