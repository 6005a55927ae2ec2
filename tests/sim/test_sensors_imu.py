from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks import allan
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.noise import FLOOR, Noise, Wander
from stridetwin.sim.parts.kinds import Accelerometer, Gyroscope, ImuPart
from stridetwin.sim.parts.library import make_ideal
from stridetwin.sim.sensors import imu as imu_model
from stridetwin.sim.sensors.model import step_ends
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.rig import ImuCalibration, Mount

STILL = Noise(None)
PART = ImuPart(
    name="test",
    description="",
    rate_hz=120.0,
    gyroscope=Gyroscope(noise_density=1e-3, bias_instability=0, turn_on_bias=0.01, range=np.inf, bandwidth_hz=np.inf),
    accelerometer=Accelerometer(
        noise_density=2e-3, bias_instability=0, turn_on_bias=0.05, range=np.inf, bandwidth_hz=np.inf
    ),
)


class ImuModel(imu_model.ImuModel):
    """Reads a track with a row a sample."""

    def __init__(self, calibration, noise, part=PART):
        super().__init__(calibration, replace(part, rate_hz=calibration.rate_hz), noise)

    def read(self, body):
        return super().read(body, body.t_ns)


def imu(T_body_sensor=None, rate_hz=120.0):
    return ImuCalibration(
        topic="/foot_l/imu",
        part="",
        rate_hz=rate_hz,
        mount=Mount(body="foot_l", T_body_sensor=np.eye(4) if T_body_sensor is None else T_body_sensor),
        gyroscope_noise_density=1e-3,
        gyroscope_random_walk=0.0,
        accelerometer_noise_density=2e-3,
        accelerometer_random_walk=0.0,
        gyroscope_bias_sd=0.01,
        accelerometer_bias_sd=0.05,
    )


def attitude(t):
    return Rotation.from_euler(
        "ZYX",
        np.column_stack([0.4 * np.sin(0.9 * t), 1.1 * np.sin(4 * np.pi * t), 0.25 * np.sin(6 * np.pi * t + 0.3)]),
    )


def foot_like(t):
    """A foot's motion with peaks of 4.5 m/s and 800 deg/s; analytic but for the rate (central difference)."""
    w = 2 * np.pi
    p = np.column_stack([1.5 * t + 3 / w * np.sin(w * t), 0.05 * np.sin(w * t), 0.1 * (1 - np.cos(2 * w * t))])
    v = np.column_stack([1.5 + 3 * np.cos(w * t), 0.05 * w * np.cos(w * t), 0.2 * w * np.sin(2 * w * t)])
    h = 1e-5
    rate = (attitude(t - h).inv() * attitude(t + h)).as_rotvec() / (2 * h)
    return Track(
        t_ns=np.round(t * 1e9).astype(np.int64),
        p_body_in_world=p,
        q_world_body=attitude(t).as_quat(scalar_first=True),
        v_body_in_world=v,
        w_body=rate,
    )


def instants(rate_hz, seconds):
    return np.round(np.arange(int(seconds * rate_hz) + 1) / rate_hz, 9)


def strapdown(block, start):
    """Velocity in closed form for constant rate and force over an interval, position by its trapezoids."""
    R, p, v = start.rotation[0], start.p_body_in_world[0], start.v_body_in_world[0]
    t = block.t_ns * 1e-9
    path = [p]
    for k in range(1, len(block)):
        dt = t[k] - t[k - 1]
        phi, f = block.columns["angular_rate"][k] * dt, block.columns["specific_force"][k]
        hat = np.cross(np.eye(3), phi)
        gamma1, power = np.eye(3), np.eye(3)
        for n in range(1, 14):  # integral of Exp(s phi) over s in 0-1, as a series
            power = power @ hat / n
            gamma1 = gamma1 + power / (n + 1)
        before = v
        v = v + np.array([0.0, 0.0, -NOMINAL_GRAVITY_MPS2]) * dt + R.apply(gamma1 @ f) * dt
        p = p + (before + v) / 2 * dt
        R = R * Rotation.from_rotvec(phi)
        path.append(p)
    return np.array(path), v, R


