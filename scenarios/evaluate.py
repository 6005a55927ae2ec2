"""Runs the estimators that a recording feeds and scores them against the recording's truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from stridetwin.estimators.foot_ins import FootIns
from stridetwin.scenarios.scoring import Comparison, Scores, compare, score
from stridetwin.scenarios.truth import TruePath
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.recording import Recording
from stridetwin.streams.samples import Block, Imu
from stridetwin.streams.trajectory import Trajectory

FEET = {"l": "left", "r": "right"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """The path that an estimator gives for one frame.

    Attributes:
        name: Such as `foot_ins_l`.
        frame: Frame whose path it is, such as `foot_l/imu`.
        path: Poses in the estimator's own world.
        ready_ns: From when on it is scored: an estimator may look for the vertical first.
    """

    name: str
    frame: str
    path: Trajectory
    ready_ns: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """An estimate, laid over the truth and scored."""

    estimate: Estimate
    comparison: Comparison
    scores: Scores


def estimate_foot(recording: Recording, foot: str) -> Estimate:
    """The foot-mounted inertial system of one foot.

    Args:
        recording: Needs `/foot_{foot}/imu` and its calibration.
        foot: `l` or `r`.

    Raises:
        StrideTwinError: The topic or the calibration is missing, or the data would spoil the estimate.
    """
    frame = f"foot_{foot}/imu"
    block: Block[Imu] = recording.block(f"/{frame}")
    path = FootIns(recording.rig.imu(f"/{frame}")).run(block)
    if not path.aligned.any():
        raise RecordingError(f"{recording.path}: /{frame}: the foot never stands still")
    ready = int(path.trajectory.t_ns[path.aligned.argmax()])
    return Estimate(name=f"foot_ins_{foot}", frame=frame, path=path.trajectory, ready_ns=ready)


def estimates(recording: Recording) -> list[Estimate]:
    """Every estimate that the recording feeds."""
    return [estimate_foot(recording, foot) for foot in FEET if f"/foot_{foot}/imu" in recording.topics]


def true_path(recording: Recording, frame: str) -> TruePath:
    """The true path of a frame.

    Raises:
        RecordingError: The recording has no truth of it; the message lists the frames it has.
    """
    frames = true_frames(recording.topics)
    if frame not in frames:
        raise RecordingError(f"{recording.path}: no truth of frame {frame!r}; it has {', '.join(frames) or 'none'}")
    return TruePath.of(recording.block(f"/truth/{frame}/odometry"))


def true_frames(topics: Iterable[str]) -> list[str]:
    """Frames whose true path is among the topics."""
    prefix, suffix = "/truth/", "/odometry"
    return sorted(t[len(prefix) : -len(suffix)] for t in topics if t.startswith(prefix) and t.endswith(suffix))


def evaluate(recording: Recording, made: Iterable[Estimate], alignment: str = "start") -> list[Result]:
    """Scores estimates against the truth of the recording."""
    results = []
    for estimate in made:
        path = true_path(recording, estimate.frame).since(estimate.ready_ns)
        comparison = compare(estimate.path, path, alignment)
        results.append(Result(estimate=estimate, comparison=comparison, scores=score(comparison)))
    return results


def summary(all_scores: Iterable[dict[str, Scores]]) -> dict[str, Scores]:
    """Mean of each score over recordings (the largest of the `_max_` ones), per estimator.

    Args:
        all_scores: For each recording, estimator to scores.
    """
    gathered: dict[str, dict[str, list[float]]] = {}
    for recording in all_scores:
        for name, scores in recording.items():
            for metric, value in scores.items():
                gathered.setdefault(name, {}).setdefault(metric, []).append(value)
    return {
        name: {m: max(v) if "_max_" in m else sum(v) / len(v) for m, v in metrics.items()}
        for name, metrics in gathered.items()
    }
