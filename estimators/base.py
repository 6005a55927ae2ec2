"""The interface of an estimator, and its declaration.

A class is an estimator when it has a `declaration`, the class method `streams`, the constructor
`Estimator(rig, *, options=None, parameters=None)` and `update(sample)`. A package offers it under the entry point group
`stridetwin.estimators` (`registry`). What `update` returns depends on the kind of output that it declares:

| kind | `update` returns |
|---|---|
| `path` | a `Pose`, or an object whose `pose` is one |
| `steps` | `contact_terrain.StepEstimate` |
| `terrain` | `terrain_map.TerrainEstimate`; the estimator has the methods of `TerrainMap` |
| `modes` | `locomotion_mode.ModeEstimate` |
| `gait_phase` | `gait_phase.PhaseEstimate` |

How outputs of a kind are written, scored and drawn is in `outputs`, one folder per kind; packages may add kinds.

Before the first real sample `live` feeds an estimator six seconds of synthetic ones, so that it has compiled its
functions by then.

An estimator that runs other estimators itself may list them in the attribute `inner_estimators`; their output is then
taken from there, and they are not run a second time.

The estimate of an odometry may also have a `camera_pose`, the estimated `Pose` of its camera in its own frame, a new
object whenever it changes.

An estimator of paths may also have the class method `follow(recording, options, progress)`, which returns the
`PathEstimate`s of a whole recording, with the same numbers as `update` sample by sample. With a fourth argument
`parameters` it is also used where single parameters are changed.

Study files and `--set` change single parameters by name. For this, the type hint of `parameters` is a dataclass or a
named tuple with defaults; where these depend on the method, the estimator has the static method
`default_parameters(method)`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Odometry, Sample
from stridetwin.streams.trajectory import Trajectory

PROPOSED = "proposed"
"""Method of an estimator that is not from a paper."""
PATH, STEPS, TERRAIN, MODES = ("path", "steps", "terrain", "modes")
"""Names of the kinds of output of our estimators."""
POSES = "/poses"
"""Topic of the poses, `Odometry`, that an estimator of terrain or modes takes from an odometry."""
CAMERA_POSES = "/poses/camera"
"""Topic of the estimated pose of the camera in the frame of `POSES`, `Odometry`; without any, the nominal one holds."""
TRACKING = "tracking"
"""Status of a pose that measurements of the surroundings support, as against dead reckoning."""
DEPTH_ONLY = "depth_only"
"""Status of a pose that planes in depth images hold, where colour images show nothing: supported in some directions."""
IMU_ONLY, LOST = "imu_only", "lost"
"""Status of a pose by dead reckoning alone, and of one that is not valid."""
FOOT_NAMES = {"l": "left", "r": "right"}
"""Name of each foot by its letter in topics and options."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EstimatedPose(Odometry):
    """A pose under `POSES` with what its odometry says of it.

    Attributes:
        status: What holds the pose, such as `TRACKING` or `IMU_ONLY`; "" if the odometry does not say.
        covariance: (6, 6) of position (m) and rotation about the world's axes (rad), see `Pose`; None if unknown.
    """

    status: str = ""
    covariance: Array | None = None


Progress = Callable[[str, float], None]
"""Called now and then during a long run, with the name of the work and the share of it that is done, 0 to 1."""
SampleT = TypeVar("SampleT", contravariant=True)
EstimateT = TypeVar("EstimateT", covariant=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class Options:
    """The user's options, common to all estimators; each reads those it needs.

    Attributes:
        method: One of `Declaration.methods`.
        foot: `l` or `r`, for an estimator of one foot.
        mount: Mount of the camera, one of `Declaration.mounts`; "" takes the first that the rig has.
        backend: One of `Declaration.backends`; "" takes the first.
        poses_of: Frame of the poses under `POSES`, such as `head/imu`; "" means the depth camera's optical frame.
        lag_s: Smooth each pose with what follows within this time, s; None returns each pose at once.
        calibration_from: File with what an earlier estimate learnt of the sensor; None: nothing is known.
        exoskeleton: File of an exoskeleton's geometry; None takes the one in the metadata.
        metadata: Texts that came with the samples.
        source: Origin of the metadata, for error messages.
    """

    method: str = PROPOSED
    foot: str = "l"
    mount: str = ""
    backend: str = ""
    poses_of: str = ""
    lag_s: float | None = None
    calibration_from: Path | None = None
    exoskeleton: Path | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)
    source: str = "metadata"


