"""Nominal parameters of sensors without a Kalibr section, from the figures of their parts."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from stridetwin.sim.parts.kinds import ActuatorPart, AhrsPart, EncoderPart, ForceCellPart, SonarPart

Parameters = dict[str, Any]
_TYPICAL_LOAD_N = 100.0  # of a cell under a foot
_BITS_WITHOUT_COUNTING = 32


def _sonar(part: SonarPart) -> Parameters:
    return {
        "beam_rad": part.beam,
        "range_min_m": part.range_min,
        "range_max_m": part.range_max,
        "range_step_m": part.step,
        "range_sd_m": math.hypot(part.noise, part.step / math.sqrt(12)),
    }


def _ahrs(part: AhrsPart) -> Parameters:
    return {
        "tilt_sd_rad": part.tilt_moving,
        "tilt_bias_sd_rad": part.tilt_bias,
        "heading_bias_sd_rad": part.heading_bias,
        "heading_drift_radps": part.heading_drift,
        "rate_sd_radps": part.rate_noise,
        "rate_bias_sd_radps": math.hypot(part.rate_bias, part.rate_instability),
    }


def _encoder(part: EncoderPart) -> Parameters:
    return {
        "counts": 2.0 ** (part.bits or _BITS_WITHOUT_COUNTING),
        "angle_sd_rad": math.hypot(part.nonlinearity / math.sqrt(2), part.index_offset),
    }


def _insole(part: ForceCellPart) -> Parameters:
    return {
        "force_sd_n": math.hypot(part.noise, part.gain * _TYPICAL_LOAD_N),
        "force_max_n": part.range,
        "filter_hz": part.filter_hz,
    }


def _interaction(part: ForceCellPart) -> Parameters:
    return _insole(part) | {"preload_n": part.preload}


def _actuator(part: ActuatorPart) -> Parameters:
    return {"torque_sd_nm": part.torque_noise, "speed_sd_radps": part.speed_noise}


NOMINAL: dict[str, Callable[[Any], Parameters]] = {
    "range": _sonar,
    "ahrs": _ahrs,
    "encoder": _encoder,
    "insole": _insole,
    "interaction": _interaction,
    "actuator": _actuator,
}
"""By kind of `streams.rig.OtherSensor`."""
