"""Free variables of a placement: a number between bounds, one of several values, or a point on a surface."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stridetwin.scenarios.campaign.field_paths import FieldPath
from stridetwin.scenarios.fields import Field, Where, mapping, number, one_word, pair
from stridetwin.scenarios.placement.surface import SURFACES, on_surface
from stridetwin.sim.config import Person
from stridetwin.streams.errors import StrideTwinError

_DIGITS = 6  # of a number that is chosen: of any unit and size
_MM_DIGITS = 3  # after the point, of a position on a surface
_MOST_STEPS = 1000
_ANY = number(-1e6, 1e6)


@dataclass(frozen=True, kw_only=True)
class Knob:
    """One scalar to choose.

    Attributes:
        name: In tables.
        low, high: Bounds of a number.
        step: Of a number: only low, low + step, ...; None for any.
        values: One of these instead; none where it is a number.
        at: Its position in the file.
    """

    name: str
    low: float = 0.0
    high: float = 0.0
    step: float | None = None
    values: tuple[Any, ...] = ()
    at: Where

    @property
    def grid(self) -> list[Any]:
        """Every value of a sweep.

        Raises:
            ConfigError: A number without steps, or with very many.
        """
        if self.values:
            return list(self.values)
        if self.step is None:
            raise self.at.error({"between": [self.low, self.high]}, "a step too, as the method is sweep")
        count = math.floor((self.high - self.low) / self.step + 1e-9) + 1
        if count > _MOST_STEPS:
            raise self.at.error(self.step, f"steps of which there are {_MOST_STEPS} at most")
        return [self._rounded(self.low + i * self.step) for i in range(count)]

    def at_share(self, u: float) -> float:
        """The number at the fraction u (0-1) from low to high."""
        value = self.low + u * (self.high - self.low)
        if self.step is not None:
            value = self.low + self.step * round((value - self.low) / self.step)
        return self._rounded(value)

    def _rounded(self, value: float) -> float:
        """The number rounded to a few digits and limited to the bounds; -0 becomes 0, so that both are one place."""
        return min(max(float(f"{value:.{_DIGITS}g}"), self.low), self.high) + 0.0

    @property
    def ends(self) -> list[Any]:
        """Values to validate before the first walk: the ends of a range, every value of a choice."""
        return list(self.values) or [self.low, self.high]

    @property
    def middle(self) -> Any:
        """The value at which the others are validated."""
        return self.values[0] if self.values else self.at_share(0.5)


@dataclass(frozen=True, kw_only=True)
class Free:
    """A free field.

    Attributes:
        paths: Its fields in the scenario, one or several.
        knobs: Its scalars.
        surface: Name of the surface of a position on one; the knobs' names then end in its coordinates.
        fixed: Coordinates on the surface that are not free.
        at: Its position in the file.
    """

    paths: tuple[FieldPath, ...]
    knobs: tuple[Knob, ...]
    surface: str | None = None
    fixed: Mapping[str, float]
    at: Where

    def value(self, chosen: Mapping[str, Any], person: Person) -> Any:
        """The value for the scenario.

        Args:
            chosen: Value of each knob by name.
            person: The wearer.

        Raises:
            ConfigError: There is no such point on the surface.
        """
        if self.surface is None:
            return chosen[self.knobs[0].name]
        place = dict(self.fixed) | {k.name.rpartition("/")[2]: chosen[k.name] for k in self.knobs}
        try:
            p = on_surface(
                self.surface, person, math.radians(place["around_deg"]), 1e-3 * place["up_mm"], 1e-3 * place["off_mm"]
            )
        except StrideTwinError as error:
            raise self.at.error(place, f"a point on it ({error})") from error
        return [round(float(x), _MM_DIGITS) for x in 1e3 * p]


def short(name: str) -> str:
    """A path in tables."""
    return name.replace("sensors.", "")


def free_field(name: str, paths: tuple[FieldPath, ...], node: Any, at: Where) -> Free:
    """Parses a free field.

    Raises:
        ConfigError: It is none of the three forms.
    """
    if not isinstance(node, dict):
        raise at.error(node, "keys between (and step), choice, or over")
    if "over" in node:
        return _over(name, paths, node, at)
    if "choice" in node:
        values = mapping({"choice": Field(attribute="values", read=_values, required=True)}, dict)(node, at)["values"]
        knob = Knob(name=short(name), values=values, at=at)
    else:
        knob = _number(short(name), node, at)
    return Free(paths=paths, knobs=(knob,), fixed={}, at=at)


def _number(name: str, node: Any, at: Where) -> Knob:
    found = mapping(
        {
            "between": Field(attribute="between", read=pair(_ANY), required=True),
            "step": Field(attribute="step", read=number(1e-9, 1e6)),
        },
        dict,
    )(node, at)
    low, high = found["between"]
    if low >= high:
        raise at.key("between").error([low, high], "two numbers, the lower one first")
    return Knob(name=name, low=low, high=high, step=found.get("step"), at=at)


def _values(node: object, where: Where) -> tuple[Any, ...]:
    if not isinstance(node, list) or len(node) < 2:
        raise where.error(node, "a list of two values or more")
    return tuple(node)


_COORDINATES = ("around_deg", "up_mm", "off_mm")


def _over(name: str, paths: tuple[FieldPath, ...], node: dict[str, Any], at: Where) -> Free:
    for key in node:
        if key not in ("over", *_COORDINATES):
            raise at.error(key, f"keys over, {', '.join(_COORDINATES)}")
    surface = one_word(SURFACES)(node["over"], at.key("over"))
    knobs, fixed = [], {"off_mm": 0.0}
    for key in _COORDINATES:
        if isinstance(node.get(key), dict):
            knobs.append(_number(f"{short(name)}/{key}", node[key], at.key(key)))
        elif key in node or key not in fixed:
            fixed[key] = _ANY(node.get(key), at.key(key))
    if not knobs:
        raise at.error(node, f"a range for one of {', '.join(_COORDINATES)}")
    return Free(paths=paths, knobs=tuple(knobs), surface=surface, fixed=fixed, at=at)


def grid_size(knobs: list[Knob]) -> int:
    """Number of places of a sweep."""
    return int(np.prod([len(knob.grid) for knob in knobs], dtype=float)) if knobs else 1
