"""Motion of a camera with depth as the IMU explains it: equations for its lever arm and the scale of its depth.

The gyro gives the rotation between two images, and features with depth the translation that is left (linear in it).
Over a part of a segment, rates and forces of the IMU give the path up to an initial velocity and gravity in the part's
first axes; the camera departs from it by the rotation of its lever arm (Kelly and Sukhatme, IJRR 30(1), 2011, who
estimate this in a filter). Of a rolling shutter each row has its own instant, which looks like another lever arm; so
its readout is unknown as well. All of it is linear, also a common scale of the depth: the cost of a calibration is a
quadratic function of scale, lever arm and readout.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stridetwin.scenarios.image_rotation import PairTracks
from stridetwin.streams.algebra.arrays import cross, exp
from stridetwin.streams.even_steps import integrate
from stridetwin.streams.rays import find_rays
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Block, Imu
from stridetwin.streams.time_series import accumulate, interpolate

PAIRS_OF_PART = 22
"""Pairs of images of a part: 0.7 s at 30 Hz, a half to two thirds of a stride, which turns a head to and fro."""
_MIN_PAIRS = 12
"""Fewest pairs of images of a part."""
_FEWEST_POINTS = 20
"""Fewest features with depth of a pair of images."""
_POINT_NOISE_PX, _WORST_POINT_PX = 0.25, 1.0  # of tracked pixels: noise of a feature, and the most that it counts
_DISPLACEMENT_SD_M = 0.002  # of the path between two images: noise of the IMU, rolling shutters, vibration
_POINT_ROUNDS = 3
"""Rounds of weighing the features of a pair by what its translation leaves over."""
SCALE, ARM, READOUT = 0, slice(1, 4), 4
"""Places of the unknowns: scale of the depth, lever arm times scale in m, readout in `READOUT_UNIT_S`."""
READOUT_UNIT_S = 0.01
"""Unit of the readout among the unknowns, s: its usual size, so that all unknowns are of one order."""
UNKNOWNS = 5
"""Number of the unknowns."""
_ROWS = 4
"""Equations of a pair of images: three of the displacement, one of the readout."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionPart:
    """K consecutive pairs of images as linear equations in units of their noise: terms @ x + nuisance @ y = seen.

    Attributes:
        terms: (4K, 5) factors of the unknowns x.
        seen: (4K,) displacement of the camera between the images of each pair (3), and readout (1), by the features.
        nuisance: (4K, 6) factors of y, the initial velocity and gravity, in the IMU's axes at the part's start.
        misfit: (K,) sum of squared residuals that the features of each pair leave over with the best translation.
    """

    terms: Array
    seen: Array
    nuisance: Array
    misfit: Array

    def sum_up(self, weight: Array) -> Quadratic:
        """The cost as a function of the unknowns, with weights (K,) of the pairs and the best nuisance."""
        root = np.sqrt(np.repeat(weight, _ROWS))
        directions, _ = np.linalg.qr(self.nuisance * root[:, None])
        terms, seen = self.terms * root[:, None], self.seen * root
        terms, seen = terms - directions @ (directions.T @ terms), seen - directions @ (directions.T @ seen)
        constant = float(seen @ seen + weight @ self.misfit)
        return Quadratic(normal=terms.T @ terms, right=terms.T @ seen, constant=constant)

    def find_costs(self, solution: Array, weight: Array) -> Array:
        """(K,) cost of each pair for unknowns (5,), with the best nuisance for weights (K,)."""
        root = np.sqrt(np.repeat(weight, _ROWS))
        left = self.seen - self.terms @ solution
        values = np.linalg.lstsq(self.nuisance * root[:, None], left * root, rcond=None)[0]
        return np.asarray(np.sum((left - self.nuisance @ values).reshape(-1, _ROWS) ** 2, axis=1) + self.misfit)


