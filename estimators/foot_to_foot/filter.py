"""The inertial navigation of two shoes that observe each other, as an estimator: samples in, poses of both feet out."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import PATH, PROPOSED, Declaration, Options, PathEstimate, Progress, Stream
from stridetwin.estimators.checkerboard.pose import BoardObservation
from stridetwin.estimators.foot_ins.estimate import FootInsEstimate, FootInsPath, StartPose, with_considered
from stridetwin.estimators.foot_ins.parameters import for_sensor
from stridetwin.estimators.foot_ins.state import ATTITUDE, BY_VELOCITY, EMPTY, IGNORED, REPORTED, STATES
from stridetwin.estimators.foot_to_foot import kernel
from stridetwin.estimators.foot_to_foot.board_tracking import BoardPrediction, BoardTracker, relative_position
from stridetwin.estimators.foot_to_foot.events import Aid, RelativePosition, merge_events
from stridetwin.estimators.foot_to_foot.parameters import FootToFootParameters, for_kernel
from stridetwin.estimators.foot_to_foot.shoe_rig import LeftRightCheck, shoes_of, side_by_side_start
from stridetwin.estimators.foot_to_foot.state import ECHOES, FEET, IMU, NEVER, OBSERVATIONS, Events, blank_pair
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import ImuCalibration, Rig
from stridetwin.streams.samples import Array, Block, Image, Imu, Range, Sample
from stridetwin.streams.trajectory import Pose, Trajectory

# Aids of each method; `published` is the paper's name for its third one.
METHODS: dict[str, tuple[type, ...]] = {
    PROPOSED: (BoardObservation, Range),
    "published": (RelativePosition,),
    "zupt_relative_position": (RelativePosition,),
    "zupt_relative_distance": (Range,),
    "zupt": (),
}
Aiding = BoardObservation | RelativePosition | Range
MAX_WAITING_AIDS = 16  # aids that may wait for the IMUs to reach their time; the oldest is dropped first

_NOTHING_JOINS = "without shoe cameras and sonars nothing joins the feet: each path is that of its foot alone"
_REPORTED_OF_BOTH = np.r_[:REPORTED, STATES : STATES + REPORTED]
"""The first 15 errors of each foot."""
_POSES_OF_BOTH = np.r_[0:3, 6:9, REPORTED : REPORTED + 3, REPORTED + 6 : REPORTED + 9]
"""Those of position and attitude among them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FootToFootEstimate:
    """Estimated state of both feet after one sample.

    Attributes:
        t_ns: Time of the sample.
        feet: Estimate of each foot with samples, by `l` and `r`, at that foot's newest sample.
        covariance: (30, 30) of the left foot's 15 errors, then the right's; see `FootInsEstimate`.
        observations: Boards observed in the images processed with this sample.
        pose: Pose of the IMU that gave the sample; None after a sample of another kind.
    """

    t_ns: int
    feet: Mapping[str, FootInsEstimate]
    covariance: Array
    observations: tuple[BoardObservation, ...] = ()
    pose: Pose | None = None