@pytest.mark.parametrize("rate_hz", [120.0, 200.0])
def test_an_ideal_imu_integrates_back_to_the_true_path(rate_hz):
    track = foot_like(instants(rate_hz, 20.0))
    assert np.linalg.norm(track.v_body_in_world, axis=1).max() > 4.4
    assert np.degrees(np.linalg.norm(track.w_body, axis=1)).max() > 780
    lever = np.eye(4)
    lever[:3, :3] = Rotation.from_euler("XYZ", [0.3, -0.2, 0.5]).as_matrix()
    lever[:3, 3] = [-0.03, 0.04, 0.06]
    block = ImuModel(imu(lever, rate_hz), STILL, make_ideal(PART)).read(track)
    sensor = track.to_sensor(lever)
    path, v, R = strapdown(block, sensor)
    error = np.linalg.norm(path - sensor.p_body_in_world, axis=1)
    assert error[-1] < 1e-4
    assert error.max() < 1e-3
    np.testing.assert_allclose(v, sensor.v_body_in_world[-1], atol=1e-9)
    assert (R.inv() * sensor.rotation[-1]).magnitude() < 1e-9


def test_chunks_make_no_difference():
    track = foot_like(instants(120.0, 2.0))
    whole = ImuModel(imu(), Noise.of_topic(3, "/foot_l/imu")).read(track)
    model = ImuModel(imu(), Noise.of_topic(3, "/foot_l/imu"))
    parts = [model.read(track[a:b]) for a, b in ((0, 1), (1, 100), (100, 241))]
    for name, column in whole.columns.items():
        np.testing.assert_allclose(np.concatenate([p.columns[name] for p in parts]), column, atol=1e-9)


def test_at_rest_it_feels_gravity_upwards():
    t = instants(120.0, 1.0)
    still = Track(
        t_ns=np.round(t * 1e9).astype(np.int64),
        p_body_in_world=np.zeros((len(t), 3)),
        q_world_body=np.tile([1.0, 0, 0, 0], (len(t), 1)),
        v_body_in_world=np.zeros((len(t), 3)),
        w_body=np.zeros((len(t), 3)),
    )
    block = ImuModel(imu(), STILL, make_ideal(PART)).read(still)
    np.testing.assert_allclose(block.columns["specific_force"], np.tile([0, 0, 9.81], (len(t), 1)), atol=1e-12)
    np.testing.assert_allclose(block.columns["angular_rate"], 0.0, atol=1e-12)
    assert next(iter(block)).specific_force.shape == (3,)


def test_noise_has_the_density_and_the_bias_of_the_part():
    t = instants(120.0, 300.0)
    n = len(t)
    still = Track(
        t_ns=np.round(t * 1e9).astype(np.int64),
        p_body_in_world=np.zeros((n, 3)),
        q_world_body=np.tile([1.0, 0, 0, 0], (n, 1)),
        v_body_in_world=np.zeros((n, 3)),
        w_body=np.zeros((n, 3)),
    )
    blocks = [ImuModel(imu(), Noise.of_topic(seed, "/foot_l/imu")).read(still) for seed in range(30)]
    rate = np.array([b.columns["angular_rate"] for b in blocks])
    np.testing.assert_allclose(rate.std(axis=1).mean(), 1e-3 * np.sqrt(120), rtol=0.02)
    np.testing.assert_allclose(rate.mean(axis=1).std(), 0.01, rtol=0.25)
    force = np.array([b.columns["specific_force"] for b in blocks])
    np.testing.assert_allclose(force.std(axis=1).mean(), 2e-3 * np.sqrt(120), rtol=0.02)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_a_mounted_track_is_a_rigid_body(seed):
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    T[:3, 3] = rng.normal(0, 0.2, 3)
    h = 1e-4
    t = rng.uniform(0, 5) + np.array([-h, 0.0, h])
    sensor = foot_like(t).to_sensor(T)
    speed = (sensor.p_body_in_world[2] - sensor.p_body_in_world[0]) / (2 * h)
    np.testing.assert_allclose(sensor.v_body_in_world[1], speed, atol=1e-4)
    turn = (sensor.rotation[0].inv() * sensor.rotation[2]).as_rotvec() / (2 * h)
    np.testing.assert_allclose(sensor.w_body[1], turn, atol=1e-3)
    np.testing.assert_allclose(sensor.poses(), foot_like(t).poses() @ T, atol=1e-12)


