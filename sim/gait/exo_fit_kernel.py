"""Compiled loops of `exo_fit`: a leg of the frame on its couplings at every instant, and its motion over time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.algebra.tuples import (
    Vec3,
    cross,
    dot,
    mat3,
    matmul,
    matvec,
    minus,
    plus,
    rotation_about,
    store_mat3,
    store_vec3,
    store_vec3_at,
    times,
    transposed,
    vec3,
    vec3_at,
)
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(__file__, llvm_level=1)

_FAR = 40.0  # this many widths before a stop its torque is below rounding
# Steps below which nothing is gained: the fit converges linearly, the march quadratically in the step relative to the
# width of a stop.
_FIT_TOLERANCE_RAD, _STEP_TOLERANCE_RAD = 1e-4, 1e-6


class CoupledLeg(NamedTuple):
    """A leg of the frame, a chain of J joints, and its C couplings to the wearer.

    Attributes:
        offsets: (J, 3) m, origin of each body in its parent's frame.
        axes: (J, 3) of its joint, unit vectors.
        last: (C,) body of the leg that each coupling holds.
        p_in_exo: (C, 3) m, attachment in that body's frame.
        p_in_body: (C, 3) m, attachment in the frame of the wearer's body.
        stiffness: (C, 2, 3, 3) of displacement, N/m, and rotation, N m/rad.
        damping: (C, 2, 3, 3) N s/m, N m s/rad.
        stops: (J, 2) rad, lower and upper.
        stop: (2,) stiffness of a stop, N m/rad, and the width over which it engages, rad.
    """

    offsets: Array
    axes: Array
    last: NDArray[np.int64]
    p_in_exo: Array
    p_in_body: Array
    stiffness: Array
    damping: Array
    stops: Array
    stop: Array


@_entry_kernel
def strains(leg: CoupledLeg, q: Array, p: Array, R: Array) -> tuple[Array, Array]:
    """Strains of the couplings at N instants, and their Jacobian by the joint angles.

    Args:
        leg: The leg.
        q: (N, J) rad.
        p: (N, C, 3) m, origin of the wearer's body at each coupling, in the pelvis' frame.
        R: (N, C, 3, 3) rotation of that body.

    Returns:
        (N, 6 C) displacement, m, and rotation (sine of the angle) of each coupling; (N, 6 C, J) their Jacobian.
    """
    n, count, dofs = len(q), 6 * len(leg.last), len(leg.axes)  # N, 6 C and J
    # strains and Jacobian, then buffers of one instant for the origins, rotations and joint axes of the leg's bodies
    value, jacobian = np.empty((n, count)), np.zeros((n, count, dofs))
    pivots, rotations, axes = np.empty((dofs, 3)), np.empty((dofs, 3, 3)), np.empty((dofs, 3))
    for i in range(n):
        _compute_strain(leg, q[i], p[i], R[i], value[i], jacobian[i], pivots, rotations, axes)
    return value, jacobian


@_entry_kernel
def fit_angles(leg: CoupledLeg, q: Array, p: Array, R: Array, iterations: int) -> None:
    """Moves (N, J) angles to the least energy of couplings and stops, by the Gauss-Newton method.

    The energy is E(q) = ½ Σ εᵀ K ε + stops(q) with the strains ε of `strains`. Each iteration solves (Jᵀ K J + stops'')
    Δ = Jᵀ K ε + stops' and subtracts Δ; it ends when no angle changes by more than `_FIT_TOLERANCE_RAD`. The instants
    are consecutive: from the second on, the step of the previous instant is the initial step.

    Args:
        leg: The leg.
        q: (N, J) rad, start values; they are overwritten by the result.
        p: (N, C, 3) m, origin of the wearer's body at each coupling, in the pelvis' frame.
        R: (N, C, 3, 3) rotation of that body.
        iterations: Most iterations per instant.
    """
    dofs = len(leg.axes)
    # strains and Jacobian of one instant, then buffers for origins, rotations and joint axes of the leg's bodies
    value, jacobian = np.empty(6 * len(leg.last)), np.zeros((6 * len(leg.last), dofs))
    pivots, rotations, axes = np.empty((dofs, 3)), np.empty((dofs, 3, 3)), np.empty((dofs, 3))
    # `step` is first the gradient of the energy, then the step Δ; `last_step` is the whole change at the instant before
    step, hessian, last_step, guess = np.empty(dofs), np.empty((dofs, dofs)), np.zeros(dofs), np.empty(dofs)
    for i in range(len(q)):
        guess[:] = q[i]
        q[i] += last_step  # as far from its start value as the instant before
        for _ in range(iterations):
            _compute_strain(leg, q[i], p[i], R[i], value, jacobian, pivots, rotations, axes)
            _project_instant(leg.last, leg.stiffness, jacobian, value, step, hessian)
            for j in range(dofs):
                torque, slope = stop_torque(leg, j, q[i, j])
                step[j] += torque
                hessian[j, j] += slope
            _solve(hessian, step)
            q[i] -= step
            if _max_abs(step) < _FIT_TOLERANCE_RAD:
                break
        last_step[:] = q[i]
        last_step -= guess


@_entry_kernel
def project_on_joints(leg: CoupledLeg, law: Array, jacobian: Array, value: Array) -> tuple[Array, Array]:
    """Torques Jᵀ L x (N, J) of the couplings on the joints, and the matrices Jᵀ L J (N, J, J).

    With the stiffness as L and the strains as x it is the gradient of the elastic energy and its Hessian; with the
    damping as L and the strain rates as x it is the damping torque and the damping matrix.

    Args:
        leg: The leg.
        law: (C, 2, 3, 3) gains L of displacement and rotation.
        jacobian: (N, 6 C, J) of the strains.
        value: (N, 6 C) strains or their rates x.
    """
    n, dofs = len(value), len(leg.axes)
    torque, matrix = np.empty((n, dofs)), np.empty((n, dofs, dofs))
    for i in range(n):
        _project_instant(leg.last, law, jacobian[i], value[i], torque[i], matrix[i])
    return torque, matrix


@_entry_kernel
def integrate_motion(
    leg: CoupledLeg, mass: Array, damp: Array, stiff: Array, force: Array, angles: Array, dt: float, iterations: int
) -> Array:
    """(N, J) rad, solution x of M x'' + C x' + K x + stops(angles + x) = f, from rest in static balance.

    Newmark's method with constant average acceleration (β = 1/4, γ = 1/2): each step solves (4/Δt² M + 2/Δt C + K) x₁ +
    stops(angles + x₁) = f + M (4/Δt² x₀ + 4/Δt v₀ + a₀) + C (2/Δt x₀ + v₀) by Newton's method, where the stops are the
    nonlinear part.

    Args:
        leg: The leg, for its stops.
        mass: (N, J, J) kg m², M.
        damp: (N, J, J) N m s/rad, C.
        stiff: (N, J, J) N m/rad, K.
        force: (N, J) N m, f.
        angles: (N, J) rad, angles about which the motion is linearised.
        dt: Time between rows, s.
        iterations: Most Newton iterations per step.
    """
    n, dofs = force.shape
    # position x, velocity v and acceleration a belong to the row before, `new` is the position of the present row
    path, x, v, a = np.empty((n, dofs)), np.zeros(dofs), np.zeros(dofs), np.zeros(dofs)
    matrix, right, new = np.empty((dofs, dofs)), np.empty(dofs), np.zeros(dofs)
    residual, jacobian = np.empty(dofs), np.empty((dofs, dofs))
    per, per2 = 2.0 / dt, 4.0 / dt**2  # 2/Δt and 4/Δt² of Newmark's equation
    # static balance in the first row
    _solve_with_stops(leg, stiff[0], force[0], angles[0], x, residual, jacobian, iterations)
    path[0] = x
    for i in range(1, n):
        # matrix and right side of Newmark's equation, and x + Δt v + Δt²/2 a as the first guess
        for j in range(dofs):
            right[j] = force[i, j]
            for k in range(dofs):
                matrix[j, k] = stiff[i, j, k] + per * damp[i, j, k] + per2 * mass[i, j, k]
                right[j] += mass[i, j, k] * (per2 * x[k] + 2.0 * per * v[k] + a[k])
                right[j] += damp[i, j, k] * (per * x[k] + v[k])
            new[j] = x[j] + dt * (v[j] + 0.5 * dt * a[j])
        _solve_with_stops(leg, matrix, right, angles[i], new, residual, jacobian, iterations)
        # acceleration and velocity that belong to the new position
        for j in range(dofs):
            a_new = per2 * (new[j] - x[j]) - 2.0 * per * v[j] - a[j]
            v[j] += 0.5 * dt * (a[j] + a_new)
            a[j], x[j] = a_new, new[j]
        path[i] = new
    return path


@numba.njit(**INNER_KERNEL)
def stop_torque(leg: CoupledLeg, j: int, angle: float) -> tuple[float, float]:
    """Torque of a joint's stops, N m, and its slope by the angle, N m/rad.

    It is k w (ln(1 + exp(over)) − ln(1 + exp(under))), the gradient of a smooth energy. `over` and `under` are the
    distances beyond the upper and the lower stop in widths w, and k is the stiffness. The torque is positive beyond the
    upper stop: it stands on the left side of the equations of motion.

    Args:
        leg: The leg.
        j: Number of the joint.
        angle: rad.
    """
    stiffness, width = leg.stop
    over, under = (angle - leg.stops[j, 1]) / width, (leg.stops[j, 0] - angle) / width
    torque, slope = 0.0, 0.0
    # both stops: ln(1 + exp(x)) = max(x, 0) + ln(1 + exp(-|x|)), which does not overflow, and its slope
    for x, sign in ((over, 1.0), (under, -1.0)):
        if x > -_FAR:  # otherwise the torque is 0 within rounding
            fading = math.exp(-abs(x))
            torque += sign * (max(x, 0.0) + math.log1p(fading))
            slope += (1.0 if x > 0.0 else fading) / (1.0 + fading)
    return stiffness * width * torque, stiffness * slope


@numba.njit(**INNER_KERNEL)
def _solve_with_stops(
    leg: CoupledLeg,
    matrix: Array,
    right: Array,
    angles: Array,
    x: Array,
    residual: Array,
    jacobian: Array,
    iterations: int,
) -> None:
    """Moves x to the solution of A x + stops(angles + x) = b by Newton's method.

    Args:
        leg: The leg, for its stops.
        matrix: (J, J) A.
        right: (J,) b, N m.
        angles: (J,) rad, from which x counts.
        x: (J,) rad, first guess, which is overwritten by the solution.
        residual: (J,) buffer, so that the loop over time allocates nothing.
        jacobian: (J, J) buffer.
        iterations: Most iterations.
    """
    dofs = len(x)
    for _ in range(iterations):
        for j in range(dofs):
            torque, slope = stop_torque(leg, j, angles[j] + x[j])
            residual[j] = right[j] - torque
            for k in range(dofs):
                jacobian[j, k] = matrix[j, k]
                residual[j] -= matrix[j, k] * x[k]
            jacobian[j, j] += slope
        _solve(jacobian, residual)  # the residual becomes the Newton step
        x += residual
        if _max_abs(residual) < _STEP_TOLERANCE_RAD:
            break


@numba.njit(**INNER_KERNEL)
def _max_abs(step: Array) -> float:
    """Largest magnitude of (J,) steps."""
    largest = 0.0
    for size in step:
        largest = max(largest, abs(size))
    return largest


@numba.njit(**INNER_KERNEL)
def _compute_strain(
    leg: CoupledLeg,
    q: Array,
    p: Array,
    R: Array,
    value: Array,
    jacobian: Array,
    pivots: Array,
    rotations: Array,
    axes: Array,
) -> None:
    """Writes the strains (6 C,) of the couplings and their Jacobian (6 C, J) at one instant.

    For each coupling the displacement is R_eᵀ (p_point − p_e) − p_in_exo. The rotation is the vector part of
    R = R_eᵀ R_body, ½ (R₃₂ − R₂₃, R₁₃ − R₃₁, R₂₁ − R₁₂). Both are in the axes of the exoskeleton's body e.

    Args:
        leg: The leg.
        q: (J,) rad, its angles.
        p: (C, 3) m, origin of the wearer's body at each coupling, in the pelvis' frame.
        R: (C, 3, 3) rotation of that body.
        value: (6 C,) output, strains.
        jacobian: (6 C, J) output; entries of joints beyond a coupling's body stay 0.
        pivots: (J, 3) buffer for the origins of the leg's bodies in the pelvis' frame, m.
        rotations: (J, 3, 3) buffer for their rotations.
        axes: (J, 3) buffer for the joint axes in the pelvis' frame.
    """
    # frames and joint axes of the leg's bodies, from the pelvis outwards: origin `at` and rotation M of the present one
    at, M = (0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    for j in range(len(leg.axes)):
        at = plus(at, matvec(M, vec3(leg.offsets[j])))
        axis_in_body = vec3(leg.axes[j])
        store_vec3(at, pivots[j])
        store_vec3(matvec(M, axis_in_body), axes[j])
        M = matmul(M, rotation_about(axis_in_body, q[j]))
        store_mat3(M, rotations[j])
    for c in range(len(leg.last)):
        last = leg.last[c]
        to_exo, R_body = transposed(mat3(rotations[last])), mat3(R[c])  # pelvis to exoskeleton; wearer's body to pelvis
        # strain: the wearer's point and rotation as the exoskeleton's body sees them
        point = plus(vec3(p[c]), matvec(R_body, vec3(leg.p_in_body[c])))
        displacement = minus(matvec(to_exo, minus(point, vec3(pivots[last]))), vec3(leg.p_in_exo[c]))
        x, y, z = matmul(to_exo, R_body)  # rows of R: rotation of the wearer's body as seen from the exoskeleton's
        store_vec3_at(displacement, value, 6 * c)
        store_vec3_at(times(0.5, (z[1] - y[2], x[2] - z[0], y[0] - x[1])), value, 6 * c + 3)
        trace = x[0] + y[1] + z[2]
        for j in range(last + 1):  # as the frame rotates, the wearer's point moves the opposite way in its axes
            axis = vec3(axes[j])
            # columns of the Jacobian: −axis × (point − pivot), and ½ (R axis − tr(R) axis)
            moves = matvec(to_exo, cross(minus(point, vec3(pivots[j])), axis))
            turn = matvec(to_exo, axis)
            twists = times(0.5, minus(matvec((x, y, z), turn), times(trace, turn)))
            for k in range(3):
                jacobian[6 * c + k, j] = moves[k]
                jacobian[6 * c + 3 + k, j] = twists[k]


@numba.njit(**INNER_KERNEL)
def _project_instant(
    last: NDArray[np.int64], law: Array, jacobian: Array, value: Array, torque: Array, matrix: Array
) -> None:
    """Writes Jᵀ L x into `torque` (J,) and Jᵀ L J into `matrix` (J, J), for one instant.

    A coupling acts only on the joints up to the body that it holds.

    Args:
        last: (C,) body of the leg that each coupling holds.
        law: (C, 2, 3, 3) gains L of displacement and rotation.
        jacobian: (6 C, J) of the strains.
        value: (6 C,) strains or their rates x.
        torque: Output.
        matrix: Output, symmetric.
    """
    torque[:], matrix[:] = 0.0, 0.0
    for c in range(len(last)):
        for part in range(2):  # displacement, then rotation: three rows each of strains and Jacobian
            gains, first = mat3(law[c, part]), 6 * c + 3 * part
            strain = vec3_at(value, first)
            for j in range(last[c] + 1):
                weighted = matvec(gains, _column(jacobian, first, j))
                torque[j] += dot(weighted, strain)
                for k in range(j + 1):
                    matrix[j, k] += dot(weighted, _column(jacobian, first, k))
    for j in range(len(torque)):  # only the lower triangle is filled so far
        for k in range(j):
            matrix[k, j] = matrix[j, k]


@numba.njit(**INNER_KERNEL)
def _column(jacobian: Array, first: int, j: int) -> Vec3:
    """The three entries of column j of a Jacobian (rows, J) in the rows `first` to `first` + 2."""
    return jacobian[first, j], jacobian[first + 1, j], jacobian[first + 2, j]


@numba.njit(**INNER_KERNEL)
def _solve(A: Array, b: Array) -> None:
    """Solves A x = b (A symmetric positive definite) by Cholesky's method in place; b becomes x, A is overwritten.

    It multiplies by the reciprocals of the diagonal where `matrices.solve_positive` divides: faster in the innermost
    loop of this file, with other last digits.
    """
    dofs = len(b)
    # factor L with the reciprocals of its diagonal, in the lower triangle of A; b becomes L⁻¹ b
    for j in range(dofs):
        for k in range(j):
            A[j, j] -= A[j, k] * A[j, k]
        A[j, j] = 1.0 / math.sqrt(A[j, j])
        for i in range(j + 1, dofs):
            for k in range(j):
                A[i, j] -= A[i, k] * A[j, k]
            A[i, j] *= A[j, j]
        for k in range(j):
            b[j] -= A[j, k] * b[k]
        b[j] *= A[j, j]
    # b becomes L⁻ᵀ L⁻¹ b
    for j in range(dofs - 1, -1, -1):
        for k in range(j + 1, dofs):
            b[j] -= A[k, j] * b[k]
        b[j] *= A[j, j]
