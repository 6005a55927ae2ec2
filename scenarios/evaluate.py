"""Scores estimated paths against the truth of their recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stridetwin.scenarios.alignment import Rigid
from stridetwin.scenarios.scoring import Comparison, Scores, compare, score
from stridetwin.scenarios.truth import TruePath
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.recording import Recording
from stridetwin.streams.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """The path that an estimator gives for one frame.

    Attributes:
        name: Such as `foot_ins_l`.
        frame: Frame whose path it is, such as `foot_l/imu`.
        path: Poses in the estimator's own world.
        ready_ns: From when on it is scored: an estimator may look for the vertical first.
        nis: Mean squared innovation by its variance, per degree of freedom, by kind of measurement.
        world: Estimates of one world are laid over the truth together, as the first of them is; "" = each has its own.
        healthy: (N,) where the estimator trusts its pose; None: it tells of no such thing.
    """

    name: str
    frame: str
    path: Trajectory
    ready_ns: int = 0
    nis: Mapping[str, float] = field(default_factory=dict)
    world: str = ""
    healthy: NDArray[np.bool_] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """An estimate, laid over the truth and scored."""

    estimate: Estimate
    comparison: Comparison
    scores: Scores


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
    worlds: dict[str, Rigid] = {}
    for estimate in made:
        path = true_path(recording, estimate.frame).since(estimate.ready_ns)
        comparison = compare(estimate.path, path, alignment, worlds.get(estimate.world))
        if estimate.world:
            worlds.setdefault(estimate.world, comparison.laid)
        scores = score(comparison, not estimate.world) | {f"nis_{kind}": v for kind, v in estimate.nis.items()}
        results.append(Result(estimate=estimate, comparison=comparison, scores=scores))
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
