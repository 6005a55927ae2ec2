"""Compiled functions are kept until something changes that is compiled into them."""

from __future__ import annotations

import ast
import gc
import importlib.util
import sys
import tomllib
import weakref
from pathlib import Path
from types import ModuleType

import numba
import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from stridetwin import estimators, sim, streams
from stridetwin.estimators.dvio import kernel, patches
from stridetwin.streams import compiled, part_compiler
from stridetwin.streams.compiled import KNOWN, entry_kernel, find_missing_internals, is_known, is_uncompiled
from stridetwin.streams.part_compiler import PartLibrary, _list_called_libraries
from tests.estimators.from_python import from_python

INNER = "from numba import njit\n\n\n@njit\ndef doubled(x):\n    return 2 * x\n"
OUTER = "from inner import doubled\n\n\ndef outer(x):\n    return doubled(x) + 1\n"


def loaded(folder: Path, name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def hits_and_value(folder: Path, monkeypatch) -> tuple[int, int]:
    # Python takes a module that is changed within a second, and stays as long, for the compiled one
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setitem(sys.modules, "inner", loaded(folder, "inner"))
    function = entry_kernel(folder)(loaded(folder, "outer").outer)
    value = function(3)
    return sum(function.stats.cache_hits.values()), value


def test_what_is_called_inside_counts(tmp_path, monkeypatch):
    (tmp_path / "inner.py").write_text(INNER)
    (tmp_path / "outer.py").write_text(OUTER)
    assert hits_and_value(tmp_path, monkeypatch) == (0, 7)
    assert hits_and_value(tmp_path, monkeypatch) == (1, 7)
    (tmp_path / "inner.py").write_text(INNER.replace("2 * x", "3 * x"))
    assert hits_and_value(tmp_path, monkeypatch) == (0, 10)
    assert hits_and_value(tmp_path, monkeypatch) == (1, 10)


PAIRS = """from typing import NamedTuple


class Pair(NamedTuple):
    first: int
    second: int


def total(pair):
    return pair[0] + pair[1]
"""


def test_a_class_that_is_gone_is_no_error(tmp_path, monkeypatch):
    (tmp_path / "pairs.py").write_text(PAIRS)
    old = loaded(tmp_path, "pairs")
    monkeypatch.setitem(sys.modules, "pairs", old)
    assert entry_kernel(tmp_path)(old.total)(old.Pair(1, 2)) == 3
    (tmp_path / "pairs.py").write_text(PAIRS.replace("Pair", "Two"))
    new = loaded(tmp_path, "pairs")
    monkeypatch.setitem(sys.modules, "pairs", new)
    assert entry_kernel(tmp_path)(new.total)(new.Two(1, 2)) == 3


def test_a_package_is_uncompiled_until_a_function_of_it_is_cached(tmp_path, monkeypatch):
    (tmp_path / "package_outer.py").write_text(OUTER)
    (tmp_path / "inner.py").write_text(INNER)
    monkeypatch.setitem(sys.modules, "inner", loaded(tmp_path, "inner"))
    assert not is_uncompiled("package_outer")  # it has no such function yet
    function = entry_kernel(tmp_path)(loaded(tmp_path, "package_outer").outer)
    assert is_uncompiled("package_outer")
    assert not is_uncompiled("package")  # another name
    assert function(3) == 7
    assert not is_uncompiled("package_outer")


def decorated(node: ast.AST, *words: str) -> bool:
    return isinstance(node, ast.FunctionDef) and any(w in ast.unparse(d) for d in node.decorator_list for w in words)


def called_by_python(node: ast.AST, modules: set[str]) -> set[tuple[str, str]]:
    """Functions called outside compiled functions: the module of `modules` before the dot, if any, and the name.

    Methods of objects do not count.
    """
    found = set()
    for child in ast.iter_child_nodes(node):
        if decorated(child, "njit", "entry_kernel"):
            continue
        if isinstance(child, ast.Call):
            owner, _, name = ast.unparse(child.func).rpartition(".")
            if not owner or owner in modules:
                found.add((owner, name))
        found |= called_by_python(child, modules)
    return found


def test_methods_are_no_functions_that_python_calls():
    tree = ast.parse(
        "def f(x):\n    return mean(x) + x.sum() + module.sort(x)\n\n@njit\ndef g(x):\n    return inner(x)"
    )
    assert called_by_python(tree, {"module"}) == {("", "mean"), ("module", "sort")}


def imported(tree: ast.Module) -> set[tuple[str, str]]:
    """Module and name."""
    nodes = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module]
    return {(str(n.module), a.name) for n in nodes for a in n.names}


def test_python_calls_nothing_that_only_compiled_functions_can():
    """It would end the process without a word."""
    trees = {
        ".".join((part.__name__, *path.relative_to(root).with_suffix("").parts)): ast.parse(path.read_text())
        for part in (estimators, sim, streams)
        for root in map(Path, part.__path__)
        for path in sorted(root.rglob("*.py"))
    }
    inside = {(module, n.name) for module, tree in trees.items() for n in tree.body if decorated(n, "INNER_KERNEL")}
    assert len(inside) > 150
    for module, tree in trees.items():
        imports = imported(tree)
        called = called_by_python(tree, {name for _, name in imports})
        reached = {(module, name) for owner, name in called if not owner}
        reached |= {(source, name) for source, name in imports if ("", name) in called}
        reached |= {(f"{parent}.{m}", name) for parent, m in imports for owner, name in called if owner == m}
        assert not inside & reached, module


