"""What the fuzzer opens, as a user does: tables, calibration files, trajectories, bags and folders, and their seeds."""

from __future__ import annotations

import ast
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from benchmarks import foreign_files
from benchmarks.foreign_files import Walk
from benchmarks.fuzz_mutators import MOST_BYTES, Members, read_members
from stridetwin.scenarios.check import check_recording, check_table
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.imu_columns import parse_mapping
from stridetwin.streams.formats.imu_text import TableRequest
from stridetwin.streams.formats.opening import ImportOptions, open_any
from stridetwin.streams.formats.trajectory_file import read_trajectory
from stridetwin.streams.formats.trajectory_options import TrajectoryOptions
from stridetwin.streams.kalibr import read_rig
from stridetwin.streams.recording.index import Notes

ROOT = Path(__file__).resolve().parents[1]
"""Folder of the project."""
SPAN_NS = (0, 22_000_000_000)
"""First and last stamp of the recording of the seeds' trajectories, ns."""
SIZE = (752, 480)
"""Width and height of the images of the seeds' calibrations, px."""
_ROWS = 60
"""Most poses and samples of a seed: more would only slow the readers down."""
_LINES = 700
"""Most lines of a table, some of which have a line for each value."""
_IMAGES = 4
"""Most images of a seed."""
_LONGEST_WORD = 24
"""Longest word of the dictionary, characters."""


@dataclass(frozen=True)
class Target:
    """A kind of input.

    Attributes:
        name: Of the command line.
        list_seeds: The seeds by their names; it may write to the folder that it gets.
        open: Opens a source, written to a folder, as a user does, and gives every text that the user reads.
    """

    name: str
    list_seeds: Callable[[Path], Iterator[tuple[str, Members]]]
    open: Callable[[Path, Members], list[str]]


def open_recording(source: Path, members: Members) -> list[str]:
    """Opens a source strictly and leniently, reads all samples, and checks it.

    Args:
        source: File or folder.
        members: The input, whose members `--columns` and `--rate` are options.

    Returns:
        Warnings, problems, errors, and the table of the check.
    """
    texts: list[str] = []
    for lenient in (False, True):
        try:
            recording = open_any(source, lenient, ImportOptions(table=_read_request(members)))
            for _ in recording.samples():
                pass
            texts += [*recording.warnings, *map(str, recording.problems)]
            texts += [f"{topic}: {reason}" for topic, reason in recording.unread.items()]
            texts += check_table(check_recording(recording))
        except StrideTwinError as error:
            texts += _list_lines(error, source)
    return texts


def _read_request(members: Members) -> TableRequest:
    """The options `--columns` and `--rate` of an input.

    Raises:
        ConfigError: An option is invalid, as the command line refuses it.
    """
    columns = members.get("--columns", b"").decode(errors="replace")
    try:
        rate_hz = float(members["--rate"]) if "--rate" in members else None
    except ValueError as error:  # as the command line refuses it
        raise ConfigError("import", "--rate", members["--rate"], "a number") from error
    if rate_hz is not None and not 0.0 < rate_hz < 1e6:
        raise ConfigError("import", "--rate", rate_hz, "a rate")
    return TableRequest(columns=parse_mapping(columns) if columns else {}, rate_hz=rate_hz)


def _list_lines(error: StrideTwinError, source: Path) -> list[str]:
    """The lines of an error's message, each of which names a file.

    Raises:
        AssertionError: A line names neither the source nor an option.
    """
    lines = str(error).split("\n")
    top = str(source.parent.parent)  # a table of stamps may be beside the folder of poses
    for line in lines:
        if top not in line and not line.startswith(("import: ", "... and ")):  # an option, or the number of others
            raise AssertionError(f"a line of an error names no file: {line[:200]!r}")
    return lines


def open_calibration(source: Path, members: Members) -> list[str]:
    """Reads the first file of an input as a calibration, alone and for a small table; gives warnings and errors."""
    folder = source.parent if source.is_file() else source
    texts: list[str] = []
    file = folder / next(iter(members))
    try:
        rig = read_rig(file, warn=texts.append, sizes={SIZE}, needs_rates=False)
        texts += [*rig.imus, *rig.cameras]
        recording = open_any(_write_table(folder), True, ImportOptions(rig=file))
        texts += [*recording.warnings, *map(str, recording.problems)]
    except StrideTwinError as error:
        texts += _list_lines(error, file)
    return texts


