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

from stridetwin.streams.samples import Array

_NEWTON_STEPS = 25
_TOLERANCE = 1e-9


class Tasks(NamedTuple):
    """What m rows of Jacobians should accelerate by.

    Attributes:
        rows: (m, n) Jacobian rows.
        target: (m,) accelerations less their J' q'.
        weight: (m,).
    """

    rows: Array
    target: Array
    weight: Array


class ContactPoints(NamedTuple):
    """The k contact points that may bear force, and the weights of their force.

    Attributes:
        rows: (3 k, n) Jacobians.
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


@numba.njit(cache=True)
def forward(L: Array, X: Array) -> None:
    """Overwrites X (n, m) by L⁻¹ X, L (n, n) lower triangular; for few unknowns faster than a LAPACK call."""
    for i in range(len(L)):
        for j in range(i):
            for c in range(X.shape[1]):
                X[i, c] -= L[i, j] * X[j, c]
        for c in range(X.shape[1]):
            X[i, c] /= L[i, i]


@numba.njit(cache=True)
def solve_positive(H: Array, X: Array) -> None:
    """Overwrites X (n, m) by H⁻¹ X, H (n, n) symmetric and positive definite."""
    L = np.linalg.cholesky(H).astype(np.float64)
    forward(L, X)
    for i in range(len(L) - 1, -1, -1):
        for j in range(i + 1, len(L)):
            for c in range(X.shape[1]):
                X[i, c] -= L[j, i] * X[j, c]
        for c in range(X.shape[1]):
            X[i, c] /= L[i, i]


@numba.njit(cache=True)
def contact_forces(B: Array, d: Array, r: Array, p: Array) -> tuple[Array, Array]:
    """Forces f >= 0 that minimise ||B f - d||² + Σ r (f - p)², and the residual y = d - B f.

    f = max(0, p + Bᵀy / r), so that y solves y + B max(0, p + Bᵀy / r) = d: the gradient of a convex function of six
    variables, brought to zero by Newton's method with halved steps.

    Args:
        B: (6, n).
        d: (6,).
        r: (n,) positive.
        p: (n,) natural values of the forces.
    """
    y, step, value = d.copy(), np.zeros(6), 1e300
    for _ in range(_NEWTON_STEPS):
        size = 1.0
        while True:
            trial = y + size * step
            reach = np.maximum(B.T @ trial + r * p, 0.0)
            f = reach / r
            now = float(0.5 * (trial @ trial) - d @ trial + 0.5 * (reach @ f))
            if now <= value + 1e-12 * abs(value) or size < 1e-4:
                break
            size *= 0.5
        y, value = trial, now
        gradient = y - d + B @ f
        if np.max(np.abs(gradient)) < _TOLERANCE * (1.0 + np.max(np.abs(d))):
            break
        step = -gradient
        solve_positive(np.eye(6) + (B * np.where(f > 0.0, 1.0 / r, 0.0)) @ B.T, step.reshape(6, 1))
    return f, y


@numba.njit(cache=True)
def eliminate(M: Array, h: Array, driven: NDArray[np.int64], free: NDArray[np.int64]) -> tuple[Array, Array]:
    """Mass matrix (a, a) and bias (a,) of the (a,) driven coordinates after elimination of the (b,) free ones.

    `M` is the (nv, nv) mass matrix and `h` the (nv,) bias minus all known forces, among them those on the free
    coordinates, which have neither motor nor contact.
    """
    a, b = len(driven), len(free)
    A, c = np.empty((a, a)), np.empty(a)
    for i in range(a):
        c[i] = h[driven[i]]
        for j in range(a):
            A[i, j] = M[driven[i], driven[j]]
    if b == 0:
        return A, c
    E, X = np.empty((b, b)), np.empty((b, a + 1))
    for i in range(b):
        X[i, a] = h[free[i]]
        for j in range(b):
            E[i, j] = M[free[i], free[j]]
        for j in range(a):
            X[i, j] = M[free[i], driven[j]]
    across = np.ascontiguousarray(X[:, :a].T)
    solved = np.linalg.solve(E, X)
    return A - across @ np.ascontiguousarray(solved[:, :a]), c - across @ solved[:, a].copy()


@numba.njit(cache=True)
def solve(
    M: Array, h: Array, target: Array, weight: Array, tasks: Tasks, points: ContactPoints, assist: Array
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Accelerations, torques and contact forces of one control step.

    `M` (n, n) and `h` (n,) are mass matrix and bias of the driven coordinates, the root's six first; `target` and
    `weight` (n,) their accelerations; `assist` (6,) standard deviations of the root's assist, N and N m, 0 for none.

    Returns:
        (n,) accelerations; (n,) generalised forces, where those of the root are the assist; (k, 4) contact forces along
        the edges; (6,) residual at the root (0 up to rounding).
    """
    task_rows, task_target, task_weight = tasks
    contacts, edges, cost, change, last = points
    n, k = len(h), len(cost)
    # the tasks affect only root and legs; elsewhere the Hessian is the diagonal of the weights
    back = np.empty((n, 7))
    back[:, :6] = M[:6].T
    back[:, 6] = weight * target + task_rows.T @ (task_weight * task_target)
    reached = np.array([j for j in range(n) if np.any(task_rows[:, j] != 0.0)])
    own = task_rows[:, reached]
    X = back[reached]
    solve_positive(np.diag(weight[reached]) + (own.T * task_weight) @ own, X)
    back /= weight.reshape(-1, 1)
    back[reached] = X
    a0 = back[:, 6].copy()
    back = np.ascontiguousarray(back[:, :6])
    S = M[:6] @ back + np.diag(assist * assist)
    lacking = h[:6] + M[:6] @ a0
    forces, joint_force = np.zeros(4 * k), np.zeros(n)
    if k > 0:
        X, r = np.empty((6, 4 * k + 1)), np.repeat(cost, 4) + change
        for i in range(k):
            X[:, 4 * i : 4 * i + 4] = np.ascontiguousarray(contacts[3 * i : 3 * i + 3, :6].T) @ edges[i].T
        X[:, 4 * k] = lacking
        forward(np.linalg.cholesky(S).astype(np.float64), X)
        forces, _ = contact_forces(X[:, : 4 * k].copy(), X[:, 4 * k].copy(), r, change * last.ravel() / r)
        force = np.empty(3 * k)
        for i in range(k):
            force[3 * i : 3 * i + 3] = forces[4 * i : 4 * i + 4] @ edges[i]
        joint_force = contacts.T @ force
    multiplier = joint_force[:6] - lacking
    solve_positive(S, multiplier.reshape(6, 1))
    qacc = a0 + back @ multiplier
    torque = M @ qacc + h - joint_force
    rest = torque[:6] + assist * assist * multiplier
    torque[:6] = -assist * assist * multiplier
    return qacc, torque, forces.reshape(k, 4), rest
