"""The simulated walk: its small parts against the engine and against general solvers, and what holds it up."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import pytest
from scipy.optimize import nnls

from stridetwin.sim.config import Dynamics, Gait, Level, Misstep, Person, Push, Route, Segment, Stairs, TwinConfig
from stridetwin.sim.dynamics import spatial, whole_body_problem
from stridetwin.sim.dynamics.contacts import Contacts, sense_floor, sole_point_numbers, subtract_bias
from stridetwin.sim.dynamics.couplings import CouplingSet, coupling_forces
from stridetwin.sim.dynamics.footstep_replanning import PlannedFeet, StepReplan, advance_shifts
from stridetwin.sim.dynamics.plan import plan_control
from stridetwin.sim.dynamics.simulate import apply_disturbances, misstep_offsets, push_forces
from stridetwin.sim.dynamics.simulated_walk import SimulatedWalk
from stridetwin.sim.dynamics.soles import HEEL_POINTS, sole_points, toe_weights
from stridetwin.sim.dynamics.spatial import State, chain_of
from stridetwin.sim.dynamics.whole_body_problem import ContactPoints, Tasks
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.exo_couplings import BodyState, exo_couplings, wrench
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array
from tests.estimators.from_python import from_python

bias_acceleration, velocity = from_python(spatial.bias_acceleration), from_python(spatial.velocity)
jacobian, contact_forces = from_python(spatial.jacobian), from_python(whole_body_problem.contact_forces)
eliminate, solve = from_python(whole_body_problem.eliminate), from_python(whole_body_problem.solve_control_step)

STAIRS: tuple[Segment, ...] = (
    Level(length_m=2.5),
    Stairs(risers=3),
    Level(length_m=2.0),
    Stairs(risers=3, down=True),
    Level(length_m=2.0),
)


def make(
    segments: tuple[Segment, ...],
    seed: int = 7,
    dynamics: Dynamics | None = None,
    person: Person | None = None,
    speed_mps: float = Gait().speed_mps,
) -> Twin:
    config = TwinConfig(
        name="dynamic",
        route=Route(segments=segments),
        gait=Gait(stand_s=0.5, speed_mps=speed_mps),
        person=person or Person(),
        sensors=(),
        physics="dynamic",
        dynamics=dynamics,
    )
    return Twin(config, seed)


@pytest.fixture(scope="module")
def twin() -> Twin:
    return make(STAIRS)


@pytest.fixture(scope="module")
def walk(twin: Twin) -> SimulatedWalk:
    simulated = twin.walk
    assert isinstance(simulated, SimulatedWalk)
    return simulated


@pytest.fixture
def moving(twin: Twin) -> mujoco.MjData:
    """A state of the model in the middle of any motion."""
    rng = np.random.default_rng(3)
    data = mujoco.MjData(twin.model)
    q, v, _ = twin.reference.state(np.array([1.9]))
    data.qpos, data.qvel = q[0], v[0] + rng.normal(0, 0.5, twin.model.nv)
    mujoco.mj_forward(twin.model, data)
    return data


@pytest.mark.parametrize("seed", range(20))
def test_contact_forces_are_those_of_a_general_solver(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 40))
    B, d, r = rng.normal(size=(6, n)), rng.normal(size=6) * 10, rng.uniform(1e-4, 1.0, n)
    by_themselves = rng.uniform(0.0, 3.0, n) * rng.integers(0, 2)
    f, y = contact_forces(B, d, r, by_themselves)
    expected, _ = nnls(np.vstack([B, np.diag(np.sqrt(r))]), np.r_[d, np.sqrt(r) * by_themselves])
    assert np.allclose(f, expected, atol=1e-6 * max(1.0, expected.max()))
    assert np.allclose(y, d - B @ f, atol=1e-6)


def test_eliminated_joints_move_as_the_engine_says(twin: Twin, moving: mujoco.MjData) -> None:
    model, rng = twin.model, np.random.default_rng(1)
    M = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, moving, M)
    free = np.array([i for i in range(6, model.nv) if i % 5 == 0])
    driven = np.setdiff1d(np.arange(model.nv), free)
    qacc = rng.normal(size=model.nv)
    force = M @ qacc + moving.qfrc_bias
    force[free] = 0.0
    qacc = np.linalg.solve(M, force - moving.qfrc_bias)
    A, c = eliminate(M, moving.qfrc_bias.copy(), driven, free)
    assert np.allclose(A @ qacc[driven] + c, force[driven], atol=1e-6)


@pytest.mark.parametrize("body", ["foot_l", "toe_r", "exo_shank_l"])
def test_jacobians_are_the_engines(twin: Twin, moving: mujoco.MjData, body: str) -> None:
    model, b = twin.model, twin.model.body(body).id
    point = moving.xpos[b] + moving.xmat[b].reshape(3, 3) @ [0.1, -0.02, 0.03]
    chain, arm = chain_of(model, b), tuple(point - moving.subtree_com[1])
    rows = np.empty((6, model.nv))
    jacobian(moving.cdof, chain, arm, rows, 0, 3)
    expected = np.empty((2, 3, model.nv))
    mujoco.mj_jac(model, moving, expected[0], expected[1], point, b)
    assert np.allclose(rows.reshape(2, 3, -1), expected, atol=1e-12)
    mujoco.mj_jacDot(model, moving, expected[0], expected[1], point, b)
    v, w = velocity(State.of(moving), b, tuple(point))
    bias, turn = bias_acceleration(moving.cdof_dot, chain, moving.qvel, v, w, arm)
    assert np.allclose(bias, expected[0] @ moving.qvel, atol=1e-9)
    assert np.allclose(turn, expected[1] @ moving.qvel, atol=1e-9)


def test_reference_accelerations_of_contacts_include_the_missing_term(twin: Twin, moving: mujoco.MjData) -> None:
    """The reference acceleration falls by J' q', along each axis of the contact's frame."""
    model = copy.copy(twin.model)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    data = mujoco.MjData(model)
    data.qpos, data.qvel = moving.qpos, moving.qvel
    data.qpos[2] -= 0.01
    mujoco.mj_step1(model, data)
    before = data.efc_aref.copy()
    chains = np.array([chain_of(model, body) for body in range(model.nbody)])
    subtract_bias(model.body_weldid[model.geom_bodyid], chains, Contacts.of(data), State.of(data), data.efc_aref)
    dot, found = np.empty((3, model.nv)), 0
    for contact in data.contact:
        body = model.geom_bodyid[contact.geom]
        assert (body == 0).any()
        side = int(np.argmax(body > 0))
        mujoco.mj_jacDot(model, data, dot, None, contact.pos, int(body[side]))
        rows = slice(contact.efc_address, contact.efc_address + 3)
        own = contact.frame.reshape(3, 3) @ (dot @ data.qvel) * (1.0 if side == 1 else -1.0)
        assert np.allclose(before[rows] - data.efc_aref[rows], own, atol=1e-8)
        found += np.abs(own).max() > 0.1
    assert found > 0


