"""Scores estimated paths against the truth of their recording."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import PathEstimate
from stridetwin.outputs.alignment import Rigid
from stridetwin.outputs.base import Scores
from stridetwin.outputs.path.scores import PathComparison, compare, score
from stridetwin.outputs.truth import true_path
from stridetwin.streams.errors import ConfigError, check_type
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array
from stridetwin.streams.trajectory import Trajectory

LARGEST_SCORE = 1e100
"""Larger values, also in metres, would overflow in squares and sums."""
_MAX_NORM_ERROR = 1e-3
"""Of a quaternion."""
_MIN_ORDER_ERROR_RAD, _ORDER_RATIO, _MAX_ORDER_POSES = 0.09, 3.0, 1000
"""Mean error of the attitude from which another order of the quaternions is tried, how many times smaller the error
must then be, and how many poses are compared."""
_ORDERS = {
    1: "the order x, y, z, w (SciPy's as_quat has it without scalar_first=True)",
    -1: "w first in a TUM file, which has w last",
}
"""What has gone wrong, by the steps that (N, 4) quaternions must be rolled to become w, x, y, z."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """An estimated path, aligned with the truth and scored.

    Attributes:
        estimate: The path in the estimator's own world.
        comparison: The path and the truth in the truth's world.
        scores: Scores by name.
    """

    estimate: PathEstimate
    comparison: PathComparison
    scores: Scores

    @property
    def name(self) -> str:
        """Name of the estimate."""
        return self.estimate.name


def evaluate(recording: Recording, estimates: Iterable[PathEstimate], alignment: str = "start") -> list[Result]:
    """Scores estimates against the truth of the recording.

    Estimates that name a common `world` share the alignment of the first of them.

    Args:
        recording: With the truth.
        estimates: Paths, one per frame.
        alignment: `start`, `yaw` or `se3`, see `alignment.align`.

    Raises:
        ConfigError: An invalid pose or score, or quaternions in another order than w, x, y, z; the message names the
            estimator and the time.
        RecordingError: The truth is missing or too short, see `true_path` and `compare`.
    """
    check_type("evaluate", "recording", recording, Recording, "a Recording, such as open_any(PATH)")
    results = []
    worlds: dict[str, Rigid] = {}  # alignment of each world that several estimates share
    for estimate in estimates:
        _check_poses(estimate)
        # the truth from the first valid pose on
        path = true_path(recording, estimate.frame).since(estimate.ready_ns)
        comparison = compare(estimate.path, path, alignment, worlds.get(estimate.world))
        _check_order(estimate, comparison.truth)
        if estimate.world:  # the first estimate of a shared world fixes its alignment
            worlds.setdefault(estimate.world, comparison.transform)
        scores = score(comparison, not estimate.world) | {f"nis_{kind}": v for kind, v in estimate.nis.items()}
        for metric, value in scores.items():
            if not abs(value) <= LARGEST_SCORE:
                raise ConfigError(estimate.name, metric, value, f"a number of up to {LARGEST_SCORE:g}")
        results.append(Result(estimate=estimate, comparison=comparison, scores=scores))
    return results


def _check_poses(estimate: PathEstimate) -> None:
    """Raises ConfigError for a pose that is not finite, is far away, or has a quaternion whose norm is not 1."""
    path = estimate.path
    with np.errstate(over="ignore"):
        norm_error = np.abs(np.linalg.norm(path.q_world_frame, axis=1) - 1.0)
    near = (np.abs(path.p_frame_in_world) <= LARGEST_SCORE).all(axis=1)
    unit = f"a unit quaternion, its norm within {_MAX_NORM_ERROR:g} of 1"
    # per array: its name, (N,) whether each row is valid, and what is valid
    for name, fits, valid in (
        ("p_frame_in_world", near, f"finite numbers of up to {LARGEST_SCORE:g} m"),
        ("q_world_frame", norm_error <= _MAX_NORM_ERROR, unit),
    ):
        if not fits.all():
            first = int(np.argmin(fits))  # the first row that is not valid
            where = f"{name} at t = {path.t_ns[first] / 1e9:.3f} s"
            raise ConfigError(estimate.name, where, getattr(path, name)[first].tolist(), valid)


def _check_order(estimate: PathEstimate, truth: Trajectory) -> None:
    """Raises ConfigError for quaternions that agree with the truth only in another order of their components.

    The rotation since the first pose, R₀ᵀ Rᵢ, is compared, since it does not depend on the alignment. Errors of an
    estimator with the right order do not become several times smaller when w moves elsewhere.

    Args:
        estimate: The path.
        truth: True poses at those of its stamps that lie within the truth.
    """
    # about `_MAX_ORDER_POSES` poses are enough
    step = 1 + len(truth) // _MAX_ORDER_POSES
    path, true_q = estimate.path, truth.q_world_frame[::step]
    q = path.q_world_frame[np.isin(path.t_ns, truth.t_ns)][::step]  # at the same stamps as `true_q`
    error = _mean_rotation_error(q, true_q)
    if error < _MIN_ORDER_ERROR_RAD:  # small enough for the right order
        return
    for steps, cause in _ORDERS.items():
        if _mean_rotation_error(np.roll(q, steps, axis=1), true_q) * _ORDER_RATIO < error:
            raise ConfigError(estimate.name, "q_world_frame", q[0].tolist(), f"w, x, y, z; it seems to be {cause}")


def _mean_rotation_error(q: Array, true_q: Array) -> float:
    """Mean angle between the estimated and the true rotation since the first pose, rad.

    Args:
        q: (N, 4) estimated quaternions.
        true_q: (N, 4) true ones at the same stamps.
    """
    attitudes = [Rotation.from_quat(quaternions, scalar_first=True) for quaternions in (q, true_q)]
    estimated, true = (attitude[0].inv() * attitude for attitude in attitudes)  # since the first pose
    return float((estimated.inv() * true).magnitude().mean())
