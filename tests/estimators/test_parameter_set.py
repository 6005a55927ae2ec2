"""The one set of parameters. The pages in `docs/results` are of these values: a change of any needs new pages."""

from __future__ import annotations

import importlib
import pkgutil
from collections import Counter
from dataclasses import fields, is_dataclass
from inspect import isclass, signature
from typing import Any

from stridetwin import estimators

_PACKAGE = f"{estimators.__name__}."
_WITH_PARAMETERS = {
    "contact_terrain",
    "dvio",
    "foot_ins",
    "foot_to_foot",
    "gait_phase",
    "locomotion_mode",
    "terrain_map",
}
_MAX_PER_ESTIMATOR, _MAX_IN_ALL = 25, 150


def parameter_classes() -> set[type]:
    """Every class of parameters that has defaults."""
    modules = [importlib.import_module(m.name) for m in pkgutil.walk_packages(estimators.__path__, _PACKAGE)]
    classes = {value for module in modules for value in vars(module).values() if isclass(value)}
    return {
        kind
        for kind in classes
        if kind.__module__.startswith(_PACKAGE)
        and kind.__name__.endswith("Parameters")
        and all(p.default is not p.empty for p in signature(kind).parameters.values())
    }


def values(structure: Any, classes: set[type]) -> dict[str, Any]:
    """Values by name; a part that has the defaults of its own class is left out, as that class is listed."""
    made: dict[str, Any] = {}
    for name in getattr(structure, "_fields", None) or [f.name for f in fields(structure)]:
        value = getattr(structure, name)
        if isinstance(value, float):
            made[name] = float(f"{value:.9g}")
        elif not is_dataclass(value) and not hasattr(value, "_fields"):
            made[name] = value
        elif type(value) not in classes or value != type(value)():
            made |= {f"{name}.{inner}": x for inner, x in values(value, classes).items()}
    return made


def defaults() -> dict[str, dict[str, Any]]:
    """Defaults by name of every class of parameters, named `estimator.Class`."""
    classes = parameter_classes()
    table = {
        f"{kind.__module__.removeprefix(_PACKAGE).split('.')[0]}.{kind.__name__}": values(kind(), classes)
        for kind in classes
    }
    assert len(table) == len(classes)
    assert {name.partition(".")[0] for name in table} >= _WITH_PARAMETERS
    return table


def test_every_default_is_as_stored(data_regression: Any) -> None:
    data_regression.check(defaults())


def test_parameters_are_few() -> None:
    """A number that no user needs is a constant of the module that uses it."""
    count = Counter[str]()
    for name, numbers in defaults().items():
        count[name.partition(".")[0]] += len(numbers)
    assert max(count.values()) <= _MAX_PER_ESTIMATOR, count
    assert count.total() <= _MAX_IN_ALL, count
