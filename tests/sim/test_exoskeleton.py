"""The exoskeleton: its D-H table, its stops, what couples it to the wearer, its modules, and a walk without it."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation
from scipy.special import expit

from stridetwin.reference.norms import read_reference as published
from stridetwin.sim.config import Exo, Gait, Level, Person, Ramp, Route, Segment, Stairs, TwinConfig
from stridetwin.sim.dynamics.simulated_walk import SimulatedWalk
from stridetwin.sim.gait import exo_fit_kernel
from stridetwin.sim.gait.exo_fit import STOP_STIFFNESS, STOP_WIDTH_RAD, ExoLeg, LegPose, fit_leg, leg_pose
from stridetwin.sim.noise import Noise
from stridetwin.sim.people import PEOPLE
from stridetwin.sim.playback import Playback
from stridetwin.sim.sensors.force_cells import InteractionModel
from stridetwin.sim.sensors.standard_rig import EXO_GROUPS, sensor_rig, standard_rig
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.body import add_wearer, compile_model, fit_wearer
from stridetwin.sim.wearer.exo_couplings import BodyState, Coupling, exo_couplings, strain, wrench
from stridetwin.sim.wearer.exoskeleton import (
    DH_SIGNS,
    EXO_LEG_BODIES,
    EXO_LEG_JOINTS,
    HIP,
    JOINTS,
    KNEE,
    R_DH_BODY,
    RANGE_RAD,
    dh_table,
    modules,
)
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array, Block
from tests.estimators.from_python import from_python
from tests.sim.dh_kinematics import DH_FRAMES, forward_kinematics, frame_0_in_pelvis

stop_torque = from_python(exo_fit_kernel.stop_torque)


def stops(q: Array) -> tuple[Array, Array]:
    """(..., 6) torque that the stops ask for, N m, and its slope, N m/rad: the gradient of their energy, smooth."""
    over, under = (q - RANGE_RAD[:, 1]) / STOP_WIDTH_RAD, (RANGE_RAD[:, 0] - q) / STOP_WIDTH_RAD
    torque = STOP_STIFFNESS * STOP_WIDTH_RAD * (np.logaddexp(0.0, over) - np.logaddexp(0.0, under))
    return torque, STOP_STIFFNESS * (expit(over) + expit(under))


PAPER = published("shim2019")
WEARERS = (Person(), PEOPLE["shim_s6"], Person(height_m=1.95, mass_kg=110), Person(height_m=1.5, mass_kg=45))
ANGLES = st.lists(st.floats(0.0, 1.0), min_size=6, max_size=6).map(
    lambda share: RANGE_RAD[:, 0] + np.array(share) * np.ptp(RANGE_RAD, axis=1)
)
ROUTES: dict[str, tuple[Segment, ...]] = {
    "level": (Level(length_m=4.0),),
    "stairs": (
        Level(length_m=2.0),
        Stairs(risers=3),
        Level(length_m=1.5),
        Stairs(risers=3, down=True),
        Level(length_m=1.5),
    ),
    "ramp_14": (
        Level(length_m=2.0),
        Ramp(angle_rad=np.radians(14), rise_m=0.5),
        Level(length_m=1.5),
        Ramp(angle_rad=np.radians(14), rise_m=0.5, down=True),
        Level(length_m=2.0),
    ),
}


def model_of(person: Person, exo: Exo | None) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    add_wearer(spec, person, exo)
    return compile_model(spec)


MODE_0 = Exo()
MODELS = [model_of(person, MODE_0) for person in WEARERS]


def config(route: str, exo: Exo | None = MODE_0, **rest: object) -> TwinConfig:
    return TwinConfig(name=route, route=Route(segments=ROUTES[route]), exo=exo, **rest)  # type: ignore[arg-type]


def links_of(person: Person):  # type: ignore[no-untyped-def]
    links = fit_wearer(person).exo
    assert links is not None
    return links


@settings(max_examples=60, deadline=None)
@given(angles=ANGLES, side=st.sampled_from("lr"), who=st.integers(0, len(WEARERS) - 1))
def test_poses_of_the_bodies_are_those_of_the_papers_table(angles: Array, side: str, who: int) -> None:
    model, links = MODELS[who], links_of(WEARERS[who])
    data = mujoco.MjData(model)
    for joint, angle in zip(EXO_LEG_JOINTS, angles):
        data.joint(f"{joint}_{side}").qpos = angle
    mujoco.mj_kinematics(model, data)
    frames = frame_0_in_pelvis(links) @ forward_kinematics(links, side, DH_SIGNS[side] * angles)
    R_pelvis, p_pelvis = data.body("pelvis").xmat.reshape(3, 3), data.body("pelvis").xpos
    for body, frame in zip(EXO_LEG_BODIES, DH_FRAMES):
        found = data.body(f"{body}_{side}")
        p = R_pelvis.T @ (found.xpos - p_pelvis)
        assert np.abs(p - frames[frame - 1, :3, 3]).max() < 1e-9
        R = R_pelvis.T @ found.xmat.reshape(3, 3)
        assert np.abs(R - frames[frame - 1, :3, :3] @ R_DH_BODY[frame]).max() < 1e-9


@given(q=st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6).map(np.array), side=st.sampled_from("lr"))
def test_rotations_are_equations_6_and_9_of_the_paper(q: Array, side: str) -> None:
    frames = forward_kinematics(links_of(Person()), side, q)[:, :3, :3]
    (s1, s3, s5), (c1, c3, c5) = np.sin(q[:3]), np.cos(q[:3])
    hip = [
        [s1 * c5 - s3 * s5 * c1, -s1 * s5 - s3 * c1 * c5, c1 * c3],
        [-c1 * c5 - s1 * s3 * s5, s5 * c1 - s1 * s3 * c5, s1 * c3],
        [-s5 * c3, -c3 * c5, -s3],
    ]
    (s7, s8), (c7, c8) = np.sin(q[4:]), np.cos(q[4:])
    ankle = [[c7 * c8, -c7 * s8, s7], [s7 * c8, -s7 * s8, -c7], [s8, c8, 0.0]]
    np.testing.assert_allclose(frames[4], hip, atol=1e-12)
    np.testing.assert_allclose(frames[5].T @ frames[7], ankle, atol=1e-12)


def test_table_is_the_one_printed() -> None:
    links = links_of(Person())
    for side, s in (("l", 1), ("r", -1)):
        rows = dh_table(links, side)
        assert [row.joint for row in rows] == [0, None, 1, None, 2, 3, 4, 5]
        assert rows[0].a == s * links.hip1
        assert rows[1].d == s * links.hip2
        assert rows[6].d == -s * links.ankle2
        np.testing.assert_allclose([row.alpha for row in rows], np.pi / 2 * np.array([0, 1, 1, 1, -1, 0, 0, 1]))


@given(angles=ANGLES)
def test_right_leg_mirrors_the_left(angles: Array) -> None:
    links, flip = links_of(Person()), np.diag([1.0, -1.0, 1.0])
    T = {s: frame_0_in_pelvis(links) @ forward_kinematics(links, s, DH_SIGNS[s] * angles) for s in "lr"}
    for frame in DH_FRAMES:
        left, right = T["l"][frame - 1], T["r"][frame - 1]
        np.testing.assert_allclose(flip @ left[:3, 3], right[:3, 3], atol=1e-12)
        body = R_DH_BODY[frame]
        np.testing.assert_allclose(flip @ left[:3, :3] @ body @ flip, right[:3, :3] @ body, atol=1e-12)


@pytest.mark.parametrize("person", WEARERS)
def test_axes_of_abduction_and_flexion_meet_in_the_hip(person: Person) -> None:
    links, size = links_of(person), fit_wearer(person)
    T = frame_0_in_pelvis(links) @ forward_kinematics(links, "l", np.zeros(6))
    np.testing.assert_allclose(T[0, :3, 3], [0, size.body.hip_half_width_m, 0], atol=5.1e-3)
    np.testing.assert_allclose(T[4, [0, 2], 3], 0.0, atol=1e-12)
    assert abs(links.thigh - size.body.thigh_m) < 5.1e-3
    assert abs(links.shank - size.body.shank_m) < 5.1e-3


def test_joints_but_the_ankle_stop_where_the_paper_says() -> None:
    rom = {name: row["exo"] for name, row in PAPER["joint_rom_deg"].items()}
    up, down = zip(
        rom["hip_adduction_abduction"],
        rom["hip_medial_lateral_rotation"],
        rom["hip_flexion_extension"],
        rom["knee_extension_flexion"][::-1],
        rom["ankle_dorsi_plantar_flexion"],
        rom["ankle_inversion_eversion"],
    )
    theirs = np.column_stack([-np.array(down), up])
    theirs[4] = -50.0, 45.0  # beyond the wearer's own range, where theirs lies within it
    np.testing.assert_allclose(np.degrees(RANGE_RAD), theirs)
    for i, joint in enumerate(EXO_LEG_JOINTS):
        for side in "lr":
            np.testing.assert_allclose(MODELS[0].joint(f"{joint}_{side}").range, RANGE_RAD[i])
    assert np.abs(stops(np.zeros(6))[0]).max() < 1e-3
    assert stops(RANGE_RAD[:, 1] + np.radians(1.0))[0].min() > 20.0
    h = 1e-6
    q = RANGE_RAD[:, 0] + 0.002
    np.testing.assert_allclose((stops(q + h)[0] - stops(q - h)[0]) / (2 * h), stops(q)[1], rtol=1e-6)


def exo_mass(model: mujoco.MjModel) -> float:
    return float(sum(model.body_mass[i] for i in range(model.nbody) if model.body(i).name.startswith("exo_")))


def test_mass_of_every_mode_and_inertia_of_the_joints() -> None:
    mass = PAPER["exoskeleton"]["mass_kg"]
    assert exo_mass(MODELS[0]) == pytest.approx(mass["without_actuators"])
    full = model_of(Person(), Exo(mode=1))
    assert exo_mass(full) == pytest.approx(mass["with_actuators"])
    assert (HIP.gear, KNEE.gear) == tuple(PAPER["exoskeleton"]["gear"].values())
    assert full.joint("exo_hip_flexion_l").armature == pytest.approx(HIP.reflected_inertia)
    assert full.joint("exo_knee_flexion_r").armature == pytest.approx(KNEE.rotor_inertia * 6400)
    one = model_of(Person(), Exo(mode=4, joints=("knee_l",)))
    assert exo_mass(one) == pytest.approx(mass["without_actuators"] + KNEE.mass_kg)
    assert one.joint("exo_knee_flexion_l").armature > 0
    assert one.joint("exo_knee_flexion_r").armature == 0


def weighted(values: Array) -> float:
    """Sum over bodies or geoms, where each column has its own weight."""
    return float(np.sum(values * (1.0 + np.arange(values.shape[1]))))


@pytest.mark.parametrize(
    ("who", "com", "pos", "size", "quat"),
    [
        (0, -2.402, -31.5638, 14.567329627, 65.100601539),
        (1, -2.0972, -27.0278, 14.136102151, 65.099680723),
        (2, -2.698, -35.4278, 15.203633707, 64.757932695),
        (3, -2.031, -26.6234, 13.896928997, 65.273648338),
    ],
)
def test_template_fits_the_wearer(who: int, com: float, pos: float, size: float, quat: float) -> None:
    """Centres of mass and shapes as before the bodies came from a template, to the last digit here."""
    model = model_of(WEARERS[who], Exo(mode=1))
    bodies = [b for b in range(model.nbody) if model.body(b).name.startswith("exo_")]
    shapes = np.isin(model.geom_bodyid, bodies)
    assert (len(bodies), int(shapes.sum())) == (17, 118)
    assert weighted(model.body_inertia[bodies]) == pytest.approx(0.5352)
    assert weighted(model.body_ipos[bodies]) == pytest.approx(com)
    assert weighted(model.geom_pos[shapes]) == pytest.approx(pos)
    assert weighted(model.geom_size[shapes]) == pytest.approx(size)
    assert weighted(model.geom_quat[shapes]) == pytest.approx(quat)
    assert not model.geom_contype[shapes].any()
    for body in bodies:
        left = model.body(body)
        if left.name.endswith("_l"):
            right = model.body(left.name[:-1] + "r")
            np.testing.assert_allclose(right.ipos, left.ipos * [1, -1, 1], atol=1e-15)
            np.testing.assert_allclose(right.pos, left.pos * [1, -1, 1], atol=1e-15)


@pytest.mark.parametrize(
    ("exo", "joints"),
    [
        (Exo(), ()),
        (Exo(mode=1), JOINTS),
        (Exo(mode=2, joints=("knee_l", "knee_r")), ("knee_l", "knee_r")),
        (Exo(mode=3, joints=("knee_r", "hip_r")), ("hip_r", "knee_r")),
        (Exo(mode=4, joints=("hip_l",)), ("hip_l",)),
    ],
)
def test_modes_power_their_joints(exo: Exo, joints: tuple[str, ...]) -> None:
    assert set(modules(exo)) == set(joints)


@pytest.mark.parametrize(
    ("exo", "text"),
    [
        (Exo(mode=5), "0, 1, 2, 3, 4"),
        (Exo(mode=2), r"\[hip_l, hip_r\] or \[knee_l, knee_r\] in mode 2"),
        (Exo(mode=3, joints=("hip_l", "knee_r")), "in mode 3"),
        (Exo(mode=0, joints=("hip_l",)), "in mode 0"),
        (Exo(mode=4, joints=("ankle_l",)), "in mode 4"),
    ],
)
def test_joints_that_a_mode_does_not_power_are_refused(exo: Exo, text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        modules(exo)


def posed(rng: np.random.Generator, side: str, n: int) -> LegPose:
    """A leg of the wearer in mid swing, shaken."""
    size = fit_wearer(Person())

    def turned(pitch: float) -> Array:
        return Rotation.from_rotvec(rng.normal(0, 0.04, (n, 3)) + [0, pitch, 0]).as_matrix()

    R_thigh, R_shank, R_foot = turned(-0.4), turned(0.5), turned(0.5)
    arm = np.array([-size.ankle_x, 0.0, -size.body.ankle_height_m])
    ankle = R_thigh @ [0, 0, -size.body.thigh_m] + R_shank @ [0, 0, -size.body.shank_m] + R_foot @ arm
    hip = np.array([0.0, size.body.hip_half_width_m * (1 if side == "l" else -1), 0.0])
    return leg_pose(size, side, R_thigh, R_shank, hip + ankle, R_foot)


@pytest.mark.parametrize("side", ["l", "r"])
def test_strains_agree_with_their_jacobian_and_the_fit_has_no_gradient_left(side: str) -> None:
    rng = np.random.default_rng(3)
    leg, on, h = ExoLeg(fit_wearer(Person()), side), posed(rng, side, 6), 1e-6
    q = rng.uniform(-0.3, 0.3, (6, 6))
    _, jacobian = leg.strains(q, on)
    for j, step in enumerate(h * np.eye(6)):
        slope = (leg.strains(q + step, on)[0] - leg.strains(q - step, on)[0]) / (2 * h)
        np.testing.assert_allclose(jacobian[:, :, j], slope, atol=1e-8)
    q = fit_leg(leg, on)
    value, jacobian = leg.strains(q, on)
    gradient, hessian = exo_fit_kernel.project_on_joints(leg.kernel, leg.kernel.stiffness, jacobian, value)
    weighted = np.swapaxes(jacobian, 1, 2) @ block_diag(*leg.kernel.stiffness.reshape(-1, 3, 3))
    np.testing.assert_allclose(gradient, np.einsum("nik,nk->ni", weighted, value), atol=1e-9)
    np.testing.assert_allclose(hessian, weighted @ jacobian, atol=1e-9)
    gradient += stops(q)[0]
    assert np.abs(gradient).max() < 0.05


def strained(c: Coupling, data: mujoco.MjData) -> Array:
    exo, own = data.body(c.exo_body), data.body(c.body)
    moved, turned, _, _ = strain(c, exo.xpos, exo.xmat.reshape(3, 3), own.xpos, own.xmat.reshape(3, 3))
    return np.concatenate([moved, turned])


@pytest.mark.parametrize("side", ["l", "r"])
def test_compiled_strains_are_those_of_the_couplings_on_the_model(side: str) -> None:
    rng, size, model = np.random.default_rng(8), fit_wearer(Person()), MODELS[0]
    data, leg, pelvis = mujoco.MjData(model), ExoLeg(size, side), model.body("pelvis").id
    for _ in range(5):
        data.qpos[7:] = rng.uniform(-0.4, 0.4, model.nq - 7)
        mujoco.mj_kinematics(model, data)
        R = data.xmat[pelvis].reshape(3, 3)
        body = {part: data.body(f"{part}_{side}") for part in ("thigh", "shank", "foot")}
        held = LegPose(
            p={part: ((b.xpos - data.xpos[pelvis]) @ R)[None] for part, b in body.items()},
            R={part: (R.T @ b.xmat.reshape(3, 3))[None] for part, b in body.items()},
        )
        q = np.array([data.joint(f"{joint}_{side}").qpos for joint in EXO_LEG_JOINTS]).T
        wanted = np.concatenate([strained(c, data) for c in exo_couplings(size) if c.name.endswith(f"_{side}")])
        np.testing.assert_allclose(leg.strains(q, held)[0][0], wanted, atol=1e-9)


def test_compiled_stops_are_the_stops() -> None:
    leg = ExoLeg(fit_wearer(Person()), "l").kernel
    for q in np.linspace(RANGE_RAD[:, 0] - 0.05, RANGE_RAD[:, 1] + 0.05, 40):
        compiled = np.array([stop_torque(leg, j, angle) for j, angle in enumerate(q)]).T
        np.testing.assert_allclose(compiled, stops(q), rtol=1e-9, atol=1e-9)


def moving(rng: np.random.Generator) -> BodyState:
    return BodyState(
        p=rng.normal(0, 0.05, 3),
        R=Rotation.from_rotvec(rng.normal(0, 0.2, 3)).as_matrix(),
        v=rng.normal(0, 1, 3),
        w=rng.normal(0, 1, 3),
    )


def energy(c: Coupling, exo: tuple[Array, Array], body: tuple[Array, Array]) -> float:
    moved, turned, _, _ = strain(c, *exo, *body)
    return float(0.5 * (moved @ c.law[0] @ moved + turned @ c.law[2] @ turned))


def after(pose: BodyState, dt: float) -> tuple[Array, Array]:
    return pose.p + dt * pose.v, Rotation.from_rotvec(dt * pose.w).as_matrix() @ pose.R


@pytest.mark.parametrize("name", ["thigh_l", "shank_r", "heel_l"])
def test_wrench_is_the_gradient_of_the_energy(name: str) -> None:
    """The power that both bodies lose is the growth of the energy (no damping), whatever the motion."""
    rng, h = np.random.default_rng(5), 1e-6
    c = next(c for c in exo_couplings(fit_wearer(Person())) if c.name == name)
    c = replace(c, law=c.law * np.array([1.0, 0.0, 1.0, 0.0])[:, None, None])
    for _ in range(20):
        exo, body = moving(rng), moving(rng)
        force, torque, point = wrench(c, exo, body)
        power = -(force @ (exo.v + np.cross(exo.w, point - exo.p)) + torque @ exo.w)
        power += force @ (body.v + np.cross(body.w, point - body.p)) + torque @ body.w
        grown = energy(c, after(exo, h), after(body, h)) - energy(c, after(exo, -h), after(body, -h))
        assert power == pytest.approx(grown / (2 * h), rel=1e-5, abs=1e-5)


def test_damping_takes_energy_away() -> None:
    rng = np.random.default_rng(6)
    for c in exo_couplings(fit_wearer(Person())):
        damper = replace(c, law=c.law * np.array([0.0, 1.0, 0.0, 1.0])[:, None, None])
        for _ in range(10):
            exo, body = moving(rng), moving(rng)
            force, torque, point = wrench(damper, exo, body)
            relative = body.v + np.cross(body.w, point - body.p) - exo.v - np.cross(exo.w, point - exo.p)
            assert force @ relative + torque @ (body.w - exo.w) > 0.0


@pytest.mark.parametrize("forward", [0.01, -0.01])
def test_limb_that_pushes_forward_presses_the_front_cell(forward: float) -> None:
    cuff: Coupling = next(c for c in exo_couplings(fit_wearer(Person())) if c.name == "thigh_l")
    still = BodyState(p=np.zeros(3), R=np.eye(3), v=np.zeros(3), w=np.zeros(3))
    limb = replace(still, p=cuff.p_in_exo - cuff.p_in_body + [forward, 0.0, 0.03])
    force, _, _ = wrench(cuff, still, limb)
    np.testing.assert_allclose(force, [4000.0 * forward, 0.0, 0.0], atol=1e-9)  # on the frame; it slides along the limb
    worn = sensor_rig(replace(config("level"), ideal=True)).sensors["/exo/thigh_l/interaction"]
    pair = InteractionModel(worn.calibration, worn.part, Noise.of_topic(1, "x"))
    front, back = pair.read(np.array([0]), force[:1]).columns["force"][0]
    assert (front > back) == (forward > 0)


@pytest.fixture(scope="module")
def level() -> Twin:
    return Twin(config("level", sensors=()), 7)


@pytest.fixture(scope="module", params=list(ROUTES))
def walk(request: pytest.FixtureRequest, level: Twin) -> Twin:
    return level if request.param == "level" else Twin(config(request.param, sensors=()), 7)


def test_walk_keeps_within_the_stops_and_the_cuffs_stay_gentle(walk: Twin) -> None:
    motion = Playback(walk.model, walk.reference).motion(np.arange(0, int(walk.duration_s * 1e9), 5_000_000))
    for i, joint in enumerate(EXO_LEG_JOINTS):
        for side in "lr":
            angle = motion.angle[f"{joint}_{side}"]
            # the stops' rubber gives 0.7 deg on most walks and 1.3 at the hip on the 14 deg ramp
            assert RANGE_RAD[i, 0] - np.radians(1.5) < angle.min(), joint
            assert angle.max() < RANGE_RAD[i, 1] + np.radians(1.5), joint
    assert set(motion.cuff_force) == {f"{part}_{side}" for part in ("thigh", "shank") for side in "lr"}
    for place, force in motion.cuff_force.items():
        assert 10.0 < np.abs(force).max() < 150.0, place


def test_a_foot_that_lies_flat_carries_the_exoskeletons_foot_with_it(walk: Twin) -> None:
    motion = Playback(walk.model, walk.reference).motion(np.arange(0, int(walk.duration_s * 1e9), 5_000_000))
    for side in "lr":
        feet = [motion.tracks[f"{name}_{side}"].rotation for name in ("foot", "exo_foot")]
        tilt = np.degrees(np.arccos((feet[0].inv() * feet[1]).as_matrix()[:, 2, 2]))
        flat = np.abs(walk.reference.pitch(side, motion.t_ns * 1e-9)) < 1e-3
        assert np.median(tilt[flat]) < 1.0
        assert tilt[flat].max() < 3.0


def test_couplings_carry_the_legs_of_the_exoskeleton(level: Twin) -> None:
    """Without modules inverse dynamics leaves nothing to the exoskeleton's joints: cuffs and holder do it all."""
    twin = level
    playback = Playback(twin.model, twin.reference)
    t_ns = np.arange(0, int(twin.duration_s * 1e9), 10_000_000)
    torque = playback.loads(t_ns, playback.motion(t_ns)).joint_torque
    names = twin.reference.coordinates.names[6:]
    own = [i for i, name in enumerate(names) if name.startswith("exo_") and "dorsiflexion" not in name]  # has its stop
    assert (
        np.sqrt((torque[:, own] ** 2).mean(axis=0)).max() < 0.9
    )  # N m; the hip, of some 10, in the jolts of landings at speed


