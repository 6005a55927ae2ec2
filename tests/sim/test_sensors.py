from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.sim.config import Level, Route, Stairs, TwinConfig
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.figure import G
from stridetwin.sim.parts.library import make_ideal
from stridetwin.sim.parts.sensor_config import Clock
from stridetwin.sim.sensors.exo_sensors import ActuatorModel, AhrsModel, EncoderModel
from stridetwin.sim.sensors.force_cells import ForceCells, InsoleModel, InteractionModel, cell_shares
from stridetwin.sim.sensors.model import Stamps
from stridetwin.sim.sensors.sonar import SonarModel
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.sim.world.bystanders import Crowd
from stridetwin.sim.world.terrain import Terrain

ROUTE = Route(segments=(Level(length_m=3.0), Stairs(risers=3)))
SENSOR_RIG = sensor_rig(TwinConfig(name="test", route=ROUTE))
RIG = SENSOR_RIG.rig
IDEAL = Noise(None)


def made(kind, topic, noise, *more):
    """Model of a sensor of the standard rig; an ideal one where there is no noise."""
    sensor = SENSOR_RIG.sensors[topic]
    return kind(sensor.calibration, make_ideal(sensor.part) if noise is IDEAL else sensor.part, *more, noise)


def still(positions, yaw=0.0, pitch=0.0):
    p = np.atleast_2d(np.asarray(positions, dtype=float))
    n = len(p)
    q = Rotation.from_euler("ZY", [yaw, pitch]).as_quat(scalar_first=True)
    return Track(
        t_ns=np.arange(n, dtype=np.int64) * 10_000_000,
        p_body_in_world=p,
        q_world_body=np.tile(q, (n, 1)),
        v_body_in_world=np.zeros((n, 3)),
        w_body=np.tile([0.1, 0.2, 0.3], (n, 1)),
    )


def test_sonar_hears_the_other_shoe_and_not_the_floor():
    sonar = made(SonarModel, "/foot_l/sonar", IDEAL, Terrain.from_route(ROUTE), Crowd())
    left = still([[0.0, 0.1, 0.0], [0.0, 0.1, 0.0]])
    right = still([[0.0, -0.1, 0.0], [0.0, -0.2, 0.0]])
    distance = sonar.read(left, right).columns["distance"]
    # From 4 cm inside the left heel to the ball of 3.8 cm about the right one.
    assert distance[0] == pytest.approx(0.2 - 0.04 - 0.038, abs=0.005)
    assert distance[1] - distance[0] == pytest.approx(0.1, abs=0.003)


def test_sonar_hears_a_riser_and_silence():
    terrain = Terrain.from_route(ROUTE)
    sonar = made(SonarModel, "/foot_l/sonar", IDEAL, terrain, Crowd())
    far_off = still([[0.0, 50.0, 0.0]])
    facing = still([[2.0, 0.0, 0.0]], yaw=np.pi / 2)  # the left sonar looks to the right: along +x
    block = sonar.read(facing, far_off)
    ahead = facing.to_sensor(RIG.others["/foot_l/sonar"].mount.T_body_sensor).p_body_in_world[0, 0]
    assert block.columns["distance"][0] == pytest.approx(3.0 - ahead, abs=1e-6)
    in_the_open = still([[-1.9, 0.0, 4.0]], yaw=-np.pi / 2)  # above all, looking back
    assert sonar.read(in_the_open, far_off).columns["distance"][0] == 0


@pytest.mark.parametrize("side", ["l", "r"])
@settings(max_examples=60, deadline=None)
@given(x=st.floats(-0.045, 0.225), y=st.floats(-0.04, 0.04))
def test_cells_share_the_load_about_the_centre_of_pressure(side, x, y):
    cells = np.array(RIG.others[f"/foot_{side}/insole"].parameters["cells_m"])
    share = cell_shares(cells, np.array([[x, y]]))[0]
    assert np.all(share >= 0)
    assert share.sum() == pytest.approx(1.0)
    mean = share @ cells
    # The mean is the nearest point of the outline: no cell lies farther along the way from it to the point.
    miss = np.array([x, y]) - mean
    assert np.max(cells @ miss) <= mean @ miss + 1e-9


@pytest.mark.parametrize("side", ["l", "r"])
def test_cells_reproduce_a_centre_inside_exactly(side):
    cells = np.array(RIG.others[f"/foot_{side}/insole"].parameters["cells_m"])
    weights = np.random.default_rng(2).dirichlet(np.ones(4), 200)
    cop = weights @ cells
    np.testing.assert_allclose(cell_shares(cells, cop) @ cells, cop, atol=1e-12)


