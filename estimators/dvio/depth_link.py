"""Motion between two frames by the planes that their depth images show, where colour images show nothing.

An active depth camera measures in the dark as by day. Planes of the newest depth image are matched with those of the
frame before, and each pair measures three of the six components of the motion: docs/dvio.md (18). What no plane
constrains, such as the way along a corridor, has no information and is left to the IMU. See docs/dvio.md (19).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.dvio import kernel
from stridetwin.estimators.dvio.nav_state import NavState
from stridetwin.estimators.dvio.state import CALIBRATION, FRAME, Calibration, WindowState
from stridetwin.streams.algebra.arrays import exp, hat, log
from stridetwin.streams.samples import Array

# Hand-chosen on tuning seeds.
_CELL_SAMPLES = 5  # edge of a cell: finer than for level ground, so that treads and risers are planes, too
_MOST_PLANES = 16  # of a depth image
_MATCH, _AMBIGUOUS = 14.0, 12.0  # squared distance of a match in variances; more of it than that of the second best
_OUTLIER = 12.0  # squared residual of a pair after the fit, in variances, from which it is left out
_STEPS = 3  # of the fit
_LEAST_SD = 0.1  # directions of the motion that are less certain, m and rad, count as not measured
_LEVER_M = 1.0  # length by which rotations and translations are compared


class Planes(NamedTuple):
    """Planes of a depth image in the camera's axes.

    Attributes:
        pi: (P, 3) 1/m: a point X on a plane has π · X = 1.
        covariance: (P, 3, 3) of these.
    """

    pi: Array
    covariance: Array


class DepthLink(NamedTuple):
    """Measured motion of the IMU from one frame to the next.

    Attributes:
        dp: (3,) change of position in the earlier frame's axes, m.
        dR: (3, 3) rotation, later to earlier frame.
        information: (6, 6) of position and rotation; 0 in directions that no plane constrains.
    """

    dp: Array
    dR: Array
    information: Array


class PlaneReader:
    """Reads the planes of depth images for links.

    Args:
        rays: (R, C, 2) of the depth samples on the plane at depth 1.
        min_depth_m: Nearest depth that counts.
        inverse_depth_sd: Standard deviation of an inverse depth, 1/m.
    """

    def __init__(self, rays: Array, min_depth_m: float, inverse_depth_sd: float) -> None:
        """Prepares the buffers; `rays` (R, C, 2) are those of the depth samples."""
        self._rays, self._min_depth_m, self._sd = rays, min_depth_m, inverse_depth_sd
        self._pi, self._weights = np.zeros((_MOST_PLANES, 3)), np.zeros((_MOST_PLANES, 3, 3))

    def read(self, depth: NDArray[np.float32], c: Calibration) -> Planes:
        """The planes of a depth image (H, W), m, corrected by the estimated depth scale and focal lengths."""
        count = kernel.read_planes(
            depth, self._rays, _CELL_SAMPLES, self._min_depth_m, self._sd, self._pi, self._weights
        )
        by = np.array([1.0 / (1.0 + c.focal[0]), 1.0 / (1.0 + c.focal[1]), 1.0]) / c.scale[0]
        covariance = np.asarray(np.linalg.inv(self._weights[:count]) * np.outer(by, by), float)
        return Planes(pi=self._pi[:count] * by, covariance=covariance)


def link_frames(
    before: Planes, after: Planes, earlier: NavState, predicted: NavState, covariance: Array, c: Calibration
) -> DepthLink | None:
    """The motion between two frames by the planes that both see.

    Args:
        before: Planes of the earlier frame.
        after: Planes of the later one.
        earlier: State of the earlier frame.
        predicted: State of the later one by the IMU.
        covariance: (6, 6) of the predicted motion of the IMU in the earlier frame's axes: position (m), rotation (rad).
        c: The camera's mount.

    Returns:
        None where no pair of planes matches.
    """
    if not (len(before.pi) and len(after.pi)):
        return None
    # predicted motion of the IMU, and that of the camera: a point X in the later camera is R X + t in the earlier one
    dR, dp = earlier.R.T @ predicted.R, earlier.R.T @ (predicted.p - earlier.p)
    R, t = c.R.T @ dR @ c.R, c.R.T @ (dp + dR @ c.p - c.p)
    # derivative of the camera's motion (t, rotation on the right of R) by that of the IMU (dp, rotation of dR)
    to_camera = np.zeros((6, 6))
    to_camera[:3, :3], to_camera[:3, 3:], to_camera[3:, 3:] = c.R.T, -c.R.T @ dR @ hat(c.p), c.R.T
    pairs = _match(before, after, R, t, to_camera @ covariance @ to_camera.T)
    for _ in range(2):  # the second time without pairs that contradict the others
        if not pairs:
            return None
        fitted_R, fitted_t = R, t
        for _ in range(_STEPS):
            information, gradient, squares = _equations(before, after, pairs, fitted_R, fitted_t)
            information, inverse = _keep_measured(information)
            step = inverse @ gradient
            fitted_t, fitted_R = fitted_t + step[:3], fitted_R @ exp(step[3:])
        squares = _equations(before, after, pairs, fitted_R, fitted_t)[2]
        agreeing = [pair for pair, square in zip(pairs, squares) if square < _OUTLIER]
        if len(agreeing) == len(pairs):
            break
        pairs = agreeing
    if not pairs or not information.any():
        return None
    # back from the camera to the IMU
    measured_R = c.R @ fitted_R @ c.R.T
    measured_p = c.R @ fitted_t + c.p - measured_R @ c.p
    return DepthLink(dp=measured_p, dR=measured_R, information=to_camera.T @ information @ to_camera)


def _transform(pi: Array, R: Array, t: Array) -> tuple[Array, Array, Array]:
    """Planes of the earlier camera in the later one, docs/dvio.md (18), with their derivatives.

    Args:
        pi: (P, 3) planes, 1/m.
        R: (3, 3) earlier <- later camera.
        t: (3,) later camera in the earlier one, m.

    Returns:
        (P, 3) planes; (P, 3, 6) derivative by t and by a rotation on the right of R; (P, 3, 3) by the planes.
    """
    s = 1.0 / (1.0 - pi @ t)  # (P,)
    turned = pi @ R  # Rᵀ π
    moved = turned * s[:, None]
    by_t = np.einsum("pi,pj->pij", turned, pi) * (s**2)[:, None, None]
    by_plane = R.T[None] * s[:, None, None] + np.einsum("pi,j->pij", turned, t) * (s**2)[:, None, None]
    return moved, np.concatenate([by_t, hat(moved)], axis=2), by_plane


def _match(before: Planes, after: Planes, R: Array, t: Array, covariance: Array) -> list[tuple[int, int]]:
    """Pairs of planes (index before, index after) that the predicted motion R, t of the camera brings together.

    A plane with two candidates of similar distance has no match; `covariance` (6, 6) is that of the motion.
    """
    moved, J, by_plane = _transform(before.pi, R, t)
    spread = J @ covariance @ J.swapaxes(1, 2) + by_plane @ before.covariance @ by_plane.swapaxes(1, 2)
    e = after.pi[None] - moved[:, None]  # (P, Q, 3)
    squares = np.einsum("pqi,pqij,pqj->pq", e, np.linalg.inv(spread[:, None] + after.covariance[None]), e)
    pairs = []
    for q in range(squares.shape[1]):
        order = np.argsort(squares[:, q])
        best, p = squares[order[0], q], int(order[0])
        rival = squares[order[1], q] if len(order) > 1 else np.inf
        # a second candidate is one plane with the first if the two are parts of one surface
        same = len(order) > 1 and _are_one(before, p, int(order[1]))
        if best < _MATCH and (rival > best + _AMBIGUOUS or same):
            pairs.append((p, q))
    return pairs


def _are_one(planes: Planes, a: int, b: int) -> bool:
    """Whether two planes of one image may be parts of one surface, such as a floor on both sides of a table."""
    e = planes.pi[a] - planes.pi[b]
    return bool(e @ np.linalg.solve(planes.covariance[a] + planes.covariance[b], e) < _MATCH)


def _equations(
    before: Planes, after: Planes, pairs: list[tuple[int, int]], R: Array, t: Array
) -> tuple[Array, Array, Array]:
    """Normal equations of the motion of the camera: (6, 6), (6,), and the squared residuals (N,) in variances."""
    p, q = np.array(pairs).T
    moved, J, by_plane = _transform(before.pi[p], R, t)
    r = after.pi[q] - moved
    spread = after.covariance[q] + by_plane @ before.covariance[p] @ by_plane.swapaxes(1, 2)
    W = np.linalg.inv(spread)
    JtW = J.swapaxes(1, 2) @ W
    return (JtW @ J).sum(axis=0), np.einsum("nij,nj->i", JtW, r), np.einsum("ni,nij,nj->n", r, W, r)


def _keep_measured(information: Array) -> tuple[Array, Array]:
    """Information (6, 6) of the measured directions alone, and its pseudo-inverse.

    The noise of normals makes parallel planes look as if they constrained a motion along them; directions of less
    information than `_LEAST_SD` count as not measured.
    """
    unit = np.repeat([1.0, 1.0 / _LEVER_M], 3)  # scales rotations to lengths
    value, vector = np.linalg.eigh(information * np.outer(unit, unit))
    measured = value > _LEAST_SD**-2
    scaled, inverse = (
        vector * np.where(measured, value, 0.0),
        vector * np.where(measured, 1.0 / np.maximum(value, 1e-12), 0.0),
    )
    by = np.outer(1.0 / unit, 1.0 / unit)
    return scaled @ vector.T * by, inverse @ vector.T / by


def add_depth_links(
    window: WindowState, links: list[DepthLink | None], first_estimates: bool, frames: int, H: Array, b: Array
) -> float:
    """Adds the links of the oldest `frames` to the next ones, docs/dvio.md (19), to H and b; returns their cost.

    Args:
        window: Frames; those in the prior keep the Jacobians of their first estimates if `first_estimates`.
        links: Per frame the link to the next one, or None.
        first_estimates: See above.
        frames: Number of frames, from the oldest.
        H: (N, N) normal equations, changed in place.
        b: (N,) right-hand side, changed in place.
    """
    f, cost = window.frames, 0.0
    for k in range(min(frames, int(f.count[0]) - 1)):
        link = links[k]
        if link is None:
            continue
        Ri, Rj, d = f.R[k], f.R[k + 1], f.p[k + 1] - f.p[k]
        r = np.concatenate([Ri.T @ d - link.dp, log(link.dR.T @ Ri.T @ Rj)])
        pi, pj = f.p[k], f.p[k + 1]
        if first_estimates and f.in_prior[k]:
            Ri, pi = f.R_first[k], f.p_first[k]
        if first_estimates and f.in_prior[k + 1]:
            Rj, pj = f.R_first[k + 1], f.p_first[k + 1]
        J = np.zeros((6, 2 * FRAME))
        J[:3, :3], J[:3, 3:6], J[:3, FRAME : FRAME + 3] = -Ri.T, hat(Ri.T @ (pj - pi)), Ri.T
        J[3:, 3:6], J[3:, FRAME + 3 : FRAME + 6] = -Rj.T @ Ri, np.eye(3)
        at = slice(CALIBRATION + FRAME * k, CALIBRATION + FRAME * (k + 2))
        JtW = J.T @ link.information
        H[at, at] += JtW @ J
        b[at] -= JtW @ r
        cost += 0.5 * float(r @ link.information @ r)
    return cost