def test_compiled_couplings_follow_their_law(twin: Twin, moving: mujoco.MjData) -> None:
    model, coupled = twin.model, exo_couplings(twin.size)
    got = coupling_forces(CouplingSet.of(model, coupled), State.of(moving))
    expected, read = np.zeros(model.nv), np.empty(6)

    def pose(body: str) -> BodyState:
        b = model.body(body).id
        mujoco.mj_objectVelocity(model, moving, mujoco.mjtObj.mjOBJ_XBODY, b, read, 0)
        return BodyState(
            p=moving.xpos[b].copy(), R=moving.xmat[b].reshape(3, 3).copy(), v=read[3:].copy(), w=read[:3].copy()
        )

    for c in coupled:
        force, torque, point = wrench(c, pose(c.exo_body), pose(c.body))
        mujoco.mj_applyFT(model, moving, force, torque, point, model.body(c.exo_body).id, expected)
        mujoco.mj_applyFT(model, moving, -force, -torque, point, model.body(c.body).id, expected)
    assert np.abs(expected).max() > 1.0
    assert np.allclose(got, expected, atol=1e-8)
    assert np.abs(got[:3]).max() < 1e-9  # no momentum for the whole body


def test_control_step_obeys_the_equations_of_motion() -> None:
    rng = np.random.default_rng(2)
    n, k = 14, 5
    root = rng.normal(size=(n, n))
    M, h = root @ root.T + n * np.eye(n), rng.normal(size=n)
    contacts = rng.normal(size=(3 * k, n))
    up = np.array([[0.5, 0.0, 1.0], [-0.5, 0.0, 1.0], [0.0, 0.5, 1.0], [0.0, -0.5, 1.0]])
    edges = np.tile(up, (k, 1, 1))
    tasks, aims = rng.normal(size=(4, n)), rng.normal(size=4)
    wanted, unaided = rng.normal(size=n), np.zeros(6)
    qacc, torque, push, rest = solve(
        M,
        h,
        wanted,
        np.full(n, 0.1),
        Tasks(tasks, aims, np.ones(4)),
        ContactPoints(contacts, edges, np.full(k, 1e-3), 1e-4, rng.uniform(0.0, 1.0, (k, 4))),
        unaided,
    )
    assert push.min() >= 0.0
    force = np.einsum("ke,kei->ki", push, edges).ravel()
    assert np.allclose(M @ qacc + h, np.r_[np.zeros(6), torque[6:]] + contacts.T @ force + np.r_[rest, np.zeros(n - 6)])
    assert np.abs(torque[:6]).max() == 0.0
    assert np.abs(rest).max() < 1e-6
    for f in force.reshape(k, 3):
        assert abs(f[0]) + abs(f[1]) <= 0.5 * f[2] + 1e-9


