"""Scores estimated paths against the truth of their recording."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stridetwin.estimators.base import PathEstimate
from stridetwin.outputs.alignment import Rigid
from stridetwin.outputs.base import Scores
from stridetwin.outputs.path.quaternion_order import steps_to_order
from stridetwin.outputs.path.scores import PathComparison, compare, score
from stridetwin.outputs.truth import true_path
from stridetwin.streams.errors import ConfigError, check_type
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.trajectory import Trajectory

LARGEST_SCORE = 1e100
"""Larger values, also in metres, would overflow in squares and sums."""
_MAX_NORM_ERROR = 1e-3
"""Of a quaternion."""
_ORDERS = {
    1: "the order x, y, z, w (SciPy's as_quat has it without scalar_first=True; of a file, --quaternion xyzw reads it)",
    -1: "w first in a TUM file, which has w last (--quaternion wxyz reads it)",
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
        path = true_path(recording, estimate.frame)
        comparison = compare(estimate.path, path, alignment, worlds.get(estimate.world), estimate.ready_ns)
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

    Args:
        estimate: The path.
        truth: True poses at those of its stamps that lie within the truth.
    """
    path = estimate.path[np.isin(estimate.path.t_ns, truth.t_ns)]
    if steps := steps_to_order(path, truth):
        q = path.q_world_frame[0].tolist()
        raise ConfigError(estimate.name, "q_world_frame", q, f"w, x, y, z; it seems to be {_ORDERS[steps]}")
