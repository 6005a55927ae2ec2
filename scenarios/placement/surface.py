"""Points on the surface of shoe, head or chest: where something can be fixed."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from stridetwin.sim.config import Person
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array

if TYPE_CHECKING:
    from stridetwin.sim.limbs import Shape

SURFACES = {"shoe": "foot_l", "head": "head", "chest": "torso"}
_OUTSIDE_M = 0.6


def on_surface(surface: str, person: Person, around_rad: float, up_m: float, off_m: float) -> Array:
    """A point on a surface, or off it.

    Args:
        surface: Of `SURFACES`; all are as wide to the left as to the right.
        person: The wearer.
        around_rad: Direction from the body's axis, from forward aside.
        up_m: Height in the body's frame.
        off_m: How far outward of the surface.

    Returns:
        (3,) m in the body's frame: forward, aside, up.

    Raises:
        StrideTwinError: There is no surface at that height.
    """
    out = np.array([math.cos(around_rad), math.sin(around_rad), 0.0])
    origin = _OUTSIDE_M * out + [0.0, 0.0, up_m]
    away = min(shape.first_touch(origin, -out) for shape in _shapes(surface, person))
    if not math.isfinite(away) or away > _OUTSIDE_M:
        raise StrideTwinError(f"the {surface} has no surface at a height of {1e3 * up_m:g} mm in that direction")
    return np.asarray(origin + (off_m - away) * out)


@cache
def _shapes(surface: str, person: Person) -> list[Shape]:
    import mujoco  # a placement's file is read without, to be listed

    from stridetwin.sim.body import add_wearer, compile_model
    from stridetwin.sim.limbs import shapes

    spec = mujoco.MjSpec()
    add_wearer(spec, person, None)
    model = compile_model(spec)
    return shapes(model, {model.body(SURFACES[surface]).id})
