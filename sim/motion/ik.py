"""Inverse kinematics: coordinates, segment lengths and places of markers that fit recorded points best.

All frames are solved together. The coordinates minimise the squared distances of markers and targets, weak priors and
the squared third differences over time, which act like a zero-phase filter of order three. Gauss-Newton steps; the
normal equations are banded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from stridetwin.sim.motion.marker_sets import MarkerPlace
from stridetwin.sim.motion.parameters import MotionParameters
from stridetwin.sim.motion.read import MarkerTable
from stridetwin.sim.motion.skeleton import (
    LENGTHS,
    LengthChanges,
    Skeleton,
    length_values,
    lengths_of,
    with_lengths,
    with_twist,
)
from stridetwin.sim.people import Person
from stridetwin.sim.wearer.anthropometry import LEAF_LENGTHS_M, leaf_scales
from stridetwin.sim.wearer.body import LEG_JOINTS
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

_CHUNK = 256  # frames whose Jacobians are held at once
_STATURE_M = 1.741  # of the person for whom the sets of markers are written
_INDEPENDENT_FRAMES = 4.0  # skin moves with the posture and returns with it: frames whose errors are independent
_LENGTH_SD = {"hip_width_m": 0.01, "trunk_m": 0.05, "ankle_height_m": 0.012, "shoe_m": 0.015}
_USUAL_LENGTH_SD_M = 0.03
# adults' feet point 12 ± 8.7° outward against the knees (thigh-foot angle of -5 to 30°: Staheli et al. 1985)
_USUAL_TWIST_RAD, _TWIST_SD_RAD = np.radians([12.0, 8.7])
_TWIST_LIMITS_RAD = np.radians([-30.0, 50.0])
_FITTED_M = 2e-4  # largest change of a length or place in the last step
_LENGTH_LIMITS_M = {
    "thigh_m": (0.28, 0.56), "shank_m": (0.28, 0.56), "ankle_height_m": (0.06, 0.15), "hip_width_m": (0.11, 0.24),
    "trunk_m": (0.60, 1.05), "shoulder_width_m": (0.24, 0.50), "upper_arm_m": (0.20, 0.40),
    "forearm_m": (0.18, 0.36), "shoe_m": (0.20, 0.32),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class PointSet:
    """Points on bodies whose paths in the world are given.

    Attributes:
        names: (P,) of the points.
        bodies: (P,) numbers of their bodies.
        places: (P, 3) m, in the bodies' frames.
        sd_m: (P,) scatter of the places; 0 of places that are known.
        paths: (N, P, 3) m in the world; NaN where unknown.
        weights: (N, P) 1/m, inverse of the scatter of the paths.
    """

    names: tuple[str, ...]
    bodies: NDArray[np.int64]
    places: Array
    sd_m: Array
    paths: Array
    weights: Array

    @classmethod
    def of_markers(
        cls, table: MarkerTable, places: Mapping[str, MarkerPlace], skeleton: Skeleton, parameters: MotionParameters
    ) -> PointSet:
        """The markers of a table that have a place, for a wearer of any size."""
        kept = [i for i, name in enumerate(table.names) if name in places]
        chosen = [places[table.names[i]] for i in kept]
        body = skeleton.size.body
        scales = leaf_scales(body)
        along = {"foot": scales["shoe"]} | {part: scales[part] for part in ("thigh", "shank", "upper_arm", "forearm")}
        whole = (body.thigh_m + body.shank_m + body.trunk_m) / sum(
            LEAF_LENGTHS_M[part] for part in ("thigh", "shank", "trunk")
        )
        scale = np.ones((len(kept), 3))
        for row, place in zip(scale, chosen):
            part = place.body.removesuffix("_l").removesuffix("_r")
            row[:] = whole
            row[0 if part == "foot" else 2] = along.get(part, row[2])
        return cls(
            names=tuple(table.names[i] for i in kept),
            bodies=np.array([skeleton.index(place.body) for place in chosen]),
            places=np.array([place.place_m for place in chosen]) * scale,
            sd_m=np.array([place.sd_m for place in chosen]),
            paths=table.x[:, kept],
            weights=np.isfinite(table.x[:, kept, 0]) / parameters.marker_sd_m,
        )

    def append(self, other: PointSet) -> PointSet:
        """These points, and then others at the same instants."""
        return PointSet(
            names=self.names + other.names,
            bodies=np.concatenate([self.bodies, other.bodies]),
            places=np.concatenate([self.places, other.places]),
            sd_m=np.concatenate([self.sd_m, other.sd_m]),
            paths=np.concatenate([self.paths, other.paths], axis=1),
            weights=np.concatenate([self.weights, other.weights], axis=1),
        )

    def rows(self, rows: NDArray[np.int64] | slice) -> PointSet:
        """These points with their paths and weights at some instants alone, given by the rows of the instants."""
        return replace(self, paths=self.paths[rows], weights=self.weights[rows])


def initial_coordinates(skeleton: Skeleton, points: PointSet, source: str) -> Array:
    """(N, D) coordinates to begin with: the pelvis by a rigid fit to its markers, everything else upright.

    Raises:
        ConfigError: The pelvis has fewer than three markers.
    """
    on_pelvis = np.flatnonzero(points.bodies == skeleton.index("pelvis"))
    if len(on_pelvis) < 3:
        raise ConfigError(
            source, "markers", [points.names[i] for i in on_pelvis], "three or more markers on the pelvis"
        )
    x = np.zeros((len(points.paths), len(skeleton.layout.names)))
    last = None
    for k, path in enumerate(points.paths):
        seen = on_pelvis[np.isfinite(path[on_pelvis, 0])]
        if len(seen) >= 3:
            place, centre = points.places[seen].mean(0), path[seen].mean(0)
            R = Rotation.align_vectors(path[seen] - centre, points.places[seen] - place)[0].as_matrix()
            last = [*(centre - R @ place), np.arctan2(R[1, 0], R[0, 0])]
        if last is not None:
            x[k, :4] = last
    if last is None:
        raise ConfigError(source, "markers", "gaps", "three markers on the pelvis that are seen at once")
    first = np.flatnonzero(x[:, 2] != 0.0)[0]
    x[:first] = x[first]
    x[:, 3] = np.unwrap(x[:, 3])
    for side in ("l", "r"):
        x[:, skeleton.column(f"knee_flexion_{side}")] = 0.3
        x[:, skeleton.column(f"hip_flexion_{side}")] = 0.2
        x[:, skeleton.column(f"elbow_flexion_{side}")] = 0.4
    return x


def posture_prior(skeleton: Skeleton, points: PointSet, x: Array, dt: float, parameters: MotionParameters) -> Array:
    """(N, D) coordinates to which those tend that no marker shows.

    Without markers the trunk stays upright and turns with the path of the pelvis, the head with the trunk, and the
    arms swing with the opposite legs.

    Args:
        skeleton: The wearer.
        points: The markers.
        x: (N, D) present coordinates.
        dt: Time between two rows, s.
        parameters: Scatter of postures.
    """
    prior = np.zeros_like(x)
    seen = {skeleton.bodies[b].removesuffix("_l").removesuffix("_r") for b in points.bodies}
    if "torso" not in seen:
        turn = x[:, 3] - gaussian_filter1d(x[:, 3], 0.5 / dt, mode="nearest")
        prior[:, skeleton.column("lumbar_flexion")] = -x[:, 4]
        prior[:, skeleton.column("lumbar_bending")] = -x[:, 5]
        prior[:, skeleton.column("lumbar_rotation")] = -1.3 * turn
    for side, other in (("l", "r"), ("r", "l")):
        prior[:, skeleton.column(f"elbow_flexion_{side}")] = 0.4
        if "upper_arm" not in seen:
            prior[:, skeleton.column(f"shoulder_flexion_{side}")] = 0.6 * (
                x[:, skeleton.column(f"hip_flexion_{other}")] - 0.1
            )
            prior[:, skeleton.column(f"shoulder_abduction_{side}")] = 0.1
    return prior


def solve_coordinates(
    skeleton: Skeleton,
    points: PointSet,
    x: Array,
    dt: float,
    parameters: MotionParameters,
    rounds: int | None = None,
    targets: PointSet | None = None,
    follow_hz: Array | None = None,
) -> Array:
    """(N, D) coordinates that fit the paths of points best, smooth in time.

    Args:
        skeleton: The wearer.
        points: Points and their paths.
        x: (N, D) coordinates to begin with.
        dt: Time between two rows, s.
        parameters: Scatter, smoothing and number of steps.
        rounds: Number of steps, if it is another one.
        targets: Further points, whose paths are smooth already, so that they do not decide how much is smoothed.
        follow_hz: (D,) if given, not the coordinates are smoothed but their differences from those to begin with, each
            with its own frequency.
    """
    start = x
    smoothing: Array | None = None
    for _ in range(rounds or parameters.rounds):
        prior = posture_prior(skeleton, points, x, dt, parameters)
        H, g = _normal_equations(skeleton, points, x, prior, parameters)
        if smoothing is None:
            typical = np.mean(H, axis=0)  # of positive definite matrices, hence positive definite
            information = 1.0 / np.diag(np.linalg.inv(typical))
            usual = cutoffs_of(skeleton, parameters.cutoff_hz, parameters.trunk_cutoff_hz)
            cutoffs = usual if follow_hz is None else follow_hz
            smoothing = information * (2.0 * np.pi * cutoffs * dt) ** -6
        if targets is not None:
            H_targets, g_targets = _point_equations(skeleton, targets, x, parameters)
            H, g = H + H_targets, g + g_targets
        x = x + _solve_smooth(H, g, x if follow_hz is None else x - start, smoothing)
    return x


def cutoffs_of(skeleton: Skeleton, leg_hz: float, trunk_hz: float) -> Array:
    """(D,) Hz, one frequency for the joints of the legs, and one for all other coordinates."""
    is_leg = np.array([name.rpartition("_")[0] in LEG_JOINTS for name in skeleton.layout.names])
    return np.where(is_leg, leg_hz, trunk_hz)


def calibrate(
    person: Person,
    points: PointSet,
    x: Array,
    parameters: MotionParameters,
    rounds: int | None = None,
) -> tuple[Person, PointSet]:
    """Segment lengths of the person and places of the markers that fit some frames best.

    Lengths, places and the coordinates of every frame are one problem; the coordinates are eliminated frame by frame.

    Args:
        person: The person to begin with, whose lengths are all given.
        points: Markers, and points on bodies whose places are known.
        x: (N, D) coordinates to begin with.
        parameters: Scatter, number of frames and of steps.
        rounds: Number of steps, if it is another one.

    Returns:
        Person with fitted lengths; the points at their fitted places.
    """
    n = len(x)
    frames = np.unique(np.linspace(0, n - 1, min(n, parameters.calibration_frames)).astype(int))
    points_all, points, x = points, points.rows(frames), x[frames]
    start_lengths, start_places = length_values(lengths_of(replace(person, segments=None, shoe_m=None))), points.places
    lengths, places = length_values(person), points.places.copy()
    free = np.flatnonzero(points.sd_m > 0.0)
    length_sd = np.array([_LENGTH_SD.get(name, _USUAL_LENGTH_SD_M) for name in LENGTHS])
    low, high = np.array([_LENGTH_LIMITS_M[name] for name in LENGTHS]).T
    twist = 0.0 if person.segments is None else person.segments.shank_twist_rad or 0.0
    prior_precision = np.concatenate([length_sd**-2, [_TWIST_SD_RAD**-2], np.repeat(points.sd_m[free], 3) ** -2])
    share = min(1.0, _INDEPENDENT_FRAMES / len(frames))
    changes = LengthChanges.of(lengths_of(replace(person, segments=None, shoe_m=None)))  # the same for all lengths
    first_lengths, first_skeleton = lengths, Skeleton.of(person)
    L = len(LENGTHS)
    for _ in range(rounds or parameters.calibration_rounds):
        skeleton = changes.apply(first_skeleton, lengths - first_lengths).with_twist(twist)
        points = replace(points, places=places)
        prior = posture_prior(skeleton, points, x, 0.01, parameters)
        H, g, cross, shared, shared_g = _build_shared_equations(skeleton, points, changes, free, x, prior, parameters)
        off = np.concatenate(
            [lengths - start_lengths, [twist - _USUAL_TWIST_RAD], (places - start_places)[free].ravel()]
        )
        solved = np.linalg.solve(H, np.concatenate([cross, g[..., None]], axis=2))
        eliminated = cross.reshape(-1, cross.shape[2]).T @ solved.reshape(-1, solved.shape[2])
        reduced = share * (shared - eliminated[:, :-1]) + np.diag(prior_precision)
        right = share * (shared_g - eliminated[:, -1]) - prior_precision * off
        step = np.linalg.solve(reduced, right)
        x = x + solved[..., -1] - solved[..., :-1] @ step
        lengths = np.clip(lengths + step[:L], low, high)
        twist = float(np.clip(twist + step[L], *_TWIST_LIMITS_RAD))
        places = places.copy()
        places[free] += step[L + 1 :].reshape(-1, 3)
        if np.abs(step).max() < _FITTED_M:
            break
    return with_twist(with_lengths(person, lengths), twist), replace(points_all, places=places)


def point_errors(skeleton: Skeleton, points: PointSet, x: Array) -> Array:
    """(N, P) m, distances of points on the bodies from their paths; NaN where a path is unknown."""
    errors = np.empty(points.paths.shape[:2])
    for begin in range(0, len(x), _CHUNK):
        rows = slice(begin, begin + _CHUNK)
        at = skeleton.points(skeleton.poses(x[rows]), points.bodies, points.places)
        errors[rows] = np.linalg.norm(points.paths[rows] - at, axis=2)
    return errors


def _weigh(errors: Array, weights: Array, sd_known: Array, parameters: MotionParameters) -> Array:
    """(N, P) 1/m, weights with Huber's on the squares: a distant marker pulls no harder than one at `outlier_m`."""
    distance = np.linalg.norm(errors, axis=2)
    less = np.sqrt(parameters.outlier_m / np.maximum(distance, parameters.outlier_m))
    return weights * np.where(sd_known, 1.0, less)


