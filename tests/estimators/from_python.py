"""Functions that only compiled ones call, made for tests to call."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from stridetwin import estimators
from stridetwin.estimators.compiled import cached

from_python: Callable[[Callable[..., Any]], Callable[..., Any]] = cached(
    *(folder for path in estimators.__path__ for folder in sorted(Path(path).iterdir()) if folder.is_dir()),
    error_model="numpy",
)
"""Makes, of a function that is compiled for others alone, one that Python can call."""
