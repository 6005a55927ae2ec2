"""Recordings: one MCAP file of ROS 2 messages, written, indexed and read."""

from stridetwin.streams.recording.reader import Recording, RecordingWriter

__all__ = ["Recording", "RecordingWriter"]