def _normal_equations(
    skeleton: Skeleton, points: PointSet, x: Array, prior: Array, parameters: MotionParameters
) -> tuple[Array, Array]:
    """(N, D, D) and (N, D), normal equations of every frame: points, posture and joint limits."""
    H, g = _point_equations(skeleton, points, x, parameters)
    _add_priors(skeleton, x, prior, parameters, H, g)
    return H, g


def _point_equations(
    skeleton: Skeleton, points: PointSet, x: Array, parameters: MotionParameters
) -> tuple[Array, Array]:
    """(N, D, D) and (N, D), normal equations of every frame for the paths of points."""
    n, count = x.shape
    H, g = np.empty((n, count, count)), np.empty((n, count))
    for begin in range(0, n, _CHUNK):
        rows = slice(begin, min(begin + _CHUNK, n))
        poses = skeleton.poses(x[rows])
        at = skeleton.points(poses, points.bodies, points.places)
        error = np.nan_to_num(points.paths[rows] - at)
        w = _weigh(error, points.weights[rows], points.sd_m == 0.0, parameters)
        H[rows], g[rows] = skeleton.gather(poses, points.bodies, at, w**2, error)
    return H, g


def _add_priors(skeleton: Skeleton, x: Array, prior: Array, parameters: MotionParameters, H: Array, g: Array) -> None:
    """Adds the scatter of postures and the joint limits to normal equations."""
    low, high = skeleton.limits.T
    diagonal = np.arange(6, x.shape[1])
    precision = parameters.posture_sd_rad**-2
    H[:, diagonal, diagonal] += precision
    g[:, 6:] += precision * (prior - x)[:, 6:]
    beyond = (np.maximum(x - high, 0.0) + np.minimum(x - low, 0.0))[:, 6:]
    stiff = parameters.limit_sd_rad**-2
    H[:, diagonal, diagonal] += stiff * (beyond != 0.0)
    g[:, 6:] -= stiff * beyond


