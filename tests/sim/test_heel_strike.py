"""The upper of a shoe: a motion that sensors and truth agree on, and that a walk leaves no trace of."""

import copy
from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import Gait, Level, Route, TwinConfig
from stridetwin.sim.gait.heel_strike import SHOE, UpperMotion, vibration
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import ImuPart
from stridetwin.sim.parts.library import make_ideal
from stridetwin.sim.sensors.imu import ImuModel
from stridetwin.sim.twin import Twin
from stridetwin.sim.walk import Stance
from stridetwin.streams.samples import Array, Block

CONFIG = TwinConfig(
    name="shock", route=Route(segments=(Level(length_m=6.0),)), gait=Gait(speed_mps=1.3), sensors=("foot_imu",)
)


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin(CONFIG, 3)


def stand_from_zero(lasting: float) -> Stance:
    """A stance of the left foot at the origin from 0 s on."""
    return Stance(
        foot="l",
        p_foot_in_world=np.zeros(3),
        R_world_sole=np.eye(3),
        terrain="level",
        mode="LG",
        t_touch=0.0,
        t_off=lasting,
    )


def every(twin: Twin, rate_hz: float, begin: float = 0.0, end: float | None = None) -> Array:
    end = twin.duration_s if end is None else end
    return np.round(np.arange(begin, end, 1 / rate_hz) * 1e9).astype(np.int64)


def perfect_imu(twin: Twin, topic: str, rate_hz: float) -> ImuModel:
    part = twin.sensor_rig.sensors[topic].part
    assert isinstance(part, ImuPart)
    return ImuModel(twin.rig.imu(topic), replace(make_ideal(part), rate_hz=rate_hz), Noise(None))


def test_ideal_sensors_and_rigid_shoes_ride_on_the_foot(twin: Twin) -> None:
    t_ns = every(twin, 100.0)
    assert set(twin.player().motion(t_ns[:2]).uppers) == {"foot_l", "foot_r"}
    short = replace(CONFIG, route=Route(segments=(Level(length_m=2.0),)))
    for config in (replace(short, ideal=True), replace(short, shock=False)):
        motion = Twin(config, 3).player().motion(t_ns[:2])
        assert not motion.uppers
        assert motion.carrier("foot_l") is motion.tracks["foot_l"]


