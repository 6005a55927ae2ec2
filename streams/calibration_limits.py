"""Limits of a calibration: values that no sensor has which a person wears are mistakes, mostly of a unit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount
from stridetwin.streams.samples import Array

FARTHEST_M = 1.0
"""Largest distance between a camera and its IMU, or between two IMUs of one calibration."""
_FARTHEST_MOUNT_M = 2.0
"""Largest distance of a sensor from the origin of the body that carries it."""
_LARGEST_SHIFT_S = 1.0
"""Largest plausible shift between the clocks of a camera and its IMU, s."""
_LONGEST_READOUT_S = 0.2
"""Longest plausible read-out of an image, s: at 5 images per second, one follows the other."""
_FOCAL_PER_WIDTH = (0.05, 20.0)
"""Least and largest focal length of any lens, in widths of the image."""
_ASPECT = (0.5, 2.0)
"""Least and largest ratio of the two focal lengths."""
_SQUARE, _MIDDLE = 0.1, 0.15
"""Pixels are so nearly square, and centres of lenses so near to that of the image, as a share of its size."""
_RATES_HZ = (1.0, 20_000.0)
"""Least and largest plausible rate of an IMU in a calibration, Hz."""
_NOISE = {
    "gyroscope_noise_density": (1e-8, 0.5, "rad/s/√Hz", 0.0174533, "°/s/√Hz"),
    "gyroscope_random_walk": (1e-12, 0.1, "rad/s²/√Hz", 0.0174533, "°/s²/√Hz"),
    "accelerometer_noise_density": (1e-7, 5.0, "m/s²/√Hz", 9.80665e-6, "µg/√Hz"),
    "accelerometer_random_walk": (1e-12, 2.0, "m/s³/√Hz", 9.80665e-6, "µg/s/√Hz"),
}
"""Least and largest plausible noise besides 0, its unit, and a common other unit with its factor."""


def suggest_unit(distance_m: float) -> str:
    """The unit in which a distance that is too large would be plausible, as a question."""
    return "is it in mm?" if distance_m > 10 * FARTHEST_M else "is it in cm or mm?"


def check_camera(
    source: str, name: str, camera: CameraCalibration, transforms: Mapping[str, Array]
) -> Iterator[ConfigError]:
    """Yields an error for each value of a camera that is beyond what a person can wear.

    Args:
        source: Names the file.
        name: Name of the section.
        camera: The calibration.
        transforms: Transforms (4, 4) of its section by key, m.
    """
    for key, T in transforms.items():
        whence = "its IMU" if "imu" in key else "the camera before it"
        yield from _check_distance(source, f"{name}.{key}", T, FARTHEST_M, "a camera", whence)
    shift = camera.timeshift_cam_imu_s
    if abs(shift) > _LARGEST_SHIFT_S:
        unit = "ms" if abs(shift) < 1e3 else "ns, or the difference of two clocks"
        valid = f"a shift in s, up to {_LARGEST_SHIFT_S:g}; is it in {unit}?"
        yield ConfigError(source, f"{name}.timeshift_cam_imu", shift, valid)
    if camera.readout_s > _LONGEST_READOUT_S:
        valid = f"a read-out of the image in s, up to {_LONGEST_READOUT_S:g}; is it in ms?"
        yield ConfigError(source, f"{name}.readout_s", camera.readout_s, valid)
    yield from _check_lens(source, f"{name}.intrinsics", camera)


def _check_lens(source: str, path: str, camera: CameraCalibration) -> Iterator[ConfigError]:
    """Yields an error for a focal length or a centre that no lens has for images of the camera's size."""
    fu, fv, pu, pv = camera.intrinsics
    least, largest = _FOCAL_PER_WIDTH
    size = f"{camera.width} x {camera.height}"
    if not least * camera.width <= fu <= largest * camera.width:
        unit = "mm, or in widths of the image" if fu < camera.width else "thousandths of a pixel"
        limits = f"{least * camera.width:.3g} to {largest * camera.width:.3g} px"
        valid = f"a focal length of {limits} for images of {size}; is it in {unit}?"
        yield ConfigError(source, path, list(camera.intrinsics), valid)
    elif not _ASPECT[0] <= fu / fv <= _ASPECT[1]:
        valid = "two focal lengths that differ by less than a factor of 2, then the centre: fu, fv, pu, pv"
        yield ConfigError(source, path, list(camera.intrinsics), valid)
    elif abs(fu / fv - 1.0) > _SQUARE and abs(pu / fu - 1.0) < _SQUARE and _is_middle(fv, pv, camera):
        valid = "the order fu, fv, pu, pv; these look like fu, pu, fv, pv"
        yield ConfigError(source, path, list(camera.intrinsics), valid)
    elif not (-0.5 <= pu / camera.width <= 1.5 and -0.5 <= pv / camera.height <= 1.5):
        valid = f"a centre in images of {size}; are the intrinsics of another resolution, or in another order?"
        yield ConfigError(source, path, list(camera.intrinsics), valid)


