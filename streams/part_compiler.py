"""Compiles an entry point and what it calls as one program, by Numba internals (`compiled.INTERNALS`).

Numba by itself makes every function a program of its own: it links, optimises and makes machine code of each together
with all that it calls, again and again on the way out. Here a function that only others call, and each of Numba's own
that they call, stays a part, until the entry point links all parts and optimises them once.

Numba also counts the references of each array that a variable names, of a tuple's arrays all of them. In a part that
makes no arrays and returns none, the caller's references keep them alive: there nothing is counted. Without this, the
filters of the feet, whose state is a tuple of arrays, were compiled in 1.4 times and ran in three times the time.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from numba import _dynfunc, config, types  # type: ignore[attr-defined]
from numba.core import errors, ir
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.dispatcher import Dispatcher
from numba.core.typed_passes import NativeLowering

if TYPE_CHECKING:
    from numba.core.compiler import CompileResult, StateDict
    from numba.core.compiler_machinery import PassManager


_BORROWING = frozenset(("build_tuple", "cast", "exhaust_iter", "getattr", "getitem", "phi", "static_getitem"))
"""Operations of Numba's intermediate code whose array is that of an operand, or a view of it."""


class PartLibrary(JITCodeLibrary):
    """Code of a function that only goes into others, neither linked nor made machine code."""

    def finalize(self) -> None:  # noqa: D102
        # ends the compilation of a part, in place of Numba's method, which would optimise it and make machine code
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "external":
                # several entry points may contain this function: the linker then keeps one of the copies
                function.linkage = "linkonce_odr"
        self._finalize_dynamic_globals()
        self._finalized = True  # so that Numba lets others link it

    def _get_module_for_linking(self) -> Any:
        """The module of this part and of all parts below it, for a library of Numba's own kind.

        A library of Numba's own kind links only the modules of what it calls itself, so these must contain the rest.
        The module is built once and kept.
        """
        if self._shared_module is None:
            self._shared_module = self._final_module.clone()
            for library in _list_called_libraries(self):
                self._shared_module.link_in(_choose_module_to_link(library), preserve=True)
        return self._shared_module


class EntryLibrary(JITCodeLibrary):
    """Code of an entry point and of all parts that it calls, directly or not."""

    def finalize(self) -> None:  # noqa: D102
        # adds the code of all parts to the entry point's own, which Numba then optimises as one
        for library in _list_called_libraries(self):
            self._reload_init.update(library._reload_init)  # what Numba calls when it loads the code from its cache
            self._final_module.link_in(_choose_module_to_link(library), preserve=True)
        self._linking_libraries = []  # nothing is left for Numba to link
        super().finalize()


def _choose_module_to_link(library: JITCodeLibrary) -> Any:
    """The LLVM module that a caller links: of a part its own code, of another library all that it contains."""
    return library._final_module if isinstance(library, PartLibrary) else library._get_module_for_linking()


def _list_called_libraries(library: JITCodeLibrary) -> list[JITCodeLibrary]:
    """Lists each library once that a part or an entry point calls, directly or through parts.

    Callers come before what they call: LLVM leaves out a function that nothing linked before calls. The order is the
    reverse of that in which a depth-first search completes the libraries.
    """
    completed: list[JITCodeLibrary] = []  # libraries all of whose calls have been visited, in that order
    # the way from `library` to the present one: each with those of its calls that are still to be visited
    way = [(library, iter(library._linking_libraries))]
    entered = {library}
    while way:
        caller, calls_to_visit = way[-1]
        called = next(calls_to_visit, None)
        if called is None:
            completed.append(caller)
            way.pop()
        elif called not in entered:
            called._ensure_finalized()
            entered.add(called)
            # a library of Numba's own kind contains what it calls, so its calls are not visited
            way.append((called, iter(called._linking_libraries if isinstance(called, PartLibrary) else ())))
    return [called for called in reversed(completed) if called is not library]


def _only_borrows_arrays(state: StateDict) -> bool:
    """Whether all arrays that a function names are its caller's, or views of them, and it returns none.

    Args:
        state: State of one compilation, with types.
    """
    models = state.targetctx.data_model_manager
    # types of the variables that keep memory alive
    holding = {t for t in {*state.typemap.values(), state.return_type} if models[t].contains_nrt_meminfo()}
    if state.return_type in holding or not all(map(_is_array_or_tuple, holding)):
        return False  # another type is such as a list, which gets other memory while it grows

    def holds_array(variable: ir.Var) -> bool:
        """Whether a variable is an array, or a tuple with one."""
        return state.typemap[variable.name] in holding

    def makes_array(statement: ir.Stmt) -> bool:
        """Whether an array may come out of a statement that is neither one of its operands nor a view of it."""
        if isinstance(statement, (ir.SetItem, ir.StaticSetItem)):
            return holds_array(statement.value)  # it is copied before, in case both overlap
        if not isinstance(statement, ir.Assign) or not holds_array(statement.target):
            return False
        source = statement.value
        if not isinstance(source, ir.Expr):
            return not isinstance(source, (ir.Arg, ir.Const, ir.FreeVar, ir.Global, ir.Var))
        # an array of indices selects what no view can be of; the array that a call returns belongs to its caller
        return source.op not in _BORROWING or (source.op == "getitem" and holds_array(source.index))

    return not any(makes_array(statement) for block in state.func_ir.blocks.values() for statement in block.body)


def _is_array_or_tuple(variable_type: types.Type) -> bool:
    """Whether a type is that of an array, or of a tuple, named or not, of arrays, tuples and scalars."""
    if isinstance(variable_type, types.BaseTuple):
        members: Any = variable_type  # every tuple of Numba's can be iterated, but its types do not say so
        return all(isinstance(t, types.Number | types.Boolean) or _is_array_or_tuple(t) for t in members)
    return isinstance(variable_type, types.Array)


