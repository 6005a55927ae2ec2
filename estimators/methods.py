"""Current names of estimator methods, and their former names."""

from __future__ import annotations

import warnings
from typing import Any

PROPOSED = "proposed"
_FORMER = "stridetwin"


def current_name(method: str) -> str:
    """The name of a method today: `stridetwin`, its name up to release 0.1, is `proposed`.

    Warns:
        DeprecationWarning: The former name was given.
    """
    if method != _FORMER:
        return method
    warnings.warn(f"method {_FORMER!r} is now {PROPOSED!r}; the former name goes with the next release",
                  DeprecationWarning, stacklevel=3)  # fmt: skip
    return PROPOSED


def with_current_names(row: Any) -> Any:
    """A recorded row (JSON values), which may be of an earlier release, with the names of methods today."""
    if isinstance(row, dict):
        return {PROPOSED if key == _FORMER else key: with_current_names(value) for key, value in row.items()}
    return [with_current_names(value) for value in row] if isinstance(row, list) else row
