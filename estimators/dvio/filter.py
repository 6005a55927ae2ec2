"""The depth-enhanced visual-inertial odometry as an estimator: samples in, poses out."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import ClassVar

import cv2
import numpy as np

from stridetwin.estimators.base import (
    DEPTH_ONLY,
    IMU_ONLY,
    LOST,
    PATH,
    TRACKING,
    Declaration,
    Options,
    PathEstimate,
    Progress,
    Stream,
)
from stridetwin.estimators.dvio.anchor import Anchor
from stridetwin.estimators.dvio.clock_search import ClockSearch
from stridetwin.estimators.dvio.estimate import DvioEstimate
from stridetwin.estimators.dvio.initializer import Alignment, Initializer
from stridetwin.estimators.dvio.loss import RUNNING_SPEED_MPS, PoseMemory, compute_strayed_variance
from stridetwin.estimators.dvio.nav_state import STATIONARY_S, NavState, copy_of
from stridetwin.estimators.dvio.parameters import METHODS, DvioParameters, method_parameters
from stridetwin.estimators.dvio.sliding_window import STATIONARY_SPEED_SD_MPS, SlidingWindow
from stridetwin.estimators.dvio.tracker import CameraFrame, Stereo, with_depth, with_stereo
from stridetwin.streams.errors import ConfigError, RecordingError, StrideTwinError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Depth, Image, Imu, Sample, copy_sample
from stridetwin.streams.trajectory import Pose, trajectory_of

# Hand-chosen on tuning seeds.
_RUNNING = (TRACKING, DEPTH_ONLY, IMU_ONLY)
_SIMULTANEOUS_S = 0.012  # colour and depth closer in time: less than half a frame period at 30 Hz
_MAX_IMU_GAP_S = 0.5  # a longer one causes a new start
_MAX_BLIND_S = 3.0  # after this long without an image the window restarts at the state from the IMU alone
# After this long without an image, or after so many frames of a slow camera, the estimate is dead reckoning.
_DEAD_RECKONING_S, _DEAD_RECKONING_FRAMES = 0.3, 2.0
_MAX_ALIGN_S = 3.0  # in motion, wait for vision and IMU to align; then the mean force is taken as the vertical
_MEAN_FORCE_S = 1.0  # duration of that mean
_MOVING_SPEED_SD_MPS, _MOVING_TILT_SD_RAD = 0.5, 0.15  # of a start by the mean force, in motion
_RESTING_TILT_SD_RAD = 0.03  # of a stationary start
_START_SD = 1e-4  # m and rad: the first position and heading define the world
# Share of the way by which the height drifts beyond the window's covariance: all normals of the ground have the same
# error of the depth camera, 0.3 to 0.9 mrad on tuning seeds.
_HEIGHT_SHARE_SD = 6e-4
_REST_SD_M = 2.5e-3  # slow motion of a standing person that shows nowhere: 10 mm/s for 0.25 s
# After a failure: position (m) and attitude (rad) in addition to the previous uncertainty, velocity (m/s), and biases
# of gyroscope (rad/s) and accelerometer (m/s²).
_LOST_SD = (0.5, 0.3, 1.0, 0.01, 0.1)
# What a start in motion by a wrong clock may have got wrong, beside its covariance: position (m), attitude (rad),
# velocity (m/s), as `_LOST_SD`.
_WRONG_CLOCK_SD = (0.1, 0.05, 0.3, 0.01, 0.1)
_SCALE_AFTER_S = 4.0  # after a start in motion the bias shows an error of the accelerometer's scale
_MAX_BIAS_SD_MPS2 = 0.05  # of the bias along gravity, from which it counts
_LOST_RATE_SD_RADPS = 0.01  # of the gyroscope's bias, by which the heading drifts while lost
# Dead reckoning has lost its way where its speed is less certain than that of anybody who walks.
_MAX_BLIND_SPEED_SD_MPS = 1.5
# An IMU that seems so many times noisier than its part belongs to a rig that is not as calibrated: such errors last.
_CREDIBLE_INFLATION = 3.0
_NEW_S = 6.0  # time after a start in which a clock that is far off is found
_MAX_REALIGN_S = 1.5  # after the clock was wrong, wait for vision and IMU to align


MOUNTS = ("head", "chest")
MAX_WAITING_IMAGES = 4  # images that may wait for the IMU or for their depth; the oldest is dropped first

_WANTED = " or ".join(f"/{m}/color and /{m}/imu" for m in MOUNTS)


class Dvio:
    """Visual-inertial odometry with depth for a camera on head or chest: causal, of constant memory, deterministic.

    After Zhao et al. 2023, §II-C, with extensions (`DvioParameters`). It starts at once if the sensor is stationary,
    and in motion once vision and IMU align (`initializer`), after about half a second. An image is processed once the
    IMU has reached its time and its depth has arrived or timed out; one more than 6 s late is discarded. A sample is
    ignored if it is not finite, of an unexpected size, or not later than the last one of its topic.

    Args:
        rig: Calibration of camera and IMU.
        options: `method` is one of `METHODS`; `mount` is `head` or `chest`, "" for the first with a camera and an IMU.
        parameters: Replace those of the method.

    Raises:
        ConfigError: An unknown mount.
        StrideTwinError: The rig has no camera or IMU there.
    """

    declaration: ClassVar[Declaration] = Declaration(
        name="dvio",
        kind=PATH,
        order=3,
        methods=tuple(METHODS),
        mounts=MOUNTS,
        supplies_poses=True,
        label="",
        needs="a camera with IMU on head or chest, better with depth",
        summary="Camera: visual-inertial odometry of the RGB-D camera with IMU.",
    )

    default_parameters = staticmethod(method_parameters)

    def __init__(self, rig: Rig, *, options: Options | None = None, parameters: DvioParameters | None = None) -> None:
        """Prepares the odometry of one mount of the rig; it starts with the samples.

        Raises ConfigError for an unknown mount, and StrideTwinError where the rig has no camera or IMU there.
        """
        Rig.check(rig, "Dvio")  # raises if `rig` is no `Rig`
        options = options or Options()
        mount = _choose_mount(rig, options)
        if mount not in MOUNTS:
            raise ConfigError("Dvio", "mount", mount, " or ".join(MOUNTS))
        self._frame = f"{mount}/imu"  # of the poses
        # topics of the images, of the depth images and of the IMU
        self._color, self._depth, self._imu = (f"/{mount}/{s}" for s in ("color", "depth", "imu"))
        if self._color not in rig.cameras:
            raise StrideTwinError(f"the rig has no camera {self._color!r}; it has {', '.join(rig.cameras) or 'none'}")
        camera, imu = rig.cameras[self._color], rig.imu(self._imu)
        T_imu_camera = np.linalg.inv(imu.mount.T_body_sensor) @ camera.mount.T_body_sensor
        self._parameters = parameters or method_parameters(options.method)
        # time since the newest frame after which the health is `imu_only`, s
        self._max_imu_only_s = max(_DEAD_RECKONING_S, _DEAD_RECKONING_FRAMES / camera.rate_hz)
        self._shape = (camera.height, camera.width)
        # whether an image waits for the depth image of its instant
        self._waits_for_depth = camera.depth_topic != "" and self._parameters.method.uses_depth
        # the window of frames, its buffer of IMU samples (`inertial`) and the state propagated with them (`nav`)
        self._core = SlidingWindow(camera, imu, T_imu_camera, self._parameters)
        self._initializer = Initializer(self._core)  # collects images for a start in motion
        # compares images with the gyroscope until the camera's clock is known; None for methods that trust it
        self._clock = ClockSearch(self._core.lens) if self._parameters.method.refines_all else None
        # the state at the last image at rest, which no clock can spoil; None before one
        self._resting_state: NavState | None = None
        # time from which the bias shows an error of the accelerometer's scale; None: that is done
        self._scale_due_ns: int | None = None
        self._way_m = 0.0  # horizontal way since the start
        # until when a new window waits for vision and IMU to align, because the clock was wrong; None: none waits
        self._restart_due_ns: int | None = None
        self._anchor = Anchor.exact()
        self._misfit = 1.0  # factor on the standard deviations of the window, because the rig is not as calibrated
        self._camera_pose = self._camera_mount(0)
        # colour and depth images that wait for the IMU or for each other, oldest first
        self._images: deque[Image] = deque(maxlen=MAX_WAITING_IMAGES)
        self._depths: deque[Depth] = deque(maxlen=MAX_WAITING_IMAGES)
        self._last_ns: dict[str, int] = {}  # stamp of the last accepted image of each topic
        # time of the first image at which the present start was tried, on the IMU's clock; None: no start is going on
        self._init_start_ns: int | None = None
        self._health = ""  # TRACKING, DEPTH_ONLY, IMU_ONLY or LOST; "" before the first start
        self._memory = PoseMemory()
        self._began_ns = 0  # when the odometry began, or began anew after a loss
        self._lost_ns = 0  # when the odometry was lost, or held for the last time before

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """Camera, IMU, depth if the rig has a depth camera, and in any case the second camera of a stereo pair.

        A recording may lack the last two: without depth the IMU gives the scale. `update` does not take the second
        camera: only `follow` does, and computes depth images from the pair.

        Raises:
            StrideTwinError: The rig has no camera with IMU on head or chest.
        """
        mount = _choose_mount(rig, options)
        color, depth, right = (f"/{mount}/{s}" for s in ("color", "depth", "color_right"))
        streams = [Stream(role="imu", topic=f"/{mount}/imu", kind=Imu), Stream(role="camera", topic=color, kind=Image)]
        if color in rig.cameras and rig.cameras[color].depth_topic:
            streams.append(Stream(role="depth", topic=depth, kind=Depth, required=False))
        return (*streams, Stream(role="depth", topic=right, kind=Image, required=False, live=False))

    @classmethod
    def follow(
        cls,
        recording: Recording,
        options: Options,
        progress: Progress | None = None,
        parameters: DvioParameters | None = None,
    ) -> list[PathEstimate]:
        """The path of the camera's IMU over a whole recording; without a depth stream, a stereo pair gives the depth.

        Args:
            recording: The recording.
            options: Method and mount; without a mount, the first with a camera and an IMU.
            progress: Called with "estimate" and the share of the recording that is done, 0 to 1.
            parameters: Replace those of the method.

        Returns:
            A list with the one path.

        Raises:
            StrideTwinError: A topic or calibration is missing, the method is unknown, or the odometry never starts.
        """
        available_mounts = [m for m in MOUNTS if {f"/{m}/color", f"/{m}/imu"} <= set(recording.topics)]
        if not available_mounts:
            raise RecordingError(f"{recording.path}: cannot run dvio: needs {_WANTED}")
        mount = options.mount or available_mounts[0]
        color, depth, right = (f"/{mount}/{s}" for s in ("color", "depth", "color_right"))
        rig, parameters = recording.rig, parameters or method_parameters(options.method)
        topics = [t for t in (f"/{mount}/imu", color, depth) if t in recording.topics]
        samples: Iterable[Sample] = recording.samples(topics)
        # no depth camera, but a stereo pair: depth images computed from it join the samples
        if depth not in recording.topics and right in recording.topics and parameters.method.uses_depth:
            stereo = Stereo(rig.cameras[color], rig.cameras[right], depth)
            rig = with_stereo(rig, color, depth)
            samples = with_depth(recording.samples([*topics, right]), stereo, right)
        odometry = cls(rig, options=Options(method=options.method, mount=mount), parameters=parameters)
        first_image_ns, poses, camera_poses = int(recording.image_times(color)[0]), list[Pose](), list[Pose]()
        status: list[str] = []  # health at each pose
        for sample in samples:
            estimate = odometry.update(sample)
            if progress is not None and isinstance(sample, Image):
                progress("estimate", min(1.0, (sample.t_ns - first_image_ns) * 1e-9 / max(recording.duration, 1e-9)))
            if estimate is not None:
                poses.append(estimate.pose)
                status.append(estimate.health)
                # the estimated mount is the same object until it changes
                if not camera_poses or estimate.camera_pose is not camera_poses[-1]:
                    camera_poses.append(estimate.camera_pose)
        if not poses:
            raise RecordingError(f"{recording.path}: dvio never starts: needs a second of IMU and images together")
        name = cls.declaration.name
        return [
            PathEstimate(
                name=name if options.method == cls.declaration.methods[0] else f"{name}_{options.method}",
                frame=f"{mount}/imu",
                path=trajectory_of(poses),
                ready_ns=poses[0].t_ns,
                label=cls.declaration.label,
                healthy=np.array([pose.valid for pose in poses], bool),
                supplies_poses=True,
                status=np.array(status),
                camera=trajectory_of(camera_poses),
            )
        ]

    def update(self, sample: Sample) -> DvioEstimate | None:
        """Takes one sample; returns the new estimate after one of the IMU.

        None if the sample is ignored, is an image or a depth image (they wait for the IMU), or comes before the start.

        Raises:
            StrideTwinError: A sample of another topic.
        """
        if isinstance(sample, Imu) and sample.topic == self._imu:
            return self._on_imu(sample)
        queue: deque[Image] | deque[Depth]
        if isinstance(sample, Image) and sample.topic == self._color:
            has_right_size, queue = sample.pixels.shape[:2] == self._shape, self._images
        elif isinstance(sample, Depth) and sample.topic == self._depth:
            has_right_size, queue = sample.depth.shape == self._shape, self._depths
        else:
            raise StrideTwinError(
                f"{sample.topic} is not of this odometry; it takes {self._imu}, {self._color}, {self._depth}"
            )
        # an image of another size or out of order is ignored; -2⁶² ns is earlier than any stamp
        if has_right_size and sample.t_ns > self._last_ns.get(sample.topic, -(2**62)):
            self._last_ns[sample.topic] = sample.t_ns
            queue.append(copy_sample(sample))  # type: ignore[arg-type]
        return None

    @property
    def time_offset_s(self) -> float:
        """Estimated time offset of the clocks: the IMU's time minus the camera's of the same instant, s."""
        return float(self._core.window.calibration.offset[0])

    def _camera_mount(self, t_ns: int) -> Pose:
        """The camera's estimated pose in the IMU's frame, m, stamped `t_ns`."""
        mount = self._core.window.calibration  # p (3,), m, and R (3, 3), IMU <- camera
        frame = self._color.removeprefix("/")
        return Pose(t_ns=t_ns, p_frame_in_world=mount.p.copy(), rotation=mount.R.copy(), frame=frame)

    @property
    def depth_scale(self) -> float:
        """Estimated ratio of true to measured depth."""
        return float(self._core.window.calibration.scale[0])

    @property
    def imu_noise_factors(self) -> tuple[float, float]:
        """Estimated noise of the gyroscope and of the accelerometer over that of their data sheet.

        The parameters give the factor at the start; `inflation.factor` (2,) is how much larger images have shown it to
        be.
        """
        rate, force = self._parameters.imu_noise_factor * self._core.inflation.factor
        return float(rate), float(force)

    def _on_imu(self, sample: Imu) -> DvioEstimate | None:
        """Processes an IMU sample: takes the images whose time it has reached, then propagates the state to its time.

        While lost, the state is not propagated: the pose is held, and the variance of its position grows with time. A
        plausible state is remembered; an implausible one means failure.
        The health becomes `imu_only` once the newest frame is older than `_max_imu_only_s`.

        Returns:
            The new estimate; None if the sample is invalid or the odometry has not started.
        """
        core = self._core
        if not core.inertial.add(sample):  # rejected: not finite, impossibly large, or out of order
            return None
        if self._health and core.inertial.gap_s() > _MAX_IMU_GAP_S:  # samples are missing before this one
            self._declare_lost()
        while (frame := self._take_due_image()) is not None:
            if self._corrects_clock(frame):
                continue
            if self._health in _RUNNING:
                self._track(frame)
            else:
                self._initialize(frame)
            self._camera_pose = self._camera_mount(sample.t_ns)
        if not self._health:  # not started yet
            return None
        if self._health == LOST:
            self._wait_while_lost(sample.t_ns)
            covariance = self._pose_covariance()
        else:
            self._way_m += float(np.linalg.norm(core.nav.v[:2])) * (sample.t_ns - int(core.nav.t_ns[0])) * 1e-9
            core.propagate(sample.t_ns)
            is_plausible, covariance = core.is_plausible, self._pose_covariance()
            if is_plausible:
                if self._health != IMU_ONLY and (sample.t_ns - core.newest_ns) * 1e-9 > self._max_imu_only_s:
                    self._health = IMU_ONLY
                self._memory.remember(core.nav, covariance, self._health != IMU_ONLY)
            if not is_plausible or self._has_lost_its_way:
                self._declare_lost()
                core.nav.t_ns[0] = sample.t_ns
                covariance = self._pose_covariance()
        reported = core.nav._replace(covariance=core.nav.covariance.copy())
        reported.covariance[:6, :6] = covariance
        return DvioEstimate.of(reported, self._health, self._camera_pose, self._frame, self._unmodelled_variance())

    def _pose_covariance(self) -> Array:
        """(6, 6) covariance of the pose of `nav`: position (m) and attitude (rad, about the IMU's axes).

        That of the window, wider where the rig is not as calibrated, and of the world in which it began: docs/dvio.md
        (22).
        """
        nav = self._core.nav
        covariance: Array = self._misfit**2 * nav.covariance[:6, :6] + self._anchor.covariance_at(nav.p, nav.R)
        return covariance

    @property
    def _has_lost_its_way(self) -> bool:
        """Whether dead reckoning is of no use: it moves as nobody does, or knows less than that somebody walks.

        The methods of others go on until their state is impossible.
        """
        if self._health != IMU_ONLY or not self._parameters.method.refines_all:
            return False
        nav = self._core.nav
        speed_variance = float(nav.covariance[range(6, 9), range(6, 9)].sum())
        return bool(speed_variance > _MAX_BLIND_SPEED_SD_MPS**2 or nav.v @ nav.v > RUNNING_SPEED_MPS**2)

    def _wait_while_lost(self, t_ns: int) -> None:
        """Moves a lost state on to a time: the position stays, less certain; the attitude follows the gyroscope.

        The velocity is unknown and lasts for a while: its part of the variance of the position grows with the square of
        the time at first, then in proportion to it.
        """
        core, nav = self._core, self._core.nav
        before_ns = int(nav.t_ns[0])
        turned = core.rotation_between(before_ns, t_ns)
        nav.R[:] = nav.R @ turned
        nav.covariance[3:6, 3:6] = turned.T @ nav.covariance[3:6, 3:6] @ turned
        nav.covariance[:3, 3:6] = nav.covariance[:3, 3:6] @ turned
        nav.covariance[3:6, :3] = nav.covariance[:3, 3:6].T
        lost_s = [max(t - self._lost_ns, 0) * 1e-9 for t in (before_ns, t_ns)]
        nav.covariance[range(3), range(3)] += compute_strayed_variance(lost_s[1]) - compute_strayed_variance(lost_s[0])
        nav.covariance[range(3, 6), range(3, 6)] += _LOST_RATE_SD_RADPS**2 * (lost_s[1] ** 2 - lost_s[0] ** 2)
        nav.t_ns[0] = t_ns

    def _unmodelled_variance(self) -> Array | None:
        """(3,) m², variance of the position by errors that all images share, docs/dvio.md (20); None for none.

        The methods of others report their window's covariance.
        """
        if not self._parameters.method.level_ground:
            return None
        return np.array([0.0, 0.0, (_HEIGHT_SHARE_SD * self._way_m) ** 2]) + _REST_SD_M**2

    def _take_due_image(self) -> CameraFrame | None:
        """Takes the oldest waiting image, with its depth, out of the queues; None if there is none, or it must wait.

        It waits until the IMU has samples beyond its time, and until its depth has arrived or `max_depth_wait_s` has
        passed. The depth image is the one within `_SIMULTANEOUS_S`; it is None where none came in time.
        """
        if not self._images:
            return None
        image, newest_imu_ns = self._images[0], self._core.inertial.newest_ns
        image_ns = self._core.imu_time(image.t_ns)  # on the IMU's clock
        if image_ns >= newest_imu_ns:
            return None
        depth = None
        for depth_image in self._depths:
            if abs(depth_image.t_ns - image.t_ns) * 1e-9 < _SIMULTANEOUS_S:
                depth = depth_image.depth
        has_waited_enough = (newest_imu_ns - image_ns) * 1e-9 > self._parameters.max_depth_wait_s
        if depth is None and self._waits_for_depth and not has_waited_enough:
            return None
        self._images.popleft()
        # depth images up to this time are not needed by later images
        while self._depths and self._depths[0].t_ns <= image.t_ns:
            self._depths.popleft()
        grey = image.pixels if image.pixels.ndim == 2 else cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)
        return CameraFrame(t_ns=image.t_ns, grey=np.ascontiguousarray(grey), depth=depth)

    def _track(self, frame: CameraFrame) -> None:
        """Tracks one image in the window, or restarts the window after a long time without images.

        An image that is not newer than the newest frame is skipped. The window restarts at the state from the IMU alone
        after `_MAX_BLIND_S` without an image, or if the IMU samples since the last keyframe are no longer kept. Sets
        the health to `tracking`, or to `imu_only` where too few points are seen. An implausible state means failure.
        """
        core = self._core
        t_ns, newest_frame_ns = core.imu_time(frame.t_ns), core.newest_ns  # both on the IMU's clock
        if t_ns <= newest_frame_ns:
            return
        if self._realigns(frame, t_ns):
            return
        is_blind = (t_ns - newest_frame_ns) * 1e-9 > _MAX_BLIND_S or not core.is_imu_complete
        if is_blind or self._restart_due_ns is not None:
            # `nav` may be later than the image, which can arrive after later IMU samples. An image from before the IMU
            # samples that are kept is skipped.
            if core.rewind_to(t_ns):
                core.start(frame, core.nav.covariance.copy())
                self._health = self._health_of_newest()
                self._restart_due_ns = None
            return
        core.process_image(frame, core.inertial.is_stationary(t_ns))
        self._misfit = max(self._misfit, float(core.inflation.factor.max()) / _CREDIBLE_INFLATION)
        if core.is_resting and self._clock is not None and not self._clock.is_settled:
            self._resting_state = copy_of(core.nav)
        self._health = self._health_of_newest()
        if not core.is_plausible:
            self._declare_lost()
        elif self._health == TRACKING and self._scale_due_ns is not None and t_ns >= self._scale_due_ns:
            self._correct_force_scale(frame)

    def _realigns(self, frame: CameraFrame, t_ns: int) -> bool:
        """Tries to align vision and IMU anew where the window fails; returns whether the image is used.

        A window whose points are lost finds no new ones while its velocity is uncertain: points of unknown depth move
        as they like. An alignment needs no velocity. Position and heading remain, with the uncertainty that they have.
        After a wrong clock the image also counts as used while a new window waits for the alignment.
        """
        core, waits = self._core, self._restart_due_ns is not None
        if not self._parameters.method.refines_all:
            return False
        if self._health != IMU_ONLY and not waits:
            self._initializer.reset()
            return False
        alignment = self._initializer.process_image(frame)
        nav = core.nav
        is_better = alignment is not None and (
            waits
            or float(alignment.covariance[range(2, 5), range(2, 5)].sum()) < float(np.trace(nav.covariance[6:9, 6:9]))
        )
        if alignment is not None and is_better and core.rewind_to(t_ns):
            nav = core.nav
            self._anchor = Anchor.at(nav.p, nav.R, self._pose_covariance())
            self._misfit, self._resting_state = 1.0, None
            core.start(frame, self._init_from_alignment(alignment, nav.R.copy()))
            self._initializer.reset()
            self._health, self._restart_due_ns = self._health_of_newest(), None
            self._scale_due_ns = t_ns + round(_SCALE_AFTER_S * 1e9)
            return True
        return self._restart_due_ns is not None and t_ns < self._restart_due_ns

    def _health_of_newest(self) -> str:
        """How the newest frame is held: by points in the image, by planes in the depth image, or by the IMU alone."""
        if self._core.is_tracking:
            return TRACKING
        return DEPTH_ONLY if self._core.is_held_by_depth else IMU_ONLY

    def _correct_force_scale(self, frame: CameraFrame) -> None:
        """Takes the part of the accelerometer's bias along gravity that is likelier an error of its scale as such.

        Once after a start in motion, as soon as images have measured that bias. A new window begins if it matters.
        """
        core, nav = self._core, self._core.nav
        up = nav.R[2]  # the world's z axis in the IMU's axes
        if float(up @ nav.covariance[12:, 12:] @ up) > _MAX_BIAS_SD_MPS2**2:  # 12-14: bias of the accelerometer
            return
        self._scale_due_ns = None
        error = core.correct_force_scale(float(nav.bias[3:] @ up))
        if error != 0.0:
            nav.bias[3:] -= error * self._parameters.gravity_mps2 * up
            core.return_to(nav)
            core.start(frame, nav.covariance.copy())

    def _corrects_clock(self, frame: CameraFrame) -> bool:
        """Compares an image with the gyroscope; returns whether it has shown that the camera's clock is wrong.

        The offset is then corrected, and the next image starts a new window. The state becomes that of the last rest
        with the IMU's motion since, because the images in between were used at wrong times; without a rest in the
        buffer it stays, less certain. The image itself is not used: its new time may be ahead of the IMU.
        """
        core, clock = self._core, self._clock
        if clock is None or clock.is_settled:
            return False
        clock.add_image(frame.t_ns, frame.grey, frame.depth if self._parameters.method.uses_depth else None)
        mount = core.window.calibration
        offset_s = float(mount.offset[0])
        resting = self._resting_state
        if resting is not None and not core.inertial.covers(int(resting.t_ns[0])):
            resting = None
        # a state at rest is right whatever the clock, so that there is time to know it well
        is_new = resting is None and (frame.t_ns - self._began_ns) * 1e-9 < _NEW_S
        is_new |= self._health not in _RUNNING
        corrected_s = clock.find_offset(core.inertial, mount.R, offset_s, core.first_offset_s, is_new)
        if corrected_s == offset_s:
            return False
        mount.offset[0] = core.first_offset_s = corrected_s
        self._initializer.reset()
        if self._health not in _RUNNING:
            return True
        now_ns = self._restart_due_ns = int(core.nav.t_ns[0])
        if resting is not None:
            core.return_to(resting)
        else:
            core.nav.covariance[:] += np.diag(np.repeat(_WRONG_CLOCK_SD, 3) ** 2)
            core.return_to(core.nav)
            self._restart_due_ns += round(_MAX_REALIGN_S * 1e9)
        core.propagate(now_ns)
        return True

    def _initialize(self, frame: CameraFrame) -> None:
        """Tries to start the odometry at an image, in one of three ways.

        - A stationary sensor starts at once, from the mean rate and force of the last `STATIONARY_S`.
        - A moving one starts once vision and IMU align (`Initializer`), from the result of the alignment.
        - If they have not aligned within `_MAX_ALIGN_S`, it starts from the mean force of the last `_MEAN_FORCE_S`; not
          after a failure, where a guess of the velocity fails again.

        After a start with enough points the health is `tracking`; otherwise the next image tries again.
        `_init_start_ns` is the time of the first try. Nothing happens if the IMU samples do not reach back to the
        image.
        """
        core, lost_state = self._core, copy_of(self._core.nav)
        t_ns = core.imu_time(frame.t_ns)
        if not core.inertial.covers(t_ns):
            return
        if self._init_start_ns is None:
            self._init_start_ns = t_ns
        self._scale_due_ns = t_ns + round(_SCALE_AFTER_S * 1e9)
        resting = core.inertial.is_stationary(t_ns)
        # the previous attitude at the time of the image, whose heading is kept after a failure
        before = None
        if self._health == LOST:
            before = lost_state.R @ core.rotation_between(t_ns, int(lost_state.t_ns[0])).T
        may_guess = self._health != LOST or not self._parameters.method.refines_all
        # The initializer needs every image of a moving sensor: it collects them until they align.
        if not resting and (alignment := self._initializer.process_image(frame)) is not None:
            covariance = self._init_from_alignment(alignment, before)
        elif resting or (may_guess and (t_ns - self._init_start_ns) * 1e-9 >= _MAX_ALIGN_S):
            averaged_s = STATIONARY_S if resting else _MEAN_FORCE_S
            samples = core.inertial.since(t_ns - round(averaged_s * 1e9), t_ns)  # (N, 6) rate and force
            if not len(samples):  # a gap in the IMU
                return
            covariance = self._init_from_gravity(samples.mean(axis=0), resting, before)
        else:  # moving, not aligned yet, and there is still time
            return
        core.nav.t_ns[0] = t_ns
        core.start(frame, covariance)
        self._initializer.reset()
        if core.is_tracking:
            if self._health == LOST:
                self._anchor = Anchor.at(lost_state.p, core.nav.R, lost_state.covariance[:6, :6])
            self._init_start_ns, self._health, self._began_ns = None, TRACKING, t_ns
        elif self._health == LOST:
            core.return_to(lost_state)

    def _init_from_gravity(self, mean: Array, resting: bool, before: Array | None) -> Array:
        """Sets attitude, velocity and biases of `nav` from the mean rate and force (6,) of recent samples.

        The force gives the vertical. The heading is 0 at a first start, and that of the attitude `before`, (3, 3) world
        <- IMU, after a failure. The velocity becomes 0, and if `resting`, the mean rate is the gyroscope's bias. The
        position stays.

        Returns:
            (15, 15) covariance of that state in its own world, whose origin and heading are exact.
        """
        nav = self._core.nav
        nav.R[:] = _attitude_from_gravity(mean[3:], before)
        if resting:
            self._core.correct_force_scale(float(np.linalg.norm(mean[3:])) - self._parameters.gravity_mps2)
            self._scale_due_ns = None
        nav.v[:] = 0.0
        if resting:
            nav.bias[:3] = mean[:3]
        tilt_sd = _RESTING_TILT_SD_RAD if resting else _MOVING_TILT_SD_RAD
        speed_sd = STATIONARY_SPEED_SD_MPS if resting else _MOVING_SPEED_SD_MPS
        return self._core.start_covariance(_START_SD**2 * np.eye(3), _START_SD, tilt_sd, speed_sd)

    def _init_from_alignment(self, alignment: Alignment, before: Array | None) -> Array:
        """Sets attitude, velocity and biases of `nav` from an alignment; the position of `nav` stays.

        The heading is 0 at a first start, and that of the attitude `before`, (3, 3) world <- IMU, afterwards.

        Returns:
            (15, 15) covariance of that state in its own world, whose origin and heading are exact.
        """
        nav = self._core.nav
        nav.R[:] = _attitude_from_gravity(alignment.up, before)
        # `v[-1]` is the velocity at the newest image, in the axes of the IMU there
        nav.v[:], nav.bias[:] = nav.R @ alignment.v[-1], alignment.bias
        return alignment.state_covariance(nav.R, _START_SD**2 * np.eye(3), _START_SD)

    def _declare_lost(self) -> None:
        """Declares a failure: the health becomes `lost` until a new start.

        `nav` becomes the pose that was known last, at rest without biases, with a large covariance. Waiting images and
        what the initializer has collected are dropped. If the odometry is lost already, its state stays.
        """
        nav, was_lost = self._core.nav, self._health == LOST
        self._health, self._init_start_ns = LOST, None
        self._resting_state, self._restart_due_ns = None, None
        self._images.clear()
        self._initializer.reset()
        if was_lost:
            # The position has become less certain since the failure; that must not be undone.
            return
        known = self._memory.find_last_known(int(nav.t_ns[0]), self._parameters.method.refines_all)
        nav.p[:], nav.R[:], nav.v[:], nav.bias[:] = known.p, known.R, 0.0, 0.0
        self._lost_ns = known.t_ns
        # `_LOST_SD` has a value per three axes of position, attitude, velocity and the two biases; 0-5 are the pose
        nav.covariance[:] = np.diag(np.repeat(_LOST_SD, 3) ** 2)
        nav.covariance[:6, :6] += known.covariance
        self._anchor, self._misfit = Anchor.exact(), 1.0


def _attitude_from_gravity(force: Array, before: Array | None) -> Array:
    """(3, 3) rotation, world <- IMU, at which a mean force in the IMU's axes points up.

    Args:
        force: (3,) mean specific force in the IMU's axes; only its direction counts.
        before: (3, 3) previous rotation, world <- IMU, whose heading is kept. If None, the world's x axis is the
            horizontal direction of the IMU's z axis (the camera's line of sight), or of its negative y axis if the
            camera looks straight down.
    """
    up = force / np.linalg.norm(force)
    # direction that becomes the world's x axis, in the IMU's axes; before[0] is the previous x axis of the world
    forward = np.array([0.0, 0.0, 1.0]) if before is None else before[0]
    if np.linalg.norm(np.cross(up, forward)) < 0.2:  # sine of the angle between them: nearly vertical
        forward = np.array([0.0, -1.0, 0.0])
    x = forward - up * (up @ forward)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])  # the rows are the world's axes in those of the IMU


def _choose_mount(rig: Rig, options: Options) -> str:
    """Mount of the camera: that of the options, else the first with a camera and an IMU.

    Raises:
        StrideTwinError: The rig has no such camera.
    """
    # an empty `options.mount` takes the first of these
    available_mounts = [m for m in MOUNTS if f"/{m}/color" in rig.cameras and f"/{m}/imu" in rig.imus]
    if not (options.mount or available_mounts):
        raise StrideTwinError(
            f"the rig cannot run dvio: needs {_WANTED}; it has {', '.join(rig.cameras) or 'no camera'}"
        )
    return options.mount or available_mounts[0]
