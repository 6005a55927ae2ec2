"""Whole-body control: joint torques that track the reference with contact forces that the ground can provide.

At each step the joint accelerations minimise a weighted sum of squared deviations (joints, swing foot, stance, contact
points at rest) under the rows of the equations of motion that no motor drives: the six of the root, and the joints of
an unpowered exoskeleton, which are eliminated first. What remains is a problem in the contact forces alone,

    min over f >= 0 of ||B f - d||^2 + sum r_i (f_i - p_i)^2,   B with six rows,

whose dual in six unknowns is solved by Newton's method (Kuindersma et al. 2016, Auton. Robots 40, for the whole-body
problem; the elimination to six rows is ours).
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.algebra.matrices import (
    factorise_in_place,
    solve_positive,
    substitute_backward,
    substitute_forward,
)
from stridetwin.streams.compiled import INNER_KERNEL
from stridetwin.streams.samples import Array

_NEWTON_STEPS = 25  # most steps of Newton's method in `contact_forces`
_TOLERANCE = 1e-9  # it ends when no entry of the gradient is larger, relative to 1 + the largest |d|


class Tasks(NamedTuple):
    """Weighted targets for the accelerations of m directions: rows J with J q'' = target.

    Attributes:
        rows: (m, n) Jacobian rows.
        target: (m,) wanted accelerations minus J' q', m/s² or rad/s².
        weight: (m,) weights of the squared deviations.
    """

    rows: Array
    target: Array
    weight: Array


class ContactPoints(NamedTuple):
    """The k contact points that may bear force, and the weights of their force.

    Attributes:
        rows: (3 k, n) Jacobians of the points, three rows (x, y, z of the world) each.
        edges: (k, 4, 3) edges of each point's friction cone, world axes.
        weight: (k,) of force at each point.
        change_weight: Of a change of force.
        last: (k, 4) forces along the edges in the step before.
    """

    rows: Array
    edges: Array
    weight: Array
    change_weight: float
    last: Array


@numba.njit(**INNER_KERNEL)
def contact_forces(B: Array, d: Array, r: Array, p: Array) -> tuple[Array, Array]:
    """Forces f >= 0 that minimise ||B f - d||² + Σ r (f - p)², and the residual y = d - B f.

    At the minimum f = max(0, p + Bᵀy / r), so that y solves y + B max(0, p + Bᵀy / r) = d. The difference of the two
    sides is the gradient of the convex function ½ |y|² − d·y + ½ Σ r f² of the six variables y. Newton's method brings
    it to zero; a step is halved until the function does not grow.

    Args:
        B: (6, n) effect of each force on the root's six equations, scaled so that all six count alike.
        d: (6,) what these equations need, in the same scale.
        r: (n,) weights of the forces, positive.
        p: (n,) values to which the second sum draws the forces.

    Returns:
        (n,) forces f; (6,) residual y.
    """
    # `step` is the Newton step of y, `value` the convex function at y; the first trial, with step 0, is at y = d
    y, trial, f, value, largest = d.copy(), np.empty(6), np.empty(len(r)), 1e300, 0.0  # `largest`: max |d|
    step, H = np.zeros((6, 1)), np.empty((6, 6))
    for i in range(6):
        largest = max(largest, abs(d[i]))
    for _ in range(_NEWTON_STEPS):
        size = 1.0  # share of the step, halved until the convex function does not grow
        while True:
            # value of the convex function at the trial point, and its forces
            new_value = 0.0
            for i in range(6):
                trial[i] = y[i] + size * step[i, 0]
                new_value += 0.5 * trial[i] * trial[i] - d[i] * trial[i]
            for j in range(len(r)):
                unclipped = r[j] * p[j]
                for i in range(6):
                    unclipped += B[i, j] * trial[i]
                f[j] = max(unclipped, 0.0) / r[j]  # `unclipped` is r p + Bᵀy
                new_value += 0.5 * r[j] * f[j] * f[j]
            # not larger, apart from rounding; or the step has become too short to matter
            if new_value <= value + 1e-12 * abs(value) or size < 1e-4:
                break
            size *= 0.5
        # gradient y - d + B f
        value, steepest = new_value, 0.0
        for i in range(6):
            y[i] = trial[i]
            gradient = y[i] - d[i]
            for j in range(len(r)):
                gradient += B[i, j] * f[j]
            step[i, 0] = -gradient
            steepest = max(steepest, abs(gradient))
        if steepest < _TOLERANCE * (1.0 + largest):
            break
        # Hessian 1 + sum of b bᵀ / r over the positive forces; the step is -H⁻¹ gradient
        for i in range(6):
            for k in range(i + 1):
                H[i, k] = 1.0 if i == k else 0.0
                for j in range(len(r)):
                    if f[j] > 0.0:
                        H[i, k] += B[i, j] * B[k, j] / r[j]
        solve_positive(H, step)
    return f, y


@numba.njit(**INNER_KERNEL)
def eliminate(M: Array, h: Array, driven: NDArray[np.int64], free: NDArray[np.int64]) -> tuple[Array, Array]:
    """Mass matrix (a, a) and bias (a,) of the driven coordinates after elimination of the free ones.

    The free coordinates have neither motor nor contact, so that their accelerations follow from the others. Let A
    (driven), E (free) and X (coupling) be the blocks of the mass matrix, and c (driven) and e (free) the parts of the
    bias. The results are A − Xᵀ E⁻¹ X and c − Xᵀ E⁻¹ e.

    Args:
        M: (nv, nv) mass matrix.
        h: (nv,) bias minus all known forces.
        driven: (a,) coordinates that motors drive, and the root.
        free: (b,) coordinates without a motor.

    Returns:
        (a, a) mass matrix; (a,) bias.
    """
    # E becomes its Cholesky factor L, and X becomes L⁻¹ X; a product of two such columns is what E takes from A or c
    a, b = len(driven), len(free)
    A, c = M[driven][:, driven], h[driven]
    E, X = M[free][:, free], np.empty((b, a + 1))  # the last column of X is the bias e
    X[:, :a], X[:, a] = M[free][:, driven], h[free]
    factorise_in_place(E)
    substitute_forward(E, X)  # A - Xᵀ E⁻¹ X = A - (L⁻¹ X)ᵀ (L⁻¹ X)
    for k in range(b):
        for i in range(a):
            for j in range(a):
                A[i, j] -= X[k, i] * X[k, j]
            c[i] -= X[k, i] * X[k, a]
    return A, c


@numba.njit(**INNER_KERNEL)
def solve_control_step(
    M: Array, h: Array, target: Array, weight: Array, tasks: Tasks, points: ContactPoints, assist: Array
) -> tuple[Array, Array, Array, Array]:
    """Accelerations, torques and contact forces of one control step.

    Let H be the Hessian of all weighted squares, g their linear term, and M_r the root's six rows of the mass matrix.
    The accelerations are H⁻¹ (g + M_rᵀ λ). The multiplier is λ = S⁻¹ (F − (h_r + M_r H⁻¹ g)) with S = M_r H⁻¹ M_rᵀ +
    diag(assist²). F is the root's share of the contact forces, which minimise what remains (`_solve_contact_forces`).

    Args:
        M: (n, n) mass matrix of the driven coordinates, the root's six first.
        h: (n,) bias of these coordinates.
        target: (n,) target accelerations.
        weight: (n,) their weights.
        tasks: Tasks of feet and contact points.
        points: Contact points that may bear force.
        assist: (6,) standard deviations of the root's assist, N and N m; 0 for none.

    Returns:
        (n,) accelerations; (n,) generalised forces, where those of the root are the assist; (k, 4) contact forces along
        the edges; (6,) residual at the root (0 up to rounding).
    """
    rows, contacts, edges = tasks.rows, points.rows, points.edges
    n, k = len(h), len(points.weight)
    # (n, 7) `solution`: H⁻¹ of the first six columns of M and of the weighted targets, H the Hessian. Tasks affect only
    # root and legs; elsewhere the Hessian is the diagonal of the weights
    solution, columns = np.empty((n, 7)), _nonzero_columns(rows)
    solution[:, 6], solution[:, :6] = weight * target, M[:6].T
    for t in range(len(rows)):
        for i in range(n):
            solution[i, 6] += rows[t, i] * tasks.weight[t] * tasks.target[t]
    H, X = np.diag(weight[columns]), solution[columns]
    for t in range(len(rows)):
        for a in range(len(columns)):
            weighted = tasks.weight[t] * rows[t, columns[a]]
            for b in range(a + 1):
                H[a, b] += weighted * rows[t, columns[b]]
    solve_positive(H, X)
    solution /= weight.reshape(-1, 1)
    solution[columns] = X

    # S = M_r H⁻¹ M_rᵀ + diag(assist²), and the wrench that the root lacks, h_r + M_r H⁻¹ g
    S, root_deficit = np.empty((6, 6)), np.empty(6)
    for i in range(6):
        root_deficit[i] = h[i]
        for j in range(6):
            S[i, j] = assist[i] * assist[i] if i == j else 0.0
        for m in range(n):
            root_deficit[i] += M[i, m] * solution[m, 6]
            for j in range(6):
                S[i, j] += M[i, m] * solution[m, j]
    factorise_in_place(S)
    # forces along the edges, and the generalised force Jᵀ f of all of them
    force, joint_force = _solve_contact_forces(S, root_deficit, points), np.zeros(n)
    for i in range(3 * k):  # axis i % 3 of point i // 3
        along = 0.0
        for e in range(4):
            along += force[i // 3, e] * edges[i // 3, e, i % 3]
        for m in range(n):
            joint_force[m] += contacts[i, m] * along

    # multiplier λ of the root's equations: S⁻¹ (F − deficit); then the accelerations, and the torques M q'' + h − Jᵀ f
    multiplier = np.empty((6, 1))
    for i in range(6):
        multiplier[i, 0] = joint_force[i] - root_deficit[i]
    substitute_forward(S, multiplier)
    substitute_backward(S, multiplier)
    qacc, torque, residual = solution[:, 6].copy(), h - joint_force, np.empty(6)
    for j in range(6):
        qacc += solution[:, j] * multiplier[j, 0]
    for i in range(n):
        for m in range(n):
            torque[i] += M[i, m] * qacc[m]
    # what the root's equations still lack is the assist, −assist² λ; its torque entries become that assist
    for i in range(6):
        assisted = assist[i] * assist[i] * multiplier[i, 0]
        residual[i] = torque[i] + assisted
        torque[i] = -assisted
    return qacc, torque, force, residual


@numba.njit(**INNER_KERNEL)
def _nonzero_columns(rows: Array) -> NDArray[np.int64]:
    """Indices of the columns of a matrix that are not all 0."""
    return np.flatnonzero(np.abs(rows).sum(axis=0))


@numba.njit(**INNER_KERNEL)
def _solve_contact_forces(L: Array, root_deficit: Array, points: ContactPoints) -> Array:
    """(k, 4) N, forces along the edges of the friction cones that minimise the root's remaining deficit.

    They minimise ||L⁻¹ (J f − deficit)||² plus the weighted squares of the forces and of their changes.

    Args:
        L: (6, 6) Cholesky factor of S (`solve_control_step`).
        root_deficit: (6,) wrench that the root needs.
        points: Contact points.
    """
    k = len(points.weight)
    # X: wrench at the root of a unit force along each edge, then the deficit in the last column. The weights of force
    # and of its change become one weight r and one natural value p
    X, r, p = np.zeros((6, 4 * k + 1)), np.empty(4 * k), np.empty(4 * k)
    for j in range(4 * k):
        i, e = j // 4, j % 4  # contact point and edge
        r[j] = points.weight[i] + points.change_weight
        p[j] = points.change_weight * points.last[i, e] / r[j]
        for m in range(6):
            for axis in range(3):
                X[m, j] += points.rows[3 * i + axis, m] * points.edges[i, e, axis]
    X[:, 4 * k] = root_deficit
    substitute_forward(L, X)
    f, _ = contact_forces(X[:, : 4 * k].copy(), X[:, 4 * k].copy(), r, p)
    return f.reshape(k, 4)