def test_insole_reads_load_and_centre_from_the_wrench():
    insole = made(InsoleModel, "/foot_l/insole", IDEAL)
    foot = still([[1.0, 0.1, 0.3]] * 2, yaw=0.4, pitch=-0.1)
    at = foot.rotation.apply([[0.05, 0.005, 0.0]] * 2)
    force = foot.rotation.apply([[20.0, 5.0, 600.0], [0.0, 0.0, 0.0]])
    cells = insole.read(foot, force, np.cross(at, force)).columns["force"]
    assert cells[0].sum() == pytest.approx(600.0)
    centre = cells[0] @ np.array(RIG.others["/foot_l/insole"].parameters["cells_m"]) / 600.0
    np.testing.assert_allclose(centre, [0.05, 0.005], atol=1e-9)
    np.testing.assert_array_equal(cells[1], 0.0)


def test_noisy_cells_never_pull():
    insole = made(InsoleModel, "/foot_l/insole", Noise.of_topic(1, "/foot_l/insole"))
    foot = still(np.zeros((500, 3)))
    assert np.all(insole.read(foot, np.zeros((500, 3)), np.zeros((500, 3))).columns["force"] >= 0)


def ahrs_errors(rate_radps, seconds=3000.0):
    """(N, 3) rotation vectors in the world, rad, of the limb's AHRS that turns about its z axis to and fro."""
    n = int(100 * seconds)
    w = np.zeros((n, 3))
    w[:, 2] = rate_radps * np.where(np.arange(n) % 200 < 100, 1.0, -1.0)
    yaw = np.cumsum(w[:, 2]) / 100
    body = replace(
        still(np.zeros((n, 3))),
        w_body=w,
        q_world_body=Rotation.from_euler("z", yaw[:, None]).as_quat(scalar_first=True),
    )
    measured = made(AhrsModel, "/exo/thigh_l/ahrs", Noise.of_topic(1, "x")).read(body)
    assert measured.columns["angular_rate"].std(axis=0)[0] == pytest.approx(np.radians(0.1), rel=0.05)
    q = Rotation.from_quat(measured.columns["q_world_sensor"], scalar_first=True)
    return (q * body.rotation.inv()).as_rotvec()


def test_an_ideal_ahrs_measures_attitude_and_rate():
    body = still(np.zeros((400, 3)), yaw=0.5, pitch=0.2)
    measured = made(AhrsModel, "/exo/back/ahrs", IDEAL).read(body)
    np.testing.assert_allclose(measured.columns["q_world_sensor"], body.q_world_body, atol=1e-12)
    np.testing.assert_allclose(measured.columns["angular_rate"], body.w_body, atol=1e-12)


def test_the_rates_of_an_ahrs_keep_some_bias():
    part, body = SENSOR_RIG.sensors["/exo/thigh_l/ahrs"].part, still(np.zeros((1000, 3)))
    models = [made(AhrsModel, "/exo/thigh_l/ahrs", Noise.of_topic(seed, "x")) for seed in range(60)]
    means = np.array([(model.read(body).columns["angular_rate"] - body.w_body).mean(axis=0) for model in models])
    assert means.std() == pytest.approx(part.rate_bias, rel=0.2)


def test_the_tilt_of_an_ahrs_errs_more_in_motion_and_its_heading_drifts():
    part = SENSOR_RIG.sensors["/exo/thigh_l/ahrs"].part
    at_rest, moving = ahrs_errors(0.0), ahrs_errors(3.0)
    np.testing.assert_allclose(at_rest[:, :2].std(axis=0), part.tilt_still, rtol=0.15)
    np.testing.assert_allclose(moving[:, :2].std(axis=0), part.tilt_moving, rtol=0.15)
    drift = (at_rest[-1, 2] - at_rest[0, 2]) / 50.0  # a minute
    assert 0 < abs(drift) <= np.radians(0.1) + 1e-9
    assert np.ptp(moving[:, 2] - np.linspace(moving[0, 2], moving[-1, 2], len(moving))) > np.radians(0.5)