class FootToFoot:
    """Inertial navigation of two shoes, coupled by camera or sonar measurements of each other.

    Causal, of constant memory and cost, deterministic. Each foot is filtered as by `FootIns`, within one covariance of
    both; one foot alone, or two without mutual measurements, give the same numbers as `FootIns`. A board observation is
    used once both IMUs have reached its time, and an echo once both are past it: at most one sample later.

    Args:
        rig: IMUs, cameras, boards and sonars on the bodies `foot_l` and `foot_r`.
        options: `method` is one of `METHODS`: `proposed`, or one of Jao, Wang, Shkel 2020, which are
            `zupt_relative_position` (also called `published`), `zupt_relative_distance` and `zupt`.
        parameters: Parameters of all methods.
        start: Pose of each foot's IMU at its first sample, by `l` and `r`. Without it, one foot starts as `FootIns`
            does, and two start side by side.
        earth_rate_in_world: (3,) rotation rate of the Earth, rad/s; 0 if latitude or north are unknown.

    Raises:
        ConfigError: An unknown method.
        StrideTwinError: No IMU on either foot.
    """

    declaration: ClassVar[Declaration] = Declaration(
        name="foot_to_foot",
        kind=PATH,
        order=2,
        methods=tuple(METHODS),
        label="feet together",
        budget_s=0.05,
        parts={"foot_l/imu": "l", "foot_r/imu": "r"},
        summary="Feet together: both IMUs in one filter, coupled by the shoe cameras and sonars.",
    )

    def __init__(
        self,
        rig: Rig,
        *,
        options: Options | None = None,
        parameters: FootToFootParameters | None = None,
        start: Mapping[str, StartPose] | None = None,
        earth_rate_in_world: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        """Prepares the joint state of both feet for the sensors on them, without samples."""
        Rig.check(rig, "FootToFoot")  # raises if `rig` is no `Rig`
        method = (options or Options()).method
        if method not in METHODS:
            raise ConfigError("FootToFoot", "method", method, ", ".join(METHODS))
        parameters, published = parameters or FootToFootParameters(), method != PROPOSED
        self._listens_to = METHODS[method]  # types of the aids that the method uses
        self._shoes = shoes = shoes_of(rig)
        self._parameters = for_kernel(parameters, published)
        # of the method: parameters of a foot, calibrations of the IMUs, standard deviation of a gyro's scale
        foot, imus, scale_sd = parameters.foot, shoes.imus, 0.0
        if published or shoes.cameras:  # this filter has its own terms for these errors; the paper has none
            imus = {f: _without_scale_errors(imu) for f, imu in imus.items()}
        if shoes.cameras and not published:
            foot = replace(foot, gyro_noise_radps_rthz=parameters.scaled_gyro_noise_radps_rthz)
            scale_sd = parameters.gyro_scale_sd
        left, right = (
            for_sensor(foot, imus.get(f), data_sheet_alone=published, is_sensor_considered=False) for f in FEET
        )
        self._foot_parameters = (left, right)
        mount_sds = [  # position (m) and rotation (rad), of a camera and of a board
            [parameters.camera_position_sd_m, parameters.camera_rotation_sd_rad],
            [parameters.board_position_sd_m, parameters.board_rotation_sd_rad],
        ]
        # (4, 6) for left and right of each, with three axes of each value; the published method has no such errors
        mount_sd = np.zeros((4, 6)) if published else np.repeat(np.repeat(mount_sds, 2, axis=0), 3, axis=1)
        clock_sd = 0.0 if published else parameters.camera_clock_sd_s
        earth = np.asarray(earth_rate_in_world)
        self._pair = blank_pair(shoes.mounts, mount_sd**2, clock_sd**2, scale_sd**2, shoes.sonars, earth)
        if start is None:
            start = side_by_side_start(shoes) if len(shoes.imus) == 2 else {}
        for name, pose in start.items():
            pose.apply_to(self._pair.feet[FEET.index(name)])
        self._newest_ns = [NEVER, NEVER]  # time of each foot's newest sample
        # of each foot's newest used sample: phase, and standard deviation of the stationary foot's speed (m/s)
        self._phase, self._speed_sd = [EMPTY, EMPTY], [np.inf, np.inf]
        self._held: deque[Aid] = deque(maxlen=MAX_WAITING_AIDS)  # aids whose time the IMUs have not reached yet
        self._boards = BoardTracker(shoes, parameters.exposure_s)
        self._left_right = LeftRightCheck(shoes.mounts)
        # index in `FEET` of the foot, by topic of the sensor
        self._camera_of = {camera.topic: FEET.index(f) for f, camera in shoes.cameras.items()}
        self._imu_of = {imu.topic: FEET.index(f) for f, imu in shoes.imus.items()}
        self._sonar_of = {topic: i for i, topic in enumerate(shoes.sonar_topics) if topic}

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """IMUs, cameras and sonars of both feet, for any options; a recording need not have the cameras and sonars."""
        on_feet = tuple(f"foot_{foot}" for foot in FEET)
        cameras = [c.topic for c in rig.cameras.values() if c.mount.body in on_feet]
        sonars = [s.topic for s in rig.others.values() if s.kind == "range" and s.mount.body in on_feet]
        return (
            *(Stream(role=f"imu of {foot}", topic=f"/{foot}/imu", kind=Imu) for foot in on_feet),
            *(Stream(role="camera", topic=topic, kind=Image, required=False) for topic in cameras),
            *(Stream(role="sonar", topic=topic, kind=Range, required=False) for topic in sonars),
        )

    @classmethod
    def follow(
        cls,
        recording: Recording,
        options: Options,
        progress: Progress | None = None,
        parameters: FootToFootParameters | None = None,
    ) -> list[PathEstimate]:
        """The paths of both feet over a whole recording; `progress` is not used.

        Raises:
            StrideTwinError: A topic or calibration is missing, or a foot is never stationary.
        """
        estimator, name = cls(recording.rig, options=options, parameters=parameters), cls.declaration.name
        streams = [s for s in cls.streams(recording.rig, options) if s.required or s.topic in recording.topics]
        if any(s.kind is Image for s in streams):
            paths = follow(estimator, recording.samples([s.topic for s in streams]))
        else:  # no image is searched at a prediction, so one block gives the same numbers
            blocks = {foot: recording.block(f"/foot_{foot}/imu").as_kind(Imu) for foot in FEET}
            sonars = [recording.block(s.topic).as_kind(Range) for s in streams if s.kind is Range]
            echoes = [echo for sonar in sonars for echo in sonar]
            paths = estimator.run(blocks, echoes)
        world = name if options.method == PROPOSED else f"{name}_{options.method}"
        # statistics of consistency: those of both feet, and below those of each foot's zero velocities
        common = {kind: value for kind, value in estimator.nis.items() if not kind.startswith("standing")}
        alone = () if any(not s.required for s in streams) else (_NOTHING_JOINS,)
        estimates = []
        for foot, path in paths.items():
            standing = estimator.nis.get(f"standing_{foot}")
            nis = common if standing is None else {"standing": standing, **common}
            estimate = path.estimate(recording, world, foot, cls.declaration.label or "", nis, world)
            estimates.append(replace(estimate, notes=estimate.notes + alone))
        return estimates

    def update(self, sample: Imu | Image | Aiding) -> FootToFootEstimate | None:
        """Takes one sample; returns the new estimate, or None if the sample is ignored or has to wait.

        Methods that use board observations or relative positions search an image for the other shoe's board.

        Raises:
            StrideTwinError: A sample of a topic that the rig does not have on a foot, or an image that shows that left
                and right are exchanged (`LeftRightCheck`).
        """
        if isinstance(sample, Imu):
            foot = FEET[self._foot_index(sample, self._imu_of)]
            events, phase, _, _, _ = self._process({foot: _to_block(sample)}, [])
            used = phase[events.kind == IMU][0] != IGNORED  # the one IMU sample; the other events are aids
        elif isinstance(sample, Image):
            self._foot_index(sample, self._camera_of)  # raises for a topic that is not of the feet
            uses_images = bool({BoardObservation, RelativePosition} & set(self._listens_to))
            used = uses_images and self._boards.enqueue(sample)
        else:
            events, _, _, _, _ = self._process({}, [sample])
            used = len(events.t_ns) > 0  # an aid that must wait is no event yet
        if not used:
            return None
        seen = self._process_images()  # None if no queued image is due
        if seen is None and isinstance(sample, Image):  # this image waits for the IMUs and changes nothing yet
            return None
        feet = {
            FEET[f]: FootInsEstimate.of(self._pair.feet[f], self._phase[f], self._speed_sd[f], f"foot_{FEET[f]}/imu")
            for f in range(2)
            if self._phase[f] != EMPTY  # a foot with samples
        }
        pose = feet[self.foot_of(sample)].pose if isinstance(sample, Imu) else None
        covariance = self._pair.covariance[np.ix_(_REPORTED_OF_BOTH, _REPORTED_OF_BOTH)]
        poses = _POSES_OF_BOTH[:, None], _POSES_OF_BOTH
        rows = _REPORTED_OF_BOTH[_POSES_OF_BOTH]
        covariance[poses] = with_considered(self._pair.feet[0], covariance[poses], rows)
        return FootToFootEstimate(
            t_ns=sample.t_ns, feet=feet, covariance=covariance, observations=tuple(seen or ()), pose=pose
        )

    @property
    def nis(self) -> dict[str, float]:
        """Mean normalised innovation squared per degree of freedom, by kind of update: 1 if consistent.

        The kinds are `standing_l`, `standing_r`, `sightings` (boards) and `echoes`; unused ones are left out.
        """
        # (2,) each: sum of the normalised innovation squared, and number of updates
        sums = {f"standing_{f}": memory.nis[BY_VELOCITY] for f, memory in zip(FEET, self._pair.feet)}
        sums |= {"sightings": self._pair.nis[OBSERVATIONS], "echoes": self._pair.nis[ECHOES]}
        return {name: float(total / count) for name, (total, count) in sums.items() if count}

    def foot_of(self, sample: Imu) -> str:
        """`l` or `r`: the foot that carries the IMU of a sample.

        Raises:
            StrideTwinError: Neither does.
        """
        return FEET[self._foot_index(sample, self._imu_of)]

    def run(self, imus: Mapping[str, Block[Imu]], aids: Iterable[Aiding] = ()) -> dict[str, FootInsPath]:
        """The paths of both feet from all samples at once, with the numbers of `update` sample by sample.

        `update` has to take them in time order, an IMU's before an aid of the same time.

        Args:
            imus: Samples of each foot, by `l` and `r`.
            aids: Observations and echoes, in any order.

        Returns:
            Path of each foot over its usable samples, by `l` and `r`.

        Raises:
            ConfigError: A foot without IMU in the rig.
            StrideTwinError: A sonar that the rig does not have on a foot.
        """
        if unknown := set(imus) - set(self._shoes.imus):
            raise ConfigError("FootToFoot.run", "imus", sorted(unknown), f"by {' or '.join(self._shoes.imus)}")
        events, phase, figure, state, covariance = self._process(imus, aids)  # figure: of an IMU sample, the speed's sd
        paths = {}
        for foot in imus:
            rows = (events.kind == IMU) & (events.foot == FEET.index(foot))
            paths[foot] = FootInsPath.of(events.t_ns[rows], phase[rows], figure[rows], state[rows], covariance[rows])
        return paths

    def _process(
        self, imus: Mapping[str, Block[Imu]], aids: Iterable[Aiding]
    ) -> tuple[Events, NDArray[np.int8], Array, Array, Array]:
        """Runs the kernel on samples and on the aids whose time has come.

        Aids that the method does not use, and echoes without a valid distance, are dropped. Aids whose time is still to
        come are held until a later call. The time, phase and speed of each foot's newest sample are noted.

        Args:
            imus: Samples of each foot, by `l` and `r`.
            aids: New aids, in any order.

        Returns:
            The N events. (N,) of an IMU sample, the phase in which it was used; of an aid, IGNORED. (N,) of an IMU
            sample, the standard deviation of the stationary foot's speed, m/s; of an aid, its normalised innovation.
            (N, 22) nominal state and (N, 6, 6) covariance of position (m) and attitude (rad) of the foot of an IMU
            sample.
        """
        # with the foot of each; `_foot_of` raises for a topic of neither foot, also where the aid is not used
        aids_of_feet = [(self._foot_of(aid), aid) for aid in aids]
        used_aids = [
            (foot, aid)
            for foot, aid in aids_of_feet
            if isinstance(aid, self._listens_to) and (not isinstance(aid, Range) or 0.0 < aid.distance < np.inf)
        ]
        events, pending = merge_events(imus, [*self._held, *used_aids], self._newest_ns)
        self._held = deque(pending, maxlen=MAX_WAITING_AIDS)
        n = len(events.t_ns)
        phase, figure = np.empty(n, np.int8), np.empty(n)
        state, covariance = np.empty((n, self._pair.feet[0].nominal.size)), np.empty((n, 6, 6))
        kernel.run(self._pair, self._foot_parameters, self._parameters, events, phase, figure, state, covariance)
        for f in range(2):
            rows = np.flatnonzero((events.kind == IMU) & (events.foot == f))
            if len(rows):
                self._newest_ns[f] = max(self._newest_ns[f], int(events.t_ns[rows].max()))
            used_rows = rows[phase[rows] != IGNORED]
            if len(used_rows):
                newest = used_rows[-1]
                self._phase[f], self._speed_sd[f] = int(phase[newest]), float(figure[newest])
        return events, phase, figure, state, covariance

    def _foot_of(self, aid: Aiding) -> int:
        """Index in `FEET` of the foot that carries the camera or the sonar of an aid."""
        return self._foot_index(aid, self._sonar_of if isinstance(aid, Range) else self._camera_of)

    def _process_images(self) -> list[BoardObservation] | None:
        """Searches the images whose time has come for boards, and updates the filter by them.

        Returns:
            The boards found, also those not used while left and right may be exchanged; None if no image was due.
        """
        ready = self._boards.pop_ready(min(self._newest_ns))  # each with the camera's foot, and time on the IMUs' clock
        seen = []
        for image, foot, t_ns in ready:
            expected = self._predict_board(foot, t_ns)
            # no prediction while a foot is not tracked; no observation if the board is not detected
            if expected is None:
                continue
            observation = self._boards.detect(image, expected, self._left_right.seems_exchanged)
            if observation is None:
                continue
            seen.append(observation)
            if not self._left_right.agrees(observation, foot, self._attitudes()):
                continue
            aid: Aiding | None = observation
            if BoardObservation not in self._listens_to:  # the published method takes the vector between the feet
                aid = relative_position(observation, foot, self._pair.mounts, expected)
            if aid is not None:
                self._process({}, [aid])
        return seen if ready else None

    def _attitudes(self) -> Array:
        """(2, 3, 3) world <- IMU of both feet at their newest samples."""
        q = np.array([memory.nominal[ATTITUDE : ATTITUDE + 4] for memory in self._pair.feet])
        return np.asarray(Rotation.from_quat(q, scalar_first=True).as_matrix())

    def _predict_board(self, foot: int, t_ns: int) -> BoardPrediction | None:
        """Predicted pose of the other foot's board in a foot's camera; None if it is unknown.

        Args:
            foot: Index in `FEET` of the foot that carries the camera.
            t_ns: Middle of the exposure, with the calibrated offset to the clock of the IMUs.
        """
        T, T_before, covariance = np.eye(4), np.eye(4), np.empty((6, 6))  # written by the kernel
        known = kernel.predict_board(
            self._pair,
            self._foot_parameters[foot],
            self._parameters,
            foot,
            t_ns,
            self._boards.exposure_ns,
            T,
            covariance,
            T_before,
        )
        return BoardPrediction(T_camera_board=T, covariance=covariance, T_before=T_before) if known else None

    def _foot_index(self, sample: Imu | Image | Aiding, foot_by_topic: Mapping[str, int]) -> int:
        """Index in `FEET` of the foot whose sensor gave a sample.

        Args:
            sample: The sample, by its topic.
            foot_by_topic: Index of the foot by topic, of all sensors of that kind on the feet.

        Raises:
            StrideTwinError: The topic is of neither foot.
        """
        if sample.topic not in foot_by_topic:
            on_feet = ", ".join(foot_by_topic)
            raise StrideTwinError(f"{sample.topic} is on neither foot of the rig; on its feet: {on_feet}")
        return foot_by_topic[sample.topic]


def _to_block(sample: Imu) -> Block[Imu]:
    """A block of one IMU sample, as the kernel of the foot's filter takes it."""
    columns = {"angular_rate": sample.angular_rate[None], "specific_force": sample.specific_force[None]}
    return Block(topic=sample.topic, kind=Imu, t_ns=np.array([sample.t_ns]), columns=columns)


def follow(estimator: FootToFoot, samples: Iterable[Sample]) -> dict[str, FootInsPath]:
    """The path of each foot with samples, by `l` and `r`, from samples of all streams in time order.

    Samples of kinds that the filter does not use are skipped.
    """
    rows: dict[str, list[FootInsEstimate]] = {}
    for sample in samples:
        if not isinstance(sample, Imu | Image | Range):
            continue
        estimate = estimator.update(sample)
        if estimate is not None and isinstance(sample, Imu):
            foot = estimator.foot_of(sample)
            rows.setdefault(foot, []).append(estimate.feet[foot])
    return {foot: _to_path(estimates) for foot, estimates in sorted(rows.items())}


def _to_path(rows: list[FootInsEstimate]) -> FootInsPath:
    """The path of a foot from its estimates one by one."""
    pose = np.r_[0:3, 6:9]  # position and attitude among the 15 errors
    return FootInsPath(
        trajectory=Trajectory(
            t_ns=np.array([e.t_ns for e in rows], np.int64),
            p_frame_in_world=np.array([e.pose.p_frame_in_world for e in rows]),
            q_world_frame=np.array([e.pose.q_world_frame for e in rows]),
            covariance=np.array([e.covariance[np.ix_(pose, pose)] for e in rows]),
        ),
        v_imu_in_world=np.array([e.v_imu_in_world for e in rows]),
        standing_speed_sd=np.array([e.standing_speed_sd for e in rows]),
        aligned=np.array([e.aligned for e in rows]),
    )


def _without_scale_errors(imu: ImuCalibration) -> ImuCalibration:
    """The calibration without the scale and alignment errors that it leaves: this filter has its own terms for them."""
    return replace(imu, gyroscope_scale_sd=0.0, gyroscope_misalignment_sd=0.0, accelerometer_scale_sd=0.0)
