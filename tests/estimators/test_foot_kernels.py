"""Steps of the foot's filter: each is compared with a linear filter in NumPy whose Jacobians are numerical."""

import numpy as np
import pytest
from scipy.linalg import sqrtm
from scipy.spatial.transform import Rotation

from stridetwin.estimators.foot_ins import FootInsParameters, creep, rest, stance, state, strapdown
from stridetwin.estimators.foot_ins.parameters import for_sensor
from tests.estimators.from_python import from_python
from tests.estimators.one_foot import with_values

GRAVITY, DT = 9.81, 0.008
RATE, FORCE = (0.7, -1.3, 0.4), (1.5, -2.0, 11.0)
ROW = 3
"""First row of the foot's states in a larger filter."""


def mixed(n, seed=4):
    """(n, n) symmetric positive definite."""
    B = np.random.default_rng(seed).normal(size=(n, n))
    return 0.01 * (B @ B.T / n + 0.1 * np.eye(n))


def foot(states=state.STATES + 5, row=ROW):
    """Memory of a foot in motion with all states correlated, inside a larger filter."""
    memory = state.initial_state(mixed(states), np.zeros(states), row)
    x = memory.nominal
    x[state.POSITION : state.POSITION + 3], x[state.VELOCITY : state.VELOCITY + 3] = (1.0, -2.0, 0.5), (0.3, -0.2, 0.1)
    x[state.ATTITUDE : state.ATTITUDE + 4] = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_quat(scalar_first=True)
    x[state.GYRO_BIAS : state.GYRO_BIAS + 3], x[state.ACCEL_BIAS : state.ACCEL_BIAS + 3] = (
        (0.01, -0.02, 0.03),
        (0.05, 0.02, -0.04),
    )
    x[state.CONTACT : state.CONTACT + 3], x[state.FLOOR], x[state.DRIFT], x[state.SCALE] = (
        (0.02, -0.01, 0.005),
        0.4,
        0.01,
        0.02,
    )
    memory.lever[:] = 0.02, -0.01, -0.09
    return memory


def moved(x, error):
    """The true state of a nominal one (22,) and an error (21,), with the attitude as a rotation."""
    R = Rotation.from_rotvec(error[state.D_ATTITUDE : state.D_ATTITUDE + 3]) * Rotation.from_quat(
        x[state.ATTITUDE : state.ATTITUDE + 4], scalar_first=True
    )
    y = x.copy()
    for to, of, n in (
        (state.POSITION, state.D_POSITION, 3),
        (state.VELOCITY, state.D_VELOCITY, 3),
        (state.GYRO_BIAS, state.D_GYRO_BIAS, 3),
        (state.ACCEL_BIAS, state.D_ACCEL_BIAS, 3),
        (state.CONTACT, state.D_CONTACT, 3),
        (state.FLOOR, state.D_FLOOR, 1),
        (state.DRIFT, state.D_DRIFT, 1),
        (state.SCALE, state.D_SCALE, 1),
    ):
        y[to : to + n] += error[of : of + n]
    y[state.ATTITUDE : state.ATTITUDE + 4] = R.as_quat(scalar_first=True)
    return y


def difference(true, x):
    """(21,) the error that takes a nominal state to a true one; the inverse of `moved`."""
    error = np.zeros(state.STATES)
    for to, of, n in (
        (state.POSITION, state.D_POSITION, 3),
        (state.VELOCITY, state.D_VELOCITY, 3),
        (state.GYRO_BIAS, state.D_GYRO_BIAS, 3),
        (state.ACCEL_BIAS, state.D_ACCEL_BIAS, 3),
        (state.CONTACT, state.D_CONTACT, 3),
        (state.FLOOR, state.D_FLOOR, 1),
        (state.DRIFT, state.D_DRIFT, 1),
        (state.SCALE, state.D_SCALE, 1),
    ):
        error[of : of + n] = true[to : to + n] - x[to : to + n]
    a, b = (Rotation.from_quat(y[state.ATTITUDE : state.ATTITUDE + 4], scalar_first=True) for y in (true, x))
    error[state.D_ATTITUDE : state.D_ATTITUDE + 3] = (a * b.inv()).as_rotvec()
    return error


def slopes(function, n, h=1e-6):
    """Jacobian of a vector function at 0, by central differences."""
    return np.array([(function(h * e) - function(-h * e)) / (2.0 * h) for e in np.eye(n)]).T


