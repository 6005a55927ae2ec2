"""Plans of walks, kept on disk: a walk that was planned once begins at once the next time, in any process."""

from __future__ import annotations

import sys
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import scipy
from joblib import Memory
from platformdirs import user_cache_path

from stridetwin import sim
from stridetwin.sim.dynamics.plan import plan_control
from stridetwin.sim.gait.reference import reference

MAX_BYTES = 1 << 30
"""Plans beyond this size are deleted, the longest unused first."""


def stored(folder: Path | None = None) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """`reference` and `plan_control` as functions of the same arguments that look the result up first.

    A plan is found again if every argument (model, configuration, state of the random numbers), every source file of
    `sim`, and the versions of MuJoCo, NumPy and SciPy are the same. Otherwise it is made, with a note on stderr.

    Args:
        folder: Where the plans are kept; None for the user's cache.
    """
    memory = Memory(folder or user_cache_path("stridetwin") / "plans", verbose=0)
    memory.reduce_size(bytes_limit=MAX_BYTES)
    return _stored(memory, reference, "the motion"), _stored(memory, plan_control, "the control of the simulation")


def _stored(memory: Memory, function: Callable[..., Any], what: str) -> Callable[..., Any]:
    versions = (_sources(), mujoco.__version__, np.__version__, scipy.__version__)

    def planned(arguments: tuple[Any, ...], versions: tuple[Any, ...]) -> Any:
        print(f"stridetwin: note: planning {what}; kept in {memory.location} for the next time", file=sys.stderr)
        return function(*arguments)

    planned.__qualname__ = function.__name__  # the name of its folder
    kept = memory.cache(planned)
    return lambda *arguments: kept(arguments, versions)


@cache
def _sources() -> int:
    """Checksum of the source files of `sim`."""
    files = sorted(file for root in sim.__path__ for file in Path(root).rglob("*.py"))
    return zlib.crc32(b"".join(file.read_bytes() for file in files))
