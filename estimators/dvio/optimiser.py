"""The window's least squares, docs/dvio.md (10), and marginalisation of its oldest frame into the prior (11).

Landmarks are eliminated first, then Cholesky; Levenberg–Marquardt.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.landmarks import CameraEquations, blank_camera_equations, rehost
from stridetwin.estimators.dvio.projection import Views, blank_views
from stridetwin.estimators.dvio.state import (
    CALIBRATION,
    FRAME,
    FactorParameters,
    ImuNoise,
    ImuSamples,
    Preintegration,
    WindowState,
)
from stridetwin.streams.samples import Array

_FIRST_DAMPING, _MOST_DAMPING = 1e-9, 1e2


class Work(NamedTuple):
    """Preallocated buffers for the normal equations.

    Attributes:
        H: (N, N) of frames and calibration; the lower triangle counts.
        b: (N,).
        factor: (N, N) its Cholesky factor.
        step: (N,).
        camera: Camera factors.
        views: Of the frames.
        saved: Copies of the arrays of `_state_arrays`, before a step.
    """

    H: Array
    b: Array
    factor: Array
    step: Array
    camera: CameraEquations
    views: Views
    saved: list[Array]


def blank_work(window: WindowState) -> Work:
    """Buffers for a window."""
    frames, landmarks = len(window.frames.t_ns), len(window.landmarks.host)
    n = CALIBRATION + FRAME * frames
    return Work(
        H=np.zeros((n, n)), b=np.zeros(n), factor=np.zeros((n, n)), step=np.zeros(n),
        camera=blank_camera_equations(frames, landmarks), views=blank_views(frames),
        saved=[a.copy() for a in _state_arrays(window)],
    )  # fmt: skip


def preintegrate(
    zs: Preintegration, k: int, imu: ImuSamples, start_ns: int, end_ns: int, bias: Array, noise: ImuNoise
) -> None:
    """`imu_factors.integrate` into the `k`-th of an array, with its inverse covariance."""
    z = Preintegration(*(a[k] for a in zs))
    kernel.integrate(z, imu, start_ns, end_ns, bias, noise)
    z.weight[:] = kernel.inverse(z.covariance)


def _state_arrays(window: WindowState) -> tuple[Array, ...]:
    """What a step changes."""
    f, c = window.frames, window.calibration
    return (
        f.R, f.p, f.v, f.bias, f.moved, c.R, c.p, c.offset, c.scale, c.focal, c.moved, window.landmarks.inverse_depth,
    )  # fmt: skip


def _linearise(
    window: WindowState, factors: FactorParameters, work: Work, frames: int, last: int, host_depth: bool
) -> float:
    """Normal equations of the prior and of all factors of the oldest `frames`, landmarks eliminated; returns the cost.

    These are of the landmarks that the frames host, as observed by frames up to `last`; their measured depths count
    only if `host_depth`.
    """
    kernel.update_views(window.frames, window.calibration, factors.first_estimates, work.views)
    prior, d, size = window.prior, _deviation(window), CALIBRATION + FRAME * int(window.frames.count[0])
    by_prior = prior.H @ d
    work.H[:size, :size], work.b[:] = prior.H[:size, :size], prior.b - by_prior
    cost = d @ (0.5 * by_prior - prior.b)  # Zhao 2023 (6), up to a constant
    cost += kernel.add_imu_factors(window, factors, frames, work.H, work.b)
    cost += kernel.add_camera_factors(
        window, factors, work.views, work.camera, frames, last, host_depth, work.H, work.b
    )
    return float(cost)


def minimise(window: WindowState, factors: FactorParameters, work: Work, steps: int, cost_tolerance: float) -> float:
    """Moves the states towards the minimum of docs/dvio.md (10), in at most `steps`; returns a recent cost.

    Stops if a step lowers the cost by less than the share `cost_tolerance`. The factor in `work` is that of the last
    equations.
    """
    n = int(window.frames.count[0])
    size, moving = CALIBRATION + FRAME * n, _state_arrays(window)
    damping, cost = _FIRST_DAMPING, _linearise(window, factors, work, n, n - 1, factors.host_depth)
    for i in range(steps):
        if not kernel.solve(work.H, work.b, size, damping, work.factor, work.step):
            damping = max(10 * damping, 1e-4)
            continue
        for saved, a in zip(work.saved, moving):
            saved[:] = a
        kernel.apply_step(window.frames, window.landmarks, window.calibration, work.camera, work.step)
        if i == steps - 1:
            break
        new = _linearise(window, factors, work, n, n - 1, factors.host_depth)
        if new <= cost * (1.0 + 1e-9) + 1e-9:
            done = cost - new < cost_tolerance * abs(cost)
            cost, damping = new, max(0.1 * damping, 1e-12)
            if done:
                break
        else:
            for saved, a in zip(work.saved, moving):
                a[:] = saved
            damping = max(10 * damping, 1e-4)
            _linearise(window, factors, work, n, n - 1, factors.host_depth)
            if damping > _MOST_DAMPING:
                break
    if damping > _FIRST_DAMPING:
        # Damping is no information: with it, the covariance of weak directions, such as the tilt, would be too small.
        kernel.solve(work.H, work.b, size, _FIRST_DAMPING, work.factor, work.step)
    return cost


def _deviation(window: WindowState) -> Array:
    """(N,) deviation of the states from their first estimates; 0 for those that the prior does not contain."""
    f = window.frames
    return np.concatenate([window.calibration.moved, np.where(f.in_prior[:, None] > 0, f.moved, 0.0).ravel()])


def fix_first_estimate(window: WindowState, slot: int) -> None:
    """Marks a frame as in the prior: its Jacobians stay at its current state."""
    f = window.frames
    f.in_prior[slot] = 1
    f.R_first[slot], f.p_first[slot], f.v_first[slot] = f.R[slot], f.p[slot], f.v[slot]
    f.bias_first[slot], f.moved[slot] = f.bias[slot], 0.0


def marginalize_oldest(window: WindowState, factors: FactorParameters, work: Work, alive: NDArray[np.uint8]) -> None:
    """Marginalises the oldest frame with the landmarks that it hosts; `drop_oldest` then takes it out of the window.

    Each observation is used once: those of these landmarks by the newest frame stay with it, which becomes their host.
    The window holds three frames or more.
    """
    f = window.frames
    newest = int(f.count[0]) - 1
    size = CALIBRATION + FRAME * (newest + 1)
    _linearise(window, factors, work, 1, newest - 1, factors.host_depth and factors.host_depth_in_prior)
    left, right = eliminate_oldest(work.H[:size, :size], work.b[:size])
    d = np.delete(_deviation(window), np.s_[CALIBRATION : CALIBRATION + FRAME])
    prior, n = window.prior, len(right)
    prior.H[:], prior.b[:] = 0.0, 0.0
    prior.H[:n, :n], prior.b[:n] = left, right + left @ d[:n]
    for k in range(1, newest):
        o = CALIBRATION + FRAME * (k - 1)
        if not f.in_prior[k] and prior.H[o, o] > 0.0:
            fix_first_estimate(window, k)
    rehost(window.landmarks, window.calibration, work.views, alive, newest)


def eliminate_oldest(H: Array, b: Array) -> tuple[Array, Array]:
    """The equations H d = b without the oldest frame; of H the lower triangle counts. See docs/dvio.md (11)."""
    lower = np.tril(H, -1)
    full = lower + lower.T + np.diag(np.diag(H))
    oldest, remaining = slice(CALIBRATION, CALIBRATION + FRAME), np.r_[:CALIBRATION, CALIBRATION + FRAME : len(b)]
    scale = np.maximum(full.diagonal()[oldest], 1e-12) ** -0.5
    scales = np.outer(scale, scale)
    cover = np.linalg.inv(full[oldest, oldest] * scales + 1e-12 * np.eye(FRAME)) * scales
    share = full[remaining, oldest] @ cover
    left = np.tril(full[np.ix_(remaining, remaining)] - share @ full[oldest, remaining])
    return left + np.tril(left, -1).T, b[remaining] - share @ b[oldest]


def drop_oldest(window: WindowState) -> None:
    """Moves every slot one to the front, over the oldest frame."""
    frames, marks = window.frames, window.landmarks
    n = int(frames.count[0])
    for a in (*frames[1:], *window.preintegrations):
        a[: n - 1] = a[1:n]
    for a in (marks.seen, marks.at, marks.rho):
        a[:, : n - 1] = a[:, 1:n]
    marks.seen[:, n - 1] = 0
    marks.host[marks.host > 0] -= 1
    frames.in_prior[n - 1] = 0
    frames.count[0] = n - 1
