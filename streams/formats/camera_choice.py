"""Choice of the camera for an export."""

from __future__ import annotations

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.recording import Recording
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Image


def chosen_camera(recording: Recording, topic: str | None) -> CameraCalibration:
    """The camera of a topic, or the first one with depth (otherwise the first one).

    Raises:
        ConfigError: Unknown camera; the message lists the known ones.
    """
    there = [c for t, c in recording.rig.cameras.items() if t in recording.topics]
    names = ", ".join(c.topic for c in there) or "none (a recording with images)"
    if topic is not None:
        camera = recording.rig.cameras.get(topic)
        if camera is None or camera not in there:
            raise ConfigError(recording.path, "--camera", topic, names)
        return camera
    colour = [c for c in there if recording.topics[c.topic].kind is Image]
    if not colour:
        raise ConfigError(recording.path, "cameras", None, "at least one colour or grey camera with a calibration")
    return next((c for c in colour if c.depth_topic in recording.topics), colour[0])
