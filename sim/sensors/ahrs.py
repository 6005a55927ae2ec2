"""Attitude and heading reference."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.sim.noise import Noise
from stridetwin.sim.track import Track
from stridetwin.streams.rig import OtherSensor
from stridetwin.streams.samples import Ahrs, Block


class AhrsModel:
    """Orientation with a constant error and white noise on tilt, a constant heading error, and a noisy rate.

    Args:
        calibration: The sensor as it really is.
        noise: Its noise.
    """

    def __init__(self, calibration: OtherSensor, noise: Noise) -> None:
        self._calibration, self._noise = calibration, noise
        tilt, heading = calibration.number("tilt_bias_sd_rad"), calibration.number("heading_bias_sd_rad")
        self._bias = noise.normal(1.0, 3) * [tilt, tilt, heading]  # rotation vector in the world
        self._white_sd = np.repeat([calibration.number("tilt_sd_rad"), calibration.number("rate_sd_radps")], 3)

    def read(self, body: Track) -> Block[Ahrs]:
        """Samples at the instants of the carrying body's track."""
        sensor = body.mounted(self._calibration.mount.T_body_sensor)
        white = self._noise.normal(self._white_sd, (len(body), 6))
        told = Rotation.from_rotvec(self._bias + white[:, :3]) * sensor.rotation
        return Block(
            topic=self._calibration.topic,
            kind=Ahrs,
            t_ns=body.t_ns,
            columns={
                "q_world_sensor": told.as_quat(scalar_first=True),
                "angular_rate": sensor.w_body + white[:, 3:],
            },
        )
