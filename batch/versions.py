"""Version of the code behind a figure: a digest of the relevant sources and of the library versions.

Streams, twin, bodies, catalogue and reference figures (`_WHOLE`) count entirely, data included. Of the packages in
`_FOLLOWED`, the module that computes the figure and all its imports count. Any other code does not, such as the
command line's.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import sys
from collections.abc import Sequence
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
"""Packages of which the modules that a module imports, directly or indirectly, count."""
_WHOLE = (
    ("stridetwin.streams", ""),
    ("stridetwin.sim", ""),
    ("stridetwin.assets", ""),
    ("stridetwin.scenarios", "catalogue"),
    ("stridetwin.reference", ""),
)
"""Package, and folder in it ("" for the whole package), of which all files count."""
_COMPUTING = ("numpy", "scipy", "numba", "opencv-python-headless", "mujoco")  # libraries that enter the digest
_NAMED = ("mujoco", "numpy", "scipy")  # libraries whose versions are also given one by one


@cache
def code_versions(module: str, *, estimators: bool = True) -> dict[str, str]:
    """Versions that determine a module's results: the project, a digest of its sources, and numerical libraries.

    Args:
        module: Name of the module.
        estimators: False leaves the estimators out of the digest, as they do not affect a recorded walk.

    Returns:
        `stridetwin`, the version of the project; `sources`, the digest; and the version of each library in `_NAMED`.
    """
    return {
        "stridetwin": metadata.version("stridetwin"),
        "sources": digest(module, estimators=estimators),
        **_distribution_versions(_NAMED),
    }


@cache
def class_version(of: type) -> str:
    """Digest of the sources of a class, such as an installed estimator's: 16 hexadecimal digits.

    Its own file counts, wherever it is installed, and what `digest` covers for its module.
    """
    source = Path(inspect.getfile(of)).read_bytes()
    return hashlib.sha256(source + digest(of.__module__).encode()).hexdigest()[:16]


def digest(module: str, *, estimators: bool = True) -> str:
    """Digest of the sources that determine a module's results, with the versions of numerical libraries.

    Args:
        module: Name of the module.
        estimators: False excludes the estimators, which do not affect a recorded walk.

    Returns:
        16 hexadecimal digits.
    """
    # by name: what always counts, and the module with its imports
    files = _data_files() | {
        name: file for name, file in _find_imports(module).items() if estimators or not name.startswith(_ESTIMATORS)
    }
    hasher = hashlib.sha256(_library_versions().encode())
    for name in sorted(files):
        text = files[name].read_bytes()
        # name and length keep one file's end apart from the next one's beginning
        hasher.update(f"{name} {len(text)}\n".encode() + text)
    return hasher.hexdigest()[:16]


@cache
def _library_versions() -> str:
    """Versions of Python and of the installed libraries in `_COMPUTING`."""
    python = f"python {sys.version_info.major}.{sys.version_info.minor}"
    return "\n".join([python, *(f"{name} {version}" for name, version in _distribution_versions(_COMPUTING).items())])


def _distribution_versions(names: Sequence[str]) -> dict[str, str]:
    """Versions of the named distributions, without those that are not installed."""
    versions = {}
    for name in names:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions


def _data_files() -> dict[str, Path]:
    """The files of the packages in `_WHOLE`, which count entirely, by package and name."""
    return {
        f"{package}/{file.relative_to(_package_folder(package)).as_posix()}": file
        for package, folder in _WHOLE
        for file in (_package_folder(package) / folder).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }


def _find_imports(module: str) -> dict[str, Path]:
    """A module and all its direct and indirect imports from the packages in `_FOLLOWED`, name to file.

    The `__init__` of a package counts if something is imported from it, not if it is only part of the path to a module.
    Classes that entry points load are not imported by name; `class_version` gives their digests.
    """
    files: dict[str, Path] = {}
    remaining = [module]
    while remaining:
        name = remaining.pop()
        file = None if name in files else _source_file(name)
        if file is not None:
            files[name] = file
            remaining += _parse_imports(file.read_bytes())
    return files


def _source_file(name: str) -> Path | None:
    """The source of a module of the packages in `_FOLLOWED`; None for any other name."""
    package = ".".join(name.split(".")[:2])  # such as `stridetwin.gate`
    if package not in _FOLLOWED:
        return None
    place = _package_folder(package).joinpath(*name.split(".")[2:])  # without suffix: a module or a package
    return next((f for f in (place.with_suffix(".py"), place / "__init__.py") if f.is_file()), None)


@cache
def _package_folder(package: str) -> Path:
    """Folder of a package."""
    return Path(str(resources.files(package)))


@cache
def _parse_imports(source: bytes) -> list[str]:
    """Names that a source imports anywhere: modules, and names that may be modules."""
    names = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:  # not `from . import name`
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return names
