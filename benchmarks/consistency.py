"""Whether errors on real walks agree with the covariance that the filter reports."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.stats import chi2

from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Trajectory

TRUTH_SD_M = 0.01  # motion capture follows a marker of the foot, not the sensor
SETTLED_SHARE = 0.1  # of a walk: before that, the best heading explains most of the error


def nees(estimate: Trajectory, truth: Array) -> dict[str, float]:
    """Consistency of one walk, after the best heading and a common start, from `SETTLED_SHARE` of it on.

    Args:
        estimate: N poses with covariance.
        truth: (N, 3) positions at the same times, m.

    Returns:
        Mean normalised error squared in the plane (2 if consistent) and in height (1), share of the samples within 95 %
        in percent, and both at the end.
    """
    assert estimate.covariance is not None
    path, way = estimate.p_frame_in_world - estimate.p_frame_in_world[0], truth - truth[0]
    heading = np.angle(np.vdot(path[:, 0] + 1j * path[:, 1], way[:, 0] + 1j * way[:, 1]))
    c, s = np.cos(heading), np.sin(heading)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    later = slice(int(SETTLED_SHARE * len(path)), None)
    error = (path @ R.T - way)[later]
    covariance = R @ estimate.covariance[later, :3, :3] @ R.T + TRUTH_SD_M**2 * np.eye(3)
    plane = np.einsum("ni,ni->n", error[:, :2], np.linalg.solve(covariance[:, :2, :2], error[:, :2, None])[..., 0])
    height = error[:, 2] ** 2 / covariance[:, 2, 2]
    result = {}
    for name, value, dimensions in (("plane", plane, 2), ("height", height, 1)):
        result[f"nees_{name}"] = float(value.mean())
        result[f"nees_{name}_end"] = float(value[-1])
        result[f"{name}_within_95_pct"] = 100.0 * float(np.mean(value <= chi2.ppf(0.95, dimensions)))
    return result


def means(cases: Sequence[dict[str, float]]) -> dict[str, float]:
    """Mean of each figure over the cases that have it."""
    names: Iterable[str] = dict.fromkeys(name for case in cases for name in case)
    return {name: float(np.mean([case[name] for case in cases if name in case])) for name in names}
