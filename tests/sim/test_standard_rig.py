from dataclasses import replace

import mujoco
import numpy as np
import pytest

from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.sensors.standard_rig import FOOT_BOARD, FOOT_CAMERA, GROUPS, standard_rig
from stridetwin.sim.wearer.sensor_bodies import add_rig, visible_items
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.kalibr import rig_from_yaml, rig_to_yaml

CONFIG = TwinConfig(name="walk", route=Route(segments=(Level(length_m=3.0),)))
RIG = standard_rig(CONFIG)
BODIES = {
    "pelvis",
    "torso",
    "head",
    "exo_back",
    *(f"{b}_{s}" for s in "lr" for b in ("thigh", "shank", "foot", "toe")),
    *(f"exo_{b}_{s}" for s in "lr" for b in ("thigh", "shank", "foot")),
}
MIRROR = np.diag([1.0, -1.0, 1.0])


def mounts(rig):
    for group in (rig.imus, rig.cameras, rig.boards, rig.others):
        yield from ((name, sensor.mount) for name, sensor in group.items())


def test_every_topic_of_the_design_is_there_at_its_rate():
    rates = {t: s.rate_hz for g in (RIG.imus, RIG.cameras, RIG.others) for t, s in g.items()}
    expected = {"/head/color": 30, "/head/imu": 200, "/exo/back/ahrs": 100}
    for s in "lr":
        expected |= {f"/foot_{s}/imu": 120, f"/foot_{s}/camera": 60, f"/foot_{s}/sonar": 25}
        expected |= {f"/foot_{s}/insole": 100, f"/exo/knee_{s}/encoder": 100}
        expected |= {f"/exo/{p}_{s}/ahrs": 100 for p in ("thigh", "foot")}
        expected |= {f"/exo/{p}_{s}/interaction": 100 for p in ("thigh", "shank")}
        expected |= {f"/exo/{p}_{s}/actuator": 100 for p in ("hip", "knee")}
    assert rates == expected
    assert RIG.cameras["/head/color"].depth_topic == "/head/depth"
    assert RIG.cameras["/foot_l/camera"].K[0, 0] == pytest.approx(400 / np.tan(np.radians(36.5)))


def test_mounts_are_rigid_and_on_bodies_that_exist():
    for name, mount in mounts(RIG):
        assert mount.body in BODIES, name
        R = mount.T_body_sensor[:3, :3]
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12, err_msg=name)
        assert np.linalg.det(R) == pytest.approx(1.0)


def test_left_and_right_are_mirrored():
    all_mounts = dict(mounts(RIG))
    for name, mount in all_mounts.items():
        if "_l" in name:
            other = all_mounts[name.replace("_l", "_r")]
            np.testing.assert_allclose(MIRROR @ mount.T_body_sensor[:3, 3], other.T_body_sensor[:3, 3], err_msg=name)
    for name, axis in (("/foot_{}/camera", 2), ("/foot_{}/sonar", 0), ("foot_{}", 2)):
        left, right = (all_mounts[name.format(s)].T_body_sensor[:3, axis] for s in "lr")
        np.testing.assert_allclose(MIRROR @ left, right, atol=1e-12)


def test_a_sweep_can_move_shoe_cameras_and_boards():
    fitting = SensorConfig(
        mount=replace(FOOT_CAMERA, position_m=(-0.05, 0.04, 0.05)), board=replace(FOOT_BOARD, faces_rad=(2.8, 0.1))
    )
    moved = standard_rig(replace(CONFIG, fittings={"foot_camera": fitting}))
    for topic, camera in moved.cameras.items():
        same = RIG.cameras[topic].mount.T_body_sensor
        assert np.array_equal(camera.mount.T_body_sensor[:3, :3], same[:3, :3])
        if topic.startswith("/foot"):
            np.testing.assert_allclose(np.abs(camera.mount.T_body_sensor[:3, 3]), (0.05, 0.04, 0.05))
    for name, board in moved.boards.items():
        same = RIG.boards[name].mount.T_body_sensor
        assert np.array_equal(board.mount.T_body_sensor[:3, 3], same[:3, 3])
        assert not np.allclose(board.mount.T_body_sensor[:3, 2], same[:3, 2], atol=0.05)


