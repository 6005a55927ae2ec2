"""Compiles an entry point and what it calls as one program, by Numba internals (`compiled.INTERNALS`).

Numba by itself makes every function a program of its own: it links, optimises and makes machine code of each together
with all that it calls, again and again on the way out. Here a function that only others call, and each of Numba's own
that they call, stays a part, until the entry point links all parts and optimises them once.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba import _dynfunc  # type: ignore[attr-defined]
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering


class PartLibrary(JITCodeLibrary):
    """Code of a function that only goes into others, neither linked nor made machine code."""

    def finalize(self) -> None:  # noqa: D102
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "external":
                function.linkage = "linkonce_odr"  # several entry points may contain it
        self._finalize_dynamic_globals()
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """With all parts below it, for a library of Numba's own kind, which links only what it calls itself."""
        if self._shared_module is None:
            self._shared_module = self._final_module.clone()
            for library in _all_below(self):
                self._shared_module.link_in(_own_module(library), preserve=True)
        return self._shared_module


class EntryLibrary(JITCodeLibrary):
    """Code of an entry point and of all parts that it calls, directly or not."""

    def finalize(self) -> None:  # noqa: D102
        for library in _all_below(self):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(_own_module(library), preserve=True)
        self._linking_libraries = []
        super().finalize()


def _own_module(library: Any) -> Any:
    return library._final_module if isinstance(library, PartLibrary) else library._get_module_for_linking()


def _all_below(library: Any) -> list[Any]:
    """Each library once that a part or an entry point calls, directly or through parts; callers come first."""
    found: dict[Any, None] = {}
    open_ = list(library._linking_libraries)
    while open_:
        below = open_.pop()
        if below not in found:
            below._ensure_finalized()
            found[below] = None
            open_ += below._linking_libraries if isinstance(below, PartLibrary) else []
    return list(found)


@register_pass(mutates_CFG=True, analysis_only=False)
class PartLowering(NativeLowering):
    """Leaves out machine code of its own."""

    _name = "part_lowering"

    def run_pass(self, state: Any) -> bool:  # noqa: D102
        state.library = PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        key = _dynfunc.make_function(state.cr.fndesc.lookup_module(), "part", "", 0, state.cr.env, (state.library,))
        state.targetctx.insert_user_function(key, state.cr.fndesc, [state.library])
        state.cr = state.cr._replace(cfunc=key)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class EntryLowering(NativeLowering):
    """Links and optimises all parts at once."""

    _name = "entry_lowering"

    def run_pass(self, state: Any) -> bool:  # noqa: D102
        state.library = EntryLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


class PartCompiler(CompilerBase):
    """Compiles for other compiled functions only."""

    def define_pipelines(self) -> list[Any]:  # noqa: D102
        return _pipelines(self.state, PartLowering)


class EntryCompiler(CompilerBase):
    """Compiles what Python calls."""

    def compile_extra(self, func: Any) -> Any:  # noqa: D102
        with _numba_in_parts():
            return super().compile_extra(func)

    def define_pipelines(self) -> list[Any]:  # noqa: D102
        return _pipelines(self.state, EntryLowering)


def _pipelines(state: Any, lowering: type[NativeLowering]) -> list[Any]:
    made = DefaultPassBuilder.define_nopython_pipeline(state)
    made.passes = [(lowering if p is NativeLowering else p, why) for p, why in made.passes]
    made.finalize()
    return [made]


@contextmanager
def _numba_in_parts() -> Iterator[None]:
    """Compiles what Numba adds, and Python never calls, as parts; Numba's lock is held meanwhile."""
    default: Any = Compiler
    plain = default.define_pipelines

    def define_pipelines(self: Any) -> list[Any]:
        added = self.state.flags.no_compile or self.state.func_id.modname.startswith("numba.")
        return _pipelines(self.state, PartLowering) if added else plain(self)

    default.define_pipelines = define_pipelines
    try:
        yield
    finally:
        default.define_pipelines = plain