def test_the_installed_numba_has_the_internals_that_fast_compilation_needs():
    """Where this fails, see `INTERNALS`: adapt `compiled.py` and move `KNOWN`."""
    assert not find_missing_internals()
    assert is_known(numba.__version__)
    assert hasattr(numba.njit(cache=True)(find_missing_internals)._cache._cache_file, "_source_stamp")


def test_a_lacking_internal_is_named(monkeypatch):
    monkeypatch.setattr(compiled, "INTERNALS", (("numba.core.codegen", "JITCodeLibrary.gone"), ("numba.none", "x")))
    assert find_missing_internals() == ["numba.core.codegen.JITCodeLibrary.gone", "numba.none.x"]


def test_the_package_asks_for_no_version_that_is_too_old_and_refuses_no_new_one():
    asked = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]["dependencies"]
    assert f"numba>={'.'.join(map(str, KNOWN[0]))}" in asked


@pytest.mark.parametrize(
    ("version", "known"),
    [("0.60.0", False), ("0.61.0rc1", True), ("0.68.1", True), ("0.69.0", False), ("1.0", False)],
)
def test_versions_are_distinguished(version, known):
    assert is_known(version) is known


@pytest.mark.parametrize("hidden", ["version", "internals"])
def test_with_another_numba_everything_is_compiled_plainly(hidden, tmp_path, monkeypatch):
    """Numbers stay the same; only the options differ."""
    if hidden == "version":
        monkeypatch.setattr(numba, "__version__", "99.0.0")
    else:
        monkeypatch.delattr("numba.core.compiler_machinery.register_pass")
    plain = loaded(Path(compiled.__file__).parent, "compiled")
    assert plain.INNER_KERNEL == {}
    (tmp_path / "inner.py").write_text(
        INNER.replace("@njit", "@njit(**INNER_KERNEL)").replace("import njit", "import njit\n\nINNER_KERNEL = {}")
    )
    (tmp_path / "outer.py").write_text(OUTER)
    monkeypatch.setitem(sys.modules, "inner", loaded(tmp_path, "inner"))
    function = plain.entry_kernel(tmp_path)(loaded(tmp_path, "outer").outer)
    assert function(3) == 7
    assert sum(function.stats.cache_misses.values()) == 1


PART = """
from numba import njit
import numpy as np
from stridetwin.streams.compiled import INNER_KERNEL


@njit(**INNER_KERNEL)
def power(x, n):
    result = np.ones(2)
    for _ in range(n):
        result *= x
    return result.sum()


def outer(x):
    return power(x, 2) + power(x, 3) + np.linalg.solve(np.eye(2), np.ones(2)).sum()
"""


def test_a_part_is_compiled_once_for_all_integers(tmp_path):
    (tmp_path / "parts.py").write_text(PART)
    module = loaded(tmp_path, "parts")
    assert entry_kernel(tmp_path, llvm_level=1)(module.outer)(2.0) == 2 * (4 + 8) + 2
    assert len(module.power.signatures) == 1


def test_what_numba_added_as_a_part_serves_functions_of_numbas_own_kind(tmp_path):
    (tmp_path / "parts.py").write_text(PART)
    module = loaded(tmp_path, "parts")
    assert entry_kernel(tmp_path)(module.outer)(1.0) == 6.0
    plain = numba.njit(module.outer)
    assert plain(2.0) == 2 * (4 + 8) + 2


def test_a_function_has_one_kernel_for_the_product_and_the_tests():
    """Two would overwrite each other's machine code in the cache, as they are compiled of different sources."""
    assert from_python(patches.align) is kernel.align
    assert from_python(patches.cornerness) is from_python(patches.cornerness)
    functions = [made.py_func for made in compiled._entry_kernels]
    assert len(functions) == len(set(functions))


def test_a_part_is_linked_after_all_that_call_it():
    """LLVM drops a function that nothing linked before calls."""

    def part(*called: PartLibrary) -> PartLibrary:
        made = object.__new__(PartLibrary)
        made._linking_libraries, made._finalized = list(called), True
        return made

    lowest = part()
    low, other = part(lowest), part(lowest)
    high = part(low, other, lowest)
    order = _list_called_libraries(part(lowest, low, high))
    assert len(order) == 4
    for caller in order:
        assert all(order.index(caller) < order.index(called) for called in caller._linking_libraries)


