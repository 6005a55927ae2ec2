"""Full scales of the library's parts, looked up by a rig's description of a part."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from stridetwin.sim.parts.kinds import ForceCellPart, ImuPart, Part
from stridetwin.sim.parts.library import library, part


@cache
def full_scales(text: str) -> Mapping[str, float]:
    """Largest magnitude by field of the samples (rad/s, m/s², N); empty for an unknown part or one without range.

    Args:
        text: Description of the part in the rig: that in the library, or any text that contains its name.
    """
    match _described_by(text):
        case ImuPart() as imu:
            return {"angular_rate": imu.gyroscope.range, "specific_force": imu.accelerometer.range}
        case ForceCellPart() as cell:
            return {"force": cell.range}
    return {}


def _described_by(text: str) -> Part | None:
    """The part with this description, otherwise the one with the longest name in the text."""
    plain = text.replace("-", " ")
    parts = [part(name) for name in library()]
    named = [p for p in parts if p.name.replace("-", " ") in plain]
    same = [p for p in parts if p.description == text]
    return next(iter(same), max(named, key=lambda p: len(p.name), default=None))
