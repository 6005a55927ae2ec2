"""Functions that only compiled ones call, made for tests to call."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from stridetwin import estimators, sim
from stridetwin.streams.compiled import entry_kernel

from_python: Callable[[Callable[..., Any]], Callable[..., Any]] = entry_kernel(
    *(file for part in (estimators, sim) for path in part.__path__ for file in sorted(Path(path).rglob("*.py"))),
    error_model="numpy",
)
"""Makes, of a function that is compiled for others alone, one that Python can call."""
