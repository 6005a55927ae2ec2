"""IMUs on segments of the body: where they sit, what they measure in every kind of walk, and what they leave alone."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.sim.choices import BODY_PLACES
from stridetwin.sim.config import Gait, Level, Motion, Person, Route, Stairs, TwinConfig
from stridetwin.sim.parts.sensor_config import Clock, SensorConfig
from stridetwin.sim.scene.scene_spec import scene_spec
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.body import add_wearer, compile_model
from stridetwin.sim.wearer.imu_places import body_of, default_position, split_side, thin_axis
from stridetwin.sim.wearer.limbs import find_shapes
from stridetwin.sim.wearer.sensor_bodies import visible_items
from stridetwin.streams.samples import Array, Block
from tests.mocap import MOCAP, needs_mocap

SHORT = TwinConfig(
    name="short",
    route=Route(segments=(Level(length_m=1.5), Stairs(risers=2), Level(length_m=1.5))),
    gait=Gait(stand_s=0.5),
    sensors=("body_imu",),
)
PEOPLE = [Person(), Person(height_m=1.55, mass_kg=50, sex="female"), Person(height_m=1.93, mass_kg=105)]
G = np.array([0.0, 0.0, -9.81])


def read(twin: Twin) -> dict[str, Block]:
    """All samples of a walk, one block per topic."""
    parts: dict[str, list[Block]] = {}
    for chunk in twin.blocks():
        for block in chunk:
            if isinstance(block, Block):
                parts.setdefault(block.topic, []).append(block)
    joined = {}
    for topic, blocks in parts.items():
        columns = {name: np.concatenate([b.columns[name] for b in blocks]) for name in blocks[0].columns}
        t_ns = np.concatenate([b.t_ns for b in blocks])
        joined[topic] = replace(blocks[0], t_ns=t_ns, columns=columns)
    return joined


def end_errors(streams: dict[str, Block], topics: list[str]) -> tuple[Array, Array]:
    """Integrates IMUs from their true start: errors at the end, of position (N,), m, and of attitude (N,), rad."""
    truth = [streams[f"/truth{topic}/odometry"] for topic in topics]
    n = min(len(streams[topic]) for topic in topics)
    for topic, true in zip(topics, truth):
        np.testing.assert_array_equal(streams[topic].t_ns[:n], true.t_ns[:n])
    t = truth[0].t_ns[:n] * 1e-9
    rate = np.stack([streams[topic].columns["angular_rate"][:n] for topic in topics])
    force = np.stack([streams[topic].columns["specific_force"][:n] for topic in topics])
    p = np.stack([true.columns["p_frame_in_world"][0] for true in truth])
    v = np.stack([true.columns["v_frame_in_world"][0] for true in truth])
    R = Rotation.from_quat(np.stack([true.columns["q_world_frame"][0] for true in truth]), scalar_first=True)
    for k in range(1, n):
        dt = t[k] - t[k - 1]
        turn = Rotation.from_rotvec(rate[:, k] * dt)
        half = Rotation.from_rotvec(rate[:, k] * dt / 2)
        # mean of the rotated force over the interval by Simpson's rule
        mean = (force[:, k] + 4 * half.apply(force[:, k]) + turn.apply(force[:, k])) / 6
        v_next = v + dt * (R.apply(mean) + G)
        p, v, R = p + dt * (v + v_next) / 2, v_next, R * turn
    p_end = np.stack([true.columns["p_frame_in_world"][n - 1] for true in truth])
    R_end = Rotation.from_quat(np.stack([true.columns["q_world_frame"][n - 1] for true in truth]), scalar_first=True)
    return np.linalg.norm(p - p_end, axis=1), (R_end.inv() * R).magnitude()


@pytest.mark.parametrize("person", PEOPLE, ids=lambda p: f"{p.height_m:g} m")
def test_every_standard_place_lies_on_the_surface_of_its_segment(person: Person) -> None:
    spec = mujoco.MjSpec()
    add_wearer(spec, person, None)
    model = compile_model(spec)
    for place in BODY_PLACES:
        position, axis = default_position(place, person), thin_axis(place)
        _, side = split_side(place)
        position[1] *= -1.0 if side == "r" else 1.0
        shapes = find_shapes(model, {model.body(body_of(place)).id})
        out = np.zeros(3)
        # from the segment's middle towards the place, along the axis across which the case is thin
        out[axis] = np.sign(position[axis] - np.mean([shape.p for shape in shapes], axis=0)[axis])
        distance = min(shape.ray_distance(position + 0.3 * out, -out) for shape in shapes)
        # the middle of a case of 12 mm, within 5 mm: on two shapes that meet and on slim or stout people
        assert 0.3 - distance == pytest.approx(-0.006, abs=0.005), (place, 0.3 - distance)


def test_left_and_right_are_mirrored_and_middle_places_count_to_the_left() -> None:
    own = SensorConfig(position_m=(0.01, 0.05, -0.2), rotation_rad=(0.1, 0.2, 0.3))
    places = {"thigh_l": own, "thigh_r": own, "chest": own, "wrist_l": SensorConfig()}
    imus = sensor_rig(replace(SHORT, fittings={"body_imu": SensorConfig(places=places)})).rig.imus
    assert list(imus) == ["/body/chest/imu", "/body/wrist_l/imu", "/body/thigh_l/imu", "/body/thigh_r/imu"]
    left, right, chest = (imus[f"/body/{p}/imu"].mount.T_body_sensor for p in ("thigh_l", "thigh_r", "chest"))
    mirror = np.diag([1.0, -1.0, 1.0])
    np.testing.assert_allclose(mirror @ left[:3, 3], right[:3, 3])
    np.testing.assert_allclose(mirror @ left[:3, :3] @ mirror, right[:3, :3], atol=1e-12)
    np.testing.assert_allclose(chest, left)
    assert imus["/body/wrist_l/imu"].mount.body == "forearm_l"


def test_each_place_has_its_own_part_clock_and_population() -> None:
    places = {
        "shank_l": SensorConfig(rate_hz=400.0, clock=Clock(offset_s=0.01)),
        "shank_r": SensorConfig(population="consumer"),
    }
    sensors = sensor_rig(replace(SHORT, fittings={"body_imu": SensorConfig(places=places)})).sensors
    left, right = sensors["/body/shank_l/imu"], sensors["/body/shank_r/imu"]
    assert (left.calibration.rate_hz, right.calibration.rate_hz) == (400.0, 200.0)
    assert (left.clock.shift_s, right.clock.shift_s) == (0.01, 0.0)
    assert (left.sensor_config.population, right.sensor_config.population) == (None, "consumer")


@pytest.fixture(scope="module")
def planned() -> Twin:
    return Twin(replace(SHORT, ideal=True), 3)


def test_ideal_imus_of_a_planned_walk_integrate_back_onto_the_true_path(planned: Twin) -> None:
    streams = read(planned)
    topics = [f"/body/{place}/imu" for place in BODY_PLACES]
    assert set(topics) == {topic for topic in streams if topic.endswith("/imu")}
    position, attitude = end_errors(streams, topics)
    assert position.max() < 1e-3, dict(zip(topics, position))
    assert attitude.max() < 1e-7


def test_the_truth_of_every_imu_is_the_kinematics_of_the_physics_engine(planned: Twin) -> None:
    streams = read(planned)
    data = mujoco.MjData(planned.model)
    for at_s in (0.4, 2.0, 3.1):
        q, v = planned.walk.position_velocity(np.array([at_s]))
        data.qpos, data.qvel = q[0], v[0]
        mujoco.mj_kinematics(planned.model, data)
        mujoco.mj_comPos(planned.model, data)
        mujoco.mj_comVel(planned.model, data)
        for topic, imu in planned.sensor_rig.rig.imus.items():
            true = streams[f"/truth{topic}/odometry"]
            row = int(np.searchsorted(true.t_ns, round(at_s * 1e9)))
            body = data.body(imu.mount.body)
            R = body.xmat.reshape(3, 3)
            lever = R @ imu.mount.T_body_sensor[:3, 3]
            six = np.zeros(6)  # rates and velocity of the body's origin, world axes
            kind = mujoco.mjtObj.mjOBJ_XBODY
            mujoco.mj_objectVelocity(planned.model, data, kind, planned.model.body(imu.mount.body).id, six, 0)
            np.testing.assert_allclose(true.columns["p_frame_in_world"][row], body.xpos + lever, atol=1e-9)
            velocity = six[3:] + np.cross(six[:3], lever)
            np.testing.assert_allclose(true.columns["v_frame_in_world"][row], velocity, atol=1e-8, err_msg=topic)


def test_ideal_imus_of_a_simulated_walk_integrate_back_onto_the_true_path() -> None:
    route = Route(segments=(Level(length_m=1.5),))
    twin = Twin(replace(SHORT, route=route, physics="dynamic", ideal=True), 3)
    position, attitude = end_errors(read(twin), [f"/body/{p}/imu" for p in ("wrist_r", "shank_l", "head", "heel_r")])
    assert position.max() < 2e-3, position
    assert attitude.max() < 1e-6


@needs_mocap
def test_ideal_imus_of_a_recorded_walk_integrate_back_onto_the_true_path() -> None:
    motion = Motion(file=str(MOCAP / "opencap_walking.trc.gz"))
    places = ("chest", "thigh_l", "shank_r", "hand_l", "ankle_r")
    fittings = {"body_imu": SensorConfig(places=dict.fromkeys(places, SensorConfig()))}
    twin = Twin(replace(SHORT, gait=Gait(), motion=motion, ideal=True, fittings=fittings), 3)
    position, attitude = end_errors(read(twin), [f"/body/{place}/imu" for place in places])
    assert position.max() < 2e-3, position
    assert attitude.max() < 1e-6


def test_they_change_no_other_sensor_and_measure_gravity_at_rest() -> None:
    route = Route(segments=(Level(length_m=1.0),))
    base = replace(SHORT, route=route, sensors=("foot_imu", "insole", "ahrs", "head_imu"))
    before = read(Twin(base, 5))
    after = read(Twin(replace(base, sensors=(*base.sensors, "body_imu")), 5))
    for topic, block in before.items():
        for name, column in block.columns.items():
            assert np.array_equal(column, after[topic].columns[name]), topic
    assert not any("/body/" in topic for topic in before)
    # at rest all measure gravity, within the turn-on bias of the part and its scale
    for place in BODY_PLACES:
        force = np.linalg.norm(after[f"/body/{place}/imu"].columns["specific_force"][10:60], axis=1)
        assert np.mean(force) == pytest.approx(9.81, abs=1.2), place


def test_the_scene_has_a_site_and_the_wearer_a_flat_case_at_every_place() -> None:
    spec = scene_spec(SHORT)
    sites = {site.name for site in spec.sites}
    assert {f"body_{place}_imu" for place in BODY_PLACES} <= sites
    cases = {topic: part for _, part, topic, _ in visible_items(sensor_rig(SHORT).rig)}
    assert cases["/body/chest/imu"] == cases["/body/heel_l/imu"] == "imu_pod_front"
    assert cases["/body/thigh_r/imu"] == "imu_pod"
    assert cases["/body/instep_r/imu"] == "imu_pod_top"


def test_heel_strikes_shake_the_imus_that_they_are_asked_to_and_their_truth() -> None:
    route = Route(segments=(Level(length_m=2.0),))
    soft, hard = SensorConfig(ideal=True), SensorConfig(ideal=True, strike=20.0)
    base = replace(SHORT, route=route, sensors=("body_imu",))
    found = []
    for shank in (soft, hard):
        places = {"shank_l": shank, "shank_r": soft, "pelvis": replace(shank, strike=shank.strike / 4)}
        twin = Twin(replace(base, fittings={"body_imu": SensorConfig(places=places)}), 5)
        found.append(read(twin))
    before, after = found
    touch = [step.t_touch for step in twin.walk.steps["l"] if np.isfinite(step.t_touch)]
    shaken = {
        place: np.linalg.norm(
            after[f"/body/{place}/imu"].columns["specific_force"]
            - before[f"/body/{place}/imu"].columns["specific_force"],
            axis=1,
        )
        for place in ("shank_l", "shank_r", "pelvis")
    }
    t = before["/body/shank_l/imu"].t_ns * 1e-9
    near = np.any([(t > first - 0.002) & (t < first + 0.06) for first in touch], axis=0)
    assert 10.0 < shaken["shank_l"][near].max() < 60.0  # 20 m/s², more or less from strike to strike
    assert shaken["shank_l"][near].max() > 2 * shaken["pelvis"].max() > 2.0  # which those of both feet reach
    assert np.all(shaken["shank_l"][t < touch[0] - 0.01] == 0.0)
    assert np.all(shaken["shank_r"] == 0.0)
    # what is measured is the motion of the truth
    position, attitude = end_errors(after, ["/body/shank_l/imu", "/body/pelvis/imu"])
    assert position.max() < 2e-3
    assert attitude.max() < 1e-6
    moved = after["/truth/body/shank_l/imu/odometry"].columns["p_frame_in_world"]
    still = before["/truth/body/shank_l/imu/odometry"].columns["p_frame_in_world"]
    assert 0.5e-3 < np.linalg.norm(moved - still, axis=1).max() < 10e-3
