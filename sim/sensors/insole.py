"""Pressure insole: four cells that share the load so that their weighted mean is the centre of pressure."""

from __future__ import annotations

import numpy as np

from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import ForceCellPart
from stridetwin.sim.sensors.force_cell import ForceCells
from stridetwin.streams.rig import OtherSensor
from stridetwin.streams.samples import Array, Block, Insole

_RING = (0, 1, 3, 2)  # heel, lateral ball, toe, medial ball: the cells' convex outline
_LIFTED_N = 1e-3


class InsoleModel:
    """Forces on the cells heel, lateral ball, medial ball and toe.

    Args:
        calibration: Topic and mount, with `cells_m`.
        part: True parameters of the cells.
        noise: Source of their errors.
    """

    def __init__(self, calibration: OtherSensor, part: ForceCellPart, noise: Noise) -> None:
        self._calibration = calibration
        self._cells = np.asarray(calibration.parameters["cells_m"], dtype=float)
        self._force = ForceCells(part, len(self._cells), calibration.rate_hz, noise)

    def read(self, foot: Track, force_in_world: Array, torque_in_world: Array) -> Block[Insole]:
        """Samples at the track's instants.

        Args:
            foot: Track of the foot's frame, whose z = 0 is the sole.
            force_in_world: (N, 3) load of the ground on the foot, N.
            torque_in_world: (N, 3) its moment about the foot frame's origin, N m.
        """
        to_foot = foot.rotation.inv()
        force, torque = to_foot.apply(force_in_world), to_foot.apply(torque_in_world)
        load = np.maximum(force[:, 2], 0.0)
        cop = np.stack([-torque[:, 1], torque[:, 0]], axis=-1) / np.maximum(load, _LIFTED_N)[:, None]
        cells = load[:, None] * cell_shares(self._cells, cop)
        return Block(
            topic=self._calibration.topic,
            kind=Insole,
            t_ns=foot.t_ns,
            columns={"force": self._force.read(cells)},
        )


def cell_shares(cells: Array, cop: Array) -> Array:
    """Share of the load on each cell: Wachspress coordinates of the centre of pressure (Wachspress 1975).

    Args:
        cells: (4, 2) positions of heel, lateral ball, medial ball and toe, a convex outline, m.
        cop: (N, 2) centre of pressure, m; a point outside the outline is moved to its nearest point.

    Returns:
        (N, 4) shares, not negative, with sum 1, whose mean position is the centre of pressure.
    """
    corner = cells[list(_RING)]
    after, before = np.roll(corner, -1, axis=0), np.roll(corner, 1, axis=0)
    # A right foot's outline is clockwise.
    turning = float(np.sign(_cross(after[0] - corner[0], before[0] - corner[0])))
    inside = _into(corner, after, turning, cop)
    # Twice the area of the triangle of each side with the point; for four corners the weight is the product of the two
    # far sides.
    area = np.maximum(turning * _cross(after - corner, inside[:, None] - corner), 0.0)
    at_corner = turning * _cross(after - corner, before - corner)
    weight = at_corner * np.roll(area, -1, axis=-1) * np.roll(area, -2, axis=-1)
    shares = np.empty_like(weight)
    shares[:, _RING] = weight / weight.sum(axis=-1, keepdims=True)
    return shares


def _into(corner: Array, after: Array, turning: float, point: Array) -> Array:
    """Points (N, 2); those outside the outline are moved to its nearest point."""
    side = after - corner
    to = point[:, None] - corner
    share = np.clip(np.sum(to * side, axis=-1) / np.sum(side * side, axis=-1), 0.0, 1.0)
    nearest = corner + share[..., None] * side
    best = np.argmin(np.linalg.norm(point[:, None] - nearest, axis=-1), axis=-1)
    outside = np.any(turning * _cross(side, to) < 0, axis=-1)
    return np.where(outside[:, None], nearest[np.arange(len(point)), best], point)


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
