"""Result of a simulated walk: its physics steps as smooth functions of time for playback, and the contact loads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from stridetwin.sim.config import SIDES
from stridetwin.sim.gait.footsteps import Footstep
from stridetwin.sim.gait.reference import Reference
from stridetwin.sim.playback import FootLoad, Loads, Motion, Player
from stridetwin.sim.walk import Walk
from stridetwin.streams.algebra.arrays import from_euler
from stridetwin.streams.samples import Array

_LOADED_N = 20.0  # vertical force from which a foot counts as loaded
_EARLY_OR_LATE_S = 0.12  # a touch-down is searched this close to the planned one


class FootRecord(NamedTuple):
    """Frames of both feet and the loads of the ground on them, at N physics steps or at one.

    Attributes:
        R: (N, 2, 3, 3) rotations of the feet, foot to world; left, then right.
        p: (N, 2, 3) m, origins of the feet's frames in the world.
        force: (N, 2, 3) N, ground force on each foot, world axes.
        moment: (N, 2, 3) N m about the frames' origins, world axes.
        cop: (N, 2, 3) m, centre of pressure in the world; (0, 0, 0) without load.
    """

    R: Array
    p: Array
    force: Array
    moment: Array
    cop: Array

    def at(self, rows: int | slice | NDArray[np.int64]) -> FootRecord:
        """Record of one row, or of several rows, as views."""
        return FootRecord(*(values[rows] for values in self))


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedWalk(Walk):
    """Result of the simulation; it ends where the walker fell.

    The coordinates of the physics steps are the control points of cubic B-splines, so that position, velocity and
    acceleration agree exactly at any instant.

    Attributes:
        fell_at: When the walker fell, s, or None.
        t: (N,) s, the physics steps.
        torque: (N, nv) N m, generalised forces of the joints; the root's six entries are the assist (world force,
            torque in the pelvis' axes), 0 without it.
        loads: The feet, left and right, at these steps.
        _pitch: (N, 2) rad, pitch of the left and the right foot against its ground, toes down positive.
    """

    fell_at: float | None
    t: Array
    torque: Array
    loads: FootRecord
    _pitch: Array

    @classmethod
    def of(
        cls, reference: Reference, t: Array, q: Array, torque: Array, loads: FootRecord, fell_at: float | None = None
    ) -> SimulatedWalk:
        """The simulated walk, with the footsteps and foot pitch that the simulation made.

        Args:
            reference: The planned motion.
            t: (N,) s, the physics steps.
            q: (N, nq) positions.
            torque: (N, nv) N m, generalised forces of the joints.
            loads: Loads of the feet at these steps.
            fell_at: Time at which the walker fell, s; None if they did not.
        """
        end = float(t[-1])
        # footsteps by side, as simulated; those after the end of the simulation are left out. k: 0 left, 1 right
        steps = {
            side: [
                _simulate_footstep(step, t, loads.force[:, k, 2], loads.p[:, k], loads.R[:, k])
                for step in reference.steps[side]
                if step.t_touch < end
            ]
            for k, side in enumerate(SIDES)
        }
        pitch = np.column_stack([_foot_pitch(steps[side], t, loads.R[:, k]) for k, side in enumerate(SIDES)])
        return replace(cls.of_part(reference, t, q, torque, loads), steps=steps, fell_at=fell_at, _pitch=pitch)

    @classmethod
    def of_part(cls, reference: Reference, t: Array, q: Array, torque: Array, loads: FootRecord) -> SimulatedWalk:
        """Part of a walk, for live playback: it keeps the planned footsteps and sets the pitch of the feet to 0.

        Args:
            reference: The planned motion.
            t: (N,) s, consecutive physics steps.
            q: (N, nq) positions.
            torque: (N, nv) N m, generalised forces of the joints.
            loads: Loads of the feet at these steps.
        """
        return cls(
            duration_s=float(t[-1]),
            size=reference.size,
            steps=reference.steps,
            coordinates=reference.coordinates,
            splines=control_spline(t, reference.coordinates.from_mujoco(q)),
            fell_at=None,
            t=t,
            torque=torque,
            loads=loads,
            _pitch=np.zeros((len(t), len(SIDES))),
        )

    def pitch(self, side: str, t: NDArray[np.floating]) -> Array:
        """(N,) rad, simulated pitch of a foot relative to the ground under it at (N,) s, toes down positive."""
        return np.interp(t, self.t, self._pitch[:, SIDES.index(side)])

    def _nearest_steps(self, t: NDArray[np.floating]) -> NDArray[np.int64]:
        """(N,) rows of the physics steps nearest to (N,) s; the first or last row for times outside."""
        return np.clip(np.round((t - self.t[0]) / (self.t[1] - self.t[0])).astype(np.int64), 0, len(self.t) - 1)

    def feet(self, t: NDArray[np.floating]) -> dict[str, FootLoad]:
        """Ground reaction on each foot at (N,) s, that of the nearest physics step, by side."""
        _, _, force, moment, cop = self.loads.at(self._nearest_steps(t))
        return {
            side: FootLoad(force=force[:, k], torque=moment[:, k], cop=cop[:, k], loaded=force[:, k, 2] > _LOADED_N)
            for k, side in enumerate(SIDES)
        }

    def efforts(self, t: NDArray[np.floating]) -> tuple[Array, Array, Array]:
        """Torques of the joints, and the assistance at the root, at (N,) s; those of the nearest physics steps.

        Returns:
            (N, J) N m, torques of the joints in the order of `coordinates.names[6:]`; (N, 3) N, force of the assistance
            at the pelvis, and (N, 3) N m, its torque about the pelvis, both in world axes and 0 without assistance.
        """
        torque = self.torque[self._nearest_steps(t)]
        R = from_euler(self.splines(t)[:, 3:6])  # pelvis to world, from yaw, pitch and roll of the root
        return torque[:, self.coordinates.dof], torque[:, :3], np.einsum("nij,nj->ni", R, torque[:, 3:6])


def control_spline(t: Array, x: Array) -> BSpline:
    """Cubic B-spline with (N, n) control points at (N,) evenly spaced times; the ends are held.

    The spline is near its control points, not through them: at each time it is the mean (1, 4, 1) / 6 of three points.
    Its acceleration is continuous.
    """
    control = np.concatenate([x[:1], x[:1], x, x[-1:], x[-1:]])
    # evenly spaced knots, such that the basis function of each row of `x` peaks at its time
    return BSpline(t[0] + (t[1] - t[0]) * (np.arange(len(control) + 4) - 4.0), control, 3)


def _simulate_footstep(step: Footstep, t: Array, lift: Array, p_foot: Array, R_foot: Array) -> Footstep:
    """Footstep with the simulated times of contact and the simulated footprint, in place of the planned ones.

    The planned footstep comes back if the simulated foot is never on the ground in that time.

    Args:
        step: The planned footstep.
        t: (N,) s.
        lift: (N,) N, vertical force on this foot.
        p_foot: (N, 3) m, origin of the foot in the world.
        R_foot: (N, 3, 3) rotation of the foot.
    """
    loaded = lift > _LOADED_N
    touch_downs = np.flatnonzero(loaded[1:] & ~loaded[:-1]) + 1  # rows at which the load begins
    toe_offs = np.flatnonzero(~loaded[1:] & loaded[:-1]) + 1  # and at which it ends
    touch = _nearest_event_time(t, touch_downs, step.t_touch)
    off = _nearest_event_time(t, toe_offs, step.t_off)
    during = np.flatnonzero((t >= touch) & (t <= off))
    if not len(during):
        return step
    # the foot is flat where the sole's normal agrees best with the ground's: largest cosine between the third columns
    agreement = np.einsum("nij,ij->n", R_foot[during][:, :, 2:], step.R_world_sole[:, 2:])
    flat = during[np.argmax(agreement)]
    R_world_sole = _project_on_ground(R_foot[flat], step.R_world_sole[:, 2])
    return replace(step, t_touch=touch, t_off=off, p_foot_in_world=p_foot[flat], R_world_sole=R_world_sole)


def _project_on_ground(R_world_foot: Array, normal: Array) -> Array:
    """(3, 3) rotation of a foot projected onto its ground: a loaded rubber sole is tilted by up to 0.3°.

    Args:
        R_world_foot: (3, 3) rotation of the foot.
        normal: (3,) unit normal of the ground in the world; it becomes the z axis.
    """
    forward = R_world_foot[:, 0] - (R_world_foot[:, 0] @ normal) * normal
    forward /= np.linalg.norm(forward)
    return np.column_stack([forward, np.cross(normal, forward), normal])


def _nearest_event_time(t: Array, events: NDArray[np.int64], planned: float) -> float:
    """Time of the event nearest to a planned time, s; the planned time if none is within `_EARLY_OR_LATE_S`.

    Args:
        t: (N,) s.
        events: (K,) rows of `t` at which such an event occurs.
        planned: Planned time, s; ±inf, for feet that stand at the start or the end, comes back as it is.
    """
    if not np.isfinite(planned) or not len(events):
        return planned
    nearest = float(t[events[np.abs(t[events] - planned).argmin()]])
    return nearest if abs(nearest - planned) < _EARLY_OR_LATE_S else planned


def _foot_pitch(steps: list[Footstep], t: Array, R_foot: Array) -> Array:
    """(N,) rad, pitch of one foot against the ground of its current or next footstep, toes down positive.

    Args:
        steps: Footsteps of the foot in order of time.
        t: (N,) s.
        R_foot: (N, 3, 3) rotation of the foot, foot to world.
    """
    # (N,) number of the footstep: the first whose toe-off is still to come, or the last one
    i = np.clip(np.searchsorted([s.t_off for s in steps], t), 0, len(steps) - 1)
    # direction of the toes in the axes of the ground
    R_ground = np.array([s.R_world_sole for s in steps])[i]
    toes = np.einsum("nji,nj->ni", R_ground, R_foot[:, :, 0])
    return -np.arcsin(np.clip(toes[:, 2], -1.0, 1.0))


class Replay(Player[SimulatedWalk]):
    """Player of a simulated walk, with the loads that the simulation recorded."""

    def loads(self, t_ns: NDArray[np.int64], motion: Motion) -> Loads:
        """Contact loads and joint torques at (N,) instants, as the simulation recorded them.

        The residual is the assistance at the root alone. `motion` is not read: it is an argument because the loads of a
        `Playback` follow from it.
        """
        t = t_ns * 1e-9
        torque, force, moment = self._walk.efforts(t)
        names = self._walk.coordinates.names[6:]  # the joints, in the order of the columns of `torque`
        motors = {name: torque[:, k] for k, name in enumerate(names) if name.startswith("exo_")}
        return Loads(
            t_ns=t_ns,
            feet=self._walk.feet(t),
            joint_torque=torque,
            residual_force=force,
            residual_torque=moment,
            motors=motors,
        )