def test_one_topic_never_changes_another():
    a = Noise.of_topic(7, "/foot_l/imu").normal(1.0, 5)
    Noise.of_topic(7, "/foot_r/imu").normal(1.0, 99)
    np.testing.assert_array_equal(a, Noise.of_topic(7, "/foot_l/imu").normal(1.0, 5))
    assert not np.allclose(a, Noise.of_topic(7, "/foot_r/imu").normal(1.0, 5))
    assert not np.allclose(a, Noise.of_topic(8, "/foot_l/imu").normal(1.0, 5))
    assert np.all(Noise(None).normal(1.0, 5) == 0)


def at_steps(track, rate_hz, steps):
    """Rows of a dense track that are the ends of the steps of its samples, and the samples' times."""
    t_ns = np.round(np.arange(int(track.t_ns[-1] * 1e-9 * rate_hz) + 1) * 1e9 / rate_hz).astype(np.int64)
    return step_ends(rate_hz, steps, t_ns), t_ns


def limited(**gyroscope):
    return replace(make_ideal(PART), gyroscope=replace(make_ideal(PART).gyroscope, **gyroscope))


def test_steps_join_without_coning_or_sculling_error():
    """Through 1080 Hz steps an unlimited sensor's samples are those of whole intervals."""
    model = imu_model.ImuModel(imu(), limited(bandwidth_hz=1e6), STILL)
    assert model.steps == 9
    ends, t_ns = at_steps(foot_like(instants(120.0, 3.0)), 120.0, model.steps)
    track = foot_like(ends * 1e-9)
    stepped = model.read(track, t_ns)
    whole = ImuModel(imu(), STILL, make_ideal(PART)).read(foot_like(t_ns * 1e-9))
    for name in ("angular_rate", "specific_force"):
        np.testing.assert_allclose(stepped.columns[name][1:], whole.columns[name][1:], atol=2e-5)


def test_a_gyroscope_saturates_at_its_range():
    limit = np.radians(450)
    model = imu_model.ImuModel(imu(), limited(range=limit), STILL)
    ends, t_ns = at_steps(foot_like(instants(120.0, 3.0)), 120.0, model.steps)
    measured = model.read(foot_like(ends * 1e-9), t_ns).columns["angular_rate"]
    true = ImuModel(imu(), STILL, make_ideal(PART)).read(foot_like(t_ns * 1e-9)).columns["angular_rate"]
    assert np.abs(true).max() > 1.5 * limit
    assert np.abs(measured).max() <= limit * 1.001
    beyond = np.abs(true[:, 1]) > 1.2 * limit
    np.testing.assert_allclose(np.abs(measured[beyond, 1]), limit, rtol=0.02)
    below = np.all(np.abs(true) < 0.8 * limit, axis=1)
    np.testing.assert_allclose(measured[below], true[below], atol=0.05)


# from `INNER_HZ` on, a sample has one inner step
@pytest.mark.parametrize(("cut_hz", "rate_hz"), [(30.0, 250.0), (30.0, 1000.0), (120.0, 2000.0)])
def test_the_bandwidth_is_where_a_part_feels_0_7_of_a_vibration_and_its_delay_is_allowed_for(cut_hz, rate_hz):
    model = imu_model.ImuModel(imu(rate_hz=rate_hz), replace(limited(bandwidth_hz=cut_hz), rate_hz=rate_hz), STILL)
    t_ns = np.round(np.arange(int(2 * rate_hz)) * 1e9 / rate_hz).astype(np.int64)
    t = (step_ends(rate_hz, model.steps, t_ns) + round(model.delay_s * 1e9)) * 1e-9
    zero = np.zeros((len(t), 3))

    def gain_and_delay(hz):
        w = 2 * np.pi * hz
        track = Track(
            t_ns=np.round(t * 1e9).astype(np.int64),
            p_body_in_world=zero,
            v_body_in_world=zero,
            q_world_body=Rotation.from_euler("x", -0.1 / w * np.cos(w * t)[:, None]).as_quat(scalar_first=True),
            w_body=np.column_stack([0.1 * np.sin(w * t), zero[:, :2]]),
        )
        fresh = imu_model.ImuModel(imu(rate_hz=rate_hz), replace(limited(bandwidth_hz=cut_hz), rate_hz=rate_hz), STILL)
        settled = t_ns >= 1e9
        measured = fresh.read(track, t_ns).columns["angular_rate"][settled, 0]
        middle = t_ns[settled] * 1e-9 - 0.5 / rate_hz  # of the interval that a sample is the mean of
        response = 2 * np.mean(measured * np.exp(-1j * w * middle)) / 0.1 * 1j
        return abs(response), -np.angle(response) / w

    gain, _ = gain_and_delay(cut_hz)
    assert gain == pytest.approx(np.sqrt(0.5), rel=0.05)
    gain, delay = gain_and_delay(5.0)
    assert gain == pytest.approx(1.0, rel=0.01)
    # a two-sided delay: gyroscope and accelerometer share the mean of theirs, the accelerometer's here is none
    assert delay == pytest.approx(model.delay_s, rel=0.03)


