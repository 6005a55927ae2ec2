"""A board in one picture: which corners are seen, in what directions, and how surely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

MIN_POINTS, MAX_POINTS = 4, 64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardSighting:
    """Corners of one board in one picture; each corner's identity is certain, its place is not.

    Attributes:
        topic: Stream of the picture.
        t_ns: Middle of the exposure on the clock of the IMUs (the picture's stamp and `timeshift_cam_imu_s`).
        points_in_board: (M, 3) corners in the board's frame, m, 4 ≤ M ≤ 64.
        rays: (M, 2) x / z and y / z of each in the camera's optical frame, lens undistorted.
        ray_sd: (M,) standard deviation of each coordinate of a ray (root mean square of the two), blur included.
    """

    topic: str
    t_ns: int
    points_in_board: Array
    rays: Array
    ray_sd: Array

    def __post_init__(self) -> None:
        """Raises ConfigError where an array has another shape or is not finite."""
        m = len(self.points_in_board)
        if not MIN_POINTS <= m <= MAX_POINTS:
            raise ConfigError("BoardSighting", "points_in_board", m, f"{MIN_POINTS} to {MAX_POINTS} points")
        for name, shape in (("points_in_board", (m, 3)), ("rays", (m, 2)), ("ray_sd", (m,))):
            value = getattr(self, name)
            if np.shape(value) != shape or not np.all(np.isfinite(value)):
                raise ConfigError("BoardSighting", name, value, f"finite numbers of shape {shape}")
        if not np.all(self.ray_sd > 0.0):
            raise ConfigError("BoardSighting", "ray_sd", self.ray_sd, "numbers > 0")
