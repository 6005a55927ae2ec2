"""The twin as an environment: a controller drives the exoskeleton and observes the resulting walk."""

from stridetwin.streams.errors import explain_import_error

with explain_import_error("the closed loop needs it", "closed-loop"):
    from stridetwin.studies.closed_loop.environment import Assistance, Observer, Streams, WalkPhysics, environment

__all__ = ["Assistance", "Observer", "Streams", "WalkPhysics", "environment"]
