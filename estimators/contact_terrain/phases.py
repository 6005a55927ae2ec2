"""The four phases of a foot, from its centre of pressure and how fast it turns (Shim et al. 2019, 2.2.2)."""

from __future__ import annotations

from enum import Enum

from stridetwin.estimators.contact_terrain.parameters import PublishedParameters
from stridetwin.streams.samples import Array


class Phase(Enum):
    """Phase of one foot."""

    FOOT_OFF = "FO"
    HEEL_CONTACT = "HC"
    FOOT_FLAT = "FF"
    HEEL_OFF = "HO"


def foot_phase(cells: Array, cop: Array | None, rate: float, parameters: PublishedParameters) -> Phase:
    """Phase of a foot.

    Args:
        cells: (4, 2) m, heel first and toe last.
        cop: (2,) m, or None where the foot does not press.
        rate: How fast the foot turns, rad/s.
        parameters: Limits of rate and of heel and front.
    """
    if cop is None:
        return Phase.FOOT_OFF
    share = (cop[0] - cells[0, 0]) / (cells[3, 0] - cells[0, 0])
    if rate > parameters.turning_radps and share < parameters.heel_share:
        return Phase.HEEL_CONTACT
    if rate > parameters.turning_radps and share > parameters.front_share:
        return Phase.HEEL_OFF
    return Phase.FOOT_FLAT
