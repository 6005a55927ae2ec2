"""The installed estimators: ours, and those of any package with entry points of the group `stridetwin.estimators`."""

from __future__ import annotations

import ast
import sys
from functools import cache
from importlib.abc import InspectLoader
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import TYPE_CHECKING, cast

from stridetwin.streams.errors import ConfigError, StrideTwinError

if TYPE_CHECKING:  # names of estimators are needed at once, NumPy only with their classes
    from stridetwin.estimators.base import AnyEstimator

GROUP = "stridetwin.estimators"
OUTPUT_GROUP = "stridetwin.outputs"
"""Entry point group of the kinds of output; `outputs.registry` loads them."""


def names() -> tuple[str, ...]:
    """Names of all estimators, in alphabetical order; imports none of them.

    Raises:
        StrideTwinError: Two packages offer the same name.
    """
    return tuple(_points_by_name())


def descriptions() -> dict[str, str]:
    """One line about each estimator, by name: the first of its module's docstring, read without importing the module.

    For a module without a docstring, its class is loaded, and the line is the description in the class's declaration.

    Raises:
        StrideTwinError: A module has no docstring, and its estimator cannot be loaded by `estimator`.
    """
    lines = {}
    for name, point in _points_by_name().items():
        lines[name] = _read_summary(point) or estimator(name).declaration.description
    return lines


def output_descriptions() -> dict[str, str]:
    """One line about each kind of output, by name: the first of its module's docstring, read without importing it."""
    return {point.name: _read_summary(point) for point in _entry_points(OUTPUT_GROUP, tuple(sys.path))}


def estimator(name: str) -> type[AnyEstimator]:
    """The class of one estimator.

    Raises:
        StrideTwinError: The name is unknown, the class cannot be imported, or it is not an estimator.
    """
    from stridetwin.estimators.base import Declaration

    points = _points_by_name()
    if name not in points:
        raise ConfigError("estimator", "name", name, ", ".join(points))
    # the entry point as its package writes it, for messages: "group: name = module:class"
    where = f"{GROUP}: {name} = {points[name].value}"
    try:
        estimator_class: object = points[name].load()
    except Exception as error:
        raise StrideTwinError(f"{where}: cannot be imported: {type(error).__name__}: {error}") from error
    declaration = getattr(estimator_class, "declaration", None)
    if not isinstance(declaration, Declaration):
        raise ConfigError(where, "declaration", type(declaration).__name__, "stridetwin.estimators.base.Declaration")
    kinds = tuple(sorted({point.name for point in _entry_points(OUTPUT_GROUP, tuple(sys.path))}))  # of output
    # the declared name must be that of the entry point, and the kind an installed one
    for field, value, valid in (("name", declaration.name, (name,)), ("kind", declaration.kind, kinds)):
        if value not in valid:
            raise ConfigError(where, f"declaration.{field}", value, ", ".join(valid))
    for method in ("streams", "update"):
        if not callable(getattr(estimator_class, method, None)):
            raise ConfigError(where, method, getattr(estimator_class, method, None), "a method")
    return cast("type[AnyEstimator]", estimator_class)


def estimators(kind: str) -> dict[str, type[AnyEstimator]]:
    """All estimators of one kind by name, in their declared order.

    Raises:
        StrideTwinError: One of the installed classes cannot be imported, or is not an estimator.
    """
    classes_of_kind = [loaded for loaded in map(estimator, names()) if loaded.declaration.kind == kind]
    classes_of_kind.sort(key=lambda loaded: (loaded.declaration.order, loaded.declaration.name))
    return {loaded.declaration.name: loaded for loaded in classes_of_kind}


def _read_summary(point: EntryPoint) -> str:
    """First line of the docstring of an entry point's module, without its full stop; the module is not imported.

    "" if the module has no docstring, cannot be found, or has no Python source that can be parsed.
    """
    try:
        spec = find_spec(point.module)
        # only a loader of this kind gives the source; an extension module has none
        source = spec.loader.get_source(point.module) if spec and isinstance(spec.loader, InspectLoader) else None
        docstring = ast.get_docstring(ast.parse(source or ""))
        lines = (docstring or "").splitlines()
    except (ImportError, SyntaxError):
        return ""
    return lines[0].rstrip(".") if lines else ""


def _points_by_name() -> dict[str, EntryPoint]:
    """Entry points of all estimators by name.

    Raises:
        StrideTwinError: Two packages offer the same name.
    """
    points: dict[str, EntryPoint] = {}
    for point in _entry_points(GROUP, tuple(sys.path)):
        first_of_name = points.setdefault(point.name, point)
        # one installation may be listed twice, with the same `module:class`: that is no conflict
        if point.value != first_of_name.value:
            both = f"{first_of_name.value} and {point.value}"
            raise StrideTwinError(f"{GROUP}: {point.name}: two packages offer it, {both}; uninstall one")
    return points


@cache
def _entry_points(group: str, path: tuple[str, ...]) -> list[EntryPoint]:
    """The entry points of a group, sorted by name.

    Reading them takes 4 ms, so they are cached. `path`, the search path for modules, is not used but for the cache: on
    another path other packages are installed.
    """
    return sorted(entry_points(group=group), key=lambda point: point.name)