def propagated(x, dt=DT):
    y = x.copy()
    from_python(strapdown.propagate_state)(y, RATE, FORCE, dt, GRAVITY, (0.02, -0.01, -0.09))
    return y


def test_a_constant_rate_and_force_move_a_foot_as_their_integral_does():
    """Of ten thousand small steps with SciPy's rotations."""
    x = foot().nominal
    x[state.SCALE] = x[state.DRIFT] = 0.0
    p, v = x[state.POSITION : state.POSITION + 3].copy(), x[state.VELOCITY : state.VELOCITY + 3].copy()
    start = Rotation.from_quat(x[state.ATTITUDE : state.ATTITUDE + 4], scalar_first=True)
    w, f = (
        np.subtract(RATE, x[state.GYRO_BIAS : state.GYRO_BIAS + 3]),
        np.subtract(FORCE, x[state.ACCEL_BIAS : state.ACCEL_BIAS + 3]),
    )
    n, h = 10_000, DT / 10_000
    attitudes = start * Rotation.from_rotvec(np.outer((np.arange(n) + 0.5) * h, w))
    acceleration = attitudes.apply(f) - [0.0, 0.0, GRAVITY]
    speeds = v + h * np.cumsum(acceleration, axis=0)
    after = propagated(x)
    np.testing.assert_allclose(after[state.VELOCITY : state.VELOCITY + 3], speeds[-1], atol=1e-7)
    np.testing.assert_allclose(
        after[state.POSITION : state.POSITION + 3], p + h * (speeds - 0.5 * h * acceleration).sum(0), atol=1e-6
    )
    turned = start * Rotation.from_rotvec(w * DT)
    np.testing.assert_allclose(
        after[state.ATTITUDE : state.ATTITUDE + 4], turned.as_quat(scalar_first=True), atol=1e-12
    )


def test_a_gyro_that_reads_too_much_across_the_sole_turns_less_about_those_axes_alone():
    x = foot().nominal
    start = Rotation.from_quat(x[state.ATTITUDE : state.ATTITUDE + 4], scalar_first=True)
    down = np.array([0.02, -0.01, -0.09]) / np.linalg.norm([0.02, -0.01, -0.09])
    w = np.subtract(RATE, x[state.GYRO_BIAS : state.GYRO_BIAS + 3])
    across = w - (w @ down) * down
    turned = start * Rotation.from_rotvec((w - x[state.SCALE] * across) * DT)
    np.testing.assert_allclose(
        propagated(x)[state.ATTITUDE : state.ATTITUDE + 4], turned.as_quat(scalar_first=True), atol=1e-12
    )


def test_the_height_drifts_by_a_share_of_the_path_and_a_negative_step_takes_all_back():
    x = foot().nominal
    level = x.copy()
    level[state.DRIFT] = 0.0
    with_drift, without = propagated(x), propagated(level)
    path = np.linalg.norm(without[state.POSITION : state.POSITION + 3] - x[state.POSITION : state.POSITION + 3])
    lost = with_drift - without
    assert lost[state.POSITION + 2] == pytest.approx(-x[state.DRIFT] * path, rel=1e-9)
    lost[[state.POSITION + 2, state.DRIFT]] = 0.0
    np.testing.assert_allclose(lost, 0.0, atol=1e-15)
    np.testing.assert_allclose(propagated(with_drift, -DT), x, atol=1e-12)


def test_the_covariance_of_a_step_is_that_of_its_slopes():
    """Also the cross-covariances with the states of another foot, in front and behind.

    The step is short, and scale and drift are 0: the model neglects terms of the second order.
    """
    memory, dt = foot(), 0.001
    memory.nominal[[state.SCALE, state.DRIFT]] = 0.0
    x, P = memory.nominal.copy(), memory.covariance.copy()
    parameters = for_sensor(FootInsParameters(gravity_mps2=GRAVITY), None)
    noises = {name: 0.0 for name in parameters.dtype.names if "_noise" in name or "_walk" in name}
    parameters = with_values(parameters, **noises)
    from_python(strapdown.predict)(memory, parameters, RATE, FORCE, dt)
    F = np.eye(len(P))
    own = slice(ROW, ROW + state.STATES)
    F[own, own] = slopes(lambda e: difference(propagated(moved(x, e), dt), propagated(x, dt)), state.STATES)
    np.testing.assert_allclose(memory.covariance, F @ P @ F.T, atol=2e-7)
    np.testing.assert_array_equal(memory.covariance, memory.covariance.T)