@register_pass(mutates_CFG=True, analysis_only=False)
class PartLowering(NativeLowering):
    """Numba's pass from typed code to LLVM code, for a part: it makes no machine code."""

    _name = "part_lowering"

    def run_pass(self, state: StateDict) -> bool:  # noqa: D102
        # `state` is that of one compilation
        counting = state.targetctx
        if counting.enable_nrt and not state.func_id.modname.startswith("numba.") and _only_borrows_arrays(state):
            state.targetctx = counting.subtarget(enable_nrt=False)
            vars(state.targetctx).pop("nrt", None)  # what counts references, kept from the context that does
            try:
                return self._lower(state)
            except errors.NumbaRuntimeError:  # Numba makes an array for something else that the function does
                state.targetctx = counting
        return self._lower(state)

    def _lower(self, state: StateDict) -> bool:
        """Makes the LLVM code; `state.cr` is the result that Numba's own pass stores in the state."""
        state.library = PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True  # no machine code
        super().run_pass(state)
        # a function object that stands for the part in the code of its callers; Python never calls it
        key = _dynfunc.make_function(state.cr.fndesc.lookup_module(), "part", "", 0, state.cr.env, (state.library,))
        state.targetctx.insert_user_function(key, state.cr.fndesc, [state.library])
        state.cr = state.cr._replace(cfunc=key)
        return True  # the pass has changed the state


@register_pass(mutates_CFG=True, analysis_only=False)
class EntryLowering(NativeLowering):
    """Numba's pass from typed code to LLVM and machine code, for an entry point with all of its parts at once."""

    _name = "entry_lowering"

    def run_pass(self, state: StateDict) -> bool:  # noqa: D102
        state.library = EntryLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


class PartCompiler(CompilerBase):
    """Compiles for other compiled functions only."""

    def define_pipelines(self) -> list[PassManager]:  # noqa: D102
        # Numba calls it for its passes
        return _build_pipelines(self.state, PartLowering)


class EntryCompiler(CompilerBase):
    """Compiles what Python calls."""

    llvm_level = 3

    def compile_extra(self, func: Callable[..., object]) -> CompileResult:  # noqa: D102
        # Numba calls it to compile a function, and with it all that the function calls
        with _compile_called_as_parts(self.llvm_level):
            return super().compile_extra(func)

    def define_pipelines(self) -> list[PassManager]:  # noqa: D102
        # Numba calls it for its passes
        return _build_pipelines(self.state, EntryLowering)


def _build_pipelines(state: StateDict, lowering: type[NativeLowering]) -> list[PassManager]:
    """Builds Numba's pipeline of passes, with `lowering` in place of its pass from typed code to machine code.

    Args:
        state: State of one compilation.
        lowering: `PartLowering` or `EntryLowering`.

    Returns:
        The one pipeline, in a list, as Numba tries several in turn.
    """
    pass_builder = DefaultPassBuilder.define_nopython_pipeline(state)
    # Numba keeps each pass with a description of it
    pass_builder.passes = [(lowering if p is NativeLowering else p, text) for p, text in pass_builder.passes]
    pass_builder.finalize()
    return [pass_builder]


def entry_compiler(llvm_level: int) -> type[EntryCompiler]:
    """The subclass of `EntryCompiler` that compiles at a level of LLVM's optimisation, 1 to 3."""
    return type("EntryCompiler", (EntryCompiler,), {"llvm_level": llvm_level})


@contextmanager
def _compile_called_as_parts(llvm_level: int) -> Iterator[None]:
    """Lets Numba compile what an entry point calls as parts, which the entry point links and optimises all at once.

    A part is neither linked nor made machine code by itself. While the body runs, under Numba's lock, two methods of
    Numba's classes are replaced: functions that Numba itself adds, and Python never calls, become parts, too; and a
    part is compiled once for an integer argument, not again for each number that is written in a call. Afterwards
    Numba's classes are as before. Python looks for no unreachable objects meanwhile: with the millions of objects of
    a compilation that took a tenth of its time.

    Args:
        llvm_level: Level of LLVM's optimisation, 1 to 3.
    """
    default_compiler: Any = Compiler
    default_dispatcher: Any = Dispatcher
    settings: Any = config
    # what is replaced here, and put back at the end
    plain, plain_call, plain_level = Compiler.define_pipelines, Dispatcher.get_call_template, settings.OPT

    def define_pipelines(self: Compiler) -> list[PassManager]:
        """In place of that of Numba's compiler: functions that Numba adds become parts."""
        added = self.state.flags.no_compile or self.state.func_id.modname.startswith("numba.")
        return _build_pipelines(self.state, PartLowering) if added else plain(self)

    def get_call_template(
        self: Dispatcher[Callable[..., object]], args: tuple[types.Type, ...], kws: dict[str, types.Type]
    ) -> object:
        """In place of that of Numba's dispatcher: a literal argument of a part has the type of a variable."""
        if self._compiler.pipeline_class is PartCompiler:  # type: ignore[attr-defined]
            args = tuple(types.unliteral(a) for a in args)
        return plain_call(self, args, kws)

    default_compiler.define_pipelines, default_dispatcher.get_call_template = define_pipelines, get_call_template
    # Numba's level is an object of its own type; a lower one, which the user has set, stays
    settings.OPT = min(plain_level, type(plain_level)(llvm_level))
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()
        settings.OPT = plain_level
        default_compiler.define_pipelines, default_dispatcher.get_call_template = plain, plain_call
