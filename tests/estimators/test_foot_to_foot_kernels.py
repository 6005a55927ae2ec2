"""Updates between two feet against a textbook filter in NumPy: an echo, an image, and where corrections go."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.foot_ins.parameters import FootInsParameters, for_sensor
from stridetwin.estimators.foot_ins.state import ATTITUDE, D_ATTITUDE, D_POSITION, NAVIGATING, PHASE, POSITION, STATES
from stridetwin.estimators.foot_to_foot import FootToFootParameters, relative_updates, state
from stridetwin.estimators.foot_to_foot.parameters import for_kernel
from stridetwin.estimators.foot_to_foot.state import (
    ALL_STATES,
    CLOCKS,
    ECHOES,
    MOUNTS,
    NEVER,
    SCALES,
    blank_pair,
    board_workspace,
)
from tests.estimators.from_python import from_python
from tests.estimators.one_foot import take

FOOT = for_sensor(FootInsParameters(stationary_speed_mps=1e3), None)
NOW = 79 * 8_000_000


def pair_in_motion(seed=0):
    """Two tracked feet at arbitrary poses with all states correlated."""
    rng = np.random.default_rng(seed)
    mounts = np.column_stack([rng.normal(0, 0.1, (4, 3)), Rotation.random(4, rng=rng).as_quat(scalar_first=True)])
    arms = rng.normal(0, 0.05, (2, 3))
    pair = blank_pair(mounts, np.zeros((4, 6)), 0.0, 0.0, arms, np.zeros(3))
    k = np.arange(80)
    for foot in range(2):
        rate = (k[:, None] >= 40) * rng.normal(0.0, 3.0, (80, 3))
        take(pair.feet[foot], FOOT, k * 8_000_000, rate, np.tile([0.0, 0.0, 9.8], (80, 1)))
        assert pair.feet[foot].clock[PHASE] == NAVIGATING
        pair.feet[foot].nominal[POSITION : POSITION + 3] = rng.normal(0, 0.3, 3)
    B = rng.normal(size=(ALL_STATES, ALL_STATES))
    pair.covariance[:ALL_STATES, :ALL_STATES] = 1e-4 * (B @ B.T / ALL_STATES + 0.1 * np.eye(ALL_STATES))
    pair.error[:] = 0.0
    pair.nis[:] = 0.0
    return pair


def pose(pair, foot, error=None):
    """Position and rotation of a foot, moved by an error (74,)."""
    x, o = pair.feet[foot].nominal, STATES * foot
    error = np.zeros(ALL_STATES) if error is None else error
    R = Rotation.from_quat(x[ATTITUDE : ATTITUDE + 4], scalar_first=True).as_matrix()
    turn = Rotation.from_rotvec(error[o + D_ATTITUDE : o + D_ATTITUDE + 3]).as_matrix()
    return x[POSITION : POSITION + 3] + error[o + D_POSITION : o + D_POSITION + 3], turn @ R


def between(pair, sonar, error=None):
    """m, from a foot's sonar to the reflecting point of the other."""
    (p, R), (q, Q) = pose(pair, sonar, error), pose(pair, 1 - sonar, error)
    return float(np.linalg.norm(q + Q @ pair.sonars[1 - sonar] - p - R @ pair.sonars[sonar]))


@pytest.mark.parametrize("sonar", [0, 1])
@pytest.mark.parametrize("heard_s", [0.04, 5.0])
def test_an_echo_is_a_measurement_of_the_distance_between_two_points(sonar, heard_s):
    """Echoes within a second share one error: each counts for the time since the last one."""
    pair, parameters = pair_in_motion(), for_kernel(FootToFootParameters())
    P, before = pair.covariance[:ALL_STATES, :ALL_STATES].copy(), [f.nominal.copy() for f in pair.feet]
    pair.heard[sonar] = NOW - round(heard_s * 1e9)
    h = 1e-6
    H = np.array([(between(pair, sonar, h * e) - between(pair, sonar, -h * e)) / (2 * h) for e in np.eye(ALL_STATES)])
    off, noise = 0.12, 0.1**2
    distance = between(pair, sonar) + off
    spread = H @ P @ H
    correlated = noise / min(heard_s, 1.0)
    gain = P @ H / (spread + correlated)
    length = from_python(relative_updates.sonar_update)(pair, FOOT, parameters, sonar, NOW, distance)
    assert length == pytest.approx(off / np.sqrt(spread + noise), rel=1e-6)
    np.testing.assert_allclose(pair.nis[ECHOES], [length**2, 1.0], rtol=1e-9)
    assert pair.heard[sonar] == NOW
    assert pair.heard[1 - sonar] == NEVER
    for foot in range(2):
        moved = pair.feet[foot].nominal[POSITION : POSITION + 3] - before[foot][POSITION : POSITION + 3]
        np.testing.assert_allclose(moved, off * gain[STATES * foot : STATES * foot + 3], rtol=1e-5, atol=1e-10)
    mounts = slice(MOUNTS, ALL_STATES)
    expected = P - np.outer(gain, H @ P)
    np.testing.assert_allclose(pair.covariance[mounts, mounts], expected[mounts, mounts], rtol=1e-6, atol=1e-12)


