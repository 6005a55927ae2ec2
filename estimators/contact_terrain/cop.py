"""Centre of pressure from the cells of an insole: equation (11) of Shim et al. 2019."""

from __future__ import annotations

from stridetwin.streams.samples import Array


def centre_of_pressure(cells: Array, force: Array, pressing_n: float) -> Array | None:
    """(2,) m on the sole, None where the foot does not press.

    See docs/contact_terrain.md (3).

    Args:
        cells: (4, 2) m.
        force: (4,) N.
        pressing_n: N, a foot with less on all cells together is off the ground.
    """
    total = float(force.sum())
    return None if total < pressing_n else force @ cells / total


def on_sole(T_foot_sole: Array, cop: Array) -> Array:
    """(3,) m, a point of the sole in the foot's frame."""
    point: Array = T_foot_sole[:3, :2] @ cop + T_foot_sole[:3, 3]
    return point
