"""Options and outcome of a command. The options are a dataclass, from whose fields the parser is built.

A field's annotation is its type on the command line (`typer.Argument` or `typer.Option` with its help), its default the
option's default. Fields without default are required.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from stridetwin.estimators.backends import BACKENDS
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.files import partial_path
from stridetwin.streams.formats.file_formats import FILE_FORMATS

if TYPE_CHECKING:
    from rich.table import Table

_MOST_DIGITS = 1000
LARGEST_PX = 1024
"""Edge of a scene's textures, pixels."""
_OUTPUTS = {"output": "-o", "record": "--record", "junit": "--junit", "markdown": "--markdown", "history": "--history"}
_FOLDERS = ("run", "generate", "export", "experiment", "place", "scene")
"""Commands whose `-o` may be a folder."""
_MAKE_FOLDERS = (("import", "output"), ("score", "history"))
Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of a command: data for `--json`, output as text and tables, and the exit code."""

    data: Mapping[str, object]
    lines: Sequence[str | Table]
    code: int = 0


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


OnlyOption = Annotated[
    list[str],
    typer.Option(
        metavar="NAME",
        help="Run only this estimator, such as foot_ins, and simulate only the sensors that it reads; may be repeated.",
    ),
]

SchedulerOption = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Run on the workers of this Dask scheduler instead.")
]
_SCHEDULER = re.compile(r"([a-z]+://)?[^\s/]+:\d{1,5}")


def check_executor(workers: int | None, scheduler: str | None) -> None:
    """Rejects `--workers` together with `--scheduler`, and an invalid address.

    Raises:
        ConfigError: As described.
    """
    if workers and scheduler:
        raise ConfigError("command line", "--workers", workers, "either --workers or --scheduler")
    if scheduler is not None and not _SCHEDULER.fullmatch(scheduler):
        valid = "HOST:PORT or PROTOCOL://HOST:PORT, such as tcp://10.0.0.5:8786"
        raise ConfigError("command line", "--scheduler", scheduler, valid)


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


def _whole_number(least: int, most: int | None = None) -> Callable[[str], int]:
    expected = f"a whole number from {least} {'on' if most is None else f'to {most}'}"

    def parser(text: str) -> int:
        digits = str(text)
        fits = digits.isdecimal() and len(digits) <= _MOST_DIGITS and int(digits) >= least
        if not fits or (most is not None and int(digits) > most):
            raise typer.BadParameter(f"{digits!r}: expected {expected}")
        return int(digits)

    return parser


whole = _whole_number(0)
count = _whole_number(1, 1_000_000)
pixels = _whole_number(16, LARGEST_PX)


def option(help: str, metavar: str | None = None, parser: Callable[[str], Any] | None = None) -> Any:
    """An option with a value: `typer.Option`."""
    return typer.Option(help=help, metavar=metavar, parser=parser)


def switch(name: str, help: str) -> Any:
    """An option without a value."""
    return typer.Option(name, help=help, metavar="")  # it takes no value, such as <bool>


def output_option(help: str, metavar: str = "FILE") -> Any:
    """The option `-o`."""
    return typer.Option("-o", "--output", help=help, metavar=metavar)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of every command."""

    json: Annotated[bool, switch("--json", "Print one JSON object on stdout and nothing else there.")] = False


@dataclass(frozen=True, kw_only=True)
class SourceOptions(Options):
    """A recording to read."""

    source: Annotated[
        Path,
        typer.Argument(metavar="RECORDING", help="Recording, or anything that `import` reads.", show_default=False),
    ]
    lenient: Annotated[bool, switch("--lenient", "Read a damaged or suspicious source as far as possible.")] = False


@dataclass(frozen=True, kw_only=True)
class ImportableOptions(SourceOptions):
    """A recording of any format to read."""

    source: Annotated[
        Path,
        typer.Argument(
            metavar="PATH",
            help="Recording, MCAP file, ROS 1 or 2 bag, EuRoC, TUM or 7-Scenes folder, IMU table or folder of them.",
        ),
    ]
    kind: Annotated[
        str | None,
        typer.Option("--as", metavar="KIND", help=f"Format, where detection fails: {', '.join(FILE_FORMATS)}."),
    ] = None
    columns: Annotated[
        str | None,
        option("Columns and units of a table with other names: t=Time[ms],ax=Acc X[g],...,gx=Gyr X[deg/s].", "MAP"),
    ] = None
    rate: Annotated[float | None, option("Rate of a table without stamps.", "HZ", positive)] = None
    map: Annotated[list[str], option("Topic for a stream of the source.", "FROM=TO")] = field(default_factory=list)
    rig: Annotated[Path | None, option("Calibration (Kalibr YAML) in place of the source's.", "FILE")] = None
    depth_scale: Annotated[
        float | None,
        option("Depth units per metre in a folder's depth images (TUM 5000, 7-Scenes 1000).", "N", positive),
    ] = None


@dataclass(frozen=True, kw_only=True)
class WalkOptions(Options):
    """How to walk a scenario."""

    physics: Annotated[
        Literal["kinematic", "dynamic"] | None, option("How the body moves (default: as in the scenario).")
    ] = None
    no_cameras: Annotated[bool, switch("--no-cameras", "Leave out every camera of the rig: much faster.")] = False


def check_outputs(command: str, arguments: Options) -> None:
    """Rejects outputs that would overwrite an input or fail at the end of a long run.

    Raises:
        ConfigError: An output is also an input, is given twice, or cannot be a file.
    """
    given = dict(vars(arguments))
    if command == "history":
        given["file"] = given.pop("history")  # an input
    outputs = {name: given.pop(name) for name in _OUTPUTS if isinstance(given.get(name), Path)}
    taken = list(_files(given.values()))
    for name, path in outputs.items():
        option = f"{command} {_OUTPUTS[name]}"
        if any(_same(path, other) for other in taken):
            raise ConfigError(option, "", str(path), "a file that is not also an input or another output")
        if name != "output" or command not in _FOLDERS:
            partial_path(path)
            if not path.parent.is_dir() and (command, name) not in _MAKE_FOLDERS:
                raise ConfigError(option, "", str(path), f"a file in an existing folder; {path.parent} does not exist")
        taken.append(path)


def _files(values: Iterable[object]) -> Iterator[Path]:
    """All names in a value: paths, lists of them, file names, `NAME=FILE`."""
    for value in values:
        if isinstance(value, list):
            yield from _files(value)
        elif isinstance(value, Path):
            yield value
        elif isinstance(value, str):
            yield from (path for path in map(Path, {value, value.rpartition("=")[2]}) if _is_file(path))


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # not a valid file name
        return False


def _same(one: Path, other: Path) -> bool:
    return one.absolute() == other.absolute() or (one.exists() and other.exists() and one.samefile(other))