def _build_shared_equations(
    skeleton: Skeleton,
    points: PointSet,
    changes: LengthChanges,
    free: NDArray[np.int64],
    x: Array,
    prior: Array,
    parameters: MotionParameters,
) -> tuple[Array, Array, Array, Array, Array]:
    """Normal equations of coordinates, and of the lengths and free places that all frames share.

    Returns:
        (N, D, D) and (N, D) of the coordinates; (N, D, S) coupling; (S, S) and (S,) of what is shared.
    """
    n, count = x.shape
    L = len(LENGTHS) + 1  # with the twist
    poses = skeleton.poses(x)
    at = skeleton.points(poses, points.bodies, points.places)
    error = np.nan_to_num(points.paths - at)
    w = _weigh(error, points.weights, points.sd_m == 0.0, parameters) ** 2
    H, g = skeleton.gather(poses, points.bodies, at, w, error)
    _add_priors(skeleton, x, prior, parameters, H, g)
    diagonal = np.arange(6)
    H[:, diagonal, diagonal] += 1e-6
    J = np.swapaxes(skeleton.jacobian(poses, points.bodies, at), 2, 3) * w[..., None, None]  # (N, P, D, 3)
    by_lengths = np.concatenate(  # (N, P, 3, L)
        [
            changes.jacobian(skeleton, poses, points.bodies),
            skeleton.twist_jacobian(poses, points.bodies, at)[..., None],
        ],
        axis=-1,
    )
    R = poses.R[:, points.bodies[free]]  # by which the place of a free point moves that point alone
    cross = np.empty((n, count, L + 3 * len(free)))
    cross[..., :L] = np.moveaxis(J, 1, 2).reshape(n, count, -1) @ by_lengths.reshape(n, -1, L)
    cross[..., L:] = np.moveaxis(J[:, free] @ R, 1, 2).reshape(n, count, -1)
    weighted = by_lengths * w[..., None, None]
    shared = np.diag(np.concatenate([np.zeros(L), np.repeat(w[:, free].sum(0), 3)]))
    shared[:L, :L] = np.tensordot(weighted, by_lengths, axes=([0, 1, 2], [0, 1, 2]))
    shared[:L, L:] = np.sum(np.swapaxes(weighted[:, free], 2, 3) @ R, axis=0).transpose(1, 0, 2).reshape(L, -1)
    shared[L:, :L] = shared[:L, L:].T
    e = error * w[..., None]
    shared_g = np.concatenate(
        [
            np.tensordot(by_lengths, e, axes=([0, 1, 2], [0, 1, 2])),
            np.einsum("npij,npi->pj", R, e[:, free]).ravel(),
        ]
    )
    return H, g, cross, shared, shared_g


