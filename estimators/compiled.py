"""Compilation of the estimators, as of all compiled functions; the algebra that they share is among the sources."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from stridetwin.streams import compiled
from stridetwin.streams.compiled import INNER_KERNEL, F

__all__ = ["INNER_KERNEL", "entry_kernel"]

_SHARED = [Path(__file__).with_name(name) for name in ("so3.py", "matrices.py", "cholesky.py")]


def entry_kernel(*sources: str | Path, llvm_level: int = 3, **options: object) -> Callable[[F], F]:
    """Compiles functions that Python calls; see `streams.compiled.entry_kernel`."""
    return compiled.entry_kernel(*_SHARED, *sources, llvm_level=llvm_level, **options)
