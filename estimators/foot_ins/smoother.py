"""Fixed-lag smoother of the one-foot inertial navigation."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.foot_ins.delay import sample_rate_hz
from stridetwin.estimators.foot_ins.estimate import FootInsEstimate, FootInsPath, StartPose, nis_by_kind
from stridetwin.estimators.foot_ins.kernel import step, write_estimate
from stridetwin.estimators.foot_ins.learnt import LearntCalibration
from stridetwin.estimators.foot_ins.parameters import FootInsParameters, KernelParameters, for_sensor
from stridetwin.estimators.foot_ins.state import IGNORED, NAVIGATING, NOMINAL, RESTORED, FilterState
from stridetwin.estimators.foot_ins.window import (
    HELD,
    OLDEST,
    TransitionWindow,
    append,
    apply_restored,
    augment,
    empty_window,
    initial_augmented_state,
    release_oldest,
)
from stridetwin.streams.algebra.tuples import vec3_at
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import ImuCalibration
from stridetwin.streams.samples import Array, Block, Imu

_entry_kernel = entry_kernel(Path(__file__).parent, llvm_level=1)

# Of N samples, (N, ...) each: time, ns; phase; standard deviation of a stationary foot's speed, m/s; (N, 22) state;
# (N, 6, 6) covariance of position and attitude.
Rows = tuple[NDArray[np.int64], NDArray[np.int8], Array, Array, Array]


@njit(**INNER_KERNEL)
def _write_oldest(window: TransitionWindow, out: Rows, k: int) -> None:
    """Takes the oldest sample out of the window, smoothed, and writes it into row `k` of the buffers `out`."""
    t_ns, phase, speed_sd, nominal, covariance = out
    i = release_oldest(window)  # row of the sample in the window's ring
    t_ns[k], phase[k], speed_sd[k] = window.t_ns[i], window.phase[i], window.speed[i]
    write_estimate(window.released, nominal[k], covariance[k])


@_entry_kernel
def run(
    memory: FilterState,
    window: TransitionWindow,
    parameters: KernelParameters,
    lag_ns: int,
    t_ns: NDArray[np.int64],
    rate: Array,
    force: Array,
    finish: bool,
    out: Rows,
) -> int:
    """Takes N samples; after each, outputs the oldest held one if it is `lag_ns` old or the window is full.

    Ignored samples are not held. When the filter has restored a clipped peak, the held samples are corrected, too.

    Args:
        memory: State of the foot from `initial_augmented_state`, changed in place.
        window: The samples held, changed in place.
        parameters: Parameters of the filter.
        lag_ns: Age at which a sample leaves the window.
        t_ns: (N,) int64, times.
        rate: (N, 3) rad/s, angular rate.
        force: (N, 3) m/s², specific force.
        finish: Whether to output all held samples at the end.
        out: Buffer of N rows, of which the first are written; if `finish`, of as many more as are held.

    Returns:
        Number of rows written.
    """
    n = 0  # rows written so far
    for k in range(len(t_ns)):
        augment(memory)  # so that the step also yields the transition of the error over it
        phase, speed_sd = step(memory, parameters, t_ns[k], vec3_at(rate[k], 0), vec3_at(force[k], 0))
        if phase == IGNORED:
            continue
        if phase == NAVIGATING and memory.clock[RESTORED] > 0:  # samples since the beginning of a peak just restored
            apply_restored(window, memory)
        append(window, memory, phase, speed_sd)
        is_full = window.place[HELD] == len(window.t_ns)
        if is_full or t_ns[k] - window.t_ns[window.place[OLDEST]] >= lag_ns:
            _write_oldest(window, out, n)
            n += 1
    while finish and window.place[HELD] > 0:
        _write_oldest(window, out, n)
        n += 1
    return n


MAX_LAG_S = 10.0  # the window holds every sample within the lag, so its memory needs a limit
MAX_RATE_HZ = 1000.0  # faster sensors have the same number of samples held, and a shorter lag


class FootInsSmoother:
    """`FootIns` with a fixed lag: each pose is smoothed with the following `lag_s`.

    Within a swing the filter's error grows until the next zero velocity. With the lag, the correction is spread over
    the swing, and the path has no steps (Colomar, Nilsson, Händel 2012, "Smoothing for ZUPT-aided INSs", IPIN). There,
    corrections are held back to the end of a step and smoothed as errors of an open loop, because a closed loop has no
    error left to smooth. Here the loop is closed at every sample without loss: each correction's information is kept
    about the error that it corrected (`window`). The result is that of smoothing each interval of
    `lag_s` from its end. An alignment (the first, or after a long gap) carries no information on earlier samples.

    Causal but for the lag, of constant memory, deterministic; the filter inside gives the numbers of `FootIns`.

    Args:
        lag_s: Age at which a sample's pose is returned, s, up to 10; a second covers a whole swing.
        calibration: Noise and turn-on biases of the IMU; None: any consumer sensor.
        parameters: Parameters for any foot and sensor.
        start: Pose of the sensor at the first sample.
        learnt: What an earlier walk taught about biases and scale; its delay of a channel is not used.

    Raises:
        ConfigError: A lag that is not between 0 and 10 s.
    """

    def __init__(
        self,
        lag_s: float = 1.0,
        calibration: ImuCalibration | None = None,
        parameters: FootInsParameters | None = None,
        start: StartPose | None = None,
        *,
        learnt: LearntCalibration | None = None,
    ) -> None:
        """Prepares filter and window for a lag in s; without a calibration, the IMU is any consumer sensor."""
        if not 0.0 <= lag_s <= MAX_LAG_S:
            raise ConfigError("FootInsSmoother", "lag_s", lag_s, f"0 to {MAX_LAG_S:g} s")
        self._lag_ns = round(lag_s * 1e9)
        self._parameters = for_sensor(parameters or FootInsParameters(), calibration)
        self._memory = initial_augmented_state()  # of the filter
        # time, rate and force of one sample: `update` uses these buffers and allocates none
        self._sample = np.empty(1, np.int64), np.empty((1, 3)), np.empty((1, 3))
        self._row = _allocate_rows(1)
        self._window = empty_window(math.ceil(lag_s * MAX_RATE_HZ) + 1)  # the samples not yet returned
        self._part = "" if calibration is None else calibration.part
        self._rate_hz = 0.0 if calibration is None else calibration.rate_hz
        if learnt is not None:
            learnt.apply_to(self._memory)
        self._force_later_s = None if learnt is None else learnt.force_later_s
        if start is not None:
            start.apply_to(self._memory)

    def update(self, sample: Imu) -> FootInsEstimate | None:
        """Takes one sample; returns the oldest estimate not yet returned, None while it is too young."""
        t_ns, rate, force = self._sample
        t_ns[0], rate[0], force[0] = sample.t_ns, sample.angular_rate, sample.specific_force
        out = self._row
        _, phase, speed_sd, nominal, covariance = out
        written = run(self._memory, self._window, self._parameters, self._lag_ns, t_ns, rate, force, False, out)
        if written == 0:
            return None
        return FootInsEstimate.of(
            self._window.released,
            int(phase[0]),
            float(speed_sd[0]),
            nominal=nominal[0],
            pose_covariance=covariance[0],
        )

    def run(self, block: Block[Imu]) -> FootInsPath:
        """The path over the usable samples of a block and those held before.

        The last ones are smoothed with fewer later samples than the lag has. Afterwards none is held.
        """
        return self._smooth_all(block.t_ns, block.columns["angular_rate"], block.columns["specific_force"])

    def finish(self) -> FootInsPath:
        """The samples not yet returned, smoothed with what is available."""
        return self._smooth_all(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)))

    @property
    def nis(self) -> dict[str, float]:
        """Mean normalised innovation squared by kind of update, of the filter: smoothing does not change it."""
        return nis_by_kind(self._memory)

    @property
    def learnt(self) -> LearntCalibration:
        """What the samples so far have taught about biases and scale of the sensor."""
        rate_hz = self._rate_hz or sample_rate_hz(self._memory)
        return LearntCalibration.of(self._memory, self._part, rate_hz, self._force_later_s)

    @property
    def held(self) -> int:
        """Number of samples not yet returned."""
        return int(self._window.place[HELD])

    def _smooth_all(self, t_ns: NDArray[np.int64], rate: Array, force: Array) -> FootInsPath:
        """The path over the samples still held, and then over new ones; afterwards none is held.

        Args:
            t_ns: (N,) times of the new samples.
            rate: (N, 3) rad/s, angular rate of these.
            force: (N, 3) m/s², specific force.
        """
        out = _allocate_rows(len(t_ns) + self.held)
        n = run(
            self._memory,
            self._window,
            self._parameters,
            self._lag_ns,
            np.ascontiguousarray(t_ns, dtype=np.int64),
            np.ascontiguousarray(rate, dtype=np.float64),
            np.ascontiguousarray(force, dtype=np.float64),
            True,
            out,
        )
        return FootInsPath.of(out[0][:n], out[1][:n], out[2][:n], out[3][:n], out[4][:n])


def _allocate_rows(n: int) -> Rows:
    """Empty buffers for `n` samples, in the order of `Rows`, which is that of the arguments of `FootInsPath.of`."""
    return np.empty(n, np.int64), np.empty(n, np.int8), np.empty(n), np.empty((n, NOMINAL)), np.empty((n, 6, 6))
