"""Which version of the code makes a figure: a digest of the sources that it comes from, and of the libraries.

Of streams, twin, bodies, catalogue and reference figures that is everything, data too; of estimators and scenarios the
module that makes the figure and all that it imports. What only lays out tables and pages is none of it.
"""

from __future__ import annotations

import ast
import hashlib
import sys
from contextlib import suppress
from functools import cache
from importlib import metadata, resources
from pathlib import Path

_ESTIMATORS = "stridetwin.estimators"
_FOLLOWED = (
    _ESTIMATORS,
    *(f"stridetwin.{name}" for name in ("scenarios", "pipeline", "evaluation", "report", "studies")),
)
_WHOLE = (
    ("stridetwin.streams", ""),
    ("stridetwin.sim", ""),
    ("stridetwin.assets", ""),
    ("stridetwin.scenarios", "catalogue"),
    ("stridetwin.evaluation", "reference"),
)
_COMPUTING = ("numpy", "scipy", "numba", "opencv-python-headless", "mujoco")


def digest(module: str, *, estimators: bool = True) -> str:
    """Digest of the sources of what a module makes.

    Args:
        module: Its name.
        estimators: False: of all but the estimators, which no walk has seen when it is recorded.
    """
    files = _data() | {
        name: file for name, file in _imported(module).items() if estimators or not name.startswith(_ESTIMATORS)
    }
    hashed = hashlib.sha256(_libraries().encode())
    for name in sorted(files):
        text = files[name].read_bytes()
        hashed.update(f"{name} {len(text)}\n".encode() + text)
    return hashed.hexdigest()[:16]


@cache
def _libraries() -> str:
    """Versions of what computes: Python's and those of `_COMPUTING` that are installed."""
    versions = [f"python {sys.version_info.major}.{sys.version_info.minor}"]
    for name in _COMPUTING:
        with suppress(metadata.PackageNotFoundError):
            versions.append(f"{name} {metadata.version(name)}")
    return "\n".join(versions)


def _data() -> dict[str, Path]:
    """All that counts as a whole, by name."""
    return {
        f"{package}/{file.relative_to(_root(package)).as_posix()}": file
        for package, folder in _WHOLE
        for file in (_root(package) / folder).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }


def _imported(module: str) -> dict[str, Path]:
    """A module and all that it imports in turn of estimators and scenarios, by name.

    A package counts where something is imported from it, not where it is but on the way to a module in it.
    """
    found: dict[str, Path] = {}
    left = [module]
    while left:
        name = left.pop()
        file = None if name in found else _file(name)
        if file is not None:
            found[name] = file
            left += _imports(file.read_bytes())
    return found


def _file(name: str) -> Path | None:
    """The source of a module of estimators or scenarios; None where the name is that of anything else."""
    package = ".".join(name.split(".")[:2])
    if package not in _FOLLOWED:
        return None
    place = _root(package).joinpath(*name.split(".")[2:])
    return next((f for f in (place.with_suffix(".py"), place / "__init__.py") if f.is_file()), None)


@cache
def _root(package: str) -> Path:
    return Path(str(resources.files(package)))


@cache
def _imports(source: bytes) -> list[str]:
    """Names of what a source imports, wherever in it: modules, and what may be modules."""
    names = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return names