@dataclass(frozen=True, kw_only=True, eq=False)
class Quadratic:
    """A cost c - 2 bᵀx + xᵀAx of the unknowns x (5,), a sum of squared residuals in units of their noise.

    Attributes:
        normal: (5, 5) A.
        right: (5,) b.
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
        """(5,) where the cost is least."""
        return np.asarray(np.linalg.lstsq(self.normal, self.right, rcond=None)[0])

    def find_cost(self, solution: Array) -> float:
        """The cost at unknowns (5,)."""
        return float(self.constant - 2 * self.right @ solution + solution @ self.normal @ solution)


@dataclass(frozen=True, kw_only=True, eq=False)
class InertialPart:
    """What the IMU says about K consecutive pairs of images, for any calibration of the lens.

    Attributes:
        pairs: Tracks of the pairs.
        R_start_cam: (K, 2, 3, 3) rotations of the camera's axes at both images into the IMU's axes at the part's start.
        terms: (K, 3, 4) displacement of the camera between both images per unit of scale, m, and of lever arm times
            scale, in the IMU's axes at the start.
        nuisance: (K, 3, 6) displacement per unit of initial velocity, s, and of gravity, s², in the same axes.
        rates: (K, 2, 3) rotation rates at both images in the camera's axes, rad/s.
        speed_up: (K, 3) change of the velocity between them, in the camera's axes at the second, m/s.
    """

    pairs: Sequence[PairTracks]
    R_start_cam: Array
    terms: Array
    nuisance: Array
    rates: Array
    speed_up: Array


def prepare_parts(
    R_imu_cam: Array,
    imu: Block[Imu],
    segments: Sequence[Sequence[PairTracks]],
    shift_s: float,
    *,
    needs_depth: bool = True,
) -> Iterator[InertialPart]:
    """Yields what the IMU says about the parts of some segments.

    Args:
        R_imu_cam: (3, 3) rotation of the camera's axes into the IMU's.
        imu: All samples of the IMU.
        segments: Tracks of each segment.
        shift_s: t_imu = t_cam + shift, s.
        needs_depth: Whether pairs without depth are left out.

    Yields:
        Parts of about `PAIRS_OF_PART` pairs, `_MIN_PAIRS` at least; without those that the IMU does not cover.
    """
    for segment in segments:
        usable = [tracks for tracks in segment if tracks.depth is not None or not needs_depth]
        count = max(1, round(len(usable) / PAIRS_OF_PART))
        for numbers in np.array_split(np.arange(len(usable)), count):
            pairs = [usable[int(i)] for i in numbers]
            part = _prepare_part(R_imu_cam, imu, pairs, shift_s) if len(pairs) >= _MIN_PAIRS else None
            if part is not None:
                yield part


def build_parts(camera: CameraCalibration, parts: Sequence[InertialPart]) -> list[MotionPart]:
    """The equations of parts for a calibration of the lens; without parts of too few features with depth."""
    built = (_build_part(camera, part) for part in parts)
    return [part for part in built if part is not None]


def _prepare_part(
    R_imu_cam: Array, imu: Block[Imu], pairs: Sequence[PairTracks], shift_s: float
) -> InertialPart | None:
    """What the IMU says about K pairs; None if it does not cover them, or has fewer samples than there are pairs.

    Args:
        R_imu_cam: (3, 3) rotation of the camera's axes into the IMU's.
        imu: All samples of the IMU.
        pairs: Tracks of the pairs.
        shift_s: t_imu = t_cam + shift, s.
    """
    spans = np.array([tracks.t_ns for tracks in pairs], np.int64) + round(shift_s * 1e9)  # (K, 2) by the IMU's clock
    first, last = np.searchsorted(imu.t_ns, (int(spans.min()), int(spans.max())))
    first, last = int(first) - 1, int(last) + 1
    if first < 0 or last > len(imu) or last - first < len(pairs):
        return None
    t_ns = imu.t_ns[first:last]
    t = (t_ns - t_ns[0]) * 1e-9  # (M,)
    rate, force = (imu.columns[name][first:last] for name in ("angular_rate", "specific_force"))
    rotation, fallen = _integrate_samples(t, rate, force)
    at = (spans - t_ns[0]) * 1e-9  # (K, 2)
    R_start_imu = interpolate(at, t, rotation.reshape(-1, 9)).reshape(len(pairs), 2, 3, 3)
    R_start_cam = R_start_imu @ R_imu_cam
    moved = np.diff(interpolate(at, t, fallen), axis=1)[:, 0]  # (K, 3)
    duration, squares = at[:, 1] - at[:, 0], 0.5 * (at[:, 1] ** 2 - at[:, 0] ** 2)
    # without its mean, which is gravity: nobody speeds up for long
    pushed = np.einsum("mij,mj->mi", rotation, force)
    acceleration = interpolate(at, t, pushed - pushed.mean(axis=0)).mean(axis=1)  # (K, 3)
    return InertialPart(
        pairs=pairs,
        R_start_cam=R_start_cam,
        terms=np.concatenate((moved[..., None], R_start_imu[:, 1] - R_start_imu[:, 0]), axis=2),
        nuisance=np.concatenate((duration[:, None, None] * np.eye(3), squares[:, None, None] * np.eye(3)), axis=2),
        rates=interpolate(at, t, rate) @ R_imu_cam,
        speed_up=np.einsum("kji,kj->ki", R_start_cam[:, 1], acceleration) * duration[:, None],
    )


def _build_part(camera: CameraCalibration, part: InertialPart) -> MotionPart | None:
    """The equations of a part for a given calibration of the lens; None if too few pairs have features with depth."""
    rows_terms, rows_seen, rows_nuisance, misfits = [], [], [], []
    for k, tracks in enumerate(part.pairs):
        before, after = part.R_start_cam[k]
        motion = _solve_motion(camera, tracks, after.T @ before, part.rates[k], part.speed_up[k])
        if motion is None:
            continue
        # points move by t in the axes at the second image; the camera moves the other way
        to_start = np.eye(_ROWS)
        to_start[:3, :3] = -after
        covariance = to_start @ motion.covariance @ to_start.T
        covariance[:3, :3] += _DISPLACEMENT_SD_M**2 * np.eye(3)
        whiten = np.linalg.cholesky(np.linalg.inv(covariance)).T
        terms = np.zeros((_ROWS, UNKNOWNS))
        terms[:3, :4], terms[3, READOUT] = part.terms[k], 1.0
        rows_terms.append(whiten @ terms)
        rows_seen.append(whiten @ (to_start @ motion.value))
        rows_nuisance.append(whiten @ np.vstack((part.nuisance[k], np.zeros(6))))
        misfits.append(motion.misfit)
    if len(misfits) < _MIN_PAIRS:
        return None
    return MotionPart(
        terms=np.concatenate(rows_terms),
        seen=np.concatenate(rows_seen),
        nuisance=np.concatenate(rows_nuisance),
        misfit=np.array(misfits),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _PointMotion:
    """Motion of points from one image to the next.

    Attributes:
        value: (4,) translation of the points, m, in the camera's axes at the second image; readout in `READOUT_UNIT_S`.
        covariance: (4, 4) of these.
        misfit: Sum of the squared residuals of the features in units of their noise, each limited.
    """

    value: Array
    covariance: Array
    misfit: float


def _solve_motion(
    camera: CameraCalibration, tracks: PairTracks, R: Array, rates: Array, speed_up: Array
) -> _PointMotion | None:
    """The translation of features with depth, whose rotation from one image to the next is known, and the readout.

    A feature X = R X₁ + t is seen at x₂, so that (x₂, y₂) X₃ = (X₁, X₂), which is linear in t. Of a rolling shutter, a
    row at s (-0.5 to 0.5) of the image is read s times the readout later; between the two images the camera then turns
    by s₂ ω₂ - s₁ ω₁ times the readout more, and moves by s times the change of its velocity. Features with a large
    residual count less and less.

    Args:
        camera: Calibration of the lens.
        tracks: Features in both images.
        R: (3, 3) rotation of points from the first image to the second.
        rates: (2, 3) rotation rates at both images in the camera's axes, rad/s.
        speed_up: (3,) change of the velocity between the images, in the axes at the second, m/s.

    Returns:
        Translation and readout; None with too few features.
    """
    assert tracks.depth is not None
    has_depth = tracks.depth > 0
    if has_depth.sum() < _FEWEST_POINTS:
        return None
    before, after = find_rays(tracks.before[has_depth], camera), find_rays(tracks.after[has_depth], camera)
    points = np.column_stack((before, np.ones(len(before)))) * tracks.depth[has_depth, None] @ R.T
    # (P, 2) how late the rows of a feature are read in both images, in multiples of the readout
    late = np.column_stack((tracks.before[has_depth, 1], tracks.after[has_depth, 1])) / camera.height - 0.5
    turn = late[:, 1:] * rates[1] - late[:, :1] * rates[0]
    # points move against the camera
    by_readout = -READOUT_UNIT_S * (cross(turn, points) + late.mean(axis=1)[:, None] * speed_up)
    in_front = points[:, 2] > 0
    points, after, by_readout = points[in_front], after[in_front], by_readout[in_front]
    if len(points) < _FEWEST_POINTS:
        return None
    # in units of the noise of a feature
    scale = np.array(camera.intrinsics[:2]) / (tracks.tracked_px * _POINT_NOISE_PX) / points[:, 2:]  # (P, 2)
    rows = np.zeros((len(points), 2, 4))
    rows[:, 0, 0], rows[:, 1, 1] = 1.0, 1.0
    rows[:, :, 2] = -after
    rows[:, :, 3] = by_readout[:, :2] - after * by_readout[:, 2:]
    A: Array = (rows * scale[..., None]).reshape(-1, 4)
    b = ((after * points[:, 2:] - points[:, :2]) * scale).reshape(-1)
    most = (_WORST_POINT_PX / _POINT_NOISE_PX) ** 2
    weight = np.ones(len(points))
    for _ in range(_POINT_ROUNDS):
        # without rotation the readout is unknown; the little weight keeps it at 0
        weighted = A.T * weight.repeat(2)
        normal = weighted @ A + 1e-6 * np.eye(4)
        value = np.linalg.solve(normal, weighted @ b)
        squared = ((A @ value - b) ** 2).reshape(-1, 2).sum(axis=1)
        weight = 1 / (1 + squared / most)
    misfit = float(np.sum(most * np.log1p(squared / most)))
    return _PointMotion(
        value=np.asarray(value, float), covariance=np.asarray(np.linalg.inv(normal), float), misfit=misfit
    )


def _integrate_samples(t: Array, rate: Array, force: Array) -> tuple[Array, Array]:
    """Rotations and positions of an IMU by its samples, from rest and without gravity.

    A sample is the mean over the interval that ends at its stamp (docs/design.md, conventions).

    Args:
        t: (M,) s.
        rate: (M, 3) rad/s.
        force: (M, 3) m/s².

    Returns:
        (M, 3, 3) rotations of the IMU's axes into those at the start, and (M, 3) positions in the latter, m.
    """
    steps = np.diff(t)
    halves = exp(0.5 * rate[1:] * steps[:, None])
    rotation, middle = np.empty((len(t), 3, 3)), np.empty((len(steps), 3, 3))
    rotation[0] = np.eye(3)
    for i in range(len(steps)):
        middle[i] = rotation[i] @ halves[i]
        rotation[i + 1] = middle[i] @ halves[i]
    velocity = accumulate(steps, np.einsum("mij,mj->mi", middle, force[1:]))
    return rotation, integrate(t, velocity)
