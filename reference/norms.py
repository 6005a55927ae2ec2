"""Reference values from the literature, read from the folder `reference`."""

from __future__ import annotations

import csv
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
import yaml

from stridetwin.streams.samples import Array

_LEG_M = 0.9
_GROUPS = (("VerySlow", 0.67), ("Slow", 1.08), ("Free", 1.49), ("Fast", 1.89), ("VeryFast", float("inf")))


def read_reference(name: str) -> Any:
    """The content of one YAML file of the reference folder, such as `jao2020`."""
    file = resources.files("stridetwin.reference").joinpath(f"{name}.yaml")
    return yaml.safe_load(file.read_text(encoding="utf-8"))


def read_reference_rows(name: str) -> list[dict[str, str]]:
    """Rows of one CSV table of the reference folder, such as `zhao2023_table2`, as column to text.

    Lines that begin with # are skipped.
    """
    file = resources.files("stridetwin.reference").joinpath(f"{name}.csv")
    lines = (line for line in file.read_text(encoding="utf-8").splitlines() if not line.startswith("#"))
    return list(csv.DictReader(lines))


def speed_group(speed_mps: float, leg_m: float = _LEG_M) -> str:
    """The speed group of Schwartz et al. 2008 that a walker belongs to.

    Args:
        speed_mps: Walking speed.
        leg_m: Length of the leg; speeds of equal speed / sqrt(g leg) are in one group.

    Returns:
        VerySlow, Slow, Free, Fast or VeryFast.
    """
    scaled_speed_mps = speed_mps * float(np.sqrt(_LEG_M / leg_m))
    return next(name for name, below in _GROUPS if scaled_speed_mps < below)


@cache
def level_norm(group: str, quantity: str) -> tuple[Array, Array, Array]:
    """A level-walking curve of Schwartz, Rozumalski & Trost 2008, J. Biomech. 41(8):1639-1650.

    Args:
        group: VerySlow, Slow, Free, Fast or VeryFast.
        quantity: Such as `knee_flexion_deg`.

    Returns:
        Share of the gait cycle in % from heel contact, mean and SD, (51,) each.
    """
    rows = [r for r in read_reference_rows("gait_norms_level") if r["speed"] == group and r["quantity"] == quantity]
    table = np.array([[float(r["cycle_pct"]), float(r["mean"]), float(r["sd"])] for r in rows])
    return table[:, 0], table[:, 1], table[:, 2]
