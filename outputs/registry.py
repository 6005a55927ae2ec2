"""The installed kinds of output: ours, and those of any package with entry points of the group `stridetwin.outputs`."""

from __future__ import annotations

import sys
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from stridetwin.estimators import registry as estimator_registry
from stridetwin.estimators.base import Declaration
from stridetwin.estimators.registry import OUTPUT_GROUP
from stridetwin.outputs.base import AnyKind, OutputKind, Score, Scores
from stridetwin.outputs.feeding import EstimatorClass
from stridetwin.streams.errors import ConfigError, StrideTwinError


def kinds() -> dict[str, AnyKind]:
    """All kinds of output by name, in their declared order.

    Raises:
        StrideTwinError: A kind cannot be imported, or is not an `OutputKind`.
    """
    by_name = {name: _load(point) for name, point in _entry_points().items()}
    return dict(sorted(by_name.items(), key=lambda item: (item[1].order, item[0])))


def kind_of(declaration: Declaration) -> AnyKind:
    """The kind of output of an estimator, from its declaration.

    Raises:
        ConfigError: No installed package offers the kind; the message lists the kinds.
        StrideTwinError: The kind cannot be imported, or is not an `OutputKind`.
    """
    points = _entry_points()
    if declaration.kind not in points:
        raise ConfigError(declaration.name, "declaration.kind", declaration.kind, ", ".join(sorted(points)))
    return _load(points[declaration.kind])


def estimators() -> dict[str, EstimatorClass]:
    """All installed estimators by name, sorted by the order of their kinds and then by their own order.

    Raises:
        StrideTwinError: A kind or an estimator cannot be imported, or is invalid.
    """
    return {
        name: estimator_class
        for kind in kinds()
        for name, estimator_class in estimator_registry.estimators(kind).items()
    }


def all_scores() -> dict[str, Score]:
    """The declared scores of all kinds by name; where two kinds share a name, they agree on its scale."""
    return _all_scores(tuple(sys.path))


@cache
def _all_scores(path: tuple[str, ...]) -> dict[str, Score]:
    """Every declared score by name.

    Args:
        path: The search path of modules, which is only the key of the cache: another one may have other packages.
    """
    return {score.name: score for kind in kinds().values() for score in kind.scores}


def kind_with_scores(scores: Scores) -> AnyKind:
    """The kind that declares most of some scores, for scores whose estimator is not known.

    Args:
        scores: Scores of one output, of which only the names count.
    """

    def count_declared(kind: AnyKind) -> int:
        """How many of the scores a kind declares."""
        return sum(score.name in scores for score in kind.scores)

    return max(kinds().values(), key=count_declared)


def _entry_points() -> dict[str, EntryPoint]:
    """The entry points of kinds of output, by name."""
    return _entry_points_on(tuple(sys.path))


@cache
def _entry_points_on(path: tuple[str, ...]) -> dict[str, EntryPoint]:
    """Finds the entry points of kinds of output, by name.

    Args:
        path: The search path of modules, which is only the key of the cache: another one may have other packages.

    Raises:
        StrideTwinError: Two packages offer the same name.
    """
    points: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=OUTPUT_GROUP), key=lambda p: p.name):
        first = points.setdefault(point.name, point)
        if point.value != first.value:  # the same class twice is no conflict
            both = f"{first.value} and {point.value}"
            raise StrideTwinError(f"{OUTPUT_GROUP}: {point.name}: two packages offer it, {both}; uninstall one")
    return points


@cache
def _load(point: EntryPoint) -> AnyKind:
    """The kind behind an entry point.

    Raises:
        StrideTwinError: Its import fails.
        ConfigError: It is not an `OutputKind`.
    """
    place = f"{OUTPUT_GROUP}: {point.name} = {point.value}"
    try:
        kind_class: object = point.load()
    except Exception as error:
        raise StrideTwinError(f"{place}: cannot be imported: {type(error).__name__}: {error}") from error
    if not (isinstance(kind_class, type) and issubclass(kind_class, OutputKind)):
        raise ConfigError(place, "class", kind_class, "a subclass of stridetwin.outputs.base.OutputKind")
    kind: AnyKind = kind_class()
    return kind
