"""Compiles functions that are used only inside other compiled functions, by Numba internals (`compiled.INTERNALS`)."""

from __future__ import annotations

from typing import Any

from numba import _dynfunc  # type: ignore[attr-defined]
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering


class PartLibrary(JITCodeLibrary):
    """Code of a function that only goes into others: it is optimised and made machine code there alone."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


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


class PartCompiler(CompilerBase):
    """Compiles for other compiled functions only."""

    def define_pipelines(self) -> list[Any]:  # noqa: D102
        made = DefaultPassBuilder.define_nopython_pipeline(self.state)
        made.passes = [(PartLowering if p is NativeLowering else p, why) for p, why in made.passes]
        made.finalize()
        return [made]
