"""IMU factors of the window: preintegration between frames and zero velocity, added to the equations H d = b.

Preintegration follows Zhao 2023 (7), after Forster et al. 2017. A sample is the mean over the interval that ends at its
stamp, so rate and force are constant over it; the changes of attitude, velocity and position over it are exact to the
third order of its rotation.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.dvio import state
from stridetwin.streams.algebra.matrices import (
    apply,
    apply_inverse,
    clear,
    copy,
    copy_matrix,
    empty_mat3,
    empty_vec3,
    exp,
    hat,
    identity,
    log,
    multiply,
    right_jacobian,
    right_jacobian_inverse,
    transform_covariance,
    transposed,
)
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array


@njit(error_model="numpy", **INNER_KERNEL)
def reset(z: state.Preintegration, bias: Array) -> None:
    """Resets a measurement to zero duration, at the biases (6,) of gyroscope (rad/s) and accelerometer (m/s²)."""
    z.dt[0] = 0.0
    clear(z.delta_p)
    clear(z.delta_v)
    copy_matrix(identity(3), z.delta_R)
    z.by_bias[:] = 0.0
    z.covariance[:] = 0.0
    copy(bias, z.bias)


@njit(error_model="numpy", **INNER_KERNEL)
def advance(z: state.Preintegration, sample: Array, dt: float, rate_density: float, force_density: float) -> None:
    """Adds an interval of `dt` (s) of constant measured rate and force to a preintegrated measurement, in place.

    The measurement changes by docs/dvio.md (2), with the motion over the interval of docs/dvio.md (1); its covariance
    by docs/dvio.md (3), and its derivative `by_bias` in the same way.

    Args:
        z: Δp, Δv, ΔR with their covariance and their derivative by the biases.
        sample: (6,) angular rate, rad/s, and specific force, m/s².
        dt: Length of the interval, s.
        rate_density: White noise of the rate, rad/s/√Hz.
        force_density: White noise of the force, m/s²/√Hz.
    """
    # rotation φ over the interval, and force a, without the biases; G is ΔR before it
    phi, a, bias = empty_vec3(), empty_vec3(), z.bias
    for i in range(3):
        phi[i] = (sample[i] - bias[i]) * dt
        a[i] = sample[3 + i] - bias[3 + i]
    G, delta_v, delta_p = empty_mat3(), z.delta_v, z.delta_p
    copy_matrix(z.delta_R, G)
    X, A = hat(phi), hat(a)
    # X and A are the cross product matrices of φ and a; Xa is that of φ × a
    X2, XA, Xa = multiply(X, X), multiply(X, A), hat(apply(X, a))
    # δv = to_v a dt and δp = to_p a dt²: docs/dvio.md (1); and their derivatives by φ
    to_v, to_p, v_by_phi, p_by_phi = empty_mat3(), empty_mat3(), empty_mat3(), empty_mat3()
    for i in range(3):
        for j in range(3):
            one = 1.0 if i == j else 0.0
            both = XA[i, j] + Xa[i, j]
            to_v[i, j] = one + X[i, j] / 2.0 + X2[i, j] / 6.0
            to_p[i, j] = one / 2.0 + X[i, j] / 6.0 + X2[i, j] / 24.0
            v_by_phi[i, j] = -(A[i, j] / 2.0 + both / 6.0)
            p_by_phi[i, j] = -(A[i, j] / 6.0 + both / 24.0)
    dv, dp = apply(to_v, a), apply(to_p, a)
    for i in range(3):
        dv[i] *= dt
        dp[i] *= dt * dt
    rotation, Jr = exp(phi), right_jacobian(phi)
    p_by_turn, v_by_turn = multiply(G, hat(dp)), multiply(G, hat(dv))
    p_by_gyro, p_by_accel, v_by_gyro, v_by_accel = (
        multiply(G, p_by_phi),
        multiply(G, to_p),
        multiply(G, v_by_phi),
        multiply(G, to_v),
    )
    # derivatives of the new (Δp, ΔR, Δv), rows 0-2, 3-5 and 6-8, by the errors of the old ones, and by the biases of
    # gyroscope (columns 0-2) and accelerometer (3-5): docs/dvio.md (3)
    F, B = identity(9), np.zeros((9, 6))
    for i in range(3):
        F[i, 6 + i] = dt
        for j in range(3):
            F[i, 3 + j] = -p_by_turn[i, j]
            F[3 + i, 3 + j] = rotation[j, i]
            F[6 + i, 3 + j] = -v_by_turn[i, j]
            B[i, j] = -dt * dt * dt * p_by_gyro[i, j]
            B[i, 3 + j] = -dt * dt * p_by_accel[i, j]
            B[3 + i, j] = -dt * Jr[i, j]
            B[6 + i, j] = -dt * dt * v_by_gyro[i, j]
            B[6 + i, 3 + j] = -dt * v_by_accel[i, j]
    # White noise of density s is a bias of standard deviation s / √dt over the interval.
    by_rate, by_force = rate_density / math.sqrt(dt), force_density / math.sqrt(dt)
    P, by_bias = transform_covariance(F, z.covariance), multiply(F, z.by_bias)
    for i in range(9):
        for j in range(6):
            z.by_bias[i, j] = by_bias[i, j] + B[i, j]
        for j in range(9):
            rates = B[i, 0] * B[j, 0] + B[i, 1] * B[j, 1] + B[i, 2] * B[j, 2]
            forces = B[i, 3] * B[j, 3] + B[i, 4] * B[j, 4] + B[i, 5] * B[j, 5]
            z.covariance[i, j] = P[i, j] + by_rate * by_rate * rates + by_force * by_force * forces
    # Δp += Δv dt + ΔR δp, Δv += ΔR δv, ΔR <- ΔR Exp(φ): docs/dvio.md (2)
    for i in range(3):
        moved = delta_v[i] * dt
        for j in range(3):
            moved += G[i, j] * dp[j]
        delta_p[i] += moved
    for i in range(3):
        for j in range(3):
            delta_v[i] += G[i, j] * dv[j]
    copy_matrix(multiply(G, rotation), z.delta_R)
    z.dt[0] += dt


@njit(error_model="numpy", **INNER_KERNEL)
def _find_first_after(t_ns: NDArray[np.int64], time_ns: int) -> int:
    """Index of the first of the ascending stamps (N,) that is later than a time, N if none is; by bisection."""
    low, high = 0, t_ns.shape[0]
    while low < high:
        middle = (low + high) // 2
        if t_ns[middle] <= time_ns:
            low = middle + 1
        else:
            high = middle
    return low


@njit(error_model="numpy", **INNER_KERNEL)
def integrate(
    z: state.Preintegration, imu: state.ImuSamples, start_ns: int, end_ns: int, bias: Array, noise: state.ImuNoise
) -> None:
    """Preintegrates IMU samples into `z` from `start_ns` to `end_ns`, at the biases (6,), rad/s and m/s².

    The first sample must not be later than the start, and the last one not before the end. An interval within one
    sample is split into two, because the covariance of a single one is singular.
    """
    reset(z, bias)
    at, t_ns = start_ns, imu.t_ns
    i = _find_first_after(t_ns, start_ns)
    while at < end_ns and i < t_ns.shape[0]:
        until = min(t_ns[i], end_ns)
        if at == start_ns and until == end_ns:
            until = start_ns + (end_ns - start_ns) // 2  # the covariance of a single step is singular
        dt = (until - at) * 1e-9
        # squared density of the noise that is proportional to the rate, (rad/s/√Hz)²
        sample, motion_noise2 = imu.values[i], 0.0
        for k in range(3):
            motion_noise2 += (noise.rate_share * (sample[k] - bias[k])) ** 2
        rate_density, force_density = math.sqrt(noise.rate**2 + motion_noise2), noise.force
        if imu.invalid[i]:
            # A constant error over the interval has the density of its standard deviation times √dt.
            rate_density += noise.invalid_rate * math.sqrt(dt)
            force_density += noise.invalid_force * math.sqrt(dt)
        advance(z, sample, dt, rate_density, force_density)
        at = until
        i += at == t_ns[i]  # the next sample, once the end of this one's interval is reached


@njit(error_model="numpy", **INNER_KERNEL)
def _relative_motion(
    R: Array, pi: Array, vi: Array, pj: Array, vj: Array, dt: float, gravity: float, p: Array, v: Array
) -> None:
    """Motion from frame i to frame j in the axes of i, without gravity: two terms of docs/dvio.md (4).

    Writes R_iᵀ (p_j − p_i − v_i t − g t²/2) into `p` (3,), m, and R_iᵀ (v_j − v_i − g t) into `v` (3,), m/s, for the
    frames' positions and velocities in the world, R_i = `R` (3, 3) world <- IMU of frame i, `dt` = t in s, and g = (0,
    0, −`gravity`) m/s².
    """
    by_p, by_v = empty_vec3(), empty_vec3()
    for i in range(3):
        g = -gravity if i == 2 else 0.0
        by_p[i] = pj[i] - pi[i] - vi[i] * dt - 0.5 * g * dt * dt
        by_v[i] = vj[i] - vi[i] - g * dt
    copy(apply_inverse(R, by_p), p)
    copy(apply_inverse(R, by_v), v)


@njit(error_model="numpy", **INNER_KERNEL)
def imu_residual(window: state.WindowState, k: int, factors: state.FactorParameters, r: Array, J: Array) -> None:
    """IMU residual between frame k and the next one, and its Jacobian.

    The residual is docs/dvio.md (4): the motion between the two frames minus the preintegrated one, which is corrected
    for the change of the biases since its integration.

    Args:
        window: Frames and preintegrated measurements.
        k: Slot of the earlier frame.
        factors: Gravity, and whether frames in the prior keep their first linearisation point.
        r: (9,) out: residual of position (m), rotation (rad) and velocity (m/s).
        J: (9, 30) out: derivative by the error states of frame k, then of frame k + 1.
    """
    frames, zs, gravity = window.frames, window.preintegrations, factors.gravity
    # z_by_bias: (9, 6) derivative of the measured position, rotation and velocity by the biases
    dt, in_prior, z_by_bias = zs.dt[k, 0], frames.in_prior, zs.by_bias[k]
    Ri, Rj = frames.R[k], frames.R[k + 1]
    pi, vi, pj, vj = frames.p[k], frames.v[k], frames.p[k + 1], frames.v[k + 1]
    bias_correction, rotation, p, v = np.zeros(9), empty_vec3(), empty_vec3(), empty_vec3()
    for i in range(9):
        for j in range(6):
            bias_correction[i] += z_by_bias[i, j] * (frames.bias[k, j] - zs.bias[k, j])
    for i in range(3):
        rotation[i] = bias_correction[3 + i]
    _relative_motion(Ri, pi, vi, pj, vj, dt, gravity, p, v)
    expected = multiply(zs.delta_R[k], exp(rotation))  # ΔR Exp(J_R δb)
    e = log(multiply(transposed(expected), multiply(transposed(Ri), Rj)))
    for i in range(3):
        r[i] = p[i] - zs.delta_p[k, i] - bias_correction[i]
        r[3 + i] = e[i]
        r[6 + i] = v[i] - zs.delta_v[k, i] - bias_correction[6 + i]
    # The residual is of the present states; the Jacobian of frames in the prior is at their first estimates.
    if factors.first_estimates and in_prior[k]:
        Ri, pi, vi = frames.R_first[k], frames.p_first[k], frames.v_first[k]
    if factors.first_estimates and in_prior[k + 1]:
        Rj, pj, vj = frames.R_first[k + 1], frames.p_first[k + 1], frames.v_first[k + 1]
    _relative_motion(Ri, pi, vi, pj, vj, dt, gravity, p, v)
    inverse, P, V = right_jacobian_inverse(e), hat(p), hat(v)
    by_turn = multiply(inverse, multiply(transposed(Rj), Ri))
    # derivative of Log(Exp(-Jr(rotation) B db) E) by B db, with E = Exp(e) and B db the rotation by a bias error
    by_rotation = multiply(inverse, multiply(transposed(exp(e)), right_jacobian(rotation)))
    J[:] = 0.0
    n = state.FRAME  # first column of frame k + 1
    for i in range(3):
        for j in range(3):
            J[i, state.D_POSITION + j] = -Ri[j, i]
            J[i, state.D_ATTITUDE + j] = P[i, j]
            J[i, state.D_VELOCITY + j] = -Ri[j, i] * dt
            J[i, n + state.D_POSITION + j] = Ri[j, i]
            J[3 + i, state.D_ATTITUDE + j] = -by_turn[i, j]
            J[3 + i, n + state.D_ATTITUDE + j] = inverse[i, j]
            J[6 + i, state.D_ATTITUDE + j] = V[i, j]
            J[6 + i, state.D_VELOCITY + j] = -Ri[j, i]
            J[6 + i, n + state.D_VELOCITY + j] = Ri[j, i]
        for j in range(6):  # the biases of gyroscope and accelerometer, whose columns follow each other
            by_bias = (
                by_rotation[i, 0] * z_by_bias[3, j]
                + by_rotation[i, 1] * z_by_bias[4, j]
                + by_rotation[i, 2] * z_by_bias[5, j]
            )
            J[i, state.D_GYRO_BIAS + j] = -z_by_bias[i, j]
            J[3 + i, state.D_GYRO_BIAS + j] = -by_bias
            J[6 + i, state.D_GYRO_BIAS + j] = -z_by_bias[6 + i, j]


@njit(error_model="numpy", **INNER_KERNEL)
def add_imu_factor(window: state.WindowState, k: int, factors: state.FactorParameters, H: Array, b: Array) -> float:
    """Adds the IMU factor between frame k and the next one to H and b; returns its cost ½ rᵀ Σ⁻¹ r.

    H += Jᵀ Σ⁻¹ J and b −= Jᵀ Σ⁻¹ r for the residual r of `imu_residual` (Zhao 2023 (9)). The random walk of the biases
    is a second residual, b_(k+1) − b_k, of variance walk² dt.

    Args:
        window: Frames and preintegrated measurements.
        k: Slot of the earlier frame.
        factors: Gravity, random walks, and whether first estimates are used.
        H: (N, N) normal equations of all states, changed in place; of the factor only the lower triangle is added.
        b: (N,) right-hand side, changed in place.
    """
    r, J = np.empty(9), np.empty((9, 2 * state.FRAME))
    imu_residual(window, k, factors, r, J)
    frames, weight = window.frames, window.preintegrations.weight[k]
    WJ = multiply(weight, J)  # Σ⁻¹ J
    o = state.CALIBRATION + state.FRAME * k  # first index of frame k
    cost = 0.0
    for i in range(9):
        wr = 0.0
        for j in range(9):
            wr += weight[i, j] * r[j]
        cost += 0.5 * r[i] * wr
        for a in range(2 * state.FRAME):
            g = J[i, a]
            if g == 0.0:
                continue
            b[o + a] -= g * wr  # b -= Jᵀ Σ⁻¹ r, H += Jᵀ Σ⁻¹ J
            row = H[o + a]
            for c in range(a + 1):
                row[o + c] += g * WJ[i, c]
    dt = window.preintegrations.dt[k, 0]
    for i in range(6):  # random walk of the biases: 0-2 of the gyroscope, 3-5 of the accelerometer
        walk = factors.rate_walk if i < 3 else factors.force_walk
        w = 1.0 / (walk * walk * dt)
        step = frames.bias[k + 1, i] - frames.bias[k, i]
        at = o + state.D_GYRO_BIAS + i
        H[at, at] += w
        H[at + state.FRAME, at + state.FRAME] += w
        H[at + state.FRAME, at] -= w
        b[at] += w * step
        b[at + state.FRAME] -= w * step
        cost += 0.5 * w * step * step
    return cost


@njit(error_model="numpy", **INNER_KERNEL)
def add_zero_velocity(v: Array, sd: float, at: int, H: Array, b: Array) -> float:
    """Adds the zero-velocity update of one frame to H and b; returns its cost ½ |v|²/σ².

    Args:
        v: (3,) velocity of the frame, m/s.
        sd: σ, m/s; inf for a frame that is not known to be stationary: nothing is added.
        at: Row of the frame's velocity error in H and b.
        H: (N, N) changed in place.
        b: (N,) changed in place.
    """
    if not math.isfinite(sd):
        return 0.0
    w, cost = 1.0 / sd**2, 0.0
    for i in range(3):
        H[at + i, at + i] += w
        b[at + i] -= w * v[i]
        cost += 0.5 * w * v[i] ** 2
    return cost


@njit(error_model="numpy", **INNER_KERNEL)
def add_imu_factors(
    window: state.WindowState, factors: state.FactorParameters, frames: int, H: Array, b: Array
) -> float:
    """Adds IMU factors and zero-velocity updates of the oldest `frames` to H (N, N) and b (N,); returns their cost.

    The IMU factor of a frame links it to the next one; the newest frame has none.
    """
    f, cost = window.frames, 0.0
    for k in range(frames):
        velocity = state.CALIBRATION + state.FRAME * k + state.D_VELOCITY  # row of the frame's velocity error
        cost += add_zero_velocity(f.v[k], f.zero_velocity_sd[k], velocity, H, b)
        if k + 1 < f.count[0]:
            cost += add_imu_factor(window, k, factors, H, b)
    return cost