def delayed(part, gyroscope_s=0.0, accelerometer_s=0.0):
    return replace(
        part,
        gyroscope=replace(part.gyroscope, delay_s=gyroscope_s),
        accelerometer=replace(part.accelerometer, delay_s=accelerometer_s),
    )


def read_walk(part, seconds=4.0, chunks=1, noise=STILL):
    """Columns of the samples of a part of 120 Hz on the foot-like motion, read in so many chunks."""
    model = imu_model.ImuModel(imu(), replace(part, rate_hz=120.0), noise)
    t_ns = np.round(np.arange(int(seconds * 120) + 1) * 1e9 / 120).astype(np.int64)
    columns = []
    for samples in np.array_split(t_ns, chunks):
        ends = step_ends(120.0, model.steps, samples) + round(model.delay_s * 1e9)
        columns.append(model.read(foot_like(ends * 1e-9), samples).columns)
    return {name: np.concatenate([c[name] for c in columns]) for name in columns[0]}


def lag_s(early, late, rate_hz=120.0):
    """Time by which a channel (N,) is later than another, by the phase of their cross-spectrum below 10 Hz."""
    spectra = [np.fft.rfft((x - x.mean()) * np.hanning(len(x))) for x in (early, late)]
    cross, hz = spectra[0] * np.conj(spectra[1]), np.fft.rfftfreq(len(early), 1 / rate_hz)
    low = (hz > 0) & (hz < 10)
    # least squares of a straight phase, by power
    w = 2 * np.pi * hz[low]
    return float(np.sum(abs(cross[low]) * w * np.angle(cross[low])) / np.sum(abs(cross[low]) * w**2))


SLOW = replace(
    PART,
    gyroscope=replace(PART.gyroscope, bandwidth_hz=60.0),
    accelerometer=replace(PART.accelerometer, bandwidth_hz=60.0),
)


@settings(max_examples=12, deadline=None)
@given(gyroscope_s=st.floats(0, 0.05), accelerometer_s=st.floats(0, 0.05))
def test_a_channel_is_late_by_its_own_delay(gyroscope_s, accelerometer_s):
    prompt, late = read_walk(SLOW, 8.0), read_walk(delayed(SLOW, gyroscope_s, accelerometer_s), 8.0)
    for name, delay_s in (("angular_rate", gyroscope_s), ("specific_force", accelerometer_s)):
        for axis in (0, 1):
            assert lag_s(prompt[name][:, axis], late[name][:, axis]) == pytest.approx(delay_s, abs=2e-4)


@pytest.mark.parametrize("samples", [(1, 0), (0, 2), (3, 5)])
def test_a_delay_of_whole_samples_moves_them(samples):
    prompt, late = read_walk(SLOW), read_walk(delayed(SLOW, samples[0] / 120, samples[1] / 120))
    for name, count in zip(("angular_rate", "specific_force"), samples):
        end = len(prompt[name]) - count
        # the first sample's steps are steady motion, which the filter meets earlier
        np.testing.assert_allclose(late[name][count:][10:], prompt[name][:end][10:], atol=1e-6)


def test_chunks_make_no_difference_to_a_delay():
    part = delayed(SLOW, 0.0031, 0.0125)
    whole, cut = read_walk(part), read_walk(part, chunks=7)
    for name, column in whole.items():
        np.testing.assert_allclose(cut[name], column, atol=1e-9)


def test_a_delayed_part_feels_gravity_alone_at_rest():
    part = delayed(limited(), 0.004, 0.0123)
    model = imu_model.ImuModel(imu(), part, STILL)
    ends, t_ns = at_steps(foot_like(instants(120.0, 1.0)), 120.0, model.steps)
    still = replace(
        foot_like(np.zeros(len(ends))),
        t_ns=ends,
        v_body_in_world=np.zeros((len(ends), 3)),
        w_body=np.zeros((len(ends), 3)),
    )
    columns = model.read(still, t_ns).columns
    np.testing.assert_allclose(np.linalg.norm(columns["specific_force"], axis=1), NOMINAL_GRAVITY_MPS2, atol=1e-9)
    np.testing.assert_allclose(columns["angular_rate"], 0.0, atol=1e-9)