def test_an_echo_of_something_else_or_while_the_other_shoe_is_seen_is_not_used():
    use, parameters = from_python(relative_updates.sonar_update), for_kernel(FootToFootParameters())
    pair = pair_in_motion()
    P, distance = pair.covariance.copy(), between(pair, 0)
    pair.seen[1] = NOW - 990_000_000
    assert use(pair, FOOT, parameters, 0, NOW, distance) == relative_updates.UNUSED
    pair.seen[1] = NEVER
    assert use(pair, FOOT, parameters, 0, NOW, distance + 3.0) == relative_updates.UNUSED
    assert use(pair, FOOT, parameters, 0, NOW + 10**9, distance) == relative_updates.UNUSED  # not tracked until then
    np.testing.assert_array_equal(pair.covariance, P)
    pair.seen[1] = NOW - 1_010_000_000
    assert use(pair, FOOT, parameters, 0, NOW, distance) == pytest.approx(0.0, abs=1e-9)
    published = for_kernel(FootToFootParameters(), published=True)
    for misfit, used in ((0.49, True), (-0.49, True), (0.51, False), (-0.51, False)):
        pair = pair_in_motion()
        pair.seen[1] = NOW
        distance = between(pair, 0) + misfit
        assert (use(pair, FOOT, published, 0, NOW, distance) != relative_updates.UNUSED) == used


def test_a_correction_reaches_mounts_clocks_and_scales():
    pair = pair_in_motion(2)
    error = 0.01 * np.random.default_rng(0).normal(size=ALL_STATES)
    pair.error[:ALL_STATES] = error
    mounts, late, scales = pair.mounts.copy(), pair.late.copy(), pair.scales.copy()
    poses = [pose(pair, foot, error) for foot in range(2)]
    from_python(state.inject_all)(pair)
    for foot in range(2):
        for a, b in zip(pose(pair, foot), poses[foot]):
            np.testing.assert_allclose(a, b, atol=1e-12)
    for i in range(4):
        o = MOUNTS + 6 * i
        np.testing.assert_allclose(pair.mounts[i, :3], mounts[i, :3] + error[o : o + 3])
        before = Rotation.from_quat(mounts[i, 3:], scalar_first=True)
        expected = Rotation.from_rotvec(error[o + 3 : o + 6]) * before
        after = Rotation.from_quat(pair.mounts[i, 3:], scalar_first=True)
        np.testing.assert_allclose(after.as_matrix(), expected.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(pair.late, late + error[CLOCKS : CLOCKS + 2])
    np.testing.assert_allclose(pair.scales.ravel(), scales.ravel() + error[SCALES : SCALES + 6])
    assert SCALES == CLOCKS + 2
    assert ALL_STATES == SCALES + 6
    assert not pair.error.any()


@pytest.mark.parametrize("misfit", [0.3, 4.0])
def test_an_image_is_reduced_to_the_same_information_on_the_boards_pose(misfit):
    """Of one linearisation: normal equations, right side, and how far the corners lie off any pose."""
    rng = np.random.default_rng(1)
    points = np.array([[0.02 * i, 0.02 * j, 0.0] for i in range(5) for j in range(4)]) - [0.04, 0.03, 0.0]
    p, R = np.array([0.03, -0.02, 0.4]), Rotation.from_euler("xyz", [0.3, 2.8, 0.2])
    sd, common = rng.uniform(1e-4, 3e-4, len(points)), 1e-4**2
    total = np.sqrt(sd**2 + common)

    def project(error):
        seen = Rotation.from_rotvec(error[3:]).apply(R.apply(points)) + p + error[:3]
        return seen[:, :2] / seen[:, 2:]

    rays = project(np.zeros(6)) + misfit * total[:, None] * rng.normal(size=(len(points), 2))
    h = 1e-6
    J = np.array([(project(h * e) - project(-h * e)) / (2 * h) / total[:, None] for e in np.eye(6)]).reshape(6, -1).T
    r = ((rays - project(np.zeros(6))) / total[:, None]).ravel()
    board = board_workspace()
    board.covariance[:] = 1e-12 * np.eye(6)  # so sure of the pose that the first linearisation settles
    rows = tuple(tuple(row) for row in R.as_matrix())
    ahead, alone = from_python(relative_updates.reduce_measurement)(
        board, tuple(p), rows, len(points), points, rays, sd, common, 3.0
    )
    assert ahead
    T, z = board.reduced.jacobian, board.reduced.innovation
    np.testing.assert_allclose(T.T @ T, J.T @ J, rtol=1e-5)
    np.testing.assert_allclose(T.T @ z, J.T @ r, rtol=1e-5, atol=1e-3)
    left = r - J @ np.linalg.lstsq(J, r, rcond=None)[0]
    assert alone == pytest.approx(max(1.0, np.linalg.norm(left) / np.sqrt(len(r) - 6)), rel=1e-6)
    behind = from_python(relative_updates.reduce_measurement)(
        board, (0.0, 0.0, 0.01), rows, len(points), points, rays, sd, common, 3.0
    )
    assert not behind[0]
