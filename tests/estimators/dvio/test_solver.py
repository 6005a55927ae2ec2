"""The window's optimiser against an independent batch solution, and its prior against the window that it stands for."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.optimiser import blank_work, drop_oldest, marginalize_oldest, minimise, preintegrate
from stridetwin.estimators.dvio.state import CALIBRATION, FRAME, ImuSamples, WindowState
from tests.estimators.dvio.scenes import FACTORS, NOISE, moved, seen_window

PERIOD_NS = 5_000_000
SLOTS, POINTS = 5, 12

QUADRATIC = FACTORS._replace(huber_sd=1e3)


def noisy_window(rng: np.random.Generator, frames: int = 3) -> WindowState:
    """Frames 0.2 s apart, IMU samples that nearly fit, noisy observations, a prior of calibration and first frame."""
    w = seen_window(rng, frames, POINTS, SLOTS)
    f, marks = w.frames, w.landmarks
    g = np.array([0.0, 0.0, -9.81])
    for k in range(frames - 1):
        n = 41
        t_ns = f.t_ns[k] + PERIOD_NS * np.arange(n, dtype=np.int64)
        rate = Rotation.from_matrix(f.R[k].T @ f.R[k + 1]).as_rotvec() / 0.2
        f.v[k + 1] = 2 * (f.p[k + 1] - f.p[k]) / 0.2 - f.v[k]
        a = (f.v[k + 1] - f.v[k]) / 0.2 - g
        middle = f.R[k] @ Rotation.from_rotvec(0.1 * rate).as_matrix()
        samples = np.tile(np.concatenate([rate, middle.T @ a]), (n, 1)) + f.bias[k]
        preintegrate(
            w.preintegrations, k, ImuSamples(t_ns, samples, np.zeros(n, np.uint8)), t_ns[0], t_ns[-1], f.bias[k], NOISE
        )
    marks.at[:] += 1e-3 * rng.normal(size=marks.at.shape)
    marks.rho[:] += 4e-3 * rng.normal(size=marks.rho.shape) * (marks.rho > 0)
    # Jacobians are those of no change of the time offset; held, all of them are exact.
    sd = np.concatenate([np.full(3, 2e-3), np.full(3, 5e-3), [1e-8, 1e-2], np.full(2, 2e-3)])
    w.prior.H[range(CALIBRATION), range(CALIBRATION)] = sd**-2
    own = range(CALIBRATION, CALIBRATION + FRAME)
    w.prior.H[own, own] = np.repeat([1e-3, 1e-2, 0.1, 0.01, 0.05], 3) ** -2.0
    hold_first(w)
    return w


def hold_first(w: WindowState) -> None:
    f = w.frames
    f.in_prior[0] = 1
    f.R_first[0], f.p_first[0], f.v_first[0], f.bias_first[0] = f.R[0], f.p[0], f.v[0], f.bias[0]


def residuals(w: WindowState, factors, depths: np.ndarray) -> np.ndarray:
    """All of (15), written down anew."""
    f, c, marks = w.frames, w.calibration, w.landmarks
    n = int(f.count[0])
    g, out = np.array([0.0, 0.0, -factors.gravity]), []
    for k in range(n - 1):
        z = type(w.preintegrations)(*(a[k] for a in w.preintegrations))
        dt, off = z.dt[0], f.bias[k] - z.bias
        corrected = z.by_bias @ off
        gamma = z.delta_R @ Rotation.from_rotvec(corrected[3:6]).as_matrix()
        r = np.concatenate(
            [
                f.R[k].T @ (f.p[k + 1] - f.p[k] - f.v[k] * dt - 0.5 * g * dt**2) - z.delta_p - corrected[:3],
                Rotation.from_matrix(gamma.T @ f.R[k].T @ f.R[k + 1]).as_rotvec(),
                f.R[k].T @ (f.v[k + 1] - f.v[k] - g * dt) - z.delta_v - corrected[6:],
            ]
        )
        out.append(np.linalg.cholesky(np.linalg.inv(z.covariance)).T @ r)
        out.append((f.bias[k + 1] - f.bias[k]) / np.repeat([factors.rate_walk, factors.force_walk], 3) / np.sqrt(dt))
    R, p = [], []
    for k in range(n):
        late = c.offset[0] - f.offset[k]
        R.append(f.R[k] @ Rotation.from_rotvec(f.rate[k] * late).as_matrix())
        p.append(f.p[k] + f.v[k] * late)
    depth_sd = factors.depth_weight**-0.5
    for l, xi in enumerate(depths):
        m = np.array([*marks.at[l, 0] * (1 + c.focal), 1.0])
        world = R[0] @ (c.R @ (m / xi) + c.p) + p[0]
        out.append([(c.scale[0] * xi - marks.rho[l, 0]) / depth_sd])
        for k in range(1, n):
            q = c.R.T @ (R[k].T @ (world - p[k]) - c.p)
            out.append((q[:2] / q[2] - marks.at[l, k] * (1 + c.focal)) * factors.pixel_weight**0.5)
            out.append([(c.scale[0] / q[2] - marks.rho[l, k]) * factors.later_depth_weight**0.5])
    return np.concatenate(out)


def test_finds_the_minimum_that_a_batch_solution_finds():
    rng = np.random.default_rng(3)
    start = noisy_window(rng)
    factors = QUADRATIC
    n = CALIBRATION + FRAME * 3
    prior = np.sqrt(np.diag(start.prior.H)[:n])

    w = copy.deepcopy(start)
    minimise(w, factors, blank_work(w), 25, 0.0)

    def cost(x: np.ndarray) -> np.ndarray:
        other = copy.deepcopy(start)
        moved(other, x[:n])
        return np.concatenate([prior * x[:n], residuals(other, factors, x[n:])])

    x0 = np.concatenate([np.zeros(n), start.landmarks.inverse_depth])
    best = least_squares(cost, x0, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    found = copy.deepcopy(start)
    moved(found, best.x[:n])
    assert w.frames.p[:3] == pytest.approx(found.frames.p[:3], abs=2e-6)
    assert w.frames.R[:3] == pytest.approx(found.frames.R[:3], abs=2e-6)
    assert w.frames.v[:3] == pytest.approx(found.frames.v[:3], abs=1e-5)
    assert w.frames.bias[:3] == pytest.approx(found.frames.bias[:3], abs=1e-5)
    assert w.calibration.scale == pytest.approx(found.calibration.scale, abs=1e-6)
    assert w.landmarks.inverse_depth == pytest.approx(best.x[n:], abs=1e-6)


def test_the_prior_equals_what_was_marginalised():
    """After the oldest frame went with its landmarks, the remaining states have the same best estimate."""
    rng = np.random.default_rng(4)
    w = noisy_window(rng, frames=4)
    w.landmarks.seen[:, 3] = 0  # the newest frame's observations would change hands
    factors, work = QUADRATIC, blank_work(w)
    minimise(w, factors, work, 25, 0.0)
    whole = copy.deepcopy(w)
    marginalize_oldest(w, factors, work, np.zeros(POINTS, np.uint8))
    drop_oldest(w, work.links)
    assert w.frames.count[0] == 3
    before = w.frames.p[:3].copy()
    minimise(w, factors, work, 5, 0.0)
    assert w.frames.p[:3] == pytest.approx(before, abs=1e-6)
    assert before == pytest.approx(whole.frames.p[1:4])
    H = w.prior.H[: CALIBRATION + 2 * FRAME, : CALIBRATION + 2 * FRAME]
    assert np.linalg.eigvalsh(H).min() > -1e-6 * np.linalg.eigvalsh(H).max()


def test_damping_is_no_information(monkeypatch):
    """After a step that failed, the next one is damped; the factor, of which covariances are made, is not."""
    w, solve, dampings = noisy_window(np.random.default_rng(0)), kernel.solve, []
    size = CALIBRATION + FRAME * int(w.frames.count[0])

    def failing_once(H, b, size, damping, factor, step):
        dampings.append(damping)
        return len(dampings) > 1 and solve(H, b, size, damping, factor, step)

    monkeypatch.setattr(kernel, "solve", failing_once)
    work = blank_work(w)
    minimise(w, FACTORS, work, 2, 0.0)
    assert max(dampings) >= 1e-4
    L, H = np.tril(work.factor[:size, :size]), np.tril(work.H[:size, :size])
    assert np.diag(L @ L.T) == pytest.approx(np.diag(H), rel=1e-6, abs=1e-8)


def test_it_stops_as_soon_as_a_step_gains_little(monkeypatch):
    w, solve, steps = noisy_window(np.random.default_rng(0)), kernel.solve, []
    monkeypatch.setattr(kernel, "solve", lambda *a: steps.append(1) or solve(*a))
    work = blank_work(w)
    first = minimise(w, QUADRATIC, work, 25, 1e-3)
    assert 1 < len(steps) < 10
    steps.clear()
    assert minimise(w, QUADRATIC, work, 25, 1e-3) == pytest.approx(first, rel=2e-3)
    assert len(steps) == 1
