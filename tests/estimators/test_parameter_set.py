"""The one set of parameters. The pages in `docs/results` are of these values: a change of any needs new pages."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from inspect import isclass, signature
from typing import Any

from stridetwin import estimators


def parameter_classes() -> Iterator[type]:
    """Every class of parameters that has defaults, in the order of names."""
    found: dict[str, type] = {}
    for module in pkgutil.walk_packages(estimators.__path__, f"{estimators.__name__}."):
        for name, value in vars(importlib.import_module(module.name)).items():
            if isclass(value) and name.endswith("Parameters") and value.__module__.startswith(estimators.__name__):
                place = value.__module__.removeprefix(f"{estimators.__name__}.")
                found[f"{place}.{name}"] = value
    for _, kind in sorted(found.items()):
        if all(p.default is not p.empty for p in signature(kind).parameters.values()):
            yield kind


def values(structure: Any) -> dict[str, Any]:
    """Values by name; a part that has the defaults of its own class is left out, as that class is listed."""
    named = structure._asdict() if hasattr(structure, "_asdict") else {
        f.name: getattr(structure, f.name) for f in fields(structure)
    }  # fmt: skip
    made: dict[str, Any] = {}
    for name, value in named.items():
        if is_dataclass(value) or hasattr(value, "_asdict"):
            if not name_of(type(value)).endswith("Parameters") or value != type(value)():
                made |= {f"{name}.{inner}": x for inner, x in values(value).items()}
        else:
            made[name] = float(f"{value:.9g}") if isinstance(value, float) else value
    return made


def name_of(kind: type) -> str:
    """Package and name of a class."""
    return f"{kind.__module__.removeprefix(f'{estimators.__name__}.').split('.')[0]}.{kind.__name__}"


def test_every_default_is_as_stored(data_regression: Any) -> None:
    table = {name_of(kind): values(kind()) for kind in parameter_classes()}
    assert len(table) > 30
    data_regression.check(table)
