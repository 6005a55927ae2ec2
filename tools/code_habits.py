"""Measures habits of the code: names, `# fmt: skip`, `Any` in public signatures, and long import blocks.

    python tools/code_habits.py [--list]

Prints one line per measure, over the packages that the import rules name. With `--list`, every place is printed, too.
The exit code is 1 where a measure is beyond its limit.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_IRREGULAR = """
beaten become begun bent bitten blown born bought bound broken brought built burnt caught chosen
come dealt dug done drawn driven drunk eaten fallen fed felt flown forgotten fought found frozen
given gone ground grown held hidden kept known laid led left lent lost made meant met mown paid put
ridden risen run rung said seen sent set sewn shaken shown slept sold sought spent spoken spun
stolen stood struck stuck sung swept swum taken taught thought thrown told torn understood won worn
wound woven written
"""
_OTHERS = """
bed bound embed exceed feed ground hundred indeed need proceed put red run seed set speed succeed wound
"""
IRREGULAR_PARTICIPLES = frozenset(_IRREGULAR.split())
NO_PARTICIPLES = frozenset(_OTHERS.split())
"""Words that end like a participle, and participles that are verbs or nouns as well."""
PRONOUNS = frozenset({"found", "own", "words", "made"})
MAX_NAMES_OF_MODULE = 10
VOCABULARIES = frozenset(
    {
        "stridetwin.cli.options",
        "stridetwin.sim.config",
        "stridetwin.streams.algebra.matrices",
        "stridetwin.streams.algebra.tuples",
        "stridetwin.streams.fields",
        "stridetwin.streams.samples",
    }
)
"""Modules whose names are always imported one by one: operators of formulas, and the types and field kinds of
declarations, which are read without a word before them."""


@dataclass(frozen=True)
class Measure:
    """A measure of the code.

    Attributes:
        name: What is counted.
        places: `file:line name` of each.
        value: The measure.
        limit: The largest value that is accepted.
    """

    name: str
    places: list[str]
    value: float
    limit: float


def is_participle(name: str) -> bool:
    """Whether the first word of a function's name is a past participle, as in `posed_frames` or `_made`."""
    word = name.strip("_").split("_")[0].lower()
    if word in NO_PARTICIPLES:
        return False
    return word in IRREGULAR_PARTICIPLES or (word.endswith("ed") and len(word) > 3)


def is_property(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether a function is a property, which is named by a noun or adjective."""
    return any("property" in ast.unparse(decorator) for decorator in function.decorator_list)


def has_any(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether an annotation of a public function says `Any`."""
    arguments = function.args
    annotations = [a.annotation for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
    texts = [ast.unparse(a) for a in (*annotations, function.returns) if a is not None]
    return not function.name.startswith("_") and any(re.search(r"\bAny\b", text) for text in texts)


def is_long_import(node: ast.AST) -> bool:
    """Whether a statement imports more names from one module than the module's own name would replace."""
    return (
        isinstance(node, ast.ImportFrom) and len(node.names) > MAX_NAMES_OF_MODULE and node.module not in VOCABULARIES
    )


def find_modules() -> Iterator[Path]:
    """The Python files of every package that `stridetwin/` links to."""
    for link in sorted((ROOT / "stridetwin").iterdir()):
        if link.is_symlink():
            yield from sorted((ROOT / link.name).rglob("*.py"))


def measure() -> list[Measure]:
    """The measures over all modules."""
    functions = lines = 0
    participles, pronouns, skips, untyped, imports = [], [], [], [], []
    for file in find_modules():
        text, name = file.read_text(encoding="utf-8"), file.relative_to(ROOT)
        lines += text.count("\n")
        skips += [f"{name}:{i}" for i, line in enumerate(text.splitlines(), 1) if "# fmt: skip" in line]
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                functions += 1
                place = f"{name}:{node.lineno} {node.name}"
                participles += [place] if is_participle(node.name) and not is_property(node) else []
                untyped += [place] if has_any(node) else []
            elif is_long_import(node) and file.name != "__init__.py":  # a package's names for others
                imports.append(f"{name}:{node.lineno}")
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id.strip("_") in PRONOUNS:
                pronouns.append(f"{name}:{node.lineno} {node.id}")
    return [
        Measure("functions named by a participle, %", participles, 100.0 * len(participles) / functions, 1.0),
        Measure("assignments to found, own, words, made", pronouns, len(pronouns), 0.0),
        Measure("`# fmt: skip` per 1,000 lines", skips, 1000.0 * len(skips) / lines, 0.5),
        Measure("public functions with `Any` in the signature", untyped, len(untyped), 0.0),
        Measure("imports of more than ten names of a module", imports, len(imports), 0.0),
    ]


def main() -> int:
    """Prints the measures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true", help="print every place, too")
    asked = parser.parse_args()
    measures = measure()
    for one in measures:
        print(f"{one.name:<46} {one.value:8.1f}   at most {one.limit:g}")
        if asked.list:
            print("\n".join(f"    {place}" for place in one.places))
    return int(any(one.value > one.limit for one in measures))


if __name__ == "__main__":
    sys.exit(main())
