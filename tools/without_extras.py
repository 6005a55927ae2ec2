"""Runs `stridetwin` as a bare installation does; without arguments it imports everything that a robot needs.

    python tools/without_extras.py [ARGUMENT ...]

Packages of the extras cannot be imported here, whether they are installed or not.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

EXTRAS = frozenset(
    {
        "mujoco",
        "glfw",
        "dm_control",
        "dm_env",
        "joblib",
        "platformdirs",
        "trimesh",
        "rerun",
        "rerun_sdk",
        "dask",
        "distributed",
        "cma",
        "sklearn",
        "pandas",
        "zenoh",
        "open3d",
        "ezc3d",
        "lzfse",
        "projectaria_tools",
        "plotly",
        "jinja2",
        "markupsafe",
    }
)
"""Import names of the extras' packages."""


class Nothing(MetaPathFinder):
    """Import finder that blocks the extras."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Blocks an extra; leaves all other imports to the other finders."""
        if name.partition(".")[0] in EXTRAS:
            raise ModuleNotFoundError(f"No module named {name!r}: a bare installation", name=name)
        return None


def main() -> int:
    """Exit code of the command."""
    there = EXTRAS & {name.partition(".")[0] for name in sys.modules}
    assert not there, there
    sys.meta_path.insert(0, Nothing())
    if sys.argv[1:]:
        from stridetwin.cli.main import main as stridetwin

        return stridetwin()
    count = 0
    for top in ("stridetwin.streams", "stridetwin.estimators"):
        for module in pkgutil.walk_packages(importlib.import_module(top).__path__, f"{top}."):
            importlib.import_module(module.name)
            count += 1
    importlib.import_module("stridetwin.cli.main")
    print(f"{count} modules, and the command line, need no extra")
    return 0


if __name__ == "__main__":
    sys.exit(main())
