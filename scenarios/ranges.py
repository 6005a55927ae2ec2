"""How often a sensor was at the end of its range: known from its part, or seen as a value that many samples share."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from stridetwin.sim.parts.full_scale import full_scales
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Block, Imu

_G, _DEG = STANDARD_GRAVITY_MPS2, math.pi / 180
# Data sheets: full scales of parts of public recordings that the library does not have, rad/s and m/s².
_FURTHER = {
    "ADIS16448": {"angular_rate": 1000 * _DEG, "specific_force": 18 * _G},
    "BMI160": {"angular_rate": 2000 * _DEG, "specific_force": 16 * _G},
}
_NEAR = 0.999
_PLATEAU = 5


def range_hits(block: Block[Any], rig: Rig | None) -> float | None:
    """Share of an IMU's samples, %, with an axis at the end of its range; None for other streams.

    Args:
        block: The stream.
        rig: Names the part; its full scale is looked up in the library of parts. A part that is not known counts as
            at its limit where the largest magnitude of an axis is met by `_PLATEAU` samples or more.
    """
    if block.kind is not Imu or not len(block):
        return None
    part = rig.imus[block.topic].part if rig is not None and block.topic in rig.imus else ""
    limits = full_scales(part) or next((scales for name, scales in _FURTHER.items() if name in part), {})
    hit = np.zeros(len(block), bool)
    for field in ("angular_rate", "specific_force"):
        hit |= _at_limit(np.abs(block.columns[field]), limits.get(field))
    return 100.0 * float(hit.mean())


def _at_limit(magnitude: Array, limit: float | None) -> Array:
    if limit is not None:
        return np.asarray((magnitude >= _NEAR * limit).any(axis=1))
    top = magnitude.max(axis=0)
    same = magnitude >= top - 1e-9 * np.maximum(top, 1.0)
    return np.asarray((same & (same.sum(axis=0) >= _PLATEAU) & (top > 0)).any(axis=1))
