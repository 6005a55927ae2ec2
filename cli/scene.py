"""`scene`: the model of a walk as MJCF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from stridetwin.cli.options import Options, Outcome, Progress, option, output_option
from stridetwin.cli.walk import load_with_notes
from stridetwin.streams.errors import StrideTwinError

_SMALLEST_PX, _LARGEST_PX = 16, 1024


def _pixels(text: str) -> int:
    digits = str(text)
    if not digits.isdecimal() or not _SMALLEST_PX <= int(digits) <= _LARGEST_PX:
        raise typer.BadParameter(f"{text!r}: expected a whole number from {_SMALLEST_PX} to {_LARGEST_PX}")
    return int(digits)


@dataclass(frozen=True, kw_only=True)
class SceneOptions(Options):
    """Write the scene of a walk as MJCF, which MuJoCo opens without StrideTwin."""

    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="Name in the catalogue (see `list`), or a .yaml file.")
    ]
    texture_px: Annotated[int, option("Edge of the textures, pixels: fewer make a smaller folder.", "N", _pixels)] = (
        _LARGEST_PX
    )
    output: Annotated[Path, output_option("Folder to write; scenes of one wearer may share it.", "DIR")]


def scene_command(arguments: SceneOptions, progress: Progress) -> Outcome:
    """`scene`."""
    try:
        from stridetwin.sim.scene.scene_files import scene_files, write_scene
    except ModuleNotFoundError as error:
        raise StrideTwinError(
            f"{error.name} is not installed; scenes need the simulator: pip install 'stridetwin[twin]'"
        ) from error
    config = load_with_notes(arguments.scenario).config
    progress("scene", 0.0)
    files = scene_files(config, arguments.texture_px)
    write_scene(files, config.name, arguments.output)
    scene = arguments.output / f"{config.name}.xml"
    size = sum(map(len, files.values()))
    data = {"scene": str(scene), "files": sorted(files), "bytes": size}
    lines = [f"{scene}: {len(files)} files, {size / 1e6:.1f} MB", f"open it: python -m mujoco.viewer --mjcf={scene}"]
    return Outcome(data=data, lines=lines)
