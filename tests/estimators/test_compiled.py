"""Compiled functions are kept until something changes that is compiled into them."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from stridetwin.estimators.compiled import cached

INNER = "from numba import njit\n\n\n@njit\ndef doubled(x):\n    return 2 * x\n"
OUTER = "from inner import doubled\n\n\ndef outer(x):\n    return doubled(x) + 1\n"


def loaded(folder: Path, name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def hits_and_value(folder: Path, monkeypatch) -> tuple[int, int]:
    monkeypatch.setitem(sys.modules, "inner", loaded(folder, "inner"))
    function = cached(folder)(loaded(folder, "outer").outer)
    value = function(3)
    return sum(function.stats.cache_hits.values()), value


def test_what_is_called_inside_counts(tmp_path, monkeypatch):
    (tmp_path / "inner.py").write_text(INNER)
    (tmp_path / "outer.py").write_text(OUTER)
    assert hits_and_value(tmp_path, monkeypatch) == (0, 7)
    assert hits_and_value(tmp_path, monkeypatch) == (1, 7)
    (tmp_path / "inner.py").write_text(INNER.replace("2 * x", "3 * x"))
    assert hits_and_value(tmp_path, monkeypatch) == (0, 10)
    assert hits_and_value(tmp_path, monkeypatch) == (1, 10)
