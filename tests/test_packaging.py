"""The packages named in pyproject.toml against the folders: one forgotten works here and is missing from a wheel."""

import ast
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_every_folder_of_modules_is_packaged():
    setuptools = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    tops = list(setuptools["package-dir"].values())
    folders = {file.parent for top in tops for file in (ROOT / top).rglob("*.py")}
    names = {"stridetwin." + ".".join(folder.relative_to(ROOT).parts) for folder in folders}
    assert names == set(setuptools["packages"])


def test_every_data_file_is_packaged():
    setuptools = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    for top in setuptools["package-dir"].values():
        files = {
            f for f in (ROOT / top).rglob("*") if f.is_file() and "__pycache__" not in f.parts and f.suffix != ".py"
        }
        packaged = {
            f
            for package, patterns in setuptools["package-data"].items()
            for pattern in patterns
            for f in (ROOT / package.removeprefix("stridetwin.").replace(".", "/")).glob(pattern)
        }
        assert {f for f in files if not f.name.startswith(".")} <= packaged


NAMES = {"cv2": "opencv-python-headless", "rerun": "rerun-sdk", "sklearn": "scikit-learn", "yaml": "pyyaml"}
"""Distributions that are not called as what they are imported as."""

SHIPPED = ("streams", "sim", "estimators", "scenarios")


def declared():
    """Distributions that pyproject.toml names, by the list that names them: "" for those of every installation."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lists = {"": project["dependencies"], **project["optional-dependencies"]}
    return {name: {re.match(r"[\w.-]+", d).group().lower() for d in several} for name, several in lists.items()}


def imported(*folders):
    """Distributions that modules import, other than Python's own and ours, with one of the modules."""
    found = {}
    for file in (f for folder in folders for f in (ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module]
            for top in {name.partition(".")[0] for name in names} - sys.stdlib_module_names - {"stridetwin"}:
                found[NAMES.get(top, top.replace("_", "-"))] = str(file.relative_to(ROOT))
    return found


def test_what_is_imported_is_declared():
    anywhere = set().union(*declared().values())
    assert {name: file for name, file in imported(*SHIPPED).items() if name not in anywhere} == {}


def test_what_the_hardware_modules_import_comes_with_every_installation():
    learnt = {"scikit-learn"}  # the published classifier of steps alone, which says so
    assert set(imported("streams", "estimators")) <= declared()[""] | learnt


def test_what_is_declared_is_imported():
    lists = [names for extra, names in declared().items() if extra not in ("dev", "docs")]
    assert set().union(*lists) - {"stridetwin"} <= set(imported(*SHIPPED))
