"""Structure from motion over a few images, with depth or without (Zhao 2023 (1)-(5)).

All poses are in the axes of the newest camera. Without depth, the unit of length is the distance between the oldest
and the newest camera.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.dvio.projection import directions
from stridetwin.streams.algebra.arrays import exp, matvec
from stridetwin.streams.samples import Array

_DEPTH_MIN = 0.02  # guards divisions by the depth of a point; in units of the structure
_SCALE_INFORMATION = 1e8  # fixes the unit of length


# Hand-chosen.
_MIN_POINTS = 12  # shared by two images
_HUBER_SD, _CULL_SD = 1.5, 4.0  # observations farther off are down-weighted, and removed
_MIN_PARALLAX_RAD = 0.02  # points with less have no usable depth, unless it is measured
_MIN_PAIR_PARALLAX_RAD = 0.05  # median of the first two images, without measured depth
_PAIR_ERROR_SD, _MIN_PAIR_SHARE = 3.0, 0.6  # of inliers of the essential matrix, and their share of the shared points
_PAIR_CONFIDENCE = 0.999  # of the search for it
_MAX_BASELINES = 1e3  # points farther than so many distances of two cameras do not count for their pose
_POSE_ERROR_SD, _MIN_POSE_SHARE = 8.0, 0.5  # of inliers of P3P, and their share of the points
_MIN_KEPT_SHARE = 0.7  # of the observations at the end
_DAMPING, _COST_TOLERANCE = 1e-4, 1e-2  # of Levenberg-Marquardt: at first, and relative decrease at which it stops


@dataclass(frozen=True, kw_only=True, eq=False)
class Observations:
    """Observations of N points in K images.

    Attributes:
        seen: (K, N) whether the image shows the point.
        at: (K, N, 2) where, on the plane at depth 1.
        rho: (K, N) measured inverse depth there, 1/m; 0 where none.
        sd: Standard deviation of `at`.
        rho_sd: Standard deviation of `rho`, 1/m.
    """

    seen: NDArray[np.bool_]
    at: Array
    rho: Array
    sd: float
    rho_sd: float

    def since(self, k: int) -> Observations:
        """Observations of the images from the k-th on."""
        return replace(self, seen=self.seen[k:], at=self.at[k:], rho=self.rho[k:])


@dataclass(frozen=True, kw_only=True, eq=False)
class Structure:
    """Cameras of K images in the axes of the newest, which is the last one.

    Attributes:
        first: Index of the first of these images among all.
        R: (K, 3, 3) newest camera <- camera.
        p: (K, 3) positions, in m, or in units of the distance between first and newest camera.
        information: (6K, 6K) on the errors of position and attitude (on its right) of each; the newest has none.
        misfit: Mean squared residual, in variances.
        scaled: Whether lengths are in m.
    """

    first: int
    R: Array
    p: Array
    information: Array
    misfit: float
    scaled: bool


def structure_with_depth(s: Observations) -> Structure | None:
    """Cameras by the points of known depth: P3P from each image to the next, then all images at once.

    The latter is a bundle adjustment of cameras and points, Zhao 2023 (5).

    P3P goes from the newest image back to the oldest, and ends at the first pair that shares too few points. The result
    has the images from there on: its `first` is greater than 0 if older ones are left out. None if it would be a single
    image, or if too few observations agree.
    """
    k = len(s.seen) - 1
    R, p = [np.eye(3)], [np.zeros(3)]  # cameras from the newest to the k-th image, in the axes of the newest
    agree = s.seen.copy()  # observations without the outliers of P3P
    while k > 0:
        shared = np.flatnonzero(s.seen[k - 1] & s.seen[k] & (s.rho[k - 1] > 0))
        points_before = directions(s.at[k - 1, shared]) / s.rho[k - 1, shared, None]  # (N, 3) m, in camera k - 1
        step = _solve_pose(s, points_before, s.at[k, shared])
        if step is None:
            break
        M, t, fits = step  # rotation and position, camera k <- camera k - 1; which points are inliers
        agree[k - 1, shared[~fits]] = False
        p.append(R[-1] @ t + p[-1])
        R.append(R[-1] @ M)
        k -= 1
    if len(R) < 2:
        return None
    s = s.since(k)
    # The newest image's depths are left to the window that begins with it.
    rho = s.rho.copy()
    rho[-1] = 0.0
    # a point counts if two images show it and one of them has measured its depth
    usable = (agree[k:].sum(axis=0) > 1) & (rho > 0).any(axis=0)
    seen = agree[k:] & usable
    R_all, p_all = np.array(R[::-1]), np.array(p[::-1])  # from the oldest image to the newest
    points = _back_project(R_all, p_all, s.at, rho)
    return _bundle_adjust(replace(s, seen=seen, rho=rho), R_all, p_all, points, k, scaled=True)


def structure_without_depth(s: Observations) -> Structure | None:
    """Cameras by bearings alone: two images by their essential matrix, the others by P3P, then all images at once.

    The latter is a bundle adjustment of cameras and points, Zhao 2023 (2).

    The two images are the newest and the oldest that shares enough points with it; older ones are left out. None if
    there is no such pair, or if its parallax is too small.
    """
    last = len(s.seen) - 1
    for k in range(last - 1):  # from the oldest image on; at least one image lies between the two
        shared = np.flatnonzero(s.seen[k] & s.seen[last])
        if len(shared) < 2 * _MIN_POINTS:
            continue
        a, b = s.at[k, shared], s.at[last, shared]  # (N, 2) in the older and in the newest image
        E, _ = cv2.findEssentialMat(
            a, b, np.eye(3), method=cv2.RANSAC, prob=_PAIR_CONFIDENCE, threshold=_PAIR_ERROR_SD * s.sd
        )
        if E is None or E.shape != (3, 3):
            continue
        # the newest camera <- the older one; the mask is of points in front of both cameras
        recovered = cv2.recoverPose(E, a, b, np.eye(3), distanceThresh=_MAX_BASELINES)
        inlier_count, rotation, translation, mask = recovered[:4]
        fits = np.asarray(mask)[:, 0] > 0
        if inlier_count < _MIN_POINTS or inlier_count < _MIN_PAIR_SHARE * len(shared):
            continue
        M, t = np.asarray(rotation, float), np.asarray(translation, float)[:, 0]
        # parallax: angle between the two rays of a point, without that by the cameras' rotation
        parallax = _angles_between(directions(a[fits]) @ M.T, directions(b[fits]))
        if np.median(parallax) < _MIN_PAIR_PARALLAX_RAD:
            return None  # older ones are missing, and newer ones have less parallax
        return _connect_images(s.since(k), shared[fits], M, t, k)
    return None


def _connect_images(s: Observations, shared: NDArray[np.int64], M: Array, t: Array, first: int) -> Structure | None:
    """Structure of K images from the known relative pose M (3, 3), t (3,) of the oldest in the newest.

    Points seen by both are triangulated, the images between are placed by P3P, and all are adjusted. None if an image
    shows too few of these points.

    Args:
        s: Observations of the K images.
        shared: Indices of the points that are inliers of the relative pose.
        M: (3, 3) rotation, newest camera <- oldest camera.
        t: (3,) position of the oldest camera in the newest one's axes, in units of their distance.
        first: Index of the oldest of these images among all, which `Structure.first` reports.
    """
    K, N = s.seen.shape
    ends = np.zeros((K, N), bool)  # observations of the inliers in the oldest and in the newest image
    ends[0, shared] = ends[-1, shared] = True
    points, sure = _triangulate(np.array([M, np.eye(3)]), np.array([t, np.zeros(3)]), s.at[[0, -1]], ends[[0, -1]])
    R, p = [M], [t]
    for k in range(1, K - 1):
        use = np.flatnonzero(sure & s.seen[k])
        step = _solve_pose(s, points[use], s.at[k, use])
        if step is None:
            return None
        R_k, t_k, _ = step  # camera k <- newest camera; the inverse is kept
        R.append(R_k.T)
        p.append(-R_k.T @ t_k)
    R_all, p_all = np.array([*R, np.eye(3)]), np.array([*p, np.zeros(3)])
    seen = s.seen & (s.seen.sum(axis=0) > 1)  # observations of points that two images show
    points, sure = _triangulate(R_all, p_all, s.at, seen)
    return _bundle_adjust(replace(s, seen=seen & sure, rho=np.zeros((K, N))), R_all, p_all, points, first, scaled=False)


def solve_pnp(points: Array, at: Array, error: float, fewest: float) -> tuple[Array, Array, NDArray[np.bool_]] | None:
    """Pose of a camera by P3P with RANSAC from points (N, 3) and their observations (N, 2) on the plane at depth 1.

    Args:
        points: (N, 3) points in any axes.
        at: (N, 2) observations of the points on the plane at depth 1.
        error: Largest residual of an inlier, on the plane at depth 1.
        fewest: Smallest number of inliers.

    Returns:
        (3, 3) rotation and (3,) translation, camera <- axes of the points, and (N,) the inliers; None if there are too
        few.
    """
    if len(points) < fewest:
        return None
    success, rotation, translation, inliers = cv2.solvePnPRansac(
        points, at, np.eye(3), None, iterationsCount=60, reprojectionError=error, flags=cv2.SOLVEPNP_AP3P
    )
    if not success or inliers is None or len(inliers) < fewest:
        return None
    fits = np.zeros(len(points), bool)
    fits[inliers[:, 0]] = True
    R = np.asarray(cv2.Rodrigues(rotation)[0], float)  # from OpenCV's rotation vector
    return R, np.asarray(translation, float)[:, 0], fits


def _solve_pose(s: Observations, points: Array, at: Array) -> tuple[Array, Array, NDArray[np.bool_]] | None:
    """Pose of a camera by P3P with RANSAC, with limits from the observations' noise and the number of points.

    Args:
        s: Gives the noise of an observation.
        points: (N, 3) points in any axes.
        at: (N, 2) observations of the points on the plane at depth 1.

    Returns:
        (3, 3) rotation and (3,) translation, camera <- axes of the points, and (N,) the inliers. None if these are
        fewer than `_MIN_POINTS`, or than the share `_MIN_POSE_SHARE` of the points.
    """
    return solve_pnp(points, at, _POSE_ERROR_SD * s.sd, max(_MIN_POINTS, _MIN_POSE_SHARE * len(points)))


def _back_project(R: Array, p: Array, at: Array, rho: Array) -> Array:
    """(N, 3) points, m, from the first measured inverse depth of each, in the axes of the newest camera.

    A point without any measured depth gets the depth 1 of the first camera; it must not be used.

    Args:
        R: (K, 3, 3) newest camera <- camera.
        p: (K, 3) positions of the cameras, m.
        at: (K, N, 2) observations on the plane at depth 1.
        rho: (K, N) measured inverse depths, 1/m; 0 where none.
    """
    n = np.arange(at.shape[1])
    k = (rho > 0).argmax(axis=0)  # (N,) first image with a measured depth of each point, 0 without any
    depth = 1.0 / np.where(rho[k, n] > 0, rho[k, n], 1.0)
    return matvec(R[k], directions(at[k, n]) * depth[:, None]) + p[k]


def _triangulate(R: Array, p: Array, at: Array, seen: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """(N, 3) points nearest to all their rays, and (N,) whether they are determined and in front of all cameras.

    Least squares: Σ (I − d dᵀ) (X − p) = 0 over unit rays d from the cameras' positions p.

    Args:
        R: (K, 3, 3) newest camera <- camera.
        p: (K, 3) positions of the cameras.
        at: (K, N, 2) observations on the plane at depth 1.
        seen: (K, N) whether the camera sees the point.
    """
    ray = np.matmul(directions(at), np.swapaxes(R, 1, 2))  # d, in the axes of the newest camera
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    # (K, N, 3, 3) I - d dᵀ, the projection across each ray; 0 where the point is not seen
    across = (np.eye(3) - ray[..., :, None] * ray[..., None, :]) * seen[..., None, None]
    # The least eigenvalue is about that of two rays, ½ angle², times their number.
    A = across.sum(axis=0)
    sure = np.linalg.eigvalsh(A)[:, 0] > 0.5 * _MIN_PARALLAX_RAD**2
    b = np.einsum("knij,kj->ni", across, p)
    points = np.linalg.solve(A + 1e-9 * np.eye(3), b[..., None])[..., 0]
    depth = np.matmul(points[None] - p[:, None], R)[..., 2]  # (K, N) of each point in each camera
    is_in_front = depth > _DEPTH_MIN
    return points, sure & (is_in_front | ~seen).all(axis=0)


def _bundle_adjust(s: Observations, R: Array, p: Array, points: Array, first: int, scaled: bool) -> Structure | None:
    """Adjusts cameras and points until they fit the observations best, then once more without outliers.

    Bundle adjustment: it minimises the residuals of image points and of measured inverse depths, Zhao 2023 (1) and (3),
    by Huber's rule.

    Args:
        s: Observations in K images.
        R: (K, 3, 3) newest camera <- camera, the start.
        p: (K, 3) positions of the cameras, the start.
        points: (N, 3) points in the axes of the newest camera, the start.
        first: Index of the first of these images among all, which `Structure.first` reports.
        scaled: Whether lengths are in m by measured depths; if not, the distance of the first camera stays.

    Returns:
        The cameras with their information; None if too few observations agree.
    """
    use = s.seen.sum(axis=0) > 1  # points that two images show
    s = replace(s, seen=s.seen[:, use], at=s.at[:, use], rho=s.rho[:, use])
    points = points[use]
    for steps in (3, 2):  # largest number of steps with all observations, then without outliers
        if (s.seen.sum(axis=1) < _MIN_POINTS).any() or not np.isfinite(points).all():
            return None
        R, p, points = _minimize(s, R, p, points, scaled, steps)
        r, _ = _residuals(s, R, p, points)  # (K, N, 3) in standard deviations: image x and y, inverse depth
        off = np.linalg.norm(r[..., :2], axis=-1)
        seen = s.seen & (off < _CULL_SD)
        rho = np.where(np.abs(r[..., 2]) < _CULL_SD, s.rho, 0.0)
        # a point stays if two images show it and, where depths give the scale, one of its depths is left
        seen &= (seen.sum(axis=0) > 1) & ((rho > 0).any(axis=0) | (not scaled))
        fits = float(seen.sum() / max(s.seen.sum(), 1))  # share of the observations that stay
        s = replace(s, seen=seen, rho=rho)
    if (s.seen.sum(axis=1) < _MIN_POINTS).any() or fits < _MIN_KEPT_SHARE:
        return None
    r, _ = _residuals(s, R, p, points)
    H = _equations(s, R, p, points, scaled).H
    if not np.isfinite(H).all():
        return None
    # degrees of freedom: two residuals per observation and one per depth, less six per camera and three per point
    freedom = 2 * s.seen.sum() + (s.rho > 0)[s.seen].sum() - 6 * len(R) - 3 * s.seen.any(axis=0).sum()
    return Structure(first=first, R=R, p=p, information=H, misfit=float((r**2).sum() / max(freedom, 1)), scaled=scaled)


def _minimize(
    s: Observations, R: Array, p: Array, points: Array, scaled: bool, steps: int
) -> tuple[Array, Array, Array]:
    """Levenberg-Marquardt over cameras and points in at most `steps`; returns cameras R, p and points.

    A step that does not lower the cost is not taken, and the damping increases. The newest camera does not move.

    Args:
        s: Observations in K images.
        R: (K, 3, 3) newest camera <- camera, the start.
        p: (K, 3) positions of the cameras, the start.
        points: (N, 3) points in the axes of the newest camera, the start.
        scaled: Whether lengths are in m by measured depths; if not, the distance of the first camera stays.
        steps: Largest number of steps.
    """
    damping, cost = _DAMPING, _cost(_residuals(s, R, p, points)[0])
    for _ in range(steps):
        m = _equations(s, R, p, points, scaled)
        n = len(m.b) - 6  # the newest camera is fixed
        e = np.zeros((len(R), 6))  # step of each camera: position, attitude on its right
        e.reshape(-1)[:n] = np.linalg.solve(m.H[:n, :n] + np.diag(damping * m.H.diagonal()[:n] + 1e-9), m.b[:n])
        # (N, 3) step of each point, given that of the cameras: H_pp⁻¹ (b_p - H_pc e)
        e_points = matvec(m.points_inverse, m.b_points - np.einsum("knab,ka->nb", m.cross, e))
        R_new, p_new = R @ exp(e[:, 3:]), p + e[:, :3]
        new = _cost(_residuals(s, R_new, p_new, points + e_points)[0])
        if not new < cost:
            damping *= 100.0
            continue
        R, p, points, enough = R_new, p_new, points + e_points, cost - new < _COST_TOLERANCE * cost
        cost, damping = new, 0.1 * damping
        if enough:
            break
    return R, p, points


def _residuals(s: Observations, R: Array, p: Array, points: Array) -> tuple[Array, Array]:
    """Residuals of all observations in K cameras, in standard deviations.

    Returns:
        (K, N, 3) residuals: image x and y (Zhao 2023 (1)) and inverse depth (Zhao 2023 (3)), 0 where not observed;
        (K, N, 3) points in the axes of each camera.
    """
    q = np.matmul(points[None] - p[:, None], R)  # (K, N, 3) points in the axes of each camera
    inverse = 1.0 / np.maximum(q[..., 2], _DEPTH_MIN)
    r = np.empty(q.shape)  # 0 where the point is not seen, or its depth not measured
    r[..., :2] = (q[..., :2] * inverse[..., None] - s.at) / s.sd * s.seen[..., None]
    r[..., 2] = (inverse - s.rho) / s.rho_sd * (s.seen & (s.rho > 0))
    return r, q


def _residual_norms(r: Array) -> Array:
    """(K, N, 2) length of the image residual and of the depth residual of each observation, in standard deviations."""
    return np.stack([np.linalg.norm(r[..., :2], axis=-1), np.abs(r[..., 2])], axis=-1)


def _cost(r: Array) -> float:
    """Sum of Huber costs of (K, N, 3) residuals in standard deviations."""
    size = _residual_norms(r)
    # twice Huber's: the square up to the limit, a line beyond it
    return float(np.where(size < _HUBER_SD, size**2, 2 * _HUBER_SD * size - _HUBER_SD**2).sum())


class _Normal(NamedTuple):
    """Normal equations, points eliminated.

    Attributes:
        H: (6K, 6K) matrix of the cameras.
        b: (6K,) right-hand side of the cameras.
        cross: (K, N, 6, 3) blocks between cameras and points.
        points_inverse: (N, 3, 3) inverse of each point's block.
        b_points: (N, 3) right-hand side of the points.
    """

    H: Array
    b: Array
    cross: Array
    points_inverse: Array
    b_points: Array


def _equations(s: Observations, R: Array, p: Array, points: Array, scaled: bool) -> _Normal:
    """Normal equations of cameras and points, weighted by Huber's rule, with the points eliminated.

    Residuals of Zhao 2023 (1) and (3) by the error states of each camera (position, attitude on its right) and the
    points. The step d of the cameras solves H d = b. Without measured depths (not `scaled`), the distance of the first
    camera from the newest is fixed.

    Args:
        s: Observations in K images.
        R: (K, 3, 3) newest camera <- camera.
        p: (K, 3) positions of the cameras.
        points: (N, 3) points in the axes of the newest camera.
        scaled: Whether measured depths give the scale.
    """
    r, q = _residuals(s, R, p, points)
    K, N = s.seen.shape
    inverse = 1.0 / np.maximum(q[..., 2], _DEPTH_MIN)
    # (K, N, 3) square root of Huber's weights: one for both image residuals, one for the depth residual
    w = np.sqrt(np.minimum(1.0, _HUBER_SD / np.maximum(_residual_norms(r), 1e-9)))[..., [0, 0, 1]]
    A = np.zeros((K, N, 3, 3))  # derivative of the three residuals by the point in the camera
    A[..., 0, 0] = A[..., 1, 1] = inverse / s.sd
    A[..., :2, 2] = -q[..., :2] * (inverse**2)[..., None] / s.sd
    A[..., 2, 2] = -(inverse**2) / s.rho_sd
    w *= np.stack([s.seen, s.seen, s.seen & (s.rho > 0)], axis=-1)  # no weight without an observation
    A *= w[..., None]
    r = r * w
    # (K, N, 3, 3) by the point in the axes of the newest camera, and (K, N, 3, 6) by the camera's position and attitude
    by_point = np.matmul(A.reshape(K, 3 * N, 3), np.swapaxes(R, 1, 2)).reshape(K, N, 3, 3)
    # with a · (q × e) = (a × q) · e for an error e of the attitude
    by_camera = np.concatenate([-by_point, np.cross(A, q[:, :, None])], axis=-1)
    H_points = _sum_residuals(by_point[..., :, None] * by_point[..., None, :]).sum(axis=0)
    b_points = -_sum_residuals(by_point * r[..., None]).sum(axis=0)
    # slight damping, so that the block of a point without observations is invertible
    loose = 1e-6 * np.trace(H_points, axis1=1, axis2=2)[:, None, None] + 1e-9
    H_points_inverse = np.linalg.inv(H_points + loose * np.eye(3))
    cross = _sum_residuals(by_camera[..., :, None] * by_point[..., None, :])  # (K, N, 6, 3) H_cp of each observation
    rows = cross.transpose(1, 0, 2, 3).reshape(N, 6 * K, 3)
    # H -= H_cp H_pp⁻¹ H_pc over the points, and b likewise
    gain = (rows @ H_points_inverse).transpose(1, 0, 2).reshape(6 * K, 3 * N)
    H, b = -gain @ rows.transpose(1, 0, 2).reshape(6 * K, 3 * N).T, -gain @ b_points.reshape(-1)
    for k in range(K):
        J, at = by_camera[k].reshape(3 * N, 6), slice(6 * k, 6 * k + 6)
        H[at, at] += J.T @ J
        b[at] -= J.T @ r[k].reshape(-1)
    if not scaled:
        n = p[0] / np.linalg.norm(p[0])  # from the newest camera to the first: no step along it
        H[:3, :3] += _SCALE_INFORMATION * np.outer(n, n)
    return _Normal(H, b, cross, H_points_inverse, b_points)


def _sum_residuals(a: Array) -> Array:
    """(K, N, ...) sums of an array (K, N, 3, ...) over the three residuals of each observation."""
    return np.asarray(a[:, :, 0] + a[:, :, 1] + a[:, :, 2])


def _angles_between(a: Array, b: Array) -> Array:
    """(N,) angle between vectors a and b (N, 3), rad."""
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.arctan2(cross, (a * b).sum(axis=-1)))
