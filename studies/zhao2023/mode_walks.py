"""Records walks with camera and insoles, predicts their steps by each method, and scores them.

The whole chain: noisy images, visual-inertial odometry, map, prediction. Every method reads the same samples and,
except the one without memory, the same map. Camera pitch and speed (Figure 4 of Zhao et al. 2023) are moments and
histograms of the truth that add up over walks: between the first step and the last one, the pitch of the camera's axis
below the horizon, and the horizontal speed of the camera over a second.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from stridetwin.batch.jobs import Row
from stridetwin.estimators import registry
from stridetwin.estimators.base import CAMERA_POSES, PROPOSED, Estimator, Options
from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.estimators.locomotion_mode import INSOLES, METHODS, LocomotionMode, ModeEstimate
from stridetwin.estimators.terrain_map import TerrainEstimate, TerrainMap
from stridetwin.estimators.terrain_map.depth_camera import depth_calibration
from stridetwin.outputs.alignment import MovingAlignment
from stridetwin.outputs.chosen_poses import find_pose_topic
from stridetwin.outputs.modes.scores import ModeRows, ModeScores, score_modes
from stridetwin.outputs.parameters import parameter_keywords
from stridetwin.outputs.path.run import pose_of
from stridetwin.outputs.pose_feed import PoseFeed
from stridetwin.outputs.truth import FOOTPRINTS, TruePath, true_footprints
from stridetwin.reference.norms import Moments
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.wearer.body import fit_wearer
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array, Depth, Image, Imu, Insole, Odometry, Sample
from stridetwin.streams.terrain_truth import terrain_layout
from stridetwin.streams.trajectory import Pose, Trajectory
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.walks import fell_at_s, record_walk
from stridetwin.studies.zhao2023.odometry_walks import make_odometer

ESTIMATORS = ("dvio", "locomotion_mode", "terrain_map")
"""Estimators whose parameters `--set` changes here."""

EDGES = {"camera_pitch_rad": np.linspace(-1.0, 1.5, 26), "speed_mps": np.linspace(0.0, 2.4, 25)}
"""Edges of the histograms' bins; values beyond count in the outermost bins."""
_RATE_HZ = 30.0  # instants of the truth per second
_OVER_S = 1.0  # time over which a speed is taken


class Spread(Moments):
    """Spread of a quantity over walks.

    Attributes:
        count: Number of values.
        bins: Number of values in each bin between the quantity's `EDGES`; the outer bins have those beyond.
    """

    count: int
    bins: list[int]


class TimedModeRows(ModeRows):
    """Scores of a method on one walk.

    Attributes:
        time_ms: CPU time per depth image: `mean` and `p95`.
    """

    time_ms: dict[str, float]


def walk_spread(recording: Recording, mount: str) -> dict[str, Spread]:
    """The spread of camera pitch and speed on one walk, by quantity (keys of `EDGES`), from its truth.

    Args:
        recording: The walk, with the truth.
        mount: Body of the camera: head or chest.
    """
    truth = TruePath.of(recording.block(f"/truth/{mount}/imu/odometry"))  # its axes are the camera's
    half = round(_OVER_S / 2 * 1e9)  # half of the time over which a speed is taken, ns
    steps = recording.block(FOOTPRINTS).t_ns[2:]  # the two initial footprints come first
    # from the first step to the last; of a walk without steps the whole truth
    first, last = (steps[0], steps[-1]) if len(steps) else (truth.t_ns[0], truth.t_ns[-1])
    # instants around which a whole second of the truth is known
    t_ns = np.arange(max(first, truth.t_ns[0] + half), min(last, truth.t_ns[-1] - half), round(1e9 / _RATE_HZ))
    displacement = truth.at(t_ns + half).p_frame_in_world - truth.at(t_ns - half).p_frame_in_world  # (N, 3) m
    speed = np.linalg.norm(displacement[:, :2], axis=1) / _OVER_S
    return {
        "camera_pitch_rad": compute_spread(pitch_down(truth.at(t_ns).q_world_frame), EDGES["camera_pitch_rad"]),
        "speed_mps": compute_spread(speed, EDGES["speed_mps"]),
    }


def pitch_down(q_world_camera: Array) -> Array:
    """(N,) rad, pitch of an optical frame's axis below the horizon, from (N, 4) quaternions, w first."""
    w, x, y, z = q_world_camera.T
    # the bracket is the vertical component of the frame's z axis in the world, limited against rounding
    return np.asarray(-np.arcsin(np.clip(w * w - x * x - y * y + z * z, -1.0, 1.0)))


def compute_spread(values: Array, edges: Array) -> Spread:
    """The spread of (N,) values, N > 0, with counts in B bins between (B + 1,) edges; outer bins take values beyond."""
    bins = np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0]
    return {
        "count": len(values),
        "mean": float(np.mean(values)),
        "sd": float(np.std(values)),
        "min": float(np.min(values)),
        "max": float(np.max(values)),
        "bins": bins.tolist(),
    }


