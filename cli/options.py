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
from typing import TYPE_CHECKING, Annotated, Literal, TypedDict

import typer

from stridetwin.estimators.backends import BACKENDS
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.files import partial_path
from stridetwin.streams.formats.file_formats import FILE_FORMATS
from stridetwin.streams.formats.trajectory_options import TrajectoryOptions

if TYPE_CHECKING:
    from rich.table import Table
    from typer.models import OptionInfo

_MOST_DIGITS = 1000
LARGEST_PX = 1024
"""Edge of a scene's textures, pixels."""
_OUTPUTS = {
    "output": "-o",
    "record": "--record",
    "report": "--report",
    "junit": "--junit",
    "markdown": "--markdown",
    "history": "--history",
}
_FOLDERS = ("run", "generate", "export", "experiment", "place", "scene")
"""Commands whose `-o` may be a folder."""
_ONLY_RECORDINGS = (("import", "output"), ("live", "record"))
"""Commands and options whose file is always a recording."""
RECORDING_SUFFIX = ".mcap"
_MAKE_FOLDERS = (("import", "output"), ("score", "history"))
Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of a command.

    Attributes:
        data: What `--json` prints, as one JSON object.
        lines: What is printed otherwise: text and tables.
        code: Exit code.
    """

    data: Mapping[str, object]
    lines: Sequence[str | Table]
    code: int = 0


class Choice(TypedDict):
    """Arguments of `typer.Option` or `typer.Argument` for one of several names."""

    parser: Callable[[str], str]
    autocompletion: Callable[[], list[str]]


def one_of(names: Sequence[str], other: str = "", is_other: Callable[[str], bool] = lambda text: False) -> Choice:
    """Arguments of `typer.Option` or `typer.Argument` for a choice of names, which the shell completes.

    Args:
        names: The names.
        other: What else is valid, for the message, such as `MODULE:CLASS`; "" if nothing is.
        is_other: Whether a text has the form of that.
    """

    def parser(text: str) -> str:
        """The text if it is valid; otherwise an error that suggests a similar name."""
        if text not in names and not is_other(text):
            from stridetwin.streams.validation import suggest  # imports pydantic

            raise typer.BadParameter(f"{text!r}: expected one of {suggest(text, names)}{other and f', or {other}'}")
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

ParametersOption = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="ESTIMATOR.PARAMETER=VALUE",
        help="Value of a parameter, such as foot_ins.lever_arm_m=0.09; may be repeated.",
    ),
]

ScoreOnlyOption = Annotated[
    list[str], typer.Option(metavar="NAME", help="Score only this estimator, such as foot_ins; may be repeated.")
]

SchedulerOption = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Run on the workers of this Dask scheduler instead.")
]
_SCHEDULER = re.compile(r"([a-z]+://)?[^\s/]+:\d{1,5}")


def check_executor(workers: int | None, scheduler: str | None) -> None:
    """Checks the options of commands that run many jobs.

    Raises:
        ConfigError: `--workers` together with `--scheduler`, or an invalid address.
    """
    if workers and scheduler:
        raise ConfigError("command line", "--workers", workers, "either --workers or --scheduler")
    if scheduler is not None and not _SCHEDULER.fullmatch(scheduler):
        valid = "HOST:PORT or PROTOCOL://HOST:PORT, such as tcp://10.0.0.5:8786"
        raise ConfigError("command line", "--scheduler", scheduler, valid)


def _number_parser(valid: Callable[[float], bool], expected: str) -> Callable[[str], float]:
    """Makes a parser of an option's number; `valid` says whether a value is accepted, `expected` says it in errors."""

    def parser(text: str) -> float:
        """The number in an option's text, or an error that says what is expected; a text without one counts as NaN."""
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not valid(value):
            raise typer.BadParameter(f"{text!r}: expected {expected}")
        return value

    return parser


finite = _number_parser(lambda value: abs(value) < 9e9, "seconds, up to 9e9")
positive = _number_parser(lambda value: 0 < value < 1e9, "a number above 0")
share = _number_parser(lambda value: 0 <= value <= 1000, "0-1000")
probability = _number_parser(lambda value: 0.01 <= value <= 50, "0.01-50")


def _whole_number_parser(least: int, most: int | None = None) -> Callable[[str], int]:
    """Makes a parser of an option's whole number from `least` to `most`."""
    expected = f"a whole number from {least} {'on' if most is None else f'to {most}'}"

    def parser(text: str) -> int:
        """The number in an option's text, or an error that says what is expected.

        Texts with too many digits are refused first, as Python converts them slowly or not at all.
        """
        digits = str(text)
        fits = digits.isdecimal() and len(digits) <= _MOST_DIGITS and int(digits) >= least
        if not fits or (most is not None and int(digits) > most):
            raise typer.BadParameter(f"{digits!r}: expected {expected}")
        return int(digits)

    return parser


whole = _whole_number_parser(0)
count = _whole_number_parser(1, 1_000_000)
pixels = _whole_number_parser(16, LARGEST_PX)


def option(help: str, metavar: str | None = None, parser: Callable[[str], object] | None = None) -> OptionInfo:
    """An option with a value, as `typer.Option`.

    Args:
        help: Its help.
        metavar: Name of the value in the help.
        parser: Converts the text to the value; by default as the field's annotation says.
    """
    info: OptionInfo = typer.Option(help=help, metavar=metavar, parser=parser)
    return info


