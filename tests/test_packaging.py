"""The packages named in pyproject.toml against the folders: one forgotten works here and is missing from a wheel."""

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
