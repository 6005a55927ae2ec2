"""Triangles of a mesh file, `.stl`, `.obj` or `.ply`, up to a size limit; materials and other files are ignored."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.streams.bounded import read_bytes
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.samples import Array

MOST_TRIANGLES = 100_000
_LARGEST_FILE = 32 << 20
_FARTHEST_M = 1000.0
_SUFFIXES = (".stl", ".obj", ".ply")


def read_triangles(path: Path, scale: float) -> Array:
    """(T, 3, 3) m, corners of the triangles of a mesh.

    Args:
        path: The file.
        scale: Metres in its unit.

    Raises:
        ConfigError: Another kind of file, one that is too large, or one with invalid coordinates.
        StrideTwinError: The file cannot be read.
    """
    import trimesh  # slow to import

    kind = path.suffix.lower()
    if kind not in _SUFFIXES:
        raise ConfigError(path, "mesh", path.suffix, ", ".join(_SUFFIXES))
    try:
        data = read_bytes(path, _LARGEST_FILE)
        _check_declared(path, kind, data)
        more = {"skip_materials": True} if kind == ".obj" else {}
        mesh: Any = trimesh.load(
            io.BytesIO(data), file_type=kind[1:], process=False, force="mesh", resolver=None, **more
        )
        corners: Array = np.asarray(mesh.vertices, dtype=np.float64)[np.asarray(mesh.faces)]
    except OSError as error:
        raise StrideTwinError(f"{path}: cannot be read: {error.strerror or error}") from error
    except StrideTwinError:
        raise
    except Exception as error:  # the parsers do not validate their input
        words = " ".join(str(error).split()) or type(error).__name__
        raise StrideTwinError(f"{path}: no {kind[1:].upper()} mesh: {words[:200]}") from error
    if not 0 < len(corners) <= MOST_TRIANGLES:
        raise ConfigError(path, "triangles", len(corners), f"1-{MOST_TRIANGLES}")
    corners = scale * corners
    if not np.all(np.abs(corners) < _FARTHEST_M):
        raise ConfigError(path, "coordinates", "NaN or far away", f"numbers within {_FARTHEST_M:g} m (unit: mm?)")
    return np.asarray(corners)


def _check_declared(path: Path, kind: str, data: bytes) -> None:
    """Rejects a header that declares more elements than the file can hold."""
    most = MOST_TRIANGLES
    if kind == ".stl" and not data[:512].lstrip().startswith(b"solid"):
        count = int.from_bytes(data[80:84], "little")
        if count > most or len(data) < 84 + 50 * count:
            raise ConfigError(path, "triangles declared", count, f"up to {most}, as many as there are")
    elif kind == ".ply":
        head = data[: data.find(b"end_header") + 1][:20_000]
        counts = [int(n) for n in re.findall(rb"element\s+\w+\s+(\d{1,18})", head)]
        if not counts or max(counts) > 10 * most or sum(counts) > len(data):
            raise ConfigError(path, "elements declared", counts, f"up to {10 * most}, as many as there are")
    elif data.count(b"\nf ") > most or data.count(b"\nfacet") > most or data.count(b"\n") > 40 * most:
        raise ConfigError(path, "lines", data.count(b"\n"), f"a mesh of up to {most} triangles")