def _write_table(folder: Path) -> Path:
    """A table of an IMU at rest."""
    file = folder / "table_for_the_rig.csv"
    rows = "".join(f"{0.01 * k:.2f},0,0,9.81,0.001,0,{0.001 * (k % 3)}\n" for k in range(20))
    file.write_text("t,ax,ay,az,gx,gy,gz\n" + rows)
    return file


def open_trajectory(source: Path, members: Members) -> list[str]:
    """Reads the first file of an input as a trajectory, with and without a recording's span, and with stamps beside."""
    folder = source.parent if source.is_file() else source
    names = [name for name in members if not name.startswith("--")]
    file = folder / next((name for name in names if name != "times.txt"), names[0])
    times = folder / "times.txt" if "times.txt" in names else None
    texts: list[str] = []
    for span_ns in (None, SPAN_NS):
        notes = Notes(file, lenient=False)
        try:
            trajectory = read_trajectory(file, TrajectoryOptions(times=times), span_ns=span_ns, notes=notes)
            trajectory.with_other_order()
        except StrideTwinError as error:
            texts += _list_lines(error, file)
        texts += notes.warnings
    return texts


def _import_test_files(name: str) -> ModuleType:
    """A module of the tests that writes files."""
    for folder in (ROOT / "tests" / "streams", ROOT / "tests"):
        if str(folder) not in sys.path:
            sys.path.insert(0, str(folder))
    return __import__(name)


def _shorten(members: Members) -> Members:
    """An input whose text files have at most `_LINES` lines."""
    short = {}
    for name, data in members.items():
        lines = data.split(b"\n")
        is_table = name.endswith((".csv", ".txt", ".tsv", ".sto")) and b"\0" not in data
        short[name] = b"\n".join(lines[:_LINES]) if is_table else data
    return short


def _write_seeds(folder: Path, writers: dict[str, Callable[[Path], Path]]) -> Iterator[tuple[str, Members]]:
    """What functions write, each into an empty folder; sources of more than half the largest input are left out."""
    for name, write in writers.items():
        place = folder / "seed"
        place.mkdir()
        members = _shorten(read_members(write(place)))
        if sum(map(len, members.values())) <= MOST_BYTES // 2:
            yield name, members
        shutil.rmtree(place)


def list_tables(folder: Path) -> Iterator[tuple[str, Members]]:
    """Tables of many makers, and one whose columns are given."""
    foreign, loggers = _import_test_files("foreign_tables"), _import_test_files("logger_files")
    writers = {name: write for name, write in foreign.FOREIGN.items() if name != "long preamble"}
    writers |= {"gaitmap": loggers.gaitmap, "opensense": loggers.opensense}
    writers["npz"] = lambda place: foreign_files.write_npz_table(place, _short_walk())
    yield from _write_seeds(folder, writers)
    for name, (write, request) in loggers.ONE.items():
        for _, members in _write_seeds(folder, {name: write}):
            columns = ",".join(f"{key}={column}" for key, column in request.columns.items())
            options = {"--columns": columns, "--rate": f"{request.rate_hz or ''}"}
            yield name, {**members, **{option: text.encode() for option, text in options.items() if text}}
    parts = [f"{k // 60},{k % 60 * 16_000_000},0.1,0.2,9.8,{0.01 * (k % 7)},0,0\n" for k in range(2 * _ROWS)]
    units = [f"{name}_{axis} ({unit})" for name, unit in (("accel", "m/s^2"), ("gyro", "rad/s")) for axis in "xyz"]
    names = ",".join(["stamp.sec", "stamp.nanosec", *units]) + "\n"
    yield "stamps in two columns", {"a.csv": "".join([names, *parts]).encode()}
    body = "\n".join(foreign.BODY[:_ROWS]).encode()
    yield "no header", {"a.csv": body, "--columns": foreign.MAPPING.encode(), "--rate": b"100"}


def list_calibrations(folder: Path) -> Iterator[tuple[str, Members]]:
    """Calibrations of every tool; the file that a user gives comes first."""
    files = _import_test_files("calibration_files")
    for name in sorted(name for name in vars(files) if name.startswith("write_")):
        place = folder / name
        place.mkdir()
        first = getattr(files, name)(place).name
        members = read_members(place)
        yield name[6:], {first: members.pop(first), **members}
    rigs, kalibr = _import_test_files("rigs"), sys.modules["stridetwin.streams.kalibr"]
    yield "ours", {"rig.yaml": kalibr.rig_to_yaml(rigs.small_rig()).encode()}
    yield "camera_info", {"camera.yaml": _CAMERA_INFO.encode()}


