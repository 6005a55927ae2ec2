"""Compilation of the estimators: functions called by Python are cached, inner ones are compiled at less cost.

Numba has no public way to either. `INTERNALS` names what is used of its inside; `SUPPORTED` the versions in which that
means what it means here. With any other version everything is compiled by plain `numba.njit(cache=True)`: the numbers
are the same, compilation takes about twice as long, and a cached function does not notice changes in other files.
"""

from __future__ import annotations

import importlib
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba import njit

SUPPORTED = ((0, 61), (0, 69))
"""First version of Numba that is supported, and the first one beyond."""
INTERNALS = (
    ("numba._dynfunc", "make_function"),
    ("numba.core.caching", "IndexDataCacheFile"),
    ("numba.core.codegen", "JITCodeLibrary._optimize_final_module"),
    ("numba.core.codegen", "JITCodeLibrary._finalize_final_module"),
    ("numba.core.codegen", "JITCodeLibrary._finalize_dynamic_globals"),
    ("numba.core.compiler", "CompilerBase"),
    ("numba.core.compiler", "DefaultPassBuilder.define_nopython_pipeline"),
    ("numba.core.compiler_machinery", "register_pass"),
    ("numba.core.typed_passes", "NativeLowering.run_pass"),
)
"""Modules of Numba and what of them is used, beside `_cache._cache_file._source_stamp` of a cached function."""


def missing_internals() -> list[str]:
    """The `INTERNALS` that the installed Numba lacks."""
    lacking = []
    for module, names in INTERNALS:
        try:
            found: Any = importlib.import_module(module)
            for name in names.split("."):
                found = getattr(found, name)
        except (ImportError, AttributeError):
            lacking.append(f"{module}.{names}")
    return lacking


def is_supported(version: str) -> bool:
    """Whether a version of Numba lies within `SUPPORTED`."""
    parts = version.split(".")[:2]
    numbers = tuple(int(part) for part in parts if part.isdecimal())
    return SUPPORTED[0] <= numbers < SUPPORTED[1]


_SO3 = Path(__file__).with_name("so3.py")
_WITH_INTERNALS = is_supported(numba.__version__) and not missing_internals()
_NO_C: dict[str, Any] = {}
INSIDE: dict[str, Any] = {}
"""Options of a function that Python never calls: its arguments are not taken apart, and LLVM sees it only as a part of
what calls it. Otherwise every function is optimised and made machine code again for each one further out; that was
half of the compilation."""

if _WITH_INTERNALS:
    from stridetwin.estimators.part_compiler import PartCompiler

    _NO_C["no_cfunc_wrapper"] = True
    INSIDE |= {"no_cpython_wrapper": True, "pipeline_class": PartCompiler, **_NO_C}

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
        if _WITH_INTERNALS:
            made._cache._cache_file._source_stamp = stamp
        return cast(F, made)

    return compiled


def digest_of_sources(*folders: Path) -> int:
    """Checksum, ≥ 0, of every Python file that lies in the folders, and of `so3`, which all packages share."""
    files = [_SO3, *(f for folder in folders for f in sorted(folder.glob("*.py")))]
    return zlib.crc32(b"".join(f.read_bytes() for f in files))
