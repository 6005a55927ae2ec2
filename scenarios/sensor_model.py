"""The key `sensors` of a scenario file: the enabled groups, and the part, rate, clock and mount of each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Tag,
    ValidationInfo,
    create_model,
)

from stridetwin.sim.config import TwinConfig
from stridetwin.sim.parts.kinds import Part
from stridetwin.sim.parts.library import IDEAL, kind_of, library, part, read_part
from stridetwin.sim.parts.sensor_config import KIND, Clock, Facing, Seat, SensorConfig
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.fields import DEG, elsewhere, flag, folder_of, refused, unique, words
from stridetwin.streams.json_schema import described
from stridetwin.streams.validation import suggest

_FILE_SUFFIXES = (".yaml", ".yml")
_SHIFTED = ("foot_camera", "foot_imu", "head_camera", "head_imu")
"""Groups whose clock a calibration can hold: cameras relative to the IMUs beside them."""
_OPTIONS = {
    "foot_camera": ("light", "exposure_s", "frames", "shadows", "board", "mount"),
    "head_camera": ("light", "exposure_s", "shadows", "calibration_sd", "pitch_down_rad", "mount"),
    "head_imu": ("strike",),
    "foot_imu": ("position_m", "rotation_rad"),
    "sonar": ("mount",),
}
"""Attributes of a `SensorConfig` that only some groups have."""
_EVERY = ("ideal", "rate_hz", "clock")


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """The sensors of a scenario.

    Attributes:
        groups: Enabled groups.
        paths: Key path of every group that the file names.
        configs: Options of each group that differ from the standard rig.
    """

    groups: tuple[str, ...]
    paths: dict[str, str]
    configs: dict[str, SensorConfig] = field(default_factory=dict)


def _of_part(group: str, node: object, info: ValidationInfo) -> SensorConfig:
    """A part by its name in the library, with or without `-ideal`, or by the path of its file."""
    if not isinstance(node, str):
        raise refused(node, _valid(group))
    plain = node.removesuffix(IDEAL)
    if plain in library():
        found: Part = part(plain)
    elif node.endswith(_FILE_SUFFIXES):
        try:
            found, plain = read_part(folder_of(info) / node), node
        except StrideTwinError as error:
            raise elsewhere(error) from None
    else:
        raise refused(node, _valid(group, node))
    if kind_of(found) != KIND[group]:
        raise refused(node, _valid(group))
    return SensorConfig(part=found, ideal=node != plain)


def _valid(group: str, near: str = "") -> str:
    names: Iterable[str] = [n for n in library() if kind_of(part(n)) == KIND[group]]
    return f"{suggest(near, names)}, each with or without {IDEAL}, or the path of a .yaml file of kind {KIND[group]}"


def _without_nominal(clock: Clock) -> Clock:
    if clock.calibrated:
        raise refused("calibrated", "keys offset_s, drift_ppm, jitter_s, latency_s: no calibration holds this clock")
    return clock


def _seat(facing: Facing) -> Seat:
    return Seat(position_m=facing.position_m, faces_rad=facing.faces_rad)


def _one_aim(options: Any) -> Any:
    if {"mount", "pitch_down_rad"} <= options.model_fields_set:
        raise refused(
            round(options.pitch_down_rad / DEG, 6), "no pitch_down_deg, as mount sets the direction", "pitch_down_deg"
        )
    return options


def _group(group: str) -> Any:
    """Type of a group in a file: `true`, `false`, a part, or keys."""
    hints = get_type_hints(SensorConfig, include_extras=True)
    if group not in _SHIFTED:
        hints["clock"] = Annotated[Clock, AfterValidator(_without_nominal)]
    hints["board"] = Annotated[Facing, AfterValidator(_seat)]
    hints["mount"] = hints["board"] if group == "sonar" else Seat
    names = (*_EVERY, *_OPTIONS.get(group, ()))
    made: dict[str, Any] = {
        "part": (Annotated[Any, BeforeValidator(partial(_of_part, group), json_schema_input_type=str)], None)
    }
    made |= {name: (hints[name], None) for name in names}
    model = create_model(group, __config__=ConfigDict(extra="forbid"), **made)
    descriptions = described(SensorConfig)
    model.__doc__ = "Options of a group.\n\nAttributes:\n" + "".join(f"    {n}: {descriptions[n]}\n" for n in made)
    options: Any = Annotated[model, BeforeValidator(_short, json_schema_input_type=str | model)]
    if group == "head_camera":
        options = Annotated[options, AfterValidator(_one_aim)]
    return Annotated[
        Annotated[Annotated[bool, flag()], Tag("=switch")] | Annotated[options, Tag("=options")],
        Discriminator(lambda node: "=switch" if isinstance(node, bool) else "=options"),
    ]


def _short(node: object) -> object:
    return {"part": node} if isinstance(node, str) else node


def _sensor_config(options: BaseModel) -> SensorConfig:
    given = {name: getattr(options, name) for name in options.model_fields_set}
    return replace(given.pop("part", SensorConfig()), **given)


def _of_names(names: tuple[str, ...]) -> Sensors:
    return Sensors(groups=names, paths={group: f"sensors[{i}]" for i, group in enumerate(names)})


def _of_groups(groups: BaseModel) -> Sensors:
    given = {name: getattr(groups, name) for name in KIND if name in groups.model_fields_set}
    return Sensors(
        groups=tuple(g for g in KIND if given.get(g, g in TwinConfig.sensors) is not False),
        paths={name: f"sensors.{name}" for name, value in given.items() if value is not False},
        configs={name: _sensor_config(value) for name, value in given.items() if isinstance(value, BaseModel)},
    )


_made: dict[str, Any] = {group: (_group(group), None) for group in KIND}
_Groups: Any = create_model("Sensors", __config__=ConfigDict(extra="forbid"), **_made)
_Names = Annotated[tuple[Annotated[str, words(tuple(KIND))], ...], AfterValidator(unique), AfterValidator(_of_names)]
SensorsInFile = Annotated[
    Annotated[_Names, Tag("=names")] | Annotated[_Groups, AfterValidator(_of_groups), Tag("=groups")],
    Discriminator(lambda node: "=groups" if isinstance(node, dict) else "=names"),
]
"""Type of `sensors`: the list of enabled groups, or a mapping of those that differ from `TwinConfig`."""
