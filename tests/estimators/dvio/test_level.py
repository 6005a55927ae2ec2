"""Level ground as a measurement of the tilt, and the prior of the mount: derivatives, gates, and effect."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.estimators.dvio import DvioParameters, level
from stridetwin.estimators.dvio.mount_prior import MountPrior
from stridetwin.estimators.dvio.optimiser import blank_work, minimise
from stridetwin.estimators.dvio.state import CALIBRATION, D_ATTITUDE, D_ATTITUDE_IC, FRAME, WindowState
from tests.estimators.dvio.scenes import FACTORS, moved, seen_window

SD_RAD = DvioParameters().level_ground_sd_rad
STEP = 1e-6
DOWN = np.array([0.0, 0.0, -1.0])


def ground(w: WindowState, slot: int, slope_rad: float = 0.0) -> np.ndarray:
    """(3,) 1/m: ground 1.6 m below a frame's camera that rises along x, as `read_planes` measures it."""
    normal = Rotation.from_euler("y", -slope_rad).apply(DOWN)
    return np.asarray((w.frames.R[slot] @ w.calibration.R).T @ normal) / 1.6


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_jacobian_of_a_slope_is_its_derivative(seed):
    rng = np.random.default_rng(seed)
    w = seen_window(rng)
    w.calibration.focal[:] = [0.01, -0.02]
    measured = ground(w, 2, 0.02) + 0.01 * rng.normal(size=3)
    slope = level.slope_of(w, 2, measured)
    for column, i in enumerate(level.slope_columns(2)):
        other, error = copy.deepcopy(w), np.zeros(CALIBRATION + FRAME * 4)
        error[i] = STEP
        moved(other, error)
        derivative = (level.slope_of(other, 2, measured).r - slope.r) / STEP
        assert slope.J[:, column] == pytest.approx(derivative, abs=1e-5)


def test_a_slope_is_that_of_the_ground():
    w = seen_window(np.random.default_rng(1))
    assert level.slope_of(w, 1, ground(w, 1)).r == pytest.approx([0.0, 0.0], abs=1e-12)
    assert level.slope_of(w, 1, ground(w, 1, 0.02)).r == pytest.approx([np.sin(0.02), 0.0], abs=1e-9)


def slope(x: float) -> level.Slope:
    return level.Slope(r=np.array([x, 0.0]), J=np.hstack([np.zeros((2, 3)), np.eye(2, 3)]))


def tilted(sd: float) -> np.ndarray:
    return sd**2 * np.eye(6)


@pytest.mark.parametrize(
    ("slope_rad", "tilt_sd_rad", "used"),
    [
        (0.01, 0.01, True),  # an accelerometer bias of 10 mg
        (0.025, 0.01, True),
        (0.05, 0.02, False),  # a wheelchair ramp, however uncertain the tilt
        (0.015, 0.002, False),  # 0.9 degrees, once the vertical is known
        (0.0, 0.04, False),  # nobody knows yet what is level
    ],
)
def test_only_what_may_be_level_is_taken_as_level(slope_rad, tilt_sd_rad, used):
    assert (level.level_weight(slope(slope_rad), tilted(tilt_sd_rad), SD_RAD) > 0) == used


def test_an_unlikely_slope_counts_less():
    assert level.level_weight(slope(0.0), tilted(0.01), SD_RAD) == pytest.approx(SD_RAD**-2)
    assert level.level_weight(slope(0.025), tilted(0.01), SD_RAD) < 0.7 * SD_RAD**-2


def test_the_variance_of_a_slope_is_the_scatter_of_its_measurements():
    rng = np.random.default_rng(5)
    w = seen_window(rng)
    exact, covariance = ground(w, 1, 0.01), np.diag([4e-3, 2e-3, 1e-3]) ** 2
    slopes = [level.slope_of(w, 1, exact + rng.multivariate_normal(np.zeros(3), covariance)).r for _ in range(4000)]
    expected = 0.5 * np.var(slopes, axis=0).sum()
    assert level.slope_of(w, 1, exact, np.linalg.inv(covariance)).variance == pytest.approx(expected, rel=0.06)


def measured_slope(x: float, y: float, variance: float) -> level.Slope:
    return level.Slope(r=np.array([x, y]), J=np.zeros((2, 6)), variance=variance)


def test_planes_of_one_floor_are_as_uncertain_as_they_scatter():
    """Two of them agree, the third is a degree off: it moves the mean, which counts little."""
    alike = [measured_slope(0.001, 0.0, 1e-5), measured_slope(-0.001, 0.0, 1e-5)]
    mean = level.mean_slope(alike, [0.0, 0.0])
    assert mean.r == pytest.approx([0.0, 0.0])
    assert mean.variance == pytest.approx(1e-5 + 0.5e-6)
    torn = level.mean_slope([*alike, measured_slope(0.0, 0.018, 1e-5)], [0.0, 0.0, 0.0])
    assert torn.r == pytest.approx([0.0, 0.006])
    assert torn.variance == pytest.approx(1e-5 + (2 * (1e-6 + 0.006**2) + 0.012**2) / 6)
    flat = tilted(0.01)
    assert level.level_weight(torn, flat, SD_RAD) < 0.5 * level.level_weight(alike[0], flat, SD_RAD)


