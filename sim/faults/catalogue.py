"""Every kind of fault, by its name in scenario files."""

from __future__ import annotations

from stridetwin.sim.faults import sample_faults
from stridetwin.sim.faults.faults import Fault, LooseStrap
from stridetwin.sim.faults.image_faults import (
    Darkness,
    DepthNoise,
    HighView,
    LensDirt,
    MirrorFloor,
    Occlusion,
    PasserBy,
)

FAULTS: dict[str, type[Fault]] = {
    kind.kind: kind
    for kind in (
        sample_faults.Dropout,
        sample_faults.Freeze,
        sample_faults.Repeat,
        sample_faults.Interpolated,
        sample_faults.Nan,
        sample_faults.Late,
        sample_faults.OutOfOrder,
        sample_faults.ClockJump,
        sample_faults.Exchange,
        sample_faults.Saturation,
        sample_faults.Offset,
        sample_faults.DeadCell,
        sample_faults.Restart,
        Occlusion,
        LensDirt,
        PasserBy,
        Darkness,
        DepthNoise,
        HighView,
        MirrorFloor,
        LooseStrap,
        sample_faults.Miscalibration,
    )
}