@pytest.mark.parametrize(
    "name",
    [
        "gyro_noise_radps_rthz",
        "accel_noise_mps2_rthz",
        "gyro_bias_walk_radps2_rthz",
        "accel_bias_walk_mps3_rthz",
        "accel_motion_noise_per_rthz",
    ],
)
def test_each_noise_density_adds_its_square_times_the_duration(name):
    row = {
        "gyro_noise": state.D_ATTITUDE,
        "accel_noise": state.D_VELOCITY,
        "gyro_bias": state.D_GYRO_BIAS,
        "accel_bias": state.D_ACCEL_BIAS,
        "accel_motion": state.D_VELOCITY,
    }["_".join(name.split("_")[:2])]
    variances = []
    for density in (0.0, 0.02):
        memory = foot()
        memory.clock[state.HEAD], memory.clock[state.FILL] = 0, 1
        parameters = with_values(for_sensor(FootInsParameters(gravity_mps2=GRAVITY), None), **{name: density})
        from_python(strapdown.predict)(memory, parameters, RATE, FORCE, DT)
        variances.append(np.diag(memory.covariance)[ROW : ROW + state.STATES])
    expected, x = np.zeros(state.STATES), foot().nominal
    expected[row : row + 3] = 0.02**2 * DT
    if name.startswith("accel_motion"):
        after = propagated(x)
        expected *= np.sum(((after - x)[state.VELOCITY : state.VELOCITY + 3] / DT) ** 2)
    np.testing.assert_allclose(variances[1] - variances[0], expected, rtol=1e-6, atol=1e-15)


def test_a_gap_adds_noise():
    covariances = []
    for dt in (0.03, 0.03 + 1e-9):
        memory = foot()
        from_python(strapdown.predict)(memory, for_sensor(FootInsParameters(), None), RATE, FORCE, dt)
        covariances.append(memory.covariance[ROW : ROW + state.STATES, ROW : ROW + state.STATES])
    expected = np.zeros(state.STATES)
    expected[state.D_ATTITUDE : state.D_ATTITUDE + 3], expected[state.D_VELOCITY : state.D_VELOCITY + 3] = (
        0.3**2 * 0.03,
        3.0**2 * 0.03,
    )
    np.testing.assert_allclose(covariances[1] - covariances[0], np.diag(expected), atol=1e-8)


def test_an_axis_at_its_limit_adds_noise():
    names = ("gyro_limit_noise_radps_rthz", "accel_limit_noise_mps2_rthz")
    limits = {"gyro_range_radps": 1.3, "accel_range_mps2": 11.0}

    def covariance(**noise):
        memory = foot()
        values = dict.fromkeys(names, 0.0) | limits | noise
        parameters = with_values(for_sensor(FootInsParameters(gravity_mps2=GRAVITY), None), **values)
        from_python(strapdown.predict)(memory, parameters, RATE, FORCE, DT)
        return memory.covariance[ROW : ROW + state.STATES, ROW : ROW + state.STATES]

    x, none = foot().nominal, covariance()
    w = np.subtract(RATE, x[state.GYRO_BIAS : state.GYRO_BIAS + 3])
    start = Rotation.from_quat(x[state.ATTITUDE : state.ATTITUDE + 4], scalar_first=True)
    R = (start * Rotation.from_rotvec(0.5 * DT * w)).as_matrix()  # but for the scale, in the middle of the interval
    for name, row, axis in zip(names, (state.D_ATTITUDE, state.D_VELOCITY), (1, 2)):
        added = covariance(**{name: 0.3}) - none
        expected = np.zeros((state.STATES, state.STATES))
        expected[row : row + 3, row : row + 3] = 0.3**2 * DT * np.outer(R[:, axis], R[:, axis])
        np.testing.assert_allclose(added, expected, atol=2e-7, err_msg=name)


def corrected(P, H, z, noise):
    """Error and covariance after a measurement, by the textbook."""
    S = H @ P @ H.T + noise
    K = P @ H.T @ np.linalg.inv(S)
    return K @ z, P - K @ S @ K.T


def seen_from(P, row, error):
    """A covariance of the error in the corrected state: position and velocity errors turn with the world."""
    T = np.eye(len(P))
    for d in (state.D_POSITION, state.D_VELOCITY):
        by = error[row + d : row + d + 3]
        T[row + d : row + d + 3, row + state.D_ATTITUDE : row + state.D_ATTITUDE + 3] = -np.cross(by, np.eye(3)).T
    return T @ P @ T.T


