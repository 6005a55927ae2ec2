"""Runs the estimators that a recording feeds and scores them against the recording's truth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from stridetwin.estimators.contact_terrain import ContactTerrain, StepEstimate, read_exoskeleton
from stridetwin.estimators.foot_ins import FootIns, FootInsPath, FootInsSmoother
from stridetwin.estimators.foot_to_foot import FootToFoot, follow
from stridetwin.scenarios.alignment import Rigid
from stridetwin.scenarios.exo_geometry import of_recording
from stridetwin.scenarios.scoring import Comparison, Scores, compare, score
from stridetwin.scenarios.truth import TruePath
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.recording import Recording
from stridetwin.streams.rig import ImuCalibration
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
        nis: Mean squared innovation by its variance, per degree of freedom, by kind of measurement.
        world: Estimates of one world are laid over the truth together, as the first of them is; "" = each has its own.
    """

    name: str
    frame: str
    path: Trajectory
    ready_ns: int = 0
    nis: Mapping[str, float] = field(default_factory=dict)
    world: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """An estimate, laid over the truth and scored."""

    estimate: Estimate
    comparison: Comparison
    scores: Scores


def foot_filter(lag_s: float | None = None, calibration: ImuCalibration | None = None) -> FootIns | FootInsSmoother:
    """The one-foot filter, or its smoother where there is a lag (s)."""
    return FootIns(calibration) if lag_s is None else FootInsSmoother(lag_s, calibration)


def estimate_foot(recording: Recording, foot: str, lag_s: float | None = None) -> Estimate:
    """The foot-mounted inertial system of one foot.

    Args:
        recording: Needs `/foot_{foot}/imu` and its calibration.
        foot: `l` or `r`.
        lag_s: See `foot_filter`.

    Raises:
        StrideTwinError: The topic or the calibration is missing, or the data would spoil the estimate.
    """
    frame = f"foot_{foot}/imu"
    block: Block[Imu] = recording.block(f"/{frame}")
    estimator = foot_filter(lag_s, recording.rig.imu(f"/{frame}"))
    path = estimator.run(block)
    nis = {} if math.isnan(estimator.nis) else {"standing": estimator.nis}
    return _estimate(recording, "foot_ins", foot, path, nis)


def estimate_feet(recording: Recording, method: str = "stridetwin") -> list[Estimate]:
    """Both feet together, with what their cameras and sonars say of each other, where there are any.

    Args:
        recording: Needs the IMUs of both feet and their calibration.
        method: See `FootToFoot`.

    Raises:
        StrideTwinError: As `estimate_foot`.
    """
    rig = recording.rig
    mounts = {c.topic: c.mount for c in rig.cameras.values()}
    mounts |= {s.topic: s.mount for s in rig.others.values() if s.kind == "range"}
    aids = [t for t, mount in mounts.items() if mount.body in ("foot_l", "foot_r") and t in recording.topics]
    imus = [f"/foot_{foot}/imu" for foot in FEET]
    estimator = FootToFoot(rig, method=method)
    paths = follow(estimator, recording.samples([*imus, *aids]))
    world = "foot_to_foot" if method == "stridetwin" else f"foot_to_foot_{method}"
    common = {kind: value for kind, value in estimator.nis.items() if not kind.startswith("standing")}
    found = []
    for foot, path in paths.items():
        standing = estimator.nis.get(f"standing_{foot}")
        nis = common if standing is None else {"standing": standing, **common}
        found.append(_estimate(recording, world, foot, path, nis, world))
    return found


def estimate_steps(
    recording: Recording, method: str = "stridetwin", exoskeleton: Path | None = None
) -> list[StepEstimate]:
    """Slope, elevation and class of each step of someone in an exoskeleton.

    Args:
        recording: Needs AHRS, encoders and insoles.
        method: See `ContactTerrain`.
        exoskeleton: File of its geometry; None takes what the recording tells.

    Raises:
        StrideTwinError: A topic or the geometry is missing.
    """
    exo = of_recording(recording) if exoskeleton is None else read_exoskeleton(exoskeleton)
    if missing := [topic for topic in exo.topics if topic not in recording.topics]:
        raise RecordingError(f"{recording.path}: no topic {', '.join(missing)}; contact_terrain needs all of them")
    return ContactTerrain(exo, method).run(recording.samples(list(exo.topics)))


def _estimate(
    recording: Recording, name: str, foot: str, path: FootInsPath, nis: Mapping[str, float], world: str = ""
) -> Estimate:
    frame = f"foot_{foot}/imu"
    if not path.aligned.any():
        raise RecordingError(f"{recording.path}: /{frame}: the foot never stands still")
    ready = int(path.trajectory.t_ns[path.aligned.argmax()])
    return Estimate(name=f"{name}_{foot}", frame=frame, path=path.trajectory, ready_ns=ready, nis=nis, world=world)


def estimates(recording: Recording) -> list[Estimate]:
    """Every estimate that the recording feeds."""
    there = [foot for foot in FEET if f"/foot_{foot}/imu" in recording.topics]
    alone = [estimate_foot(recording, foot) for foot in there]
    return [*alone, *estimate_feet(recording)] if len(there) == len(FEET) else alone


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