def ahrs_paths(pitch, seeds, seconds=60.0):
    """(len(seeds), 2, 3) rotation vectors in the world, rad, of the errors at 0 s and later, at rest."""
    topic = "/exo/thigh_l/ahrs"
    body = replace(still(np.zeros((2, 3)), yaw=0.4, pitch=pitch), t_ns=np.array([0, round(seconds * 1e9)]))
    body = replace(body, w_body=np.zeros((2, 3)))
    measured = [made(AhrsModel, topic, Noise.of_topic(seed, topic)).read(body).columns for seed in seeds]
    rotations = [Rotation.from_quat(columns["q_world_sensor"], scalar_first=True) for columns in measured]
    sensor = body.to_sensor(SENSOR_RIG.sensors[topic].calibration.mount.T_body_sensor).rotation
    return np.array([(rotation * sensor.inv()).as_rotvec() for rotation in rotations])


def test_the_heading_of_an_ahrs_drifts_as_its_data_sheet_says():
    errors = ahrs_paths(0.0, range(200))
    drift = errors[:, 1, 2] - errors[:, 0, 2]  # over a minute
    most = np.radians(0.1)
    assert 0.95 * most < np.abs(drift).max() <= most + 1e-9
    assert drift.std() == pytest.approx(most / np.sqrt(3), rel=0.1)


def test_the_error_of_an_ahrs_is_one_about_the_axes_of_the_world():
    level, upright = ahrs_paths(0.0, range(3), 3000.0), ahrs_paths(1.4, range(3), 3000.0)
    np.testing.assert_allclose(upright, level, atol=1e-12)
    assert np.abs(level[:, 1, 2]).max() > 3 * np.abs(level[..., :2]).max()


def test_encoder_counts():
    t = np.arange(1000, dtype=np.int64)
    angle = np.linspace(-0.1, 1.2, 1000)
    measured = made(EncoderModel, "/exo/knee_l/encoder", Noise.of_topic(1, "x")).read(t, angle).columns["angle"]
    counts = measured / (2 * np.pi / 4096)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.abs(measured - angle).max() < np.radians(0.2) + 5 * np.radians(0.1) + np.pi / 4096
    np.testing.assert_allclose(made(EncoderModel, "/exo/knee_l/encoder", IDEAL).read(t, angle).columns["angle"], angle)


def test_the_error_of_an_encoder_is_a_sine_over_a_turn_and_its_index_offset():
    t, angle = np.arange(4000, dtype=np.int64), np.linspace(-np.pi, np.pi, 4000, endpoint=False)
    part = SENSOR_RIG.sensors["/exo/knee_l/encoder"].part
    error = made(EncoderModel, "/exo/knee_l/encoder", Noise.of_topic(1, "x")).read(t, angle).columns["angle"] - angle
    sine = 2.0 * np.abs(np.mean(error * np.exp(-1j * angle)))
    assert sine == pytest.approx(part.nonlinearity, rel=0.02)
    assert 0.0 < abs(error.mean()) < 4.0 * part.index_offset


def test_interaction_pair_shows_which_side_is_pressed():
    t = np.arange(3, dtype=np.int64)
    pair = made(InteractionModel, "/exo/thigh_l/interaction", IDEAL)
    force = pair.read(t, np.array([10.0, 0.0, -4.0])).columns["force"]
    np.testing.assert_allclose(force, [[10.0, 0.0], [5.0, 5.0], [3.0, 7.0]])


def test_passive_actuator_reports_noise_about_zero():
    t = np.arange(2000, dtype=np.int64)
    model = made(ActuatorModel, "/exo/hip_l/actuator", Noise.of_topic(1, "a"))
    columns = model.read(t, 0.0, 0.0, np.full(2000, 1.5)).columns
    assert np.all(columns["torque_command"] == 0)
    assert columns["torque"].std() == pytest.approx(0.2, rel=0.1)
    assert columns["speed"].mean() == pytest.approx(1.5, abs=0.002)


def test_a_force_cell_loops_between_loading_and_unloading_and_creeps():
    part = replace(SENSOR_RIG.sensors["/foot_l/insole"].part, gain=0.0, noise=0.0, filter_hz=np.inf)
    quick = ForceCells(replace(part, drift=0.0), 1, 100.0, IDEAL)
    way = np.concatenate([np.linspace(0, 150, 301), np.linspace(150, 0, 301)[1:]])
    measured = quick.read(np.column_stack([way]))[:, 0]
    up, down = measured[way == 75.0]
    assert down - up == pytest.approx(part.hysteresis * 75.0, rel=0.1)
    assert measured[0] == measured[-1] == 0
    count = G * 1e-3 * 6.97  # at no load, where the curve is steepest
    assert np.abs(measured - way).max() < part.hysteresis / 2 * 150 + count
    crept = ForceCells(replace(part, hysteresis=0.0), 1, 100.0, IDEAL).read(np.full((20000, 1), 100.0))[:, 0]
    decade = crept[np.searchsorted(np.arange(20000), [400, 4000])]
    assert decade[1] - decade[0] == pytest.approx(part.drift * 100.0, rel=0.35)
    assert np.all(np.diff(crept) >= 0)