_CAMERA_INFO = """\
image_width: 640
image_height: 480
camera_name: head
camera_matrix:
  rows: 3
  cols: 3
  data: [600.0, 0.0, 320.0, 0.0, 600.0, 240.0, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.1, -0.2, 0.001, 0.002, 0.0]
"""
"""A calibration as ROS's `camera_calibration` writes it."""


def list_trajectories(_: Path) -> Iterator[tuple[str, Members]]:
    """Trajectories in the forms of common tools."""
    forms = _import_test_files("test_trajectory_files")
    for name, (rows, header, separator, options) in forms.FORMS.items():
        body = "".join(separator.join(row) + "\n" for row in rows[:_ROWS])
        members = {"path.csv" if separator == "," else "path.txt": (header + body).encode()}
        if "times" in options:
            members["times.txt"] = "".join(f"{t:.3f}\n" for t in forms.T_S[:_ROWS]).encode()
        yield name, members


def _short_walk() -> Walk:
    """The walk of the foreign files, cut to the first samples and images."""
    walk = Walk()
    for name in ("t", "gyro", "accel", "p", "q"):
        setattr(walk, name, getattr(walk, name)[:_ROWS])
    for name in ("t_images", "colour", "depth_mm"):
        setattr(walk, name, getattr(walk, name)[:_IMAGES])
    return walk


def _write_walk(write: Callable[[Path, Walk], Path]) -> Callable[[Path], Path]:
    """A writer of a folder that gets the short walk."""
    return lambda place: write(place, _short_walk())


def list_bags(folder: Path) -> Iterator[tuple[str, Members]]:
    """MCAP files of ours and of other programs, and bags of ROS 1 and ROS 2 in both storages."""
    names = ("mcap", "mcap_foreign", "rosbag1", "rosbag2_mcap")
    writers = {name: _write_walk(foreign_files.FORMATS[name]) for name in names}
    writers["realsense"] = _write_walk(foreign_files.write_realsense_bag)
    robots = _import_test_files("robot_files")
    streams = {
        "/xsens/lfoot/imu": (robots.IMU_TYPE, robots.still_imu(count=40)),
        "/camera/image": (robots.IMAGE_TYPE, [(t, robots.grey_message(t)) for t, _ in robots.still_imu(count=3)]),
        "/camera/camera_info": (robots.INFO_TYPE, [(robots.START_NS, robots.info_message(robots.START_NS, 30.0))]),
    }
    writers["robot"] = lambda place: robots.write_bag(place / "bag", streams)
    yield from _write_seeds(folder, writers)
    with tempfile.TemporaryDirectory() as place:
        bag = foreign_files.write_rosbag1(Path(place), _short_walk())
        yield "ros1_in_mcap", read_members(robots.convert_to_mcap(bag, Path(place) / "walk.mcap"))


def list_folders(folder: Path) -> Iterator[tuple[str, Members]]:
    """Folders of EuRoC, TUM RGB-D, 7-Scenes, OpenLORIS and the apps of phones."""
    names = ("euroc", "tum", "7scenes")
    writers = {name: _write_walk(foreign_files.FORMATS[name]) for name in names}
    writers["openloris"] = _import_test_files("test_openloris").write_folder
    scans = _import_test_files("scan_files")
    writers |= {"strayscanner": lambda place: scans.stray_scanner(place, video=False), "record3d": scans.record3d}
    yield from _write_seeds(folder, writers)


TARGETS = {
    target.name: target
    for target in (
        Target("table", list_tables, open_recording),
        Target("calibration", list_calibrations, open_calibration),
        Target("trajectory", list_trajectories, open_trajectory),
        Target("bag", list_bags, open_recording),
        Target("folder", list_folders, open_recording),
    )
}
"""The kinds of inputs by their names."""


def list_words() -> list[str]:
    """Words of the dictionary: the short strings in the sources of the readers, such as keys and names of columns."""
    vocabulary: set[str] = set()
    for file in sorted((ROOT / "streams").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            text = node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""
            if 0 < len(text) <= _LONGEST_WORD and text.isprintable():
                vocabulary.add(text)
    return sorted(vocabulary)


def write_dictionary(file: Path) -> None:
    """Writes the words in libFuzzer's form of a dictionary."""
    escaped = ("".join(f"\\x{byte:02x}" for byte in word.encode()) for word in list_words())
    file.write_text("".join(f'"{text}"\n' for text in escaped))