ARRAYS = """
from typing import NamedTuple

from numba import njit
import numpy as np
from stridetwin.streams.compiled import INNER_KERNEL


class Memory(NamedTuple):
    first: np.ndarray
    second: np.ndarray


@njit(**INNER_KERNEL)
def add_row(row, factor):
    for i in range(len(row)):
        row[i] += factor


@njit(**INNER_KERNEL)
def borrow(memory):
    both, low = (memory.first, memory.second), memory.first[0]
    for k in range(len(memory.first)):
        row = memory.first[k] if k % 2 else low
        add_row(row[1:], both[1][0, 0])
    return both[0][0, 1]


@njit(**INNER_KERNEL)
def view(memory):
    return memory.first[1:]


@njit(**INNER_KERNEL)
def view_and_rest(memory):
    return memory, memory.second[0], 1.0


@njit(**INNER_KERNEL)
def make(memory):
    made = np.zeros(3)
    made[0] = memory.first[0, 0]
    return made.sum()


@njit(**INNER_KERNEL)
def take_view(memory):
    return view(memory)[0, 0]


@njit(**INNER_KERNEL)
def copy_rows(memory):
    memory.first[:2] = memory.first[1:3]
    return 0.0


@njit(**INNER_KERNEL)
def pick_rows(memory, rows):
    return memory.first[rows][0, 1]


@njit(**INNER_KERNEL)
def hold_list(memory):
    rows = [memory.first[0]]
    rows.append(memory.second[0])
    return rows[1][0]


def outer(first, second, rows):
    memory = Memory(first, second)
    total = borrow(memory) + make(memory) + take_view(memory) + copy_rows(memory) + hold_list(memory)
    total += pick_rows(memory, rows)
    kept, row, one = view_and_rest(memory)
    for k in range(50):
        total += borrow(kept) + view(memory)[0, 0] + row[0] + one
    return total
"""


def test_references_are_counted_in_parts_that_make_or_return_arrays_alone(tmp_path, monkeypatch):
    (tmp_path / "arrays.py").write_text(ARRAYS)
    borrows, judge = {}, part_compiler._only_borrows_arrays

    def note(state):
        borrows[state.func_id.func_name] = is_borrowing = judge(state)
        return is_borrowing

    monkeypatch.setattr(part_compiler, "_only_borrows_arrays", note)
    kernel = entry_kernel(tmp_path)(loaded(tmp_path, "arrays").outer)
    (tmp_path / "interpreted.py").write_text(ARRAYS.replace("@njit(**INNER_KERNEL)\n", ""))
    interpreted = loaded(tmp_path, "interpreted").outer
    _nrt_python.memsys_enable_stats()
    before = rtsys.get_allocation_stats()
    totals, ends, arrays = [], [], []
    for outer in (kernel, interpreted):
        first, second = np.arange(9.0).reshape(3, 3), np.full((3, 3), 0.5)
        totals.append(outer(first, second, np.array([2, 0])))
        ends.append((first.tolist(), second.tolist()))
        arrays += [weakref.ref(first), weakref.ref(second)]
        del first, second
    assert totals[0] == totals[1]
    assert ends[0] == ends[1]
    parts = ("add_row", "borrow", "copy_rows", "hold_list", "make", "pick_rows", "take_view", "view", "view_and_rest")
    assert [name for name in parts if borrows[name]] == ["add_row", "borrow"]
    # nothing is kept, and nothing is freed that is still in use
    gc.collect()
    assert [array() for array in arrays] == [None] * 4
    after = rtsys.get_allocation_stats()
    _nrt_python.memsys_disable_stats()
    assert after.alloc - before.alloc == after.free - before.free
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free > 0


def test_a_part_that_needs_the_count_after_all_has_it(tmp_path, monkeypatch):
    (tmp_path / "arrays.py").write_text(ARRAYS)
    judge = part_compiler._only_borrows_arrays
    monkeypatch.setattr(
        part_compiler, "_only_borrows_arrays", lambda state: state.func_id.func_name == "hold_list" or judge(state)
    )
    (tmp_path / "interpreted.py").write_text(ARRAYS.replace("@njit(**INNER_KERNEL)\n", ""))
    kernel, interpreted = (
        entry_kernel(tmp_path)(loaded(tmp_path, "arrays").outer),
        loaded(tmp_path, "interpreted").outer,
    )
    made = [outer(np.arange(9.0).reshape(3, 3), np.ones((3, 3)), np.array([2, 0])) for outer in (kernel, interpreted)]
    assert made[0] == made[1]


def test_while_a_function_is_compiled_python_looks_for_no_unreachable_objects(tmp_path, monkeypatch):
    (tmp_path / "inner.py").write_text(INNER)
    (tmp_path / "outer.py").write_text(OUTER)
    monkeypatch.setitem(sys.modules, "inner", loaded(tmp_path, "inner"))
    seen, build = [], part_compiler._build_pipelines

    def note(*arguments):
        seen.append(gc.isenabled())
        return build(*arguments)

    monkeypatch.setattr(part_compiler, "_build_pipelines", note)
    for is_on in (False, True):
        (gc.enable if is_on else gc.disable)()
        try:
            entry_kernel(tmp_path)(loaded(tmp_path, "outer").outer)(3.0 if is_on else 3)
            assert gc.isenabled() is is_on
        finally:
            gc.enable()
    assert len(seen) >= 2
    assert not any(seen)
