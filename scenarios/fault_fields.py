"""The block `faults:` of a scenario file."""

from __future__ import annotations

import math
from collections.abc import Mapping

from stridetwin.scenarios.fields import Field, Where, choice, flag, integer, mapping, number, suggest, text
from stridetwin.sim.faults import Fault, LooseStrap
from stridetwin.sim.picture_faults import LensDirt, Occlusion
from stridetwin.sim.sample_faults import (
    CELLS,
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

_LONGEST_S = 36000
_WHEN = {
    "topic": Field(attribute="topic", read=text, required=True),
    "at_s": Field(attribute="at_s", read=number(0, _LONGEST_S)),
    "duration_s": Field(attribute="duration_s", read=number(0.001, _LONGEST_S)),
    "rate_per_min": Field(attribute="rate_per_min", read=number(0.001, 600)),
    "name": Field(attribute="name", read=text),
}
_WHAT: Mapping[type[Fault], Mapping[str, Field]] = {
    Dropout: {},
    Freeze: {},
    Repeat: {},
    Nan: {},
    Late: {"delay_s": Field(attribute="delay_s", read=number(0.001, 60))},
    OutOfOrder: {},
    ClockJump: {"jump_s": Field(attribute="jump_s", read=number(-3600, 3600), required=True)},
    Saturation: {"fraction": Field(attribute="fraction", read=number(0.001, 1))},
    DeadCell: {
        "cell": Field(attribute="cell", read=choice({c: c for c in CELLS})),
        "stuck": Field(attribute="stuck", read=flag),
    },
    Occlusion: {"share": Field(attribute="share", read=number(0.01, 1))},
    LensDirt: {
        "spots": Field(attribute="spots", read=integer(1, 50)),
        "size": Field(attribute="size", read=number(0.01, 0.5)),
    },
    LooseStrap: {
        "angle_deg": Field(attribute="angle_rad", read=number(0, 90, scale=math.pi / 180)),
        "shift_mm": Field(attribute="shift_m", read=number(0, 100, scale=1e-3)),
    },
}
KINDS = {kind.kind: mapping({**_WHEN, **what}, kind) for kind, what in _WHAT.items()}


def fault(node: object, where: Where) -> Fault:
    """One fault: its kind, where, and either when or how often."""
    if not isinstance(node, dict) or "kind" not in node:
        raise where.error(node if isinstance(node, dict) else str(node), "keys kind, topic and at_s or rate_per_min")
    kind = node["kind"]
    if not isinstance(kind, str) or kind not in KINDS:
        raise where.key("kind").error(kind, suggest(kind, KINDS))
    read: Fault = KINDS[kind]({k: v for k, v in node.items() if k != "kind"}, where)
    if (read.at_s is None) == (read.rate_per_min is None):
        given = [k for k in ("at_s", "rate_per_min") if k in node]
        raise where.error(given, "either at_s or rate_per_min")
    if read.rate_per_min is not None and read.duration_s is None:
        raise where.error("no duration_s", "the key duration_s is required with rate_per_min")
    return read