def test_forward_simulation_of_the_legs_follows_the_plan(level: Twin) -> None:
    """The legs of the exoskeleton, simulated in steps of 1 ms on the walking wearer, stay where they are planned."""
    twin = level
    model, dt, start = twin.model, 1e-3, 3.0  # a whole stride, after the steps from standing
    own = np.array([model.joint(f"{j}_{s}").dofadr[0] for s in "lr" for j in EXO_LEG_JOINTS])
    bodies = [(c, model.body(c.exo_body).id, model.body(c.body).id) for c in exo_couplings(twin.size)]
    q, v, a = twin.reference.state(np.arange(start, start + 1.5, dt))
    data, needed, full = mujoco.MjData(model), np.empty(model.nv), np.empty((model.nv, model.nv))
    angle, speed, away = q[0, own + 1], v[0, own], []

    def pose(body: int) -> BodyState:
        twist = np.empty(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 0)
        return BodyState(p=data.xpos[body], R=data.xmat[body].reshape(3, 3), v=twist[3:], w=twist[:3])

    for i in range(len(q)):
        away.append(angle - q[i, own + 1])
        data.qpos, data.qvel, data.qacc = q[i], v[i], a[i]
        data.qpos[own + 1], data.qvel[own], data.qacc[own] = angle, speed, 0.0
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, needed)
        mujoco.mj_fullM(model, data, full)
        given = np.zeros(model.nv)
        for c, exo, body in bodies:
            force, torque, point = wrench(c, pose(exo), pose(body))
            mujoco.mj_applyFT(model, data, force, torque, point, exo, given)
        push = (given - needed)[own] - stops(angle.reshape(2, 6))[0].ravel()
        speed = speed + dt * np.linalg.solve(full[np.ix_(own, own)], push)
        angle = angle + dt * speed
    # the ankle, when the foot leaves: its stop gives way later than the plan, which knows no speeds, has it
    assert np.degrees(np.abs(away).max()) < 1.5
    assert np.degrees(np.std(away, axis=0).max()) < 0.30