def _is_middle(u: float, v: float, camera: CameraCalibration) -> bool:
    """Whether a pixel is near the middle of a camera's images."""
    return all(abs(x / size - 0.5) < _MIDDLE for x, size in ((u, camera.width), (v, camera.height)))


def check_imu(source: str, name: str, imu: ImuCalibration) -> Iterator[ConfigError]:
    """Yields an error for each value of an IMU that no sensor has; 0 stands for unknown and passes.

    Args:
        source: Names the file.
        name: Name of the section.
        imu: The calibration.
    """
    least_hz, largest_hz = _RATES_HZ
    if imu.rate_hz and not least_hz <= imu.rate_hz <= largest_hz:
        hint = "; is it a period in s?" if imu.rate_hz < least_hz else ""
        valid = f"a rate of {least_hz:g} to {largest_hz:g} Hz{hint}"
        yield ConfigError(source, f"{name}.update_rate", imu.rate_hz, valid)
    if imu.mount.body == "imu0":  # of a plain file, in the frame of its first IMU
        yield from _check_distance(source, f"{name}.T_i_b", imu.mount.T_body_sensor, FARTHEST_M, "an IMU", "imu0")
    for key, (least, largest, unit, factor, other_unit) in _NOISE.items():
        value = float(getattr(imu, key))
        if value and not least <= value <= largest:
            hint = f"is it in {other_unit}? Multiply by {factor:g}" if value > largest else "is it a variance?"
            yield ConfigError(source, f"{name}.{key}", value, f"{least:g} to {largest:g} {unit}; {hint}")


def check_mount(source: str, path: str, mount: Mount) -> Iterator[ConfigError]:
    """Yields an error if a sensor is far from the origin of its body; `path` is that of its section in `source`."""
    place = f"{path}.mount.T_body_sensor"
    yield from _check_distance(
        source, place, mount.T_body_sensor, _FARTHEST_MOUNT_M, "a sensor", f"the origin of {mount.body}"
    )


def _check_distance(
    source: str, path: str, T: Array, farthest_m: float, what: str, whence: str
) -> Iterator[ConfigError]:
    """Yields an error if the translation of T (4, 4) is longer than `farthest_m`.

    Args:
        source: Names the file.
        path: Key path of the transform.
        T: (4, 4), m.
        farthest_m: Largest plausible distance.
        what: The sensor, for the message.
        whence: From what the distance is, for the message.
    """
    distance = float(np.linalg.norm(T[:3, 3]))
    if distance > farthest_m:
        shown = [float(f"{value:.6g}") for value in T[:3, 3]]
        valid = f"{what} up to {farthest_m:g} m from {whence}, not {distance:.3g} m; {suggest_unit(distance)}"
        yield ConfigError(source, path, shown, valid)
