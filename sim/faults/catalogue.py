"""Every kind of fault, by its name in scenario files."""

from __future__ import annotations

from stridetwin.sim.faults.faults import Fault, LooseStrap
from stridetwin.sim.faults.image_faults import DepthNoise, HighView, LensDirt, MirrorFloor, Occlusion, PasserBy
from stridetwin.sim.faults.sample_faults import (
    ClockJump,
    DeadCell,
    Dropout,
    Exchange,
    Freeze,
    Late,
    Miscalibration,
    Nan,
    Offset,
    OutOfOrder,
    Repeat,
    Restart,
    Saturation,
)

FAULTS: dict[str, type[Fault]] = {
    kind.kind: kind
    for kind in (
        Dropout,
        Freeze,
        Repeat,
        Nan,
        Late,
        OutOfOrder,
        ClockJump,
        Exchange,
        Saturation,
        Offset,
        DeadCell,
        Restart,
        Occlusion,
        LensDirt,
        PasserBy,
        DepthNoise,
        HighView,
        MirrorFloor,
        LooseStrap,
        Miscalibration,
    )
}
