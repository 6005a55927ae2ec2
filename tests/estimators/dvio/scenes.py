"""Small worlds for the tests of the odometry: a smooth motion, points, and a window that observes them."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.dvio.state import CALIBRATION, FRAME, FactorParameters, ImuNoise, WindowState, blank_window

NOISE = ImuNoise(
    rate=1e-3, force=1e-2, rate_share=0.0, rate_walk=1e-4, force_walk=1e-3, invalid_rate=1.0, invalid_force=5.0
)
FACTORS = FactorParameters(
    gravity=9.81,
    pixel_weight=400.0**2,
    depth_weight=200.0**2,
    later_depth_weight=100.0**2,
    huber_sd=3.0,
    host_depth=True,
    depth_fixed=False,
    projection_depth=True,
    host_depth_in_prior=True,
    first_estimates=False,
    rate_walk=1e-4,
    force_walk=1e-3,
)
T_IMU_CAMERA = np.eye(4)
T_IMU_CAMERA[:3, :3] = Rotation.from_euler("xyz", [0.1, -0.2, 0.05]).as_matrix()
T_IMU_CAMERA[:3, 3] = [0.03, -0.01, 0.02]


def seen_window(rng: np.random.Generator, frames: int = 3, points: int = 6, slots: int = 4) -> WindowState:
    """Frames a step apart that look at points, all at their true states, observations without error."""
    w = blank_window(slots, points, T_IMU_CAMERA, 0.0)
    f, marks = w.frames, w.landmarks
    f.count[0] = frames
    for k in range(frames):
        f.R[k] = Rotation.from_rotvec(0.1 * rng.normal(size=3)).as_matrix()
        f.p[k] = [0.2 * k, 0.1 * rng.normal(), 0.1 * rng.normal()]
        f.v[k] = 0.5 * rng.normal(size=3)
        f.rate[k] = 0.3 * rng.normal(size=3)
        f.bias[k] = 0.01 * rng.normal(size=6)
        f.t_ns[k] = 200_000_000 * k
    R, p = w.calibration.R, w.calibration.p
    for l in range(points):
        m = np.array([*rng.uniform(-0.4, 0.4, 2), 1.0])
        depth = rng.uniform(1.5, 5.0)
        world = f.R[0] @ (R @ (m * depth) + p) + f.p[0]
        marks.host[l], marks.inverse_depth[l], marks.measured[l] = 0, 1 / depth, 1
        for k in range(frames):
            q = R.T @ (f.R[k].T @ (world - f.p[k]) - p)
            marks.seen[l, k], marks.at[l, k], marks.rho[l, k] = 1, q[:2] / q[2], 1 / q[2]
    return w


def moved(window: WindowState, error: np.ndarray) -> None:
    """Moves all states by an error, the calibration's first."""
    c, f = window.calibration, window.frames
    c.p[:] += error[:3]
    c.R[:] = c.R @ Rotation.from_rotvec(error[3:6]).as_matrix()
    c.offset[:] += error[6]
    c.scale[:] += error[7]
    c.focal[:] += error[8:10]
    for k in range(f.count[0]):
        e = error[CALIBRATION + FRAME * k :]
        f.p[k] += e[:3]
        f.R[k] = f.R[k] @ Rotation.from_rotvec(e[3:6]).as_matrix()
        f.v[k] += e[6:9]
        f.bias[k] += e[9:15]