def check_after(memory, x, error, P):
    """The foot's own error has moved into its state, that of the rest waits."""
    own = slice(ROW, ROW + state.STATES)
    np.testing.assert_allclose(memory.nominal, moved(x, error[own]), atol=1e-9)
    waiting = error.copy()
    waiting[own] = 0.0
    np.testing.assert_allclose(memory.error, waiting, atol=1e-9)
    np.testing.assert_allclose(memory.covariance, seen_from(P, ROW, error), atol=1e-9)
    np.testing.assert_array_equal(memory.covariance, memory.covariance.T)


@pytest.mark.parametrize("dt", [0.01, 0.1])
def test_zero_velocity_is_a_measurement_of_the_stationary_point(dt):
    memory = foot()
    memory.clock[state.CONTACT_PHASE] = state.STANDING
    memory.creep[creep.FORWARD : creep.SINKING + 1] = 1.2, -0.4, 0.9  # of the stride that led here
    x, P = memory.nominal.copy(), memory.covariance.copy()
    parameters = for_sensor(
        FootInsParameters(innovation_gate=1e6, stationary_correlation_s=0.04, lever_sd_m=0.04), None
    )
    R = Rotation.from_quat(x[state.ATTITUDE : state.ATTITUDE + 4], scalar_first=True).as_matrix()

    def speed(error):
        """Of the point in sensor axes, drawn as a vector of the world at the nominal attitude."""
        y = moved(x, error)
        axes = Rotation.from_quat(y[state.ATTITUDE : state.ATTITUDE + 4], scalar_first=True)
        w = np.subtract(RATE, y[state.GYRO_BIAS : state.GYRO_BIAS + 3])
        return R @ (
            axes.inv().apply(y[state.VELOCITY : state.VELOCITY + 3])
            + np.cross(w, memory.lever + y[state.CONTACT : state.CONTACT + 3])
        )

    H = np.zeros((3, len(P)))
    H[:, ROW : ROW + state.STATES] = slopes(speed, state.STATES)
    w = R @ np.subtract(RATE, x[state.GYRO_BIAS : state.GYRO_BIAS + 3])
    noise = 0.05**2 * np.eye(3) + 0.04**2 * ((w @ w) * np.eye(3) - np.outer(w, w))
    level = parameters.creep_level  # at which a shoe creeps by half as much
    creeping = 0.5 * np.array([1.2, -0.4, 0.9]) * [*[parameters.creep_forward_share] * 2, -parameters.creep_down_m]
    z = creeping - speed(np.zeros(state.STATES))
    error, covariance = corrected(P, H, z, max(1.0, 0.04 / dt) * noise)
    from_python(stance.zero_velocity_update)(memory, parameters, 100_000_000, RATE, dt, level, 0.05)
    check_after(memory, x, error, covariance)
    # what is reported is the innovation against the noise of the speed itself
    S = H @ P @ H.T + noise
    assert memory.nis[state.BY_VELOCITY, 1] == 1.0
    assert memory.nis[state.BY_VELOCITY, 0] == pytest.approx(z @ np.linalg.solve(S, z) / 3.0, rel=1e-6)


def test_a_foot_at_rest_measures_the_bias_of_its_gyro():
    memory = foot()
    x, P = memory.nominal.copy(), memory.covariance.copy()
    parameters = for_sensor(FootInsParameters(innovation_gate=1e6), None)
    H = np.zeros((3, len(P)))
    H[:, ROW + state.D_GYRO_BIAS : ROW + state.D_GYRO_BIAS + 3] = np.eye(3)
    z = np.array([0.05, -0.04, 0.06]) - x[state.GYRO_BIAS : state.GYRO_BIAS + 3]
    noise = 0.03**2 * np.eye(3)
    error, covariance = corrected(P, H, z, noise)
    from_python(rest._bias_update)(memory, parameters, (0.05, -0.04, 0.06), 0.03)
    check_after(memory, x, error, covariance)
    S = H @ P @ H.T + noise
    np.testing.assert_allclose(memory.nis[state.BY_RATE], [z @ np.linalg.solve(S, z) / 3.0, 1.0], rtol=1e-9)
    assert from_python(stance.unknown_bias_statistic)(foot()) == pytest.approx(
        4.0
        * np.trace(
            P[
                ROW + state.D_GYRO_BIAS : ROW + state.D_GYRO_BIAS + 3,
                ROW + state.D_GYRO_BIAS : ROW + state.D_GYRO_BIAS + 3,
            ]
        )
        / stance.GYRO_SCALE_RADPS**2
    )