def test_the_scenario_file_turns_it_off(tmp_path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "rigid.yaml"
    file.write_text("description: d\nterrain:\n  - level: {length_m: 5}\nshock: false\n")
    assert not load_scenario(str(file)).config.shock
    assert load_scenario("level_20m").config.shock


def test_velocity_and_rate_are_the_derivatives_of_the_pose(twin: Twin) -> None:
    upper = twin.player().motion(every(twin, 10000.0, 4.0, 4.6)).uppers["foot_l"]
    h = 1e-4
    speed = (upper.p_body_in_world[2:] - upper.p_body_in_world[:-2]) / (2 * h)
    np.testing.assert_allclose(upper.v_body_in_world[1:-1], speed, atol=2e-3)
    turn = (upper[:-2].rotation.inv() * upper[2:].rotation).as_rotvec() / (2 * h)
    np.testing.assert_allclose(upper.w_body[1:-1], turn, atol=2e-2)


def test_it_stays_small_and_nothing_but_the_end_of_the_toe_off_is_left_of_it_in_swing(twin: Twin) -> None:
    t = every(twin, 500.0)
    motion = twin.player().motion(t)
    for side in ("l", "r"):
        foot, upper = motion.tracks[f"foot_{side}"], motion.uppers[f"foot_{side}"]
        apart = np.linalg.norm(upper.p_body_in_world - foot.p_body_in_world, axis=1)
        rotated = (foot.rotation.inv() * upper.rotation).magnitude()
        assert 0.5e-3 < apart.max() < 15e-3
        assert np.radians(0.3) < rotated.max() < np.radians(10.0)
        steps = twin.walk.steps[side]
        for before, after in pairwise(steps):
            since_s = t * 1e-9 - before.t_off
            swing = (since_s > 0.0) & (t * 1e-9 < after.t_touch)
            assert apart[swing].max() < 1e-3
            assert rotated[swing].max() < np.radians(1.0)
            late = swing & (since_s > 0.30)  # about five decay times of the slowest mode
            assert apart[late].max(initial=0.0) < 5e-5
            assert rotated[late].max(initial=0.0) < np.radians(0.02)


@pytest.mark.parametrize(("rate_hz", "path_m"), [(120.0, 5e-3), (1000.0, 2e-4)])
def test_the_imu_integrates_back_to_the_upper(twin: Twin, rate_hz: float, path_m: float) -> None:
    track = twin.player().motion(every(twin, rate_hz)).uppers["foot_r"]
    imu = twin.rig.imu("/foot_r/imu")
    sensor = track.to_sensor(imu.mount.T_body_sensor)
    block = perfect_imu(twin, "/foot_r/imu", rate_hz).read(track, track.t_ns)
    v, p, R = velocity_path_attitude(block.columns["angular_rate"], block.columns["specific_force"], sensor)
    np.testing.assert_allclose(v, sensor.v_body_in_world[-1], atol=1e-7)
    assert np.linalg.norm(p - sensor.p_body_in_world[-1]) < path_m  # the trapezoids of the velocity, at 120 Hz
    assert (R.inv() * sensor.rotation[-1]).magnitude() < 1e-7


def velocity_path_attitude(rate: Array, force: Array, sensor: Track) -> tuple[Array, Array, Rotation]:
    """Strapdown over all intervals, each with constant rate and force."""
    v, p, R = sensor.v_body_in_world[0], sensor.p_body_in_world[0], sensor.rotation[0]
    dt = np.diff(sensor.t_ns) * 1e-9
    for k in range(1, len(rate)):
        nodes, weights = np.polynomial.legendre.leggauss(5)
        rotated = (R * Rotation.from_rotvec(np.outer((nodes + 1) / 2, rate[k] * dt[k - 1]))).apply(force[k])
        v_next = v + (weights @ rotated / 2 + [0.0, 0.0, -9.81]) * dt[k - 1]
        p, v = p + (v + v_next) / 2 * dt[k - 1], v_next
        R = R * Rotation.from_rotvec(rate[k] * dt[k - 1])
    return v, p, R


def test_strikes_of_most_people_are_felt_beyond_8_g_at_1_khz() -> None:
    medians = []
    for seed in range(3, 8):  # some mounts are padded
        twin = Twin(CONFIG, seed)
        motion = twin.player().motion(every(twin, 1000.0))
        block = perfect_imu(twin, "/foot_l/imu", 1000.0).read(motion.uppers["foot_l"], motion.t_ns)
        force = np.linalg.norm(block.columns["specific_force"], axis=1)
        peaks = [
            force[round(1000 * s.t_touch) : round(1000 * s.t_touch) + 80].max() / 9.81
            for s in twin.walk.steps["l"]
            if 0.0 < s.t_touch < twin.duration_s - 2.0
        ]
        assert max(peaks) < 60.0
        assert np.std(peaks) > 0.3  # no two strikes are alike
        medians.append(np.median(peaks))
    assert np.median(medians) > 8.0


def test_feet_that_stand_sway_a_little(twin: Twin) -> None:
    imu = twin.rig.imu("/foot_l/imu")
    t = every(twin, 200.0, 0.0, 1.5)
    sensor = twin.player().motion(t).uppers["foot_l"].to_sensor(imu.mount.T_body_sensor)
    rate = np.sqrt((sensor.w_body**2).sum(1).mean())
    assert 0.003 < rate < 0.1
    assert np.linalg.norm(sensor.w_body.mean(0)) < rate  # it turns back


def test_a_shoe_in_stance_is_not_perfectly_still(twin: Twin) -> None:
    imu = twin.rig.imu("/foot_l/imu")
    sensor = twin.player().motion(every(twin, 500.0)).uppers["foot_l"].to_sensor(imu.mount.T_body_sensor)
    speed, t = np.linalg.norm(sensor.v_body_in_world, axis=1), sensor.t_ns * 1e-9
    slowest = [
        speed[(t > s.t_touch + 0.15) & (t < s.t_off - 0.15)].min()
        for s in twin.walk.steps["l"]
        if 0.0 < s.t_touch < twin.duration_s - 2.0
    ]
    assert 1e-3 < np.median(slowest) < 25e-3


def test_camera_and_board_ride_on_the_same_upper(twin: Twin) -> None:
    """What a camera's own shoe looks like to it does not change; the board that the other one sees moves."""
    t_ns = every(twin, 200.0, 3.0, 4.0)
    motion = twin.player().motion(t_ns)
    pose = motion.upper_poses(np.arange(len(t_ns)))["foot_l"]
    foot, upper = motion.tracks["foot_l"], motion.uppers["foot_l"]
    model, data = copy.copy(twin.model), mujoco.MjData(twin.model)
    i = int(np.abs(pose[:, :3]).sum(axis=1).argmax())
    body = model.body("upper_l")
    body.pos, body.quat = pose[i, :3], pose[i, 3:]
    data.qpos = motion.qpos[i]
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body("upper_l").xpos, upper.p_body_in_world[i], atol=1e-9)
    np.testing.assert_allclose(data.body("upper_l").xmat.reshape(3, 3), upper.rotation[i].as_matrix(), atol=1e-9)
    assert np.linalg.norm(upper.p_body_in_world[i] - foot.p_body_in_world[i]) > 1e-4


def test_insoles_lie_under_the_foot_and_not_on_the_upper() -> None:
    walk = TwinConfig(name="loads", route=Route(segments=(Level(length_m=1.2),)), sensors=("insole",), exo=None)
    forces = [
        np.concatenate(
            [
                b.columns["force"]
                for blocks in Twin(replace(walk, shock=shock), 3).blocks()
                for b in blocks
                if isinstance(b, Block) and b.topic == "/foot_l/insole"
            ]
        )
        for shock in (True, False)
    ]
    np.testing.assert_array_equal(*forces)


