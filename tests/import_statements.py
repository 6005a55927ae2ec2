"""What modules import, in the order of their lines."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")


def find_imports(source: str, *, in_functions: bool = True) -> Iterator[ast.Import | ast.ImportFrom]:
    """Import statements of a module, including those under TYPE_CHECKING.

    Only statements are looked at, never the expressions in them, which are most of a syntax tree.
    """
    waiting: list[ast.AST] = [ast.parse(source)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node
        elif in_functions or not isinstance(node, _FUNCTIONS):
            waiting += reversed([child for block in _BLOCKS for child in getattr(node, block, ())])


@cache
def imports_of_folder(folder: Path) -> list[tuple[Path, ast.Import | ast.ImportFrom]]:
    """Import statements of all modules below a folder, each with its file."""
    return [
        (file, statement)
        for file in sorted(folder.rglob("*.py"))
        for statement in find_imports(file.read_text(encoding="utf-8"))
    ]
