"""What the motion says about the cameras of an imported recording, before an estimator uses them.

`check` takes its time; here a few segments of images are enough for the errors that spoil an estimate. Recordings of
the twin are not looked at: their calibration is what it says.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

from stridetwin.scenarios.camera_fit import QUICK_SEGMENTS, fit_camera, list_cameras_beside_imus
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.formats.opening import print_warnings
from stridetwin.streams.recording.imported import IMPORTED_FROM
from stridetwin.streams.recording.index import LENIENT
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Imu


def report_cameras(recording: Recording, topics: Collection[str], *, lenient: bool) -> list[str]:
    """Compares the cameras of an imported recording with their IMUs, and prints what contradicts on stderr.

    Args:
        recording: The recording; nothing happens for one of the twin.
        topics: Topics that will be used; cameras of which neither images nor depth are among them are left out.
        lenient: Errors that spoil an estimate are warnings, too.

    Returns:
        The warnings, one sentence each, with the topic of the camera.

    Raises:
        RecordingError: Camera and IMU contradict by more than an odometry can mend, unless lenient.
    """
    warnings = list[str]()
    for camera in _list_cameras(recording, topics):
        block = recording.block(camera.imu_topic).as_kind(Imu)
        for fault in fit_camera(recording, camera, block, QUICK_SEGMENTS).list_faults():
            text = f"{camera.topic}: {fault.text}"
            if fault.spoils and not lenient:
                raise RecordingError(f"{recording.path}: {text}{LENIENT}")
            warnings.append(text)
    print_warnings(recording.path, warnings)
    return warnings


def _list_cameras(recording: Recording, topics: Collection[str]) -> Iterator[CameraCalibration]:
    """Yields the cameras of an imported recording that are used and can be compared with the IMU on their body."""
    if IMPORTED_FROM not in recording.metadata:
        return
    for camera, reason in list_cameras_beside_imus(recording):
        is_used = camera.topic in topics or (camera.depth_topic and camera.depth_topic in topics)
        if is_used and not reason:
            yield camera
