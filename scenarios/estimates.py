"""Paths and steps that a recording's streams lead to, by each estimator that it feeds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

from stridetwin.estimators.contact_terrain import ContactTerrain, StepEstimate, read_exoskeleton
from stridetwin.estimators.foot_ins import FootIns, FootInsPath, FootInsSmoother
from stridetwin.estimators.foot_to_foot import FootToFoot, follow
from stridetwin.estimators.methods import PROPOSED, current_name
from stridetwin.scenarios.evaluate import Estimate
from stridetwin.scenarios.exo_geometry import of_recording
from stridetwin.scenarios.odometry import estimate_odometry, feeds_odometry
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.recording import Recording
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, OtherSensor
from stridetwin.streams.samples import Block, Imu

FEET = {"l": "left", "r": "right"}


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


def estimate_feet(recording: Recording, method: str = PROPOSED) -> list[Estimate]:
    """Both feet together, with what their cameras and sonars say of each other, where there are any.

    Args:
        recording: Needs the IMUs of both feet and their calibration.
        method: See `FootToFoot`.

    Raises:
        StrideTwinError: As `estimate_foot`.
    """
    method, rig = current_name(method), recording.rig
    cameras = _on_feet(recording, rig.cameras.values())
    sonars = _on_feet(recording, (s for s in rig.others.values() if s.kind == "range"))
    imus = {foot: f"/foot_{foot}/imu" for foot in FEET}
    estimator = FootToFoot(rig, method=method)
    if cameras:
        paths = follow(estimator, recording.samples([*imus.values(), *cameras, *sonars]))
    else:  # nothing has to be looked for where the feet were believed to be by then: the same numbers, at once
        blocks = {foot: recording.block(topic) for foot, topic in imus.items()}
        paths = estimator.run(blocks, [s for topic in sonars for s in recording.block(topic)])
    world = "foot_to_foot" if method == PROPOSED else f"foot_to_foot_{method}"
    common = {kind: value for kind, value in estimator.nis.items() if not kind.startswith("standing")}
    found = []
    for foot, path in paths.items():
        standing = estimator.nis.get(f"standing_{foot}")
        nis = common if standing is None else {"standing": standing, **common}
        found.append(_estimate(recording, world, foot, path, nis, world))
    return found


def estimate_steps(recording: Recording, method: str = PROPOSED, exoskeleton: Path | None = None) -> list[StepEstimate]:
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


def _on_feet(recording: Recording, sensors: Iterable[CameraCalibration | OtherSensor]) -> list[str]:
    """Topics of those of the sensors that the feet carry and the recording holds."""
    return [s.topic for s in sensors if s.mount.body in ("foot_l", "foot_r") and s.topic in recording.topics]


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
    return estimates_of_feet(recording) + estimates_of_head(recording)


def estimates_of_feet(recording: Recording) -> list[Estimate]:
    """Those that the shoes' streams feed: each foot, then both together."""
    there = [foot for foot in FEET if f"/foot_{foot}/imu" in recording.topics]
    made = [estimate_foot(recording, foot) for foot in there]
    if len(there) == len(FEET):
        made += estimate_feet(recording)
    return made


def estimates_of_head(recording: Recording) -> list[Estimate]:
    """The odometry, where a camera on head or chest feeds it."""
    return [estimate_odometry(recording)] if feeds_odometry(recording) else []


def feet_see(recording: Recording) -> bool:
    """Whether there are pictures of the shoes' cameras."""
    return bool(_on_feet(recording, recording.rig.cameras.values())) if recording.has_rig else False
