"""Focal length of a depth camera by its images alone: with a wrong one, points of known depth do not move as a body.

A focal length k times the true one shrinks the space across the optical axis by k. A camera that turns in such a space
sees points shear, so that no pose explains all of their images. It shows where the camera turns; while it only moves,
every focal length fits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stridetwin.scenarios.depth_tracks import RunTracks, solve_path
from stridetwin.scenarios.motion_scale import LogRatio, jackknife
from stridetwin.streams.algebra.arrays import exp, hat
from stridetwin.streams.samples import Array

_RATIOS_LOG = np.linspace(math.log(0.6), math.log(1.0 / 0.6), 9)
"""Logarithms of the ratios of focal lengths that are compared."""
_IMAGES = 5
"""Most images of a run that are compared with its first one, spread over it."""
_RESIDUAL_PX = 1.5
"""Residual in pixels of the tracked image from which a feature counts less (Geman and McClure's function)."""
_ROUNDS = 7
"""Rounds of Gauss and Newton for the poses at each focal length."""
_FEWEST_RUNS = 4
"""Runs from which a focal length counts."""
_DAMPING = 1e-6
"""Of the least squares, relative to their diagonal."""


def measure_focal_by_images(runs: Sequence[RunTracks]) -> LogRatio:
    """Calibrated focal length over that with which the features of some runs fit best, with an interval by a jackknife.

    Args:
        runs: Features of each run.

    Returns:
        The ratio; unknown (an infinite interval) with too few runs, without rotation, or if the best one is at the end
        of those that are compared.
    """
    costs = np.array([cost for run in runs if (cost := _find_costs(run)) is not None])
    if len(costs) < _FEWEST_RUNS:
        return LogRatio(value=0.0, half=math.inf)
    # runs without rotation know nothing: they do not count as further evidence
    contrast = np.ptp(costs, axis=1)
    effective = float(contrast.sum() ** 2 / (np.sum(contrast**2) + 1e-30))
    return jackknife(costs, _find_minimum, freedom=effective - 1.0)


def _find_minimum(costs: Array) -> float:
    """Logarithm of the ratio at the least of the costs (F,) at `_RATIOS_LOG`, by a parabola; NaN if it is at an end."""
    at = int(np.argmin(costs))
    if at in (0, len(costs) - 1):
        return math.nan
    before, here, after = costs[at - 1 : at + 2].tolist()
    step = float(_RATIOS_LOG[1] - _RATIOS_LOG[0])
    offset = 0.5 * step * (before - after) / (before - 2 * here + after + 1e-30)
    return float(_RATIOS_LOG[at] + offset)


def _find_costs(run: RunTracks) -> Array | None:
    """(F,) mean robust squared residual of the best poses at each of F ratios (`_RATIOS_LOG`) of focal lengths.

    In squared pixels of the tracked images. None for a run of too few features.
    """
    path = solve_path(run)
    if path is None:
        return None
    # images of the path, without the first one
    numbers = np.unique(np.linspace(1, len(path.t_ns) - 1, _IMAGES).round().astype(int))
    chosen = np.searchsorted(run.t_ns, path.t_ns[numbers])
    R = np.swapaxes(path.R_first_camera[numbers], 1, 2)
    t = -np.einsum("iab,ib->ia", R, path.p_camera_in_first[numbers])
    weights, costs = run.is_tracked[chosen].astype(float), np.empty(len(_RATIOS_LOG))
    middle = len(_RATIOS_LOG) // 2
    for order in (range(middle, len(_RATIOS_LOG)), range(middle - 1, -1, -1)):
        pose = R, t
        for i in order:
            *pose_at_ratio, costs[i] = _fit_poses(run, chosen, weights, math.exp(_RATIOS_LOG[i]), pose)
            pose = pose_at_ratio[0], pose_at_ratio[1]
    return costs


def _fit_poses(
    run: RunTracks, chosen: NDArray[np.intp], weights: Array, ratio: float, start: tuple[Array, Array]
) -> tuple[Array, Array, float]:
    """Poses of some images that fit best with a focal length, and their cost.

    Args:
        run: The features.
        chosen: (I,) numbers of the images.
        weights: (I, N) 1 for a feature that is tracked in an image, else 0.
        ratio: Calibrated focal length over the assumed one.
        start: (I, 3, 3) rotations and (I, 3) translations, m, from the first image's axes to each image's.

    Returns:
        Rotations and translations at the minimum, and the mean robust squared residual there, in squared pixels of the
        tracked images.
    """
    points = np.column_stack((run.rays[0] * ratio, np.ones(len(run.depth)))) * run.depth[:, None]
    seen, pixel = run.rays[chosen] * ratio, run.pixel * ratio
    R, t = start
    cost = math.inf
    for _ in range(_ROUNDS):
        moved = np.einsum("iab,nb->ina", R, points) + t[:, None]  # (I, N, 3)
        z = np.maximum(moved[..., 2], 1e-3)
        residual = (moved[..., :2] / z[..., None] - seen) / pixel  # (I, N, 2)
        squared = np.sum(residual**2, axis=-1)
        bound = _RESIDUAL_PX**2
        cost = float(np.sum(weights * squared * bound / (squared + bound)) / weights.sum())
        robust = weights * (bound / (squared + bound)) ** 2
        # derivative of the projection, then of the moved points by a rotation and a translation on the left
        projection = np.zeros((*z.shape, 2, 3))
        projection[..., 0, 0] = projection[..., 1, 1] = 1.0 / z
        projection[..., :, 2] = -moved[..., :2] / z[..., None] ** 2
        turn = -projection @ hat(moved - t[:, None])
        J = np.concatenate((turn, projection), axis=-1) / pixel  # (I, N, 2, 6)
        weighted = J * robust[..., None, None]
        H = np.einsum("inra,inrb->iab", weighted, J)
        H += _DAMPING * np.einsum("iaa->ia", H)[:, :, None] * np.eye(6) + 1e-12 * np.eye(6)
        step = -np.linalg.solve(H, np.einsum("inra,inr->ia", weighted, residual)[..., None])[..., 0]
        R, t = exp(step[:, :3]) @ R, t + step[:, 3:]
    return R, t, cost
