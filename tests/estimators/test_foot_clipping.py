"""Peaks beyond a sensor's range: known from their flanks, and left alone where nothing was cut."""

from dataclasses import replace

import numpy as np
import pytest
from foot_motion import ADIS16485, Walk, rig_of, walk
from scipy.spatial.transform import Rotation

from stridetwin.estimators.foot_ins import FootIns, FootInsSmoother, StartPose
from stridetwin.estimators.foot_ins.parameters import FootInsParameters
from stridetwin.streams.samples import Array
from tests.estimators.one_foot import with_values

EXACT = replace(ADIS16485, gyroscope_range=1e3, accelerometer_range=1e4)


@pytest.fixture(scope="module")
def truth() -> Walk:
    return walk(strides=12)


def clipped(truth: Walk, name: str, limit: float) -> Walk:
    columns = {**truth.imu.columns, name: np.clip(truth.imu.columns[name], -limit, limit)}
    return replace(truth, imu=replace(truth.imu, columns=columns))


def end_error(truth: Walk, path: Array) -> float:
    went = truth.p_imu_in_world[-1] - truth.p_imu_in_world[0]
    return float(np.linalg.norm(path[-1] - path[0] - went))


@pytest.mark.parametrize(
    ("name", "range_name", "share"),
    [("angular_rate", "gyroscope_range", 0.75), ("specific_force", "accelerometer_range", 0.75)],
)
def test_a_clipped_peak_is_restored(truth: Walk, name: str, range_name: str, share: float) -> None:
    limit = share * float(np.abs(truth.imu.columns[name]).max())
    cut = clipped(truth, name, limit)
    knows, blind = (
        FootIns(rig_of(calibration)).run(cut.imu).trajectory.p_frame_in_world
        for calibration in (replace(EXACT, **{range_name: limit}), EXACT)
    )
    assert end_error(truth, knows) < 0.5 * end_error(truth, blind)


def test_a_range_that_is_not_reached_changes_nothing(truth: Walk) -> None:
    wider = replace(EXACT, gyroscope_range=2e3, accelerometer_range=2e4)
    a, b = (FootIns(rig_of(c)).run(truth.imu).trajectory.p_frame_in_world for c in (EXACT, wider))
    np.testing.assert_array_equal(a, b)


def test_a_restored_peak_gives_no_information_on_the_heading(truth: Walk) -> None:
    """A turn of the world is seen by nothing: how well the heading was known at the start may not bend the path."""
    limit = 0.75 * float(np.abs(truth.imu.columns["angular_rate"]).max())
    calibration = replace(EXACT, gyroscope_range=limit)
    start = StartPose(p_imu_in_world=np.zeros(3), q_world_imu=truth.q_world_imu[0])
    sure, unsure = (
        FootIns(rig_of(calibration), start=replace(start, heading_sd=sd)).run(clipped(truth, "angular_rate", limit).imu)
        for sd in (1e-3, 0.5)
    )
    np.testing.assert_allclose(
        unsure.trajectory.p_frame_in_world, sure.trajectory.p_frame_in_world, atol=1e-5 * truth.distance
    )
    assert unsure.trajectory.covariance[-1, 5, 5] > 0.99 * 0.5**2


@pytest.mark.parametrize("curvature", [0.8, 1.6, 4.0])
def test_of_a_parabola_the_hidden_area_comes_back(curvature: float) -> None:
    still, top, limit = walk(strides=1), 150, 49.0
    force = still.imu.columns["specific_force"][:250].copy()
    force[:, 0] += np.maximum(80.0 - curvature * (np.arange(250) - top) ** 2, 0.0)
    cut = force.copy()
    cut[:, 0] = np.minimum(cut[:, 0], limit)

    def speed(force: Array, limit: float) -> float:
        columns = {"angular_rate": still.imu.columns["angular_rate"][:250], "specific_force": force}
        imu = replace(still.imu, t_ns=still.imu.t_ns[:250], columns=columns)
        nothing_stands = FootInsParameters(stationary_speed_mps=1e6, rest_level=0.0)
        ins = FootIns(rig_of(replace(EXACT, accelerometer_range=limit)), parameters=nothing_stands)
        return float(ins.run(imu).v_imu_in_world[top + 30, 0])

    true = speed(force, np.inf)
    hidden = float((force - cut).sum()) / 120.0
    assert true - speed(cut, np.inf) == pytest.approx(hidden, rel=0.02)
    assert true - speed(cut, limit) == pytest.approx(0.0, abs=0.08 * hidden)


