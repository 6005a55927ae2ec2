"""Folders of tables of inertial sensors: one for the forces and one for the rates, or one for each sensor.

Sensor Logger: `TotalAcceleration.csv`, or `Accelerometer.csv` and `Gravity.csv`; `Metadata.csv` names the platform,
since iPhones report forces with the opposite sign. phyphox, MetaMotion, Movesense and OpenSense name force and rate in
the files' names.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from stridetwin.streams.bounded import LONGEST_ROW, read_lines
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.imu_columns import missing_axis_error
from stridetwin.streams.formats.imu_text import (
    TablePart,
    TableRequest,
    find_quantities,
    has_table_suffix,
    quantity_of,
    read_text_table,
    without_only_sensor,
)
from stridetwin.streams.formats.imu_units import ACCEL, GYRO
from stridetwin.streams.formats.table_head import read_table_head
from stridetwin.streams.formats.text_encoding import detect_encoding
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.segments import side_of

_MOST_HEADS = 64
"""Files of a folder that are looked at for a header."""
_WITHOUT_GRAVITY = re.compile(r"linear(?!_?accelerations?\.sto)|user", re.IGNORECASE)
"""What names of files of forces without gravity contain, as `LinearAcceleration.csv`."""
_OTHER = re.compile(
    r"gravity|uncalibrated|metadata|magnet|orientation|annotation|high_?-?g|quaternion|euler|magnitudes|^(?:earth|linear)\b",
    re.IGNORECASE,
)
"""What names of files that are neither forces nor rates contain, as `Orientation.csv`."""
_QUANTITY_AND_TAIL = re.compile(
    r"[\W_]*(?:linear_accelerations?|angular_velocity|(?:total)?accel\w*?(?:eration|erometer)|gyr(?:o|oscope)?|acc(?:el)?"
    r"|rotation_?rate)(?![a-z]).*",
    re.IGNORECASE,
)
"""The quantity in a file's name and all that follows, as `_Accelerometer_100Hz`; what is before it names the sensor."""
_TAG = re.compile(r"\W*(?:device ?tag|sensor name|device name)\W+([^,;\t]*)", re.IGNORECASE)
"""Line that gives the name of a sensor, as `DeviceTag: left`."""
_TOTAL, _GRAVITY, _METADATA = "TotalAcceleration.csv", "Gravity.csv", "Metadata.csv"
"""Files of Sensor Logger: forces with gravity, gravity alone (both m/s²), and properties of the phone."""


def is_imu_folder(path: Path) -> bool:
    """Whether a folder has a table of forces or one of rates, by the names or the columns of its files."""
    return bool(_list_complete_tables(path) or _list_tables(path))


def read_folder_parts(path: Path, request: TableRequest, notes: Notes) -> list[TablePart]:
    """Reads the forces and rates of all tables in a folder; those of one sensor have the same sensor name.

    Tables of both, one for each sensor, count before those of one quantity. Gravity in a table of its own is added to
    forces without it, and the sign of an iPhone's forces is corrected; both are reported.

    Args:
        path: The folder.
        request: Columns and rate that the user gives; of a table of one quantity, its columns alone are used.
        notes: Collects what was assumed.

    Raises:
        StrideTwinError: A table cannot be read, or all forces are without gravity.
    """
    tables = _list_tables(path)
    if not tables and request.columns:  # no name tells a quantity: each table is a sensor
        return _read_sensor_tables(_list_text_files(path), request, notes)
    if complete := _list_complete_tables(path):
        return _read_sensor_tables(complete, request, notes)
    parts: list[TablePart] = []
    for file, quantity in tables.items():
        sensor = _QUANTITY_AND_TAIL.sub("", file.stem)  # what the name of the file says beside the quantity
        for part in read_text_table(file, _select_columns(request, quantity), notes, quantity):
            name = part.sensor or sensor
            # of two tables with the same quantity of one sensor the first counts
            if all((earlier.sensor, earlier.quantity) != (name, part.quantity) for earlier in parts):
                parts.append(replace(part, sensor=name))
    if (path / _GRAVITY).is_file() and not (path / _TOTAL).is_file():
        gravity = next(iter(read_text_table(path / _GRAVITY, request, notes, ACCEL)), None)
        if gravity is None:
            raise missing_axis_error(path / _GRAVITY, ACCEL, "x", ())
        parts = [_add_gravity(p, gravity) if p.quantity == ACCEL else p for p in parts]
        notes.warn(f"{_GRAVITY} is added to the forces")
    if all(part.quantity != ACCEL for part in parts):
        # a table of forces without gravity, if there is one, for the message
        without = next((f.name for f in sorted(path.iterdir()) if _WITHOUT_GRAVITY.search(f.name)), None)
        raise ConfigError(path, "forces", without, "an accelerometer with gravity, as the sensor measures it")
    if (path / _METADATA).is_file() and _is_raw_iphone(path / _METADATA):
        notes.warn(f"{_METADATA}: an iPhone's forces have the opposite sign, which is corrected")
        parts = [replace(p, values=-p.values) if p.quantity == ACCEL else p for p in parts]
    parts = _align_zeros(parts)
    names = {part.sensor for part in parts}
    if len(names) == 1 or len(parts) == len(tables) == 2:  # the only sensor needs no name, but keeps its side
        side = side_of(min(names).lower()) if len(names) == 1 else ""
        parts = [replace(part, sensor=part.sensor if side else "") for part in parts]
        return parts
    return without_only_sensor(parts)


