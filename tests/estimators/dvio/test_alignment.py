"""Structure from motion and its alignment with the IMU, on walks of known state."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.dvio import DvioParameters, initializer, kernel
from stridetwin.estimators.dvio import structure_from_motion as sfm
from stridetwin.estimators.dvio.initializer import Initializer, Priors, align_vision_imu, solve_gyro_bias
from stridetwin.estimators.dvio.optimiser import preintegrate
from stridetwin.estimators.dvio.sliding_window import SlidingWindow
from stridetwin.estimators.dvio.state import ImuSamples, Preintegration, blank_preintegration
from stridetwin.estimators.dvio.structure_from_motion import Observations, structure_with_depth, structure_without_depth
from stridetwin.estimators.dvio.tracker import CameraFrame
from stridetwin.streams.samples import Image, Imu
from tests.estimators.dvio.scenes import NOISE, T_IMU_CAMERA
from tests.estimators.dvio.wall import Wall, rig, swaying

GRAVITY = np.array([0.0, 0.0, -9.81])
PERIOD_NS, IMAGES, BETWEEN, POINTS = 5_000_000, 8, 20, 80
SIGHT_SD, TOLD_SD = 8e-4, 0.014
BIAS_SD, MOUNT_SD, OFFSET_SD, SCALE_SD = np.repeat([0.02, 0.1], 3), np.repeat([2e-3, 5e-3], 3), 5e-3, 1e-2


class Walk(NamedTuple):
    """What is measured of some images of a walk, and the truth about the newest."""

    observations: Observations
    preintegrations: Preintegration
    rates: np.ndarray
    priors: Priors
    up: np.ndarray
    v: np.ndarray
    bias: np.ndarray
    way_m: float

    def align_vision_imu(self, structure):
        later = Preintegration(*(a[structure.first :] for a in self.preintegrations))
        return align_vision_imu(structure, later, self.rates[structure.first :], self.priors)

    def error(self, found):
        tilt = found.tilt_axes.T @ np.cross(self.up, found.up)
        return np.concatenate([tilt, self.v - found.v[-1], self.bias - found.bias])


def walked(seed: int, noisy: bool, depth: bool, believed_sd: np.ndarray = BIAS_SD) -> Walk:
    """A head that bobs and turns as in walking; without noise also the calibration is as measured."""
    rng = np.random.default_rng(seed)
    n = BETWEEN * (IMAGES - 1) + 1
    t_ns = PERIOD_NS * np.arange(n, dtype=np.int64)
    s, phase = t_ns[:, None] * 1e-9, rng.uniform(0, 2 * np.pi, 6)
    rate = np.array([0.4, 0.3, 0.5]) * np.sin(2 * np.pi * np.array([1.8, 1.1, 0.6]) * s + phase[:3])
    pushed = np.array([1.5, 0.8, 3.0]) * np.sin(2 * np.pi * np.array([1.8, 0.9, 1.8]) * s + phase[3:])
    first = Rotation.from_rotvec(0.3 * rng.normal(size=3)) * Rotation.from_euler("x", -90, degrees=True)
    about = [first]
    for k in range(1, n):
        about.append(about[-1] * Rotation.from_rotvec(rate[k] * PERIOD_NS * 1e-9))
    force = np.array([about[max(k - 1, 0)].inv().apply(pushed[k] - GRAVITY) for k in range(n)])
    true, invalid, v_first = (
        np.hstack([rate, force]),
        np.zeros(n, np.uint8),
        rng.normal([0.0, 1.0, 0.0], [0.4, 0.2, 0.2]),
    )
    at_image, z, R_first = t_ns[::BETWEEN], blank_preintegration(), first.as_matrix()
    R, p, v = np.zeros((IMAGES, 3, 3)), np.zeros((IMAGES, 3)), np.zeros((IMAGES, 3))
    for k, end in enumerate(at_image):
        kernel.integrate(z, ImuSamples(t_ns, true, invalid), 0, int(end), np.zeros(6), NOISE)
        dt = z.dt[0]
        R[k], v[k] = R_first @ z.delta_R, v_first + GRAVITY * dt + R_first @ z.delta_v
        p[k] = v_first * dt + 0.5 * GRAVITY * dt**2 + R_first @ z.delta_p
    bias = BIAS_SD * rng.normal(size=6)
    white = np.repeat([NOISE.rate, NOISE.force], 3) / np.sqrt(PERIOD_NS * 1e-9)
    measured, preintegrations = (
        true + bias + noisy * white * rng.normal(size=true.shape),
        blank_preintegration(IMAGES - 1),
    )
    for k in range(IMAGES - 1):
        ends = int(at_image[k]), int(at_image[k + 1])
        preintegrate(preintegrations, k, ImuSamples(t_ns, measured, invalid), *ends, np.zeros(6), NOISE)
    off = noisy * rng.normal(size=8)
    R_ic = T_IMU_CAMERA[:3, :3] @ Rotation.from_rotvec(off[3:6] * MOUNT_SD[3:]).as_matrix()
    R_seen = R @ Rotation.from_rotvec(rate[::BETWEEN] * off[6] * OFFSET_SD).as_matrix()
    cameras, places = (
        R_seen @ R_ic,
        p + v * off[6] * OFFSET_SD + R_seen @ (T_IMU_CAMERA[:3, 3] + off[:3] * MOUNT_SD[:3]),
    )
    rays = np.concatenate([rng.uniform(-0.6, 0.6, (POINTS, 2)), np.ones((POINTS, 1))], axis=1)
    middle = IMAGES // 2
    points = (rays * rng.uniform(1.5, 5.0, (POINTS, 1))) @ cameras[middle].T + places[middle]
    q = np.matmul(points[None] - places[:, None], cameras)
    at, inverse = q[..., :2] / q[..., 2:], np.exp(off[7] * SCALE_SD) / q[..., 2]
    seen = (q[..., 2] > 0.3) & (np.abs(at) < 0.75).all(axis=-1)
    observations = Observations(
        seen=seen,
        at=at + noisy * SIGHT_SD * rng.normal(size=at.shape),
        rho=np.where(seen & depth, inverse + noisy * TOLD_SD * rng.normal(size=inverse.shape), 0.0),
        sd=SIGHT_SD,
        rho_sd=TOLD_SD,
    )
    priors = Priors(
        T_imu_camera=T_IMU_CAMERA,
        bias=np.zeros(6),
        bias_sd=believed_sd,
        mount_sd=noisy * MOUNT_SD,
        offset_sd=noisy * OFFSET_SD,
        scale_sd=noisy * SCALE_SD,
        gravity=9.81,
    )
    last, way_m = R[-1].T, float(np.linalg.norm(places[0] - places[-1]))
    return Walk(observations, preintegrations, measured[::BETWEEN, :3], priors, last[:, 2], last @ v[-1], bias, way_m)


METHODS = {"depth": structure_with_depth, "bearings": structure_without_depth}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", range(4))
def test_finds_all_where_nothing_is_uncertain(method, seed):
    # Nothing is believed of the biases beforehand: the rotation separates that of the accelerometer from gravity.
    walk = walked(seed, noisy=False, depth=method == "depth", believed_sd=np.repeat([0.1, 10.0], 3))
    structure = METHODS[method](walk.observations)
    assert structure.misfit < 1e-6
    found = walk.align_vision_imu(structure)
    assert solve_gyro_bias(structure, walk.preintegrations, walk.priors) == pytest.approx(walk.bias[:3], abs=1e-3)
    assert found.bias[:3] == pytest.approx(walk.bias[:3], abs=1e-3)
    assert found.up == pytest.approx(walk.up, abs=5e-3)
    assert found.v[-1] == pytest.approx(walk.v, abs=5e-3)
    assert found.scale == pytest.approx(1.0 if method == "depth" else walk.way_m, rel=5e-3)


@pytest.mark.parametrize("method", METHODS)
def test_covariance_is_that_of_the_errors(method):
    squares, tilts, speeds = [], [], []
    for seed in range(40):
        walk = walked(seed, noisy=True, depth=method == "depth")
        structure = METHODS[method](walk.observations)
        if structure is None or (found := walk.align_vision_imu(structure)) is None:
            continue
        e, P = walk.error(found), found.covariance[:11, :11]
        assert np.linalg.eigvalsh(P).min() > 0
        squares.append(e @ np.linalg.solve(P, e))
        tilts.append(np.linalg.norm(e[:2]))
        speeds.append(np.linalg.norm(e[2:5]))
    assert len(squares) >= 36
    assert 8.0 < np.mean(squares) < 14.5  # 11 ± 3 standard deviations of a mean of 36, and what is not linear
    assert np.median(tilts) < 0.02  # the accelerometer's bias: 0.1 m/s² on either axis
    assert np.median(speeds) < 0.03


def test_what_passes_by_is_left_out():
    walk = walked(3, noisy=True, depth=True)
    by = np.zeros(POINTS, bool)
    by[:25] = True
    at = walk.observations.at.copy()
    at[:, by] += 0.05 * np.arange(IMAGES)[:, None, None]
    found = walk.align_vision_imu(structure_with_depth(Observations(**{**vars(walk.observations), "at": at})))
    assert np.linalg.norm(found.v[-1] - walk.v) < 0.05
    assert np.linalg.norm(np.cross(found.up, walk.up)) < 0.04


def test_says_nothing_of_too_few_points():
    s = walked(0, noisy=True, depth=True).observations
    for many in (0, 1, 8):
        few = Observations(seen=s.seen[:, :many], at=s.at[:, :many], rho=s.rho[:, :many], sd=s.sd, rho_sd=s.rho_sd)
        assert structure_with_depth(few) is None
        assert structure_without_depth(few) is None


def test_state_covariance_turns_with_the_heading():
    walk = walked(1, noisy=True, depth=True)
    found = walk.align_vision_imu(structure_with_depth(walk.observations))
    x = np.cross(found.up, [0.0, 1.0, 0.0]) / np.linalg.norm(np.cross(found.up, [0.0, 1.0, 0.0]))
    R = np.stack([x, np.cross(found.up, x), found.up])
    P = found.state_covariance(R, 0.25 * np.eye(3), 0.3)
    assert np.allclose(P, P.T)
    assert found.up @ P[3:6, 3:6] @ found.up == pytest.approx(0.09)
    v = R @ found.v[-1]
    sideways = np.array([-v[1], v[0], 0.0])
    # a heading that is off by an angle turns the velocity by it
    assert sideways @ P[6:9, 3:6] @ found.up == pytest.approx(0.09 * sideways @ sideways, rel=0.05)
    assert P[:3, :3] == pytest.approx(0.25 * np.eye(3))


def test_products_are_summed_over_both_directions_and_the_depth():
    products = np.random.default_rng(1).normal(size=(2, 5, 3, 6, 3))
    np.testing.assert_allclose(sfm._sum_residuals(products), products.sum(axis=2))


def test_a_later_start_uses_what_is_known_of_lens_and_depth(monkeypatch):
    """After a loss, the window's focal lengths and depth scale correct the observations."""

    def observations(focal: list[float], scale: float) -> Observations:
        made = []
        monkeypatch.setattr(initializer, "structure_with_depth", lambda s: made.append(s))
        wall = Wall(lambda t: swaying(t + 3.0), 0.7, seed=7)
        core = SlidingWindow(rig().cameras["/head/color"], rig().imus["/head/imu"], np.eye(4), DvioParameters())
        core.window.calibration.focal[:], core.window.calibration.scale[0] = focal, scale
        found = Initializer(core)
        for sample in wall.samples():
            if isinstance(sample, Imu):
                core.inertial.add(sample)
            elif isinstance(sample, Image):
                grey, t_ns = sample.pixels, sample.t_ns
            elif core.inertial.covers(t_ns):
                found.process_image(CameraFrame(t_ns=t_ns, grey=grey, depth=sample.depth))
        return made[0]

    nominal, corrected = observations([0.0, 0.0], 1.0), observations([0.01, -0.02], 1.05)
    seen = nominal.seen
    assert seen.sum() > 100
    assert corrected.at[seen] == pytest.approx(nominal.at[seen] * [1.01, 0.98])
    assert corrected.rho[seen] == pytest.approx(nominal.rho[seen] / 1.05)