def test_the_noise_of_a_rotating_arm_is_whitened():
    w = np.array([1.0, -2.0, 0.5])
    W = np.array(from_python(stance._whitening)(tuple(w), 0.05, 0.04))
    noise = 0.05**2 * np.eye(3) + 0.04**2 * ((w @ w) * np.eye(3) - np.outer(w, w))
    np.testing.assert_allclose(W, np.linalg.inv(np.real(sqrtm(noise))), rtol=1e-9)


def test_the_wandering_of_contact_and_drift_keeps_their_variances():
    """A Gauss-Markov process in its steady state stays in it; away from it, it returns with its time constant."""
    parameters = for_sensor(FootInsParameters(contact_sd_m=0.05, height_drift_sd=0.02), None)
    memory = foot()
    lever = memory.lever / np.linalg.norm(memory.lever)
    across = np.eye(3) - np.outer(lever, lever)
    x, P = memory.nominal.copy(), memory.covariance.copy()
    from_python(stance.move_contact_point)(memory, parameters, 0.5)
    from_python(stance.vary_height_drift)(memory, parameters, 0.5)
    keep = np.eye(len(P))
    contact, drift = ROW + state.D_CONTACT + np.arange(3), ROW + state.D_DRIFT
    keep[contact, contact], keep[drift, drift] = np.exp(-0.05), np.exp(-0.1)
    expected = keep @ P @ keep
    expected[np.ix_(contact, contact)] += (1.0 - np.exp(-0.1)) * 0.05**2 * across
    expected[drift, drift] += (1.0 - np.exp(-0.2)) * 0.02**2
    np.testing.assert_allclose(memory.covariance, expected, rtol=1e-9, atol=1e-15)
    x[state.CONTACT : state.CONTACT + 3] *= np.exp(-0.05)
    x[state.DRIFT] *= np.exp(-0.1)
    np.testing.assert_allclose(memory.nominal, x, rtol=1e-12)


def test_the_motion_statistic_is_the_energy_of_its_window():
    parameters = for_sensor(FootInsParameters(window_s=0.0243), None)
    memory, rng = foot(), np.random.default_rng(2)
    memory.norm[0] = 9.79
    samples = rng.normal(size=(6, 6)) * [0.02] * 6 + [0.01, -0.02, 0.03, 0.5, -0.3, 9.7]
    for k, row in enumerate(samples):
        from_python(stance.append_sample)(memory, k * 8_000_000, tuple(row[:3]), tuple(row[3:]))
    assert (memory.clock[state.HEAD], memory.clock[state.FILL]) == (6, 6)
    w, f = samples[-4:, :3] - memory.nominal[state.GYRO_BIAS : state.GYRO_BIAS + 3], samples[-4:, 3:]  # 0 to 24 ms old
    mean = f.mean(axis=0)
    spread = np.mean(np.sum((f - 9.79 * mean / np.linalg.norm(mean)) ** 2, axis=1))
    rates = np.mean(np.sum(w**2, axis=1))
    expected = spread / stance.ACCEL_SCALE_MPS2**2 + rates / stance.GYRO_SCALE_RADPS**2
    assert from_python(stance.motion_statistic)(memory, parameters) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("excess", [-0.2, -0.03, 0.03, 0.2])
def test_before_the_alignment_any_size_near_gravity_is_rest(excess):
    parameters = for_sensor(FootInsParameters(gravity_mps2=10.0), None)
    memory = foot()
    memory.nominal[state.GYRO_BIAS : state.GYRO_BIAS + 3] = 0.0
    for k in range(3):
        from_python(stance.append_sample)(memory, k * 8_000_000, (0.0, 0.0, 0.0), (0.0, 0.0, 10.0 * (1.0 + excess)))
    beyond = max(abs(10.0 * excess) - 0.5, 0.0)
    found = from_python(stance.motion_statistic)(memory, parameters)
    assert found == pytest.approx(beyond**2 / stance.ACCEL_SCALE_MPS2**2, abs=1e-6)


def test_a_foots_speed_is_less_certain_the_more_it_moves():
    parameters = for_sensor(
        FootInsParameters(
            stationary_level=100.0, stationary_share=0.01, stationary_power=2.0, stationary_speed_mps=0.01
        ),
        None,
    )
    for statistic, peak, level in ((0.0, 0.0, 100.0), (50.0, 9e3, 100.0), (300.0, 5e4, 500.0), (1e4, 0.0, 100.0)):
        expected = 0.01 * np.sqrt(1.0 + (statistic / level) ** 2)
        found = from_python(stance.stationary_speed_sd)(statistic, peak, parameters)
        assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("same", [0.3, 1.0])
