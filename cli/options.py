"""Shared options: each command's options are a dataclass, from whose fields the parser is built.

A field's annotation is its type on the command line (`typer.Argument` or `typer.Option` with its help), its default the
option's default. Fields without default are required.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import typer

from stridetwin.estimators.base import BACKENDS

KINDS = ("mcap", "rosbag1", "rosbag2", "euroc", "tum", "7scenes", "table")
_MOST = 1_000_000


def one_of(names: Sequence[str]) -> dict[str, Any]:
    """Arguments of `typer.Option` or `typer.Argument` for a choice of names, which the shell completes."""

    def parser(text: str) -> str:
        if text not in names:
            raise typer.BadParameter(f"{text!r}: expected one of {', '.join(names)}")
        return text

    return {"parser": parser, "autocompletion": lambda: list(names)}


BackendOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="terrain_map, locomotion_mode: numba (default), or open3d, the published map by Open3D.",
        **one_of(BACKENDS),
    ),
]


def _number(valid: Callable[[float], bool], expected: str) -> Callable[[str], float]:
    def parser(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not valid(value):
            raise typer.BadParameter(f"{text!r}: expected {expected}")
        return value

    return parser


positive = _number(lambda value: 0 < value < 1e9, "a number above 0")
share = _number(lambda value: 0 <= value <= 1000, "0-1000")
probability = _number(lambda value: 0.01 <= value <= 50, "0.01-50")


def whole(text: str) -> int:
    """An integer of at least 0, such as a seed."""
    if not str(text).isdecimal():
        raise typer.BadParameter(f"{text!r}: expected a whole number from 0 on")
    return int(text)


def count(text: str) -> int:
    """A count: an integer of at least 1."""
    digits = str(text)
    if not digits.isdecimal() or len(digits) > len(str(_MOST)) or not 1 <= int(digits) <= _MOST:
        raise typer.BadParameter(f"{text!r}: expected a whole number from 1 to {_MOST}")
    return int(digits)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of every command."""

    json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else there.")] = (
        False
    )


@dataclass(frozen=True, kw_only=True)
class SourceOptions(Options):
    """A recording to read."""

    source: Annotated[
        Path,
        typer.Argument(metavar="RECORDING", help="Recording, or anything that `import` reads.", show_default=False),
    ]
    lenient: Annotated[
        bool, typer.Option("--lenient", help="Read a damaged or suspicious source as far as possible.")
    ] = False


@dataclass(frozen=True, kw_only=True)
class ImportableOptions(SourceOptions):
    """A recording of any format to read."""

    source: Annotated[
        Path,
        typer.Argument(
            metavar="PATH",
            help="Recording, MCAP file, ROS 1 or 2 bag, EuRoC, TUM or 7-Scenes folder, IMU table.",
        ),
    ]
    kind: Annotated[
        str | None,
        typer.Option("--as", metavar="KIND", help=f"Format, where detection fails: {', '.join(KINDS)}."),
    ] = None
    map: Annotated[list[str], typer.Option("--map", metavar="FROM=TO", help="Topic for a stream of the source.")] = (
        field(default_factory=list)
    )
    rig: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Calibration (Kalibr YAML) in place of the source's.")
    ] = None
    depth_scale: Annotated[
        float | None,
        typer.Option(
            parser=positive,
            metavar="N",
            help="Depth units per metre in a folder's depth images (TUM 5000, 7-Scenes 1000).",
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class WalkOptions(Options):
    """How to walk a scenario."""

    physics: Annotated[
        str | None,
        typer.Option(help="How the body moves: kinematic, dynamic (default: as the scenario says)."),
    ] = None
    no_cameras: Annotated[
        bool, typer.Option("--no-cameras", help="Leave out every camera of the rig: much faster.")
    ] = False
