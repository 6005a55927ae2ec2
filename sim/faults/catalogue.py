"""Every kind of fault, by its name in scenario files."""

from __future__ import annotations

from stridetwin.sim.faults.faults import Fault, LooseStrap
from stridetwin.sim.faults.image_faults import LensDirt, Occlusion
from stridetwin.sim.faults.sample_faults import (
    ClockJump,
    DeadCell,
    Dropout,
    Freeze,
    Late,
    Nan,
    OutOfOrder,
    Repeat,
    Saturation,
)

FAULTS: dict[str, type[Fault]] = {
    kind.kind: kind
    for kind in (
        Dropout, Freeze, Repeat, Nan, Late, OutOfOrder, ClockJump, Saturation, DeadCell, Occlusion, LensDirt, LooseStrap
    )
}  # fmt: skip
