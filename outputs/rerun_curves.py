"""Curves over time in a Rerun file, thinned to what a screen shows."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array

if TYPE_CHECKING:
    from rerun import RecordingStream

CURVES_HZ = 50.0
"""Rate of the values of a curve in the viewer."""


def log_curves(
    rerun: ModuleType,
    stream: RecordingStream,
    entity: str,
    t_ns: NDArray[np.int64],
    values: Array,
    labels: tuple[str, ...],
    colors: Sequence[tuple[int, int, int]] | None = None,
) -> None:
    """Logs (N, K) values at (N,) stamps as K curves, thinned to about `CURVES_HZ`.

    Args:
        rerun: The module `rerun`.
        stream: Its stream.
        entity: Path of the curves in the viewer.
        t_ns: (N,) times, ns.
        values: (N, K) values.
        labels: Name of each curve; "" stands for the last part of the entity.
        colors: RGB of each curve; None leaves them to the viewer.
    """
    seconds, thinned = thin_out(t_ns, CURVES_HZ, values)
    names = [label or entity.rsplit("/", 1)[1] for label in labels]
    stream.log(entity, rerun.SeriesLines(names=names, colors=colors), static=True)
    columns = rerun.Scalars.columns(scalars=thinned)
    stream.send_columns(entity, indexes=[rerun.TimeColumn("time", duration=seconds)], columns=columns)


def thin_out(t_ns: NDArray[np.int64], rate_hz: float, *columns: Array) -> tuple[Array, ...]:
    """Thins columns to about `rate_hz` for display: every n-th row; slower columns stay as they are.

    Args:
        t_ns: (N,) times, ns.
        rate_hz: Rate to keep.
        columns: Arrays of N rows.

    Returns:
        Times in s, and the columns.
    """
    seconds = t_ns * 1e-9
    span_s = float(seconds[-1] - seconds[0]) if len(seconds) > 1 else 1.0  # a single row is kept, whatever its span
    # number of rows per row that is kept
    step = max(1, round(len(seconds) / (span_s * rate_hz)))
    return seconds[::step], *(np.asarray(column[::step], dtype=float) for column in columns)
