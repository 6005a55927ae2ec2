"""Functions that only compiled ones call, made for tests to call."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from stridetwin import estimators, sim
from stridetwin.estimators.dvio import kernel  # noqa: F401  (makes kernels of functions in other modules)
from stridetwin.streams import compiled

_make_kernel = compiled.entry_kernel(
    *(file for part in (estimators, sim) for path in part.__path__ for file in sorted(Path(path).rglob("*.py"))),
    error_model="numpy",
)


def from_python(function: Callable[..., Any]) -> Callable[..., Any]:
    """Makes, of a function that is compiled for others alone, one that Python can call.

    A function that Python calls in the product, too, has one kernel for both. Otherwise each of two would throw away
    what the other has in the cache, as it is compiled of other sources, and every process would compile it again.
    """
    plain = getattr(function, "py_func", function)
    kernels = [made for made in compiled._entry_kernels if made.py_func is plain]
    return kernels[0] if kernels else _make_kernel(plain)
