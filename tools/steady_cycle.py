"""One periodic stride of steady level walking in a given style, solved quickly for a fit.

It follows the planner's steps (foot paths, load, posture, zero-moment point) with periodic ends.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import mujoco
import numpy as np

from stridetwin.sim.config import SIDES, Gaze, Person
from stridetwin.sim.gait.body_sway import SwayParameters, plan_sway
from stridetwin.sim.gait.foot_path import FootPath, foot_path
from stridetwin.sim.gait.footsteps import HALF_STEP_WIDTH_M, TOE_OUT_RAD, Footstep, Rhythm
from stridetwin.sim.gait.load import cop_travel, load_shares, pressure_centres
from stridetwin.sim.gait.pelvis import fit_pelvis_height, level_height, max_pelvis_height
from stridetwin.sim.gait.posture import Posture, plan_posture
from stridetwin.sim.gait.reference import solve_legs, stack_coordinates, zero_moment_point
from stridetwin.sim.gait.style import Style, leg_length
from stridetwin.sim.kinematics.coordinates import Coordinates
from stridetwin.sim.wearer.body import add_wearer, compile_model
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.streams.algebra.arrays import from_euler, from_quaternion, rot_z
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Array
from stridetwin.streams.terrain_truth import Strip

SAMPLES = 100  # per stride
_COM_ABOVE_PELVIS_M = 0.03
_FIRST = 2  # first step of the evaluated stride
_GROUND = (Strip(s0=-100.0, s1=100.0, z0=0.0, z1=0.0, terrain="level"),)
# Least flexion of the knee, which determines how high the pelvis may be. It is that of the planner and more, because
# the steps of a walk differ and its pelvis is lower for some time around every leg that would be too straight
_BENT_RAD = np.radians(8.0)
# a walker without any difference from the mean one, whose steps are all alike
_MEAN_WALKER = SwayParameters(person_log_sd=0.0, rise_log_sd=0.0, person_phase_deg=0.0, unevenness=0.0, step_sd=0.0)


class Walker:
    """A person without an exoskeleton, and the model for inverse dynamics."""

    def __init__(self, person: Person) -> None:
        spec = mujoco.MjSpec()
        self.size: Wearer = add_wearer(spec, person, None)
        self.model: mujoco.MjModel = compile_model(spec)
        self.mass_kg = float(self.model.body_subtreemass[0])
        self.layout = Coordinates.of(self.model)
        self.leg_m = leg_length(self.size)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cycle:
    """A stride of the left foot from touch-down to touch-down, `SAMPLES` rows.

    Attributes:
        angles_deg: hip, knee and ankle flexion by name.
        moments: Internal extension (plantarflexion) moments, N m/kg, by the same names.
        pelvis_tilt_deg: (N,) anterior tilt.
        rise: Difference between the highest and the lowest height of the pelvis, leg lengths.
        load: Vertical ground reaction of the foot, body weights.
        total: Of both feet.
        sole: Lowest point of the sole in swing above the ground, m.
        heel_speed: Of the heel, m/s.
        heel_acceleration: Its magnitude, m/s².
        pitch_rate: Of the foot, rad/s.
        stretch: How far the foot is out of the leg's reach, m.
        lowered: How much lower the pelvis is than the style says, because the legs would be too straight, m.
        over_ground: (N, 2) pelvis path relative to steady motion, m, to start the next solution from.
        zmp_error: Largest distance of the zero-moment point from the desired one, m.
        stride_s: Duration of the stride.
        leg_m: Hip centre to sole.
    """

    angles_deg: dict[str, Array]
    moments: dict[str, Array]
    pelvis_tilt_deg: Array
    rise: float
    load: Array
    total: Array
    sole: Array
    heel_speed: Array
    heel_acceleration: Array
    pitch_rate: Array
    stretch: Array
    lowered: Array
    over_ground: Array
    zmp_error: float
    stride_s: float
    leg_m: float


def steady_cycle(
    walker: Walker, style: Style, step_m: float, step_s: float, start: Array | None = None, rounds: int = 2
) -> Cycle:
    """Solves a stride; `start` is the `over_ground` of a similar one, `rounds` the number of corrections."""
    size, layout = walker.size, walker.layout
    steps = _footsteps(style, step_m, step_s)
    wide = np.arange(-SAMPLES, 2 * SAMPLES + 1) * (2 * step_s / SAMPLES) + _FIRST * step_s
    mid = slice(SAMPLES, 2 * SAMPLES + 1)
    t = wide[mid]
    wide_paths = {side: foot_path(steps[side], size, wide, _flat) for side in SIDES}
    wide_shares = load_shares(steps, wide)
    rhythm = Rhythm.of(steps)
    rng = np.random.default_rng(0)  # nothing is drawn from it that has an effect
    sway = plan_sway(rhythm, walker.leg_m, rng, _MEAN_WALKER)
    mean, wave, _ = level_height(rhythm, wide, walker.leg_m, sway.rise)
    pose = _cut_posture(plan_posture(rhythm, wide_paths, walker.leg_m, wide, _GROUND, Gaze(), sway, wave, rng), mid)
    paths = {side: _cut_path(wide_paths[side], mid) for side in SIDES}
    shares = {side: wide_shares[side][mid] for side in SIDES}
    with np.errstate(invalid="ignore"):  # of steps beyond the ends, which have no rows
        travels = {side: cop_travel(steps[side], wide, np.zeros(len(wide)))[mid] for side in SIDES}
    centres = {
        side: pressure_centres(steps[side], size.shoe, t, travels[side], paths[side].pitch, _flat) for side in SIDES
    }
    wanted = sum(shares[side][:, None] * centres[side] for side in SIDES)[:, :2]
    drift = np.outer(t, [step_m / step_s, 0.0])
    dt = t[1] - t[0]
    kappa = np.full(len(t), (walker.leg_m + _COM_ABOVE_PELVIS_M) / NOMINAL_GRAVITY_MPS2)
    path = _periodic_cart_table((wanted - drift)[:-1], kappa[:-1], dt) if start is None else start
    R_pelvis = from_euler(pose.pelvis)
    for round_ in range(rounds + 1):
        p_pelvis = np.column_stack([np.vstack([path, path[:1]]) + drift, np.zeros(len(t))])
        limit = max_pelvis_height(size, p_pelvis, R_pelvis, paths, np.full(len(t), _BENT_RAD)) - wave[mid]
        smooth = _fit_periodic_height(mean[mid], limit, dt)
        height = p_pelvis[:, 2] = wave[mid] + smooth
        legs_ = solve_legs(size, p_pelvis, R_pelvis, paths)
        x = stack_coordinates(size, layout, p_pelvis, pose, legs_, {}, paths)
        x[:, :2] -= drift
        x, dx, ddx = _periodic_derivatives(x[:-1], dt)
        x[:, :2] += drift
        dx[:, 0] += step_m / step_s
        q, v, a = layout.to_mujoco(x, dx, ddx)
        needed, com_z = _inverse_dynamics(walker.model, q, v, a)
        moment = np.einsum("nij,nj->ni", from_quaternion(q[:, 3:7]), needed[:, 3:6])
        zmp, kappa = zero_moment_point(q[:, :3], needed[:, :3], moment, com_z, np.zeros(len(t)), walker.mass_kg)
        error = wanted - zmp
        if round_ < rounds:
            path = path + _periodic_cart_table(error[:-1], kappa[:-1], dt)
    weight = walker.mass_kg * NOMINAL_GRAVITY_MPS2
    load = shares["l"] * needed[:, 2]
    names = layout.names
    side_angles = {j: np.degrees(x[:, names.index(f"{n}_l")]) for j, n in _JOINTS.items()}
    return Cycle(
        angles_deg={j: angle[:-1] for j, angle in side_angles.items()},
        moments=_moments(
            walker,
            q[:-1],
            needed[:-1],
            load[:-1, None] * (needed[:-1, :3] / needed[:-1, 2:3]),
            (centres["l"][:, :2] + zmp - wanted)[:-1],
        ),
        pelvis_tilt_deg=np.degrees(pose.pelvis[:-1, 1]),
        rise=float(np.ptp(height)) / walker.leg_m,
        load=load[:-1] / weight,
        total=needed[:-1, 2] / weight,
        sole=_lowest(size, paths["l"])[:-1],
        heel_speed=_motion_of_heel(size, wide_paths["l"], wide)[0][mid][:-1],
        heel_acceleration=_motion_of_heel(size, wide_paths["l"], wide)[1][mid][:-1],
        pitch_rate=np.gradient(wide_paths["l"].pitch, wide)[mid][:-1],
        stretch=legs_["l"].stretch[:-1],
        lowered=(mean[mid] - smooth)[:-1],
        over_ground=path,
        zmp_error=float(np.abs(error).max()),
        stride_s=2.0 * step_s,
        leg_m=walker.leg_m,
    )


_JOINTS = {"hip": "hip_flexion", "knee": "knee_flexion", "ankle": "ankle_dorsiflexion"}


def _footsteps(style: Style, step_m: float, step_s: float) -> dict[str, list[Footstep]]:
    steps: dict[str, list[Footstep]] = {side: [] for side in SIDES}
    share = float(style.double_support)
    for k in range(-2, _FIRST + 6):
        foot, sign = ("l", 1.0) if k % 2 == 0 else ("r", -1.0)
        steps[foot].append(
            Footstep(
                foot=foot,
                p_foot_in_world=np.array([k * step_m, sign * HALF_STEP_WIDTH_M, 0.0]),
                R_world_sole=rot_z(np.array(sign * TOE_OUT_RAD)),
                s=k * step_m,
                heading=0.0,
                slope=0.0,
                rise=0.0,
                fall=0.0,
                terrain="level",
                mode="LG",
                arrival="heel",
                departure="push",
                t_touch=k * step_s if k >= 0 else -np.inf,
                t_off=(k + 1 + share) * step_s,
                style=style,
            )
        )
    return steps


def _flat(xy: Array) -> Array:
    return np.zeros(np.shape(xy)[:-1])


def _cut_path(path: FootPath, rows: slice) -> FootPath:
    return FootPath(**{f.name: getattr(path, f.name)[rows] for f in fields(path)})


def _cut_posture(pose: Posture, rows: slice) -> Posture:
    return Posture(pelvis=pose.pelvis[rows], joints={name: value[rows] for name, value in pose.joints.items()})


def _periodic_derivatives(x: Array, dt: float) -> tuple[Array, Array, Array]:
    """Columns of one period with their first row again at the end, and their spectral derivatives."""
    spectrum = np.fft.rfft(x, axis=0)
    turn = 2j * np.pi * np.fft.rfftfreq(len(x), dt)[:, None]
    columns = (np.fft.irfft(turn**k * spectrum, len(x), axis=0) for k in range(3))
    x0, x1, x2 = (np.vstack([c, c[:1]]) for c in columns)
    return x0, x1, x2


def _fit_periodic_height(goal: Array, limit: Array, dt: float) -> Array:
    """`fit_pelvis_height` of a stride that repeats; the last row is the first one again."""
    n = len(goal) - 1
    goal3, limit3 = (np.append(np.tile(x[:-1], 3), x[0]) for x in (goal, limit))
    return fit_pelvis_height(goal3, limit3, dt)[n : 2 * n + 1]


def _periodic_cart_table(wanted: Array, kappa: Array, dt: float) -> Array:
    """Periodic path c whose zero-moment point c - kappa c'' is the desired one (spectral second derivative)."""
    n = len(wanted)
    omega = 2 * np.pi * np.fft.fftfreq(n, dt)
    second = np.real(np.fft.ifft(-(omega**2)[:, None] * np.fft.fft(np.eye(n), axis=0), axis=0))
    return np.linalg.solve(np.eye(n) - kappa[:, None] * second, wanted)


def _lowest(size: Wearer, path: FootPath) -> Array:
    shoe = size.shoe
    heel = np.array([shoe.heel_back_x, 0.0, 0.0])
    hinge = np.array([shoe.toe_hinge_x, 0.0, shoe.toe_hinge_z])
    ball = np.array([shoe.toe_hinge_x, 0.0, 0.0])
    p, R = path.p_foot_in_world, path.R_world_foot
    along = shoe.toe_tip_x - shoe.toe_hinge_x
    tip_pitch = path.pitch - path.toe_extension
    tip_z = (p + R @ hinge)[:, 2] - along * np.sin(tip_pitch) - shoe.toe_hinge_z * np.cos(tip_pitch)
    return np.minimum.reduce([(p + R @ heel)[:, 2], (p + R @ ball)[:, 2], tip_z])


def _motion_of_heel(size: Wearer, path: FootPath, t: Array) -> tuple[Array, Array]:
    """(N,) m/s and (N,) m/s², speed of the heel and magnitude of its acceleration."""
    heel = path.p_foot_in_world + path.R_world_foot @ np.array([size.shoe.heel_back_x, 0.0, 0.05])
    velocity = np.gradient(heel, t, axis=0)
    return np.linalg.norm(velocity, axis=1), np.linalg.norm(np.gradient(velocity, t, axis=0), axis=1)


def _inverse_dynamics(model: mujoco.MjModel, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """(N, nv) generalised forces that the motion needs without contacts, and (N,) height of the centre of mass."""
    data = mujoco.MjData(model)
    needed, com_z = np.empty((len(q), model.nv)), np.empty(len(q))
    for i in range(len(q)):
        data.qpos, data.qvel, data.qacc = q[i], v[i], a[i]
        mujoco.mj_inverse(model, data)
        needed[i], com_z[i] = data.qfrc_inverse, data.subtree_com[0, 2]
    return needed, com_z


def _moments(walker: Walker, q: Array, needed: Array, force: Array, cop: Array) -> dict[str, Array]:
    """Extension moments of the left leg: inverse dynamics minus the moments of the ground reaction about each joint."""
    model, data = walker.model, mujoco.MjData(walker.model)
    foot = model.body("foot_l").id
    dofs = {joint: model.joint(f"{name}_l").dofadr[0] for joint, name in _JOINTS.items()}
    J = np.empty((3, model.nv))
    torque = {joint: np.empty(len(q)) for joint in dofs}
    for i in range(len(q)):
        data.qpos = q[i]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jac(model, data, J, None, np.append(cop[i], 0.0), foot)
        for joint, dof in dofs.items():
            torque[joint][i] = -(needed[i, dof] - force[i] @ J[:, dof]) / walker.mass_kg
    return torque
