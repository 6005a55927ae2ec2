"""Every kind of fault, by its name in scenario files."""

from __future__ import annotations

from stridetwin.sim.faults.faults import Fault, LooseStrap
from stridetwin.sim.faults.image_faults import LensDirt, Occlusion
from stridetwin.sim.faults.miscalibration import Miscalibration
from stridetwin.sim.faults.sample_faults import (
    ClockJump,
    DeadCell,
    Dropout,
    Exchange,
    Freeze,
    Late,
    Nan,
    Offset,
    OutOfOrder,
    Repeat,
    Restart,
    Saturation,
)
from stridetwin.sim.faults.view_faults import DepthNoise, HighView, MirrorFloor, PasserBy

_ANY_STREAM = (Dropout, Freeze, Repeat, Nan, Late, OutOfOrder, ClockJump, Exchange)
_VALUES = (Saturation, Offset, DeadCell, Restart)
_VIEW = (Occlusion, LensDirt, PasserBy, DepthNoise, HighView, MirrorFloor)
FAULTS: dict[str, type[Fault]] = {
    kind.kind: kind for kind in (*_ANY_STREAM, *_VALUES, *_VIEW, LooseStrap, Miscalibration)
}