def test_a_seed_fixes_it(twin: Twin) -> None:
    t_ns = every(twin, 200.0, 3.0, 5.0)
    again = Twin(CONFIG, 3).player().motion(t_ns).uppers["foot_l"]
    np.testing.assert_array_equal(again.p_body_in_world, twin.player().motion(t_ns).uppers["foot_l"].p_body_in_world)


@settings(max_examples=50, deadline=None)
@given(hz=st.floats(10, 150), decay=st.floats(0.005, 0.08), phase=st.floats(0, 6.28))
def test_a_mode_begins_without_a_jump_and_dies(hz: float, decay: float, phase: float) -> None:
    tau = np.linspace(0.0, 10 * decay, 20001)
    value, rate = vibration(tau, hz, decay, phase)
    np.testing.assert_allclose(np.gradient(value, tau)[1:-1], rate[1:-1], atol=0.02 * abs(rate).max())
    assert value[0] == rate[0] == 0.0
    assert abs(rate[1]) < 0.02 * abs(rate).max()  # no jump of velocity, and none of force
    assert abs(value[-1]) < 1e-4


def test_the_table_holds_what_its_docstring_says() -> None:
    modes, rocks = len(SHOE.mode_hz), len(SHOE.rock_hz)
    assert SHOE.mode_decay_s.shape == (modes,)
    assert SHOE.mode_force.shape == SHOE.mode_rate.shape == (modes, 3)
    assert SHOE.rock_rate.shape == (rocks, 3)
    assert SHOE.mode_hz.max() < 102.4  # nothing beyond what the recording holds


def test_a_shoe_rolls_over_the_ground_from_heel_to_ball_without_slip() -> None:
    """The point that touches the ground has no speed while it moves forward, and nothing is left at the end."""
    still = replace(SHOE, rock_rate=0.0 * SHOE.rock_rate, settle_rad=np.zeros(3), settle_sd_rad=np.zeros(3), snap=0.0)
    shoe = replace(
        still,
        mode_force=0.0 * SHOE.mode_force,
        mode_rate=0.0 * SHOE.mode_rate,
        sway_rate=0.0 * SHOE.sway_rate,
        roll_rad=np.array([0.0, 0.03, 0.0]),
        roll_sd=0.0,
        give_sd_m=np.zeros(3),
    )
    pivot = np.array([0.11, 0.0, 0.085])
    stance = stand_from_zero(0.65)
    upper = UpperMotion.of(
        [stance], lambda t: np.zeros(len(t)), lambda t: np.ones(len(t)), pivot, np.random.default_rng(0), shoe
    )
    t = np.linspace(0.0, 0.65, 651)
    moved, turned, v, w = upper.at(t)
    assert w[325, 1] == pytest.approx(1.875 * 0.03 / 0.65, rel=1e-6)
    np.testing.assert_allclose(np.gradient(moved, t, axis=0)[1:-1], v[1:-1], atol=1e-4)
    np.testing.assert_allclose(np.gradient(turned, t, axis=0)[1:-1], w[1:-1], atol=1e-3)
    assert np.abs([moved[[0, -1]], turned[[0, -1]]]).max() < 1e-12
    contact_m = np.interp(turned[:, 1] / 0.03, (0.0, 1.0), SHOE.roll_m)  # forward in the foot's frame
    arm = np.column_stack([contact_m, np.zeros((len(t), 2))]) - pivot
    while_it_rolls = t < 0.55
    np.testing.assert_allclose((v + np.cross(w, arm))[while_it_rolls], 0.0, atol=1e-9)


def test_a_landing_has_settled_by_the_middle_of_a_runners_stance() -> None:
    """Runners have an instant of rest, as recorded ones do: what settles takes a share of the stance, not a time."""
    none = np.zeros(3)
    shoe = replace(
        SHOE,
        mode_force=0.0 * SHOE.mode_force,
        mode_rate=0.0 * SHOE.mode_rate,
        rock_rate=0.0 * SHOE.rock_rate,
        sway_rate=0.0 * SHOE.sway_rate,
        settle_sd_rad=none,
        give_sd_m=none,
        snap=0.0,
    )
    turned = {}
    for lasting in (0.61, 0.30, 0.20):
        stance = stand_from_zero(lasting)
        upper = UpperMotion.of(
            [stance],
            lambda t: np.zeros(len(t)),
            lambda t: np.ones(len(t)),
            np.array([0.11, 0.0, 0.085]),
            np.random.default_rng(0),
            shoe,
        )
        t = np.linspace(0.0, lasting, 2001)
        moved, rotation, v, w = upper.at(t)
        np.testing.assert_allclose(np.gradient(rotation, t, axis=0)[1:-1], w[1:-1], atol=2e-2)
        np.testing.assert_allclose(np.gradient(moved, t, axis=0)[1:-1], v[1:-1], atol=2e-3)
        assert np.abs(w[t > 0.4 * lasting]).max() < 1e-12
        turned[lasting] = np.abs(rotation).max()
    assert turned[0.61] == pytest.approx(0.075)
    assert turned[0.30] == pytest.approx(0.075 * 0.30 / 0.61, rel=1e-3)
    assert turned[0.20] < turned[0.30]
