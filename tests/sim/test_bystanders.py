from __future__ import annotations

import mujoco
import numpy as np
import pytest

from stridetwin.sim.config import Gait, Level, Route, Stairs, Turn, TwinConfig
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.library import make_ideal
from stridetwin.sim.rendering.renderer import SensorView
from stridetwin.sim.sensors.sonar import SonarModel
from stridetwin.sim.twin import Twin
from stridetwin.sim.world.bystanders import PARTS, pose_crowd
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.algebra.arrays import to_quaternion
from stridetwin.streams.errors import ConfigError

ROUTES = {
    "short": (Level(length_m=1.5),),
    "stairs": (Level(length_m=3.0), Stairs(risers=4), Level(length_m=3.0)),
    "corner": (Level(length_m=4.0), Turn(angle_rad=np.radians(90.0), radius_m=0.0), Level(length_m=4.0)),
}


def make(name: str, count: int = 2, seed: int = 3, sensors: tuple[str, ...] = (), physics: str = "kinematic") -> Twin:
    route = Route(segments=ROUTES[name], width_m=1.8, bystanders=count)
    gait = Gait(stand_s=0.5)
    return Twin(TwinConfig(name=name, route=route, gait=gait, sensors=sensors, physics=physics), seed)


@pytest.fixture(scope="module", params=["stairs", "corner"])
def twin(request: pytest.FixtureRequest) -> Twin:
    return make(request.param, 3)


def test_nobody_runs_into_anybody(twin: Twin) -> None:
    t = np.arange(0.0, twin.duration_s, 0.05)
    walker = twin.reference.splines(t)[:, :2]
    places = [person.parts(t)[0][:, 0, :2] for person in twin.crowd]
    assert len(places) == 3
    for i, p in enumerate(places):
        assert np.linalg.norm(p - walker, axis=1).min() > 0.65
        for q in places[:i]:
            assert np.linalg.norm(p - q, axis=1).min() > 0.65


def test_feet_that_carry_stand_still_on_the_ground(twin: Twin) -> None:
    t = np.arange(0.0, twin.duration_s, 0.01)
    for person in twin.crowd:
        p, _ = person.parts(t)
        for side in "lr":
            ankle = p[:, PARTS.index(f"foot_{side}")]
            speed = np.linalg.norm(np.gradient(ankle, t, axis=0), axis=1)
            assert (speed < 0.05).mean() > 0.25
        lower = np.minimum(*(p[:, PARTS.index(f"foot_{side}"), 2] for side in "lr"))
        assert np.all(p[:, 0, 2] - lower > 0.5)
        knees = [
            np.linalg.norm(p[:, PARTS.index(f"thigh_{s}")] - p[:, PARTS.index(f"shank_{s}")], axis=1) for s in "lr"
        ]
        assert np.ptp(knees) < 1e-6


def test_the_same_seed_gives_the_same_people() -> None:
    one, two, three = make("corner"), make("corner"), make("corner", seed=4)
    at = np.array([2.0, 5.0])
    for a, b, c in zip(one.crowd, two.crowd, three.crowd):
        assert np.array_equal(a.parts(at)[0], b.parts(at)[0])
        assert not np.allclose(a.parts(at)[0], c.parts(at)[0])
    t = np.linspace(0.0, one.duration_s, 50)
    alone = make("corner", count=0)
    assert np.array_equal(alone.reference.splines(t), one.reference.splines(t))


def test_a_crowd_leaves_the_simulated_walker_alone_and_is_seen_as_in_the_plan() -> None:
    planned, walked = make("short"), make("short", physics="dynamic")
    alone = make("short", count=0, physics="dynamic")
    assert walked.fell_at is None
    assert np.array_equal(walked.walk.splines.c, alone.walk.splines.c)
    at_s = 1.0
    views = []
    for twin in (planned, walked):
        data = mujoco.MjData(twin.model)
        data.qpos = planned.reference.state(np.array([at_s]))[0][0]
        pose_crowd(twin.model, data, twin.crowd, at_s)
        mujoco.mj_forward(twin.model, data)
        T = np.eye(4)  # over the walker's head, looking down on both
        T[:3, :3], T[:3, 3] = np.diag([1.0, -1.0, -1.0]), [data.qpos[0], data.qpos[1], 6.0]
        with SensorView(twin.model, 64, 48) as view:
            views.append(view.frame(data, T, (40.0, 40.0, 31.5, 23.5)))
    assert all(np.array_equal(a, b) for a, b in zip(*views))
    assert (views[0][1] < 5.5).sum() > 20  # people are there


