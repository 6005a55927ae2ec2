"""Triangles of mesh files (`.stl`, `.obj`, `.ply`, `.glb`, `.gltf`), with limits for untrusted files.

Materials are ignored. A `.gltf` may have its numbers in files beside it.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from stridetwin.streams.bounded import read_bytes
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.samples import Array

MOST_TRIANGLES = 100_000
_LARGEST_FILE = 32 << 20  # bytes
GLTF_SUFFIXES = (".glb", ".gltf")
"""Files whose format defines that y points up, in metres."""
_SUFFIXES = (".stl", ".obj", ".ply", *GLTF_SUFFIXES)
_MOST_NODES = 10_000
_PACKED = re.compile(r"draco|meshopt|quantization", re.IGNORECASE)
"""Extensions of glTF without which its geometry cannot be read."""
_GLB_HEAD = 20
"""Bytes before the JSON text of a `.glb`; the last eight of them are its length and kind."""


def read_triangles(path: Path) -> Array:
    """(T, 3, 3) corners of the triangles of a mesh, in the unit and axes of the file.

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
        files: Mapping[str, bytes] = {}  # beside it, by name
        if kind in GLTF_SUFFIXES:
            files = _check_gltf(path, kind, data)
        else:
            _check_declared(path, kind, data)
        # one mesh of all parts, unchanged, without reading other files; only some readers know of materials
        mesh: Any = trimesh.load(
            io.BytesIO(data),
            file_type=kind[1:],
            process=False,
            force="mesh",
            resolver=files or None,
            **({"skip_materials": True} if kind in (".obj", *GLTF_SUFFIXES) else {}),
        )
        corners: Array = np.asarray(mesh.triangles, dtype=np.float64)
    except OSError as error:
        raise StrideTwinError(f"{path}: cannot be read: {error.strerror or error}") from error
    except StrideTwinError:
        raise
    except Exception as error:  # the parsers do not validate their input
        reason = " ".join(str(error).split()) or type(error).__name__
        raise StrideTwinError(f"{path}: no {kind[1:].upper()} mesh: {reason[:200]}") from error
    if not 0 < len(corners) <= MOST_TRIANGLES:
        raise ConfigError(path, "triangles", len(corners), f"1-{MOST_TRIANGLES}")
    if not np.isfinite(corners).all():
        raise ConfigError(path, "coordinates", "NaN or infinity", "finite numbers")
    return corners


def _check_declared(path: Path, kind: str, data: bytes) -> None:
    """Rejects a mesh file that declares or has too many elements, before a parser allocates memory for them.

    Args:
        path: The file, for messages.
        kind: `.stl`, `.ply` or `.obj`.
        data: Its content.

    Raises:
        ConfigError: More elements than are accepted, or than the file can hold.
    """
    most = MOST_TRIANGLES
    # binary STL: a header of 80 bytes, the number of triangles, and 50 bytes for each; text STL begins with `solid`
    if kind == ".stl" and not data[:512].lstrip().startswith(b"solid"):
        count = int.from_bytes(data[80:84], "little")
        if count > most or len(data) < 84 + 50 * count:
            raise ConfigError(path, "triangles declared", count, f"up to {most}, as many as there are")
    elif kind == ".ply":
        # numbers of vertices, faces and other elements in the header, which is empty if its end is missing; no mesh
        # needs ten vertices per triangle
        head = data[: data.find(b"end_header") + 1][:20_000]
        counts = [int(n) for n in re.findall(rb"element\s+\w+\s+(\d{1,18})", head)]
        if not counts or max(counts) > 10 * most or sum(counts) > len(data):
            raise ConfigError(path, "elements declared", counts, f"up to {10 * most}, as many as there are")
    # OBJ and text STL: faces begin with `f` and `facet`; no triangle needs as many as 40 lines
    elif data.count(b"\nf ") > most or data.count(b"\nfacet") > most or data.count(b"\n") > 40 * most:
        raise ConfigError(path, "lines", data.count(b"\n"), f"a mesh of up to {most} triangles")


def _check_gltf(path: Path, kind: str, data: bytes) -> Mapping[str, bytes]:
    """Rejects a glTF file that declares too many elements or is packed, and reads the files with its numbers.

    Args:
        path: The file.
        kind: `.glb` or `.gltf`.
        data: Its content.

    Returns:
        Content of the files beside it that it names, by name.

    Raises:
        ConfigError: More elements than are accepted, or geometry that an extension packs.
        StrideTwinError: A file beside it cannot be read.
        LookupError, TypeError, ValueError: It is no such file.
    """
    if kind == ".glb":
        length = int.from_bytes(data[12:16], "little")
        data = data[_GLB_HEAD : _GLB_HEAD + length]
    header = json.loads(data.decode("utf-8"))
    packings = [str(name) for name in header.get("extensionsRequired", []) if _PACKED.search(str(name))]
    if packings:
        raise ConfigError(path, "extensionsRequired", packings[0], "geometry that is not packed; export it without")
    nodes, meshes = header.get("nodes", []), header.get("meshes", [])
    counts = [int(accessor["count"]) for accessor in header.get("accessors", [])]
    # items of the lists that are walked through, each of which takes time
    links = sum(len(node.get("children", ())) for node in nodes)
    links += sum(len(scene.get("nodes", ())) for scene in header.get("scenes", []))
    parts = sum(len(mesh["primitives"]) for mesh in meshes)
    if max(len(nodes), links, parts) > _MOST_NODES:
        raise ConfigError(path, "nodes declared", max(len(nodes), links, parts), f"up to {_MOST_NODES}")
    if min(counts, default=0) < 0 or sum(counts) > 10 * MOST_TRIANGLES:
        raise ConfigError(path, "elements declared", sum(counts), f"up to {10 * MOST_TRIANGLES}")
    # a mesh is repeated for each node that refers to it
    sizes = [sum(_count_corners(part, counts) for part in mesh["primitives"]) for mesh in meshes]
    corners = max(sum(sizes), sum(sizes[node["mesh"]] for node in nodes if "mesh" in node))
    if corners > 3 * MOST_TRIANGLES:
        raise ConfigError(path, "triangles", corners // 3, f"1-{MOST_TRIANGLES}")
    return _read_buffers(path, [str(b["uri"]) for b in header.get("buffers", []) if "uri" in b])


def _count_corners(primitive: Mapping[str, Any], counts: Sequence[int]) -> int:
    """Number of corners of the triangles of a part of a glTF mesh.

    Args:
        primitive: The part.
        counts: Number of items of each accessor.
    """
    return counts[primitive["indices"] if "indices" in primitive else primitive["attributes"]["POSITION"]]


def _read_buffers(path: Path, uris: Sequence[str]) -> Mapping[str, bytes]:
    """Reads the files beside a `.gltf` that it names; numbers that are in the file itself are left out.

    Raises:
        ConfigError: A name leads to another folder, or the files are too large.
        StrideTwinError: A file cannot be read.
    """
    files: dict[str, bytes] = {}
    for uri in uris:
        if uri.startswith("data:"):
            continue
        if PurePath(uri).name != uri or "\0" in uri:
            raise ConfigError(path, "buffers", uri[:80], "files in the same folder, or a .glb, which has all in one")
        files[uri] = read_bytes(path.parent / uri, _LARGEST_FILE - sum(map(len, files.values())))
    return files
