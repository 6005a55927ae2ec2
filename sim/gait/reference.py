"""The reference motion: every coordinate of the wearer as a smooth function of time.

Route -> footsteps -> foot paths -> pelvis path with a feasible zero-moment point -> leg inverse kinematics ->
exoskeleton -> quintic splines through all coordinates. The zero-moment point is first that of a linear inverted
pendulum, then corrected by the inverse dynamics of the whole body.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from stridetwin.sim.acts import HoldRail
from stridetwin.sim.config import SIDES, TwinConfig
from stridetwin.sim.gait.body_sway import plan_sway
from stridetwin.sim.gait.exo_fit import ExoLeg, fit_leg, leg_pose, solve_leg_dynamics
from stridetwin.sim.gait.foot_path import FootPath, foot_path, with_heel_rise
from stridetwin.sim.gait.footsteps import Footstep, Rhythm, plan_footsteps
from stridetwin.sim.gait.hand_on_rail import check_reach, hold_rails
from stridetwin.sim.gait.leg_ik import LegAngles, solve_leg
from stridetwin.sim.gait.load import (
    add_quiet_stance,
    cop_travel,
    in_flight,
    load_shares,
    pressure_centres,
    standing_time,
)
from stridetwin.sim.gait.pelvis import (
    HARD_MIN_KNEE_RAD,
    fit_pelvis_height,
    level_height,
    max_pelvis_height,
    min_knee_flexion,
    solve_cart_table,
)
from stridetwin.sim.gait.posture import Posture, plan_posture
from stridetwin.sim.gait.settled_soles import settle_soles
from stridetwin.sim.gait.style import leg_length
from stridetwin.sim.gait.swing_variability import set_down_softly, vary_swings
from stridetwin.sim.kinematics.coordinates import Coordinates
from stridetwin.sim.kinematics.rigid_tree import Tree, root_wrench
from stridetwin.sim.kinematics.smooth import ease
from stridetwin.sim.walk import GivenWalk
from stridetwin.sim.wearer.body import LEG_JOINTS
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.sim.wearer.exo_couplings import leg_frame
from stridetwin.sim.world.rails import Rail
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.algebra.arrays import from_euler, rot_x, rot_y, rot_z
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array


def solve_legs(size: Wearer, p_pelvis: Array, R_pelvis: Array, paths: Mapping[str, FootPath]) -> dict[str, LegAngles]:
    """Angles of both legs that bring the feet to their paths, by side; `LegAngles.stretch` reports feet out of reach.

    Args:
        size: Wearer.
        p_pelvis: (N, 3) m, pelvis in the world.
        R_pelvis: (N, 3, 3) its rotation.
        paths: Paths of the feet by side.
    """
    return {
        side: solve_leg(
            size, side, p_pelvis, R_pelvis, paths[side].p_foot_in_world, paths[side].R_world_foot, HARD_MIN_KNEE_RAD
        )
        for side in SIDES
    }


def stack_coordinates(
    size: Wearer,
    layout: Coordinates,
    p_pelvis: Array,
    pose: Posture,
    legs_: Mapping[str, LegAngles],
    exo: Mapping[str, Array],
    paths: Mapping[str, FootPath],
) -> Array:
    """(N, names) generalised coordinates in the order of `layout.names`.

    Args:
        size: Wearer.
        layout: Names and order of the coordinates.
        p_pelvis: (N, 3) m, pelvis in the world.
        pose: Orientation of the pelvis, and angles of trunk, neck and arms.
        legs_: Angles of the legs by side.
        exo: (N, J) rad, angles of the exoskeleton's legs by side; empty without exoskeleton.
        paths: Paths of the feet, for the extension of the toes.
    """
    # (N,) values by name: first position (3) and yaw, pitch and roll (3) of the root
    columns = dict(zip(layout.ROOT, np.column_stack([p_pelvis, pose.pelvis]).T))
    columns |= pose.joints
    for side in SIDES:
        # `LegAngles` has a field for each joint but the last, the toes' hinge, which follows from the foot's path
        for joint in LEG_JOINTS[:-1]:
            columns[f"{joint}_{side}"] = getattr(legs_[side], joint)
        columns[f"toe_extension_{side}"] = paths[side].toe_extension
        if side in exo:
            columns |= dict(zip(leg_frame(size, side).joints, exo[side].T))
    return np.column_stack([columns[name] for name in layout.names])


def zero_moment_point(
    p_root: Array, force: Array, moment: Array, com_z: Array, z: Array, mass: float
) -> tuple[Array, Array]:
    """Zero-moment point of a motion: the point of the ground about which the needed wrench has no horizontal moment.

    x = x_root + ((z − z_root) F_x − M_y) / F_z and y = y_root + ((z − z_root) F_y + M_x) / F_z.

    Args:
        p_root: (N, 3) m, root in the world.
        force: (N, 3) N, external force F that the motion needs, world axes (`rigid_tree.root_wrench`).
        moment: (N, 3) N m, its moment M about the root.
        com_z: (N,) height of the centre of mass, m.
        z: (N,) height of the ground, m.
        mass: Of the whole body, kg.

    Returns:
        (N, 2) zero-moment point at height z, m; (N,) s², κ = m (z_com − z) / F_z for its correction by
        `pelvis.solve_cart_table`.
    """
    x = p_root[:, 0] + ((z - p_root[:, 2]) * force[:, 0] - moment[:, 1]) / force[:, 2]
    y = p_root[:, 1] + ((z - p_root[:, 2]) * force[:, 1] + moment[:, 0]) / force[:, 2]
    return np.stack([x, y], -1), mass * (com_z - z) / force[:, 2]


GRID_S = 0.005  # step of the time grid of a planned walk
_ZMP_ROUNDS = 6  # rounds of the correction by the zero-moment point
# When the frame's weight is added to its couplings: later rounds correct its effect. As the couplings are stiff, the
# frame follows the last shift of the pelvis in the last round.
_WEIGHED_ROUND = 3
_SETTLING_ROUNDS = 2  # linearisations of the weighed frame in its first fit
_HEEL_ROUNDS = (0, 1, 2)  # after which the heels may rise, because the pelvis determines how far the ankles bend
_ZMP_GAIN = 0.85  # the height follows the legs' reach, which reacts to the correction: full steps overshoot
_STRIDE = 2  # half the grid's rate is enough for the correction and the frame's angles
_ROUGH_STRIDE = 4  # and a quarter for the frame's first fit, which affects the correction alone
_COM_ABOVE_PELVIS_M = 0.03  # height of the centre of mass over the pelvis, for the first path of the pelvis
_LEAST_FORCE = 0.15  # share of the body's weight, above which the zero-moment point counts
_REACH_TOLERANCE_M = 5e-4  # a foot farther out of reach is an error


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference(GivenWalk):
    """A planned walk; its splines are quintic.

    Attributes:
        steps: Footsteps of each foot in order of time, initial stance first.
        loads: Cubic splines of share (1) and planned centre of pressure (3) of the left, then the right foot.
        paths: Foot paths on the grid, for the phases.
    """

    steps: dict[str, list[Footstep]]
    loads: BSpline
    paths: dict[str, FootPath]

    def pitch(self, side: str, t: NDArray[np.floating]) -> Array:
        """(N,) rad, planned pitch of a foot relative to the ground under it at (N,) s, toes down positive."""
        return np.interp(t, self.grid, self.paths[side].pitch)

    def contact_shares(self, t: NDArray[np.floating]) -> Array:
        """(N, 8) at (N,) s: share of the load and centre of pressure (3, m, world) of the left, then the right foot."""
        loads = np.asarray(self.loads(t))
        if any(step.is_run for steps in self.steps.values() for step in steps):
            flight = in_flight(self.steps, np.asarray(t, dtype=np.float64))
            loads[flight, 0] = loads[flight, 4] = 0.0  # the shares of both feet
        return loads

    def progress(self, t: NDArray[np.floating]) -> Array:
        """(N,) m, arc length along the way at (N,) s, midway between the feet."""
        return np.interp(t, self.grid, (self.paths["l"].s + self.paths["r"].s) / 2)


def plan_reference(
    config: TwinConfig, model: mujoco.MjModel, size: Wearer, terrain: Terrain, rng: np.random.Generator
) -> Reference:
    """Plans the whole walk for a compiled model of the wearer on the terrain.

    The path of the pelvis is found in `_ZMP_ROUNDS` rounds. Each one fits the height of the pelvis to the reach of the
    legs, solves the legs, and corrects the horizontal path by the error of the whole body's zero-moment point. In some
    rounds the heels may rise farther, or the exoskeleton is fitted again.

    Args:
        config: Scenario.
        model: Compiled model of the wearer on the terrain.
        size: Dimensions of the wearer.
        terrain: Ground.
        rng: Varies the steps, draws a wandering gaze, and spawns the stream of the walker's sway.

    Raises:
        StrideTwinError: The legs cannot reach the footsteps.
    """
    footsteps, duration = plan_footsteps(terrain.layout, size, config.gait, rng, config.route.width_m / 2)
    if config.route.unevenness_m:
        footsteps = settle_soles(footsteps, size.shoe, terrain)
    # swings are drawn from a stream of their own, which leaves places and times of the steps as they are
    footsteps = vary_swings(footsteps, config.gait, rng.spawn(1)[0])
    if config.physics == "dynamic":
        footsteps = set_down_softly(footsteps)
    steps = {side: [s for s in footsteps if s.foot == side] for side in SIDES}
    # the grid of all quantities; it extends beyond the walk, so that boundary effects of the splines stay outside
    t = np.arange(-0.5, duration + 0.5 + GRID_S, GRID_S)
    t = t[: len(t) - (len(t) - 1) % _ROUGH_STRIDE]  # the coarse grids end with the fine one
    # by side: paths of the feet, shares of the load, centres of pressure along the foot, centres of pressure (N, 3);
    # `planned_zmp` (N, 3) is the centre of pressure of both feet together
    paths = {side: foot_path(steps[side], size, t, terrain.height) for side in SIDES}
    shares = add_quiet_stance(load_shares(steps, t), steps, t)
    standing, flight = standing_time(steps, t), in_flight(steps, t)
    travels = {side: cop_travel(steps[side], t, standing) for side in SIDES}
    centres, planned_zmp = _centres_of_pressure(steps, paths, shares, travels, size, t, terrain.height)
    rhythm, leg_m = Rhythm.of(steps), leg_length(size)
    # from a stream of its own, so that other draws do not depend on it
    sway = plan_sway(rhythm, leg_m, rng.spawn(1)[0])
    # height of the pelvis on the level (mean and oscillation), and the share of level ground
    mean, wave, level = level_height(rhythm, t, leg_m, sway.rise)
    pose = plan_posture(rhythm, paths, leg_m, t, terrain.profile, config.gait.gaze, sway, wave, rng)
    free_pose = pose  # without a hand on a rail
    held_rails = [act for act in config.gait.acts if isinstance(act, HoldRail)]
    rails = [Rail.along(act, terrain.layout) for act in held_rails]
    R_pelvis = from_euler(pose.pelvis)
    min_knee = min_knee_flexion(rhythm, t)

    # first path of the pelvis over the ground (N, 2): that of a pendulum of constant height; κ is its height divided by
    # gravity
    kappa = np.full(len(t), (leg_m + _COM_ABOVE_PELVIS_M) / -model.opt.gravity[2])
    over_ground = solve_cart_table(planned_zmp[:, :2], kappa, GRID_S)
    layout, tree = Coordinates.of(model), Tree.of(model)
    exo: dict[str, Array] = {}
    for round_ in range(_ZMP_ROUNDS):
        # height of the pelvis below the reach of the legs, which depends on its horizontal path
        p_pelvis = np.column_stack([over_ground, np.zeros(len(t))])
        # the mean height is fitted, and the oscillation is added to it; off the level the goal is the limit itself
        limit = max_pelvis_height(size, p_pelvis, R_pelvis, paths, min_knee) - wave
        p_pelvis[:, 2] = wave + fit_pelvis_height(level * mean + (1.0 - level) * limit, limit, GRID_S)
        legs_ = solve_legs(size, p_pelvis, R_pelvis, paths)
        pose, gaps = hold_rails(held_rails, rails, model, free_pose, p_pelvis, t)
        if round_ == 0:  # expensive, so not in every round
            exo = _fit_exoskeleton(size, t, p_pelvis, R_pelvis, paths, legs_, _ROUGH_STRIDE)
        elif round_ in (_WEIGHED_ROUND, _ZMP_ROUNDS - 1):
            # with the frame's weight; the last round starts from the result of the earlier one
            start = exo if round_ > _WEIGHED_ROUND else None
            exo = _fit_exoskeleton(size, t, p_pelvis, R_pelvis, paths, legs_, _STRIDE, (model, layout, pose), start)
        splines = make_interp_spline(t, stack_coordinates(size, layout, p_pelvis, pose, legs_, exo, paths), k=5)
        if round_ < _ZMP_ROUNDS - 1:
            # zero-moment point of the whole body; its error corrects the path of the pelvis
            coarse = t[::_STRIDE]
            q, v, a = layout.evaluate(splines, coarse)
            force, moment, com = root_wrench(tree, q, v, a, model.opt.gravity)
            mass = float(tree.mass.sum())
            pressing = np.ones(len(coarse))
            if flight.any():  # a foot that hardly presses does not move the body by its place
                weight = -mass * model.opt.gravity[2]
                pressing = ease((force[:, 2] / weight - _LEAST_FORCE) / _LEAST_FORCE)
                force[:, 2] = np.maximum(force[:, 2], _LEAST_FORCE * weight)
            zmp, kappa = zero_moment_point(q[:, :3], force, moment, com[:, 2], planned_zmp[::_STRIDE, 2], mass)
            wrong = (planned_zmp[::_STRIDE, :2] - zmp) * pressing[:, None]
            error = solve_cart_table(wrong, kappa, _STRIDE * GRID_S)
            over_ground = over_ground + _ZMP_GAIN * make_interp_spline(coarse, error, k=5)(t)
        if round_ in _HEEL_ROUNDS:
            # the heels rise where the ankles would bend too far; the centres of pressure follow
            paths = {
                side: with_heel_rise(paths[side], steps[side], size.shoe, t, legs_[side].ankle_dorsiflexion)
                for side in SIDES
            }
            centres, planned_zmp = _centres_of_pressure(steps, paths, shares, travels, size, t, terrain.height)
    check_reach(held_rails, gaps)
    worst = max(float(leg.stretch.max()) for leg in legs_.values())  # m, by which a foot is out of reach
    if worst > _REACH_TOLERANCE_M:
        side = max(legs_, key=lambda s: legs_[s].stretch.max())
        when = t[legs_[side].stretch.argmax()]
        raise StrideTwinError(
            f"the {side} leg misses its footstep by {1e3 * worst:.1f} mm at {when:.2f} s: steps too long"
        )
    loads = np.column_stack([shares["l"], centres["l"], shares["r"], centres["r"]])
    return Reference(
        duration_s=duration,
        size=size,
        steps=steps,
        coordinates=layout,
        splines=splines,
        loads=make_interp_spline(t, loads, k=3),
        paths=paths,
        grid=t,
    )


def _centres_of_pressure(
    steps: dict[str, list[Footstep]],
    paths: dict[str, FootPath],
    shares: dict[str, Array],
    travels: dict[str, Array],
    size: Wearer,
    t: Array,
    height: Callable[[Array], Array],
) -> tuple[dict[str, Array], Array]:
    """Planned centres of pressure: under each foot, and of both feet together.

    Args:
        steps: Footsteps by side.
        paths: Paths of the feet by side.
        shares: (N,) share of the load by side.
        travels: (N,) centre of pressure along the foot by time alone, by side (`cop_travel`).
        size: Wearer.
        t: (N,) s.
        height: Height of the ground, m, at (..., 2) points of the world.

    Returns:
        (N, 3) m in the world, by side; (N, 3) m, their mean weighted by the shares.
    """
    centres = {
        side: pressure_centres(steps[side], size.shoe, t, travels[side], paths[side].pitch, height) for side in SIDES
    }
    return centres, np.sum([shares[side][:, None] * centres[side] for side in SIDES], axis=0)


def _fit_exoskeleton(
    size: Wearer,
    t: Array,
    p_pelvis: Array,
    R_pelvis: Array,
    paths: dict[str, FootPath],
    legs: dict[str, LegAngles],
    stride: int,
    weighing: tuple[mujoco.MjModel, Coordinates, Posture] | None = None,
    start: dict[str, Array] | None = None,
) -> dict[str, Array]:
    """(N, J) rad, angles of the exoskeleton's legs by side, for a motion of the wearer; empty without exoskeleton.

    They are computed at every `stride`-th instant and interpolated by quintic splines.

    Args:
        size: Wearer.
        t: (N,) uniform s.
        p_pelvis: (N, 3) m.
        R_pelvis: (N, 3, 3).
        paths: Paths of the feet by side.
        legs: Angles of the wearer's legs by side.
        stride: Step between the instants that are computed.
        weighing: Model, layout and posture, from which the frame's weight and inertia follow; None for weightless legs.
        start: (N, J) rad by side, result for a similar motion, from which the solution starts.
    """
    if size.exo is None:
        return {}
    k = slice(None, None, stride)  # rows of the instants that are computed
    to_pelvis = np.swapaxes(R_pelvis[k], 1, 2)  # world to pelvis
    # by side: statics of the exoskeleton's leg, pose of the wearer's leg, and (K, J) start values of the angles
    frames, wearers, coarse = {}, {}, {}
    for side in SIDES:
        sign, leg, path = (1.0 if side == "l" else -1.0), legs[side], paths[side]
        # thigh in the pelvis' frame, from the three angles of the hip
        R_thigh = rot_y(-leg.hip_flexion[k]) @ rot_x(-sign * leg.hip_adduction[k]) @ rot_z(-sign * leg.hip_rotation[k])
        p_foot = np.einsum("nij,nj->ni", to_pelvis, path.p_foot_in_world[k] - p_pelvis[k])
        wearers[side] = leg_pose(
            size, side, R_thigh, R_thigh @ rot_y(leg.knee_flexion[k]), p_foot, to_pelvis @ path.R_world_foot[k]
        )
        frames[side] = ExoLeg(size, side)
        coarse[side] = fit_leg(frames[side], wearers[side]) if start is None else start[side][k]
    # (N, J) by side, at all instants; they are the result without weight, and the motion about which weight acts
    fine = {side: make_interp_spline(t[k], coarse[side], k=5)(t) for side in SIDES}
    if weighing is None:
        return fine
    model, layout, pose = weighing
    # splines of all coordinates, with the legs of the exoskeleton
    splines = make_interp_spline(t, stack_coordinates(size, layout, p_pelvis, pose, legs, fine, paths), k=5)
    angles = solve_leg_dynamics(
        frames, coarse, wearers, model, layout, splines, t[k], _SETTLING_ROUNDS if start is None else 1
    )
    return {side: make_interp_spline(t[k], angles[side], k=5)(t) for side in SIDES}