def test_a_camera_and_a_sonar_agree_on_who_stands_before_them() -> None:
    twin = make("corner")
    at_s, person = 4.0, twin.crowd[0]
    p, R = (part[0, PARTS.index("shank_l")] for part in person.parts(np.array([at_s])))
    middle = p - 0.2 * R[:, 2]
    sides = np.array([[np.cos(yaw), np.sin(yaw), 0.0] for yaw in np.arange(0.0, 6.3, 0.3)])
    free = twin.terrain.ray_cast(np.tile(middle, (len(sides), 1)), sides)
    ahead = -sides[np.argmax(np.minimum(free, 3.0))]  # from where nothing else is near
    eye = middle - 0.9 * ahead
    toward = np.column_stack([np.cross(ahead, [0.0, 0.0, 1.0]), [0.0, 0.0, -1.0], ahead])  # optical frame
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = toward, eye
    data = mujoco.MjData(twin.model)
    data.qpos = twin.reference.state(np.array([at_s]))[0][0]
    pose_crowd(twin.model, data, twin.crowd, at_s)
    mujoco.mj_forward(twin.model, data)
    with SensorView(twin.model, 64, 48) as view:
        _, depth = view.frame(data, T, (60.0, 60.0, 31.5, 23.5))
    seen = float(depth[22:26, 30:34].min())
    assert seen == pytest.approx(0.85, abs=0.03)
    sonar = make("corner", sensors=("sonar",)).sensor_rig.sensors["/foot_l/sonar"]
    T_body_sensor = sonar.calibration.mount.T_body_sensor
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, :3] = np.column_stack([toward[:, 2], toward[:, 0], np.cross(toward[:, 2], toward[:, 0])])
    T_world_sensor[:3, 3] = eye
    T_world_body = T_world_sensor @ np.linalg.inv(T_body_sensor)
    still = {
        "t_ns": np.array([int(at_s * 1e9)]),
        "q_world_body": to_quaternion(T_world_body[None, :3, :3]),
        "v_body_in_world": np.zeros((1, 3)),
        "w_body": np.zeros((1, 3)),
    }
    body = Track(p_body_in_world=T_world_body[None, :3, 3], **still)
    away = Track(p_body_in_world=np.full((1, 3), 100.0), **still)
    model = SonarModel(sonar.calibration, make_ideal(sonar.part), twin.terrain, twin.crowd, Noise(None))
    heard = float(model.read(body, away).columns["distance"][0])
    assert 0.5 < heard <= seen + 0.03


def test_truth_says_where_they_are() -> None:
    twin = make("corner")
    found: dict[str, list[np.ndarray]] = {}
    for blocks in twin.blocks():
        for block in blocks:
            if block.topic.startswith("/truth/bystander"):
                found.setdefault(block.topic, []).append(block.columns["p_frame_in_world"])
    assert set(found) == {f"/truth/bystander_{i}/odometry" for i in range(2)}
    p = np.concatenate(found["/truth/bystander_1/odometry"])
    assert len(p) == pytest.approx(200 * twin.duration_s, abs=2)
    assert np.abs(np.diff(p, axis=0)).max() < 0.05


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"bystanders": 5}, "bystanders"),
        ({"bystanders": 2, "width_m": 1.2}, "width_m"),
        ({"texture": "blue"}, "texture"),
        ({"light": 0.0}, "light"),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, object], field: str) -> None:
    with pytest.raises(ConfigError, match=field):
        Terrain.from_route(Route(segments=ROUTES["stairs"], **options))  # type: ignore[arg-type]
