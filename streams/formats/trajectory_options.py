"""What a user says about a trajectory of another tool, where the file itself does not."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class TrajectoryOptions:
    """What a user says about a trajectory.

    Attributes:
        quaternion: Order of the quaternion, `xyzw` or `wxyz`; None recognises it.
        time_unit: Unit of the stamps, `s`, `ms`, `us` or `ns`; None recognises it.
        times: File whose first column has the stamp of each pose, for a trajectory without stamps.
        time_offset_s: Added to the stamps, s.
        length_unit: Unit of the positions, `m`, `cm` or `mm`; None is that of the header, else m.
    """

    quaternion: str | None = None
    time_unit: str | None = None
    times: Path | None = None
    time_offset_s: float = 0.0
    length_unit: str | None = None


NO_OPTIONS = TrajectoryOptions()