def test_nothing_but_the_ground_holds_the_walker(twin: Twin, walk: SimulatedWalk) -> None:
    """The centre of mass moves as gravity and the contact forces say: there is no hidden help."""
    assert walk.fell_at is None
    assert np.abs(walk.torque[:, :6]).max() == 0.0
    mass, data = float(twin.model.body_subtreemass[0]), mujoco.MjData(twin.model)
    t = np.arange(1.0, walk.duration_s - 1.0, 0.25)
    span = 0.1
    for moment in t:
        momenta = []
        q, v, _ = walk.state(np.array([moment, moment + span]))
        for i in range(2):
            data.qpos, data.qvel = q[i], v[i]
            mujoco.mj_kinematics(twin.model, data)
            mujoco.mj_comPos(twin.model, data)
            mujoco.mj_comVel(twin.model, data)
            mujoco.mj_subtreeVel(twin.model, data)
            momenta.append(mass * data.subtree_linvel[0].copy())
        during = (walk.t >= moment) & (walk.t < moment + span)
        push = walk.loads.force[during].sum(axis=(0, 1)) * 1e-3 - np.array([0.0, 0.0, 9.81 * mass * span])
        assert np.abs(momenta[1] - momenta[0] - push).max() < 0.01 * mass * 9.81 * span


def test_ground_never_presses_with_much_more_than_the_body_weighs() -> None:
    """At 1.3 m/s people's feet press with up to 1.25 body weights; the plan asks for 1.8 at its last landing."""
    twin = make((Level(length_m=6.0),), seed=2, speed_mps=1.3)
    walk = twin.walk
    assert isinstance(walk, SimulatedWalk)
    assert walk.fell_at is None
    steady = (walk.t > 0.4) & (walk.t < walk.duration_s - 0.4)
    lift = walk.loads.force[steady, :, 2].sum(axis=1) / (9.81 * twin.total_mass_kg)
    assert 1.2 < lift.max() < 1.6


def test_load_leaves_the_heel_before_the_heel_leaves_the_ground(twin: Twin) -> None:
    """Until the plan lifts the heel, force at the heel becomes ever dearer, smoothly."""
    feet, found = twin.control_plan.feet, 0
    for k in range(2):
        heel, ball = np.split(feet.touching[:, k], [HEEL_POINTS], axis=1)
        heel, ball = np.logical_and.reduce(heel, axis=1), np.logical_and.reduce(ball, axis=1) & ~feet.swinging[:, k]
        whole, ball_alone = heel & ball, ball & ~heel
        for i in np.flatnonzero(whole[:-1] & ball_alone[1:]):
            weight = feet.force_weight[i - 40 : i + 1, k, 0]
            assert (np.diff(weight) >= 0.0).all()
            assert (np.diff(np.log(weight)) < 0.3).all()
            assert weight[0] == 1.0
            assert weight[-1] == pytest.approx(30.0)
            found += 1
    assert found > 5


