"""Whether a camera and the IMU on its body agree: clock, mount, focal length and lever arm, by their motion.

`check` looks at as many images as it needs; `estimate`, `import` and `score` at a few (`QUICK_SEGMENTS`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stridetwin.scenarios.camera_axes import find_rate_fault, find_up, is_upright
from stridetwin.scenarios.camera_clock import (
    CLOCK_OFFSET_S,
    CameraClock,
    GyroRates,
    angle_deg,
    estimate_clock,
    exchange_axes,
    moving_board,
)
from stridetwin.scenarios.camera_focal import FOCAL_OFF, FocalMultiple, estimate_focal, scale_focal
from stridetwin.scenarios.camera_lever import LEVER_OFF_M, LeverArm, estimate_lever
from stridetwin.scenarios.camera_motion import build_parts, prepare_parts
from stridetwin.scenarios.image_rotation import PairTracks, Rates, list_rates, track_segment
from stridetwin.streams.recording.imported import IMPORTED_FROM
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array, Block, Image, Imu

_SEGMENT_IMAGES, _BATCH, _MOST_SEGMENTS = 45, 3, 12
"""Images of a segment, segments that are read at a time, and most segments of one recording."""
QUICK_SEGMENTS = 6
"""Most segments of the quick look that precedes an estimate. Where the head turns, the first batch is enough, which is
two to three seconds of work."""
_NEAR_AXES_DEG = 12.0
"""A mount this close to one whose axes are exchanged counts as that."""
_OTHER_LENSES = (0.75, 1.35)
"""Multiples of the focal length that are tried where the calibrated one shows no clock."""
_OFF_CENTRE, _SAME_LENS = 0.1, 0.1
"""Share by which the centre of a lens may be off the middle of its images, and by which a focal length may differ from
that of images of another size to count as the same lens."""
_GOLDEN = 0.618034  # multiples of the golden ratio are spread evenly, however many there are
_SPOILING_OFFSET_S = 0.02
"""Offset of the clocks beyond which an odometry does not find it by itself, s: four times what `dvio` assumes."""
_HALF_READOUT_S = 0.0167
"""Half of the longest usual readout, the period of 30 images a second, s."""
_LARGEST_CORRECTION_S = 1.0
"""Largest shift that a calibration file may have, s."""


@dataclass(frozen=True, kw_only=True)
class CameraFault:
    """An error of a camera's calibration or stamps that the motion shows.

    Attributes:
        text: What was seen, what is expected, the likely cause and what mends it.
        spoils: Whether it is more than an odometry mends by itself.
        is_certain: Whether nothing else explains it.
    """

    text: str
    spoils: bool
    is_certain: bool = True


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraFit:
    """What the motion says about a camera and its IMU.

    Attributes:
        camera: Its calibration.
        R_cam_imu: (3, 3) its calibrated rotation, which takes the IMU's axes into the camera's optical ones.
        rate_fault: What is wrong with the rates of its IMU, by the images; "" for nothing.
        up: (3,) direction of up in the camera's axes by the forces of its IMU; None without gravity.
        clock: Its clock and mount; None where the two rotations have no clear common peak.
        focal: Its focal length; None where the rotation does not show it.
        lever: Its lever arm; None without depth, or where clock, mount or focal length are wrong.
        spans_s: First and last stamp of the images, and of the IMU, s, each by its own clock.
        is_imported: Whether the calibration is another tool's, which rarely knows the readout of the shutter.
    """

    camera: CameraCalibration
    R_cam_imu: Array
    rate_fault: str
    up: Array | None
    clock: CameraClock | None
    focal: FocalMultiple | None
    lever: LeverArm | None
    spans_s: tuple[tuple[float, float], tuple[float, float]]
    is_imported: bool

    @property
    def overlaps(self) -> bool:
        """Whether images and IMU share any time, with the calibrated shift."""
        (first, last), (imu_first, imu_last) = self.spans_s
        shift = self.camera.timeshift_cam_imu_s
        return first + shift <= imu_last and last + shift >= imu_first

    def list_faults(self) -> Iterator[CameraFault]:
        """Yields each error of the calibration or the stamps that the motion shows."""
        if not self.overlaps:
            yield CameraFault(text=self._describe_spans(), spoils=True)
        clock = self.clock
        if self.rate_fault:
            yield CameraFault(text=self.rate_fault, spoils=True)
            return
        if clock is None:
            return
        if clock.mount_off_deg:
            yield CameraFault(text=self._describe_turn(clock), spoils=True)
        elif self.up is not None and not is_upright(self.camera, self.up):
            yield CameraFault(text=self._describe_up(self.up), spoils=False, is_certain=False)
        if clock.is_off and self.overlaps:
            spoils = abs(clock.unexplained_s) - clock.half_s > _SPOILING_OFFSET_S
            # an unknown readout of a rolling shutter looks like half of it, and an odometry finds as much by itself
            is_rolling = self.is_imported and not self.camera.readout_s and abs(clock.unexplained_s) < _HALF_READOUT_S
            if not is_rolling:
                yield CameraFault(text=self._describe_clock(clock), spoils=spoils)
        if self.focal is not None and self.focal.is_off:
            yield CameraFault(text=self._describe_focal(self.focal), spoils=True)
        if self.lever is not None and self.lever.is_off:
            yield CameraFault(text=self._describe_lever(self.lever), spoils=False)

    def _describe_turn(self, clock: CameraClock) -> str:
        """The sentence about a rotation that differs from the calibrated one: of the mount, or of the rates alone."""
        up, camera = self.up, self.camera
        if up is None or not is_upright(camera, up) or is_upright(camera, clock.turn @ up):
            return self._describe_mount(clock)
        return (
            f"its images turn as {clock.imu} measures only if the rates of that are turned by "
            f"{clock.mount_off_deg:.0f}°, and then the camera is not upright, which it is as calibrated by the forces: "
            "probably the axes of the rates are others than those of the forces"
        )

    def _describe_up(self, up: Array) -> str:
        """The sentence about a camera that is not upright, (3,) up in its axes."""
        x, y, z = up
        return (
            f"up is ({x:.1f}, {y:.1f}, {z:.1f}) in its axes by the forces of {self.camera.imu_topic}: expected about "
            "(0, -1, 0) of a worn camera, whose y points down; does it lie on its side, or have the forces other axes "
            "than the rates?"
        )

    def _describe_mount(self, clock: CameraClock) -> str:
        """The sentence about a wrong rotation on the IMU."""
        return (
            f"its mount differs by {clock.mount_off_deg:.0f}° from the calibration of it and {clock.imu}: "
            f"only then do their rotation rates agree (correlation {clock.correlation:.2f}); "
            f"{describe_turn(clock.turn, self.R_cam_imu)}"
        )

    def _describe_lever(self, lever: LeverArm) -> str:
        """The sentence about a wrong place on the IMU."""
        calibrated = ", ".join(f"{value:.2f}" for value in lever.calibrated)
        return (
            f"its place on {self.camera.imu_topic} is ({calibrated}) m in the calibration, by their motion "
            f"{lever.text}: expected the same within {LEVER_OFF_M:g} m; "
            "is the translation of T_cam_imu in another unit, or that of the inverse? --rig FILE corrects it"
        )

    def _describe_spans(self) -> str:
        """The sentence about images and an IMU that share no time."""
        (first, last), (imu_first, imu_last) = self.spans_s
        text = (
            f"its images are from {first:.3f} to {last:.3f} s, {self.camera.imu_topic} from {imu_first:.3f} to "
            f"{imu_last:.3f} s: expected stamps of one clock"
        )
        if self.clock is None:
            return text
        return f"{text}; their rotation rates agree if {self.clock.shift_s:.3f} s are added to the stamps of the images"

    @staticmethod
    def _describe_clock(clock: CameraClock) -> str:
        """The sentence about stamps that differ from those of the IMU."""
        text = (
            f"its clock differs by {clock.shift_s * 1e3:+.1f} ± {clock.half_s * 1e3:.1f} ms from that of {clock.imu}, "
            f"in the calibration by {clock.calibrated_s * 1e3:+.1f} ms (t_imu = t_cam + shift)"
        )
        if abs(clock.shift_s) <= _LARGEST_CORRECTION_S:
            return f"{text}; timeshift_cam_imu: {clock.shift_s:.4f} in --rig FILE corrects it"
        return f"{text}; add {clock.shift_s:.3f} s to the stamps of its images"

    def _describe_focal(self, focal: FocalMultiple) -> str:
        """The sentence about a focal length that does not fit the rotation."""
        fu, fv, *_ = self.camera.intrinsics
        text = (
            f"its images turn by {focal.ratio:.2f} ± {focal.half:.2f} times what {self.camera.imu_topic} measures: "
            f"expected 1 ± {FOCAL_OFF:g}; "
        )
        if focal.is_gyro_off:
            return f"{text}probably the rates of {self.camera.imu_topic} are {1 / focal.roll:.2f} times too large"
        fitting = f"{focal.ratio * fu:.0f}, {focal.ratio * fv:.0f} px"
        return (
            f"{text}focal lengths of about {fitting} would fit, where the calibration has {fu:.0f}, {fv:.0f}; "
            "are the intrinsics of another resolution or camera? --rig FILE corrects them"
        )


def list_cameras_beside_imus(recording: Recording) -> Iterator[tuple[CameraCalibration, str]]:
    """Yields each recorded camera with a recorded IMU on its body, and why its images do not show how that turns.

    The reason is "" for a camera that `fit_camera` can compare with its IMU.
    """
    topics = recording.topics
    for camera in recording.rig.cameras.values() if recording.has_rig else ():
        has_imu = camera.imu_topic in topics and topics[camera.imu_topic].kind is Imu
        if camera.topic not in topics or not has_imu:
            continue
        reason = ""
        if (board := moving_board(recording.rig, camera)) is not None:
            reason = f"its images show the board of {board.mount.body}, which moves"
        elif topics[camera.topic].kind is not Image:
            reason = "depth images alone do not show how it turns"
        yield camera, reason


def fit_camera(
    recording: Recording, camera: CameraCalibration, imu: Block[Imu], most_segments: int = _MOST_SEGMENTS
) -> CameraFit:
    """Compares a camera with the IMU on its body.

    Segments of images are read in batches, those with the most varied rotation first, until the offset of the clocks
    is certainly above or below `CLOCK_OFFSET_S`, and the focal length certainly right or wrong. Intrinsics that look
    like those of images of another size are compared at the size of the images, if the motion agrees with that.

    Args:
        recording: Recording with the images.
        camera: Calibration of the camera.
        imu: All samples of the IMU.
        most_segments: Most segments that are read.

    Returns:
        What is known; parts of it are None where the motion does not show them.
    """
    T_imu_cam = np.linalg.inv(recording.rig.imu(camera.imu_topic).mount.T_body_sensor) @ camera.mount.T_body_sensor
    gyro = GyroRates.of(imu, T_imu_cam[:3, :3].T)
    images = recording.image_times(camera.topic)
    starts = _sort_segments(images + round(camera.timeshift_cam_imu_s * 1e9), gyro)[:most_segments]
    comparison = _Comparison(camera=camera, T_imu_cam=T_imu_cam, imu=imu, gyro=gyro)
    segments, rates = list[list[PairTracks]](), list[Rates]()
    for start in range(0, len(starts), _BATCH):
        batch = [track_segment(recording, camera, first, _SEGMENT_IMAGES) for first in starts[start : start + _BATCH]]
        segments += batch
        rates += list_rates(camera, batch)
        clock, focal = comparison.find_clock_and_focal(
            segments, rates, tries_other_lenses=start + _BATCH >= len(starts)
        )
        is_clear = clock is not None and abs(abs(clock.unexplained_s) - CLOCK_OFFSET_S) > clock.half_s
        if is_clear and focal is not None and focal.is_certain:
            break
    rate_fault = find_rate_fault(camera, gyro, rates, clock) if rates else ""
    lever = None
    if clock is not None and not rate_fault and not clock.mount_off_deg and focal is not None and not focal.is_off:
        lever = comparison.find_lever(segments, clock)
    spans = tuple((int(t[0]) * 1e-9, int(t[-1]) * 1e-9) for t in (images, imu.t_ns))
    return CameraFit(
        camera=camera,
        R_cam_imu=T_imu_cam[:3, :3].T,
        rate_fault=rate_fault,
        up=find_up(imu, T_imu_cam[:3, :3].T),
        clock=clock,
        focal=focal,
        lever=lever,
        spans_s=(spans[0], spans[1]),
        is_imported=IMPORTED_FROM in recording.metadata,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Comparison:
    """A camera and the IMU on its body, which are compared by the tracks of segments of images.

    Attributes:
        camera: Calibration of the camera.
        T_imu_cam: (4, 4) its calibrated pose on the IMU.
        imu: All samples of the IMU.
        gyro: Rates of its gyro in the camera's nominal axes.
    """

    camera: CameraCalibration
    T_imu_cam: Array
    imu: Block[Imu]
    gyro: GyroRates

    def find_clock_and_focal(
        self, segments: Sequence[Sequence[PairTracks]], rates: Sequence[Rates], *, tries_other_lenses: bool
    ) -> tuple[CameraClock | None, FocalMultiple | None]:
        """Clock and focal length by the tracks of some segments.

        Args:
            segments: The tracks of each segment.
            rates: Their rates with the calibrated lens.
            tries_other_lenses: Whether other focal lengths are tried where the calibrated one shows no clock.

        Returns:
            Clock and mount, and focal length in multiples of the calibrated one; each None where it does not show.
        """
        size = _guess_image_size(self.camera)
        if size != 1.0:
            resized = _resize(self.camera, size)
            clock, focal = self._find_with_lens(resized, segments, list_rates(resized, segments))
            if focal is not None and abs(focal.ratio - 1) < _SAME_LENS:
                return clock, focal.multiply(size)
        clock, focal = self._find_with_lens(self.camera, segments, rates)
        for factor in _OTHER_LENSES if clock is None and tries_other_lenses else ():
            scaled = scale_focal(self.camera, factor)
            clock, focal = self._find_with_lens(scaled, segments, list_rates(scaled, segments))
            if clock is not None:
                return clock, None if focal is None else focal.multiply(factor)
        return clock, focal

    def find_lever(self, segments: Sequence[Sequence[PairTracks]], clock: CameraClock) -> LeverArm | None:
        """The lever arm by the tracks of some segments, where clock, mount and lens are right; None without depth."""
        parts = build_parts(self.camera, list(prepare_parts(self.T_imu_cam[:3, :3], self.imu, segments, clock.shift_s)))
        depths = [tracks.median_depth for segment in segments for tracks in segment]
        depth_m = float(np.nanmedian(depths)) if parts else 0.0
        return estimate_lever(parts, self.T_imu_cam, depth_m, self.camera.readout_s)

    def _find_with_lens(
        self, camera: CameraCalibration, segments: Sequence[Sequence[PairTracks]], rates: Sequence[Rates]
    ) -> tuple[CameraClock | None, FocalMultiple | None]:
        """Clock, and focal length in multiples of that of `camera`, which has another calibration of the lens.

        Both are None where the rotations of images and gyro do not agree.
        """
        clock = estimate_clock(camera, self.gyro, rates)
        if clock is None:
            return None, None
        return clock, estimate_focal(camera, self.T_imu_cam, self.imu, self.gyro, segments, rates, clock)


def _guess_image_size(camera: CameraCalibration) -> float:
    """By what intrinsics have to be multiplied if they are of images of another size; 1 where nothing says so.

    The centre of a lens is near the middle of its images.
    """
    _, _, pu, pv = camera.intrinsics
    across, down = camera.width / (2 * pu + 1), camera.height / (2 * pv + 1)
    is_other = abs(across - 1) > _OFF_CENTRE and abs(across / down - 1) < _OFF_CENTRE and across > 0
    return math.sqrt(across * down) if is_other else 1.0


def _resize(camera: CameraCalibration, factor: float) -> CameraCalibration:
    """The camera with intrinsics for images that are `factor` times as large; its width and height stay."""
    fu, fv, pu, pv = camera.intrinsics
    # 0.5 moves from the centre of a pixel to its corner and back
    centre = (factor * (pu + 0.5) - 0.5, factor * (pv + 0.5) - 0.5)
    return replace(camera, intrinsics=(factor * fu, factor * fv, *centre))


def describe_turn(turn: Array, R_cam_imu: Array) -> str:
    """The likely mistake behind a wrong mount, and the rotation that fits.

    Args:
        turn: (3, 3) rotation that maps the camera's nominal axes to its true ones.
        R_cam_imu: (3, 3) calibrated rotation, which takes the IMU's axes into the camera's.

    Returns:
        A clause of a message, without a full stop.
    """
    fitting = turn @ R_cam_imu
    axes, off_deg = _find_nearest_axes(turn)
    if angle_deg(fitting @ R_cam_imu) < _NEAR_AXES_DEG and angle_deg(R_cam_imu @ R_cam_imu) > _NEAR_AXES_DEG:
        cause = "T_cam_imu is inverted"
    elif off_deg > _NEAR_AXES_DEG:
        cause = "T_cam_imu is of another camera or mount"
    elif np.array_equal(axes, np.eye(3)):
        return f"probably T_cam_imu is not exact; its rotation that fits is {fitting.round(3).tolist()}, for --rig FILE"
    elif (angle := round(angle_deg(axes))) in (90, 180) and (np.diag(axes) == 1).any():
        cause = f"the camera is turned by {angle}° about its {'xyz'[int(np.argmax(np.diag(axes)))]} axis"
    else:
        names = [f"{'-' if row.sum() < 0 else ''}{'xyz'[int(np.argmax(np.abs(row)))]}" for row in axes]
        cause = f"its axes x, y, z are {', '.join(names)} of the calibrated camera"
    whole, whole_off_deg = _find_nearest_axes(fitting)
    shown = whole.astype(int).tolist() if whole_off_deg < _NEAR_AXES_DEG else fitting.round(2).tolist()
    return f"probably {cause}; the rotation of T_cam_imu that fits is {shown}, for --rig FILE"


def _find_nearest_axes(R: Array) -> tuple[Array, float]:
    """The rotation (3, 3) of exchanged axes, with entries 0, 1 and -1, nearest to R (3, 3), and their angle, deg."""
    best = min(exchange_axes(), key=lambda axes: angle_deg(R @ axes.T))
    return best, angle_deg(R @ best.T)


def _sort_segments(images: NDArray[np.int64], gyro: GyroRates) -> list[int]:
    """Numbers of the first images of all segments, sorted by how much the rotation rate varies in them, most first.

    The measure is the sum of the standard deviations of the three axes. Without any rate during the images, the
    segments are spread over the recording.

    Args:
        images: (N,) stamps of the images by the clock of the gyro, ns.
        gyro: Rates of the gyro.
    """
    # segments that a further image follows; the rest at the end is left out, unless it is the only one
    starts = range(0, max(1, len(images) - _SEGMENT_IMAGES), _SEGMENT_IMAGES)
    spread: list[float] = []
    for start in starts:
        first, last = images[start], images[min(start + _SEGMENT_IMAGES, len(images) - 1)]
        segment_rate = gyro.rate[(gyro.t_ns >= first) & (gyro.t_ns <= last)]
        spread.append(float(segment_rate.std(axis=0).sum()) if len(segment_rate) > 1 else 0.0)
    if not any(spread):
        return sorted(starts, key=lambda first: first / _SEGMENT_IMAGES * _GOLDEN % 1)
    return [starts[int(i)] for i in np.argsort(spread, kind="stable")[::-1]]
