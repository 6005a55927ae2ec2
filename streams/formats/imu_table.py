"""Reads and writes the table of a single IMU, `.npz` or `.csv`: `t` (s), `accel` (m/s²), `gyro` (rad/s)."""

from __future__ import annotations

import csv
import zipfile
from array import array
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.bounded import lines
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.files import whole_file
from stridetwin.streams.formats.tum import LATEST_S
from stridetwin.streams.plausible import IMU_RATES_HZ, implausible_rates, implausible_units
from stridetwin.streams.samples import Array, Block, Imu

MIN_ROWS = 20
_FREE_BYTES, _BYTES_PER_BYTE = 16 << 20, 20
_AXES = "xyz"
_NAMES = {"accel": ("accel_{}", "a{}", "acc_{}"), "gyro": ("gyro_{}", "g{}", "w{}")}


def read_imu_table(path: str | Path, topic: str = "/foot/imu") -> Block[Imu]:
    """Reads `t` (s), `accel` (m/s²) and `gyro` (rad/s) from a table, and checks that they are plausible.

    Args:
        path: `.npz` with `t` (N,), `accel` (N, 3) and `gyro` (N, 3), or `.csv` with a header and the columns
            `t`, `accel_x` ... (or `ax` ...) and `gyro_x` ... (or `gx` ...).
        topic: Topic of the samples.

    Returns:
        One sample per row. Times are rounded to ns.

    Raises:
        StrideTwinError: The table cannot be read or is invalid; names file, column, row and value.
    """
    path = Path(path)
    if path.suffix == ".npz":
        t, accel, gyro = _read_npz(path)
    elif path.suffix == ".csv":
        t, accel, gyro = _read_csv(path)
    else:
        raise ConfigError(path, "", path.suffix, "a table .npz or .csv")
    _check_numbers(path, t, accel, gyro)
    _check_times(path, t)
    t_ns = np.rint(t * 1e9).astype(np.int64)
    for found in (*implausible_rates(t_ns, IMU_RATES_HZ), *implausible_units(t_ns, accel, gyro)):
        raise ConfigError(path, found.field, found.value, found.valid)
    return Block(
        topic=topic,
        kind=Imu,
        t_ns=t_ns,
        columns={"angular_rate": gyro, "specific_force": accel},
    )


def _read_npz(path: Path) -> tuple[Array, Array, Array]:
    try:
        _check_packing(path)
        with np.load(path, allow_pickle=False) as table:
            columns: dict[str, NDArray[Any]] = {n: table[n] for n in ("t", "accel", "gyro") if n in table}
            there = table.files
    except StrideTwinError:
        raise
    except Exception as error:  # damaged ZIP files raise many unrelated exceptions
        words = " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
        raise StrideTwinError(f"{path}: cannot be read: {words[:200]}") from error
    for name, shape in (("t", "(N,)"), ("accel", "(N, 3)"), ("gyro", "(N, 3)")):
        if name not in columns:
            raise ConfigError(path, name, None, f"an array {name} {shape}; the table has {', '.join(there) or 'none'}")
        count = columns["t"].size
        want = (count,) if name == "t" else (count, 3)
        if columns[name].shape != want or columns[name].dtype.kind not in "fiu":
            raise ConfigError(path, name, f"{columns[name].dtype} {columns[name].shape}", f"numbers of shape {want}")
    return tuple(columns[n].astype(np.float64) for n in ("t", "accel", "gyro"))  # type: ignore[return-value]


def _check_packing(path: Path) -> None:
    """Rejects arrays that unpack to more bytes than sensor data.

    Raises:
        ConfigError: An array is too large.
        zipfile.BadZipFile: The file is not a ZIP file.
    """
    with zipfile.ZipFile(path) as packed:
        for member in packed.infolist():
            most = _FREE_BYTES + _BYTES_PER_BYTE * member.compress_size
            if member.file_size > most:
                raise ConfigError(path, f"size of {member.filename[:40]}, unpacked", member.file_size, f"up to {most}")


def _read_csv(path: Path) -> tuple[Array, Array, Array]:
    header: list[str] | None = None
    where: list[int] = []
    table = array("d")
    row = 0
    try:
        for line in csv.reader(lines(path, "utf-8-sig")):
            if not line:
                continue
            if header is None:
                header = [name.strip() for name in line]
                where = _columns(path, header)
                continue
            row += 1
            for at in where:
                try:
                    table.append(float(line[at]))
                except (ValueError, IndexError):
                    value = line[at] if at < len(line) else None
                    raise ConfigError(path, f"{header[at]}, row {row}", value, "a number") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise StrideTwinError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if header is None:
        _columns(path, [])
    numbers = np.array(table).reshape(-1, 7)
    return numbers[:, 0], numbers[:, 1:4], numbers[:, 4:7]


def _columns(path: Path, header: list[str]) -> list[int]:
    """Indices of `t`, the accelerations and the rates."""
    where = [_column(path, header, ("t",))]
    for quantity in ("accel", "gyro"):
        where += [_column(path, header, [n.format(axis) for n in _NAMES[quantity]]) for axis in _AXES]
    return where


def _column(path: Path, header: list[str], names: Sequence[str]) -> int:
    for name in names:
        if name in header:
            return header.index(name)
    there = ", ".join(header) or "none"
    raise ConfigError(path, names[0], None, f"a column {' or '.join(names)}; the table has {there}")


def _check_numbers(path: Path, t: Array, accel: Array, gyro: Array) -> None:
    if len(t) < MIN_ROWS:
        raise ConfigError(path, "rows", len(t), f"at least {MIN_ROWS}")
    for name, values in (("t", t[:, None]), ("accel", accel), ("gyro", gyro)):
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            row, axis = bad[0]
            column = name if name == "t" else f"{name}_{_AXES[axis]}"
            raise ConfigError(path, f"{column}, row {row + 1}", float(values[row, axis]), "a finite number")


def _check_times(path: Path, t: Array) -> None:
    step = np.diff(t)
    if np.any(step < 1e-9):
        row = int(np.argmax(step < 1e-9)) + 1
        raise ConfigError(
            path, f"t, row {row + 1}", float(t[row]), f"a time after that of the previous row, {t[row - 1]:g} s"
        )
    if t[0] < 0:
        raise ConfigError(path, "t, row 1", float(t[0]), "a time from 0 s on")
    if t[-1] >= LATEST_S:
        raise ConfigError(path, f"t, row {len(t)}", float(t[-1]), f"a time before {LATEST_S:g} s")


TABLES = (".npz", ".csv")
_HEADER = "t,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z"


def write_imu_table(path: Path, block: Block[Imu]) -> None:
    """Writes a `.npz` or `.csv` that `read_imu_table` reads back, whole or not at all.

    Raises:
        ConfigError: Another suffix.
    """
    t, accel, gyro = block.t_ns * 1e-9, block.columns["specific_force"], block.columns["angular_rate"]
    if path.suffix not in TABLES:
        raise ConfigError(path, "", path.suffix, f"a table {' or '.join(TABLES)}")
    with whole_file(path) as temporary, temporary.open("wb") as file:
        if path.suffix == ".npz":
            np.savez_compressed(file, t=t, accel=accel, gyro=gyro)
        else:
            rows = np.column_stack([t, accel, gyro])
            np.savetxt(file, rows, fmt=["%.9f"] + ["%.9g"] * 6, delimiter=",", header=_HEADER, comments="")
