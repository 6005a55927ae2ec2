"""Motion of a camera with depth as the IMU explains it: equations for its lever arm and the scale of its depth.

The gyro gives the rotation between two images, and features with depth the translation that is left (linear in it).
Over a part of a segment, rates and forces of the IMU give the path up to an initial velocity and gravity in the part's
first axes; the camera departs from it by the rotation of its lever arm (Kelly and Sukhatme, IJRR 30(1), 2011, who
estimate this in a filter). All of it is linear, also a common scale of the depth, so that the cost of a calibration is
a quadratic function of scale and lever arm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.scenarios.image_rotation import Tracks, find_rays
from stridetwin.streams.algebra.arrays import exp
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Block, Imu

PAIRS_OF_PART = 22
"""Pairs of images of a part: 0.7 s at 30 Hz, a half to two thirds of a stride, which turns a head to and fro."""
_MIN_PAIRS = 12
_FEWEST_POINTS = 20
_POINT_NOISE_PX, _WORST_POINT_PX = 0.25, 1.0  # of tracked pixels: noise of a feature, and the most that it counts
_DISPLACEMENT_SD_M = 0.002  # of the path between two images: noise of the IMU, rolling shutters, vibration
_POINT_ROUNDS = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionPart:
    """K consecutive pairs of images as linear equations in units of their noise.

    Attributes:
        terms: (3K, 4) of the scale of depth, and of lever arm times scale.
        seen: (3K,) displacements of the camera.
        nuisance: (3K, 6) terms of the part's initial velocity and of gravity.
        misfit: (K,) what the features of each pair leave over with the best translation.
    """

    terms: Array
    seen: Array
    nuisance: Array
    misfit: Array

    def sum_up(self, weight: Array) -> Quadratic:
        """The cost as a function of scale and lever arm, with weights (K,) of the pairs and the best nuisance."""
        root = np.sqrt(np.repeat(weight, 3))
        directions, _ = np.linalg.qr(self.nuisance * root[:, None])
        terms, seen = self.terms * root[:, None], self.seen * root
        terms, seen = terms - directions @ (directions.T @ terms), seen - directions @ (directions.T @ seen)
        constant = float(seen @ seen + weight @ self.misfit)
        return Quadratic(normal=terms.T @ terms, right=terms.T @ seen, constant=constant)

    def find_costs(self, solution: Array, weight: Array) -> Array:
        """(K,) cost of each pair for scale and lever arm (4,), with the best nuisance for weights (K,)."""
        root = np.sqrt(np.repeat(weight, 3))
        left = self.seen - self.terms @ solution
        values = np.linalg.lstsq(self.nuisance * root[:, None], left * root, rcond=None)[0]
        return np.asarray(np.sum((left - self.nuisance @ values).reshape(-1, 3) ** 2, axis=1) + self.misfit)


@dataclass(frozen=True, kw_only=True, eq=False)
class Quadratic:
    """A cost c - 2 bᵀx + xᵀAx of scale and lever arm times scale x (4,).

    Attributes:
        normal: (4, 4) A.
        right: (4,) b.
        constant: c.
    """

    normal: Array
    right: Array
    constant: float

    def __add__(self, other: Quadratic) -> Quadratic:
        return Quadratic(
            normal=self.normal + other.normal, right=self.right + other.right, constant=self.constant + other.constant
        )

    def __sub__(self, other: Quadratic) -> Quadratic:
        return Quadratic(
            normal=self.normal - other.normal, right=self.right - other.right, constant=self.constant - other.constant
        )

    def solve(self) -> Array:
        """(4,) the least cost's place."""
        return np.asarray(np.linalg.lstsq(self.normal, self.right, rcond=None)[0])

    def find_cost(self, solution: Array) -> float:
        """The cost at (4,)."""
        return float(self.constant - 2 * self.right @ solution + solution @ self.normal @ solution)


def build_parts(
    camera: CameraCalibration,
    T_imu_cam: Array,
    imu: Block[Imu],
    segments: Sequence[Sequence[Tracks]],
    shift_s: float,
) -> Iterator[MotionPart]:
    """Yields the equations of the parts of some segments, for a given calibration of the lens.

    Args:
        camera: The calibration.
        T_imu_cam: (4, 4) its pose on the IMU, of which the rotation counts.
        imu: All samples of the IMU.
        segments: Tracks of each segment; pairs without depth are left out.
        shift_s: t_imu = t_cam + shift.
    """
    for segment in segments:
        with_depth = [tracks for tracks in segment if tracks.depth is not None]
        count = max(1, round(len(with_depth) / PAIRS_OF_PART))
        for numbers in np.array_split(np.arange(len(with_depth)), count):
            pairs = [with_depth[int(i)] for i in numbers]
            part = _build_part(camera, T_imu_cam[:3, :3], imu, pairs, shift_s) if len(pairs) >= _MIN_PAIRS else None
            if part is not None:
                yield part


