import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.sim.bystanders import Crowd
from stridetwin.sim.config import Level, Route, Stairs, TwinConfig
from stridetwin.sim.noise import Noise
from stridetwin.sim.sensors.ahrs import AhrsModel
from stridetwin.sim.sensors.insole import InsoleModel, cell_shares
from stridetwin.sim.sensors.joint import ActuatorModel, EncoderModel, InteractionModel
from stridetwin.sim.sensors.picture import DEPTH_RANGE_M, CameraModel, DepthModel
from stridetwin.sim.sensors.sonar import SonarModel
from stridetwin.sim.standard_rig import standard_rig
from stridetwin.sim.terrain import Terrain
from stridetwin.sim.track import Track

ROUTE = Route(segments=(Level(length_m=3.0), Stairs(risers=3)))
RIG = standard_rig(TwinConfig(name="test", route=ROUTE))
IDEAL = Noise(None)


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
    sonar = SonarModel(RIG.others["/foot_l/sonar"], Terrain.from_route(ROUTE), Crowd(), IDEAL)
    left = still([[0.0, 0.1, 0.0], [0.0, 0.1, 0.0]])
    right = still([[0.0, -0.1, 0.0], [0.0, -0.2, 0.0]])
    distance = sonar.read(left, right).columns["distance"]
    # From 4 cm inside the left heel to the ball of 3.8 cm about the right one.
    assert distance[0] == pytest.approx(0.2 - 0.04 - 0.038, abs=0.005)
    assert distance[1] - distance[0] == pytest.approx(0.1, abs=0.003)


def test_sonar_hears_a_riser_and_silence():
    terrain = Terrain.from_route(ROUTE)
    sonar = SonarModel(RIG.others["/foot_l/sonar"], terrain, Crowd(), IDEAL)
    far_off = still([[0.0, 50.0, 0.0]])
    facing = still([[2.0, 0.0, 0.0]], yaw=np.pi / 2)  # the left sonar looks to the right: along +x
    block = sonar.read(facing, far_off)
    ahead = facing.mounted(RIG.others["/foot_l/sonar"].mount.T_body_sensor).p_body_in_world[0, 0]
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
    insole = InsoleModel(RIG.others["/foot_l/insole"], IDEAL)
    foot = still([[1.0, 0.1, 0.3]] * 2, yaw=0.4, pitch=-0.1)
    at = foot.rotation.apply([[0.05, 0.005, 0.0]] * 2)
    force = foot.rotation.apply([[20.0, 5.0, 600.0], [0.0, 0.0, 0.0]])
    cells = insole.read(foot, force, np.cross(at, force)).columns["force"]
    assert cells[0].sum() == pytest.approx(600.0)
    centre = cells[0] @ np.array(RIG.others["/foot_l/insole"].parameters["cells_m"]) / 600.0
    np.testing.assert_allclose(centre, [0.05, 0.005], atol=1e-9)
    np.testing.assert_array_equal(cells[1], 0.0)


def test_noisy_cells_never_pull():
    insole = InsoleModel(RIG.others["/foot_l/insole"], Noise.of_topic(1, "/foot_l/insole"))
    foot = still(np.zeros((500, 3)))
    assert np.all(insole.read(foot, np.zeros((500, 3)), np.zeros((500, 3))).columns["force"] >= 0)


def test_ahrs_tells_attitude_and_rate():
    body = still(np.zeros((400, 3)), yaw=0.5, pitch=0.2)
    ideal = AhrsModel(RIG.others["/exo/back/ahrs"], IDEAL).read(body)
    np.testing.assert_allclose(ideal.columns["q_world_sensor"], body.q_world_body, atol=1e-12)
    np.testing.assert_allclose(ideal.columns["angular_rate"], body.w_body, atol=1e-12)
    noisy = AhrsModel(RIG.others["/exo/back/ahrs"], Noise.of_topic(1, "/exo/back/ahrs")).read(body)
    q = noisy.columns["q_world_sensor"]
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0)
    error = (Rotation.from_quat(q, scalar_first=True) * body.rotation.inv()).as_rotvec()
    np.testing.assert_allclose(np.degrees(error.std(axis=0)), 0.25, rtol=0.2)
    assert np.any(np.abs(np.degrees(error.mean(axis=0))) > 0.05)