def combine_spreads(parts: Sequence[Spread]) -> Spread:
    """The spread of all values behind the spreads of several parts, at least one.

    With counts n and means m of the parts, sd² = Σ n (sd² + (m - mean)²) / Σ n.
    """
    counts = np.array([p["count"] for p in parts], float)
    means, sds = np.array([p["mean"] for p in parts]), np.array([p["sd"] for p in parts])
    mean = float(counts @ means / counts.sum())
    return {
        "count": int(counts.sum()),
        "mean": mean,
        "sd": math.sqrt(float(counts @ (sds**2 + (means - mean) ** 2) / counts.sum())),
        "min": min(p["min"] for p in parts),
        "max": max(p["max"] for p in parts),
        "bins": np.sum([p["bins"] for p in parts], axis=0).tolist(),
    }


MOUNTS = ("head", "chest")
"""Bodies that may carry the camera."""
HEIGHT_GROUPS = ("I", "II", "III", "IV", "V")
"""Groups of walkers by height."""
POSE_SOURCES = ("dvio", "given")
"""Where the camera's poses come from: the visual-inertial odometry, or the truth."""
FORGETFUL = "single_image"
"""Our prediction without a map over time: it knows the ground only from the last image."""


def run_case(case: ExperimentCase, poses: str = "dvio", methods: Sequence[str] = METHODS) -> Row:
    """Simulates the walk of a case and predicts its modes by each method, installed estimators included.

    Args:
        case: With one walk.
        poses: One of `POSE_SOURCES`.
        methods: Names from the predictor's `METHODS`, or `FORGETFUL`; the first one's time includes the map's.

    Returns:
        The case's row with `mount`, `fell_at_s`, `spread` (`walk_spread`), and `methods`: method to `steps` (true steps
        and their predictions), `approaches` (estimates ahead of terrain changes) and `time_ms` per depth image.
    """
    (walk,) = case.walks()
    mount = walk.config.rig_mount
    with record_walk(walk, case) as recording:
        predictions = predict(samples_with_poses(recording, mount, poses), recording, (*methods, *case.estimators))
        return case.row(
            mount=mount,
            fell_at_s=fell_at_s(recording),
            spread=walk_spread(recording, mount),
            methods=score_rows(predictions, recording, sole_length_m(walk.config)),
        )


def sole_length_m(config: TwinConfig) -> float:
    """Length of the walker's soles, m."""
    return float(fit_wearer(config.person, with_exo=config.exo is not None).body.shoe_length_m)


class SharedMap(TerrainMap):
    """A map that several predictors feed with the same samples; it processes each once."""

    _last: Sample | None = None  # the last sample that was processed
    _shared: TerrainEstimate | None = None  # what came of it

    def update(self, sample: Sample) -> TerrainEstimate | None:
        """Updates the map with a sample; a repeated sample returns the first result."""
        if sample is not self._last:
            self._shared = super().update(sample)
            self._last = sample
        return self._shared


class ForgetfulMap(TerrainMap):
    """A map that is cleared before every image, with the planes of that image alone."""

    def update(self, sample: Sample) -> TerrainEstimate | None:
        """Updates the map with a sample.

        It is cleared before a depth image that is due, and other depth images are skipped.
        """
        if isinstance(sample, Depth):
            if not self.due(sample.t_ns):
                return None
            self.clear()
        return super().update(sample)


@dataclass(frozen=True, kw_only=True, eq=False)
class Predictions:
    """Predictions of all methods on one walk.

    Attributes:
        estimates: By method, in order.
        frame_ms: By method, time per depth image; that of the first one includes the map's.
        path: Poses that the methods received.
        camera: The last estimated pose of the camera in their frame; None without any.
    """

    estimates: Mapping[str, list[ModeEstimate]]
    frame_ms: Mapping[str, list[float]]
    path: Trajectory
    camera: Odometry | None = None


