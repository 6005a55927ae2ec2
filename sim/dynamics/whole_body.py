"""Whole-body control: joint torques that track the reference with forces that the ground can give.

At each step the joint accelerations minimise a weighted sum of squared deviations (joints, swing foot, stance, contact
points at rest) under the rows of the equations of motion that no motor drives: the six of the root, and the joints of
an unpowered exoskeleton, which are eliminated first. What remains is a problem in the contact forces alone,

    min over f >= 0 of ||B f - d||^2 + sum r_i f_i^2,   B with six rows,

whose dual in six unknowns is solved by Newton's method (Kuindersma et al. 2016, Auton. Robots 40, for the whole-body
problem; the elimination to six rows is ours).
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array

_NEWTON_STEPS = 25
_TOLERANCE = 1e-9


@numba.njit(cache=True)
def contact_forces(B: Array, d: Array, r: Array) -> tuple[Array, Array]:
    """Forces f >= 0 that minimise ||B f - d||² + Σ r f², and the residual y = d - B f.

    f = max(0, Bᵀy / r), so that y solves y + B max(0, Bᵀy / r) = d: the gradient of a convex function of six variables,
    brought to zero by Newton's method with halved steps.

    Args:
        B: (6, n).
        d: (6,).
        r: (n,) positive.
    """
    n = B.shape[1]
    y = d.copy()
    f = np.zeros(n)
    value = 1e300
    step = np.zeros(6)
    for _ in range(_NEWTON_STEPS):
        size = 1.0
        while True:
            trial = y + size * step
            s = B.T @ trial
            now = float(0.5 * (trial @ trial) - d @ trial)
            for i in range(n):
                if s[i] > 0.0:
                    now += float(0.5 * s[i] * s[i] / r[i])
            if now <= value + 1e-12 * abs(value) or size < 1e-4:
                break
            size *= 0.5
        y, value = trial, now
        H = np.eye(6)
        for i in range(n):
            f[i] = max(0.0, s[i] / r[i])
            if s[i] > 0.0:
                b = B[:, i].copy()
                H += np.outer(b, b) / r[i]
        gradient = y - d + B @ f
        if np.max(np.abs(gradient)) < _TOLERANCE * (1.0 + np.max(np.abs(d))):
            break
        step = -np.linalg.solve(H, gradient).astype(np.float64)
    return f, y


@numba.njit(cache=True)
def eliminate(M: Array, h: Array, driven: NDArray[np.int64], free: NDArray[np.int64]) -> tuple[Array, Array]:
    """Equations of motion of the driven coordinates once the free ones (no motor, no contact) have been solved for.

    Args:
        M: (nv, nv) mass matrix.
        h: (nv,) bias less all known forces.
        driven: (a,) coordinates to keep.
        free: (b,) coordinates whose generalised force is known and in `h`.

    Returns:
        (a, a) mass matrix and (a,) bias.
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
    M: Array, h: Array, wanted: Array, weight: Array, tasks: Array, task_wanted: Array, task_weight: Array,
    contacts: Array, edges: Array, cost: Array, assist: float,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Accelerations, torques and contact forces of one control step.

    Args:
        M: (n, n) mass matrix of the driven coordinates, the root's six first.
        h: (n,) bias.
        wanted: (n,) accelerations.
        weight: (n,) their weights.
        tasks: (m, n) Jacobian rows of the tasks.
        task_wanted: (m,) accelerations of the tasks less their J' q'.
        task_weight: (m,).
        contacts: (3 k, n) Jacobians of the contact points that may push.
        edges: (k, 4, 3) edges of each point's friction cone, world axes.
        cost: (k,) price of force at each point.
        assist: Standard deviation of the root's assist, N and N m; 0 for none.

    Returns:
        (n,) accelerations; (n,) generalised forces, the root's being the assist; (3 k,) contact forces, world;
        (6,) what the root lacks (0 but for rounding).
    """
    n, k = len(h), len(cost)
    H = np.diag(weight)
    g = weight * wanted
    weighted = tasks * task_weight.reshape(-1, 1)
    H += weighted.T @ tasks
    g += weighted.T @ task_wanted
    root = M[:6].copy()
    L = np.linalg.cholesky(H)
    right = np.empty((n, 7))
    right[:, :6] = root.T
    right[:, 6] = g
    half = np.linalg.solve(L, right)
    solved = np.linalg.solve(L.T.copy(), half)
    a0 = solved[:, 6].copy()
    back = np.ascontiguousarray(solved[:, :6])
    S = root @ back + assist * assist * np.eye(6)
    lacking = h[:6] + root @ a0
    force = np.zeros(3 * k)
    if k > 0:
        A = np.empty((6, 4 * k))
        r = np.empty(4 * k)
        for i in range(k):
            push = contacts[3 * i : 3 * i + 3, :6].T.copy()
            for e in range(4):
                A[:, 4 * i + e] = push @ edges[i, e]
                r[4 * i + e] = cost[i]
        C = np.linalg.cholesky(S)
        f, _ = contact_forces(
            np.linalg.solve(C, A).astype(np.float64), np.linalg.solve(C, lacking).astype(np.float64), r
        )
        for i in range(k):
            for e in range(4):
                force[3 * i : 3 * i + 3] += f[4 * i + e] * edges[i, e]
    pushed = contacts.T @ force if k > 0 else np.zeros(n)
    multiplier = np.linalg.solve(S, pushed[:6] - lacking)
    qacc = a0 + back @ multiplier
    torque = M @ qacc + h - pushed
    rest = torque[:6] + assist * assist * multiplier
    torque[:6] = -assist * assist * multiplier
    return qacc, torque, force, rest