@dataclass(frozen=True, kw_only=True)
class Stream:
    """A stream that an estimator takes.

    Attributes:
        role: Use of the samples. Streams with the same role are alternatives; a required role needs one of them.
        topic: Name of the stream.
        kind: Type of its samples.
        required: Without a stream of this role nothing is estimated in `run` and `score`.
        live: The estimator's `update` takes it; otherwise only `follow` reads it.
    """

    role: str
    topic: str
    kind: type[Sample]
    required: bool = True
    live: bool = True


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """Description of an estimator for the commands, the report and the gate.

    Attributes:
        name: In commands, files and scores.
        kind: Kind of its output, an entry point of the group `stridetwin.outputs`; decides return type, file, truth and
            scores.
        description: One line for `list`, where the module of the entry point has no docstring.
        needs: What a recording must hold, in words: "a recording with <needs>".
        order: Place among the estimators of its kind.
        methods: Names of the algorithms, the default first.
        backends: Implementations of its method, the default first; empty if there is one.
        per_foot: One instance is the estimator of one foot; both feet are run.
        mounts: Possible mounts of its camera; the first that the streams allow is run.
        parts: For an instance that estimates several paths: by frame, the suffix of the path's name and file.
        supplies_poses: Estimators of terrain and modes use its poses, those of the sensor of its stream `imu`.
        smooths: It takes `Options.lag_s`.
        recalls: It takes `Options.calibration_from`.
        label: How figures call its paths, beside "left", "right" or "camera"; None means its name.
        summary: A sentence for the report.
        budget_s: Live: time from arrival to estimate that 99 % of the samples keep, s. A step takes 0.5 s; ours allow
            a tenth of it for legs, a fifth for cameras, and more for ground that is 1.5 s away.
        window_s: Live: how long a sample waits for older ones of other streams, s.
    """

    name: str
    kind: str
    description: str = ""
    needs: str = ""
    order: int = 100
    methods: tuple[str, ...] = (PROPOSED,)
    backends: tuple[str, ...] = ()
    per_foot: bool = False
    mounts: tuple[str, ...] = ()
    parts: Mapping[str, str] = field(default_factory=dict)
    supplies_poses: bool = False
    smooths: bool = False
    recalls: bool = False
    label: str | None = None
    summary: str = ""
    budget_s: float = 0.1
    window_s: float = 0.01


class Estimator(Protocol[SampleT, EstimateT]):
    """An estimator: causal, bounded in memory, deterministic; never returns a NaN.

    The interface is generic: of `SampleT`, such as `Imu` or a union of sample types, `update` makes an `EstimateT`, the
    type that the kind of output asks for (table above). `estimator_class: type[Estimator[Imu, Pose]] = MyFoot` lets a
    type checker say whether a class fits.

    Attributes:
        declaration: Its description.
    """

    declaration: ClassVar[Declaration]

    def __init__(self, rig: Rig, *, options: Options | None = None, parameters: object = None) -> None:
        """Raises StrideTwinError where the rig lacks a sensor or calibration; the message names it."""

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """The streams that it takes; several of one role are alternatives.

        Raises:
            StrideTwinError: The rig, or the options' metadata, does not say what these are.
        """

    def update(self, sample: SampleT, /) -> EstimateT | None:
        """Takes one sample, in time order; returns an estimate, or None if nothing changed."""


AnyEstimator = Estimator[Sample, object]
"""An estimator of any kind, as commands run it: its samples are those of the streams that it has named."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PathEstimate:
    """The path that an estimator gives for one frame over a whole recording, of N poses.

    Attributes:
        name: In scores and files, such as `foot_ins_l`.
        frame: Frame whose path it is, such as `foot_l/imu`.
        path: Poses in the estimator's own world.
        ready_ns: From when on it is scored: an estimator may align to gravity first.
        nis: By kind of measurement: mean squared innovation over its variance, per degree of freedom; 1 if consistent.
        world: Estimates of one world are aligned with the truth together, as the first of them is; "" = each by itself.
        healthy: (N,) whether the estimator considers its pose valid; None if not provided.
        status: (N,) words of the estimator, `TRACKING` among them; None if not provided.
        camera: Estimated poses of the camera in the frame, one per change; None if not estimated.
        label: What figures call the path, beside "left", "right" or "camera"; None means its name.
        supplies_poses: Whether estimators of terrain and modes use this path.
        notes: What the user should know about this estimate, one sentence each.
        write_calibration: Writes what was learnt of the sensor to a file; None if nothing is.
    """

    name: str
    frame: str
    path: Trajectory
    ready_ns: int = 0
    nis: Mapping[str, float] = field(default_factory=dict)
    world: str = ""
    healthy: NDArray[np.bool_] | None = None
    status: NDArray[np.str_] | None = None
    camera: Trajectory | None = None
    label: str | None = None
    supplies_poses: bool = False
    notes: tuple[str, ...] = ()
    write_calibration: Callable[[Path], None] | None = None


def foot_imu_topic(rig: Rig | None, foot: str) -> str:
    """Topic of the IMU on a foot: `/foot_l/imu`, or that of another one that the rig has on the foot.

    Args:
        rig: The calibration; None for an unknown one.
        foot: `l` or `r`.
    """
    standard = f"/foot_{foot}/imu"
    on_foot = [] if rig is None else [t for t, imu in rig.imus.items() if imu.mount.body == f"foot_{foot}"]
    return standard if standard in on_foot or not on_foot else on_foot[0]


POSE_STREAM = Stream(role="poses", topic=POSES, kind=Odometry)
