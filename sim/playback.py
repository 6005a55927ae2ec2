"""Plays a planned or recorded walk without a simulation.

Inverse dynamics gives the ground reaction wrench, which is distributed between the two feet.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.config import SIDES
from stridetwin.sim.gait.heel_strike import UpperMotion
from stridetwin.sim.kinematics import rigid_tree
from stridetwin.sim.kinematics.rigid_tree import Tree
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.walk import GivenWalk, Walk
from stridetwin.sim.wearer.body import bodies_to_track
from stridetwin.sim.wearer.exo_couplings import BodyState, Coupling, exo_couplings, wrench
from stridetwin.sim.wearer.sensor_bodies import UPPERS
from stridetwin.streams.algebra.arrays import cross, from_quaternion
from stridetwin.streams.samples import Array

LIFTED_SHARE = 1e-3  # share of the load below which a foot counts as lifted
# How the load of two feet follows what the motion needs: the centres of pressure move by about `_COP_SD_M`, the shares
# by about `_SHARE_SD` where both feet bear half, and never fall by more than the share `_MOST_OF_SHARE`. By hand: a
# centre of pressure leaves the sole within millimetres of where feet land and leave, a load can move at any time
_COP_SD_M, _SHARE_SD, _MOST_OF_SHARE = 0.010, 0.20, 0.8


@dataclass(frozen=True, kw_only=True, eq=False)
class FootLoad:
    """Ground reaction on one foot at N instants.

    Attributes:
        force: (N, 3) N, world.
        torque: (N, 3) N m about the foot frame's origin, world axes.
        cop: (N, 3) m, centre of pressure in the world; undefined while the foot is lifted.
        loaded: (N,) whether the foot bears load, so that its centre of pressure is defined.
    """

    force: Array
    torque: Array
    cop: Array
    loaded: NDArray[np.bool_]


def split_wrench(
    force: Array,
    torque: Array,
    origin: Array,
    shares: dict[str, Array],
    planned: dict[str, Array],
    p_foot: dict[str, Array],
) -> tuple[dict[str, FootLoad], Array, Array]:
    """Splits the total wrench of the ground between the two feet.

    The weighted mean of the centres of pressure is the zero-moment point. Where it is not the planned one, load moves
    from foot to foot, and the centres of pressure are translated equally in the plane, by what is least relative to
    what each may change (`_move_load`). The moment about the vertical is shared like the force.

    Args:
        force: (N, 3) total force of the ground, world, N.
        torque: (N, 3) its moment about `origin`, N m.
        origin: (N, 3) m, world.
        shares: (N,) by foot, summing to 1, or 0 in a flight.
        planned: (N, 3) m, planned centre of pressure by foot, world.
        p_foot: (N, 3) m, foot frame's origin by foot, world.

    Returns:
        Loads by foot; and the force (N, 3), N, and the moment about `origin` (N, 3), N m, that they do not explain.
    """
    # a lifted foot bears nothing; the shares of the others are scaled to the sum 1
    kept = {f: np.where(s > LIFTED_SHARE, s, 0.0) for f, s in shares.items()}
    total_share = np.sum(list(kept.values()), axis=0)
    flight = total_share == 0.0  # where no foot bears anything, the residual is what the motion still needs
    shares = {f: s / np.where(flight, 1.0, total_share) for f, s in kept.items()}
    middle = np.sum([shares[f][:, None] * planned[f] for f in shares], axis=0)  # mean planned centre of pressure
    middle = np.where(flight[:, None], np.mean(list(planned.values()), axis=0), middle)
    arm_z = middle[:, 2] - origin[:, 2]  # m, height of the ground relative to the origin
    lift = np.maximum(force[:, 2], 1.0)  # in free fall there is no zero-moment point
    x = origin[:, 0] + (arm_z * force[:, 0] - torque[:, 1]) / lift
    y = origin[:, 1] + (arm_z * force[:, 1] + torque[:, 0]) / lift
    shift = np.column_stack([x, y, middle[:, 2]]) - middle  # from the planned mean to the zero-moment point (x, y)
    shift[flight] = 0.0
    twist = torque - cross(middle + shift - origin, force)  # what remains of the moment there, about the vertical
    if len(shares) == 2:
        shares, shift = _move_load(shares, planned, shift, force / lift[:, None])
    loads, residual_force, residual_torque = {}, force.copy(), torque.copy()
    for foot, share in shares.items():
        foot_force = share[:, None] * force
        cop = planned[foot] + shift
        # the foot's share of the moment about the vertical, which acts beside the force
        free = np.column_stack([np.zeros((len(share), 2)), share * twist[:, 2]])
        loads[foot] = FootLoad(
            force=foot_force, torque=cross(cop - p_foot[foot], foot_force) + free, cop=cop, loaded=share > 0.0
        )
        residual_force -= foot_force
        residual_torque -= cross(cop - origin, foot_force) + free
    return loads, residual_force, residual_torque


def _move_load(
    shares: dict[str, Array], planned: dict[str, Array], shift: Array, direction: Array
) -> tuple[dict[str, Array], Array]:
    """Shares of the load by foot, and (N, 3) m, what is left for the centres of pressure of a wanted shift.

    With the planned centres of pressure apart by d, a change δ of the shares moves their mean by δ d, along the force
    back to its height by δ d'. Of all δ d' + r = `shift`, along d', the one with the least (δ / σ_δ)² + (|r| / σ_r)² is
    taken; σ_δ vanishes with either share.

    Args:
        shares: (N,) by foot, of two feet.
        planned: (N, 3) m, planned centres of pressure by foot, world.
        shift: (N, 3) m, from their mean to the zero-moment point, level.
        direction: (N, 3) force of the ground, relative to its vertical part.
    """
    (first, a), (second, b) = shares.items()
    apart = planned[first] - planned[second]
    apart = apart - apart[:, 2:] * direction
    apart[:, 2] = 0.0
    # a foot that has just landed may bear at once what stops it
    share_sd = _SHARE_SD * np.maximum(4.0 * a * b, 0.0) ** 0.25
    along = np.einsum("ni,ni->n", shift, apart)
    moved = along * share_sd**2 / (_COP_SD_M**2 + (apart**2).sum(1) * share_sd**2)
    moved = np.clip(moved, -_MOST_OF_SHARE * a, _MOST_OF_SHARE * b)
    return {first: a + moved, second: b - moved}, shift - moved[:, None] * apart


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Motion of the wearer at N instants.

    Attributes:
        t_ns: (N,) increasing.
        qpos: (N, nq) in MuJoCo's layout.
        tracks: Track by body name: `body.bodies_to_track`, and the bodies that carry other sensors.
        uppers: Track of the shoe's upper by name of the foot; empty for rigid shoes. If heel strikes reach a sensor
            case further up, also the track of that case, by name of its body.
        angle: (N,) rad by hinge name.
        speed: (N,) rad/s by hinge name.
        cuff_force: (N,) N by place (thigh_l, ...), force of the cuff on the wearer, forward positive; empty without
            exoskeleton.
    """

    t_ns: NDArray[np.int64]
    qpos: Array
    tracks: dict[str, Track]
    uppers: dict[str, Track]
    angle: dict[str, Array]
    speed: dict[str, Array]
    cuff_force: dict[str, Array]

    def rows(self, t_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """(len(t_ns),) rows of this motion at the given instants, which must be among its own ones."""
        return np.searchsorted(self.t_ns, t_ns)

    def carrier(self, body: str) -> Track:
        """Track of the carrier of the sensors mounted on a body: for a foot, the shoe's upper."""
        return self.uppers.get(body, self.tracks[body])

    def upper_poses(self, rows: NDArray[np.int64]) -> dict[str, Array]:
        """(len(rows), 7) position (m) and quaternion of each shoe's upper in its foot's frame, by name of the foot."""
        poses = {}
        for name in (foot for foot in UPPERS if foot in self.uppers):
            upper, foot = self.uppers[name], self.tracks[name]
            R_foot_world = foot.rotation[rows].inv()
            # translation and rotation of the upper, in the axes of the foot
            shift = R_foot_world.apply(upper.p_body_in_world[rows] - foot.p_body_in_world[rows])
            turn = (R_foot_world * upper.rotation[rows]).as_quat(scalar_first=True)
            poses[name] = np.hstack([shift, turn])
        return poses


@dataclass(frozen=True, kw_only=True, eq=False)
class Loads:
    """Ground reaction and joint torques at N instants.

    Attributes:
        t_ns: (N,).
        feet: Load of each foot, `l` and `r`.
        joint_torque: (N, J) N m of the hinges, in the order of `Coordinates.names[6:]`. The torques of the
            exoskeleton's couplings are subtracted, so that its own joints carry the torques of stops and modules only.
        residual_force: (N, 3) N, world: force that the contacts do not explain.
        residual_torque: (N, 3) N m about the pelvis.
        motors: (N,) N m by hinge name, torque of the motors that drive the exoskeleton's joints.
    """

    t_ns: NDArray[np.int64]
    feet: dict[str, FootLoad]
    joint_torque: Array
    residual_force: Array
    residual_torque: Array
    motors: dict[str, Array] = field(default_factory=dict)


AnyWalk = TypeVar("AnyWalk", bound=Walk, covariant=True)


class Player(Generic[AnyWalk]):
    """Gives poses, velocities and cuff forces of a walk at any instants.

    Args:
        model: Compiled model of the wearer on the terrain.
        walk: Motion to play.
        uppers: Motion of the shoes' uppers, by name of the foot; None for rigid shoes.
        carriers: Bodies that carry sensors, whose tracks `motion` has beside those of `bodies_to_track`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        walk: AnyWalk,
        uppers: Mapping[str, UpperMotion] | None = None,
        carriers: Iterable[str] = (),
    ) -> None:
        """Prepares the tree and the couplings."""
        self._model, self._walk, self._uppers = model, walk, uppers or {}
        self._bodies = tuple(dict.fromkeys([*bodies_to_track(walk.size), *carriers]))
        self._tree = Tree.of(model)
        self._couplings = exo_couplings(walk.size)
        # instants, positions and velocities of the last call of `track`: both feet ask for the same ones
        self._state: tuple[NDArray[np.int64], Array, Array] | None = None

    def motion(self, t_ns: NDArray[np.int64]) -> Motion:
        """Poses, velocities and cuff forces at (N,) instants."""
        walk = self._walk
        q, v = walk.position_velocity(t_ns * 1e-9)
        # layout of the coordinates, and the names of the hinges, which come after the six coordinates of the root
        names, layout = walk.coordinates.names[6:], walk.coordinates
        tracks = self._tracks(self._bodies, self._tree, t_ns, q, v)
        cuffs = [c for c in self._couplings if not c.name.startswith("heel")]  # a heel's coupling is no cuff
        return Motion(
            t_ns=t_ns,
            qpos=q,
            tracks=tracks,
            uppers={foot: upper.upper_track(tracks[foot]) for foot, upper in self._uppers.items()},
            angle={name: q[:, layout.qpos[i]] for i, name in enumerate(names)},
            speed={name: v[:, layout.dof[i]] for i, name in enumerate(names)},
            cuff_force={c.name: _cuff_force(c, tracks) for c in cuffs},
        )

    def _tracks(
        self, bodies: Iterable[str], tree: Tree, t_ns: NDArray[np.int64], q: Array, v: Array
    ) -> dict[str, Track]:
        """Tracks of some bodies of a tree.

        Args:
            bodies: Their names.
            tree: Tree that contains them.
            t_ns: (N,) instants.
            q: (N, nq) positions.
            v: (N, nv) velocities.
        """
        p, quat, speed, w = rigid_tree.body_motion(tree, q, v)  # (N, B, ...) of all bodies of the tree
        rows = {body: tree.index_of(self._model.body(body).id) for body in bodies}
        return {
            body: Track(
                t_ns=t_ns, p_body_in_world=p[:, i], q_world_body=quat[:, i], v_body_in_world=speed[:, i], w_body=w[:, i]
            )
            for body, i in rows.items()
        }

    def track(self, body: str, t_ns: NDArray[np.int64]) -> Track:
        """Track of the carrier of a body's sensors (`Motion.carrier`) at (N,) instants; much faster than `motion`.

        Consecutive calls with equal instants share the state of the walk.
        """
        if self._state is None or not np.array_equal(self._state[0], t_ns):
            self._state = (t_ns, *self._walk.position_velocity(t_ns * 1e-9))
        # the bodies that carry this one are enough for its motion
        chain = self._tree.subtree([self._tree.index_of(self._model.body(body).id)])
        track = self._tracks([body], chain, *self._state)[body]
        return self._uppers[body].upper_track(track) if body in self._uppers else track


class Playback(Player[GivenWalk]):
    """Player of a planned or recorded walk, exactly as given; its loads follow from inverse dynamics."""

    def loads(self, t_ns: NDArray[np.int64], motion: Motion) -> Loads:
        """Contact loads and joint torques by inverse dynamics of the whole body.

        The wrench that the motion needs at the root is the ground's (`split_wrench`). The torques of the hinges also
        balance the couplings of the exoskeleton, rotors and damping.

        Args:
            t_ns: (N,) instants, which are among those of `motion`.
            motion: Motion of the wearer.
        """
        model, tree, walk = self._model, self._tree, self._walk
        q, v, a = walk.state(t_ns * 1e-9)
        rows = motion.rows(t_ns)
        # (N, 3) force and moment about the root that the ground has to provide
        total, torque, _ = rigid_tree.root_wrench(tree, q, v, a, model.opt.gravity)
        shares = walk.contact_shares(t_ns * 1e-9)
        feet, residual_force, residual_torque = split_wrench(
            total,
            torque,
            q[:, :3],
            # columns of `shares`: share (1) and centre of pressure (3) of the left, then of the right foot
            {side: shares[:, 4 * k] for k, side in enumerate(SIDES)},
            {side: shares[:, 4 * k + 1 : 4 * k + 4] for k, side in enumerate(SIDES)},
            {side: motion.tracks[f"foot_{side}"].p_body_in_world[rows] for side in SIDES},
        )
        # external wrenches on bodies: (body, (N, 3) force, (N, 3) moment about the body's origin), world axes
        applied = [(f"foot_{side}", load.force, load.torque) for side, load in feet.items()]
        # each coupling acts on its exoskeleton body, and with the opposite sign on the wearer's; moments are moved from
        # the coupling's point to the origin of each body
        for c in self._couplings:
            exo, limb = (_pose(motion.tracks[body][rows]) for body in (c.exo_body, c.body))
            force, moment, point = wrench(c, exo, limb)
            for body, sign in ((c.exo_body, 1.0), (c.body, -1.0)):
                arm = point - motion.tracks[body].p_body_in_world[rows]
                applied.append((body, sign * force, sign * (moment + cross(arm, force))))
        bodies = np.array([tree.index_of(model.body(body).id) for body, _, _ in applied])
        forces = np.stack([force for _, force, _ in applied])
        moments = np.stack([moment for _, _, moment in applied])
        joint_torque = rigid_tree.hinge_torques(tree, q, v, a, model.opt.gravity, bodies, forces, moments)
        # rotors and damping, which `hinge_torques` leaves out
        joint_torque += model.dof_armature[tree.dof] * a[:, tree.dof] + model.dof_damping[tree.dof] * v[:, tree.dof]
        return Loads(
            t_ns=t_ns,
            feet=feet,
            joint_torque=joint_torque,
            residual_force=residual_force,
            residual_torque=residual_torque,
        )


def _cuff_force(c: Coupling, tracks: dict[str, Track]) -> Array:
    """(N,) N, force of a coupling on the wearer along the x axis of the exoskeleton's body, forward positive."""
    exo = _pose(tracks[c.exo_body])
    force, _, _ = wrench(c, exo, _pose(tracks[c.body]))  # on the exoskeleton
    return -np.einsum("ni,ni->n", exo.R[:, :, 0], force)


def _pose(track: Track) -> BodyState:
    """Poses and velocities of a track, all in world axes, as the couplings need them."""
    R = from_quaternion(track.q_world_body)
    return BodyState(p=track.p_body_in_world, R=R, v=track.v_body_in_world, w=np.einsum("nij,nj->ni", R, track.w_body))
