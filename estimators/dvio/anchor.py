"""Uncertainty of the world in which a window began: of the position and heading at its start.

Neither images nor the IMU measure them, so a window that begins after a loss takes both as exact, and what was not
known there is added to what it reports. In the window itself an uncertainty of metres would fade: its information is
ten orders of magnitude below that of the IMU, where the rounding of the equations begins.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.streams.samples import Array

_UP = np.array([0.0, 0.0, 1.0])
_POSITION_AND_HEADING = np.ix_([0, 1, 2, 5], [0, 1, 2, 5])  # of a pose: position, then rotation about the world's axes


@dataclass(frozen=True, kw_only=True, eq=False)
class Anchor:
    """Position and heading at which a window began, as uncertain as they were.

    Attributes:
        p: (3,) m, that position in the world.
        covariance: (4, 4) of its error (m) and of the heading's (rad).
    """

    p: Array
    covariance: Array

    @classmethod
    def exact(cls) -> Anchor:
        """The anchor of a first start, which defines the world."""
        return cls(p=np.zeros(3), covariance=np.zeros((4, 4)))

    @classmethod
    def at(cls, p: Array, R: Array, covariance: Array) -> Anchor:
        """The anchor of a window that begins at a pose.

        Args:
            p: (3,) m, IMU in the world.
            R: (3, 3) world <- IMU.
            covariance: (6, 6) of the errors of position (m) and attitude (rad, about the IMU's axes).
        """
        to_world = np.eye(6)
        to_world[3:, 3:] = R
        return cls(p=p.copy(), covariance=(to_world @ covariance @ to_world.T)[_POSITION_AND_HEADING])

    def covariance_at(self, p: Array, R: Array) -> Array:
        """(6, 6) covariance that the anchor adds to that of a pose in its window.

        docs/dvio.md (22): an error of the heading turns the way since the start about the vertical through it.

        Args:
            p: (3,) m, IMU in the world.
            R: (3, 3) world <- IMU.

        Returns:
            Of the errors of position (m) and attitude (rad, about the IMU's axes).
        """
        by_anchor = np.zeros((6, 4))
        by_anchor[:3, :3] = np.eye(3)
        by_anchor[:3, 3] = np.cross(_UP, p - self.p)
        by_anchor[3:, 3] = R[2]
        covariance: Array = by_anchor @ self.covariance @ by_anchor.T
        return covariance
