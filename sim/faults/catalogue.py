"""Every kind of fault, by its name in scenario files."""

from __future__ import annotations

from stridetwin.sim.faults.calibration_faults import NominalClock, NominalLinks, NominalMount, NominalRange
from stridetwin.sim.faults.faults import Fault, LooseStrap
from stridetwin.sim.faults.image_faults import LensDirt, Occlusion
from stridetwin.sim.faults.offset_faults import EncoderOffset, InsoleOffset, YawDrift
from stridetwin.sim.faults.pose_faults import Restart
from stridetwin.sim.faults.sample_faults import (
    ClockJump,
    DeadCell,
    Dropout,
    Exchange,
    Freeze,
    Late,
    Loss,
    Nan,
    OutOfOrder,
    Repeat,
    Saturation,
)
from stridetwin.sim.faults.view_faults import DepthNoise, HighView, MirrorFloor, PasserBy

_STREAM = (Dropout, Loss, Freeze, Repeat, Nan, Late, OutOfOrder, ClockJump, Exchange, Saturation)
_VALUES = (DeadCell, InsoleOffset, EncoderOffset, YawDrift)
_VIEW = (Occlusion, LensDirt, PasserBy, DepthNoise, HighView, MirrorFloor)
_CALIBRATION = (NominalMount, NominalClock, NominalRange, NominalLinks)
FAULTS: dict[str, type[Fault]] = {
    kind.kind: kind for kind in (*_STREAM, *_VALUES, *_VIEW, LooseStrap, Restart, *_CALIBRATION)
}
