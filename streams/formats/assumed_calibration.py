"""Default calibrations of an import for sensors without one; each default is reported by a warning."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from stridetwin.streams.calibration_limits import FARTHEST_M, suggest_unit
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2
from stridetwin.streams.plausible import mean_rate
from stridetwin.streams.recording.imported import ImageStream
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Block, Depth, Image, Imu, Sample, Stamps
from stridetwin.streams.segments import segment_of

BODY = "head"
"""Body of a sensor whose topic does not imply another one."""
_PLACES = (BODY, "exo", "truth")
"""Beginnings of our own topics whose sensors are on the head or have a calibration that knows their body."""
GIVE = "give one with --rig FILE (Kalibr YAML)"
"""What a warning of an assumed calibration recommends."""
# Bosch BMI055, a common consumer part: 0.014 °/s/√Hz and 150 µg/√Hz; biases that vary by their in-run instability
# (10 °/h, 40 µg) in 100 s
_GYRO_NOISE = math.radians(0.014)
_GYRO_WALK = math.radians(10 / 3600) / 10
_ACCEL_NOISE = 150e-6 * STANDARD_GRAVITY_MPS2
_ACCEL_WALK = 40e-6 * STANDARD_GRAVITY_MPS2 / 10
_OFF_CENTRE, _SAME_SCALE = 0.24, 0.05
"""Share of half an image by which the centre of a lens may be off, and by which the two axes of another resolution may
differ. Centres of public RGB-D and stereo cameras are within 12 %."""
_DEVICE_M = 0.25
"""Largest distance of camera and IMU on one head or chest unit, m: from a brow to the back of a head."""
_FOCAL_PER_WIDTH = 525.0 / 640.0  # the first Kinect's, used by RGB-D datasets without a calibration


def with_assumed_calibration(
    rig: Rig,
    blocks: Mapping[str, Block[Sample]],
    images: Mapping[str, ImageStream],
    notes: Notes,
    registered: Collection[str] = (),
) -> Rig:
    """Completes a rig, so that every IMU and camera of an import has a calibration, and no other sensor has one.

    A missing calibration is replaced by that of a consumer part (IMU) or of a pinhole with the focal length of the
    first Kinect (camera), at the origin of the body that the topic implies. A warning reports each assumption.

    Args:
        rig: Known calibrations, by topic.
        blocks: Small streams by topic.
        images: Image streams by topic.
        notes: Collects the warnings.
        registered: Topics of depth that is known to be registered to colour.

    Returns:
        The calibrations of the streams in `blocks` and `images`. A depth stream belongs to the colour camera that it is
        registered to, or is a camera of its own.

    Raises:
        ConfigError: The images of a camera have another size than its calibration, unless lenient.
    """
    imus = {
        topic: _add_rate(rig.imus[topic], block.t_ns) if topic in rig.imus else _assume_imu(topic, block.t_ns, notes)
        for topic, block in blocks.items()
        if block.kind is Imu
    }
    colour_topics = [topic for topic, stream in images.items() if stream.kind is Image]
    depth_topics = [topic for topic, stream in images.items() if stream.kind is Depth]
    cameras = {topic: _camera_or_default(rig, topic, images[topic], notes) for topic in colour_topics}
    for topic in depth_topics:
        if not any(c.depth_topic == topic for c in cameras.values()):  # no camera refers to it
            _add_depth(rig, cameras, topic, images, notes, topic in registered)
    cameras = {topic: _drop_missing_references(camera, imus, images) for topic, camera in cameras.items()}
    for camera in cameras.values():
        _check_intrinsics(camera, notes)
        _check_distance(camera, imus, notes)
    others = {topic: sensor for topic, sensor in rig.others.items() if topic in blocks}
    return Rig(imus=imus, cameras=cameras, boards=rig.boards, others=others)


def body_of(topic: str) -> str:
    """Body that carries the sensor of a topic.

    Returns:
        `foot_l` of `/foot_l/imu`, the torso of `/chest/...`, the head of `/head/...` and of topics that tell no part of
        the body, and the part itself of others, such as `pelvis` of `/xsens/pelvis/imu`.
    """
    first = topic.strip("/").split("/")[0]
    if first == "chest":
        return "torso"
    if first.startswith("foot_"):
        return first
    segment = BODY if first in _PLACES else segment_of(topic)
    return segment if segment not in ("", "chest", "foot") and not segment.startswith("foot_") else BODY


def read_first_image_size(images: ImageStream) -> tuple[int, int] | None:
    """(width, height) of the first image, None if it cannot be read."""
    try:
        first = images.load("", 0)  # its topic does not matter
    except (StrideTwinError, ValueError, IndexError):
        return None
    shape = first.depth.shape if isinstance(first, Depth) else first.pixels.shape
    return shape[1], shape[0]


def _add_rate(imu: ImuCalibration, t_ns: Stamps) -> ImuCalibration:
    """The calibration, with the mean rate of the stamps (N,) ns if it has none; the rate of one sample is not valid."""
    return imu if imu.rate_hz else replace(imu, rate_hz=mean_rate(t_ns) or 1.0)


def _assume_imu(topic: str, t_ns: Stamps, notes: Notes) -> ImuCalibration:
    """A consumer IMU at the origin of the body that the topic implies, at the mean rate of its stamps (N,) ns."""
    notes.warn(
        f"{topic}: no calibration; assumed the noise of a consumer IMU ({math.degrees(_GYRO_NOISE):.3g} °/s/√Hz, "
        f"{_ACCEL_NOISE:.2g} m/s²/√Hz) at the origin of {body_of(topic)}; {GIVE}"
    )
    return ImuCalibration(
        topic=topic,
        part="",
        rate_hz=mean_rate(t_ns) or 1.0,  # the rate of one sample is 0, and not valid
        mount=Mount(body=body_of(topic)),
        gyroscope_noise_density=_GYRO_NOISE,
        gyroscope_random_walk=_GYRO_WALK,
        accelerometer_noise_density=_ACCEL_NOISE,
        accelerometer_random_walk=_ACCEL_WALK,
    )


def _camera_or_default(rig: Rig, topic: str, images: ImageStream, notes: Notes) -> CameraCalibration:
    """The known calibration of a camera after a check of the image size, or an assumed one without distortion.

    Args:
        rig: Known calibrations.
        topic: Topic of the camera.
        images: Its images, the first of which gives the size.
        notes: Collects the assumption, or an error if the calibration is for images of another size.
    """
    size = read_first_image_size(images)
    if topic not in rig.cameras:
        return _assume_camera(topic, images, size or (640, 480), notes)  # any size, if the first image is damaged
    camera = rig.cameras[topic]
    if size is not None and size != (camera.width, camera.height):
        expected = f"{camera.width} x {camera.height}"
        notes.add_error(
            ConfigError(notes.path, f"{topic}, size", f"{size[0]} x {size[1]}", f"{expected}, as calibrated")
        )
    return camera


def _assume_camera(topic: str, images: ImageStream, size: tuple[int, int], notes: Notes) -> CameraCalibration:
    """A pinhole whose focal length is 525/640 of the image width, with its centre in the middle of the image."""
    width, height = size
    focal = _FOCAL_PER_WIDTH * width
    notes.warn(f"{topic}: no calibration; assumed a pinhole of focal length {focal:.0f} px, {GIVE}")
    return make_pinhole(topic, size, (focal, focal, (width - 1) / 2, (height - 1) / 2), mean_rate(images.t_ns))


def make_pinhole(
    topic: str, size: tuple[int, int], intrinsics: tuple[float, float, float, float], rate_hz: float, depth: str = ""
) -> CameraCalibration:
    """A camera without distortion at the origin of the body that its topic implies.

    Args:
        topic: Topic of its images.
        size: (width, height) in pixels.
        intrinsics: (fu, fv, pu, pv) in pixels.
        rate_hz: Rate of its images.
        depth: Topic of the depth that is registered to it; "" without one.
    """
    return CameraCalibration(
        topic=topic,
        part="",
        rate_hz=rate_hz,
        mount=Mount(body=body_of(topic)),
        width=size[0],
        height=size[1],
        intrinsics=intrinsics,
        depth_topic=depth,
    )


def _check_intrinsics(camera: CameraCalibration, notes: Notes) -> None:
    """Warns of a focal length or a principal point that no usual lens has for images of the camera's size."""
    fu, fv, pu, pv = camera.intrinsics
    is_lens = 0.2 < fu / camera.width < 5 and 0.5 < fu / fv < 2
    # the centre in multiples of the middle of the image
    across, down = (2 * pu + 1) / camera.width, (2 * pv + 1) / camera.height
    is_central = abs(across - 1) < _OFF_CENTRE and abs(down - 1) < _OFF_CENTRE
    if is_lens and is_central:
        return
    hint = ""
    if not is_central and abs(across - down) < _SAME_SCALE * across:
        hint = f"; are they of images of {round(2 * pu + 1)} x {round(2 * pv + 1)}? Multiply them by {1 / across:.3g}"
    size = f"{camera.width} x {camera.height}"
    notes.warn(f"{camera.topic}: intrinsics {fu:g} {fv:g} {pu:g} {pv:g} are unusual for images of {size}{hint}")


