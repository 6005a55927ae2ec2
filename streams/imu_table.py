"""A single IMU's table, `.npz` or `.csv`, as a block of samples."""

from __future__ import annotations

import csv
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.samples import Array, Block, Imu

MIN_ROWS = 20
RATES_HZ = (20.0, 5000.0)
_GRAVITY = 9.81
_REST_SPREAD = 0.15
_AXES = "xyz"
_NAMES = {"accel": ("accel_{}", "a{}", "acc_{}"), "gyro": ("gyro_{}", "g{}", "w{}")}
_FASTEST = 60.0  # rad/s: 3400 °/s, beyond what foot-worn gyros measure


def read_imu_table(path: str | Path, topic: str = "/foot/imu") -> Block[Imu]:
    """Reads `t` (s), `accel` (m/s²) and `gyro` (rad/s) from a table, and checks that they can be that.

    Args:
        path: `.npz` with `t` (N,), `accel` (N, 3) and `gyro` (N, 3), or `.csv` with a header and the columns
            `t`, `accel_x` ... (or `ax` ...) and `gyro_x` ... (or `gx` ...).
        topic: Topic that the samples get.

    Returns:
        One sample a row. Times are rounded to ns.

    Raises:
        StrideTwinError: The table cannot be read or is not valid; names file, column, row and value.
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
    _check_units(path, accel, gyro)
    return Block(
        topic=topic,
        kind=Imu,
        t_ns=np.rint(t * 1e9).astype(np.int64),
        columns={"angular_rate": gyro, "specific_force": accel},
    )


def _read_npz(path: Path) -> tuple[Array, Array, Array]:
    try:
        with np.load(path, allow_pickle=False) as table:
            columns: dict[str, NDArray[Any]] = {n: table[n] for n in ("t", "accel", "gyro") if n in table}
            there = table.files
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise StrideTwinError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    for name, shape in (("t", "(N,)"), ("accel", "(N, 3)"), ("gyro", "(N, 3)")):
        if name not in columns:
            raise ConfigError(path, name, None, f"an array {name} {shape}; the table has {', '.join(there) or 'none'}")
        want = (len(columns["t"]),) if name == "t" else (len(columns["t"]), 3)
        if columns[name].shape != want or columns[name].dtype.kind not in "fiu":
            raise ConfigError(path, name, f"{columns[name].dtype} {columns[name].shape}", f"numbers of shape {want}")
    return tuple(columns[n].astype(np.float64) for n in ("t", "accel", "gyro"))  # type: ignore[return-value]


def _read_csv(path: Path) -> tuple[Array, Array, Array]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = [line for line in csv.reader(file) if line]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise StrideTwinError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    header = [name.strip() for name in lines[0]] if lines else []
    where = [_column(path, header, ("t",))]
    for quantity in ("accel", "gyro"):
        where += [_column(path, header, [n.format(axis) for n in _NAMES[quantity]]) for axis in _AXES]
    table = np.empty((len(lines) - 1, 7))
    for i, line in enumerate(lines[1:]):
        for k, at in enumerate(where):
            try:
                table[i, k] = float(line[at])
            except (ValueError, IndexError):
                value = line[at] if at < len(line) else None
                raise ConfigError(path, f"{header[at]}, row {i + 1}", value, "a number") from None
    return table[:, 0], table[:, 1:4], table[:, 4:7]


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
            path, f"t, row {row + 1}", float(t[row]), f"a time after that of the row before, {t[row - 1]:g} s"
        )
    if t[0] < 0:
        raise ConfigError(path, "t, row 1", float(t[0]), "a time from 0 s on")
    rate = 1.0 / float(np.median(step))
    low, high = RATES_HZ
    if not low <= rate <= high:
        hint = "; is t in milliseconds or nanoseconds?" if rate < low else ""
        raise ConfigError(path, "t", f"{rate:g} Hz", f"a rate of {low:g} to {high:g} Hz, t in s{hint}")


def _check_units(path: Path, accel: Array, gyro: Array) -> None:
    """Gravity must show where the sensor turns least, and no foot turns faster than any gyro measures."""
    turning = np.linalg.norm(gyro, axis=1)
    at_rest = turning <= np.percentile(turning, 10)
    force = float(np.median(np.linalg.norm(accel[at_rest], axis=1)))
    if not (1 - _REST_SPREAD) * _GRAVITY < force < (1 + _REST_SPREAD) * _GRAVITY:
        if 0.8 < force < 1.2:
            hint = "; is it in g? Multiply by 9.80665"
        elif 800 < force < 1200:
            hint = "; is it in milli-g? Multiply by 0.00980665"
        elif force < 3:
            hint = "; has gravity been taken out? It must be the raw specific force"
        else:
            hint = ""
        raise ConfigError(path, "accel", f"median magnitude {force:.3g} at rest", f"about 9.8 m/s²{hint}")
    fastest = float(np.percentile(np.abs(gyro), 99.9))
    if fastest > _FASTEST:
        raise ConfigError(path, "gyro", f"up to {fastest:.0f}", "rad/s; is it in °/s? Multiply by 0.0174533")
