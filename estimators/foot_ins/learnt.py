"""What a walk taught about its sensor: written beside the path, and the start of a later walk with the same sensor."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.estimators.foot_ins import state
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.files import atomic_file, to_json
from stridetwin.streams.samples import Array

_FORMAT = "stridetwin foot_ins calibration 1"
# How far a part may be from what it was when it was last turned on: 1 standard deviation. [consumer parts; a gyro of
# three walks in `foot_imu_corners` varied by 0.04 °/s]
_GYRO_TURN_ON_RADPS = 9e-4
_ACCEL_TURN_ON_MPS2 = 0.03
_SCALE_TURN_ON = 1e-3
_RATE_TOLERANCE = 0.05  # of two recordings of one sensor
_MOST_GYRO_BIAS_RADPS, _MOST_ACCEL_BIAS_MPS2, _MOST_SCALE, _MOST_DELAY_S = 0.2, 3.0, 0.2, 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class LearntCalibration:
    """Errors of one IMU as a walk left them.

    Attributes:
        part: Name of the part; "" if unknown.
        rate_hz: Sample rate.
        gyro_bias_radps: (3,) rad/s, sensor axes.
        gyro_bias_covariance: (3, 3) (rad/s)².
        accel_bias_mps2: (3,) m/s², sensor axes.
        accel_bias_covariance: (3, 3) (m/s²)².
        gyro_scale: Share by which the gyro reads too much across the sole's normal.
        gyro_scale_sd: Its standard deviation; 0: it was not estimated.
        force_later_s: Time by which the force is later than the rate, s; None if the walk did not tell.
    """

    part: str
    rate_hz: float
    gyro_bias_radps: Array
    gyro_bias_covariance: Array
    accel_bias_mps2: Array
    accel_bias_covariance: Array
    gyro_scale: float
    gyro_scale_sd: float
    force_later_s: float | None

    @classmethod
    def of(cls, memory: state.FilterState, part: str, rate_hz: float, force_later_s: float | None) -> LearntCalibration:
        """What the filter knows after its last sample."""
        x, P, o = memory.nominal, memory.covariance, memory.row
        g, b, s = o + state.D_GYRO_BIAS, o + state.D_ACCEL_BIAS, o + state.D_SCALE
        unlearnt = memory.unlearnt[state.UNLEARNT_VARIANCE]  # what no rest has decided on
        return cls(
            part=part,
            rate_hz=rate_hz,
            gyro_bias_radps=x[state.GYRO_BIAS : state.GYRO_BIAS + 3].copy(),
            gyro_bias_covariance=P[g : g + 3, g : g + 3] + unlearnt * np.eye(3),
            accel_bias_mps2=x[state.ACCEL_BIAS : state.ACCEL_BIAS + 3].copy(),
            accel_bias_covariance=P[b : b + 3, b : b + 3].copy(),
            gyro_scale=float(x[state.SCALE]),
            gyro_scale_sd=math.sqrt(max(P[s, s], 0.0)),
            force_later_s=force_later_s,
        )

    def apply_to(self, memory: state.FilterState) -> None:
        """Makes this the start of a foot without samples, with the growth from one turn-on to the next."""
        x, prior = memory.nominal, memory.prior
        x[state.GYRO_BIAS : state.GYRO_BIAS + 3] = self.gyro_bias_radps
        x[state.ACCEL_BIAS : state.ACCEL_BIAS + 3] = self.accel_bias_mps2
        x[state.SCALE] = self.gyro_scale
        prior[:3, :3] = self.gyro_bias_covariance + _GYRO_TURN_ON_RADPS**2 * np.eye(3)
        prior[3:6, 3:6] = self.accel_bias_covariance + _ACCEL_TURN_ON_MPS2**2 * np.eye(3)
        if self.gyro_scale_sd > 0.0:
            prior[6, 6] = self.gyro_scale_sd**2 + _SCALE_TURN_ON**2

    def check_sensor(self, source: str, part: str, rate_hz: float) -> None:
        """Raises ConfigError where this is of another part, or of another rate; what is unknown fits."""
        if self.part and part and self.part != part:
            raise ConfigError(source, "part", self.part, f"{part}, the part of this recording")
        if rate_hz > 0.0 and abs(self.rate_hz / rate_hz - 1.0) > _RATE_TOLERANCE:
            raise ConfigError(source, "rate_hz", self.rate_hz, f"about {rate_hz:.0f}, the rate of this recording")


def write_learnt(learnt: LearntCalibration, file: Path) -> None:
    """Writes a calibration as a JSON file."""
    values: dict[str, Any] = {"format": _FORMAT}
    for name in LearntCalibration.__dataclass_fields__:
        value = getattr(learnt, name)
        values[name] = value.tolist() if isinstance(value, np.ndarray) else value
    with atomic_file(file) as temporary:
        temporary.write_text(to_json(values), encoding="utf-8")


def read_learnt(file: Path) -> LearntCalibration:
    """Reads a file of `write_learnt`.

    Raises:
        ConfigError: The file cannot be read, is none of these, or a value is missing or impossible.
    """
    source = str(file)
    try:
        values = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no text"
        raise ConfigError(source, "", reason, "a calibration file that an estimate of foot_ins wrote") from error
    except (json.JSONDecodeError, RecursionError) as error:
        raise ConfigError(source, "", "no JSON", "a calibration file that an estimate of foot_ins wrote") from error
    if not isinstance(values, Mapping) or values.get("format") != _FORMAT:
        written = values.get("format") if isinstance(values, Mapping) else type(values).__name__
        raise ConfigError(source, "format", written, repr(_FORMAT))
    if not isinstance(part := values.get("part"), str):
        raise ConfigError(source, "part", part, "a text")
    delay = values.get("force_later_s")
    return LearntCalibration(
        part=part,
        rate_hz=_read_number(source, values, "rate_hz", 1.0, 1e5),
        gyro_bias_radps=_read_vector(source, values, "gyro_bias_radps", _MOST_GYRO_BIAS_RADPS),
        gyro_bias_covariance=_read_covariance(source, values, "gyro_bias_covariance"),
        accel_bias_mps2=_read_vector(source, values, "accel_bias_mps2", _MOST_ACCEL_BIAS_MPS2),
        accel_bias_covariance=_read_covariance(source, values, "accel_bias_covariance"),
        gyro_scale=_read_number(source, values, "gyro_scale", -_MOST_SCALE, _MOST_SCALE),
        gyro_scale_sd=_read_number(source, values, "gyro_scale_sd", 0.0, _MOST_SCALE),
        force_later_s=(
            None if delay is None else _read_number(source, values, "force_later_s", -_MOST_DELAY_S, _MOST_DELAY_S)
        ),
    )


def _read_number(source: str, values: Mapping[str, Any], name: str, least: float, most: float) -> float:
    """A number between two bounds."""
    value = values.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise ConfigError(source, name, value, f"a number from {least:g} to {most:g}")
    return float(value)


def _read_array(source: str, values: Mapping[str, Any], name: str, shape: tuple[int, ...], valid: str) -> Array:
    """Finite numbers of a shape."""
    try:
        array = np.asarray(values.get(name), dtype=float)
    except (TypeError, ValueError, OverflowError):
        array = np.full(1, np.nan)
    if array.shape != shape or not np.isfinite(array).all():
        raise ConfigError(source, name, values.get(name), valid)
    return array


def _read_vector(source: str, values: Mapping[str, Any], name: str, most: float) -> Array:
    """Three numbers of a size up to `most`."""
    valid = f"three numbers from {-most:g} to {most:g}"
    vector = _read_array(source, values, name, (3,), valid)
    if abs(vector).max() > most:
        raise ConfigError(source, name, values.get(name), valid)
    return vector


def _read_covariance(source: str, values: Mapping[str, Any], name: str) -> Array:
    """A symmetric 3 × 3 matrix without negative eigenvalues."""
    valid = "a symmetric 3 x 3 matrix without negative eigenvalues"
    matrix = _read_array(source, values, name, (3, 3), valid)
    size = abs(matrix).max()
    if abs(matrix - matrix.T).max() > 1e-6 * size or np.linalg.eigvalsh(matrix)[0] < -1e-6 * size:
        raise ConfigError(source, name, values.get(name), valid)
    return 0.5 * (matrix + matrix.T)
