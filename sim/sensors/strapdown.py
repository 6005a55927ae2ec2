"""Interval means of rate and specific force that strapdown integration turns back into the motion."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.sim.rotation import cross
from stridetwin.sim.track import Track
from stridetwin.streams.samples import Array


def increments(before: Track, sensor: Track, gravity: Array) -> tuple[Array, Array, Array]:
    """Constant rate and specific force over each interval.

    The rate is the constant one that turns the attitude at an interval's start into that at its end; the specific force
    is the constant one, in the turning sensor frame, that makes the velocity's true change: with φ = Log(R₀ᵀR₁) the
    velocity changes by R₀ Γ₁(φ) f Δt + g Δt, where Γ₁ is the left Jacobian of SO(3).

    Args:
        before: One instant, the start of the first interval.
        sensor: N ends of intervals.
        gravity: (3,) in the world, m/s².

    Returns:
        (N, 1) s, (N, 3) rad/s and (N, 3) m/s², in the sensor frame.
    """
    dt = np.diff(sensor.t_ns, prepend=before.t_ns)[:, None] * 1e-9
    rotation = Rotation.concatenate([before.rotation, sensor.rotation])
    velocity = np.concatenate([before.v_body_in_world, sensor.v_body_in_world])
    start = rotation[:-1].inv()
    phi = (start * rotation[1:]).as_rotvec()
    push = start.apply(np.diff(velocity, axis=0) / dt - gravity)
    return dt, phi / dt, _left_jacobian_inverse_times(phi, push)


def joined(dt: Array, rate: Array, force: Array, steps: int) -> tuple[Array, Array]:
    """One rate and force for every `steps` intervals, free of coning and sculling: same turn, same change of velocity.

    Args:
        dt: (N, 1) s.
        rate: (N, 3) rad/s.
        force: (N, 3) m/s².
        steps: Divides N.

    Returns:
        (N / steps, 3) rad/s and (N / steps, 3) m/s².
    """
    dt, rate, force = (a.reshape(-1, steps, a.shape[1]) for a in (dt, rate, force))
    phi = rate * dt
    push = _left_jacobian_times(phi, force * dt)
    turned = Rotation.identity(len(dt))
    change = np.zeros((len(dt), 3))
    for k in range(steps):
        change += turned.apply(push[:, k])
        turned = turned * Rotation.from_rotvec(phi[:, k])
    whole, total = dt.sum(axis=1), turned.as_rotvec()
    return total / whole, _left_jacobian_inverse_times(total, change / whole)


def steadily_before(sensor: Track, steps: int, dt: float) -> Track:
    """`steps` instants before the track's first, `dt` apart, had rate and velocity been constant until then."""
    first = sensor[:1]
    ago = dt * np.arange(steps, 0, -1)[:, None]
    return Track(
        t_ns=first.t_ns - np.round(ago[:, 0] * 1e9).astype(np.int64),
        p_body_in_world=first.p_body_in_world - ago * first.v_body_in_world,
        q_world_body=(first.rotation * Rotation.from_rotvec(-ago * first.w_body)).as_quat(scalar_first=True),
        v_body_in_world=np.repeat(first.v_body_in_world, steps, axis=0),
        w_body=np.repeat(first.w_body, steps, axis=0),
    )


def _left_jacobian_times(phi: Array, v: Array) -> Array:
    """(..., 3): Γ₁(φ) v = v + (1 − cos θ)/θ² φ×v + (θ − sin θ)/θ³ φ×(φ×v) (Barfoot 2017, eq. 7.37)."""
    theta = np.linalg.norm(phi, axis=-1, keepdims=True)
    safe = np.maximum(theta, 1e-4)
    a = np.where(theta < 1e-4, 0.5, (1 - np.cos(safe)) / safe**2)
    b = np.where(theta < 1e-4, 1 / 6, (safe - np.sin(safe)) / safe**3)
    once = cross(phi, v)
    return v + a * once + b * cross(phi, once)


def _left_jacobian_inverse_times(phi: Array, v: Array) -> Array:
    """(N, 3): Γ₁(φ)⁻¹ v = v − φ×v/2 + c φ×(φ×v), c = (1 − (θ/2) cot(θ/2)) / θ² (Barfoot 2017, eq. 7.37)."""
    theta = np.linalg.norm(phi, axis=-1, keepdims=True)
    half = np.maximum(theta, 1e-4) / 2
    c = np.where(theta < 1e-4, 1 / 12, (1 - half / np.tan(half)) / (4 * half**2))
    once = cross(phi, v)
    return v - once / 2 + c * cross(phi, once)
