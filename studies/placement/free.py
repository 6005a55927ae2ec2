"""Free variables of a placement: a number between bounds, one of several values, or a point on a surface.

Points on the surface of a shoe or a segment of the body: where something can be fixed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag

from stridetwin.scenarios.campaign.field_paths import FieldPath
from stridetwin.sim.config import Person
from stridetwin.streams.errors import FieldLocation, StrideTwinError
from stridetwin.streams.fields import FileModel, Number, OneOf, field_error
from stridetwin.streams.samples import Array

if TYPE_CHECKING:
    from stridetwin.sim.wearer.limbs import LimbShape

SURFACES = {
    "shoe": "foot_l",
    "head": "head",
    "chest": "torso",
    "pelvis": "pelvis",
    **{limb: f"{limb}_l" for limb in ("thigh", "shank", "upper_arm", "forearm")},
}
"""Body of each surface, by its name."""
_OUTSIDE_M = 0.6  # distance from the body's axis that lies outside of every surface


def point_on_surface(surface: str, person: Person, around_rad: float, up_m: float, off_m: float) -> Array:
    """A point on the surface of a shoe or a segment, or at a distance outward of it.

    Args:
        surface: Name in `SURFACES`; all are as wide to the left as to the right.
        person: The wearer.
        around_rad: Direction from the body's axis: 0 is forward, a right angle is aside.
        up_m: Height in the body's frame.
        off_m: Distance outward of the surface.

    Returns:
        (3,) m in the body's frame: forward, aside, up.

    Raises:
        StrideTwinError: There is no surface at that height.
    """
    out = np.array([math.cos(around_rad), math.sin(around_rad), 0.0])
    # a ray from outside towards the axis meets the surface at the distance `away`, infinite if it meets none
    origin = _OUTSIDE_M * out + [0.0, 0.0, up_m]
    away = min(shape.ray_distance(origin, -out) for shape in _shapes_of_surface(surface, person))
    if not math.isfinite(away) or away > _OUTSIDE_M:  # beyond the axis is the other side of the body
        raise StrideTwinError(f"the {surface} has no surface at a height of {1e3 * up_m:g} mm in that direction")
    return np.asarray(origin + (off_m - away) * out)


@cache
def _shapes_of_surface(surface: str, person: Person) -> list[LimbShape]:
    """The geometric shapes of one wearer's body that form a surface (`SURFACES`), in the body's frame."""
    import mujoco  # imported late, because placements are listed and read without the simulator

    from stridetwin.sim.wearer.body import add_wearer, compile_model
    from stridetwin.sim.wearer.limbs import find_shapes

    spec = mujoco.MjSpec()
    add_wearer(spec, person, None)
    model = compile_model(spec)
    return find_shapes(model, {model.body(SURFACES[surface]).id})


_DIGITS = 6  # significant digits of a number that is chosen, of any unit and size
_MM_DIGITS = 3  # digits after the point of a position on a surface, mm
_MOST_STEPS = 1000  # of one number in a sweep
_Number = Annotated[Number, Field(ge=-1e6, le=1e6)]


@dataclass(frozen=True, kw_only=True)
class Knob:
    """One scalar that a placement chooses: a number between bounds, or one of several values.

    Attributes:
        name: In tables.
        low: Lower bound of a number.
        high: Upper bound of a number.
        step: Of a number: only low, low + step, ...; None for any.
        values: The values of a choice; empty for a number.
        at: Its position in the file.
    """

    name: str
    low: float = 0.0
    high: float = 0.0
    step: float | None = None
    values: tuple[object, ...] = ()
    at: FieldLocation

    @property
    def grid(self) -> list[object]:
        """Every value of a sweep: those of a choice, else the numbers.

        Raises:
            ConfigError: A number without steps, or with very many.
        """
        return list(self.values or self.numbers)

    @property
    def numbers(self) -> list[float]:
        """Every number of a sweep between the bounds.

        Raises:
            ConfigError: There are no steps, or very many.
        """
        if self.step is None:
            raise self.at.error({"between": [self.low, self.high]}, "a step, as the method is sweep")
        count = math.floor((self.high - self.low) / self.step + 1e-9) + 1  # 1e-9: the upper bound in spite of rounding
        if count > _MOST_STEPS:
            raise self.at.error(self.step, f"at most {_MOST_STEPS} steps")
        return [self._round(self.low + i * self.step) for i in range(count)]

    def at_share(self, u: float) -> float:
        """The number at the fraction u (0-1) from low to high, on the nearest step if there are steps."""
        value = self.low + u * (self.high - self.low)
        if self.step is not None:
            value = self.low + self.step * round((value - self.low) / self.step)
        return self._round(value)

    def _round(self, value: float) -> float:
        """The number rounded to a few digits and limited to the bounds; -0 becomes 0, so that both are one place."""
        return min(max(float(f"{value:.{_DIGITS}g}"), self.low), self.high) + 0.0

    @property
    def ends(self) -> list[object]:
        """Values to validate before the first walk: the ends of a range, every value of a choice."""
        return list(self.values) or [self.low, self.high]

    @property
    def middle(self) -> object:
        """The value of this knob while the others are validated: the middle of the range, or the first value."""
        return self.values[0] if self.values else self.at_share(0.5)


def to_number(value: object) -> float:
    """The value of a knob that is a number."""
    assert isinstance(value, (int, float))
    return value


def grid_size(knobs: list[Knob]) -> int:
    """Number of places of a sweep: the product of the numbers of values of all knobs."""
    return math.prod(len(knob.grid) for knob in knobs)


@dataclass(frozen=True, kw_only=True)
class FreeField:
    """A field of the scenario, or several with one value, that a placement chooses.

    Attributes:
        paths: Its fields in the scenario, one or several.
        knobs: Its scalars.
        surface: Name of the surface (`SURFACES`) on which the field is a position; None for any other field. The knobs'
            names then end in the coordinates, such as `/up_mm`.
        fixed: Coordinates on the surface that are not free, by name.
        at: Its position in the file.
    """

    paths: tuple[FieldPath, ...]
    knobs: tuple[Knob, ...]
    surface: str | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    at: FieldLocation

    def value(self, chosen: Mapping[str, object], person: Person) -> object:
        """The value of the field in the scenario of a person.

        Args:
            chosen: Value of each knob by name.
            person: The wearer, on whose surface a position lies.

        Returns:
            The chosen value, or for a surface the position, [forward, aside, up] mm.

        Raises:
            ConfigError: There is no such point on the surface.
        """
        if self.surface is None:
            return chosen[self.knobs[0].name]
        # the coordinates on the surface: those that are fixed, and the chosen ones, whose knobs' names end in theirs
        place = {**self.fixed, **{k.name.rpartition("/")[2]: to_number(chosen[k.name]) for k in self.knobs}}
        around_rad, up_m, off_m = math.radians(place["around_deg"]), 1e-3 * place["up_mm"], 1e-3 * place["off_mm"]
        try:
            p = point_on_surface(self.surface, person, around_rad, up_m, off_m)
        except StrideTwinError as error:
            raise self.at.error(place, f"a point on it ({error})") from error
        return [round(float(x), _MM_DIGITS) for x in 1e3 * p]


def _check_order(span: tuple[float, float]) -> tuple[float, float]:
    """Checks the range of a free value, and returns it.

    Raises:
        PydanticCustomError: The lower end is not below the upper one.
    """
    lowest, highest = span
    if lowest >= highest:
        raise field_error(list(span), "two numbers, the lower one first")
    return span


class Between(FileModel):
    """A number between bounds.

    Attributes:
        between: Lowest and highest.
        step: Only the lowest and multiples of the step above it; any number where it is missing.
    """

    between: Annotated[tuple[_Number, _Number], AfterValidator(_check_order)]
    step: Annotated[Number, Field(ge=1e-9, le=1e6)] | None = None


class Among(FileModel):
    """One of several values.

    Attributes:
        choice: The values; anything that a scenario file may say.
    """

    choice: Annotated[tuple[object, ...], Field(min_length=2)]


_Coordinate = Annotated[
    Annotated[_Number, Tag("=number")] | Annotated[Between, Tag("=range")],
    Discriminator(lambda node: "=range" if isinstance(node, dict | Between) else "=number"),
]


class Over(FileModel):
    """A point on a surface of the body, of which at least one coordinate is free.

    Attributes:
        over: The surface.
        around_deg: Angle about the surface's axis.
        up_mm: Height on it.
        off_mm: Distance from it.
    """

    over: Annotated[str, OneOf(tuple(SURFACES))]
    around_deg: _Coordinate
    up_mm: _Coordinate
    off_mm: _Coordinate = 0.0

    def check_free(self) -> Over:
        """Returns the point if at least one coordinate is free; refuses others."""
        if not any(isinstance(getattr(self, key), Between) for key in _COORDINATES):
            raise field_error(self.model_dump(), f"a range for one of {', '.join(_COORDINATES)}")
        return self


_COORDINATES = ("around_deg", "up_mm", "off_mm")


def _form(node: object) -> str:
    """Tag of the form of a free field: a point on a surface, a choice, or a range, which also reports other forms."""
    keys = node if isinstance(node, dict) else ()
    return "=over" if "over" in keys else "=choice" if "choice" in keys else "=between"


FreeInFile = Annotated[
    Annotated[Over, AfterValidator(Over.check_free), Tag("=over")]
    | Annotated[Among, Tag("=choice")]
    | Annotated[Between, Tag("=between")],
    Discriminator(_form),
]
"""Type of what a file says of a free field."""


def free_field(paths: tuple[FieldPath, ...], spec: Between | Among | Over, at: FieldLocation) -> FreeField:
    """A free field from its form in a file.

    Args:
        paths: Fields of the scenario.
        spec: A range, a choice, or a point on a surface.
        at: Position in the file.
    """
    name = ", ".join(path.text for path in paths).replace("sensors.", "")  # in tables, without the common beginning
    if isinstance(spec, Among):
        return FreeField(paths=paths, knobs=(Knob(name=name, values=spec.choice, at=at),), at=at)
    if isinstance(spec, Between):
        return FreeField(paths=paths, knobs=(_knob_between(name, spec, at),), at=at)
    # a point on a surface: a knob for each coordinate that is a range, the others are fixed
    place = {key: getattr(spec, key) for key in _COORDINATES}
    free = {key: value for key, value in place.items() if isinstance(value, Between)}
    knobs = tuple(_knob_between(f"{name}/{key}", value, at.key(key)) for key, value in free.items())
    # `off_mm` is here in every case; where it is free, the chosen value replaces it in `FreeField.value`
    fixed = {"off_mm": 0.0} | {key: value for key, value in place.items() if key not in free}
    return FreeField(paths=paths, knobs=knobs, surface=spec.over, fixed=fixed, at=at)


def _knob_between(name: str, spec: Between, at: FieldLocation) -> Knob:
    """The knob of a number between bounds.

    Args:
        name: Its name in tables.
        spec: Bounds and step.
        at: Position in the file.
    """
    return Knob(name=name, low=spec.between[0], high=spec.between[1], step=spec.step, at=at)
