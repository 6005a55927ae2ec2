"""The walk itself: on the ground, without slip, within human ranges, dynamically consistent."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest

from benchmarks import gait
from stridetwin.sim.config import Gait, Level, Person, Ramp, Route, Segment, Stairs, Turn, TwinConfig
from stridetwin.sim.gait.footsteps import Footstep
from stridetwin.sim.playback import Playback, split_wrench
from stridetwin.sim.truth import CONTACT, FLAT, HEEL_OFF, SWING, foot_phase
from stridetwin.sim.twin import Twin
from stridetwin.streams.algebra.arrays import from_quaternion, rot_y
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.way import Way

ROUTES: dict[str, tuple[Segment, ...]] = {
    "level": (Level(length_m=6.0),),
    "stairs": (
        Level(length_m=2.5),
        Stairs(risers=4),
        Level(length_m=2.0),
        Stairs(risers=4, down=True),
        Level(length_m=2.0),
    ),
    "winding": (
        Level(length_m=2.5),
        Stairs(risers=6, tread_m=0.28, turn_rad=np.radians(90.0)),
        Level(length_m=2.0),
        Stairs(risers=8, tread_m=0.26, down=True, turn_rad=np.radians(-150.0)),
        Level(length_m=2.0),
    ),
    "ramp": (
        Level(length_m=2.5),
        Ramp(angle_rad=np.radians(8.5), rise_m=0.4),
        Level(length_m=2.0),
        Ramp(angle_rad=np.radians(8.5), rise_m=0.4, down=True),
        Level(length_m=2.5),
    ),
    "arc": (Level(length_m=2.0), Turn(angle_rad=np.radians(-200.0), radius_m=1.5), Level(length_m=1.5)),
    "spot": (
        Level(length_m=1.5),
        Turn(angle_rad=np.radians(90.0), radius_m=0.0),
        Level(length_m=1.5),
        Turn(angle_rad=np.radians(-180.0), radius_m=0.0),
        Level(length_m=1.5),
    ),
    "aslant": (Level(length_m=1.5), Level(length_m=3.0, cross_slope_rad=np.radians(5.0)), Level(length_m=1.5)),
    "aslant_ramp": (Level(length_m=1.5), Ramp(angle_rad=0.1, rise_m=0.3, cross_slope_rad=0.07), Level(length_m=1.5)),
}


def make(name: str, seed: int = 7, person: Person | None = None, gait_of: Gait | None = None) -> Twin:
    config = TwinConfig(
        name=name,
        route=Route(segments=ROUTES[name], width_m=0.9 if name == "winding" else Route.width_m),
        sensors=(),
        person=person or Person(),
        gait=gait_of or Gait(),
    )
    return Twin(config, seed)


@cache
def usual(name: str) -> Twin:
    return make(name)


@pytest.fixture(scope="module", params=list(ROUTES))
def twin(request: pytest.FixtureRequest) -> Twin:
    return usual(request.param)


def test_no_foot_goes_through_the_ground(twin: Twin) -> None:
    assert max(gait.penetration(twin, side) for side in "lr") < 0.005


def test_stance_does_not_slip(twin: Twin) -> None:
    assert max(gait.slip(twin, side) for side in "lr") < 0.002


@pytest.mark.parametrize("riser_m", [0.12, 0.22])
def test_a_foot_crosses_a_short_summit_without_a_leap(riser_m: float) -> None:
    """From a tread over one higher, the riser stands right before the toes; a bump would lift the foot by a metre."""
    up = Stairs(risers=3, riser_m=riser_m)
    segments = (Level(length_m=2.0), up, Level(length_m=0.3), replace(up, down=True), Level(length_m=2.0))
    twin = Twin(TwinConfig(name="summit", route=Route(segments=segments), sensors=()), 1000)
    top = max(float(path.p_foot_in_world[:, 2].max()) for path in twin.reference.paths.values())
    assert 3.0 * riser_m < top < 3.0 * riser_m + 0.25


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("stairs_first", [False, True])
def test_a_ramp_begins_and_ends_at_a_stair_without_a_landing(down: bool, stairs_first: bool) -> None:
    pair = [Stairs(risers=3, down=down), Ramp(angle_rad=np.radians(6.0), rise_m=0.3, down=down)]
    segments = (Level(length_m=2.0), *(pair if stairs_first else pair[::-1]), Level(length_m=2.0))
    twin = Twin(TwinConfig(name="joined", route=Route(segments=segments), sensors=()), 7)
    assert max(gait.penetration(twin, side) for side in "lr") < 0.005
    assert max(gait.slip(twin, side) for side in "lr") < 0.002


def test_joints_stay_in_human_ranges_and_knees_never_bend_backwards(twin: Twin) -> None:
    for joint, (low, high) in gait.HUMAN_DEG.items():
        least, most = gait.joint_range_deg(twin, joint)
        assert low <= least, joint
        assert most <= high, joint


def test_soles_lie_wholly_on_one_tread(twin: Twin) -> None:
    """Down stairs the heel keeps off the riser behind it, for which the tip of the toes may reach over the edge.

    Where the stair winds, the treads are shorter than the inner foot: its heel or its toes reach over the edge.
    """
    shoe, winding = twin.size.shoe, twin.config.name == "winding"
    for side in "lr":
        for step in twin.reference.steps[side]:
            w, heel, toe = shoe.half_width, shoe.heel_back_x, shoe.toe_tip_x
            if step.terrain == "stair" and step.mode == "SD":
                toe -= 0.08 if winding else 0.010
            if step.terrain == "stair" and step.mode == "SA" and winding:
                heel += 0.06
            corners = np.array([[x, y, 0.0] for x in (heel, toe) for y in (-w, w)])
            sole = step.p_foot_in_world + corners @ step.R_world_sole.T
            assert set(twin.terrain.terrain_class(sole[:, :2])) == {step.terrain}
            np.testing.assert_allclose(twin.terrain.height(sole[:, :2]), sole[:, 2], atol=1e-9)


def test_feet_turn_with_the_way_in_steps_that_people_make(twin: Twin) -> None:
    way, steps = (
        twin.terrain.layout.way,
        sorted((s for own in twin.reference.steps.values() for s in own), key=lambda s: s.t_touch),
    )
    turns = np.abs(np.diff([s.heading for s in steps]))
    assert np.degrees(turns.max()) < 45.0
    for step in steps:
        assert step.heading == way.heading(step.s)
        assert 0.03 < (1 if step.foot == "l" else -1) * _left_of(way, step) < 0.12


def _left_of(way: Way, step: Footstep) -> float:
    """M that a footprint lies to the left of the way."""
    away = step.p_foot_in_world[:2] - way.point(step.s)
    return float(away @ [-np.sin(step.heading), np.cos(step.heading)])


def test_feet_pass_each_other_without_touching(twin: Twin) -> None:
    motion, shoe = gait.motion_at(twin, np.arange(0.0, twin.duration_s, 0.01)), twin.size.shoe
    outline = [[x, y, 0.0] for x in np.linspace(shoe.heel_back_x, shoe.toe_tip_x, 8) for y in (-1, 0, 1)]
    local = np.array(outline) * [1.0, shoe.half_width, 1.0]
    left, right = (
        track.p_body_in_world[:, None] + local @ np.swapaxes(from_quaternion(track.q_world_body), 1, 2)
        for track in (motion.tracks["foot_l"], motion.tracks["foot_r"])
    )
    assert np.linalg.norm(left[:, :, None] - right[:, None], axis=-1).min() > 0.015


def test_the_head_turns_into_a_curve_before_the_pelvis() -> None:
    twin = usual("arc")
    motion = gait.motion_at(twin, np.arange(0.0, twin.duration_s, 0.01))
    names = twin.reference.coordinates.names
    columns = twin.reference.splines(np.arange(0.0, twin.duration_s, 0.01))
    pelvis = columns[:, names.index("root_yaw")]
    assert np.abs(np.diff(pelvis)).max() < 0.05  # continuous beyond half a turn
    assert pelvis[-1] == pytest.approx(np.radians(-200.0), abs=0.02)
    R = from_quaternion(motion.tracks["head"].q_world_body)
    head = np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    middle = [int(np.argmax(yaw < np.radians(-100.0))) for yaw in (head, pelvis)]
    assert 0.1 < 0.01 * (middle[1] - middle[0]) < 0.8


def test_down_stairs_lands_on_the_forefoot() -> None:
    pitches = gait.landing_pitch_deg(usual("stairs"), "SD")
    assert len(pitches) == 4
    assert min(pitches) >= 15
    assert max(pitches) <= 35


def test_down_stairs_the_pressure_starts_at_the_toes_and_goes_back_as_the_heel_comes_down() -> None:
    twin = usual("stairs")
    playback, weight = Playback(twin.model, twin.reference), 9.81 * float(twin.model.body_subtreemass[0])
    for side in "lr":
        for step in (s for s in twin.reference.steps[side] if (s.mode, s.departure) == ("SD", "lower")):
            t_ns = np.round(1e9 * np.linspace(step.t_touch, step.t_off, 100)).astype(np.int64)
            load = playback.loads(t_ns, playback.motion(t_ns)).feet[side]
            x = ((load.cop - step.p_foot_in_world) @ step.R_world_sole)[:, 0]
            pressed, pitch = load.force[:, 2] > 0.2 * weight, twin.reference.pitch(side, t_ns * 1e-9)
            lowering = pressed & (pitch > np.radians(5.0)) & (np.arange(100) < 30)
            assert np.median(x[lowering]) > 0.18
            flat = slice(25, 50)
            assert 0.055 < x[flat].min() < 0.10
            assert x[60:90].min() > 0.13


@pytest.mark.parametrize("seed", [7, 8])
def test_down_stairs_the_foot_lies_flat_and_still_for_a_quarter_of_stance(seed: int) -> None:
    """From about 25 % of stance, when the heel has come down, until the ankle has no more room."""
    twin = make("stairs", seed)
    lowering = [s for own in twin.reference.steps.values() for s in own if (s.mode, s.departure) == ("SD", "lower")]
    assert len(lowering) == 3
    for step in lowering:
        stance = step.t_off - step.t_touch
        t = np.linspace(step.t_touch, step.t_off, 400)
        track = gait.motion_at(twin, t).tracks[f"foot_{step.foot}"]
        still = np.linalg.norm(track.w_body, axis=1) < 0.02
        still &= np.linalg.norm(track.v_body_in_world, axis=1) < 0.001
        rows = np.flatnonzero(still)
        longest = max(np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1), key=len)
        first, last = (t[longest[[0, -1]]] - step.t_touch) / stance
        assert first < 0.27
        assert last - first >= 0.25
        assert (last - first) * stance >= 0.2
        np.testing.assert_allclose(
            track.p_body_in_world[longest], np.broadcast_to(step.p_foot_in_world, (len(longest), 3)), atol=2e-4
        )


def test_modes_follow_the_terrain() -> None:
    modes = {}
    for name in ("stairs", "ramp"):
        modes[name] = [step.mode for own in usual(name).reference.steps.values() for step in own]
    assert modes["stairs"].count("SA") == 4
    assert modes["stairs"].count("SD") == 4
    assert set(modes["ramp"]) == {"LG", "RA", "RD"}
    for side in "lr":
        for step in usual("ramp").reference.steps[side]:
            assert step.mode == {0: "LG", 1: "RA", -1: "RD"}[np.sign(step.slope)]


@pytest.mark.parametrize(("riser_m", "modes"), [(0.06, {"LG"}), (0.08, {"LG", "SA", "SD"})])
def test_risers_of_seven_centimetres_are_stairs(riser_m: float, modes: set[str]) -> None:
    flights = (Stairs(risers=3, riser_m=riser_m), Level(length_m=1.5), Stairs(risers=3, riser_m=riser_m, down=True))
    route = Route(segments=(Level(length_m=1.5), *flights, Level(length_m=1.5)))
    steps = Twin(TwinConfig(name="low", route=route, sensors=()), 7).reference.steps
    assert {step.mode for own in steps.values() for step in own} == modes


def test_walk_starts_and_ends_in_standing(twin: Twin) -> None:
    _, v, a = twin.reference.state(np.array([0.0, 0.2, twin.duration_s - 0.2, twin.duration_s]))
    assert np.abs(v).max() < 0.02
    assert np.abs(a).max() < 0.2
    for side in "lr":
        assert foot_phase(twin.reference, side, np.array([0.0, twin.duration_s])).tolist() == [FLAT, FLAT]


def test_the_phases_of_a_level_step_follow_each_other_from_heel_to_toe() -> None:
    assert (SWING, CONTACT, FLAT, HEEL_OFF) == (0, 1, 2, 3)  # as in a recording
    walk = usual("level").reference
    for side in "lr":
        for step, after in zip(walk.steps[side][1:-1], walk.steps[side][2:]):
            phase = foot_phase(walk, side, np.linspace(step.t_touch, after.t_touch, 200, endpoint=False))
            assert phase[np.flatnonzero(np.diff(phase, prepend=-1))].tolist() == [CONTACT, FLAT, HEEL_OFF, SWING]


def test_contact_forces_carry_the_motion_within_the_soles(twin: Twin) -> None:
    """The wrench of inverse dynamics comes back from the feet, and each centre of pressure lies in its sole."""
    playback = Playback(twin.model, twin.reference)
    t_ns = np.arange(0, int(twin.duration_s * 1e9), 10_000_000)
    motion = playback.motion(t_ns)
    loads = playback.loads(t_ns, motion)
    weight = float(twin.model.body_subtreemass[0]) * 9.81
    assert np.abs(loads.residual_force).max() < 1e-6 * weight
    assert np.quantile(np.abs(loads.residual_torque), 0.99) < 0.002 * weight
    total = sum(load.force[:, 2] for load in loads.feet.values())
    assert abs(total.mean() / weight - 1.0) < 0.02
    for side, load in loads.feet.items():
        strong = load.force[:, 2] > 0.2 * weight
        track = motion.tracks[f"foot_{side}"]
        R = from_quaternion(track.q_world_body)
        local = np.einsum("nji,nj->ni", R, load.cop - track.p_body_in_world)[strong]
        shoe = twin.size.shoe
        inside = (local[:, 0] > shoe.heel_back_x - 0.005) & (local[:, 0] < shoe.toe_tip_x + 0.005)
        assert (inside & (np.abs(local[:, 1]) < shoe.half_width)).mean() > 0.98


def test_reference_agrees_with_its_own_derivatives(twin: Twin) -> None:
    t = np.linspace(0.5, twin.duration_s - 0.5, 40)
    h = 1e-5
    _, v, a = twin.reference.state(t)
    q0, v0, _ = twin.reference.state(t - h)
    q1, v1, _ = twin.reference.state(t + h)
    dq = np.empty(twin.model.nv)
    for i in range(len(t)):
        mujoco.mj_differentiatePos(twin.model, dq, 2 * h, q0[i], q1[i])
        assert np.allclose(dq, v[i], atol=1e-5)
    assert np.allclose((v1 - v0) / (2 * h), a, atol=1e-3)


def test_same_seed_same_walk_other_seed_other_steps() -> None:
    one, two, three = make("level", 3), make("level", 3), make("level", 4)
    t = np.linspace(0, one.duration_s, 200)
    assert np.array_equal(one.reference.splines(t), two.reference.splines(t))
    assert one.duration_s != three.duration_s


@pytest.mark.parametrize(
    "person", [Person(height_m=1.50, mass_kg=45, sex="female"), Person(height_m=1.95, mass_kg=110)]
)
def test_small_and_tall_people_walk_stairs(person: Person) -> None:
    twin = make("stairs", person=person)
    t = np.arange(0.0, twin.duration_s, 0.01)
    knee = [i for i, n in enumerate(twin.reference.coordinates.names) if n.startswith("knee_flexion")]
    assert twin.reference.splines(t)[:, knee].min() > 0.0
    body = sum(twin.model.body_mass[b] for b in range(twin.model.nbody)) - 9.5
    assert body == pytest.approx(person.mass_kg, rel=2e-3)


@pytest.mark.parametrize(("walk", "text"), [(Gait(speed_mps=3.0), "speed_mps"), (Gait(speed_mps=0.04), "0.05-2.1")])
def test_speed_out_of_range_is_refused_with_the_range(walk: Gait, text: str) -> None:
    with pytest.raises(StrideTwinError, match=text):
        make("level", gait_of=walk)


def test_shared_load_balances_any_wrench() -> None:
    rng = np.random.default_rng(0)
    n = 50
    force = rng.normal(0, 50, (n, 3)) + [0, 0, 800.0]
    torque, origin = rng.normal(0, 30, (n, 3)), rng.normal(0, 1, (n, 3)) + [0, 0, 1.0]
    share = rng.uniform(0.1, 0.9, n)
    planned = {"l": rng.normal(0, 0.2, (n, 3)), "r": rng.normal(0, 0.2, (n, 3))}
    feet = {"l": rng.normal(0, 0.2, (n, 3)), "r": rng.normal(0, 0.2, (n, 3))}
    loads, left_force, left_torque = split_wrench(force, torque, origin, {"l": share, "r": 1 - share}, planned, feet)
    assert np.abs(left_force).max() < 1e-9
    total = sum(load.torque + np.cross(feet[f] - origin, load.force) for f, load in loads.items())
    assert np.allclose(total + left_torque, torque, atol=1e-9)
    # the feet may stand at two heights, so a sideways force leaves a small moment; on one plane none is left
    flat = {f: p * [1, 1, 0] for f, p in planned.items()}
    *_, rest = split_wrench(force, torque, origin, {"l": share, "r": 1 - share}, flat, feet)
    assert np.abs(rest).max() < 1e-9


def test_rotation_convention_pitch_is_nose_down() -> None:
    assert rot_y(np.array(0.3))[2, 0] < 0
