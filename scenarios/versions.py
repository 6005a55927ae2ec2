"""Version of the code behind a figure: a digest of the relevant sources and of the library versions.

Streams, twin, bodies, catalogue and reference figures count entirely, data included. Of estimators and scenarios, the
module that computes the figure and all its imports count. Code that only formats tables and pages does not.
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
    *(
        f"stridetwin.{name}"
        for name in ("scenarios", "outputs", "run", "gate", "pages", "reference", "report", "studies")
    ),
)
_WHOLE = (
    ("stridetwin.streams", ""),
    ("stridetwin.sim", ""),
    ("stridetwin.assets", ""),
    ("stridetwin.scenarios", "catalogue"),
    ("stridetwin.reference", ""),
)
_COMPUTING = ("numpy", "scipy", "numba", "opencv-python-headless", "mujoco")


def digest(module: str, *, estimators: bool = True) -> str:
    """Digest of the sources behind a module's results.

    Args:
        module: Its name.
        estimators: False excludes the estimators, which do not affect a recorded walk.
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
    """Versions of Python and of the installed libraries in `_COMPUTING`."""
    versions = [f"python {sys.version_info.major}.{sys.version_info.minor}"]
    for name in _COMPUTING:
        with suppress(metadata.PackageNotFoundError):
            versions.append(f"{name} {metadata.version(name)}")
    return "\n".join(versions)


def _data() -> dict[str, Path]:
    """All files that count entirely, by name."""
    return {
        f"{package}/{file.relative_to(_root(package)).as_posix()}": file
        for package, folder in _WHOLE
        for file in (_root(package) / folder).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }


def _imported(module: str) -> dict[str, Path]:
    """A module and all its direct and indirect imports from estimators and scenarios, by name.

    A YAML file of the same name beside a module counts, too. A package counts if something is imported from it, not if
    it is only part of the path to a module.
    """
    found: dict[str, Path] = {}
    left = [module]
    while left:
        name = left.pop()
        file = None if name in found else _file(name)
        if file is not None:
            found[name] = file
            found |= {f"{name}.yaml": data for data in [file.with_suffix(".yaml")] if data.is_file()}
            left += _imports(file.read_bytes())
    return found


def _file(name: str) -> Path | None:
    """The source of a module of estimators or scenarios; None for any other name."""
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
    """Names that a source imports anywhere: modules, and names that may be modules."""
    names = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return names
