"""The twin as an environment: who drives the exoskeleton senses the walk that follows from it."""

from stridetwin.studies.closed_loop.environment import Assistance, WalkPhysics, environment
from stridetwin.studies.closed_loop.observers import Observer, Streams

__all__ = ["Assistance", "Observer", "Streams", "WalkPhysics", "environment"]
