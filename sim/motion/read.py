"""Readers of motion capture: tables of markers, of joint angles, and of force plates, one function per format."""

from __future__ import annotations

import gzip
import io
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stridetwin.streams.errors import ConfigError, explain_import_error, read_error
from stridetwin.streams.samples import Array

_MAX_BYTES = 512 * 1024 * 1024  # of an unpacked file
_UNITS_M = {"m": 1.0, "meters": 1.0, "cm": 0.01, "mm": 0.001}
_MIN_FRAMES = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkerTable:
    """Paths of markers in the axes of the laboratory.

    Attributes:
        source: File.
        names: (M,) of the markers.
        t: (N,) s, evenly spaced.
        x: (N, M, 3) m; NaN where a marker was not seen.
    """

    source: str
    names: tuple[str, ...]
    t: Array
    x: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class NumberTable:
    """Columns of numbers over time: joint angles or force plates.

    Attributes:
        source: File.
        names: (C,) of the columns, without the time.
        t: (N,) s, increasing.
        values: (N, C) in the file's units, angles in rad.
    """

    source: str
    names: tuple[str, ...]
    t: Array
    values: Array

    def column(self, name: str) -> Array:
        """(N,) values of a column.

        Raises:
            ConfigError: There is no such column.
        """
        if name not in self.names:
            raise ConfigError(self.source, "columns", name, ", ".join(self.names))
        return self.values[:, self.names.index(name)]


def read_markers(path: Path) -> MarkerTable:
    """Markers of a `.trc` or `.c3d` file, possibly packed with gzip.

    Raises:
        ConfigError: A file of another kind, or with invalid content.
    """
    kind = _kind_of(path)
    if kind == ".trc":
        return read_trc(path)
    if kind == ".c3d":
        return read_c3d(path)
    raise ConfigError(path, "", path.name, "a file of markers, .trc or .c3d, possibly .gz")


def read_trc(path: Path) -> MarkerTable:
    """Markers of a `.trc` file; markers at exactly (0, 0, 0) and empty cells are gaps.

    Raises:
        ConfigError: The file is not a table of markers.
    """
    lines = read_text(path).splitlines()
    if len(lines) < 6 or not lines[0].startswith("PathFileType"):
        raise ConfigError(path, "line 1", lines[0][:40] if lines else "", "PathFileType, and five lines of a head")
    head = dict(zip(lines[1].split("\t"), lines[2].split("\t")))
    unit = head.get("Units", "").strip().lower()
    if unit not in _UNITS_M:
        raise ConfigError(path, "Units", unit, ", ".join(_UNITS_M))
    names = tuple(cell.strip() for cell in lines[3].split("\t")[2:] if cell.strip())
    if not names:
        raise ConfigError(path, "line 4", lines[3][:40], "names of markers after Frame# and Time")
    rows = []
    for number, line in enumerate(lines[5:], start=6):
        cells = line.rstrip("\r\n").split("\t")
        if not any(cell.strip() for cell in cells):
            continue
        cells = (cells + [""] * (2 + 3 * len(names)))[: 2 + 3 * len(names)]
        rows.append([_to_number(path, f"line {number}", cell) for cell in cells])
    table = np.array(rows, dtype=float).reshape(len(rows), -1)
    check_length(path, len(table))
    x = table[:, 2:].reshape(len(table), len(names), 3) * _UNITS_M[unit]
    x[np.all(x == 0.0, axis=2)] = np.nan
    return _to_markers(path, names, table[:, 1], x)


def read_c3d(path: Path) -> MarkerTable:
    """Markers of a `.c3d` file; points whose residual is negative are gaps.

    Raises:
        ConfigError: The file is no `.c3d` file, or has no markers.
        StrideTwinError: The library `ezc3d` is not installed.
    """
    with explain_import_error("a .c3d file", "mocap"):
        import ezc3d

    if path.suffix == ".gz":  # the library reads files by name alone
        with tempfile.TemporaryDirectory() as folder:
            unpacked = Path(folder) / path.stem
            unpacked.write_bytes(_read_bytes(path))
            return _read_c3d(path, unpacked, ezc3d)
    return _read_c3d(path, path, ezc3d)


def _read_c3d(source: Path, path: Path, ezc3d: object) -> MarkerTable:
    """Markers of an unpacked `.c3d` file; `source` is named in messages."""
    try:
        content = ezc3d.c3d(str(path))  # type: ignore[attr-defined]
    except OSError as error:
        raise ConfigError(source, "", str(error), "a .c3d file") from None
    except Exception as error:  # the library raises its own errors of C++ as bare exceptions
        raise ConfigError(source, "", str(error)[:80], "a .c3d file") from None
    point = content["parameters"]["POINT"]
    names = tuple(str(name) for name in point.get("LABELS", {"value": []})["value"])
    points = np.asarray(content["data"]["points"])
    if not names or points.size == 0:
        raise ConfigError(source, "POINT.LABELS", list(names), "markers; this file has none")
    unit = str((point.get("UNITS", {"value": ["mm"]})["value"] or ["mm"])[0]).strip().lower() or "mm"
    if unit not in _UNITS_M:
        raise ConfigError(source, "POINT.UNITS", unit, ", ".join(_UNITS_M))
    rate = float(point["RATE"]["value"][0])
    if not rate > 0.0:
        raise ConfigError(source, "POINT.RATE", rate, "a number of frames per second > 0")
    x = np.moveaxis(points[:3, : len(names)], 2, 0).transpose(0, 2, 1) * _UNITS_M[unit]
    x[np.all(x == 0.0, axis=2)] = np.nan
    residuals = content["data"].get("meta_points", {}).get("residuals")
    if residuals is not None and np.size(residuals):
        x[np.asarray(residuals)[0, : len(names)].T < 0.0] = np.nan
    check_length(source, len(x))
    return _to_markers(source, names, np.arange(len(x)) / rate, x)


