"""Packages, data and dependencies of pyproject.toml against the folders: a missing one works here, not in a wheel."""

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

from setuptools import find_packages

from tests.import_statements import imports_of_folder

ROOT = Path(__file__).parents[1]


TOPS = sorted(link.name for link in (ROOT / "stridetwin").iterdir() if link.is_symlink())


def test_every_folder_of_modules_is_packaged():
    found = find_packages(str(ROOT), include=["stridetwin", "stridetwin.*"])
    folders = {file.parent for top in TOPS for file in (ROOT / top).rglob("*.py")}
    assert set(found) == {"stridetwin"} | {"stridetwin." + ".".join(f.relative_to(ROOT).parts) for f in folders}


def test_every_package_is_linked():
    not_packages = {"benchmarks", "docs", "examples", "stridetwin", "tests", "tools"}
    folders = {file.parent.name for file in ROOT.glob("*/__init__.py")}
    assert folders - not_packages == set(TOPS)
    assert all((ROOT / "stridetwin" / top).readlink() == Path("..") / top for top in TOPS)


def test_a_copy_without_links_is_refused_in_one_line(tmp_path):
    copy = tmp_path / "stridetwin"
    copy.mkdir()
    (copy / "links.py").write_bytes((ROOT / "stridetwin" / "links.py").read_bytes())
    (copy / "__init__.py").write_bytes((ROOT / "stridetwin" / "__init__.py").read_bytes())
    (copy / "streams").write_text("../streams")
    (tmp_path / "setup.py").write_bytes((ROOT / "setup.py").read_bytes())
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "x"\nversion = "1"\n')
    for words in (["setup.py", "bdist_wheel"], ["-c", "import stridetwin"]):
        done = subprocess.run([sys.executable, *words], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 1
        assert "streams: invalid link: expected a link to the folder ../streams" in done.stderr.splitlines()[-1]
    assert {path.name for path in tmp_path.iterdir()} <= {"stridetwin", "setup.py", "pyproject.toml"}


def test_every_data_file_is_packaged():
    setuptools = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    for top in TOPS:
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


NAMES = {
    "cv2": "opencv-python-headless",
    "rerun": "rerun-sdk",
    "sklearn": "scikit-learn",
    "yaml": "pyyaml",
    "zenoh": "eclipse-zenoh",
}
"""Distributions that are not called as what they are imported as."""


def declared():
    """Distributions that pyproject.toml names, by the list that names them: "" for those of every installation."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lists = {"": project["dependencies"], **project["optional-dependencies"]}
    return {name: {re.match(r"[\w.-]+", d).group().lower() for d in several} for name, several in lists.items()}


def imported(*folders):
    """Distributions that modules import, other than Python's own and ours, with one of the modules."""
    found = {}
    for folder in folders:
        for file, node in imports_of_folder(ROOT / folder):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module]
            for top in {name.partition(".")[0] for name in names} - sys.stdlib_module_names - {"stridetwin"}:
                found[NAMES.get(top, top.replace("_", "-"))] = str(file.relative_to(ROOT))
    return found


def test_what_is_imported_is_declared():
    anywhere = set().union(*declared().values())
    assert {name: file for name, file in imported(*TOPS).items() if name not in anywhere} == {}


def test_what_the_hardware_modules_import_comes_with_every_installation():
    # The published classifier, a stream as a table, live transport, the published map, scans of phones and glasses:
    # each says what it needs.
    optional = {"scikit-learn", "pandas", "eclipse-zenoh", "open3d", "lzfse", "projectaria-tools"}
    assert set(imported("streams", "estimators")) <= declared()[""] | optional


def test_what_is_declared_is_imported():
    lists = [names for extra, names in declared().items() if extra not in ("dev", "docs")]  # open3d-cpu is open3d
    assert set().union(*lists) - {"stridetwin", "open3d-cpu"} <= set(imported(*TOPS, "stridetwin"))


def test_the_readme_lists_every_extra():
    rows = re.findall(r"^\| (`[^|]+`) \|", (ROOT / "README.md").read_text(encoding="utf-8"), re.M)
    listed = {name for row in rows for name in re.findall(r"`([\w-]+)`", row)}
    assert set(declared()) - {"", "dev", "docs"} <= listed