def switch(name: str, help: str) -> OptionInfo:
    """An option without a value, such as `--json`, as `typer.Option`."""
    info: OptionInfo = typer.Option(name, help=help, metavar="")  # it takes no value, such as <bool>
    return info


def output_option(help: str, metavar: str = "FILE") -> OptionInfo:
    """The option `-o` of a command that writes a file or folder, as `typer.Option`."""
    info: OptionInfo = typer.Option("-o", "--output", help=help, metavar=metavar)
    return info


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of every command."""

    json: Annotated[bool, switch("--json", "Print one JSON object on stdout and nothing else there.")] = False


@dataclass(frozen=True, kw_only=True)
class TrajectoryFileOptions(Options):
    """How to read a trajectory."""

    quaternion: Annotated[
        Literal["xyzw", "wxyz"] | None,
        option("Order of the quaternions in a trajectory (default: its header's, or recognised)."),
    ] = None
    time_unit: Annotated[
        Literal["s", "ms", "us", "ns"] | None, option("Unit of a trajectory's stamps (default: recognised).")
    ] = None
    times: Annotated[
        Path | None, option("Stamps of a trajectory without any, such as KITTI's, one per row.", "FILE")
    ] = None
    time_offset: Annotated[
        float | None, option("Added to the stamps of a trajectory of another clock.", "S", finite)
    ] = None
    length_unit: Annotated[
        Literal["m", "cm", "mm"] | None, option("Unit of a trajectory's positions (default: its header's, or m).")
    ] = None

    @property
    def trajectory(self) -> TrajectoryOptions:
        """These options for the reader of trajectories."""
        return TrajectoryOptions(
            quaternion=self.quaternion,
            time_unit=self.time_unit,
            times=self.times,
            time_offset_s=self.time_offset or 0.0,
            length_unit=self.length_unit,
        )


NO_FILE = "--quaternion, --time-unit, --times, --time-offset, --length-unit say how a trajectory is read: expected"
"""Begin of the error where no trajectory is given."""


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
        option(
            "Columns, by name or by number from 1, and units of any table: t=Time[ms],ax=Acc X[g],...,gx=5[deg/s].",
            "MAP",
        ),
    ] = None
    rate: Annotated[
        float | None, option("Rate of a table without stamps, or of its packet counter.", "HZ", positive)
    ] = None
    map: Annotated[list[str], option("Topic for a stream of the source.", "FROM=TO")] = field(default_factory=list)
    rig: Annotated[
        Path | None, option("Calibration (Kalibr's or another tool's) in place of the source's.", "FILE")
    ] = None
    depth_scale: Annotated[
        float | None,
        option("Units per metre of depth images (default: TUM 5000, 7-Scenes and bags 1000).", "N", positive),
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
    option_values = dict(vars(arguments))  # outputs are taken out below, inputs remain
    if command == "history":
        option_values["file"] = option_values.pop("history")  # an input
    outputs = {name: option_values.pop(name) for name in _OUTPUTS if isinstance(option_values.get(name), Path)}
    taken = list(_find_files(option_values.values()))  # inputs, and the outputs so far
    for name, path in outputs.items():
        option = f"{command} {_OUTPUTS[name]}"
        if any(_is_same_file(path, other) for other in taken):
            raise ConfigError(option, "", str(path), "a file that is not also an input or another output")
        if name != "output" or command not in _FOLDERS:  # it has to be a file
            partial_path(path)  # raises an error for a name that no file can have
            if not path.parent.is_dir() and (command, name) not in _MAKE_FOLDERS:
                raise ConfigError(option, "", str(path), f"a file in an existing folder; {path.parent} does not exist")
        if (command, name) in _ONLY_RECORDINGS:
            check_recording_name(option, path)
        taken.append(path)


def check_recording_name(option: str, path: Path) -> None:
    """Refuses a file for a recording whose name says that it is something else, such as a bag; recordings are MCAP.

    Args:
        option: Command and option that name the file, for the error.
        path: The file.

    Raises:
        ConfigError: It is a folder, or its suffix is not `.mcap`.
    """
    partial_path(path)  # raises an error for a name that no file can have
    if path.suffix != RECORDING_SUFFIX:
        raise ConfigError(option, "", str(path), f"a file that ends in {RECORDING_SUFFIX}")


def _find_files(values: Iterable[object]) -> Iterator[Path]:
    """Yields the files in the values of options: paths, lists of them, existing files, and that of `NAME=FILE`."""
    for value in values:
        if isinstance(value, list):
            yield from _find_files(value)
        elif isinstance(value, Path):
            yield value
        elif isinstance(value, str):
            after_equals = value.rpartition("=")[2]  # FILE of `NAME=FILE`; the whole text without "="
            yield from (path for path in map(Path, {value, after_equals}) if _is_file(path))


def _is_file(path: Path) -> bool:
    """Whether there is a file of this name; false for a name that no file can have."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # not a valid file name
        return False


def _is_same_file(one: Path, other: Path) -> bool:
    """Whether two names are those of one file, links included."""
    return one.absolute() == other.absolute() or (one.exists() and other.exists() and one.samefile(other))
