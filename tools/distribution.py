"""Builds what users install: the source distribution, and the wheel that pip makes of it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_FILES = ("pyproject.toml", "setup.py", "README.md", "LICENSE", "stridetwin")


def build(folder: Path) -> tuple[Path, Path]:
    """Builds the source distribution and, from it, the wheel, with the build packages of this environment.

    Args:
        folder: Receives both files; a new folder.

    Returns:
        The source distribution and the wheel.
    """
    source = folder / "source"
    source.mkdir(parents=True)
    for name in _FILES:
        if (ROOT / name).is_dir():  # links become folders
            shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, source / name)
    backend = "import sys, setuptools.build_meta as backend; backend.build_sdist(sys.argv[1])"
    subprocess.run([sys.executable, "-c", backend, folder], cwd=source, stdout=subprocess.DEVNULL, check=True)
    (sdist,) = folder.glob("*.tar.gz")
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--wheel-dir", folder, sdist], check=True)
    (wheel,) = folder.glob("*.whl")
    return sdist, wheel
