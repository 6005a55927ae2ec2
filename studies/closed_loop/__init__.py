"""The twin as an environment: a controller drives the exoskeleton and observes the resulting walk."""

from stridetwin.studies.closed_loop.environment import Assistance, Observer, Streams, WalkPhysics, environment

__all__ = ["Assistance", "Observer", "Streams", "WalkPhysics", "environment"]