def test_simulated_walk_follows_its_plan(twin: Twin, walk: SimulatedWalk) -> None:
    t = np.arange(0.0, walk.duration_s, 0.01)
    legs = [i for i, n in enumerate(walk.coordinates.names) if n.startswith(("hip", "knee", "ankle"))]
    error = np.degrees(walk.splines(t)[:, legs] - twin.reference.splines(t)[:, legs])
    assert np.sqrt((error**2).mean()) < 2.0
    for side in "lr":
        for planned, done in zip(twin.reference.steps[side], walk.steps[side], strict=True):
            assert np.linalg.norm(planned.p_foot_in_world - done.p_foot_in_world) < 0.04


def test_simulated_state_agrees_with_its_own_derivatives(walk: SimulatedWalk) -> None:
    t = np.round(np.linspace(0.5, walk.duration_s - 0.5, 50), 3) + 5e-4  # between two steps
    h = 1e-5
    _, _, a = walk.state(t)
    _, v0, _ = walk.state(t - h)
    _, v1, _ = walk.state(t + h)
    assert np.allclose((v1 - v0) / (2 * h), a, rtol=1e-3, atol=1e-2)


IN_PLACE = np.zeros((2, 2))
RIGHT_STANDS = np.array([np.nan, 0.0])


def replanned(
    shift: StepReplan,
    until: float,
    normal: Array,
    off: Array = IN_PLACE,
    floor: Array = RIGHT_STANDS,
    misplaced: Array = IN_PLACE,
    pressing: tuple[bool, bool] = (False, True),
) -> None:
    """One control step on the right foot; the left one lands in `until` s, or should have landed."""
    R_sole, vec, points = np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)), np.zeros((2, 8))
    R_sole[:, :, 2] = normal
    planned = PlannedFeet(
        share=np.array([0.0, 1.0] if until > 0.0 else [0.5, 0.5]),
        touching=points > 0.0,
        force_weight=points,
        R_sole=R_sole,
        p_sole=vec,
        swinging=np.array([until > 0.0, False]),
        until_landing=np.array([until, 0.0]),
        R_way=np.eye(2),
        near_edge=np.zeros(2, dtype=bool),
        p_foot=vec,
        v_foot=vec,
        a_foot=vec,
        R_foot=R_sole,
        w_foot=vec,
        dw_foot=vec,
    )
    advance_shifts(shift, 0.002, planned, off, floor, np.array(pressing), misplaced)


def test_feet_are_moved_only_where_the_body_is_off_its_plan() -> None:
    still, falling, up = StepReplan.none(), StepReplan.none(), np.array([0.0, 0.0, 1.0])
    for until in np.arange(0.35, 0.0, -0.002):
        replanned(still, until, up)
        replanned(falling, until, up, off=np.array([[0.0, 0.08], [0.0, 0.0]]))
    assert np.abs(still.foot).max() == 0.0
    assert falling.foot[0, 0, 1] > 0.02  # the left foot lands further left
    assert np.abs(falling.foot[1]).max() == 0.0


@pytest.mark.parametrize(("measured", "down_m"), [(np.nan, 0.010), (-0.008, 0.002)])
def test_a_foot_expects_the_measured_floor_of_the_other_and_descends_until_it_presses(
    measured: float, down_m: float
) -> None:
    shift, slope = StepReplan.none(), np.array([-np.sin(0.2), 0.0, np.cos(0.2)])
    for until in np.arange(0.35, 0.0, -0.002):
        replanned(shift, until, slope, floor=np.array([np.nan, -0.008]), misplaced=np.array([[0.05, 0.0], [0.0, 0.0]]))
    # 50 mm further up the slope, on a floor that lies 8 mm lower than planned
    assert shift.foot[0, 0] == pytest.approx([0.05, 0.0, 0.05 * np.tan(0.2) - 0.008], abs=2e-3)
    before = shift.foot[0, 0, 2]
    for _ in range(25):  # it hovers: fast where it measures no floor, slowly over one
        replanned(shift, 0.0, slope, floor=np.array([measured, -0.008]))
    assert shift.foot[0, 0, 2] < before - down_m
    landed = shift.foot[0, 0, 2]
    for _ in range(200):
        replanned(shift, 0.0, slope, floor=np.array([-0.008, -0.008]), pressing=(True, True))
    assert shift.foot[0, 0, 2] == pytest.approx(landed, abs=0.01)


