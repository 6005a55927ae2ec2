"""Folders in which an app or a logger leaves forces and rates in separate tables: which of them belong together.

Sensor Logger: `TotalAcceleration.csv`, or `Accelerometer.csv` and `Gravity.csv`; `Metadata.csv` names the platform,
since iPhones report forces with the opposite sign. phyphox, MetaMotion, Movesense and OpenSense name force and rate in
the files' names.
"""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from stridetwin.streams.bounded import lines
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.imu_text import SUFFIXES, Part, TableRequest, quantity_of, read_text_table
from stridetwin.streams.formats.units import ACCEL, GYRO
from stridetwin.streams.recording.index import Notes

_WITHOUT_GRAVITY = re.compile(r"linear(?!_?accelerations?\.sto)|user", re.IGNORECASE)
_OTHER = re.compile(r"gravity|uncalibrated|metadata|magnet|orientation|annotation", re.IGNORECASE)
_WORDS = re.compile(
    r"[\W_]*(?:linear_accelerations?|angular_velocity|(?:total)?accel\w*?(?:eration|erometer)|gyr(?:o|oscope)?|acc(?:el)?"
    r"|rotation_?rate)(?![a-z]).*",
    re.IGNORECASE,
)
_TOTAL, _GRAVITY, _METADATA = "TotalAcceleration.csv", "Gravity.csv", "Metadata.csv"


def is_imu_folder(path: Path) -> bool:
    """Whether a folder has a table of forces and one of rates, by the names of its files."""
    return {ACCEL, GYRO} <= {quantity_of(file.stem) for file in _tables(path)}


def folder_parts(path: Path, request: TableRequest, notes: Notes) -> list[Part]:
    """The forces and rates of the tables in a folder; those of one sensor have the same name.

    Raises:
        StrideTwinError: A table cannot be read, or only forces without gravity are there.
    """
    found: list[Part] = []
    for file in _tables(path):
        sensor = _WORDS.sub("", file.stem)
        for part in read_text_table(file, request, notes):
            name = part.sensor or sensor
            if all((other.sensor, other.quantity) != (name, part.quantity) for other in found):
                found.append(replace(part, sensor=name))
    if (path / _GRAVITY).is_file() and not (path / _TOTAL).is_file():
        (gravity,) = read_text_table(path / _GRAVITY, request, notes, ACCEL)
        found = [_with_gravity(p, gravity) if p.quantity == ACCEL else p for p in found]
        notes.warn(f"{_GRAVITY} is added to the forces")
    if all(part.quantity != ACCEL for part in found):
        without = next((f.name for f in sorted(path.iterdir()) if _WITHOUT_GRAVITY.search(f.name)), None)
        raise ConfigError(path, "forces", without, "an accelerometer with gravity, as the sensor measures it")
    if (path / _METADATA).is_file() and _is_raw_iphone(path / _METADATA):
        notes.warn(f"{_METADATA}: an iPhone's forces have the opposite sign, which is corrected")
        found = [replace(p, values=-p.values) if p.quantity == ACCEL else p for p in found]
    if len({part.sensor for part in found}) == 1:
        found = [replace(part, sensor="") for part in found]
    return found


def _with_gravity(force: Part, gravity: Part) -> Part:
    added = np.column_stack([np.interp(force.t, gravity.t, gravity.values[:, k]) for k in range(3)])
    return replace(force, values=force.values + added)


def _tables(path: Path) -> list[Path]:
    """The tables of forces and rates in a folder; forces with gravity before those that get it added."""
    files = [f for f in sorted(path.iterdir()) if f.is_file() and f.suffix in SUFFIXES and quantity_of(f.stem)]
    files = [f for f in files if not _OTHER.search(f.name) and not _WITHOUT_GRAVITY.search(f.name)]
    if (path / _TOTAL).is_file():
        files = [f for f in files if f.name == _TOTAL or quantity_of(f.stem) == GYRO]
    return files


def _is_raw_iphone(file: Path) -> bool:
    """Whether Sensor Logger's metadata name an iPhone whose frames are not those of Android."""
    try:
        rows = list(csv.reader(lines(file, "utf-8-sig")))
    except csv.Error as error:
        raise StrideTwinError(f"{file}: cannot be read: {error}") from error
    row = dict(zip(*rows[:2])) if len(rows) > 1 else {}
    return row.get("platform", "").lower() == "ios" and row.get("standardisation", "").lower() != "true"