def test_a_better_known_plane_counts_more():
    mean = level.mean_slope([measured_slope(0.0, 0.0, 1e-6), measured_slope(0.01, 0.0, 9e-6)], [1.0, 1.0])
    assert mean.r == pytest.approx([0.001, 0.0])


def test_a_floor_counts_more_than_the_gentle_ramp_behind_it():
    """Of two planes that may be level but not both, the likelier one: with 0.65° of tilt, 0° against 1.8°."""
    floor, ramp = slope(0.0)._replace(variance=1e-5), slope(0.0314)._replace(variance=1e-5)
    unknown = tilted(0.0113)
    misfits = [level.misfit(plane, unknown, SD_RAD) for plane in (floor, ramp)]
    assert misfits == pytest.approx([0.0, 0.0314**2 / (0.0113**2 + SD_RAD**2 + 1e-5)])
    mean = level.mean_slope([floor, ramp], misfits)
    ratio = np.exp(-0.5 * misfits[1])
    assert mean.r[0] == pytest.approx(0.0314 * ratio / (1.0 + ratio))
    assert mean.r[0] < 0.002


@pytest.mark.parametrize(
    ("slope_rad", "at_start", "later"), [(0.03, True, True), (0.039, True, False), (0.044, False, False)]
)
def test_the_ground_of_the_start_may_be_steeper(slope_rad, at_start, later):
    unknown = tilted(0.0113)
    assert (level.level_weight(slope(slope_rad), unknown, SD_RAD, at_start=True) > 0) == at_start
    assert (level.level_weight(slope(slope_rad), unknown, SD_RAD) > 0) == later


def prior_of(w: WindowState, tilt_sd: float = 0.01, mount_sd: float = 5e-3) -> None:
    """A prior of all states, in which the first frame's tilt is uncertain."""
    n = CALIBRATION + FRAME * 4
    w.prior.H[range(n), range(n)] = 1e6
    own = CALIBRATION + D_ATTITUDE
    w.prior.H[range(own, own + 3), range(own, own + 3)] = tilt_sd**-2
    at = range(D_ATTITUDE_IC, D_ATTITUDE_IC + 3)
    w.prior.H[at, at] = mount_sd**-2


def test_level_ground_corrects_the_tilt():
    w = seen_window(np.random.default_rng(3), frames=1)
    prior_of(w)
    truth = w.frames.R[0].copy()
    measured = ground(w, 0)
    w.frames.R[0] = Rotation.from_euler("x", 0.01).as_matrix() @ truth
    work = blank_work(w)
    minimise(w, FACTORS, work, 1, 1e-3)
    size = CALIBRATION + FRAME
    before = level.slope_of(w, 0, measured)
    covariance = level.covariance_of(level.slope_columns(0), work.factor, size)
    assert np.sqrt(np.diag(covariance)) == pytest.approx([5e-3] * 3 + [0.01] * 3, rel=1e-3)
    weight = level.level_weight(before, covariance, SD_RAD)
    assert weight > 0
    level.add_level(w, 0, before, weight)
    minimise(w, FACTORS, work, 3, 1e-9)
    after = level.slope_of(w, 0, measured)
    assert np.linalg.norm(before.r) == pytest.approx(0.01, rel=0.01)
    expected = SD_RAD**2 / (SD_RAD**2 + 0.01**2 + 5e-3**2)
    assert np.linalg.norm(after.r) == pytest.approx(expected * 0.01, rel=0.05)
    tilt = after.J @ level.covariance_of(level.slope_columns(0), work.factor, size) @ after.J.T
    assert np.sqrt(np.diag(tilt)).max() < SD_RAD


def test_a_second_observation_continues_from_the_first():
    """The same ground once more, after the states have moved, pulls to the same place."""
    w = seen_window(np.random.default_rng(4), frames=1)
    prior_of(w)
    measured, work = ground(w, 0), blank_work(w)
    w.frames.R[0] = Rotation.from_euler("y", 0.01).as_matrix() @ w.frames.R[0]
    left = []
    for _ in range(4):
        level.add_level(w, 0, level.slope_of(w, 0, measured), SD_RAD**-2)
        minimise(w, FACTORS, work, 3, 1e-9)
        left.append(float(np.linalg.norm(level.slope_of(w, 0, measured).r)))
    s2 = SD_RAD**2 / (0.01**2 + 5e-3**2)
    assert left == pytest.approx([0.01 * s2 / (s2 + k) for k in (1, 2, 3, 4)], rel=0.08)