def test_a_point_in_contact_stays_so_until_it_is_well_off_the_floor(twin: Twin) -> None:
    plan = plan_control(twin.reference, twin.model)
    model = copy.copy(twin.model)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data, soles = mujoco.MjData(model), sole_point_numbers(model)
    none, every = np.zeros((2, 8), dtype=bool), np.ones((2, 8), dtype=bool)
    found = {}
    for height in (-0.0005, 0.001, 0.003):
        data.qpos = plan.q[0]
        data.qpos[2] += height
        mujoco.mj_step1(model, data)
        found[height] = [
            sense_floor(soles, Contacts.of(data), plan.feet_at(0), before)[0].any() for before in (none, every)
        ]
    assert found == {-0.0005: [True, True], 0.001: [False, True], 0.003: [False, False]}


def test_same_seed_same_simulation() -> None:
    segments = (Level(length_m=0.6),)
    one, two = make(segments).walk, make(segments).walk
    assert np.array_equal(one.splines.c, two.splines.c)


LEVEL: tuple[Segment, ...] = (Level(length_m=3.0),)


def simulated(dynamics: Dynamics) -> tuple[Twin, SimulatedWalk]:
    twin = make(LEVEL, dynamics=dynamics)
    walk = twin.walk
    assert isinstance(walk, SimulatedWalk)
    return twin, walk


def test_a_pushed_walker_puts_the_foot_elsewhere_and_walks_on() -> None:
    _, calm = simulated(Dynamics())
    twin, walk = simulated(Dynamics(pushes=(Push(at_s=2.0, left_n=80.0),)))
    assert twin.fell_at is None
    moved = [
        np.linalg.norm(one.p_foot_in_world - other.p_foot_in_world)
        for side in "lr"
        for one, other in zip(calm.steps[side], walk.steps[side], strict=True)
    ]
    assert max(moved) > 0.02
    assert np.abs(walk.torque[:, :6]).max() == 0.0


def test_a_shoe_longer_than_the_treads_carries_its_wearer_down() -> None:
    down = Stairs(risers=5, riser_m=0.2, tread_m=0.28, down=True)
    twin = make((Level(length_m=1.5), down, Level(length_m=1.5)), person=Person(height_m=1.88, mass_kg=80.0))
    shoe, simulated = twin.size.shoe, twin.walk
    assert isinstance(simulated, SimulatedWalk)
    assert simulated.fell_at is None
    t = np.arange(0.0, simulated.duration_s, 0.005)
    loads, over = twin.reference.loads(t), 0
    for k, side in enumerate("lr"):
        for step in twin.reference.steps[side]:
            on = (t > step.t_touch) & (t < step.t_off)
            centre = loads[on, 4 * k + 1 : 4 * k + 4]
            assert twin.terrain.height(centre[:, :2]) == pytest.approx(centre[:, 2], abs=0.005)
            tip = step.p_foot_in_world + shoe.flat_tip_x * step.R_world_sole[:, 0]
            over += bool(twin.terrain.height(tip[:2]) < tip[2] - 0.1)
    assert over >= 4


def test_a_walker_who_is_pushed_over_is_reported_fallen() -> None:
    twin, _ = simulated(Dynamics(pushes=(Push(at_s=2.0, duration_s=0.3, left_n=500.0),)))
    assert twin.fell_at is not None
    assert 2.0 < twin.fell_at < twin.reference.duration_s
    assert twin.duration_s == pytest.approx(twin.fell_at, abs=0.01)


