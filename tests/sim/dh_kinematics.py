"""Forward kinematics of the exoskeleton's D-H table, as the paper of Shim et al. 2019 writes it."""

from __future__ import annotations

import math

import numpy as np

from stridetwin.sim.wearer.exoskeleton import R_DH_BODY, DhRow, ExoLinks, dh_table
from stridetwin.streams.samples import Array

DH_FRAMES = (1, 3, 5, 6, 7, 8)
"""Frame of the table at which each body of `EXO_LEG_BODIES` sits."""


def forward_kinematics(links: ExoLinks, side: str, q: Array) -> Array:
    """(..., 8, 4, 4) poses of frames 1-8 in frame 0: equations (1) and (2) of the paper.

    Args:
        links: Lengths.
        side: `l` or `r`.
        q: (..., 6) rad, the table's (q1, q3, q5, q6, q7, q8).
    """
    T, frames = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4)), []
    for row in dh_table(links, side):
        angle = row.theta + (0.0 if row.joint is None else q[..., row.joint])
        T = T @ _craig(row, np.broadcast_to(angle, q.shape[:-1]))
        frames.append(T)
    return np.stack(frames, -3)


def frame_0_in_pelvis(links: ExoLinks) -> Array:
    """(4, 4) pose of the D-H frame 0 in the pelvis' frame: the hip's axes meet the line of the hip centres."""
    T = np.eye(4)
    T[:3, :3] = R_DH_BODY[0].T
    T[:3, 3] = [-links.hip6, 0.0, links.hip4 + links.hip5 - links.hip3]
    return T


def _craig(row: DhRow, angle: Array) -> Array:
    c, s, ca, sa = np.cos(angle), np.sin(angle), math.cos(row.alpha), math.sin(row.alpha)
    T = np.zeros((*angle.shape, 4, 4))
    T[..., 0, 0], T[..., 0, 1], T[..., 0, 3] = c, -s, row.a
    T[..., 1, 0], T[..., 1, 1], T[..., 1, 2], T[..., 1, 3] = s * ca, c * ca, -sa, -sa * row.d
    T[..., 2, 0], T[..., 2, 1], T[..., 2, 2], T[..., 2, 3] = s * sa, c * sa, ca, ca * row.d
    T[..., 3, 3] = 1.0
    return T