def test_encoder_counts():
    calibration = RIG.others["/exo/knee_l/encoder"]
    t = np.arange(1000, dtype=np.int64)
    angle = np.linspace(-0.1, 1.2, 1000)
    told = EncoderModel(calibration, Noise.of_topic(1, "x")).read(t, angle).columns["angle"]
    counts = told / (2 * np.pi / 4096)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.abs(told - angle).max() < 5 * np.radians(0.1) + np.pi / 4096
    np.testing.assert_array_equal(EncoderModel(calibration, IDEAL).read(t, angle).columns["angle"], angle)


def test_interaction_pair_shows_which_side_is_pressed():
    t = np.arange(3, dtype=np.int64)
    pair = InteractionModel(RIG.others["/exo/thigh_l/interaction"], IDEAL)
    force = pair.read(t, np.array([10.0, 0.0, -4.0])).columns["force"]
    np.testing.assert_allclose(force, [[10.0, 0.0], [5.0, 5.0], [3.0, 7.0]])


def test_passive_actuator_reports_noise_about_zero():
    t = np.arange(2000, dtype=np.int64)
    model = ActuatorModel(RIG.others["/exo/hip_l/actuator"], Noise.of_topic(1, "a"))
    columns = model.read(t, 0.0, 0.0, np.full(2000, 1.5)).columns
    assert np.all(columns["torque_command"] == 0)
    assert columns["torque"].std() == pytest.approx(0.2, rel=0.1)
    assert columns["speed"].mean() == pytest.approx(1.5, abs=0.002)


def test_pictures_have_read_noise_of_their_instant():
    rgb = np.full((60, 80, 3), 100, np.uint8)
    camera = CameraModel("/foot_l/camera", (60, 80), Noise.of_topic(1, "/foot_l/camera"))
    later, first = camera.picture(2, rgb), camera.picture(1, rgb)
    again = CameraModel("/foot_l/camera", (60, 80), Noise.of_topic(1, "/foot_l/camera")).picture(1, rgb)
    assert first.pixels.shape == (60, 80)
    assert first.pixels.dtype == np.uint8
    np.testing.assert_array_equal(first.pixels, again.pixels)
    assert not np.array_equal(first.pixels, later.pixels)
    assert first.pixels.std() == pytest.approx(1.5, rel=0.15)
    clean = CameraModel("/head/color", (60, 80, 3), IDEAL).picture(1, rgb)
    np.testing.assert_array_equal(clean.pixels, rgb)


def test_noise_does_not_wrap_round_at_white_and_black():
    for level in (0, 255):
        rgb = np.full((60, 80, 3), level, np.uint8)
        noisy = CameraModel("/head/color", (60, 80, 3), Noise.of_topic(1, "c")).picture(1, rgb).pixels
        assert np.abs(noisy.astype(int) - level).max() < 20


def test_depth_noise_grows_with_the_square_and_leaves_holes():
    low, high = DEPTH_RANGE_M
    depth = np.tile(np.array([0.0, low / 2, 1.0, 4.0, high + 1], np.float32), (400, 1))
    noisy = DepthModel("/head/depth", depth.shape, Noise.of_topic(1, "/head/depth")).picture(5, depth).depth
    assert noisy.dtype == np.float32
    assert np.all(noisy[:, [0, 1, 4]] == 0)
    assert noisy[:, 2].std() == pytest.approx(0.004, rel=0.15)
    assert noisy[:, 3].std() == pytest.approx(0.064, rel=0.15)
    np.testing.assert_allclose(noisy * 1000, np.round(noisy * 1000), atol=2e-3)
    ideal = DepthModel("/head/depth", depth.shape, IDEAL).picture(5, depth).depth
    np.testing.assert_array_equal(ideal[:, 2:4], depth[:, 2:4])
