"""The wearer's bodies at many instants: where points on them are, and how that changes with coordinates and lengths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.config import SIDES
from stridetwin.sim.kinematics.coordinates import Coordinates
from stridetwin.sim.people import Person, Segments
from stridetwin.sim.wearer.anthropometry import SHOE_OVER_FOOT_M, anthropometry
from stridetwin.sim.wearer.body import add_wearer, compile_model
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.sim.wearer.exoskeleton import outward
from stridetwin.streams.algebra.arrays import from_quaternion, rot_z
from stridetwin.streams.samples import Array

LENGTHS = (*(field.name for field in fields(Segments) if field.name.endswith("_m")), "shoe_m")
"""Names of the lengths that are fitted to a person."""
_STEP_M = 0.01  # of the differences by which the places of bodies change with the lengths


class Poses(NamedTuple):
    """Poses of B bodies at N instants.

    Attributes:
        R: (N, B, 3, 3) body to world.
        p: (N, B, 3) m, origins.
        axes: (N, D, 3) axis of each rotating coordinate, world axes; 0 of the first three.
        anchors: (N, D, 3) m, a point on it.
    """

    R: Array
    p: Array
    axes: Array
    anchors: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Skeleton:
    """Kinematics of a wearer without exoskeleton in the coordinates of `Coordinates`.

    Attributes:
        size: Dimensions.
        layout: Names and order of the D coordinates.
        bodies: Names of the B bodies, carriers first; the first is the root.
        parent: (B,) number of each body's carrier, -1 of the root.
        offset: (B, 3) m, origin in the carrier's frame if the body were not turned.
        anchor: (B, 3) m, point about which all hinges of a body rotate, in its frame.
        turn: (B, 3, 3) body to carrier while its hinges are at 0; it is turned about its anchor.
        hinges: For each body its coordinates, each with its axis (3,) in the body's frame.
        carries: (B, D) whether a coordinate moves a body.
        limits: (D, 2) rad, range of each coordinate; infinite for the root.
    """

    size: Wearer
    layout: Coordinates
    bodies: tuple[str, ...]
    parent: NDArray[np.int64]
    offset: Array
    anchor: Array
    turn: Array
    hinges: tuple[tuple[tuple[int, Array], ...], ...]
    carries: NDArray[np.bool_]
    limits: Array

    @classmethod
    def of(cls, person: Person) -> Skeleton:
        """Skeleton of a person without exoskeleton."""
        spec = mujoco.MjSpec()
        size = add_wearer(spec, person, None)
        model = compile_model(spec)
        layout = Coordinates.of(model)
        ids = range(1, model.nbody)
        names = tuple(model.body(b).name for b in ids)
        parent = np.array([model.body_parentid[b] - 1 for b in ids])
        hinges, anchor = [], np.zeros((len(names), 3))
        carries = np.zeros((len(names), len(layout.names)), dtype=bool)
        limits = np.tile([-np.inf, np.inf], (len(layout.names), 1))
        for i, b in enumerate(ids):
            joints = range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b]) if i else ()
            body_hinges = []
            for j in joints:
                column = layout.names.index(model.joint(j).name)
                body_hinges.append((column, model.jnt_axis[j].copy()))
                anchor[i] = model.jnt_pos[j]
                limits[column] = model.jnt_range[j]
            if i == 0:  # yaw, pitch and roll of the free root
                body_hinges = [(3, np.eye(3)[2]), (4, np.eye(3)[1]), (5, np.eye(3)[0])]
                carries[i, :3] = True
            else:
                carries[i] = carries[parent[i]]
            carries[i, [column for column, _ in body_hinges]] = True
            hinges.append(tuple(body_hinges))
        turn = from_quaternion(model.body_quat[1:])
        offset = model.body_pos[1:] + np.einsum("bij,bj->bi", turn, anchor) - anchor
        offset[0] = 0.0  # the root's place is its coordinates
        return cls(
            size=size,
            layout=layout,
            bodies=names,
            parent=parent,
            offset=offset,
            anchor=anchor,
            turn=turn,
            hinges=tuple(hinges),
            carries=carries,
            limits=limits,
        )

    def index(self, body: str) -> int:
        """Number of a body."""
        return self.bodies.index(body)

    def column(self, name: str) -> int:
        """Number of a coordinate."""
        return self.layout.names.index(name)

    def with_twist(self, twist_rad: float) -> Skeleton:
        """The skeleton with feet that are turned outward against the knees by another angle."""
        turn = self.turn.copy()
        for side in SIDES:
            turn[self.index(f"foot_{side}")] = rot_z(np.array(outward(side) * twist_rad))
        return replace(self, turn=turn)

    def poses(self, x: Array) -> Poses:
        """Poses of all bodies at (N, D) coordinates."""
        n, count = len(x), len(self.bodies)
        R, p = np.empty((n, count, 3, 3)), np.empty((n, count, 3))
        axes, anchors = np.zeros((n, x.shape[1], 3)), np.zeros((n, x.shape[1], 3))
        for b, up in enumerate(self.parent):
            carrier_R, carrier_p = (R[:, up], p[:, up]) if up >= 0 else (np.eye(3)[None].repeat(n, 0), x[:, :3])
            point = carrier_p + carrier_R @ (self.offset[b] + self.anchor[b])
            body_R = carrier_R @ self.turn[b]
            for column, axis in self.hinges[b]:
                axes[:, column], anchors[:, column] = body_R @ axis, point
                body_R = body_R @ _rotate(axis, x[:, column])
            R[:, b], p[:, b] = body_R, point - body_R @ self.anchor[b]
        return Poses(R, p, axes, anchors)

    def points(self, poses: Poses, bodies: NDArray[np.int64], places: Array) -> Array:
        """(N, P, 3) m in the world, of (P, 3) places on (P,) bodies."""
        return poses.p[:, bodies] + np.einsum("npij,pj->npi", poses.R[:, bodies], places)

    def jacobian(self, poses: Poses, bodies: NDArray[np.int64], points: Array) -> Array:
        """(N, P, 3, D) derivatives of (N, P, 3) points on (P,) bodies by the coordinates."""
        n, count, _ = points.shape
        J = np.zeros((n, count, 3, poses.axes.shape[1]))
        J[:, :, [0, 1, 2], [0, 1, 2]] = 1.0
        for b in np.unique(bodies):
            rows = np.flatnonzero(bodies == b)
            columns = np.flatnonzero(self.carries[b])
            columns = columns[columns >= 3]
            arm = points[:, rows, None] - poses.anchors[:, None, columns]
            turned = _cross(poses.axes[:, None, columns], arm)  # (N, rows, columns, 3)
            J[:, rows[:, None], :, columns[None]] = np.moveaxis(turned, 0, 2)
        return J

    def twist_jacobian(self, poses: Poses, bodies: NDArray[np.int64], points: Array) -> Array:
        """(N, P, 3) 1/rad, derivatives of (N, P, 3) points on (P,) bodies by the twist of both shanks."""
        J = np.zeros_like(points)
        for side in SIDES:
            ankle = self.column(f"ankle_dorsiflexion_{side}")
            beyond = np.flatnonzero(self.carries[bodies, ankle])
            shank = poses.R[:, self.index(f"shank_{side}")]
            arm = points[:, beyond] - poses.anchors[:, None, ankle]
            J[:, beyond] = outward(side) * _cross(shank[:, None, :, 2], arm)
        return J

    def gather(
        self, poses: Poses, bodies: NDArray[np.int64], points: Array, weights: Array, errors: Array
    ) -> tuple[Array, Array]:
        """Normal equations Jᵀ W J and Jᵀ W e of points on the bodies, J as of `jacobian`, which is not formed.

        The points that a coordinate moves are summed up as the masses of a composite body are (Featherstone 2008,
        section 6.2): a coordinate with axis a through o moves a point at r from the root by v + a × r, v = a × −o.

        Args:
            poses: N poses.
            bodies: (P,) numbers of the bodies.
            points: (N, P, 3) m in the world.
            weights: (N, P).
            errors: (N, P, 3) m.

        Returns:
            (N, D, D) and (N, D).
        """
        root = poses.p[:, :1]
        r = points - root
        axes = poses.axes
        slides = _cross(axes, root - poses.anchors)
        slides[:, [0, 1, 2], [0, 1, 2]] = 1.0
        weighted, force = r * weights[..., None], errors * weights[..., None]
        sums = [weights[..., None], weighted, weighted[..., :1] * r, weighted[..., 1:2] * r[..., 1:]]
        sums += [weighted[..., 2:] * r[..., 2:], force, _cross(r, force)]
        moved = self.carries[bodies].T.astype(float) @ np.concatenate(sums, axis=-1)  # (N, D, 16)
        mass, moment = moved[..., :1], moved[..., 1:4]
        xx, xy, xz, yy, yz, zz = np.moveaxis(moved[..., 4:10], -1, 0)
        second = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(*xx.shape, 3, 3)
        push = mass * slides + _cross(axes, moment)
        twist = _cross(moment, slides) + (xx + yy + zz)[..., None] * axes - (second @ axes[..., None])[..., 0]
        # between a coordinate and those of its carriers counts what the former moves
        half = np.concatenate([twist, push], axis=-1) @ np.swapaxes(np.concatenate([axes, slides], axis=-1), 1, 2)
        moves = self.carries.astype(int)
        is_lower = (moves.T @ moves) == moves.sum(0)[:, None]  # all that the row moves, the column moves, too
        H = np.where(is_lower, half, np.where(is_lower.T, np.swapaxes(half, 1, 2), 0.0))
        g = np.sum(slides * moved[..., 10:13] + axes * moved[..., 13:], axis=-1)
        return H, g


@dataclass(frozen=True, kw_only=True, eq=False)
class LengthChanges:
    """How bodies are displaced by the lengths `LENGTHS`.

    Attributes:
        offset: (L, B, 3) derivative of each body's origin in its carrier's frame.
        anchor: (L, B, 3) derivative of the point about which its hinges rotate.
    """

    offset: Array
    anchor: Array

    @staticmethod
    @lru_cache(maxsize=4)
    def of(person: Person) -> LengthChanges:
        """Derivatives at a person, whose lengths are all given; places are linear in the lengths."""
        base = Skeleton.of(person)
        changed = [Skeleton.of(_with_length(person, name, _STEP_M)) for name in LENGTHS]
        return LengthChanges(
            offset=np.stack([(s.offset - base.offset) / _STEP_M for s in changed]),
            anchor=np.stack([(s.anchor - base.anchor) / _STEP_M for s in changed]),
        )

    def apply(self, skeleton: Skeleton, change_m: Array) -> Skeleton:
        """The bodies of a skeleton where they are after changes (L,) of the lengths; its sizes stay as they are."""
        return replace(
            skeleton,
            offset=skeleton.offset + np.tensordot(change_m, self.offset, 1),
            anchor=skeleton.anchor + np.tensordot(change_m, self.anchor, 1),
        )

    def jacobian(self, skeleton: Skeleton, poses: Poses, bodies: NDArray[np.int64]) -> Array:
        """(N, P, 3, L) derivatives of points on (P,) bodies by the lengths, at unchanged coordinates."""
        n, count = poses.p.shape[:2]
        moved = np.zeros((n, count, 3, len(LENGTHS)))  # of the bodies' origins
        for b, up in enumerate(skeleton.parent):
            if up < 0:
                continue
            carrier = poses.R[:, up]
            moved[:, b] = moved[:, up] + np.einsum("nij,lj->nil", carrier, self.offset[:, b])
            moved[:, b] += np.einsum("nij,lj->nil", carrier - poses.R[:, b], self.anchor[:, b])
        return moved[:, bodies]


def lengths_of(person: Person) -> Person:
    """A person with the lengths of all segments set to those that follow from height and sex."""
    body = anthropometry(person)
    return replace(
        person,
        shoe_m=body.shoe_length_m - SHOE_OVER_FOOT_M,
        segments=Segments(
            thigh_m=body.thigh_m,
            shank_m=body.shank_m,
            ankle_height_m=body.ankle_height_m,
            hip_width_m=2 * body.hip_half_width_m,
            trunk_m=body.trunk_m,
            shoulder_width_m=2 * body.shoulder_half_width_m,
            upper_arm_m=body.upper_arm_m,
            forearm_m=body.forearm_m,
            shank_twist_rad=body.shank_twist_rad,
        ),
    )


def length_values(person: Person) -> Array:
    """(L,) m, the lengths `LENGTHS` of a person who has all of them."""
    return np.array([person.shoe_m if name == "shoe_m" else getattr(person.segments, name) for name in LENGTHS])


def with_lengths(person: Person, values: Sequence[float] | Array) -> Person:
    """The person with other lengths (L,), m, in the order of `LENGTHS`."""
    table: Mapping[str, float] = {name: float(value) for name, value in zip(LENGTHS, values)}
    lengths = {name: value for name, value in table.items() if name != "shoe_m"}
    return replace(person, shoe_m=table["shoe_m"], segments=replace(person.segments or Segments(), **lengths))


def with_twist(person: Person, twist_rad: float) -> Person:
    """The person with feet that are turned outward against the knees by another angle."""
    return replace(person, segments=replace(person.segments or Segments(), shank_twist_rad=twist_rad))


def _with_length(person: Person, name: str, change: float) -> Person:
    """The person with one length changed by m."""
    values = length_values(person)
    values[LENGTHS.index(name)] += change
    return with_lengths(person, values)


def _cross(a: Array, b: Array) -> Array:
    """(..., 3) vector product; for many short vectors it is much faster than `np.cross`."""
    a_x, a_y, a_z = a[..., 0], a[..., 1], a[..., 2]
    b_x, b_y, b_z = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x], axis=-1)


def _rotate(axis: Array, angle: Array) -> Array:
    """(N, 3, 3) rotations by (N,) angles about a constant unit axis (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle)[:, None, None] * K + (1.0 - np.cos(angle))[:, None, None] * (K @ K)
