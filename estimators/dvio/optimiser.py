"""The window's least squares, docs/dvio.md (10), and marginalisation of its oldest frame, docs/dvio.md (11).

Landmarks are eliminated first, then Cholesky; Levenberg–Marquardt.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.depth_link import DepthLink, add_depth_links
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

# Share of the diagonal that Levenberg-Marquardt adds to it: at first, and the one above which it gives up. The first
# must be so small that it is no information on the absolute position: 1e-9 of the IMU's is that of 1 to 3 m.
_FIRST_DAMPING, _MOST_DAMPING = 1e-13, 1e2
# Added to the information of the frame that is eliminated, whose diagonal is scaled to 1, so that it can be inverted.
_LEAST_INFORMATION = 1e-15


class Work(NamedTuple):
    """Preallocated buffers for the normal equations of N states.

    Attributes:
        H: (N, N) of calibration and frames; the lower triangle counts.
        b: (N,) right-hand side.
        factor: (N, N) Cholesky factor of H.
        step: (N,) solution of H d = b.
        camera: Camera factors.
        views: Cameras of the frames.
        saved: Copies of the arrays of `_state_arrays`, before a step.
        links: Per frame the motion to the next one by depth alone, None where images show it.
    """

    H: Array
    b: Array
    factor: Array
    step: Array
    camera: CameraEquations
    views: Views
    saved: list[Array]
    links: list[DepthLink | None]


def blank_work(window: WindowState) -> Work:
    """Preallocated buffers for a window of this size."""
    frames, landmarks = len(window.frames.t_ns), len(window.landmarks.host)
    n = CALIBRATION + FRAME * frames
    return Work(
        H=np.zeros((n, n)),
        b=np.zeros(n),
        factor=np.zeros((n, n)),
        step=np.zeros(n),
        camera=blank_camera_equations(frames, landmarks),
        views=blank_views(frames),
        saved=[a.copy() for a in _state_arrays(window)],
        links=[None] * frames,
    )


def preintegrate(
    zs: Preintegration, k: int, imu: ImuSamples, start_ns: int, end_ns: int, bias: Array, noise: ImuNoise
) -> None:
    """Preintegrates IMU samples between two times into the k-th measurement of an array, with its weight Σ⁻¹.

    Args:
        zs: Measurements with a leading axis.
        k: Index of the measurement.
        imu: Samples that cover the interval.
        start_ns: Begin of the interval.
        end_ns: End of the interval.
        bias: (6,) biases of gyroscope (rad/s) and accelerometer (m/s²).
        noise: Noise of the samples.
    """
    z = Preintegration(*(a[k] for a in zs))
    kernel.integrate(z, imu, start_ns, end_ns, bias, noise)
    z.weight[:] = kernel.inverse(z.covariance)


def _state_arrays(window: WindowState) -> tuple[Array, ...]:
    """The arrays of the window that an optimisation step changes, as views."""
    f, c = window.frames, window.calibration
    return (
        f.R,
        f.p,
        f.v,
        f.bias,
        f.moved,
        c.R,
        c.p,
        c.offset,
        c.scale,
        c.focal,
        c.moved,
        window.landmarks.inverse_depth,
    )


def _linearise(
    window: WindowState, factors: FactorParameters, work: Work, frames: int, last: int, host_depth: bool
) -> float:
    """Writes the normal equations of prior and factors into `work`, landmarks eliminated; returns the cost.

    Args:
        window: The sliding window.
        factors: Noise model of the factors.
        work: Buffers; `H` and `b`, the camera equations and the views are written.
        frames: Number of frames, from the oldest, whose IMU factors and hosted landmarks are included.
        last: Newest frame whose observations are included.
        host_depth: Whether the measured depths of the hosts are included.

    Returns:
        The cost; that of the prior is up to a constant.
    """
    kernel.update_views(window.frames, window.calibration, factors.first_estimates, work.views)
    prior, d, size = window.prior, _deviation(window), CALIBRATION + FRAME * int(window.frames.count[0])
    by_prior = prior.H @ d  # d: deviation of the states from the prior's linearisation point
    work.H[:size, :size], work.b[:] = prior.H[:size, :size], prior.b - by_prior
    cost = d @ (0.5 * by_prior - prior.b)  # Zhao 2023 (6), up to a constant
    cost += kernel.add_imu_factors(window, factors, frames, work.H, work.b)
    cost += add_depth_links(window, work.links, factors.first_estimates, frames, work.H, work.b)
    cost += kernel.add_camera_factors(
        window, factors, work.views, work.camera, frames, last, host_depth, work.H, work.b
    )
    return float(cost)


def minimise(window: WindowState, factors: FactorParameters, work: Work, steps: int, cost_tolerance: float) -> float:
    """Minimises the cost of prior, IMU and camera factors by Levenberg-Marquardt; returns the last computed cost.

    The cost is docs/dvio.md (10). There are at most `steps` steps; it stops if a step lowers the cost by less than the
    share `cost_tolerance`. `work.factor` is afterwards the undamped Cholesky factor of the last equations, from which
    covariances follow. The cost after the last step is not computed.

    Args:
        window: The sliding window, whose frames, landmarks and calibration change.
        factors: Noise model of the factors.
        work: Buffers.
        steps: Largest number of steps.
        cost_tolerance: Relative decrease of the cost below which it stops.
    """
    n = int(window.frames.count[0])
    size, moving = CALIBRATION + FRAME * n, _state_arrays(window)  # moving: the arrays that a step changes
    damping, cost = _FIRST_DAMPING, _linearise(window, factors, work, n, n - 1, factors.host_depth)
    for i in range(steps):
        if not kernel.solve(work.H, work.b, size, damping, work.factor, work.step):  # not positive definite
            damping = max(10 * damping, 1e-4)
            continue
        for saved, a in zip(work.saved, moving):
            saved[:] = a
        kernel.apply_step(window.frames, window.landmarks, window.calibration, work.camera, work.step)
        if i == steps - 1:  # the last step is taken without a check of its cost, which saves time
            break
        new = _linearise(window, factors, work, n, n - 1, factors.host_depth)
        if new <= cost * (1.0 + 1e-9) + 1e-9:  # not higher, but for rounding
            done = cost - new < cost_tolerance * abs(cost)
            cost, damping = new, max(0.1 * damping, _FIRST_DAMPING)
            if done:
                break
        else:  # the cost has increased: back to the state before the step
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
    """(N,) deviation d of the states from their first estimates; 0 for frames that the prior does not contain."""
    f = window.frames
    return np.concatenate([window.calibration.moved, np.where(f.in_prior[:, None] > 0, f.moved, 0.0).ravel()])


def fix_first_estimate(window: WindowState, slot: int) -> None:
    """Includes a frame in the prior: its Jacobians stay at the present state, its first estimate."""
    f = window.frames
    f.in_prior[slot] = 1
    f.R_first[slot], f.p_first[slot], f.v_first[slot] = f.R[slot], f.p[slot], f.v[slot]
    f.bias_first[slot], f.moved[slot] = f.bias[slot], 0.0


def marginalize_oldest(window: WindowState, factors: FactorParameters, work: Work, alive: NDArray[np.uint8]) -> None:
    """Marginalises the oldest frame, with the landmarks that it hosts, into the window's prior.

    `drop_oldest` then removes the frame from the window, which must hold three frames or more. Each observation is used
    once: observations of these landmarks by the newest frame stay with it, which becomes their host.

    Args:
        window: The sliding window, whose prior and landmarks change.
        factors: Noise model of the factors.
        work: Buffers.
        alive: (L,) 1 where a landmark is tracked; others of the oldest frame are dropped.
    """
    f = window.frames
    newest = int(f.count[0]) - 1
    size = CALIBRATION + FRAME * (newest + 1)
    # the prior and the oldest frame's factors alone, without observations by the newest frame
    _linearise(window, factors, work, 1, newest - 1, factors.host_depth and factors.host_depth_in_prior)
    # equations of the remaining states, at the present states; b becomes that at their first estimates, by + H d
    left, right = eliminate_oldest(work.H[:size, :size], work.b[:size])
    d = np.delete(_deviation(window), np.s_[CALIBRATION : CALIBRATION + FRAME])
    prior, n = window.prior, len(right)
    prior.H[:], prior.b[:] = 0.0, 0.0
    prior.H[:n, :n], prior.b[:n] = left, right + left @ d[:n]
    for k in range(1, newest):
        o = CALIBRATION + FRAME * (k - 1)  # index of frame k in the prior, from which the oldest frame is gone
        if not f.in_prior[k] and prior.H[o, o] > 0.0:  # the prior now has information on this frame
            fix_first_estimate(window, k)
    rehost(window.landmarks, window.calibration, work.views, alive, newest)


def eliminate_oldest(H: Array, b: Array) -> tuple[Array, Array]:
    """The equations H d = b without the oldest frame o: docs/dvio.md (11).

    They are H_rr − H_ro H_oo⁻¹ H_or and b_r − H_ro H_oo⁻¹ b_o for the remaining states r.

    Args:
        H: (N, N) equations of calibration and frames; only the lower triangle is read.
        b: (N,) right-hand side.

    Returns:
        H (symmetric) and b of the N − 15 remaining states. H_oo is scaled to a unit diagonal before its inversion.
    """
    lower = np.tril(H, -1)  # below the diagonal
    full = lower + lower.T + np.diag(np.diag(H))
    oldest, remaining = slice(CALIBRATION, CALIBRATION + FRAME), np.r_[:CALIBRATION, CALIBRATION + FRAME : len(b)]
    scale = np.maximum(full.diagonal()[oldest], 1e-12) ** -0.5  # which makes the diagonal of H_oo 1
    scales = np.outer(scale, scale)
    H_oo_inverse = np.linalg.inv(full[oldest, oldest] * scales + _LEAST_INFORMATION * np.eye(FRAME)) * scales
    gain = full[remaining, oldest] @ H_oo_inverse  # H_ro H_oo⁻¹
    reduced = np.tril(full[np.ix_(remaining, remaining)] - gain @ full[oldest, remaining])
    return reduced + np.tril(reduced, -1).T, b[remaining] - gain @ b[oldest]


def drop_oldest(window: WindowState, links: list[DepthLink | None]) -> None:
    """Removes the oldest frame: moves the arrays of all later slots one slot to the front.

    No landmark may be hosted by it any more (`marginalize_oldest` moves them to another frame or drops them). `links`
    are those of `Work`.
    """
    links.append(links.pop(0))
    links[-1] = None
    frames, marks = window.frames, window.landmarks
    n = int(frames.count[0])
    for a in (*frames[1:], *window.preintegrations):  # `frames[0]` is the number of frames in use
        a[: n - 1] = a[1:n]
    for a in (marks.seen, marks.at, marks.rho):
        a[:, : n - 1] = a[:, 1:n]
    marks.seen[:, n - 1] = 0
    marks.host[marks.host > 0] -= 1  # hosts are slots of frames
    frames.in_prior[n - 1] = 0
    frames.count[0] = n - 1
