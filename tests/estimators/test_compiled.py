"""Compiled functions are kept until something changes that is compiled into them."""

from __future__ import annotations

import ast
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from stridetwin import estimators
from stridetwin.estimators.compiled import cached

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
    monkeypatch.setitem(sys.modules, "inner", loaded(folder, "inner"))
    function = cached(folder)(loaded(folder, "outer").outer)
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


def decorated(node: ast.AST, *words: str) -> bool:
    return isinstance(node, ast.FunctionDef) and any(w in ast.unparse(d) for d in node.decorator_list for w in words)


def named_by_python(node: ast.AST) -> set[str]:
    """Names that are used outside compiled functions."""
    found = set()
    for child in ast.iter_child_nodes(node):
        if decorated(child, "njit", "cached", "_called"):
            continue
        if isinstance(child, ast.Call):
            found.add(ast.unparse(child.func).split(".")[-1])
        found |= named_by_python(child)
    return found


def imported(tree: ast.Module) -> set[tuple[str, str]]:
    """Module and name."""
    nodes = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module]
    return {(str(n.module), a.name) for n in nodes for a in n.names}


def test_python_calls_nothing_that_only_compiled_functions_can():
    """It would end the process without a word."""
    (root,) = [Path(p) for p in estimators.__path__]
    trees = {
        ".".join(("stridetwin.estimators", *path.relative_to(root).with_suffix("").parts)): ast.parse(path.read_text())
        for path in sorted(root.rglob("*.py"))
    }
    inside = {(module, n.name) for module, tree in trees.items() for n in tree.body if decorated(n, "INSIDE")}
    assert len(inside) > 100
    for module, tree in trees.items():
        called = named_by_python(tree)
        reached = imported(tree) | {(module, name) for name in called}
        assert not [name for _, name in inside & reached if name in called], module
