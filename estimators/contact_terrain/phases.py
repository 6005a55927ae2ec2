"""The four phases of a foot, from its centre of pressure and how fast it turns (Shim et al. 2019, 2.2.2)."""

from __future__ import annotations

from enum import Enum

from stridetwin.streams.samples import Array

TURNING_RADPS = 0.8
"""A foot that turns faster is not flat, unless its centre of pressure is in the middle."""
HEEL_SHARE, FRONT_SHARE = 0.35, 0.65
"""Of the way from the heel's cell to the toe's: what counts as the heel side, and as the front."""


class Phase(Enum):
    """Phase of one foot."""

    FOOT_OFF = "FO"
    HEEL_CONTACT = "HC"
    FOOT_FLAT = "FF"
    HEEL_OFF = "HO"


def foot_phase(cells: Array, cop: Array | None, rate: float) -> Phase:
    """Phase of a foot.

    Args:
        cells: (4, 2) m, heel first and toe last.
        cop: (2,) m, or None where the foot does not press.
        rate: How fast the foot turns, rad/s.
    """
    if cop is None:
        return Phase.FOOT_OFF
    share = (cop[0] - cells[0, 0]) / (cells[3, 0] - cells[0, 0])
    if rate > TURNING_RADPS and share < HEEL_SHARE:
        return Phase.HEEL_CONTACT
    if rate > TURNING_RADPS and share > FRONT_SHARE:
        return Phase.HEEL_OFF
    return Phase.FOOT_FLAT