def _check_distance(camera: CameraCalibration, imus: Mapping[str, ImuCalibration], notes: Notes) -> None:
    """Warns of a camera that is farther from its IMU than a person could wear them, as a wrong unit causes."""
    imu = imus.get(camera.imu_topic)
    if imu is None or imu.mount.body != camera.mount.body:
        return
    distance = float(np.linalg.norm(camera.mount.T_body_sensor[:3, 3] - imu.mount.T_body_sensor[:3, 3]))
    if distance > FARTHEST_M:
        expected = f"up to {FARTHEST_M:g} m; {suggest_unit(distance)}"
    elif distance > _DEVICE_M:
        expected = f"up to {_DEVICE_M:g} m on one device; is the translation of T_cam_imu in another unit?"
    else:
        return
    notes.warn(f"{camera.topic}: {distance:.3g} m from {camera.imu_topic}: expected {expected}")


def _add_depth(
    rig: Rig,
    cameras: dict[str, CameraCalibration],
    topic: str,
    images: Mapping[str, ImageStream],
    notes: Notes,
    is_registered: bool,
) -> None:
    """Adds a depth stream to `cameras`: to the colour camera that it is registered to, or as a camera of its own.

    A stream counts as registered if the rig says so, if `is_registered`, or if the colour images have its size and its
    intrinsics do not differ from theirs; the last is reported as an assumption if its intrinsics are unknown.

    Args:
        rig: Known calibrations.
        cameras: Calibrations of the import's cameras by topic, changed.
        topic: Topic of the depth stream.
        images: Image streams by topic.
        notes: Collects assumptions.
        is_registered: Whether the depth is known to be registered to colour.
    """
    registered_camera = next((c for c in rig.cameras.values() if c.depth_topic == topic), None)
    if registered_camera is not None:  # a camera whose colour was not recorded
        cameras[registered_camera.topic] = _camera_or_default(rig, registered_camera.topic, images[topic], notes)
        return
    size = read_first_image_size(images[topic])
    depth_camera = rig.cameras.get(topic)  # the depth stream's own calibration; None if it is unknown
    for name, camera in cameras.items():
        may_match = is_registered or depth_camera is None or np.allclose(depth_camera.intrinsics, camera.intrinsics)
        if not camera.depth_topic and size == (camera.width, camera.height) and may_match:
            if depth_camera is None and not is_registered:
                notes.warn(f"{topic}: assumed registered to {name} because of its size; {GIVE}")
            cameras[name] = replace(camera, depth_topic=topic)
            return
    if cameras:
        notes.warn(f"{topic}: not registered to a colour image; it becomes a separate camera")
    camera = depth_camera or _assume_camera(topic, images[topic], size or (640, 480), notes)
    cameras[topic] = replace(camera, topic=topic, depth_topic=topic)


def _drop_missing_references(
    camera: CameraCalibration, imus: Mapping[str, ImuCalibration], images: Mapping[str, ImageStream]
) -> CameraCalibration:
    """A camera without references to streams that are missing, and with an IMU of its own body if there is one."""
    on_body = [t for t, imu in imus.items() if imu.mount.body == camera.mount.body]
    imu = camera.imu_topic if camera.imu_topic in on_body else (on_body[0] if on_body else "")
    depth = camera.depth_topic if camera.depth_topic in images else ""
    return replace(camera, imu_topic=imu, depth_topic=depth)
