"""Refuses to build from a copy of the repository without symbolic links; everything else is in pyproject.toml."""

import runpy
import sys
from pathlib import Path

from setuptools import setup

try:
    runpy.run_path(str(Path(__file__).parent / "stridetwin" / "links.py"))
except ImportError as error:
    sys.exit(str(error))
setup()