def test_help_at_the_root_is_soft_and_recorded() -> None:
    twin, walk = simulated(Dynamics(assist=True, mass_error=0.05, torque_noise=0.1))
    assert twin.fell_at is None
    weight = 9.81 * float(twin.model.body_subtreemass[0])
    given = np.linalg.norm(walk.torque[:, :3], axis=1)
    assert 0.0 < given.mean() < 0.02 * weight
    assert given.max() < 0.1 * weight
    t_ns = (np.array([2.0, 3.0]) * 1e9).astype(np.int64)
    player = twin.player()
    loads = player.loads(t_ns, player.motion(t_ns))
    assert np.allclose(loads.residual_force, walk.torque[[2000, 3000], :3])


def test_the_body_and_the_floor_are_as_disturbed(twin: Twin) -> None:
    model = apply_disturbances(twin.model, Dynamics(mass_error=0.05, floor_offset_m=-0.008, friction=0.5))
    assert model.body_subtreemass[0] == pytest.approx(1.05 * twin.model.body_subtreemass[0])
    ground = twin.model.geom("ground").id
    assert model.geom_pos[ground, 2] == pytest.approx(twin.model.geom_pos[ground, 2] - 0.008)
    assert model.geom("sole_l_0").friction[0] == 0.5
    assert twin.model.geom("sole_l_0").friction[0] != 0.5


def test_pushes_and_missteps_happen_at_the_configured_times_and_places(twin: Twin) -> None:
    plan = plan_control(twin.reference, twin.model)
    push = push_forces(Dynamics(pushes=(Push(at_s=3.0, duration_s=0.2, left_n=100.0),)), plan)
    on = (plan.t >= 3.0) & (plan.t < 3.2)
    assert np.allclose(push[on], [0.0, 100.0], atol=1.0)
    assert np.abs(push[~on]).max() == 0.0
    off = misstep_offsets(Dynamics(missteps=(Misstep(at_s=4.0, forward_m=0.05),)), plan)
    foot = int(np.abs(off).max(axis=(0, 2)).argmax())
    during = np.flatnonzero(off[:, foot, 0])
    landing = plan.t[during[-1]] + plan.feet.until_landing[during[-1], foot]
    assert landing > 4.0
    assert plan.feet.swinging[during, foot].all()
    assert np.abs(off[:, 1 - foot]).max() == 0.0


def test_dynamics_without_dynamic_physics_is_refused() -> None:
    config = TwinConfig(name="still", route=Route(segments=LEVEL), sensors=(), dynamics=Dynamics(assist=True))
    with pytest.raises(ConfigError, match="still: dynamics: invalid 'physics kinematic'"):
        Twin(config, 1)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.85])
def test_forces_that_cost_what_toes_cost_press_where_they_are_wanted(share: float) -> None:
    size = Twin(TwinConfig(name="toes", route=Route(segments=(Level(length_m=2.0),)), sensors=()), 1).size
    ahead = np.array([p[0] for body, p in sole_points(size) if body == "toe"])
    x = size.shoe.toe_hinge_x + share * ahead.max()
    force = 1.0 / toe_weights(size, np.array([x]))[0]  # the least cost of any sum of forces
    assert size.shoe.toe_hinge_x + force @ ahead / force.sum() == pytest.approx(x)
    assert toe_weights(size, np.array([-1.0, 1.0])).max() < 10.0


def test_a_simulated_foot_presses_under_its_toes_until_the_heel_is_down() -> None:
    route = Route(segments=(Level(length_m=2.0), Stairs(risers=3, down=True), Level(length_m=1.5)))
    twin = Twin(TwinConfig(name="down", route=route, gait=Gait(stand_s=0.5), sensors=(), physics="dynamic"), 3)
    player, pressed = twin.player(), []
    for side in "lr":
        for step in (s for s in twin.walk.steps[side] if (s.mode, s.departure) == ("SD", "lower")):
            t_ns = np.round(1e9 * (step.t_touch + np.linspace(0.09, 0.16, 20) * (step.t_off - step.t_touch)))
            load = player.loads(t_ns.astype(np.int64), player.motion(t_ns.astype(np.int64))).feet[side]
            pressed.append(np.median((load.cop - step.p_foot_in_world) @ step.R_world_sole[:, 0]))
    assert twin.fell_at is None
    assert len(pressed) == 2
    assert min(pressed) > 0.175
