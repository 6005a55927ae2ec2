"""Compilation of functions: those called by Python are cached, inner ones are compiled at less cost.

Numba has no public way to either. `INTERNALS` names what is used of its inside; `KNOWN` the versions in which that
means what it means here. With any other version everything is compiled by plain `numba.njit(cache=True)`: the numbers
are the same, compilation takes about twice as long, and a cached function does not notice changes in other files.
"""

from __future__ import annotations

import importlib
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar, cast

import numba
from numba import njit

if TYPE_CHECKING:
    from numba.core.compiler import CompilerBase

KNOWN = ((0, 61), (0, 69))
"""First version of Numba whose inside is known, and the first one beyond."""
INTERNALS = (
    ("numba._dynfunc", "make_function"),
    ("numba.core.base", "BaseContext.nrt"),
    ("numba.core.base", "BaseContext.subtarget"),
    ("numba.core.caching", "IndexDataCacheFile"),
    ("numba.core.codegen", "JITCodeLibrary._get_module_for_linking"),
    ("numba.core.codegen", "JITCodeLibrary.finalize"),
    ("numba.core.compiler", "Compiler.define_pipelines"),
    ("numba.core.codegen", "JITCodeLibrary._finalize_dynamic_globals"),
    ("numba.core.compiler", "CompilerBase"),
    ("numba.core.compiler", "DefaultPassBuilder.define_nopython_pipeline"),
    ("numba.core.compiler_machinery", "register_pass"),
    ("numba.core.datamodel.models", "DataModel.contains_nrt_meminfo"),
    ("numba.core.dispatcher", "Dispatcher.get_call_template"),
    ("numba.core.errors", "NumbaRuntimeError"),
    ("numba.core.ir", "StaticSetItem"),
    ("numba.core.typed_passes", "NativeLowering.run_pass"),
)
"""Modules of Numba and what of them is used, beside `_compiler.pipeline_class` of any function, and
`_cache._cache_file` with `_source_stamp` and `_version` of a cached one."""


def find_missing_internals() -> list[str]:
    """The `INTERNALS` that the installed Numba lacks, each as its module and its name there, joined by a point."""
    lacking = []
    for module, dotted_name in INTERNALS:
        try:
            internal: object = importlib.import_module(module)
            for name in dotted_name.split("."):  # a class, and then its method
                internal = getattr(internal, name)
        except (ImportError, AttributeError):
            lacking.append(f"{module}.{dotted_name}")
    return lacking


def is_known(version: str) -> bool:
    """Whether a version of Numba, such as `0.61.2`, lies within `KNOWN`."""
    parts = version.split(".")[:2]  # major and minor
    # without a part such as `61rc1`, a preliminary version sorts before the first known one
    numbers = tuple(int(part) for part in parts if part.isdecimal())
    first, beyond = KNOWN
    return first <= numbers < beyond


class KernelOptions(TypedDict, total=False):
    """Options of `numba.njit` that its types know; so a compiled function keeps the types of the plain one."""

    pipeline_class: type[CompilerBase]


class _InnerOptions(KernelOptions):
    """The options in `INNER_KERNEL`, when Numba's inside is known."""

    no_cfunc_wrapper: bool
    no_cpython_wrapper: bool


_WITH_INTERNALS = is_known(numba.__version__) and not find_missing_internals()
INNER_KERNEL: KernelOptions = {}
"""Options of a function that Python never calls: its arguments are not taken apart, and LLVM sees it only as a part of
what calls it (`part_compiler`). Otherwise every function is optimised and made machine code again for each one further
out; that was half of the compilation."""

if _WITH_INTERNALS:
    from stridetwin.streams.part_compiler import PartCompiler, entry_compiler

    INNER_KERNEL = _InnerOptions(no_cfunc_wrapper=True, no_cpython_wrapper=True, pipeline_class=PartCompiler)

_COMMON = [Path(__file__).parent / name for name in ("algebra/matrices.py", "algebra/tuples.py", "part_compiler.py")]
"""Sources that count for every function, because most call them, or because they make its machine code."""
F = TypeVar("F", bound=Callable[..., object])
_entry_kernels: list[Any] = []
"""Every kernel that `entry_kernel` has made; `is_uncompiled` looks through them."""


def entry_kernel(*sources: str | Path, llvm_level: int = 3, **options: object) -> Callable[[F], F]:
    """Compiles functions that Python calls, and caches them until a source changes.

    numba's cache looks at the file of the cached function alone, and would go on with what that function took in from
    other files, however much those have changed since. So the stamp of the cache is a checksum of all of
    them, and what is called inside is not cached.

    Args:
        sources: Files, and folders of Python files, of all that is compiled into the functions; the compiled modules of
            `streams/algebra` and `streams/part_compiler` count for every function.
        llvm_level: Level of LLVM's optimisation, 1 to 3. Compilation at level 1 takes a tenth less time than at 3, and
            the numbers are the same; long sequences of scalar operations are then no slower, and loops over images are
            slower by a quarter. Not used if Numba's inside is unknown.
        options: Further options of `numba.njit`.

    Returns:
        Decorator of a plain function, or of one that is compiled for others to call.
    """
    stamp = digest_of_sources(*_COMMON, *sources)
    settings = dict[str, Any](options)
    if _WITH_INTERNALS:
        settings |= {"no_cfunc_wrapper": True, "pipeline_class": entry_compiler(llvm_level)}

    def compile_and_cache(function: F) -> F:
        """Compiles a function, with the checksum of the sources as the stamp of its cache."""
        plain = getattr(function, "py_func", function)  # `py_func` is the plain function of a compiled one
        kernel: Any = njit(cache=True, **settings)(plain)
        if _WITH_INTERNALS:
            index = kernel._cache._cache_file
            index._source_stamp = stamp
            # Numba compares the version before it unpickles the rest of an index file. With the stamp in it, the index
            # of other sources is not unpickled, which would fail if that names a class that exists no more.
            index._version += f" {stamp}"
        _entry_kernels.append(kernel)
        return cast(F, kernel)

    return compile_and_cache


def is_uncompiled(package: str) -> bool:
    """Whether a package has functions that Python calls, and Numba's cache has machine code of none of them.

    Machine code of an earlier state of the sources counts as well: it is compiled anew by whoever calls it first.

    Args:
        package: Name of an imported package or module, such as `stridetwin.estimators.dvio`.
    """
    # the points at the end let a module match itself, but not `dvio_tools` match `dvio`
    kernels = [k for k in _entry_kernels if f"{k.py_func.__module__}.".startswith(f"{package}.")]
    return bool(kernels) and not any(map(_has_cached_code, kernels))


def _has_cached_code(kernel: Any) -> bool:
    """Whether Numba's cache has an index file of a kernel; `stats.cache_path` is public, the file's name is not."""
    function = kernel.py_func
    pattern = f"{function.__module__.rsplit('.')[-1]}.{function.__qualname__}-*.nbi"
    return any(Path(kernel.stats.cache_path).glob(pattern))


def digest_of_sources(*sources: str | Path) -> int:
    """Checksum (CRC-32, ≥ 0) of the contents of files and of the Python files in folders."""
    files: list[Path] = []
    for path in map(Path, sources):
        files += sorted(path.glob("*.py")) if path.is_dir() else [path]
    return zlib.crc32(b"".join(file.read_bytes() for file in files))
