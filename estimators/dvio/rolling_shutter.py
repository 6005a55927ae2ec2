"""Points in the images of a rolling shutter, moved to the time of the image.

Each row is exposed a little later than the one above; the middle one at the image's time. While the camera moves, a
point is therefore seen where it was or will be.
"""

from __future__ import annotations

import numpy as np

from stridetwin.estimators.dvio.state import Calibration
from stridetwin.estimators.dvio.tracker import Lens, Points
from stridetwin.streams.rig import CameraCalibration
from stridetwin.streams.samples import Array


class RollingShutter:
    """Corrects points by their motion in the image; leaves those of a global shutter as they are.

    Args:
        camera: Calibration, with the readout time.
        lens: Of the same camera.
    """

    def __init__(self, camera: CameraCalibration, lens: Lens) -> None:
        self._readout_s, self._last_row, self._lens = camera.readout_s, max(camera.height - 1, 1), lens

    def at_image_time(
        self, points: Points, inverse_depth: Array, calibration: Calibration, R: Array, v: Array, rate: Array
    ) -> Points:
        """Where resting points would be if all rows were exposed at the time of the image.

        Args:
            points: (N, 2) px, as seen.
            inverse_depth: (N,) 1/m.
            calibration: Mount of the camera on the IMU.
            R: (3, 3) world <- IMU.
            v: (3,) m/s, of the IMU in the world.
            rate: (3,) rad/s, of the IMU.

        Returns:
            (N, 2) px.
        """
        if not self._readout_s or not len(points):
            return points
        late_s = (points[:, 1] / self._last_row - 0.5) * self._readout_s
        at = self._lens.normalised(points)
        flow = image_velocity(
            at, inverse_depth, calibration.R.T @ (R.T @ v + np.cross(rate, calibration.p)), calibration.R.T @ rate
        )
        return self._lens.pixels(at - late_s[:, None] * flow)


def image_velocity(at: Array, inverse_depth: Array, velocity: Array, rate: Array) -> Array:
    """(N, 2) 1/s, motion on the plane at depth 1 of resting points (Longuet-Higgins & Prazdny 1980).

    Args:
        at: (N, 2) on the plane at depth 1.
        inverse_depth: (N,) 1/m.
        velocity: (3,) m/s, of the camera in its own axes.
        rate: (3,) rad/s, likewise.
    """
    x, y = at.T
    (vx, vy, vz), (wx, wy, wz) = velocity, rate
    return np.column_stack(
        [
            inverse_depth * (x * vz - vx) + wx * x * y - wy * (1.0 + x * x) + wz * y,
            inverse_depth * (y * vz - vy) + wx * (1.0 + y * y) - wy * x * y - wz * x,
        ]
    )