def test_a_part_without_delay_keeps_its_bytes():
    noise = "/foot_l/imu"
    plain, zero = (read_walk(p, noise=Noise.of_topic(5, noise)) for p in (SLOW, delayed(SLOW, 0.0, 0.0)))
    for name, column in plain.items():
        np.testing.assert_array_equal(zero[name], column)


def test_errors_that_grow_with_the_motion_are_those_of_the_part():
    part = limited(scale_factor=0.01, misalignment=0.002, g_sensitivity=1e-3)
    t = instants(120.0, 2.0)
    true = ImuModel(imu(), STILL, make_ideal(PART)).read(foot_like(t)).columns
    spread = []
    for seed in range(60):
        measured = ImuModel(imu(), Noise.of_topic(seed, "/foot_l/imu"), part).read(foot_like(t)).columns["angular_rate"]
        error = measured - true["angular_rate"]
        both = np.hstack([true["angular_rate"], true["specific_force"]])
        spread.append(np.linalg.lstsq(both, error, rcond=None)[0])
    sd = np.array(spread).std(axis=0)

    def pooled(values):
        return np.sqrt(np.mean(values**2))

    assert pooled(np.diag(sd[:3])) == pytest.approx(0.01, rel=0.2)
    assert pooled(sd[:3][~np.eye(3, dtype=bool)]) == pytest.approx(0.002, rel=0.15)
    assert pooled(sd[3:]) == pytest.approx(1e-3, rel=0.15)


def test_readings_are_whole_counts():
    part = replace(PART, gyroscope=replace(PART.gyroscope, resolution=np.radians(0.061)))
    measured = (
        ImuModel(imu(), Noise.of_topic(1, "x"), part).read(foot_like(instants(120.0, 1.0))).columns["angular_rate"]
    )
    counts = measured / np.radians(0.061)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)


def test_biases_wander_with_the_allan_deviation_of_the_part():
    """White noise apart: flat at the instability, then rising as the random walk; 20 seeds, 2 h."""
    rate_hz, floor, walk = 4.0, np.array([1.0, 0.5]), np.array([0.01, 0.02])
    counts = np.unique(np.geomspace(8, 2400, 12).astype(np.int64))
    tau = counts / rate_hz
    seen = []
    for seed in range(20):
        drawn = Wander(floor, walk, rate_hz, Noise.of_topic(seed, "x")).draw(int(7200 * rate_hz))
        seen.append(allan.allan_variance(drawn, counts))
    expected = floor**2 + walk**2 * tau[:, None] / 3
    mean, error = np.mean(seen, axis=0), np.std(seen, axis=0, ddof=1) / np.sqrt(20)
    # 95 % of the means lie within two of their own errors; the flicker is flat to 4 % from 2 s on
    inside = np.abs(mean - expected) < 2.1 * error + 0.04 * floor**2
    assert inside.mean() >= 0.9


def test_drawing_a_wander_in_pieces_changes_nothing():
    whole = Wander(np.ones(3), np.ones(3), 10.0, Noise.of_topic(1, "x")).draw(100)
    pieces = Wander(np.ones(3), np.ones(3), 10.0, Noise.of_topic(1, "x"))
    np.testing.assert_allclose(np.vstack([pieces.draw(30), pieces.draw(70)]), whole, atol=1e-9)


@pytest.mark.parametrize("name", allan.parts())
def test_every_imu_of_the_library_is_as_noisy_as_its_figures(name):
    part, counts = allan.parts()[name], np.array([1, 2, 5])
    means = allan.means(allan.at_rest(part, 600.0, seed=1), part.rate_hz)
    seen, tau = allan.allan_variance(means, counts), counts * allan.SHORTEST_S
    for i, triad in enumerate(allan.TRIADS):
        white, instability, walk = allan.truth(part, triad)
        expected = white / tau + instability * FLOOR**2 + walk * tau / 3
        np.testing.assert_allclose(np.sqrt(seen[:, 3 * i : 3 * i + 3].mean(axis=1) / expected), 1.0, atol=0.05)