def test_a_force_cell_counts_on_its_curve_and_saturates():
    cell = SENSOR_RIG.sensors["/foot_l/insole"].part
    part = replace(cell, gain=0.0, noise=0.0, drift=0.0, hysteresis=0.0, filter_hz=np.inf)
    force = np.linspace(0, 300, 3001)
    measured = ForceCells(part, 1, 100.0, IDEAL).read(force[:, None])[:, 0]
    x = measured / G  # kgf back to counts by the paper's curve
    counts = 1000 * (6.97 - np.sqrt(6.97**2 - 4 * 0.47 * x)) / (2 * 0.47)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    inside = force < 20 * G
    assert np.abs(measured - force)[inside].max() < 0.5 * 6.97e-3 * G + 1e-9
    assert measured.max() == pytest.approx(20 * G, abs=6.97e-3 * G)


def test_a_force_cell_follows_through_its_butterworth_filter_in_pieces():
    part = SENSOR_RIG.sensors["/foot_l/insole"].part
    load = np.abs(np.random.default_rng(0).normal(60, 40, (300, 4)))
    whole = ForceCells(part, 4, 100.0, Noise.of_topic(1, "x")).read(load)
    cells = ForceCells(part, 4, 100.0, Noise.of_topic(1, "x"))
    np.testing.assert_allclose(np.vstack([cells.read(load[:50]), cells.read(load[50:])]), whole, atol=1e-9)
    assert whole[100:].std() < 0.6 * load.std()


def test_sonar_measures_whole_steps_and_now_and_then_a_ghost():
    sensor = SENSOR_RIG.sensors["/foot_l/sonar"]
    left, right = still(np.tile([0.0, 0.1, 0.0], (4000, 1))), still(np.tile([0.0, -0.25, 0.0], (4000, 1)))
    measured = made(SonarModel, "/foot_l/sonar", Noise.of_topic(1, "x"), Terrain.from_route(ROUTE), Crowd()).read(
        left, right
    )
    distance = measured.columns["distance"]
    np.testing.assert_allclose(distance / 0.043, np.round(distance / 0.043), atol=1e-9)
    true = made(SonarModel, "/foot_l/sonar", IDEAL, Terrain.from_route(ROUTE), Crowd()).read(left[:1], right[:1])
    ghosts = np.abs(distance - true.columns["distance"][0]) > 0.0215 + 5 * sensor.part.noise
    assert ghosts.mean() == pytest.approx(sensor.part.ghost, rel=0.4)


@settings(max_examples=40, deadline=None)
@given(offset=st.floats(-0.05, 0.05), drift=st.floats(-200, 200), jitter=st.floats(0, 0.02), latency=st.floats(0, 0.05))
def test_stamps_increase_whatever_the_clock(offset, drift, jitter, latency):
    clock = Clock(offset_s=offset, drift_ppm=drift, jitter_s=jitter, latency_s=latency)
    t = np.round(np.arange(500) * 1e9 / 120).astype(np.int64)
    stamps = Stamps(clock, 120.0, Noise.of_topic(1, "x"))
    measured = np.concatenate([stamps.stamp(t[:200]), stamps.stamp(t[200:])])
    kept = measured[measured >= 0]
    assert np.all(np.diff(kept) > 0)
    late = (measured - t)[measured >= 0] * 1e-9 - offset - latency - drift * 1e-6 * t[measured >= 0] * 1e-9
    assert np.abs(late).max() <= 0.45 / 120 + 2e-9
    assert len(measured) - len(kept) <= 7 + 1


def test_a_perfect_clock_stamps_true_times():
    t = np.arange(5, dtype=np.int64)
    np.testing.assert_array_equal(Stamps(Clock(calibrated=True), 100.0, IDEAL).stamp(t), t)
    np.testing.assert_array_equal(Stamps(Clock(), 100.0, IDEAL).stamp(t), t)