@pytest.mark.parametrize("side", ["l", "r"])
def test_a_shoe_camera_sees_the_board_of_the_foot_ahead(side):
    inward = -1.0 if side == "l" else 1.0
    other = "r" if side == "l" else "l"
    T_foot_camera = RIG.cameras[f"/foot_{side}/camera"].mount.T_body_sensor
    T_foot_board = np.eye(4)
    T_foot_board[:3, 3] = [0.30, 0.18 * inward, 0.10]  # the other foot in mid-swing, ahead and inward
    T = np.linalg.inv(T_foot_camera) @ T_foot_board @ RIG.boards[f"foot_{other}"].mount.T_body_sensor
    corners = np.array([[x, y, 0, 1] for x in (-0.015, 0.015) for y in (-0.0225, 0.0225)]) @ T.T
    u, v, w = (corners[:, :3] @ RIG.cameras[f"/foot_{side}/camera"].K.T).T
    assert np.all(w > 0)
    assert np.all((u / w > 0) & (u / w < 799) & (v / w > 0) & (v / w < 599))
    assert T[:3, 2] @ T[:3, 3] < 0  # its printed face is turned this way


def test_the_head_camera_looks_forward_and_25_degrees_down():
    T = RIG.cameras["/head/color"].mount.T_body_sensor
    np.testing.assert_allclose(T[:3, 2], [np.cos(np.radians(25)), 0, -np.sin(np.radians(25))], atol=1e-12)
    np.testing.assert_allclose(T[:3, 0], [0, -1, 0], atol=1e-12)


def test_the_chest_carries_the_same_camera():
    rig = standard_rig(replace(CONFIG, rig_mount="chest"))
    assert rig.cameras["/chest/color"].mount.body == "torso"
    assert rig.cameras["/chest/color"].imu_topic in rig.imus


@pytest.mark.parametrize("group", GROUPS)
def test_a_group_can_be_left_out(group):
    every = standard_rig(replace(CONFIG, sensors=GROUPS))
    rig = standard_rig(replace(CONFIG, sensors=tuple(g for g in GROUPS if g != group)))
    count = sum(len(g) for g in (rig.imus, rig.cameras, rig.others))
    assert count < sum(len(g) for g in (every.imus, every.cameras, every.others))
    assert bool(rig.boards) == (group != "foot_camera")


def test_the_inertial_sensors_of_the_ahrs_are_there_when_asked_for():
    rig = standard_rig(replace(CONFIG, sensors=("ahrs", "exo_imu")))
    assert {t.replace("/imu", "/ahrs") for t in rig.imus} == set(rig.others)
    for topic, imu in rig.imus.items():
        ahrs = rig.others[topic.replace("/imu", "/ahrs")]
        assert imu.part.startswith(ahrs.part.split(",")[0])
        assert (imu.mount.body, imu.rate_hz) == (ahrs.mount.body, ahrs.rate_hz)
    assert not any(topic.startswith("/exo") for topic in RIG.imus)
    assert not list(visible_items(rig))  # they sit inside


def test_unknown_groups_and_places_are_refused():
    with pytest.raises(ConfigError, match="foot_imu"):
        standard_rig(replace(CONFIG, sensors=("foot_imu", "lidar")))
    with pytest.raises(ConfigError, match="head or chest"):
        standard_rig(replace(CONFIG, rig_mount="hip"))


def test_what_is_seen_of_the_rig_sits_at_its_mounts_and_weighs_nothing():
    spec = mujoco.MjSpec()
    for body in sorted(BODIES):
        added = spec.worldbody.add_body(name=body, pos=[1.0, 2.0, 3.0])
        added.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0])
    bare = spec.compile()
    add_rig(spec, RIG)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert model.body_mass.sum() == pytest.approx(bare.body_mass.sum())
    assert np.count_nonzero(model.geom_contype) == np.count_nonzero(bare.geom_contype)
    boards = [i for i in range(model.nbody) if model.body(i).name.endswith("checkerboard")]
    assert len(boards) == 2
    np.testing.assert_allclose(
        data.xpos[boards[0]], RIG.boards["foot_l"].mount.T_body_sensor[:3, 3] + [1, 2, 3], atol=1e-12
    )
    np.testing.assert_allclose(
        data.xmat[boards[0]].reshape(3, 3), RIG.boards["foot_l"].mount.T_body_sensor[:3, :3], atol=1e-9
    )


@pytest.mark.parametrize("group", ["head_camera", "foot_camera"])
def test_a_camera_without_the_imu_beside_it_can_be_written(group):
    rig = standard_rig(replace(CONFIG, sensors=(group, "body_imu")))
    again = rig_from_yaml(rig_to_yaml(rig), "rig")
    for topic, camera in rig.cameras.items():
        assert camera.imu_topic == ""
        np.testing.assert_allclose(again.cameras[topic].mount.T_body_sensor, camera.mount.T_body_sensor)
