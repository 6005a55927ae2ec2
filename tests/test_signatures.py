"""No function takes more arguments than a reader can keep apart: what belongs together goes in a named structure."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
PRODUCT = ("streams", "batch", "sim", "estimators", "scenarios", "pipeline", "evaluation", "report", "studies", "cli")
MOST = 10


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """How many a caller gives."""
    given = function.args
    named = [a.arg for a in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return len(named) - (named[:1] in (["self"], ["cls"]))


def longest(source: str) -> list[tuple[str, int]]:
    """Functions of a module with more than `MOST` parameters."""
    functions = (n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef))
    return [(f.name, parameters(f)) for f in functions if parameters(f) > MOST]


def test_no_function_has_more_than_ten_parameters():
    files = [path for package in PRODUCT for path in sorted((ROOT / package).rglob("*.py"))]
    assert len(files) > 300
    assert not [(str(p.relative_to(ROOT)), *found) for p in files for found in longest(p.read_text("utf-8"))]


def test_every_kind_of_parameter_counts():
    ten, eleven = (", ".join(f"a{i}" for i in range(n)) for n in (10, 11))
    assert not longest(f"class A:\n    def f(self, {ten}): pass")
    assert longest(f"def f(a, /, b, *, {ten}): pass") == [("f", 12)]
    assert longest(f"class A:\n    @classmethod\n    async def f(cls, {eleven}): pass") == [("f", 11)]
