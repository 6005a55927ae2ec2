"""Steps of a terrain estimator as a table, one row per step."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.streams.files import whole_file

COLUMNS = (
    "t_s", "step", "foot", "mode", "probability", "slope_rad", "slope_sd_rad", "elevation_m", "elevation_sd_m", "x_m",
    "y_m", "z_m",
)  # fmt: skip


def step_cells(estimate: StepEstimate) -> tuple[str, ...]:
    """A step as a row of `COLUMNS`."""
    e = estimate
    return (
        f"{e.t_ns * 1e-9:.3f}", str(e.step), e.foot, e.mode, f"{e.probability:.3f}", f"{e.slope:.5f}",
        f"{e.slope_sd:.5f}", f"{e.elevation:.5f}", f"{e.elevation_sd:.5f}", *(f"{x:.5f}" for x in e.p_sole_in_world),
    )  # fmt: skip


def write_steps(estimates: Iterable[StepEstimate], path: Path) -> None:
    """Writes a table with one row per step, columns `COLUMNS`; unknown values are empty."""
    with whole_file(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(map(step_cells, estimates))