def test_idle_modules_load_the_cuffs(level: Twin) -> None:
    peak = {}
    for mode, twin in enumerate((level, Twin(config("level", Exo(mode=1), sensors=()), 7))):
        motion = Playback(twin.model, twin.reference).motion(np.arange(0, int(twin.duration_s * 1e9), 10_000_000))
        peak[mode] = {place: np.abs(force).max() for place, force in motion.cuff_force.items()}
    assert all(peak[1][place] > 1.3 * peak[0][place] for place in peak[0])


@pytest.mark.parametrize("exo", [Exo(mode=1), Exo(mode=3, joints=("hip_l", "knee_l"))])
def test_a_simulated_walk_with_unpowered_modules_needs_no_assist(exo: Exo) -> None:
    twin = Twin(
        TwinConfig(
            name="modules",
            route=Route(segments=(Level(length_m=2.0),)),
            gait=Gait(stand_s=0.5),
            exo=exo,
            physics="dynamic",
            sensors=(),
        ),
        4,
    )
    walk = twin.walk
    assert isinstance(walk, SimulatedWalk)
    assert walk.fell_at is None
    assert np.abs(walk.torque[:, :6]).max() == 0.0


def test_person_without_exoskeleton_walks_without_its_streams() -> None:
    bare = config("level", None, sensors=("foot_imu", "insole", *EXO_GROUPS))
    assert {sensor.mount.body for sensor in standard_rig(bare).others.values()} == {"foot_l", "foot_r"}
    twin = Twin(bare, 1)
    names = {twin.model.body(i).name for i in range(twin.model.nbody)}
    assert not any(name.startswith("exo_") for name in names)
    topics = {item.topic for items in twin.blocks() for item in items if isinstance(item, Block)}
    assert "/foot_l/imu" in topics
    assert not any(topic.startswith("/exo/") for topic in topics)
    assert float(twin.model.body_subtreemass[0]) == pytest.approx(bare.person.mass_kg, rel=2e-3)


def test_people_of_the_papers_are_in_the_catalogue() -> None:
    for name, (sex, _, height, mass, _, shoe) in PAPER["subjects"].items():
        person = PEOPLE[f"shim_{name.lower()}"]
        assert (person.sex[0].upper(), person.height_m, person.mass_kg) == (sex, height, mass)
        assert person.shoe_m == pytest.approx(shoe * 1e-3)
    for group, heights in published("zhao2023")["subjects"].items():
        for i, cm in enumerate(heights, start=1):
            person = PEOPLE[f"zhao_{group.lower()}_{i}"]
            assert person.height_m == pytest.approx(cm / 100)
            assert person.mass_kg / person.height_m**2 == pytest.approx(22.5, abs=0.02)
    assert len(PEOPLE) == 22
    assert all(fit_wearer(person).shoe.toe_tip_x > 0.15 for person in PEOPLE.values())


def test_shoe_size_out_of_range_is_refused() -> None:
    assert fit_wearer(Person(shoe_m=0.28)).body.shoe_length_m > fit_wearer(Person(shoe_m=0.25)).body.shoe_length_m
    with pytest.raises(ConfigError, match=r"0\.20-0\.32"):
        fit_wearer(Person(shoe_m=0.4))