def lost_turn(excess: Array) -> tuple[float, float]:
    """Hidden rotation of a peak, rad, and what the restored path lacks of it; `excess` is beyond the range, rad/s."""
    still, begin, limit = walk(strides=1), 150, np.radians(450.0)
    rate = np.zeros((250, 3))
    rate[begin : begin + len(excess), 1] = limit + excess
    cut = np.minimum(rate, limit)
    columns = {"angular_rate": cut, "specific_force": still.imu.columns["specific_force"][:250]}
    imu = replace(still.imu, t_ns=still.imu.t_ns[:250], columns=columns)
    nothing_stands = FootInsParameters(stationary_speed_mps=1e6, rest_level=0.0)

    def turn(gyro_range: float) -> float:
        ins = FootIns(rig_of(replace(EXACT, gyroscope_range=gyro_range)), parameters=nothing_stands)
        q = Rotation.from_quat(ins.run(imu).trajectory.q_world_frame, scalar_first=True)
        return float((q[begin - 1].inv() * q[begin + len(excess) + 10]).as_rotvec()[1])

    hidden = float((rate - cut).sum()) / 120.0
    return hidden, hidden - (turn(limit) - turn(1e3))


def test_a_foot_that_rolls_at_the_range_before_it_snaps_off_hides_little() -> None:
    """Excess of a toe-off of the twin (demo, seed 2): the slope of the snap says nothing of the plateau before it."""
    flanks = [[-4.3, -3.5, -2.6, -1.5, -0.6], [-0.6, -3.9, -7.7]]
    plateau = [0.17, 0.54, 0.54, 0.28, 0.0, 0.02, 0.33, 1.1, 1.95, 2.23, 1.6]
    hidden, lost = lost_turn(np.array([*flanks[0], *plateau, *flanks[1]]))
    assert 0.0 < hidden < 0.08
    assert abs(lost) < 1.5 * hidden


def test_a_dip_below_the_range_does_not_hide_the_peak_after_it() -> None:
    hidden, lost = lost_turn(np.array([-3.0, -1.8, -0.7, 0.3, 0.4, -0.1, 0.8, 1.6, 1.7, 0.9, -1.5, -4.5]))
    assert hidden > 0.0
    assert 0.0 <= lost < 0.75 * hidden  # all of it, without the slope beyond the peak alone


@pytest.mark.parametrize("length", [6, 10, 14])
@pytest.mark.parametrize("slope", [1.0, 4.0])
def test_no_peak_is_restored_far_beyond_what_a_foot_turns(length: int, slope: float) -> None:
    """However steep its ends, the mean of a restored peak stays below a share of what feet exceed the range by."""
    ends = slope * np.array([-2.5, -1.5, -0.5])
    hidden, lost = lost_turn(np.array([*ends, *np.zeros(length), *ends[::-1]]))
    assert hidden == 0.0
    assert 0.0 < -lost < 0.6 * (9.5 - np.radians(450.0)) * (length + 0.1) / 120.0


@pytest.mark.parametrize(("axis", "share"), [(2, 0.5), (2, 0.0), (0, 0.5)])
def test_a_landing_hides_a_share_of_the_range_upwards_and_of_nothing_else(axis: int, share: float) -> None:
    still, hit, limit = walk(strides=1), 150, 49.0
    force = still.imu.columns["specific_force"][:200].copy()
    force[hit : hit + 2, axis] = limit
    imu = replace(
        still.imu,
        t_ns=still.imu.t_ns[:200],
        columns={"angular_rate": still.imu.columns["angular_rate"][:200], "specific_force": force},
    )
    calibration = replace(EXACT, accelerometer_range=limit)

    def speed(excess: float) -> Array:
        nothing_stands = FootInsParameters(stationary_speed_mps=1e6, rest_level=0.0, impact_excess=excess)
        return FootIns(rig_of(calibration), parameters=nothing_stands).run(imu).v_imu_in_world[hit + 5]

    np.testing.assert_allclose(
        speed(share) - speed(0.0), [0.0, 0.0, share * limit * 2 / 120.0 * (axis == 2)], atol=1e-3
    )