def _align_zeros(parts: Sequence[TablePart]) -> list[TablePart]:
    """The parts on the clock of the earliest one, if each counts from its own begin and gives the time of that."""
    zeros = [part.zero_s for part in parts if part.zero_s is not None]
    if len(zeros) < len(parts):
        return list(parts)
    return [replace(part, t=part.t + round(zero - min(zeros), 6)) for part, zero in zip(parts, zeros)]


def _select_columns(request: TableRequest, quantity: str) -> TableRequest:
    """The request with the columns of one quantity alone; all if the user names none of it."""
    letter = "a" if quantity == ACCEL else "g"
    selected = {key: text for key, text in request.columns.items() if key[0] in ("t", "k", letter)}
    return replace(request, columns=selected) if any(key[0] == letter for key in selected) else request


def _read_sensor_tables(files: Sequence[Path], request: TableRequest, notes: Notes) -> list[TablePart]:
    """Reads tables of both quantities; the name of the file is that of the sensor, unless there is one alone."""
    parts: list[TablePart] = []
    for file in files:
        for part in read_text_table(file, request, notes):
            name = " ".join(filter(None, (_name_sensor(file), part.sensor))) if len(files) > 1 else part.sensor
            parts.append(replace(part, sensor=name))
    return parts


def _name_sensor(file: Path) -> str:
    """Name of the sensor of a table: its tag in the lines above the numbers, as of a DOT, and the name of the file."""
    preamble = read_table_head(read_lines(file, detect_encoding(file), LONGEST_ROW)).preamble
    tags = (matched[1].strip() for line in preamble if (matched := _TAG.match(line)) is not None)
    return " ".join(filter(None, (next(tags, ""), file.stem)))


def _list_text_files(path: Path) -> list[Path]:
    """Lists the files in a folder that may be text tables of forces and rates."""
    files = [f for f in sorted(path.iterdir()) if f.is_file() and has_table_suffix(f) and f.suffix != ".sto"]
    return [f for f in files if not _OTHER.search(f.name)]


def _list_complete_tables(path: Path) -> list[Path]:
    """Lists the tables in a folder that have forces and rates, one for each sensor."""
    files = [file for file in _list_text_files(path) if not quantity_of(file.stem)]
    return [file for file in files[:_MOST_HEADS] if find_quantities(file) == {ACCEL, GYRO}]


def _add_gravity(force: TablePart, gravity: TablePart) -> TablePart:
    """A force with gravity (both m/s²) interpolated to its stamps and added."""
    added = np.column_stack([np.interp(force.t, gravity.t, gravity.values[:, k]) for k in range(3)])
    return replace(force, values=force.values + added)


def _list_tables(path: Path) -> dict[Path, str]:
    """Lists the tables of forces or rates in a folder, with the quantity that their names or columns tell.

    Tables of orientation, magnetic field and forces without gravity are left out; `TotalAcceleration.csv` stands for
    all forces where it exists. Columns count where the names of files tell nothing, as in other languages.
    """
    files = [f for f in sorted(path.iterdir()) if f.is_file() and has_table_suffix(f) and not _OTHER.search(f.name)]
    files = [f for f in files if not _WITHOUT_GRAVITY.search(f.name)]
    tables = {file: quantity_of(file.stem) for file in files if quantity_of(file.stem)}
    for file in files[:_MOST_HEADS]:
        if file in tables or file.suffix == ".sto" or {ACCEL, GYRO} <= set(tables.values()):
            continue
        if len(kinds := find_quantities(file)) == 1:
            tables[file] = kinds.pop()
    if (path / _TOTAL).is_file():
        tables = {file: kind for file, kind in tables.items() if file.name == _TOTAL or kind == GYRO}
    return tables


def _is_raw_iphone(file: Path) -> bool:
    """Whether Sensor Logger's metadata name an iPhone whose forces have Apple's sign, opposite to Android's.

    The app can write both platforms' measurements alike; the metadata then say that they are standardised.

    Args:
        file: `Metadata.csv`: a row of names and a row of values.

    Raises:
        StrideTwinError: The file cannot be read.
    """
    try:
        rows = list(csv.reader(read_lines(file, detect_encoding(file))))
    except csv.Error as error:
        raise StrideTwinError(f"{file}: cannot be read: {error}") from error
    properties = dict(zip(*rows[:2])) if len(rows) > 1 else {}  # value by name
    is_iphone = properties.get("platform", "").lower() == "ios"
    return is_iphone and properties.get("standardisation", "").lower() != "true"