def test_a_level_step_teaches_how_much_floors_differ(same):
    """Of the squared step, the expected part of the floor: its posterior mean squared plus its posterior variance."""
    memory, parameters = foot(), for_sensor(FootInsParameters(floor_sd_m=0.01), None)
    memory.floor[1:] = 2.0, 3e-4
    variance = (5.0 * 0.01**2 + 3e-4) / 7.0
    assert from_python(stance._floor_variance)(memory, parameters) == pytest.approx(variance)
    step, spread = 0.02, 2e-4
    from_python(stance._learn_level_step)(memory, same, step, variance, spread)
    mean, left = step * variance / (variance + spread), 1.0 / (1.0 / variance + 1.0 / spread)
    np.testing.assert_allclose(memory.floor, [same, 2.0 + same, 3e-4 + same * (mean**2 + left)], rtol=1e-12)
    np.testing.assert_allclose(memory.nis[1], [same * step**2 / (variance + spread), same], rtol=1e-12)


@pytest.mark.parametrize("step", [0.02, -0.015, 0.2])
def test_a_foot_that_lands_is_on_its_floor_with_a_probability_or_on_a_new_one(step):
    """Bayes' rule for a step within 3.5 cm; a higher one begins a floor at the foot's height, as uncertain as it.

    The foot is on a floor from 29.8 ms on.
    """
    parameters = for_sensor(FootInsParameters(lever_arm_m=0.09), None)
    memory = foot()
    P = memory.covariance
    P *= 1e-3
    x = memory.nominal
    R = Rotation.from_quat(x[state.ATTITUDE : state.ATTITUDE + 4], scalar_first=True)
    r = R.apply(memory.lever)
    x[state.FLOOR] = x[state.POSITION + 2] + r[2] - step
    memory.clock[state.CONTACT_PHASE], memory.clock[state.T_LAST_MOTION] = 1, 0  # has swung; not surely stationary at 0
    before, x0 = P.copy(), x.copy()

    def height(error):
        y = moved(x0, error)
        arm = Rotation.from_quat(y[state.ATTITUDE : state.ATTITUDE + 4], scalar_first=True).apply(memory.lever)
        return np.array([y[state.POSITION + 2] + arm[2] - y[state.FLOOR]])

    H = np.zeros((1, len(P)))
    H[:, ROW : ROW + state.STATES] = slopes(height, state.STATES)
    variance = 0.01**2 + (0.1 * np.hypot(r[0], r[1]) / 0.09) ** 2
    spread = float((H @ before @ H.T)[0, 0])
    from_python(stance.level_floor_update)(memory, parameters, 29_000_000, 0.01)
    np.testing.assert_array_equal(x, x0)  # it has not stood for long enough
    from_python(stance.level_floor_update)(memory, parameters, 30_000_000, 0.01)
    if abs(step) < 0.035:
        s = spread + variance
        density = np.exp(-0.5 * step**2 / s) / np.sqrt(2.0 * np.pi * s)
        same = 0.9 * density / (0.9 * density + 0.1 / 0.5)
        assert memory.floor[0] == pytest.approx(same, rel=1e-6)
        assert same > 0.5
        gain = (before @ H.T / s)[:, 0]
        np.testing.assert_allclose(x, moved(x0, -same * step * gain[ROW : ROW + state.STATES]), atol=1e-8)
    else:
        expected = x0.copy()
        expected[state.FLOOR] = x0[state.POSITION + 2] + r[2]
        np.testing.assert_allclose(x, expected, atol=1e-12)
        own = H.copy()
        own[0, ROW + state.D_FLOOR] = 0.0
        row = (before @ own.T)[:, 0]
        row[ROW + state.D_FLOOR] = float((own @ before @ own.T)[0, 0]) + variance
        np.testing.assert_allclose(P[ROW + state.D_FLOOR], row, atol=1e-12)
        np.testing.assert_allclose(P[:, ROW + state.D_FLOOR], row, atol=1e-12)
        assert memory.floor[0] == 1.0
    after = x.copy()
    from_python(stance.level_floor_update)(memory, parameters, 60_000_000, 0.01)
    np.testing.assert_array_equal(x, after)  # once per landing
