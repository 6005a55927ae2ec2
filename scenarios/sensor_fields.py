"""The key `sensors` of a scenario: which groups are on, and which part, rate and clock each has."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from stridetwin.scenarios.fields import Field, Where, choice, flag, mapping, names_of, number, pair, suggest, triple
from stridetwin.sim.calibration import CalibrationSd
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.fitting import KIND, Clock, Seat, SensorConfig
from stridetwin.sim.parts.figure import G
from stridetwin.sim.parts.kinds import Part
from stridetwin.sim.parts.library import IDEAL, kind_of, library, part, read_part

_FILE_SUFFIXES = (".yaml", ".yml")
_CAMERAS = ("foot_camera", "head_camera")
_CLOCK = {
    "offset_s": Field(attribute="offset_s", read=number(-1, 1)),
    "drift_ppm": Field(attribute="drift_ppm", read=number(-1000, 1000)),
    "jitter_s": Field(attribute="jitter_s", read=number(0, 0.1)),
    "latency_s": Field(attribute="latency_s", read=number(0, 1)),
}
_TOLD = {"told": Field(attribute="told", read=flag)}
_SHIFTED = ("foot_camera", "foot_imu", "head_camera", "head_imu")
"""Groups whose clock a calibration can tell of: cameras against the IMUs beside them."""
_CALIBRATION = mapping(
    {
        "rotation_deg": Field(attribute="rotation_rad", read=number(0, 5, scale=math.pi / 180)),
        "position_mm": Field(attribute="position_m", read=number(0, 50, scale=1e-3)),
        "intrinsics_pct": Field(attribute="intrinsics", read=number(0, 5, scale=0.01)),
        "offset_ms": Field(attribute="offset_s", read=number(0, 50, scale=1e-3)),
        "depth_scale_pct": Field(attribute="depth_scale", read=number(0, 5, scale=0.01)),
    },
    CalibrationSd,
)
_POSITION = Field(attribute="position_m", read=triple(number(-300, 300, scale=1e-3)), required=True)
_DEG = math.pi / 180
_ANGLE = number(-180, 180, scale=_DEG)
_FACES = Field(attribute="faces_rad", read=pair(_ANGLE), required=True)
_ROLL = Field(attribute="roll_rad", read=_ANGLE)
_FACING = mapping({"position_mm": _POSITION, "faces_deg": _FACES}, Seat)
_LOOKING = mapping({"position_mm": _POSITION, "faces_deg": _FACES, "roll_deg": _ROLL}, Seat)
_MOUNTS = {"foot_camera": _LOOKING, "head_camera": _LOOKING, "sonar": _FACING}


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """What a scenario says of its sensors.

    Attributes:
        groups: That are on.
        asked: Key path of every group that the file names.
        fittings: What a group has that the standard one has not.
    """

    groups: tuple[str, ...]
    asked: dict[str, str]
    fittings: dict[str, SensorConfig] = field(default_factory=dict)


def sensors(node: object, where: Where) -> Sensors:
    """A list of groups, or a mapping of groups to a part, to options, or to `true` or `false`.

    Groups that a list does not name are off; groups that a mapping does not name are as `TwinConfig` has them.
    """
    if not isinstance(node, dict):
        groups = _NAMES(node, where)
        return Sensors(groups=groups, asked={g: where.item(i).path for i, g in enumerate(groups)})
    for name in node:
        if name not in KIND:
            raise where.error(name, f"keys {suggest(name, KIND)}")
    fittings = {
        name: _fitting(name, value, where.key(name)) for name, value in node.items() if not isinstance(value, bool)
    }
    return Sensors(
        groups=tuple(g for g in KIND if node.get(g, g in TwinConfig.sensors) is not False),
        asked={name: where.key(name).path for name, value in node.items() if value is not False},
        fittings=fittings,
    )


_NAMES = names_of(KIND)


def _fitting(group: str, node: object, where: Where) -> SensorConfig:
    if isinstance(node, str):
        return _of_part(group, node, where)
    if not isinstance(node, dict):
        raise where.error(node, f"a part, true, false, or keys {', '.join(_options(group))}")
    options = mapping(_options(group), dict)(node, where)
    fitting: SensorConfig = options.pop("fitting", SensorConfig())
    if group == "head_camera" and {"mount", "pitch_down_deg"} <= set(node):
        raise where.key("pitch_down_deg").error(node["pitch_down_deg"], "no pitch_down_deg, as mount says how it faces")
    return replace(fitting, **options)


def _options(group: str) -> dict[str, Field]:
    options = {
        "part": Field(attribute="fitting", read=partial(_of_part, group)),
        "ideal": Field(attribute="ideal", read=flag),
        "rate_hz": Field(attribute="rate_hz", read=number(1, 2000)),
        "clock": Field(attribute="clock", read=mapping(_CLOCK | (_TOLD if group in _SHIFTED else {}), Clock)),
    }
    if group in _CAMERAS:
        options["light"] = Field(attribute="light", read=number(0.001, 10))
        options["exposure_ms"] = Field(attribute="exposure_s", read=number(0, 100, scale=1e-3))
    if group == "head_imu":
        options["strike_g"] = Field(attribute="strike", read=number(0, 5, scale=G))
    if group == "head_camera":
        options["calibration_sd"] = Field(attribute="calibration_sd", read=_CALIBRATION)
        options["pitch_down_deg"] = Field(attribute="pitch_down_rad", read=number(-30, 75, scale=_DEG))
    if group == "foot_camera":
        options["frames"] = Field(attribute="frames", read=choice({"board": "board", "full": "full"}))
        options["board"] = Field(attribute="board", read=_FACING)
    if group == "foot_imu":
        options["position_mm"] = Field(attribute="position_m", read=triple(number(-300, 300, scale=1e-3)))
        options["rotation_deg"] = Field(attribute="rotation_rad", read=triple(_ANGLE))
    if group in _MOUNTS:
        options["mount"] = Field(attribute="mount", read=_MOUNTS[group])
    return options


def _of_part(group: str, node: object, where: Where) -> SensorConfig:
    """A part by its name in the library, with or without `-ideal`, or by the path of its file."""
    if not isinstance(node, str):
        raise where.error(node, _valid(group))
    plain = node.removesuffix(IDEAL)
    if plain in library():
        found: Part = part(plain)
    elif node.endswith(_FILE_SUFFIXES):
        found, plain = read_part(Path(where.source).parent / node), node
    else:
        raise where.error(node, _valid(group, node))
    if kind_of(found) != KIND[group]:
        raise where.error(node, _valid(group))
    return SensorConfig(part=found, ideal=node != plain)


def _valid(group: str, near: str = "") -> str:
    names: Iterable[str] = [n for n in library() if kind_of(part(n)) == KIND[group]]
    return f"{suggest(near, names)}, each with or without {IDEAL}, or the path of a .yaml file of kind {KIND[group]}"
