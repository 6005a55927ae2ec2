"""Motion of one frame over time, and of frames fixed to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from stridetwin.streams.algebra.arrays import to_quaternion
from stridetwin.streams.algebra.tuples import (
    apply,
    cross,
    exp,
    inverse,
    minus,
    multiply,
    plus,
    quaternion,
    store_quaternion,
    store_vec3,
    times,
    vec3,
)
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(__file__)

_Columns = tuple[Array, Array, Array, Array]
"""Position (N, 3), attitude (N, 4), velocity (N, 3) and rate (N, 3) of a frame, with the units of `Track`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Poses and velocities of a frame at N instants.

    Attributes:
        t_ns: (N,) int64, strictly increasing.
        p_body_in_world: (N, 3) m.
        q_world_body: (N, 4) unit quaternions (w, x, y, z).
        v_body_in_world: (N, 3) m/s of the origin, world axes.
        w_body: (N, 3) rad/s, the frame's own axes.
    """

    t_ns: NDArray[np.int64]
    p_body_in_world: Array
    q_world_body: Array
    v_body_in_world: Array
    w_body: Array

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, rows: slice | NDArray[np.integer]) -> Track:
        """Track of some of the instants: a slice, or increasing row numbers."""
        # every field has one row per instant
        return Track(**{name: values[rows] for name, values in vars(self).items()})

    def append_track(self, after: Track) -> Track:
        """This track followed by another one, whose instants are all later."""
        return Track(**{name: np.concatenate([values, getattr(after, name)]) for name, values in vars(self).items()})

    @property
    def rotation(self) -> Rotation:
        """Body to world, N of them."""
        return Rotation.from_quat(self.q_world_body, scalar_first=True)

    def to_sensor(self, T_body_sensor: ArrayLike) -> Track:
        """Track of a frame that is rigidly mounted on this one, such as that of a sensor.

        Args:
            T_body_sensor: (4, 4) from the sensor's frame to this one.
        """
        T = np.asarray(T_body_sensor, dtype=float)
        return self._with_columns(_to_sensor(*self._columns, to_quaternion(T[:3, :3]), T[:3, 3].copy()))

    def displace(
        self, pivot: Array, translation: Array, rotation: Array, velocity: Array, rotation_rate: Array
    ) -> Track:
        """Track of a frame with a small motion relative to this one: rotation about a pivot, and translation.

        Args:
            pivot: (3,) m, this frame's axes.
            translation: (N, 3) m, translation in this frame's axes.
            rotation: (N, 3) rad, rotation vector.
            velocity: (N, 3) m/s, rate of `translation`.
            rotation_rate: (N, 3) rad/s, rate of `rotation`; unless the two are parallel, `rotation` has to stay below
                some tenths of a radian.
        """
        return self._with_columns(
            _displace(
                *self._columns, pivot, *map(np.ascontiguousarray, (translation, rotation, velocity, rotation_rate))
            )
        )

    @property
    def _columns(self) -> _Columns:
        """(N, 3) position, (N, 4) attitude, (N, 3) velocity and (N, 3) rate, contiguous for compiled code."""
        p, v = np.ascontiguousarray(self.p_body_in_world), np.ascontiguousarray(self.v_body_in_world)
        return p, np.ascontiguousarray(self.q_world_body), v, np.ascontiguousarray(self.w_body)

    def _with_columns(self, columns: _Columns) -> Track:
        """Track at the instants of this one, with other position, attitude, velocity and rate."""
        p, q, v, w = columns
        return Track(t_ns=self.t_ns, p_body_in_world=p, q_world_body=q, v_body_in_world=v, w_body=w)

    def poses(self) -> Array:
        """(N, 4, 4) transforms, frame to world."""
        T = np.tile(np.eye(4), (len(self), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = self.rotation.as_matrix(), self.p_body_in_world
        return T


@_entry_kernel
def _to_sensor(p: Array, q: Array, v: Array, w: Array, q_body_sensor: Array, lever: Array) -> _Columns:
    """Position, attitude, velocity and rate of a frame that is rigidly mounted on a body.

    They are p + R l, q ⊗ q_bs, v + R (ω × l), and R_bsᵀ ω.

    Args:
        p: (N, 3) m, position of the body in the world.
        q: (N, 4) its attitude, body to world.
        v: (N, 3) m/s, its velocity, world axes.
        w: (N, 3) rad/s, its angular rate ω, own axes.
        q_body_sensor: (4,) q_bs, attitude of the mounted frame on the body.
        lever: (3,) m, l, its origin on the body.
    """
    n = len(p)
    p_out, q_out, v_out, w_out = np.empty((n, 3)), np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 3))
    arm, mount = vec3(lever), quaternion(q_body_sensor)
    to_sensor = inverse(mount)
    for i in range(len(p)):
        attitude, rate = quaternion(q[i]), vec3(w[i])
        store_vec3(plus(vec3(p[i]), apply(attitude, arm)), p_out[i])
        store_quaternion(multiply(attitude, mount), q_out[i])
        store_vec3(plus(vec3(v[i]), apply(attitude, cross(rate, arm))), v_out[i])
        store_vec3(apply(to_sensor, rate), w_out[i])
    return p_out, q_out, v_out, w_out


@_entry_kernel
def _displace(
    p: Array,
    q: Array,
    v: Array,
    w: Array,
    pivot: Array,
    translation: Array,
    rotation: Array,
    velocity: Array,
    rotation_rate: Array,
) -> _Columns:
    """Position, attitude, velocity and rate of a frame with a small motion relative to a body (`Track.displace`).

    Let φ be the rotation vector, E = Exp(φ), c the pivot and d the translation. The frame's origin is at
    r = c + d − E c in the body. Its relative rate is u = J_r(φ) φ̇, with the right Jacobian to second order. So the
    position is p + R r, the velocity is v + R (ω × r + ḋ − E (u × c)), and the rate in the frame's own axes is
    Eᵀ ω + u.

    Args:
        p: (N, 3) m, position of the body in the world.
        q: (N, 4) its attitude, body to world, R as a matrix.
        v: (N, 3) m/s, its velocity, world axes.
        w: (N, 3) rad/s, its angular rate ω, own axes.
        pivot: (3,) m, body axes.
        translation: (N, 3) m, body axes.
        rotation: (N, 3) rad, rotation vector.
        velocity: (N, 3) m/s, rate of the translation.
        rotation_rate: (N, 3) rad/s, rate of the rotation vector.
    """
    n = len(p)
    p_out, q_out, v_out, w_out = np.empty((n, 3)), np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 3))
    centre = vec3(pivot)
    for i in range(len(p)):
        attitude, rate, phi, phi_rate = quaternion(q[i]), vec3(w[i]), vec3(rotation[i]), vec3(rotation_rate[i])
        E = exp(phi)
        # u: right Jacobian of SO(3) to second order times φ̇, in the displaced frame's axes
        phi_cross_rate = cross(phi, phi_rate)
        u = plus(minus(phi_rate, times(0.5, phi_cross_rate)), times(1.0 / 6.0, cross(phi, phi_cross_rate)))
        r = minus(plus(centre, vec3(translation[i])), apply(E, centre))
        # velocity of the frame's origin relative to the body's, in the body's axes
        r_velocity = minus(plus(cross(rate, r), vec3(velocity[i])), apply(E, cross(u, centre)))
        store_vec3(plus(vec3(p[i]), apply(attitude, r)), p_out[i])
        store_quaternion(multiply(attitude, E), q_out[i])
        store_vec3(plus(vec3(v[i]), apply(attitude, r_velocity)), v_out[i])
        store_vec3(plus(apply(inverse(E), rate), u), w_out[i])
    return p_out, q_out, v_out, w_out