def read_number_table(path: Path) -> NumberTable:
    """A `.mot` or `.sto` file of OpenSim; joint angles in degrees are converted.

    Raises:
        ConfigError: The file has no head, or cells that are no numbers.
    """
    lines = read_text(path).splitlines()
    ends = [i for i, line in enumerate(lines) if line.strip().lower() == "endheader"]
    if not ends or ends[0] + 2 > len(lines):
        raise ConfigError(path, "", lines[0][:40] if lines else "", "a head that ends with a line endheader")
    in_degrees = any(line.replace(" ", "").lower() == "indegrees=yes" for line in lines[: ends[0]])
    names = tuple(cell.strip() for cell in lines[ends[0] + 1].split("\t") if cell.strip())
    if not names or names[0].lower() != "time":
        raise ConfigError(path, f"line {ends[0] + 2}", names[:3], "names of columns, time first")
    rows = []
    for number, line in enumerate(lines[ends[0] + 2 :], start=ends[0] + 3):
        cells = line.split()
        if not cells:
            continue
        if len(cells) != len(names):
            raise ConfigError(path, f"line {number}", len(cells), f"{len(names)} numbers")
        rows.append([_to_number(path, f"line {number}", cell) for cell in cells])
    table = np.array(rows, dtype=float).reshape(len(rows), len(names))
    check_length(path, len(table))
    t, values = table[:, 0], table[:, 1:]
    if not (np.isfinite(t).all() and (np.diff(t) > 0.0).all()):
        raise ConfigError(path, "time", t[:3].tolist(), "increasing s")
    if in_degrees:
        is_angle = [not name.endswith(("_tx", "_ty", "_tz")) for name in names[1:]]
        values[:, is_angle] = np.radians(values[:, is_angle])
    return NumberTable(source=str(path), names=names[1:], t=t, values=values)


def total_plate_force(table: NumberTable) -> Array:
    """(N, 3) N, force of all plates of an OpenSim ground reaction file on the person, axes of the laboratory."""
    axes = [
        [name for name in table.names if "force" in name and name.endswith(f"v{axis}")] for axis in "xyz"
    ]  # columns such as ground_force_1_vx
    if not all(axes):
        raise ConfigError(table.source, "columns", list(table.names[:6]), "forces such as ground_force_1_vx")
    return np.stack([np.sum([table.column(name) for name in names], axis=0) for names in axes], axis=1)


def _to_markers(source: Path, names: Sequence[str], t: Array, x: Array) -> MarkerTable:
    """Checked table of markers, without the markers that were never seen."""
    if not (np.isfinite(t).all() and (np.diff(t) > 0.0).all()):
        raise ConfigError(source, "Time", t[:3].tolist(), "increasing s")
    dt = np.diff(t)
    if dt.max() > 1.5 * np.median(dt):
        raise ConfigError(source, "Time", float(dt.max()), f"frames every {np.median(dt):.4g} s, none missing")
    seen = np.asarray(np.isfinite(x).all(axis=2))
    if np.nanmax(np.abs(np.where(seen[..., None], x, 0.0)), initial=0.0) > 1e3:
        raise ConfigError(source, "Units", "places beyond 1 km", "markers within a laboratory")
    x = np.where(seen[..., None], x, np.nan)
    kept = np.asarray(seen.any(axis=0))
    return MarkerTable(
        source=str(source),
        names=tuple(name for name, is_kept in zip(names, kept) if is_kept),
        t=np.linspace(0.0, t[-1] - t[0], len(t)) + t[0],
        x=x[:, kept],
    )


def check_length(path: Path, frames: int) -> None:
    """Rejects a table that is too short to be a walk."""
    if frames < _MIN_FRAMES:
        raise ConfigError(path, "frames", frames, f"at least {_MIN_FRAMES}")


def _to_number(path: Path, field: str, cell: str) -> float:
    """A cell as a number; an empty one is NaN."""
    try:
        return float(cell) if cell.strip() else np.nan
    except ValueError:
        raise ConfigError(path, field, cell, "numbers") from None


def _kind_of(path: Path) -> str:
    """Suffix of a file without that of gzip, in lower case."""
    return (Path(path.stem).suffix if path.suffix.lower() == ".gz" else path.suffix).lower()


def _read_bytes(path: Path) -> bytes:
    """Content of a file, unpacked if its name ends in `.gz`."""
    try:
        if path.suffix.lower() != ".gz":
            return path.read_bytes()
        with gzip.open(path) as packed:
            content = packed.read(_MAX_BYTES + 1)
    except (EOFError, gzip.BadGzipFile) as error:
        raise ConfigError(path, "", str(error), "a file packed by gzip") from None
    except OSError as error:
        raise read_error(path, error) from None
    if len(content) > _MAX_BYTES:
        raise ConfigError(path, "size", f"more than {_MAX_BYTES} bytes", "a smaller recording")
    return content


def read_text(path: Path) -> str:
    """Text of a file, unpacked if its name ends in `.gz`; characters that are no UTF-8 become question marks."""
    return io.TextIOWrapper(io.BytesIO(_read_bytes(path)), encoding="utf-8", errors="replace").read()
