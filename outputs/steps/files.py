"""Estimated steps as a table."""

from __future__ import annotations

from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.outputs.csv_tables import LiveTable, csv_row

STEP_COLUMNS = (
    "t_s",
    "step",
    "foot",
    "mode",
    "probability",
    "slope_rad",
    "slope_sd_rad",
    "elevation_m",
    "elevation_sd_m",
    "x_m",
    "y_m",
    "z_m",
)


def step_cells(estimate: StepEstimate) -> tuple[str, ...]:
    """The cells of `STEP_COLUMNS` for a step."""
    e = estimate
    return (
        f"{e.t_ns * 1e-9:.3f}",
        str(e.step),
        e.foot,
        e.mode,
        f"{e.probability:.3f}",
        f"{e.slope:.5f}",
        f"{e.slope_sd:.5f}",
        f"{e.elevation:.5f}",
        f"{e.elevation_sd:.5f}",
        *(f"{x:.5f}" for x in e.p_sole_in_world),
    )


class LiveSteps(LiveTable):
    """Formats step estimates in `live`: a row for each, and in the end a table of the last estimate of each step."""

    def add(self, estimate: object) -> str | None:
        """The row of an estimate as text; None for step 0, at which the person stands, and for other objects.

        The table at the end keeps the last row of each step.
        """
        if not isinstance(estimate, StepEstimate) or estimate.step <= 0:
            return None
        row = step_cells(estimate)
        self.keep(estimate.step, row)
        return csv_row(row)
