"""Compilation of the estimators: as of all compiled functions, and `so3`, which they share, is among the sources."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from stridetwin.streams import compiled
from stridetwin.streams.compiled import INSIDE, F

__all__ = ["INSIDE", "cached"]

_SO3 = Path(__file__).with_name("so3.py")


def cached(*sources: str | Path, **options: Any) -> Callable[[F], F]:
    """Compiles functions that Python calls; see `streams.compiled.cached`."""
    return compiled.cached(_SO3, *sources, **options)
