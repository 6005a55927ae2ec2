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

_SETTLED_M = 1e-5  # change of the height at which the iteration of `fit_pelvis_height` ends
_MOST_ROUNDS = 40  # of this iteration


# Least flexion of the knees, and the height of the pelvis; chosen by hand, within what the legs reach.
#
# On the level it is a little less than that of people's straightest knees, 5-8° in the norms: steps differ, and where a
# leg would be straighter, the pelvis is lower all around, and both knees bend farther than the norms. Off the level it
# is larger: down stairs people land on a bent knee; uphill, a nearly straight rear leg would have to bend at hundreds
# of rad/s² as soon as its foot leaves, and the other foot would slip.
_MIN_KNEE_RAD = np.radians(6.0)  # determines the height of the pelvis on the level
HARD_MIN_KNEE_RAD = np.radians(1.5)  # to which the legs may straighten
_KNEE_DOWNSTAIRS_RAD = np.radians(16.0)  # least flexion at the landing on a tread, downstairs
_KNEE_UPSTAIRS_RAD = np.radians(11.0)  # least flexion upstairs
_KNEE_BY_SLOPE = 1.5  # additional rad per rad of slope
_MAX_KNEE_BY_SLOPE_RAD = np.radians(20.0)  # limit of the least flexion uphill
_STANDING_HEIGHT = 0.99  # leg lengths
_SMOOTHNESS = 2e-3  # s³, weight of the third derivative of the height
_ABOVE_REACH_WEIGHT = 5e3  # weight of a height beyond the legs' reach relative to the distance from the goal


def solve_cart_table(zmp: Array, kappa: Array, dt: float) -> Array:
    """Path c of the centre of mass with a zero-moment point p = c − κ c'' (linear inverted pendulum, Kajita 2003).

    The second derivative is a central difference, so that each row reads −k c₋ + (1 + 2 k) c − k c₊ = p with k = κ /
    Δt²; at both ends c = p.

    Args:
        zmp: (N, d) zero-moment point p in d directions, m; at rest at both ends.
        kappa: (N,) κ = (z_com - z_zmp) / (g + z_com''), s².
        dt: Time Δt between rows, s.

    Returns:
        (N, d) path c, m.
    """
    n = len(zmp)
    k = kappa / dt**2
    bands = np.zeros((3, n))  # upper, main and lower diagonal of the system, as for `solve_banded`
    bands[1] = 1 + 2 * k
    bands[0, 1:], bands[2, :-1] = -k[:-1], -k[1:]
    bands[1, 0], bands[0, 1], bands[1, -1], bands[2, -2] = 1.0, 0.0, 1.0, 0.0  # c = p in the first and the last row
    return solve_banded((1, 1), bands, zmp)


def max_pelvis_height(
    size: Wearer, p_pelvis_in_world: Array, R_world_pelvis: Array, paths: Mapping[str, FootPath], min_knee: Array
) -> Array:
    """(N,) m, height of the pelvis at which the straighter leg has just its least knee flexion.

    Args:
        size: Wearer.
        p_pelvis_in_world: (N, 3) m; the height has no effect.
        R_world_pelvis: (N, 3, 3).
        paths: Path of each foot, by side.
        min_knee: (N,) rad, least knee flexion.
    """
    limits = []
    for side in SIDES:
        sign = 1.0 if side == "l" else -1.0
        hip = R_world_pelvis @ np.array([0.0, sign * size.body.hip_half_width_m, 0.0])
        ankle = ankle_in_world(size, paths[side].p_foot_in_world, paths[side].R_world_foot)
        away_squared = ((p_pelvis_in_world + hip - ankle)[:, :2] ** 2).sum(1)  # m², horizontally from hip to ankle
        # height of the hip above the ankle; at least 0.2 m (0.04 m²), so that the root exists for a foot out of reach
        hip_over_ankle = np.sqrt(np.maximum(reach(size, min_knee) ** 2 - away_squared, 0.04))
        limits.append(ankle[:, 2] - hip[:, 2] + hip_over_ankle)
    return np.minimum(*limits)