def _build_part(
    camera: CameraCalibration, R_imu_cam: Array, imu: Block[Imu], pairs: Sequence[Tracks], shift_s: float
) -> MotionPart | None:
    """The equations of K pairs; None if the IMU does not cover them, or too few features have depth."""
    spans = np.array([tracks.t_ns for tracks in pairs], np.int64) + round(shift_s * 1e9)  # (K, 2) by the IMU's clock
    first, last = np.searchsorted(imu.t_ns, (int(spans.min()), int(spans.max())))
    first, last = int(first) - 1, int(last) + 1
    if first < 0 or last > len(imu) or last - first < len(pairs):
        return None
    t_ns = imu.t_ns[first:last]
    t = (t_ns - t_ns[0]) * 1e-9  # (M,)
    columns = (imu.columns[name][first:last] for name in ("angular_rate", "specific_force"))
    rotation, fallen = _integrate(t, *columns)
    at = (spans - t_ns[0]) * 1e-9  # (K, 2)
    R_start_imu = _interpolate(at, t, rotation.reshape(-1, 9)).reshape(len(pairs), 2, 3, 3)
    places = _interpolate(at, t, fallen)  # (K, 2, 3)
    # (K, 3, 4) displacement per unit of scale, and of lever arm times scale
    terms = np.concatenate(((places[:, 1] - places[:, 0])[..., None], R_start_imu[:, 1] - R_start_imu[:, 0]), axis=2)
    duration, squares = at[:, 1] - at[:, 0], 0.5 * (at[:, 1] ** 2 - at[:, 0] ** 2)
    nuisance = np.stack([np.hstack((d * np.eye(3), s * np.eye(3))) for d, s in zip(duration, squares)])  # (K, 3, 6)
    rows_terms, rows_seen, rows_nuisance, misfits = [], [], [], []
    for k, tracks in enumerate(pairs):
        R_start_cam = R_start_imu[k] @ R_imu_cam  # (2, 3, 3) at both images
        translation = _solve_translation(camera, tracks, R_start_cam[1].T @ R_start_cam[0])
        if translation is None:
            continue
        # points move by t in the axes at the second image; the camera moves the other way
        seen = -R_start_cam[1] @ translation.value
        covariance = R_start_cam[1] @ translation.covariance @ R_start_cam[1].T + _DISPLACEMENT_SD_M**2 * np.eye(3)
        whiten = np.linalg.cholesky(np.linalg.inv(covariance)).T
        rows_terms.append(whiten @ terms[k])
        rows_seen.append(whiten @ seen)
        rows_nuisance.append(whiten @ nuisance[k])
        misfits.append(translation.misfit)
    if len(misfits) < _MIN_PAIRS:
        return None
    return MotionPart(
        terms=np.concatenate(rows_terms),
        seen=np.concatenate(rows_seen),
        nuisance=np.concatenate(rows_nuisance),
        misfit=np.array(misfits),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Translation:
    """Translation of points from one image to the next.

    Attributes:
        value: (3,) m, in the camera's axes at the second image.
        covariance: (3, 3) m².
        misfit: Sum of the squared residuals of the features in units of their noise, each limited.
    """

    value: Array
    covariance: Array
    misfit: float


def _solve_translation(camera: CameraCalibration, tracks: Tracks, R: Array) -> _Translation | None:
    """The translation of features with depth, whose rotation R (3, 3) from one image to the next is known.

    A feature X = R X₁ + t is seen at x₂, so that (x₂, y₂) (X₃) = (X₁, X₂), which is linear in t. Features with a large
    residual count less and less.
    """
    assert tracks.depth is not None
    has_depth = tracks.depth > 0
    if has_depth.sum() < _FEWEST_POINTS:
        return None
    before, after = find_rays(tracks.before[has_depth], camera), find_rays(tracks.after[has_depth], camera)
    points = np.column_stack((before, np.ones(len(before)))) * tracks.depth[has_depth, None] @ R.T
    in_front = points[:, 2] > 0
    points, after = points[in_front], after[in_front]
    if len(points) < _FEWEST_POINTS:
        return None
    # in units of the noise of a feature
    scale = np.array(camera.intrinsics[:2]) / (tracks.tracked_px * _POINT_NOISE_PX) / points[:, 2:]  # (P, 2)
    A = np.zeros((len(points), 2, 3))
    A[:, 0, 0], A[:, 1, 1] = scale[:, 0], scale[:, 1]
    A[:, :, 2] = -after * scale
    b = (after * points[:, 2:] - points[:, :2]) * scale
    most = (_WORST_POINT_PX / _POINT_NOISE_PX) ** 2
    weight = np.ones(len(points))
    for _ in range(_POINT_ROUNDS):
        normal = np.einsum("p,pij,pik->jk", weight, A, A) + 1e-9 * np.eye(3)
        value = np.linalg.solve(normal, np.einsum("p,pij,pi->j", weight, A, b))
        squared = np.sum((A @ value - b) ** 2, axis=1)
        weight = 1 / (1 + squared / most)
    return _Translation(
        value=value, covariance=np.linalg.inv(normal), misfit=float(np.sum(most * np.log1p(squared / most)))
    )


def _integrate(t: Array, rate: Array, force: Array) -> tuple[Array, Array]:
    """Rotations (M, 3, 3) and positions (M, 3), m, of an IMU that starts at rest and without gravity.

    Args:
        t: (M,) s.
        rate: (M, 3) rad/s.
        force: (M, 3) m/s².
    """
    steps = np.diff(t)
    turns = exp(0.5 * (rate[1:] + rate[:-1]) * steps[:, None])
    rotation = np.empty((len(t), 3, 3))
    rotation[0] = np.eye(3)
    for i in range(len(steps)):
        rotation[i + 1] = rotation[i] @ turns[i]
    pushed = np.einsum("mij,mj->mi", rotation, force)
    mean = 0.5 * (pushed[1:] + pushed[:-1]) * steps[:, None]
    velocity = np.vstack((np.zeros(3), np.cumsum(mean, axis=0)))
    moved = 0.5 * (velocity[1:] + velocity[:-1]) * steps[:, None]
    return rotation, np.vstack((np.zeros(3), np.cumsum(moved, axis=0)))


def _interpolate(at: Array, t: Array, values: Array) -> Array:
    """(K, 2, D) values (M, D) at times (M,), interpolated at times (K, 2)."""
    return np.stack([np.interp(at, t, values[:, k]) for k in range(values.shape[1])], axis=-1)
