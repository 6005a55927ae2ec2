"""Planes in depth images hold the pose where colour images show nothing; without them the covariance grows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import DEPTH_ONLY, IMU_ONLY, TRACKING
from stridetwin.estimators.dvio import Dvio
from stridetwin.estimators.dvio.depth_link import Planes, link_frames
from stridetwin.estimators.dvio.nav_state import blank_nav_state
from stridetwin.estimators.dvio.state import blank_window
from stridetwin.streams.samples import Depth, Image
from tests.estimators.dvio.test_dvio import errors
from tests.estimators.dvio.wall import Wall, rig, swaying

MOUNT = np.eye(4)
MOUNT[:3, :3], MOUNT[:3, 3] = Rotation.from_rotvec([0.1, -0.2, 0.05]).as_matrix(), [0.02, -0.01, 0.03]
ROOM = np.array([[0.0, 0.62, 0.1], [0.31, 0.02, 0.05], [0.03, 0.0, 0.33]])
"""A floor, a wall beside and one ahead: planes in 1/m in the camera's axes."""


def move_planes(pi, T, sd=0.0, seed=0):
    """Planes as a camera sees them from the pose T (4, 4) in the first one's axes, with noise."""
    seen = pi @ T[:3, :3] / (1.0 - pi @ T[:3, 3])[:, None]
    seen = seen + np.random.default_rng(seed).normal(0, sd, pi.shape)
    return Planes(pi=seen, covariance=np.tile(max(sd, 1e-3) ** 2 * np.eye(3), (len(pi), 1, 1)))


def measure_link(pi, sd=0.0, off=(0.03, -0.02, 0.01)):
    """The link between two frames, its true motion, and that motion in the axes of the earlier IMU."""
    calibration = blank_window(3, 4, MOUNT, 0.0).calibration
    T_imu = np.eye(4)
    T_imu[:3, :3], T_imu[:3, 3] = Rotation.from_rotvec([0.03, 0.06, -0.02]).as_matrix(), [0.2, -0.05, 0.3]
    T_camera = np.linalg.inv(MOUNT) @ T_imu @ MOUNT
    earlier, predicted = blank_nav_state(), blank_nav_state()
    predicted.R[:] = T_imu[:3, :3] @ Rotation.from_rotvec([0.004, -0.003, 0.005]).as_matrix()
    predicted.p[:] = T_imu[:3, 3] + off
    covariance = np.diag([0.05**2] * 3 + [0.01**2] * 3)
    link = link_frames(
        move_planes(pi, np.eye(4)), move_planes(pi, T_camera, sd), earlier, predicted, covariance, calibration
    )
    return link, T_imu, predicted


def test_three_planes_measure_the_whole_motion():
    link, T_imu, _ = measure_link(ROOM)
    assert link is not None
    np.testing.assert_allclose(link.dp, T_imu[:3, 3], atol=1e-6)
    np.testing.assert_allclose(link.dR, T_imu[:3, :3], atol=1e-6)
    assert np.linalg.eigvalsh(link.information).min() > 10.0


def test_the_information_is_that_of_the_noise():
    squares = []
    for seed in range(40):
        calibration = blank_window(3, 4, MOUNT, 0.0).calibration
        true, sd = np.eye(4), 2e-3
        true[:3, 3] = [0.1, 0.0, 0.2]
        T_camera = np.linalg.inv(MOUNT) @ true @ MOUNT
        after = move_planes(ROOM, T_camera, sd, seed)
        before = Planes(pi=ROOM, covariance=np.tile(1e-12 * np.eye(3), (3, 1, 1)))
        earlier, predicted = blank_nav_state(), blank_nav_state()
        predicted.p[:] = true[:3, 3]
        link = link_frames(before, after, earlier, predicted, np.diag([0.05**2] * 6), calibration)
        assert link is not None
        e = np.concatenate([link.dp - true[:3, 3], Rotation.from_matrix(link.dR).as_rotvec()])
        squares.append(e @ link.information @ e)
    assert 4.0 < np.mean(squares) < 8.0  # six degrees of freedom


