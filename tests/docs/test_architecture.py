"""The diagram of the architecture page equals the import rules and the imports."""

import ast
import re
import tomllib
from pathlib import Path

from tests.import_statements import imports_of_folder

ROOT = Path(__file__).parents[2]
PARTS = {link.name for link in (ROOT / "stridetwin").iterdir() if link.is_symlink()} - {"assets"}


def drawn():
    """Part to the parts that it imports, in the order of the diagram."""
    block = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8").split("```")[1]
    lines = [line.partition("->") for line in block.strip().splitlines()]
    return {name.strip(): re.findall(r"\w+", others) for name, _, others in lines}


def imported(part):
    """The other parts that a part imports anywhere in its modules."""
    found = set()
    for _, node in imports_of_folder(ROOT / part):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
        found |= {name.split(".")[1] for name in names if name.startswith("stridetwin.")}
    return (found & PARTS) - {part}


def test_every_part_is_drawn_with_its_imports():
    assert {name: set(others) for name, others in drawn().items()} == {name: imported(name) for name in PARTS}


def test_the_rules_have_the_order_of_the_diagram():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = next(c["layers"] for c in contracts if c["name"] == "packages")
    ordered = [name.strip().removeprefix("stridetwin.") for layer in layers for name in layer.split("|")]
    assert list(drawn()) == ordered