def start(w: WindowState, slope_rad: float) -> MountPrior:
    """The first observation of ground by a window that begins, of a calibrated mount and a tilt known to 0.6°."""
    prior_of(w)
    mount = MountPrior(np.array([2e-3, 5e-3]), np.array([0.03, 0.04]))
    work = blank_work(w)
    minimise(w, FACTORS, work, 1, 1e-3)
    weights = np.tile(1e6 * np.eye(3), (2, 1, 1))
    planes = np.array([ground(w, 0, slope_rad), 1.05 * ground(w, 0, slope_rad)])
    level.LevelGround(SD_RAD, used=True).observe(w, work.factor, 0, planes, weights, mount)
    minimise(w, FACTORS, work, 3, 1e-9)
    return mount


@pytest.mark.parametrize(("slope_rad", "is_mount"), [(0.015, False), (0.06, True), (0.1, True), (0.14, False)])
def test_a_mount_that_is_off_is_seen_at_the_start(slope_rad, is_mount):
    """Ground that is too steep for the tilt turns the mount, by most of its slope, and nothing else."""
    w = seen_window(np.random.default_rng(3), frames=1)
    R, R_camera = w.frames.R[0].copy(), w.calibration.R.copy()
    mount = start(w, slope_rad)
    turned = Rotation.from_matrix(w.calibration.R @ R_camera.T).magnitude()
    tilted_by = Rotation.from_matrix(w.frames.R[0] @ R.T).magnitude()
    assert (mount.sd[1] > 0.02) == is_mount
    if is_mount:
        assert turned == pytest.approx(slope_rad * 0.04**2 / (0.04**2 + level.START_MOUNT_SD_RAD**2), rel=0.08)
        assert tilted_by < 2e-3
    else:
        assert turned < 0.005


def test_the_slope_of_a_mount_needs_planes_that_agree():
    floor, other = slope(0.07)._replace(variance=1e-5), slope(0.11)._replace(variance=1e-5)
    known, unknown = tilted(0.01), tilted(0.03)
    alone = level.start_slope([floor, slope(0.2)], known)
    assert alone is not None
    assert alone.r == pytest.approx(floor.r)
    assert not alone.J[:, 3:].any()
    assert level.start_slope([floor, other], known) is None
    assert level.start_slope([floor], unknown) is None
    assert level.start_slope([slope(0.2)], known) is None


def mounted(off_rad: float, spread_rad: float) -> tuple[MountPrior, WindowState]:
    """A mount prior after thirty keyframes that estimate the mount off by so much, with such a standard deviation."""
    w = seen_window(np.random.default_rng(5))
    mount = MountPrior(np.array([2e-3, 5e-3]), np.array([0.03, 0.04]))
    w.prior.H[range(6), range(6)] = mount.start(w.calibration.moved[:6]) ** -2
    w.calibration.moved[D_ATTITUDE_IC] = off_rad
    for _ in range(30):
        mount.update(w, np.diag([1.0] * 3 + [spread_rad**2] * 3))
    return mount, w


def test_a_mount_as_calibrated_keeps_the_accuracy_of_its_calibration():
    mount, w = mounted(3e-3, 2e-3)
    assert mount.sd == pytest.approx([0.03, 5e-3])
    assert np.diag(w.prior.H)[:6] == pytest.approx([0.03**-2] * 3 + [5e-3**-2] * 3)
    assert w.prior.b[:6] == pytest.approx(np.zeros(6))


def test_a_mount_that_has_slipped_is_not_held_back():
    mount, _ = mounted(0.05, 2e-3)
    assert mount.sd[1] > 0.02


def test_the_prior_of_a_mount_begins_with_the_calibration_s_rotation_and_waits_for_a_measured_position():
    w = seen_window(np.random.default_rng(5))
    mount = MountPrior(np.array([2e-3, 5e-3]), np.array([0.03, 0.04]))
    w.prior.H[range(6), range(6)] = mount.start(w.calibration.moved[:6]) ** -2
    assert mount.sd == pytest.approx([0.03, 5e-3])
    mount.update(w, np.diag([0.03**2] * 3 + [5e-3**2] * 3))
    assert mount.sd == pytest.approx([0.03, 5e-3])
    mount.update(w, np.diag([1e-3**2] * 3 + [5e-3**2] * 3))
    assert mount.sd[0] < 0.01


def test_a_known_mount_stays_known():
    mount = MountPrior(np.zeros(2), np.array([0.03, 0.04]))
    assert not mount.is_adaptive
    assert mount.start(np.zeros(6)) == pytest.approx(np.zeros(6))


def test_a_restart_keeps_what_is_known_of_the_mount():
    mount, w = mounted(3e-3, 2e-3)
    assert mount.start(w.calibration.moved[:6])[3:] == pytest.approx([5e-3] * 3)
