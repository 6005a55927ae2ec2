"""How the estimators are compiled: what Python calls is cached, what only compiled functions call costs less."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

_NO_C: dict[str, Any] = {"no_cfunc_wrapper": True}
INSIDE: dict[str, Any] = {"no_cpython_wrapper": True, **_NO_C}
"""Options of a function that Python never calls: to take apart its arguments would be a quarter of the compilation."""

F = TypeVar("F", bound=Callable[..., Any])


def cached(*folders: Path, **options: Any) -> Callable[[F], F]:
    """Compiles functions that Python calls, and caches them until a Python file in the folders changes.

    numba's cache looks at the file of the cached function alone, and would go on with what that function took in from
    other files, however much those have changed since. So the stamp of the cache is a checksum of all of
    them, and what is called inside is not cached.

    Args:
        folders: Where all lies that is compiled into the functions.
        options: For numba.

    Returns:
        Decorator of a plain function, or of one that is compiled for others to call.
    """
    stamp = digest_of_sources(*folders)

    def compiled(function: F) -> F:
        made: Any = njit(cache=True, **{**_NO_C, **options})(getattr(function, "py_func", function))
        made._cache._cache_file._source_stamp = stamp
        return cast(F, made)

    return compiled


def digest_of_sources(*folders: Path) -> int:
    """Checksum, ≥ 0, of every Python file that lies in the folders."""
    return zlib.crc32(b"".join(f.read_bytes() for folder in folders for f in sorted(folder.glob("*.py"))))