def test_where_a_long_span_at_the_limit_has_no_shape_the_covariance_grows() -> None:
    still, begin, samples, limit = walk(strides=1), 150, 30, 49.0
    force = still.imu.columns["specific_force"][:250].copy()
    force[begin : begin + samples, 0] = limit
    columns = {"angular_rate": still.imu.columns["angular_rate"][:250], "specific_force": force}
    imu = replace(still.imu, t_ns=still.imu.t_ns[:250], columns=columns)

    def variance(noise: float) -> Array:
        nothing_stands = FootInsParameters(stationary_speed_mps=1e6, rest_level=0.0)
        ins = FootIns(rig_of(replace(EXACT, accelerometer_range=limit)), parameters=nothing_stands)
        ins._parameters = with_values(ins._parameters, accel_limit_noise_mps2_rthz=noise)
        last = [ins.update(sample) for sample in imu][begin + samples + 10]
        assert last is not None
        return np.diag(last.covariance)

    hidden, span = variance(3.0) - variance(0.0), samples / 120.0
    np.testing.assert_allclose(hidden[3], 3.0**2 * span, rtol=0.02)
    assert hidden[0] > 3.0**2 * span**3 / 3.0


@pytest.mark.parametrize("lag_s", [0.2, 1.0])
def test_a_smoothed_pose_inside_a_hidden_peak_has_the_peak_and_is_honest(lag_s: float) -> None:
    true = walk(strides=8, turn_rad=0.5, calibration=ADIS16485, rng=np.random.default_rng(5))
    rate = true.imu.columns["angular_rate"]
    limit = 0.9 * float(np.abs(rate).max())
    calibration = replace(EXACT, gyroscope_range=limit)
    start = StartPose(p_imu_in_world=true.p_imu_in_world[0], q_world_imu=true.q_world_imu[0])
    smoothed = FootInsSmoother(lag_s, calibration, start=start).run(clipped(true, "angular_rate", limit).imu).trajectory
    turn = Rotation.from_quat(true.q_world_imu, scalar_first=True)
    error = (turn * Rotation.from_quat(smoothed.q_world_frame, scalar_first=True).inv()).as_rotvec()
    assert smoothed.covariance is not None
    nees = np.einsum("ni,ni->n", error, np.linalg.solve(smoothed.covariance[:, 3:, 3:], error[..., None])[..., 0])
    hidden = np.abs(rate).max(axis=1) > limit
    assert hidden.sum() > 20
    assert nees[hidden].mean() < 3.0
    assert np.linalg.norm(np.diff(error, axis=0), axis=1).max() < np.radians(0.5)
    assert np.linalg.eigvalsh(smoothed.covariance).min() > 0.0


def test_a_restored_peak_gives_the_smoother_no_information_on_the_heading(truth: Walk) -> None:
    limit = 0.9 * float(np.abs(truth.imu.columns["angular_rate"]).max())
    calibration = replace(EXACT, gyroscope_range=limit)
    start = StartPose(p_imu_in_world=np.zeros(3), q_world_imu=truth.q_world_imu[0])
    sure, unsure = (
        FootInsSmoother(1.0, calibration, start=replace(start, heading_sd=sd))
        .run(clipped(truth, "angular_rate", limit).imu)
        .trajectory
        for sd in (1e-3, 0.5)
    )
    np.testing.assert_allclose(unsure.p_frame_in_world, sure.p_frame_in_world, atol=1e-4 * truth.distance)
    assert unsure.covariance is not None
    assert unsure.covariance[:, 5, 5].min() > 0.98 * 0.5**2
