"""Gait phases as a table."""

from __future__ import annotations

from itertools import starmap

from stridetwin.estimators.gait_phase import PhaseEstimate
from stridetwin.outputs.csv_tables import LiveTable, csv_row
from stridetwin.outputs.gait_phase.scores import PhaseSeries

COLUMNS = ("t_s", "phase", "phase_sd", "rate_hz", "walking", "swing")
"""Time, phase of the cycle (0-1) and its standard deviation, cycles per second, and 0 or 1 for the two states."""


def phase_rows(series: PhaseSeries) -> list[list[str]]:
    """The cells of `COLUMNS` for each of the N samples."""
    columns = (series.t_ns, series.phase, series.phase_sd, series.rate, series.walking, series.swing)
    samples = zip(*(column.tolist() for column in columns))  # the arguments of `_cells` for each sample
    return list(starmap(_cells, samples))


def _cells(t_ns: int, phase: float, phase_sd: float, rate: float, walking: bool, swing: bool) -> list[str]:
    """Cells of a row of the table, in the order of `COLUMNS`."""
    return [f"{t_ns * 1e-9:.4f}", f"{phase:.4f}", f"{phase_sd:.4f}", f"{rate:.4f}", str(int(walking)), str(int(swing))]


class LivePhases(LiveTable):
    """Gait phases in `live`: one row per sample, and a table of all rows at the end."""

    def add(self, estimate: object) -> str | None:
        """The row of an estimate as text, which is also kept for the table; None for anything but a `PhaseEstimate`."""
        if not isinstance(estimate, PhaseEstimate):
            return None
        e = estimate
        row = _cells(e.t_ns, e.phase, e.phase_sd, e.rate, e.walking, e.swing)
        self.keep(len(self._kept), row)
        return csv_row(row)
