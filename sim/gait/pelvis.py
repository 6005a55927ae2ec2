"""Path of the pelvis: horizontally from the zero-moment point, vertically from the reach of the legs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp
from scipy.linalg import solve_banded, solveh_banded

from stridetwin.sim.config import SIDES
from stridetwin.sim.gait.foot_path import FootPath
from stridetwin.sim.gait.footsteps import Rhythm
from stridetwin.sim.gait.leg_ik import ankle_in_world, reach
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.streams.samples import Array

KNEE_MIN_RAD = np.radians(7.0)  # sets the height of the pelvis; the legs may straighten to KNEE_HARD_MIN_RAD
KNEE_HARD_MIN_RAD = np.radians(1.5)
# and larger off the level: down stairs people land on a bent knee; uphill, a nearly straight rear leg would have to
# bend at hundreds of rad/s² as soon as its foot leaves, and the other foot would slip
_KNEE_OF_MODE_RAD = {"SD": np.radians(16.0), "SA": np.radians(12.0)}
_KNEE_UPHILL, _KNEE_UPHILL_MAX_RAD = 1.5, np.radians(20.0)  # additional rad per rad of slope
_SETTLED_M = 1e-5
_SMOOTHNESS = 2e-3
_STANDING_HEIGHT = 0.99  # in leg lengths
_ABOVE_REACH = 5e3  # weight of a height beyond the legs' reach relative to the distance from the goal


def cart_table(wanted: Array, kappa: Array, dt: float) -> Array:
    """Path c with the given zero-moment point c - kappa c'' (linear inverted pendulum, Kajita 2003).

    Args:
        wanted: (N, k) zero-moment point, m; at rest at both ends.
        kappa: (N,) (z_com - z_zmp) / (g + z_com''), s².
        dt: Time between rows, s.
    """
    n = len(wanted)
    k = kappa / dt**2
    bands = np.zeros((3, n))
    bands[1] = 1 + 2 * k
    bands[0, 1:], bands[2, :-1] = -k[:-1], -k[1:]
    bands[1, 0], bands[0, 1], bands[1, -1], bands[2, -2] = 1.0, 0.0, 1.0, 0.0
    return solve_banded((1, 1), bands, wanted)


def highest(
    size: Wearer,
    p_pelvis_in_world: Array,
    R_world_pelvis: Array,
    paths: Mapping[str, FootPath],
    knee_min: Array,
) -> Array:
    """(N,) height of the pelvis at which one of the legs is as straight as (N,) `knee_min` allows."""
    limits = []
    for side in SIDES:
        sign = 1.0 if side == "l" else -1.0
        hip = R_world_pelvis @ np.array([0.0, sign * size.body.hip_half_width_m, 0.0])
        ankle = ankle_in_world(size, paths[side].p_foot_in_world, paths[side].R_world_foot)
        away = ((p_pelvis_in_world + hip - ankle)[:, :2] ** 2).sum(1)
        limits.append(ankle[:, 2] - hip[:, 2] + np.sqrt(np.maximum(reach(size, knee_min) ** 2 - away, 0.04)))
    return np.minimum(*limits)


def least_knee(rhythm: Rhythm, t: Array) -> Array:
    """(N,) rad at (N,) uniform s, least knee flexion that determines the height of the pelvis."""
    uphill = np.array([step.slope if step.mode == "RA" else 0.0 for step in rhythm.steps])
    bent = np.array([_KNEE_OF_MODE_RAD.get(step.mode, KNEE_MIN_RAD) for step in rhythm.steps])
    bent = np.minimum(bent + _KNEE_UPHILL * uphill, np.maximum(bent, _KNEE_UPHILL_MAX_RAD))
    climbing = np.where([step.mode in ("SA", "RA") for step in rhythm.steps], bent, 0.0)
    for late in (1, 2):  # the rear foot leaves the ground during the next step or the one after
        bent[late:] = np.maximum(bent[late:], climbing[:-late])
    return rhythm.blend(t, bent, KNEE_MIN_RAD, KNEE_MIN_RAD)


def level_height(rhythm: Rhythm, t: Array, leg_m: float) -> tuple[Array, Array, Array]:
    """Height of the pelvis on the level, from the styles of the steps.

    Args:
        rhythm: Steps.
        t: (N,) uniform s.
        leg_m: Hip centre to sole, m.

    Returns:
        (N,) mean height in the world, m; (N,) oscillation about it, m; and (N,) share of level ground, 0-1.
    """
    level = np.array([float(step.terrain == "level" and step.mode == "LG") for step in rhythm.steps])
    level = np.minimum(level, np.append(level[1:], 1.0)) * np.minimum(1.0, np.append(1.0, level[:-1]))
    footprints = np.array([step.p_foot_in_world[2] for step in rhythm.steps])
    ground = rhythm.blend(t, footprints, 0.0, footprints[-1])
    mean = ground + leg_m * rhythm.styled(t, "height", _STANDING_HEIGHT, 0)
    psi = 2 * np.pi * rhythm.phase(t)
    wave = np.zeros_like(t)
    for k in (1, 2, 3):
        for index, swing in ((2 * k - 1, np.cos(k * psi)), (2 * k, np.sin(k * psi))):
            amplitudes = np.array([step.style.height[index] for step in rhythm.steps])
            wave += leg_m * rhythm.blend(t, level * amplitudes, 0.0, 0.0) * swing
    return mean, wave, rhythm.blend(t, level, 1.0, 1.0)


def height_near(goal: Array, limit: Array, dt: float) -> Array:
    """Smoothest height close to a goal and below a limit: least squares with a third-derivative penalty.

    Args:
        goal: (N,) m.
        limit: (N,) m.
        dt: Time between rows, s.
    """
    n = len(limit)
    D = sp.diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(n - 3, n)) / dt**3
    penalty = sp.dia_array(D.T @ D)
    bands = np.zeros((4, n))
    for offset, row in zip(penalty.offsets, penalty.data):
        if offset >= 0:
            bands[3 - offset, offset:] = _SMOOTHNESS**2 * row[offset:n]
    above = np.zeros(n, dtype=bool)
    z = goal
    for _ in range(40):
        system = bands.copy()
        system[3] += np.where(above, _ABOVE_REACH, 1.0)
        before, z = z, solveh_banded(system, np.where(above, _ABOVE_REACH * limit, goal))
        if np.abs(z - before).max() < _SETTLED_M:
            break
        above = z > limit
    return z