def predict(
    samples: Iterable[Sample | StepEstimate], recording: Recording, methods: Sequence[str] = METHODS
) -> Predictions:
    """Runs predictors on the samples of a walk.

    Args:
        samples: Poses, depth, insoles and step estimates from the legs, in time order.
        recording: Source of rig and frame of the poses.
        methods: The predictor's own methods, `FORGETFUL`, or names of installed estimators of modes.
    """
    rig = recording.rig
    _, frame = find_pose_topic(recording, depth_calibration(rig))  # frame of the poses
    options = Options(poses_of=frame)
    shared = SharedMap(rig, options=options, **parameter_keywords(TerrainMap, PROPOSED))

    def build(name: str) -> Estimator[Sample | StepEstimate, ModeEstimate]:
        """The predictor of a method or estimator; those of `METHODS` share one map, which the first of them updates."""
        if name == FORGETFUL:
            ground = ForgetfulMap(rig, options=options, **parameter_keywords(TerrainMap, PROPOSED))
            return LocomotionMode(rig, options=options, ground=ground, **parameter_keywords(LocomotionMode, PROPOSED))
        if name in METHODS:
            return LocomotionMode(
                rig,
                options=replace(options, method=name),
                ground=shared,
                **parameter_keywords(LocomotionMode, name),
            )
        # an installed estimator runs with the first of its methods
        estimator_class = registry.estimator(name)
        first = estimator_class.declaration.methods[0]
        keywords = parameter_keywords(estimator_class, first)
        estimator = estimator_class(rig, options=replace(options, method=first), **keywords)
        return cast("Estimator[Sample | StepEstimate, ModeEstimate]", estimator)

    predictors = {name: build(name) for name in methods}
    estimates: dict[str, list[ModeEstimate]] = {m: [] for m in predictors}
    frame_ms: dict[str, list[float]] = {m: [] for m in predictors}
    poses: list[Odometry] = []
    camera: Odometry | None = None
    for sample in samples:
        if isinstance(sample, Odometry):
            if sample.topic == CAMERA_POSES:
                camera = sample
            else:
                poses.append(sample)
        for method, predictor in predictors.items():
            began = time.process_time()  # CPU time of this method alone; a map counts for the method that updates it
            estimate = predictor.update(sample)
            elapsed_ms = 1e3 * (time.process_time() - began)
            if isinstance(sample, Depth):
                frame_ms[method].append(elapsed_ms)
            if estimate is not None:
                estimates[method].append(estimate)
    return Predictions(estimates=estimates, frame_ms=frame_ms, path=trajectory(poses), camera=camera)


def score_predictions(predictions: Predictions, recording: Recording, sole_m: float) -> dict[str, ModeScores]:
    """Scores of the predictions of each method.

    Args:
        predictions: Predictions on a walk.
        recording: The walk, with the truth.
        sole_m: Length of the walker's soles, m.
    """
    pose_topic, _ = find_pose_topic(recording, depth_calibration(recording.rig))
    truth = TruePath.of(recording.block(pose_topic))
    # poses at which the truth is known
    in_truth = (predictions.path.t_ns >= truth.t_ns[0]) & (predictions.path.t_ns <= truth.t_ns[-1])
    path = predictions.path[in_truth]
    alignment = MovingAlignment(path, truth.at(path.t_ns))  # from the odometry's world to the true one
    layout = terrain_layout(recording.metadata)  # the true terrain
    footprints = true_footprints(recording)
    return {m: score_modes(footprints, e, alignment, layout, sole_m) for m, e in predictions.estimates.items()}


def score_rows(predictions: Predictions, recording: Recording, sole_m: float) -> dict[str, TimedModeRows]:
    """The scores of each method as rows (`ModeScores.rows`), with the time per depth image: `time_ms: {mean, p95}`.

    Args:
        predictions: Predictions on a walk.
        recording: The walk, with the truth.
        sole_m: Length of the walker's soles, m.
    """
    return {
        method: {**scores.rows(), "time_ms": _time_statistics(predictions.frame_ms[method])}
        for method, scores in score_predictions(predictions, recording, sole_m).items()
    }


def samples_with_poses(
    recording: Recording,
    mount: str,
    poses: str,
    on_pose: Callable[[Pose], None] = lambda pose: None,
) -> Iterator[Sample]:
    """Yields what the predictors read, in time order: poses, depth images and insoles.

    Poses of the odometry are those of the camera's IMU, and of the camera on it.

    Args:
        recording: Recording of the walk.
        mount: Body of the camera: head or chest.
        poses: One of `POSE_SOURCES`; the true poses (`given`) are those of one frame alone.
        on_pose: Gets every valid pose of the odometry, with its covariance.
    """
    camera = depth_calibration(recording.rig)
    if poses == "given":  # the true poses take the place of the odometry
        pose_topic, _ = find_pose_topic(recording, camera)
        yield from recording.samples([pose_topic, *INSOLES, camera.depth_topic])
        return
    odometry = make_odometer("proposed", recording.rig, mount)
    pose_feed = PoseFeed()  # turns an estimate of the odometry into pose samples
    for sample in recording.samples([f"/{mount}/imu", camera.topic, *INSOLES, camera.depth_topic]):
        if isinstance(sample, Imu | Image | Depth):
            estimate = odometry.update(sample)
            if (pose := pose_of(estimate)) is not None and pose.valid:
                on_pose(pose)
            yield from pose_feed.samples(estimate)
        if isinstance(sample, Depth | Insole):
            yield sample


def trajectory(path: list[Odometry]) -> Trajectory:
    """The poses of odometry samples in time order as a trajectory."""
    return Trajectory(
        t_ns=np.array([o.t_ns for o in path], np.int64),
        p_frame_in_world=np.array([o.p_frame_in_world for o in path]),
        q_world_frame=np.array([o.q_world_frame for o in path]),
    )


def _time_statistics(frame_ms: list[float]) -> dict[str, float]:
    """Mean (`mean`) and 95th percentile (`p95`) of times, ms."""
    return {"mean": float(np.mean(frame_ms)), "p95": float(np.percentile(frame_ms, 95))}