def test_a_floor_alone_leaves_the_way_along_it_to_the_imu():
    link, T_imu, _ = measure_link(ROOM[:1])
    assert link is not None
    normal = MOUNT[:3, :3] @ ROOM[0] / np.linalg.norm(ROOM[0])
    assert normal @ (link.dp - T_imu[:3, 3]) == pytest.approx(0.0, abs=2e-3)
    along = np.linalg.svd(normal[None])[2][1:]
    for direction in along:
        assert direction @ link.information[:3, :3] @ direction < 1e-6 * normal @ link.information[:3, :3] @ normal
    value = np.linalg.eigvalsh(link.information)
    assert (value > 1.0).sum() == 3


def test_planes_of_another_room_are_no_link():
    calibration = blank_window(3, 4, MOUNT, 0.0).calibration
    here, there = move_planes(ROOM, np.eye(4)), move_planes(ROOM[:, [1, 2, 0]] * 1.7, np.eye(4))
    states = blank_nav_state(), blank_nav_state()
    assert link_frames(here, there, *states, np.diag([1e-4] * 6), calibration) is None
    assert link_frames(here, Planes(np.zeros((0, 3)), np.zeros((0, 3, 3))), *states, np.eye(6), calibration) is None


def darkened(wall, from_s, until_s, depth):
    """Samples of a wall whose colour images are black for some time; the depth ones stay if `depth`."""
    rng = np.random.default_rng(9)
    for s in wall.samples():
        if isinstance(s, Image) and from_s <= s.t_ns * 1e-9 < until_s:
            s = replace(s, pixels=rng.integers(0, 3, s.pixels.shape).astype(np.uint8))
        if isinstance(s, Depth) and not depth and from_s <= s.t_ns * 1e-9 < until_s:
            continue
        yield s


def follow(depth):
    """Estimates while a wall is dark from 3 to 9 of 12 s."""
    wall = Wall(swaying, 12.0, seed=3)
    odometry = Dvio(rig())
    made = [e for s in darkened(wall, 3.0, 9.0, depth) if (e := odometry.update(s)) is not None]
    return wall, made


def test_the_health_says_what_holds_the_pose():
    wall, made = follow(depth=True)
    t = np.array([e.t_ns for e in made]) * 1e-9
    health = np.array([e.health for e in made])
    assert set(health[(t > 3.5) & (t < 9.0)]) == {DEPTH_ONLY}
    assert set(health[t < 3.0]) == {TRACKING} == set(health[t > 9.6])
    # the distance from the wall is measured, the way along it is not
    p = np.array([e.pose.p_frame_in_world for e in made])
    sd = np.sqrt([np.diag(e.covariance)[:3] for e in made])
    dark = (t > 5.0) & (t < 9.0)
    assert sd[dark, 0].max() < 0.05
    assert sd[dark, 1].max() > 2.0 * sd[dark, 0].max()
    off = errors(wall, made)
    assert (off[dark] < 3.5 * np.linalg.norm(sd[dark], axis=1)).all()
    assert np.isfinite(p).all()


def test_without_images_and_depth_the_covariance_only_grows():
    wall, made = follow(depth=False)
    t = np.array([e.t_ns for e in made]) * 1e-9
    blind = [e for e in made if e.health == IMU_ONLY]
    assert len(blind) > 1000
    variance = np.array([np.trace(e.covariance[:3, :3]) for e in blind])
    assert np.all(np.diff(variance) > -1e-3 * variance[1:])
    assert variance[-1] > 100.0 * variance[0]
    off = errors(wall, made)
    sd = np.sqrt([np.trace(e.covariance[:3, :3]) for e in made])
    dark = (t > 4.0) & (t < 9.0)
    assert (off[dark] < 3.0 * sd[dark]).all()
    # images that come back measure the speed, not the place: what was gained in uncertainty stays
    later = [np.sqrt(np.trace(e.covariance[:3, :3])) for e in made if e.t_ns > 9.6e9]
    assert min(later) > 10.0 * sd[t < 3.0].max()
