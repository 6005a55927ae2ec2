"""Small bugs in a Python source: one change of the syntax tree each, such as a swapped operator or a dropped term.

Only what a program computes is changed: no docstrings, annotations, decorators, messages of errors, or imports.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

_ARITHMETIC: dict[type[ast.operator], tuple[type[ast.operator], ...]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.Mod: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
}
_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.GtE),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
}
_NAMES = {"min": "max", "max": "min", "sin": "cos", "cos": "sin", "argmin": "argmax", "argmax": "argmin"}
_EVEN = ("abs", "np.abs", "math.fabs", "np.linalg.norm", "np.square")
"""Functions of the size of their first argument; a norm along any axis is one."""
_SYMMETRIC = ("np.minimum", "np.maximum", "np.hypot", "math.hypot", "dot", "math.isclose")
_IGNORED = (ast.Raise, ast.Assert, ast.JoinedStr, ast.Import, ast.ImportFrom)


@dataclass(frozen=True, kw_only=True, order=True)
class Mutant:
    """One change of a source.

    Attributes:
        line: First line of the changed expression, from 1.
        start: Its first byte in the source.
        stop: The byte after its last one.
        kind: What was changed, such as `sign` or `constant`.
        before: The expression.
        after: What replaces it.
    """

    line: int
    start: int
    stop: int
    kind: str
    before: str
    after: str

    def applied(self, source: str) -> str:
        """The source with the change."""
        data = source.encode()
        return (data[: self.start] + self.after.encode() + data[self.stop :]).decode()


def mutants(source: str) -> list[Mutant]:
    """All changes of a source, in the order of its lines; a few are no change, see `is_change`.

    Args:
        source: Of a Python module.
    """
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    data, mutant_list = source.encode(), []
    for node in _computed(ast.parse(source)):
        first = starts[node.lineno - 1] + node.col_offset
        last = starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
        for kind, changed in _changes(node):
            text = ast.unparse(changed)
            after = text if isinstance(node, ast.stmt | ast.Name | ast.Constant) else f"({text})"
            before = data[first:last].decode()
            mutant_list.append(Mutant(line=node.lineno, start=first, stop=last, kind=kind, before=before, after=after))
    return sorted(mutant_list)


def is_change(source: str, mutant: Mutant) -> bool:
    """Whether the changed source compiles, to another syntax tree than the source.

    The order of two operands does not count where the result is the same to the last bit: of a difference whose size
    alone matters, and of the arguments of a symmetric function.
    """
    try:
        changed = statements_at(mutant.line, source, mutant.applied(source))
    except SyntaxError:
        return False
    return _shapes(changed) != _shapes(statements_at(mutant.line, source, source))


def statements_at(line: int, source: str, changed: str) -> list[ast.stmt]:
    """Top-level statements of a changed source in the place of those at a line, which alone the change concerns.

    Args:
        line: Of the source.
        source: The source before the change.
        changed: The source after it; where it has more or fewer statements, all of them are given.

    Raises:
        SyntaxError: The changed source does not compile.
    """
    spans, after = _statement_lines(source), ast.parse(changed).body
    if len(spans) != len(after):
        return after
    return [statement for (first, last), statement in zip(spans, after) if first <= line <= last]


@lru_cache(maxsize=256)
def _statement_lines(source: str) -> list[tuple[int, int]]:
    """First and last line of each top-level statement; the unchanged source is asked for once per change."""
    return [(statement.lineno, statement.end_lineno or 0) for statement in ast.parse(source).body]


def _shapes(statements: list[ast.stmt]) -> list[str]:
    """Statements as text, with operands whose order has no effect in a fixed one."""
    return [ast.dump(_Unordered().visit(statement)) for statement in statements]


class _Unordered(ast.NodeTransformer):
    """Brings operands whose order has no effect into a fixed one."""

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        name = ast.unparse(node.func)
        if name in _EVEN and node.args:
            node.args[0] = _sorted_difference(node.args[0])
        elif name in _SYMMETRIC and len(node.args) == 2 and not node.keywords:
            node.args.sort(key=ast.dump)
        return node

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.op, ast.Pow) and isinstance(node.right, ast.Constant) and node.right.value == 2:
            node.left = _sorted_difference(node.left)
        return node


def _sorted_difference(node: ast.expr) -> ast.expr:
    """A difference with its operands in a fixed order; anything else as it is."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub):
        node.left, node.right = sorted((node.left, node.right), key=ast.dump)
    return node


