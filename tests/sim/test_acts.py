"""What a wearer does on the way beside walking on: places of the feet, bounds of benchmarks.gait, refused values."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest

from benchmarks import gait
from stridetwin.sim.acts import Backwards, Hesitate, HoldRail, LookBack, Pivot, ShuffleInPlace, SideStep, StepAside
from stridetwin.sim.config import Exo, Gait, Level, Route, Stairs, Stop, Turn, TwinConfig
from stridetwin.sim.gait.footsteps import Footstep
from stridetwin.sim.twin import Twin
from stridetwin.sim.world.rails import Rail
from stridetwin.streams.algebra.arrays import from_quaternion
from stridetwin.streams.errors import ConfigError

LEVEL = TwinConfig(name="acts", route=Route(segments=(Level(length_m=8.0),)), exo=None, sensors=())
WALKS: dict[str, TwinConfig] = {
    "side steps": replace(
        LEVEL,
        gait=Gait(acts=(SideStep(at_m=1.8, left_m=0.5, for_s=0.6), StepAside(at_m=4.0, left_m=-0.4, for_s=1.0))),
    ),
    "backwards": replace(
        LEVEL,
        route=Route(segments=(Level(length_m=5.0),)),
        gait=Gait(acts=(Backwards(at_m=2.5, for_m=1.6, for_s=1.0),)),
    ),
    "backwards over edges": replace(
        LEVEL,
        route=Route(
            segments=(
                Level(length_m=2.5),
                Stairs(risers=2, riser_m=0.16),
                Level(length_m=3.5),
                Stairs(risers=1, riser_m=0.15, down=True),
                Level(length_m=3.0),
            )
        ),
        gait=Gait(acts=(Backwards(at_m=3.4, for_m=1.6), Backwards(at_m=7.0, for_m=1.0))),
    ),
    "hesitation": replace(
        LEVEL,
        route=Route(segments=(Level(length_m=8.5), Stairs(risers=2, down=True), Level(length_m=2.5))),
        gait=Gait(
            acts=(
                Hesitate(at_m=1.8, how="hover", for_s=0.7),
                Hesitate(at_m=3.6, how="retrace", for_s=0.8),
                Hesitate(at_m=5.2, how="slow", for_s=0.5),
                Hesitate(at_m=6.5, how="half_steps"),
                Hesitate(at_m=8.6, how="retrace", for_s=0.5),
            )
        ),
    ),
    "looks": replace(
        LEVEL,
        gait=Gait(
            acts=(
                LookBack(at_m=1.2, head_rad=np.radians(80.0)),
                ShuffleInPlace(at_m=4.0, for_s=2.5),
                LookBack(at_m=6.0, to="right", standing=True, head_rad=np.radians(85.0), for_s=1.2),
            )
        ),
    ),
    "rails": replace(
        LEVEL,
        route=Route(
            segments=(
                Level(length_m=2.5),
                Stairs(risers=5),
                Level(length_m=3.0),
                Stairs(risers=4, down=True),
                Level(length_m=2.5),
            )
        ),
        gait=Gait(acts=(HoldRail(at_m=2.1, for_m=2.0), HoldRail(at_m=6.2, for_m=1.9, side="left"))),
    ),
    "pivots": replace(
        LEVEL,
        gait=Gait(acts=(Pivot(at_m=2.0, angle_rad=np.pi), Pivot(at_m=5.0, angle_rad=-np.pi / 2))),
    ),
}


@pytest.fixture(scope="module")
def twins() -> dict[str, Twin]:
    return {name: Twin(config, 3) for name, config in WALKS.items()}


def in_order(twin: Twin) -> list[Footstep]:
    steps = [s for side in twin.reference.steps.values() for s in side if np.isfinite(s.t_touch)]
    return sorted(steps, key=lambda s: s.t_touch)


def left_of(steps: list[Footstep]) -> np.ndarray:
    """(N,) m, middle between the feet to the left of a straight way, from places of the feet."""
    return np.array([s.p_foot_in_world[1] - (0.06 if s.foot == "l" else -0.06) for s in steps])


@pytest.mark.parametrize("name", list(WALKS))
def test_feet_stay_on_the_ground_and_joints_in_human_ranges(twins: dict[str, Twin], name: str) -> None:
    twin = twins[name]
    assert 1e3 * max(gait.penetration(twin, side) for side in "lr") < gait.ALLOWED["penetration_mm"]
    assert 1e3 * max(gait.slip(twin, side) for side in "lr") < gait.ALLOWED["slip_mm"]
    for joint, (low, high) in gait.HUMAN_DEG.items():
        least, most = gait.joint_range_deg(twin, joint)
        assert low - 4.0 <= least, joint
        assert most <= high + 5.0, joint


@pytest.mark.parametrize("name", list(WALKS))
def test_motion_is_smooth_to_the_second_derivative(twins: dict[str, Twin], name: str) -> None:
    twin = twins[name]
    # the largest change of an acceleration shrinks with the time between two instants: it does not jump
    changes = []
    for dt in (2e-3, 2.5e-4):
        a = twin.walk.splines(np.arange(0.0, twin.duration_s, dt), 2)
        changes.append(np.abs(np.diff(a, axis=0)).max(axis=0))
    moves = changes[0] > 1e-3
    assert np.all(changes[1][moves] < 0.35 * changes[0][moves])


@pytest.mark.parametrize("name", list(WALKS))
def test_feet_alternate_and_one_is_always_on_the_ground(twins: dict[str, Twin], name: str) -> None:
    steps = in_order(twins[name])
    assert [s.foot for s in steps] == ["r", "l"] * (len(steps) // 2) + ["r"] * (len(steps) % 2)
    for before, after in pairwise(steps):
        assert before.t_off > after.t_touch


def test_side_steps_lead_with_the_foot_on_that_side_and_stay_there(twins: dict[str, Twin]) -> None:
    steps = in_order(twins["side steps"])
    left = left_of(steps)
    assert left[:3] == pytest.approx(np.zeros(3), abs=0.02)
    first = int(np.flatnonzero(np.abs(left) > 0.1)[0])
    assert steps[first].foot == "l"
    assert left[first : first + 4] == pytest.approx([0.25, 0.25, 0.5, 0.5], abs=0.02)
    assert {s.s for s in steps[first - 1 : first + 4]} == {steps[first].s}
    assert steps[first].s == pytest.approx(1.8, abs=1.0)
    assert left[first + 4] == pytest.approx(0.5, abs=0.02)
    assert all(s.mode == "LG" for s in steps)


def test_who_steps_aside_comes_back(twins: dict[str, Twin]) -> None:
    steps = in_order(twins["side steps"])
    left = left_of(steps)
    aside = [i for i, s in enumerate(steps) if s.pause_s == 1.0]
    assert len(aside) == 1
    assert left[aside[0]] == pytest.approx(0.1, abs=0.02)
    assert left[-1] == pytest.approx(0.5, abs=0.02)
    # the feet never cross
    for before, after in pairwise(steps[aside[0] :]):
        apart = (after.p_foot_in_world - before.p_foot_in_world)[1] * (1.0 if after.foot == "l" else -1.0)
        assert apart > 0.08


def test_backwards_as_far_as_asked_and_forwards_again(twins: dict[str, Twin]) -> None:
    steps = in_order(twins["backwards"])
    s = np.array([step.s for step in steps])
    turn, back = int(np.argmax(np.diff(s) < 0.0)), np.diff(s) < -1e-9
    assert s[turn] - s.min(where=np.arange(len(s)) > turn, initial=np.inf) == pytest.approx(1.6, abs=0.02)
    assert np.all(np.abs(np.diff(s)[back]) < 0.45)
    # toes touch down first, and the heel leaves last
    walk = twins["backwards"].walk
    touching = [walk.pitch(step.foot, np.array([step.t_touch]))[0] for step in steps if step.arrival == "toe"]
    leaving = [walk.pitch(step.foot, np.array([step.t_off]))[0] for step in steps if step.departure == "back"]
    assert len(touching) == len(leaving) == back.sum() + 1
    assert min(touching) > 0.15
    assert max(leaving) < -0.08
    assert s[-1] == pytest.approx(5.0, abs=0.01)


def test_backwards_over_edges_is_labelled_by_the_direction_of_the_riser(twins: dict[str, Twin]) -> None:
    modes = [step.mode for step in in_order(twins["backwards over edges"])]
    over = [mode for mode in modes if mode != "LG"]
    # up two risers, back down two, up again; down the kerb, back up, down again
    assert over == ["SA", "SA", "SD", "SD", "SA", "SA", "SD", "SA", "SD"]


def foot_way(twin: Twin, before: Footstep, step: Footstep) -> tuple[np.ndarray, np.ndarray]:
    """(N,) s in a swing, and (N,) m that the foot has gone in it along a straight way."""
    t = np.linspace(before.t_off, step.t_touch, 400)
    x = np.interp(t, twin.reference.grid, twin.reference.paths[step.foot].p_foot_in_world[:, 0])
    return t, x - x[0]


def test_hesitating_feet_hover_or_go_back(twins: dict[str, Twin]) -> None:
    twin = twins["hesitation"]
    pairs = [(a, b) for steps in twin.reference.steps.values() for a, b in pairwise(steps)]
    found = {b.hesitation.how + b.mode: foot_way(twin, a, b) for a, b in pairs if b.hesitation is not None}
    assert set(found) == {"hoverLG", "retraceLG", "slowLG", "retraceSD"}
    usual_s = np.median([b.t_touch - a.t_off for a, b in pairs if b.hesitation is None and b.s < 5.0])
    for name, longer in (("hoverLG", 0.7), ("retraceLG", 0.8), ("slowLG", 0.5)):
        t, _ = found[name]
        assert t[-1] - t[0] == pytest.approx(usual_s + longer, abs=0.12)
    t, x = found["hoverLG"]
    assert np.sum(np.abs(np.gradient(x, t)) < 0.03) * (t[1] - t[0]) > 0.3
    _, x = found["retraceLG"]
    assert (np.maximum.accumulate(x) - x).max() > 0.1


def test_half_steps_are_half_as_long(twins: dict[str, Twin]) -> None:
    s = np.array([step.s for step in in_order(twins["hesitation"])])
    lengths = np.diff(s)
    assert np.sum((lengths > 0.22) & (lengths < 0.36) & (s[1:] > 6.0) & (s[1:] < 8.0)) == 4


def test_head_turns_over_the_shoulder_and_back(twins: dict[str, Twin]) -> None:
    twin = twins["looks"]
    t = np.arange(0.0, twin.duration_s, 0.02)
    q = np.degrees(twin.walk.splines(t))
    yaw = sum(q[:, twin.walk.coordinates.names.index(name)] for name in ("lumbar_rotation", "neck_rotation"))
    looks = [step for step in in_order(twin) if step.look_back is not None]
    assert len(looks) == 2
    assert yaw[t < looks[1].t_touch].max() == pytest.approx(80.0, abs=8.0)
    assert yaw.min() == pytest.approx(-85.0, abs=8.0)
    assert np.abs(yaw[-50:]).max() < 8.0
    # neck and trunk stay within what people reach
    for name, limit in (("neck_rotation", 70.0), ("lumbar_rotation", 34.0)):
        assert np.abs(q[:, twin.walk.coordinates.names.index(name)]).max() < limit
    # the first look is walked through, the second one is watched standing
    assert looks[0].pause_s == 0.0
    assert looks[1].pause_s > 2.0


def test_shuffle_in_place_is_of_small_steps_on_the_spot(twins: dict[str, Twin]) -> None:
    steps = in_order(twins["looks"])
    shuffled = [step for step in steps if step.arrival == "flat"]
    assert 4 <= len(shuffled) <= 6
    assert np.ptp([step.s for step in shuffled]) < 0.08
    assert shuffled[-1].t_touch - shuffled[0].t_touch == pytest.approx(2.0, abs=0.8)


def test_hand_slides_along_the_rail_within_the_ranges_of_the_arm(twins: dict[str, Twin]) -> None:
    twin = twins["rails"]
    data, reference = mujoco.MjData(twin.model), twin.reference
    for act in twin.config.gait.acts:
        assert isinstance(act, HoldRail)
        rail, hand = Rail.along(act, twin.terrain.layout), twin.model.body(f"hand_{act.side[0]}").id
        bar = rail.points(np.arange(act.at_m - 0.3, act.at_m + act.for_m + 0.3, 0.005))
        on = np.flatnonzero((reference.progress(reference.grid) > act.at_m) & (reference.grid > 0.0))[0]
        times = reference.grid[on] + np.arange(0.6, 2.2, 0.1)
        places = []
        for pose in twin.walk.position_velocity(times)[0]:
            data.qpos = pose
            mujoco.mj_kinematics(twin.model, data)
            palm = data.xpos[hand] + data.xmat[hand].reshape(3, 3) @ np.array([0.0, 0.0, -0.075])
            away = np.linalg.norm(bar - palm, axis=1)
            assert away.min() < 0.02
            places.append(bar[away.argmin(), 0])
        assert np.all(np.diff(places) > 0.0)  # it only slides on
    names, t = twin.walk.coordinates.names, np.arange(0.0, twin.duration_s, 0.01)
    for joint in ("shoulder_flexion", "shoulder_abduction", "elbow_flexion", "lumbar_bending", "neck_bending"):
        for name in (n for n in names if n.startswith(joint)):
            q = twin.walk.splines(t)[:, names.index(name)]
            low, high = twin.model.joint(name).range
            assert low < q.min() <= q.max() < high, name


def test_rail_out_of_reach_is_refused() -> None:
    acts = (HoldRail(at_m=2.0, for_m=3.0, away_m=0.5, height_m=0.8),)
    with pytest.raises(ConfigError, match=r"acts.away_m: invalid 0.5.*the hand misses the rail by .* mm"):
        Twin(replace(LEVEL, gait=Gait(acts=acts)), 0)


def test_pivots_turn_in_two_steps_and_back_within_the_hips_range(twins: dict[str, Twin]) -> None:
    twin = twins["pivots"]
    steps = in_order(twin)
    first = next(i for i, step in enumerate(steps) if step.arrival == "ball")
    assert [np.degrees(step.heading) for step in steps[first - 1 : first + 5]] == pytest.approx(
        [0.0, 180.0, 180.0, 360.0, 360.0, 360.0]
    )
    assert steps[first].foot == "l"
    # half a turn and on by as much ends at the place of before
    assert steps[first + 3].p_foot_in_world == pytest.approx(steps[first - 1].p_foot_in_world, abs=0.04)
    assert steps[first + 1].t_touch - steps[first - 1].t_touch < 1.6
    turned = [step.heading - 2 * np.pi for step in steps[first + 4 :]]
    assert np.degrees(min(turned)) == pytest.approx(-90.0)
    assert turned[-1] == pytest.approx(0.0)
    t, names = np.arange(0.0, twin.duration_s, 0.01), twin.walk.coordinates.names
    for name in ("hip_rotation_l", "hip_rotation_r", "hip_adduction_l", "neck_rotation", "lumbar_rotation"):
        q = twin.walk.splines(t)[:, names.index(name)]
        low, high = twin.model.joint(name).range
        assert low < q.min() <= q.max() < high, name


def test_a_foot_turns_on_its_ball_with_the_heel_up(twins: dict[str, Twin]) -> None:
    twin = twins["pivots"]
    for step in (step for step in in_order(twin) if step.arrival == "ball"):
        t = np.arange(step.t_touch, step.t_touch + 0.9, 0.005)
        motion = gait.motion_at(twin, t).tracks[f"foot_{step.foot}"]
        R = from_quaternion(motion.q_world_body)
        yaw = np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
        turned = abs(yaw[-1] - yaw[0])
        assert turned > np.radians(45.0)
        turning = np.abs(np.gradient(yaw, t)) > np.radians(8.0)
        assert twin.walk.pitch(step.foot, t[turning]).min() > 5e-4
        ball = motion.p_body_in_world + R @ np.array([twin.size.shoe.toe_hinge_x, 0.0, twin.size.shoe.toe_hinge_z])
        assert np.ptp(ball, axis=0).max() < 5e-4


@pytest.mark.parametrize("name", list(WALKS))
def test_feet_and_shanks_keep_clear_of_each_other(twins: dict[str, Twin], name: str) -> None:
    twin = twins[name]
    tracks = gait.motion_at(twin, np.arange(0.0, twin.duration_s, 0.02)).tracks
    feet, shanks = [], []
    for side in "lr":
        foot, shank = tracks[f"foot_{side}"], tracks[f"shank_{side}"]
        R = from_quaternion(foot.q_world_body)
        along = np.linspace(-0.03, twin.size.shoe.toe_tip_x - 0.03, 12)
        feet.append(np.stack([foot.p_body_in_world + R @ np.array([x, 0.0, 0.03]) for x in along], 1))
        ankle = foot.p_body_in_world + R @ np.array([twin.size.ankle_x, 0.0, twin.size.body.ankle_height_m])
        share = np.linspace(0.0, 1.0, 12)[:, None]
        shanks.append(shank.p_body_in_world[:, None] + share * (ankle - shank.p_body_in_world)[:, None])
    for lines in (feet, shanks):
        # 2 x 37 mm are the half widths of two shoes
        assert np.linalg.norm(lines[0][:, :, None] - lines[1][:, None], axis=-1).min() > 0.08


def test_walk_without_acts_is_that_of_before() -> None:
    assert Gait().acts == ()
    steps = in_order(Twin(replace(LEVEL, route=Route(segments=(Level(length_m=2.0),))), 1))
    assert left_of(steps) == pytest.approx(np.zeros(len(steps)), abs=0.02)


def test_simulated_walker_steps_aside() -> None:
    acts = (StepAside(at_m=1.5, left_m=0.4, for_s=1.0),)
    route = Route(segments=(Level(length_m=4.0),))
    twin = Twin(replace(LEVEL, route=route, gait=Gait(acts=acts), physics="dynamic"), 1)
    assert twin.fell_at is None
    assert twin.duration_s == pytest.approx(twin.reference.duration_s, abs=2e-3)


@pytest.mark.parametrize(
    ("walk", "message"),
    [
        (
            Gait(acts=(SideStep(at_m=80.0, left_m=0.3),)),
            r"acts.at_m: invalid 80.*less than .* m, the length of the way",
        ),
        (Gait(acts=(SideStep(at_m=3.0, left_m=0.0),)), r"acts.left_m: invalid 0.*at least 0.05 m"),
        (Gait(acts=(SideStep(at_m=3.0, left_m=1.2),)), r"acts.left_m: invalid 1.2.*from the middle of the way"),
        (
            Gait(acts=(SideStep(at_m=3.0, left_m=0.3), SideStep(at_m=3.4, left_m=0.3))),
            r"acts.at_m: invalid 3.4.*at least 1 m after",
        ),
        (
            Gait(acts=(SideStep(at_m=3.0, left_m=0.3),), stops=(Stop(at_m=3.1, for_s=1.0),)),
            r"acts.at_m: invalid 3.1.*at least 1 m after",
        ),
        (Gait(acts=(Backwards(at_m=2.0, for_m=4.0),)), r"acts.for_m: invalid 4.*at most .* back to the start"),
        (Gait(acts=(Hesitate(at_m=7.9, how="half_steps"),)), r"acts.at_m: invalid 7.9.*amid a level"),
        (Gait(acts=(Pivot(at_m=3.0, angle_rad=0.5),)), r"acts.angle_deg: invalid 28.6.*at least 45"),
        (Gait(acts=(LookBack(at_m=3.0), LookBack(at_m=4.0))), r"acts.at_m: invalid 4.0.*look back before it is over"),
        (Gait(acts=(SideStep(at_m=3.0, left_m=0.3),), pattern="run"), r"acts.kind: invalid 'side_step'.*in a run"),
    ],
)
def test_impossible_acts_are_refused(walk: Gait, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Twin(replace(LEVEL, gait=walk), 0)


@pytest.mark.parametrize(
    ("change", "valid"), [({"physics": "dynamic"}, "physics kinematic"), ({"exo": Exo()}, "exo none")]
)
def test_pivots_that_cannot_be_are_refused(change: dict[str, object], valid: str) -> None:
    pivots = replace(LEVEL, gait=Gait(acts=(Pivot(at_m=3.0, angle_rad=3.0),)))
    with pytest.raises(ConfigError, match=rf"acts.kind: invalid 'pivot': expected {valid}"):
        Twin(replace(pivots, **change), 0)


def test_backwards_round_a_bend_is_refused() -> None:
    route = Route(segments=(Level(length_m=2.5), Turn(angle_rad=1.0, radius_m=2.0), Level(length_m=2.0)))
    acts = (Backwards(at_m=5.0, for_m=2.0),)
    with pytest.raises(ConfigError, match=r"acts.for_m: invalid 2.0.*straight"):
        Twin(replace(LEVEL, route=route, gait=Gait(acts=acts)), 0)


def test_side_steps_on_a_tread_are_refused() -> None:
    route = Route(segments=(Level(length_m=2.5), Stairs(risers=5), Level(length_m=2.0)))
    acts = (SideStep(at_m=3.1, left_m=0.3),)
    with pytest.raises(ConfigError, match=r"acts.at_m: invalid 3.1.*for side_step"):
        Twin(replace(LEVEL, route=route, gait=Gait(acts=acts)), 0)
