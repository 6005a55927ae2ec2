"""A synthetic IMU that never rests, on a walker's head or in a hand: force and rate that agree with each other."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

RATE_HZ = 100.0
Array = NDArray[np.float64]


def simulate_worn(seed: int = 0, duration_s: float = 60.0, tilt_rad: float = 0.4) -> tuple[Array, Array, Array]:
    """A walk at 1.3 m/s round some bends: t (N,) s, force (N, 3) m/s², rate (N, 3) rad/s.

    Args:
        seed: Of the noise, the mount and the phases of the movements.
        duration_s: Length of the walk, s.
        tilt_rad: By how much the sensor is slowly tilted to and fro, as by a look down; 0 is a head that keeps level.
    """
    random = np.random.default_rng(seed)
    phases = random.uniform(0, 2 * np.pi, 8)
    mount = Rotation.random(random_state=seed)
    step_s = 1e-3  # of the differences
    t = np.arange(0.0, duration_s, 1.0 / RATE_HZ)
    before, now, after = (_poses(t + shift, tilt_rad, phases) for shift in (-step_s, 0.0, step_s))
    acceleration = (before[0] - 2.0 * now[0] + after[0]) / step_s**2 + [0.0, 0.0, 9.81]
    rate = (before[1].inv() * after[1]).as_rotvec() / (2.0 * step_s)
    force = mount.apply(now[1].inv().apply(acceleration)) + random.normal(0.0, 0.03, (len(t), 3))
    return t, force, mount.apply(rate) + random.normal(0.0, 0.003, (len(t), 3))


def _poses(t: Array, tilt_rad: float, phases: Array) -> tuple[Array, Rotation]:
    """Position (N, 3) m and attitude of the sensor at times (N,) s."""
    heading = 1.2 * np.sin(2 * np.pi * t / 23 + phases[0]) + 0.8 * np.sin(2 * np.pi * t / 9 + phases[1])
    sway = 0.03 * np.sin(np.pi * 1.8 * t + phases[2])
    bounce = 0.03 * np.sin(2 * np.pi * 1.8 * t + phases[3])
    # a path of that heading: its speed summed up over steps of 10 ms
    grid = np.arange(t[0] - 0.1, t[-1] + 0.1, 0.01)
    courses = 1.2 * np.sin(2 * np.pi * grid / 23 + phases[0]) + 0.8 * np.sin(2 * np.pi * grid / 9 + phases[1])
    from scipy.interpolate import CubicSpline

    way = CubicSpline(grid, 1.3 * np.column_stack([np.cos(courses), np.sin(courses)])).antiderivative()(t)
    aside = np.column_stack([-np.sin(heading), np.cos(heading)]) * sway[:, None]
    pitch = tilt_rad * np.sin(2 * np.pi * t / 7 + phases[4]) + 0.03 * np.sin(2 * np.pi * 1.8 * t + phases[5])
    roll = 0.6 * tilt_rad * np.sin(2 * np.pi * t / 5 + phases[6]) + 0.02 * np.sin(np.pi * 1.8 * t + phases[7])
    return np.column_stack([way + aside, bounce]), Rotation.from_euler("ZYX", np.column_stack([heading, pitch, roll]))
