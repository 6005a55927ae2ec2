"""A recorded walk as functions of time, with its contacts, its progress along the way and the exoskeleton's legs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from stridetwin.sim.gait.exo_fit import ExoLeg, fit_leg, leg_pose, solve_leg_dynamics
from stridetwin.sim.kinematics.coordinates import Coordinates
from stridetwin.sim.kinematics.smooth import ease
from stridetwin.sim.motion.fit import SIDES, FittedWalk, track_feet
from stridetwin.sim.motion.rests import FootRest, FootTrack
from stridetwin.sim.walk import GivenWalk, Stance
from stridetwin.sim.wearer.dimensions import Shoe, Wearer
from stridetwin.sim.wearer.exo_couplings import leg_frame
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.samples import Array

_TRANSFER_S = 0.12  # in which a foot takes or gives up its load
_STAIR_MODE_M = 0.07  # riser from which a step is SA or SD (Zhao et al. 2023)
_RAMP_MODE_RAD = 0.02  # slope from which a step is RA or RD
_TRAVEL = ((0.0, 0.15, 0.6, 0.9, 1.0), (-0.2, 0.25, 0.8, 1.08, 1.1))  # share of stance; x by that of the toe hinge
_FLAT_RAD = 0.03  # pitch from which only heel or ball press
_EXO_STEP_S = 0.01  # step of the exoskeleton's motion
_SETTLING_ROUNDS = 2


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedWalk(GivenWalk):
    """A recorded walk; its splines are quintic.

    Attributes:
        pitches: (N,) rad, pitch of the feet on the grid by side.
        contacts: (N, 8) shares and centres of pressure on the grid.
        arc_length: (N,) m, along the way.
    """

    pitches: dict[str, Array]
    contacts: Array
    arc_length: Array

    def pitch(self, side: str, t: NDArray[np.floating]) -> Array:
        """(N,) rad, pitch of a foot relative to the ground under it at (N,) s, toes down positive."""
        return np.interp(t, self.grid, self.pitches[side])

    def contact_shares(self, t: NDArray[np.floating]) -> Array:
        """(N, 8) at (N,) s: share of the load and centre of pressure (3, m, world) of the left, then the right foot."""
        return np.stack([np.interp(t, self.grid, column) for column in self.contacts.T], axis=1)

    def progress(self, t: NDArray[np.floating]) -> Array:
        """(N,) m, arc length of the pelvis along the way at (N,) s."""
        return np.interp(t, self.grid, self.arc_length)


def make_recorded_walk(fitted: FittedWalk, model: mujoco.MjModel, size: Wearer, terrain: Terrain) -> RecordedWalk:
    """The walk of a wearer, whose exoskeleton follows the legs.

    Args:
        fitted: The recorded walk.
        model: Compiled model of the wearer on the terrain.
        size: Dimensions of the wearer, whose body is that of the recorded walk.
        terrain: Ground.
    """
    layout = Coordinates.of(model)
    t: Array = np.arange(len(fitted.x), dtype=float) * fitted.dt
    x = np.zeros((len(t), len(layout.names)))
    for column, name in enumerate(fitted.skeleton.layout.names):
        x[:, layout.names.index(name)] = fitted.x[:, column]
    if size.exo is not None:
        _fill_exoskeleton(fitted, model, size, layout, t, x)
    feet = track_feet(fitted.skeleton, fitted.x)
    heights, slopes = fitted.ground.heights, fitted.ground.slopes
    steps = {
        side: [_make_stance(fitted, i, t, terrain) for i, rest in enumerate(fitted.rests) if rest.side == side]
        for side in SIDES
    }
    pitches, columns = {}, []
    shares = _share_load(fitted.rests, len(t), fitted.dt)
    for track in feet:
        numbers = [i for i, rest in enumerate(fitted.rests) if rest.side == track.side]
        slope = _slope_over_time(fitted.rests, numbers, slopes, len(t))
        ahead = track.R[:, :, 0]
        pitch = np.arcsin(np.clip(-ahead[:, 2], -1.0, 1.0)) + slope * ahead[:, 0]
        pitches[track.side] = pitch
        centres = _pressure_centres(
            track, [fitted.rests[i] for i in numbers], pitch, heights[numbers], slopes[numbers], size.shoe
        )
        columns += [shares[track.side][:, None], centres]
    way = terrain.layout.way
    return RecordedWalk(
        duration_s=float(t[-1]),
        size=size,
        steps=steps,
        coordinates=layout,
        splines=make_interp_spline(t, x, k=5),
        grid=t,
        pitches=pitches,
        contacts=np.hstack(columns),
        arc_length=way.project(fitted.x[:, :2], begin=float(fitted.x[0, 0])),
    )


def _make_stance(fitted: FittedWalk, number: int, t: Array, terrain: Terrain) -> Stance:
    """Stance of the walk from a rest of its number among those of both feet."""
    rest, height, slope = fitted.rests[number], fitted.ground.heights[number], float(fitted.ground.slopes[number])
    c, s = np.cos(rest.yaw), np.sin(rest.yaw)
    normal = np.array([-np.sin(slope), 0.0, np.cos(slope)])
    ahead = np.array([c, s, np.tan(slope) * c])
    ahead /= np.linalg.norm(ahead)
    before = [k for k in range(number) if fitted.rests[k].side != rest.side]
    rise = float(height - fitted.ground.heights[before[-1]]) if before else 0.0
    middle = rest.p[:2] + 0.5 * fitted.skeleton.size.shoe.toe_hinge_x * np.array([c, s])
    mode = "LG"
    if abs(slope) > _RAMP_MODE_RAD:
        mode = "RA" if slope * c > 0 else "RD"
    elif abs(rise) >= _STAIR_MODE_M:
        mode = "SA" if rise > 0 else "SD"
    begin, end = rest.ground
    return Stance(
        foot=rest.side,
        p_foot_in_world=np.array([*rest.p[:2], height]),
        R_world_sole=np.column_stack([ahead, np.cross(normal, ahead), normal]),
        terrain=str(terrain.terrain_class(middle)),
        mode=mode,
        t_touch=-np.inf if begin == 0 else float(t[begin]),
        t_off=np.inf if end >= len(t) else float(t[end]),
    )


def _share_load(rests: Sequence[FootRest], frames: int, dt: float) -> dict[str, Array]:
    """(N,) share of the load by side; a foot takes its load and gives it up within `_TRANSFER_S`."""
    row: Array = np.arange(frames, dtype=float)
    raw = {side: np.full(frames, 1e-12) for side in SIDES}
    for rest in rests:
        begin, end = rest.ground
        up = np.ones(frames) if begin == 0 else ease((row - begin) * dt / _TRANSFER_S)
        down = np.ones(frames) if end >= frames else ease((end - row) * dt / _TRANSFER_S)
        # where no foot stands, the nearest one in time bears what is left
        away = np.maximum(np.maximum(begin - row, row - end), 0) * dt
        raw[rest.side] = np.maximum(raw[rest.side], np.maximum(up * down, 1e-6 * np.exp(-away / 0.02)))
    total = raw["l"] + raw["r"]
    return {side: values / total for side, values in raw.items()}


def _slope_over_time(rests: Sequence[FootRest], own: Sequence[int], slopes: Array, frames: int) -> Array:
    """(N,) rad, inclination of the ground under a foot; between two rests that changes in the middle of swing."""
    slope = np.zeros(frames)
    since = 0
    for k, i in enumerate(own):
        until = frames if k + 1 == len(own) else (rests[i].ground[1] + rests[own[k + 1]].ground[0]) // 2
        slope[since:until] = slopes[i]
        since = until
    return slope


def _pressure_centres(
    track: FootTrack, rests: Sequence[FootRest], pitch: Array, heights: Array, slopes: Array, shoe: Shoe
) -> Array:
    """(N, 3) m, centre of pressure under one foot: from the heel to the ball, where the sole touches the ground."""
    n = len(pitch)
    along = np.full(n, 0.5 * shoe.toe_hinge_x)
    level = np.full(n, np.nan)
    for rest, height, slope in zip(rests, heights, slopes):
        begin, end = rest.ground
        rows = slice(begin, end)
        share = (np.arange(begin, end) - begin) / max(1, end - begin)
        knots, places = _TRAVEL
        travel = np.interp(share, knots, places) * shoe.toe_hinge_x
        heel, ball = shoe.heel_back_x + 0.003, 1.03 * shoe.toe_hinge_x
        travel += (np.maximum(travel, ball) - travel) * ease(pitch[rows] / _FLAT_RAD)
        travel += (heel - travel) * ease(-pitch[rows] / _FLAT_RAD)
        along[rows] = np.clip(travel, heel, shoe.flat_tip_x)
        ahead = track.p[rows, 0] + track.R[rows, 0, 0] * along[rows] - rest.p[0]
        level[rows] = height + np.tan(slope) * ahead
    known = np.flatnonzero(np.isfinite(level))
    rows_all = np.arange(n)
    along = np.interp(rows_all, known, along[known])
    centres = track.p + track.R[:, :, 0] * along[:, None]
    centres[:, 2] = np.interp(rows_all, known, level[known])
    return centres


def _fill_exoskeleton(
    fitted: FittedWalk, model: mujoco.MjModel, size: Wearer, layout: Coordinates, t: Array, x: Array
) -> None:
    """Fills the columns of the exoskeleton's legs in (N, D) coordinates: first without weight, then with it."""
    stride = max(1, round(_EXO_STEP_S / fitted.dt))
    rows = slice(None, None, stride)
    skeleton = fitted.skeleton
    poses = skeleton.poses(fitted.x[rows])
    pelvis = skeleton.index("pelvis")
    to_pelvis = np.swapaxes(poses.R[:, pelvis], 1, 2)
    legs, wearers, angles = {}, {}, {}
    for side in SIDES:
        thigh, shank, foot = (skeleton.index(f"{body}_{side}") for body in ("thigh", "shank", "foot"))
        p_foot = np.einsum("nij,nj->ni", to_pelvis, poses.p[:, foot] - poses.p[:, pelvis])
        wearers[side] = leg_pose(
            size,
            side,
            to_pelvis @ poses.R[:, thigh],
            to_pelvis @ poses.R[:, shank],
            p_foot,
            to_pelvis @ poses.R[:, foot],
        )
        legs[side] = ExoLeg(size, side)
        angles[side] = fit_leg(legs[side], wearers[side])
    columns = {side: [layout.names.index(joint) for joint in leg_frame(size, side).joints] for side in SIDES}

    def fill() -> None:
        """Writes the angles, interpolated, into the coordinates."""
        for side in SIDES:
            x[:, columns[side]] = make_interp_spline(t[rows], angles[side], k=5)(np.minimum(t, t[rows][-1]))

    fill()
    splines = make_interp_spline(t, x, k=5)
    angles = solve_leg_dynamics(legs, angles, wearers, model, layout, splines, t[rows], _SETTLING_ROUNDS)
    fill()
