"""What the factors believe, and which of them there are."""

from __future__ import annotations

from typing import NamedTuple


class Terms(NamedTuple):
    """What the factors believe, and which of them there are.

    Attributes:
        gravity: m/s².
        sight_weight: 1 / variance of a sighting on the plane at depth 1.
        sight_limit: Sightings further off than this many standard deviations count less (Huber).
        depth_weight: 1 / variance of an inverse depth that the host is told, m².
        again_weight: The same of one that another frame is told.
        depth_limit: As `sight_limit`.
        plane_limit: As `sight_limit`, of planes.
        host_depth: (11) is there.
        depth_fixed: A landmark keeps the depth that the host was told.
        projection_depth: (12) is there.
        host_depth_in_prior: (11) goes into the prior as well.
        first_estimates: Jacobians of frames that the prior speaks of are taken at their first estimates.
        rate_walk: Of the gyroscope's bias, rad/s²/√Hz.
        force_walk: Of the accelerometer's bias, m/s³/√Hz.
    """

    gravity: float
    sight_weight: float
    sight_limit: float
    depth_weight: float
    again_weight: float
    depth_limit: float
    plane_limit: float
    host_depth: bool
    depth_fixed: bool
    projection_depth: bool
    host_depth_in_prior: bool
    first_estimates: bool
    rate_walk: float
    force_walk: float