def _solve_smooth(H: Array, g: Array, x: Array, smoothing: Array) -> Array:
    """(N, D) step of the coordinates that also smooths x: (H + S) step = g − S x, S of the third differences.

    Args:
        H: (N, D, D) normal equations of every frame.
        g: (N, D) their right side.
        x: (N, D) what is smoothed: present coordinates, or their differences from others.
        smoothing: (D,) weight of the squared third differences.
    """
    n, count = x.shape
    band = np.zeros((3 * count + 1, n, count))  # row: distance below the diagonal; then frame and coordinate
    for k in range(count):
        for j in range(count - k):
            band[k, :, j] = H[:, j + k, j]
    third = np.diff(x, 3, axis=0) * smoothing
    right = g.copy()
    coefficients = np.array([-1.0, 3.0, -3.0, 1.0])
    for i, a in enumerate(coefficients):
        right[i : n - 3 + i] -= a * third
        for j in range(i + 1):  # entry of the frames i and j of each third difference
            band[(i - j) * count, j : n - 3 + j] += a * coefficients[j] * smoothing
    band[0] += 1e-9
    solution = solveh_banded(
        band.reshape(3 * count + 1, -1),
        right.ravel(),
        overwrite_ab=True,
        overwrite_b=True,
        lower=True,
        check_finite=False,
    )
    return np.asarray(solution).reshape(n, count)
