"""No module imports itself over others, not even for type hints: a circle cannot be read from its lowest module up."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests.import_statements import find_imports

ROOT = Path(__file__).parents[2]
PARTS = {link.name for link in (ROOT / "stridetwin").iterdir() if link.is_symlink()} - {"assets"}


def module_files():
    """File of each module, by its name."""
    files = [file for part in PARTS for file in (ROOT / part).rglob("*.py")]
    names = [".".join(("stridetwin", *file.relative_to(ROOT).with_suffix("").parts)) for file in files]
    return {name.removesuffix(".__init__"): file for name, file in zip(names, files)}


def list_imported_names(source):
    """Names that the statements outside of functions import, including those under TYPE_CHECKING."""
    for statement in find_imports(source, in_functions=False):
        if isinstance(statement, ast.Import):
            yield from (alias.name for alias in statement.names)
        elif statement.module:
            yield statement.module
            yield from (f"{statement.module}.{alias.name}" for alias in statement.names)


def import_graph(sources):
    """Module to the modules that it imports; a package counts where its own names are imported."""
    graph = {}
    for name, source in sources.items():
        imported = set(list_imported_names(source))
        packages = {n.rpartition(".")[0] for n in imported if n in sources}
        graph[name] = {n for n in imported if n in sources and n != name} - (packages - {name})
    return graph


def test_no_module_imports_itself_over_others():
    sources = {name: file.read_text(encoding="utf-8") for name, file in module_files().items()}
    assert len(sources) > 300
    TopologicalSorter(import_graph(sources)).prepare()


@pytest.mark.parametrize("second", ["import p.a", "from p import a", "if TYPE_CHECKING:\n    from p.a import A"])
def test_a_circle_is_found_and_imports_in_functions_are_none(second):
    with pytest.raises(CycleError):
        TopologicalSorter(import_graph({"p": "", "p.a": "from p.b import B", "p.b": second})).prepare()
    inside = "def use():\n    from p.a import A"
    TopologicalSorter(import_graph({"p": "", "p.a": "from p.b import B", "p.b": inside})).prepare()