def min_knee_flexion(rhythm: Rhythm, t: Array) -> Array:
    """(N,) rad, least knee flexion at (N,) uniform s, which determines the height of the pelvis.

    It is larger on stairs and uphill. After a step up a stair or a ramp it stays so for the next two steps, until the
    rear foot has left the ground.
    """
    uphill = np.array([step.slope if step.mode == "RA" else 0.0 for step in rhythm.steps])  # rad, by step
    of_mode = {"SD": _KNEE_DOWNSTAIRS_RAD, "SA": _KNEE_UPSTAIRS_RAD}
    bent = np.array([of_mode.get(step.mode, _MIN_KNEE_RAD) for step in rhythm.steps])  # rad, by step
    # uphill, more by the slope, but not beyond the limit for that
    bent = np.minimum(bent + _KNEE_BY_SLOPE * uphill, np.maximum(bent, _MAX_KNEE_BY_SLOPE_RAD))
    climbing = np.where([step.mode in ("SA", "RA") for step in rhythm.steps], bent, 0.0)
    for later in (1, 2):  # steps; the rear foot leaves the ground during the next step or the one after
        bent[later:] = np.maximum(bent[later:], climbing[:-later])
    return rhythm.blend(t, bent, _MIN_KNEE_RAD, _MIN_KNEE_RAD)


def level_height(rhythm: Rhythm, t: Array, leg_m: float, rise: Array) -> tuple[Array, Array, Array]:
    """Height of the pelvis on the level, from the styles of the steps.

    The oscillation is Σ leg (a_k cos 2πkφ + b_k sin 2πkφ) over three harmonics of the phase φ of the steps.

    Args:
        rhythm: Steps.
        t: (N,) uniform s.
        leg_m: Hip centre to sole, m.
        rise: (K,) oscillation in each step relative to the style's.

    Returns:
        (N,) mean height in the world, m; (N,) oscillation about it, m; and (N,) share of level ground, 0-1.
    """
    # 1 for a step on level ground whose neighbours are on level ground, too
    level = np.array([float(step.terrain == "level" and step.mode == "LG") for step in rhythm.steps])
    following, preceding = np.append(level[1:], 1.0), np.append(1.0, level[:-1])  # standing counts as level
    level = np.minimum(level, following) * preceding
    footprints = np.array([step.p_foot_in_world[2] for step in rhythm.steps])  # m, heights
    # mean height of the pelvis above the ground, leg lengths: the first entry of the style's `height`
    above_ground = rhythm.blend_style(t, "height", _STANDING_HEIGHT, 0)
    mean = rhythm.blend(t, footprints, 0.0, footprints[-1]) + leg_m * above_ground
    psi = 2 * np.pi * rhythm.phase(t)
    wave = np.zeros_like(t)
    for k in (1, 2, 3):  # entries 2 k − 1 and 2 k of the style's `height` are a_k and b_k
        for index, harmonic in ((2 * k - 1, np.cos(k * psi)), (2 * k, np.sin(k * psi))):
            amplitudes = np.array([step.style.height[index] for step in rhythm.steps])
            wave += leg_m * rhythm.blend(t, level * rise * amplitudes, 0.0, 0.0) * harmonic
    return mean, wave, rhythm.blend(t, level, 1.0, 1.0)


def fit_pelvis_height(goal: Array, limit: Array, dt: float) -> Array:
    """(N,) m, smooth height close to a goal and below a limit.

    It minimises Σ w (z − target)² + `_SMOOTHNESS`² Σ (z''')². The target is the goal with w = 1; where z would exceed
    the limit, it is the limit with w = `_ABOVE_REACH_WEIGHT`. The set of these rows is found by iteration. Sets often
    come back in a circle instead of settling; then whole circles are left out of the remaining rounds, as they change
    nothing.

    Args:
        goal: (N,) m, wanted height.
        limit: (N,) m, largest height within reach of the legs.
        dt: Time between rows, s.
    """
    n = len(limit)
    # third difference over Δt³, (N − 3, N), and the penalty DᵀD on the third derivative
    D = sp.diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(n - 3, n)) / dt**3
    penalty = sp.dia_array(D.T @ D)
    # upper diagonals of the symmetric system, the main one last, as for `solveh_banded`
    bands = np.zeros((4, n), order="F")
    for offset, row in zip(penalty.offsets, penalty.data):
        if offset >= 0:  # the lower diagonals follow by symmetry
            bands[3 - offset, offset:] = _SMOOTHNESS**2 * row[offset:n]
    above = goal > limit  # rows whose target is the limit
    z = goal
    last = _MOST_ROUNDS - 1
    seen: dict[bytes, int] = {}  # round in which a set of rows came first
    for k in range(_MOST_ROUNDS):
        period = k - seen.setdefault(np.packbits(above).tobytes(), k)
        if period == 1:
            break  # the set of the round before
        if period:
            last = k + (last - k) % period
        system = bands.copy(order="F")
        system[3] += np.where(above, _ABOVE_REACH_WEIGHT, 1.0)
        before = z
        target = np.where(above, _ABOVE_REACH_WEIGHT * limit, goal)
        z = solveh_banded(system, target, overwrite_ab=True, overwrite_b=True)
        if k == last or np.abs(z - before).max() < _SETTLED_M:
            break
        above = z > limit
    return z