def _computed(node: ast.AST) -> Iterator[ast.expr | ast.AugAssign]:
    """Expressions and augmented assignments below a node that take part in what the program computes."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params", "bases"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or isinstance(child, _IGNORED) or _is_text(child) or _is_typing(child):
                continue
            if isinstance(child, ast.expr | ast.AugAssign):
                yield child
            yield from _computed(child)


def _is_text(node: ast.AST) -> bool:
    """Whether a statement is a docstring."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _is_typing(node: ast.AST) -> bool:
    """Whether a statement is for type checkers, or for `python -m`, alone."""
    return isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "__name__ == '__main__'")


def _changes(node: ast.expr | ast.AugAssign) -> Iterator[tuple[str, ast.expr | ast.AugAssign]]:
    if isinstance(node, ast.AugAssign):
        for other in _ARITHMETIC.get(type(node.op), ()):
            yield "operator", ast.AugAssign(target=node.target, op=other(), value=node.value)
    elif isinstance(node, ast.BinOp):
        for other in _ARITHMETIC.get(type(node.op), ()):
            yield "operator", ast.BinOp(left=node.left, op=other(), right=node.right)
        if isinstance(node.op, ast.Add | ast.Sub | ast.Mult):
            yield "dropped term", node.left
        if isinstance(node.op, ast.Sub):
            yield "order", ast.BinOp(left=node.right, op=node.op, right=node.left)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield "sign" if isinstance(node.op, ast.USub) else "negation", node.operand
    elif isinstance(node, ast.Compare) and len(node.ops) == 1:
        for compared in _COMPARISONS.get(type(node.ops[0]), ()):
            yield "comparison", ast.Compare(left=node.left, ops=[compared()], comparators=node.comparators)
    elif isinstance(node, ast.BoolOp):
        other_op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield "condition", ast.BoolOp(op=other_op, values=node.values)
        yield (
            "dropped term",
            ast.BoolOp(op=node.op, values=node.values[:-1]) if len(node.values) > 2 else node.values[0],
        )
    elif isinstance(node, ast.IfExp):
        yield "order", ast.IfExp(test=node.test, body=node.orelse, orelse=node.body)
    elif isinstance(node, ast.Constant):
        yield from _other_constants(node)
    elif isinstance(node, ast.Call):
        yield from _other_calls(node)
    elif isinstance(node, ast.Tuple) and isinstance(node.ctx, ast.Load) and len(node.elts) in (2, 3):
        yield "order", ast.Tuple(elts=[node.elts[1], node.elts[0], *node.elts[2:]], ctx=node.ctx)


def _other_constants(node: ast.Constant) -> Iterator[tuple[str, ast.expr]]:
    if isinstance(node.value, bool):
        yield "constant", ast.Constant(value=not node.value)
    elif isinstance(node.value, int):
        yield "constant", ast.Constant(value=node.value + 1)
    elif isinstance(node.value, float):
        yield "constant", ast.Constant(value=2 * node.value if node.value else 1.0)


def _other_calls(node: ast.Call) -> Iterator[tuple[str, ast.expr]]:
    function = node.func
    if isinstance(function, ast.Attribute) and function.attr in _NAMES:
        renamed: ast.expr = ast.Attribute(value=function.value, attr=_NAMES[function.attr], ctx=function.ctx)
        yield "function", ast.Call(func=renamed, args=node.args, keywords=node.keywords)
    elif isinstance(function, ast.Name) and function.id in _NAMES:
        renamed = ast.Name(id=_NAMES[function.id], ctx=function.ctx)
        yield "function", ast.Call(func=renamed, args=node.args, keywords=node.keywords)
    starred = any(isinstance(a, ast.Starred) for a in node.args)
    if len(node.args) >= 2 and not starred and ast.unparse(function) not in ("min", "max", "math.hypot", "isinstance"):
        yield (
            "order",
            ast.Call(func=function, args=[node.args[1], node.args[0], *node.args[2:]], keywords=node.keywords),
        )
