"""Pre-integration against brute force, its derivatives by the biases against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.state import ImuSamples, Preintegration, blank_preintegration
from tests.estimators.dvio.scenes import NOISE

PERIOD_NS = 5_000_000
SEEDS = st.integers(0, 10_000)


def stretch(rng: np.random.Generator, n: int = 30):
    t_ns = PERIOD_NS * np.arange(n, dtype=np.int64)
    rate = 2.0 * rng.normal(size=3) + rng.normal(size=(n, 3))
    force = np.array([0.0, 0.0, 9.81]) + 3.0 * rng.normal(size=(n, 3))
    return t_ns, np.hstack([rate, force])


def integrated(t_ns, samples, start_ns, end_ns, bias, noise=NOISE) -> Preintegration:
    z = blank_preintegration()
    kernel.integrate(z, ImuSamples(t_ns, samples, np.zeros(len(t_ns), np.uint8)), start_ns, end_ns, bias, noise)
    return z


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS)
@example(seed=8748)  # 10.6 rad/s
def test_agrees_with_numerical_integration(seed):
    rng = np.random.default_rng(seed)
    t_ns, samples = stretch(rng)
    bias = 0.05 * rng.normal(size=6)
    start, end = 7_000_000, 121_300_000
    z = integrated(t_ns, samples, start, end, bias)
    p, v, R, at, sub = np.zeros(3), np.zeros(3), Rotation.identity(), start, 80
    for i in range(1, len(t_ns)):
        until = min(int(t_ns[i]), end)
        if until <= at:
            continue
        h = (until - at) * 1e-9 / sub
        w, a = samples[i, :3] - bias[:3], samples[i, 3:] - bias[3:]
        for _ in range(sub):
            in_start = (R * Rotation.from_rotvec(0.5 * h * w)).apply(a)
            p = p + v * h + 0.5 * in_start * h * h
            v = v + in_start * h
            R = R * Rotation.from_rotvec(h * w)
        at = until
    # beyond 6 rad/s the kernel's steps of 5 ms have errors that grow with the fourth power of the rate
    growth = max(1.0, float(np.linalg.norm(samples[:, :3], axis=1).max()) / 6.0) ** 4
    assert z.dt[0] == pytest.approx((end - start) * 1e-9, rel=1e-12)
    assert z.delta_p == pytest.approx(p, abs=1e-7 * growth)
    assert z.delta_v == pytest.approx(v, abs=2e-6 * growth)
    assert z.delta_R == pytest.approx(R.as_matrix(), abs=1e-9)


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS)
def test_derivatives_by_the_biases_are_its_slopes(seed):
    rng = np.random.default_rng(seed)
    t_ns, samples = stretch(rng)
    end = int(t_ns[-1])
    at = integrated(t_ns, samples, 0, end, np.zeros(6))
    step = 1e-5
    for j in range(6):
        e = np.zeros(6)
        e[j] = step
        up, down = integrated(t_ns, samples, 0, end, e), integrated(t_ns, samples, 0, end, -e)
        turn = Rotation.from_matrix(down.delta_R.T @ up.delta_R).as_rotvec()
        slope = np.concatenate([up.delta_p - down.delta_p, turn, up.delta_v - down.delta_v]) / (2 * step)
        assert at.by_bias[:, j] == pytest.approx(slope, abs=2e-5)


def test_covariance_is_that_of_many_noisy_runs():
    rng = np.random.default_rng(5)
    t_ns, samples = stretch(rng)
    end, n = int(t_ns[-1]), 600
    exact = integrated(t_ns, samples, 0, end, np.zeros(6))
    sd = np.repeat([NOISE.rate, NOISE.force], 3) / np.sqrt(PERIOD_NS * 1e-9)
    errors = np.empty((n, 9))
    for k in range(n):
        z = integrated(t_ns, samples + sd * rng.normal(size=samples.shape), 0, end, np.zeros(6))
        turn = Rotation.from_matrix(exact.delta_R.T @ z.delta_R).as_rotvec()
        errors[k] = np.concatenate([z.delta_p - exact.delta_p, turn, z.delta_v - exact.delta_v])
    ratio = np.var(errors, axis=0) / np.diag(exact.covariance)
    assert np.all((ratio > 0.8) & (ratio < 1.25))


def test_an_invalid_sample_adds_noise():
    t_ns, samples = stretch(np.random.default_rng(1))
    sure = integrated(t_ns, samples, 0, int(t_ns[-1]), np.zeros(6))
    invalid = np.zeros(len(t_ns), np.uint8)
    invalid[10] = 1
    z = blank_preintegration()
    kernel.integrate(z, ImuSamples(t_ns, samples, invalid), 0, int(t_ns[-1]), np.zeros(6), NOISE)
    assert z.delta_p == pytest.approx(sure.delta_p)
    added = np.diag(z.covariance - sure.covariance)[6:]
    assert added == pytest.approx(np.full(3, (NOISE.invalid_force * 0.005) ** 2), rel=0.2)
