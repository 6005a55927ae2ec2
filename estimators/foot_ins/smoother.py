"""The one-foot inertial navigation a moment later: each pose with what the next second tells of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.foot_ins import window
from stridetwin.estimators.foot_ins.filter import FootInsEstimate, FootInsPath, StartPose, standing_nis
from stridetwin.estimators.foot_ins.memory import NOMINAL
from stridetwin.estimators.foot_ins.parameters import FootInsParameters, for_sensor
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import ImuCalibration
from stridetwin.streams.samples import Array, Block, Imu

MAX_LAG_S = 10.0
MAX_RATE_HZ = 1000.0  # of a faster sensor as many samples are held, and the lag is shorter


class FootInsSmoother:
    """`FootIns` with a fixed lag: a pose is told once the foot has gone on for `lag_s`, and better for it.

    Within a swing the filter's error grows until the foot stands and says so. Told a swing later, the error is spread
    over the swing that made it, and the path has no steps (Colomar, Nilsson, Händel 2012, "Smoothing for ZUPT-aided
    INSs", IPIN). There, corrections are held back to the end of a step and smoothed as errors of an open loop, for a
    loop that is closed has no error left to smooth. Here it is closed at every sample, and nothing is lost: what each
    correction told is kept about the error that it found (`window`). The result is that of smoothing each interval of
    `lag_s` from its end. An alignment (the first, or after a long gap) tells nothing of what came before it.

    Causal but for the lag, of constant memory, deterministic; the filter inside gives the numbers of `FootIns`.

    Args:
        lag_s: Age at which a sample's pose is told, s, up to 10; a second holds a whole swing.
        calibration: As of `FootIns`.
        parameters: As of `FootIns`.
        start: As of `FootIns`.

    Raises:
        ConfigError: A lag that is not between 0 and 10 s.
    """

    def __init__(
        self,
        lag_s: float = 1.0,
        calibration: ImuCalibration | None = None,
        parameters: FootInsParameters | None = None,
        start: StartPose | None = None,
    ) -> None:
        if not 0.0 <= lag_s <= MAX_LAG_S:
            raise ConfigError("FootInsSmoother", "lag_s", lag_s, f"0 to {MAX_LAG_S:g} s")
        self._lag_ns = round(lag_s * 1e9)
        self._parameters = for_sensor(parameters or FootInsParameters(), calibration)
        self._memory = window.listening()
        self._window = window.empty_window(math.ceil(lag_s * MAX_RATE_HZ) + 1)
        if start is not None:
            start.place(self._memory)

    def update(self, sample: Imu) -> FootInsEstimate | None:
        """Takes one sample; returns the oldest one's estimate that is not told yet, None while that is too young."""
        out = _rows(1)
        t_ns, rate, force = np.array([sample.t_ns]), sample.angular_rate[None], sample.specific_force[None]
        if self._take(t_ns, rate, force, out) == 0:
            return None
        return FootInsEstimate.of(self._window.given, int(out[1][0]), float(out[2][0]))

    def run(self, block: Block[Imu]) -> FootInsPath:
        """The path over the usable samples of a block and those held before, the last smoothed with what there is."""
        out = _rows(len(block) + self.held)
        n = self._take(block.t_ns, block.columns["angular_rate"], block.columns["specific_force"], out)
        return self._told(out, n)

    def finish(self) -> FootInsPath:
        """The samples not told yet, smoothed with what there is."""
        return self._told(_rows(self.held), 0)

    @property
    def nis(self) -> float:
        """As of `FootIns`: what is smoothed are its errors, not what it met."""
        return standing_nis(self._memory)

    @property
    def held(self) -> int:
        """Samples not told yet."""
        return int(self._window.place[window.HELD])

    def _told(self, out: window.Rows, n: int) -> FootInsPath:
        """The first `n` rows, and all that is still held."""
        n = window.drain(self._window, out, n)
        return FootInsPath.of(out[0][:n], out[1][:n], out[2][:n], out[3][:n], out[4][:n])

    def _take(self, t_ns: NDArray[np.int64], rate: Array, force: Array, out: window.Rows) -> int:
        return window.run(
            self._memory,
            self._window,
            self._parameters,
            self._lag_ns,
            np.ascontiguousarray(t_ns, dtype=np.int64),
            np.ascontiguousarray(rate, dtype=np.float64),
            np.ascontiguousarray(force, dtype=np.float64),
            out,
        )


def _rows(n: int) -> window.Rows:
    """Room for `n` samples, as `FootInsPath.of` takes them."""
    return np.empty(n, np.int64), np.empty(n, np.int8), np.empty(n), np.empty((n, NOMINAL)), np.empty((n, 6, 6))
