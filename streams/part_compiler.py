"""Compiles an entry point and what it calls as one program, by Numba internals (`compiled.INTERNALS`).

Numba by itself makes every function a program of its own: it links, optimises and makes machine code of each together
with all that it calls, again and again on the way out. Here a function that only others call, and each of Numba's own
that they call, stays a part, until the entry point links all parts and optimises them once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from numba import _dynfunc, config, types  # type: ignore[attr-defined]
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.dispatcher import Dispatcher
from numba.core.typed_passes import NativeLowering

if TYPE_CHECKING:
    from numba.core.compiler import CompileResult, StateDict
    from numba.core.compiler_machinery import PassManager


class PartLibrary(JITCodeLibrary):
    """Code of a function that only goes into others, neither linked nor made machine code."""

    def finalize(self) -> None:  # noqa: D102
        # ends the compilation of a part, in place of Numba's method, which would optimise it and make machine code
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "external":
                function.linkage = "linkonce_odr"  # several entry points may contain it
        self._finalize_dynamic_globals()
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """The module of this part and of all parts below it, for a library of Numba's own kind.

        Such a library links only what it calls itself.
        """
        if self._shared_module is None:
            self._shared_module = self._final_module.clone()
            for library in _all_below(self):
                self._shared_module.link_in(_own_module(library), preserve=True)
        return self._shared_module


class EntryLibrary(JITCodeLibrary):
    """Code of an entry point and of all parts that it calls, directly or not."""

    def finalize(self) -> None:  # noqa: D102
        # adds the code of all parts to the entry point's own, which Numba then optimises as one
        for library in _all_below(self):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(_own_module(library), preserve=True)
        self._linking_libraries = []
        super().finalize()


def _own_module(library: JITCodeLibrary) -> Any:
    """The LLVM module that a caller links: of a part its own code, of another library all that it contains."""
    return library._final_module if isinstance(library, PartLibrary) else library._get_module_for_linking()


def _all_below(library: JITCodeLibrary) -> list[JITCodeLibrary]:
    """Each library once that a part or an entry point calls, directly or through parts.

    Callers come before what they call: LLVM leaves out a function that nothing linked before calls.
    """
    # depth-first search: libraries all of whose calls are visited, in that order; those on the way, with their calls
    finished: dict[JITCodeLibrary, None] = {}
    open_ = [(library, iter(library._linking_libraries))]
    entered = {library}
    while open_:
        caller, called = open_[-1]
        below = next(called, None)
        if below is None:
            finished[caller] = None
            open_.pop()
        elif below not in entered:
            below._ensure_finalized()
            entered.add(below)
            open_.append((below, iter(below._linking_libraries if isinstance(below, PartLibrary) else ())))
    return [below for below in reversed(finished) if below is not library]


@register_pass(mutates_CFG=True, analysis_only=False)
class PartLowering(NativeLowering):
    """Leaves out machine code of its own."""

    _name = "part_lowering"

    def run_pass(self, state: StateDict) -> bool:  # noqa: D102
        state.library = PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        # a function object that stands for the part in the code of its callers; Python never calls it
        key = _dynfunc.make_function(state.cr.fndesc.lookup_module(), "part", "", 0, state.cr.env, (state.library,))
        state.targetctx.insert_user_function(key, state.cr.fndesc, [state.library])
        state.cr = state.cr._replace(cfunc=key)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class EntryLowering(NativeLowering):
    """Links and optimises all parts at once."""

    _name = "entry_lowering"

    def run_pass(self, state: StateDict) -> bool:  # noqa: D102
        state.library = EntryLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


class PartCompiler(CompilerBase):
    """Compiles for other compiled functions only."""

    def define_pipelines(self) -> list[PassManager]:  # noqa: D102
        return _pipelines(self.state, PartLowering)


class EntryCompiler(CompilerBase):
    """Compiles what Python calls."""

    llvm_level = 3

    def compile_extra(self, func: Callable[..., object]) -> CompileResult:  # noqa: D102
        with _in_parts(self.llvm_level):
            return super().compile_extra(func)

    def define_pipelines(self) -> list[PassManager]:  # noqa: D102
        return _pipelines(self.state, EntryLowering)


def _pipelines(state: StateDict, lowering: type[NativeLowering]) -> list[PassManager]:
    """Numba's pipeline with the given lowering in place of its own."""
    pass_builder = DefaultPassBuilder.define_nopython_pipeline(state)
    pass_builder.passes = [(lowering if p is NativeLowering else p, why) for p, why in pass_builder.passes]
    pass_builder.finalize()
    return [pass_builder]


def entry_compiler(llvm_level: int) -> type[EntryCompiler]:
    """The compiler of what Python calls, with a level of LLVM's optimisation, 1 to 3."""
    return type("EntryCompiler", (EntryCompiler,), {"llvm_level": llvm_level})


@contextmanager
def _in_parts(llvm_level: int) -> Iterator[None]:
    """Lets Numba compile what an entry point calls as parts, which the entry point links and optimises all at once.

    A part is neither linked nor made machine code by itself. While the body runs, under Numba's lock, what Numba itself
    adds and Python never calls becomes a part, too; and a part is compiled once for an integer argument, not again for
    each number that is written in a call. Afterwards Numba's classes are as before.

    Args:
        llvm_level: Level of LLVM's optimisation, 1 to 3.
    """
    default_compiler: Any = Compiler
    default_dispatcher: Any = Dispatcher
    settings: Any = config
    plain, plain_call, plain_level = Compiler.define_pipelines, Dispatcher.get_call_template, settings.OPT

    def define_pipelines(self: Compiler) -> list[PassManager]:
        """In place of that of Numba's compiler: functions that Numba adds become parts."""
        added = self.state.flags.no_compile or self.state.func_id.modname.startswith("numba.")
        return _pipelines(self.state, PartLowering) if added else plain(self)

    def get_call_template(
        self: Dispatcher[Callable[..., object]], args: tuple[types.Type, ...], kws: dict[str, types.Type]
    ) -> object:
        """In place of that of Numba's dispatcher: a literal argument of a part has the type of a variable."""
        if self._compiler.pipeline_class is PartCompiler:  # type: ignore[attr-defined]
            args = tuple(types.unliteral(a) for a in args)
        return plain_call(self, args, kws)

    default_compiler.define_pipelines, default_dispatcher.get_call_template = define_pipelines, get_call_template
    settings.OPT = min(plain_level, type(plain_level)(llvm_level))
    try:
        yield
    finally:
        settings.OPT = plain_level
        default_compiler.define_pipelines, default_dispatcher.get_call_template = plain, plain_call
