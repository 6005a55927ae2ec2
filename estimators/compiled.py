"""How the estimators are compiled: what Python calls is cached, what only compiled functions call costs less."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import _dynfunc, njit  # type: ignore[attr-defined]
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering


class _PartLibrary(JITCodeLibrary):
    """Code of a function that only goes into others: it is optimised and made machine code there, not here as well."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    _name = "part_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        key = _dynfunc.make_function(state.cr.fndesc.lookup_module(), "part", "", 0, state.cr.env, (state.library,))
        state.targetctx.insert_user_function(key, state.cr.fndesc, [state.library])
        state.cr = state.cr._replace(cfunc=key)
        return True


class _PartCompiler(CompilerBase):
    def define_pipelines(self) -> list[Any]:
        made = DefaultPassBuilder.define_nopython_pipeline(self.state)
        made.passes = [(_PartLowering if p is NativeLowering else p, why) for p, why in made.passes]
        made.finalize()
        return [made]


_NO_C: dict[str, Any] = {"no_cfunc_wrapper": True}
INSIDE: dict[str, Any] = {"no_cpython_wrapper": True, "pipeline_class": _PartCompiler, **_NO_C}
"""Options of a function that Python never calls: its arguments are not taken apart, and LLVM sees it only as a part of
what calls it. Otherwise every function is optimised and made machine code again for each one further out; that was
half of the compilation."""

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
