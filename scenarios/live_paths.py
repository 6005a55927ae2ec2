"""Trajectories that are written while they are made."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TextIO

from stridetwin.streams.files import partial_path
from stridetwin.streams.samples import Array
from stridetwin.streams.tum import seconds


class LivePath:
    """One trajectory as of `write_tum`, row by row; the file takes its place when it is finished.

    Args:
        file: File to make; None only makes the rows.

    Attributes:
        rows: Rows made.
    """

    def __init__(self, file: Path | None) -> None:
        self.file, self.rows = file, 0
        self._out: TextIO | None = None if file is None else partial_path(file).open("w", encoding="ascii")

    def add(self, t_ns: int, p: Array, q: Array) -> str:
        """Adds a pose: position (3,) m, quaternion (4,) w, x, y, z; returns its row."""
        w, x, y, z = q.tolist()
        row = f"{seconds(t_ns)} {' '.join(f'{v:.9g}' for v in (*p.tolist(), x, y, z, w))}"
        if self._out is not None:
            self._out.write(row + "\n")
        self.rows += 1
        return row

    def finish(self) -> None:
        """Puts the file in its place."""
        if self._out is not None and self.file is not None:
            self._out.close()
            os.replace(partial_path(self.file), self.file)

    def abandon(self) -> None:
        """Leaves the place as it was."""
        if self._out is not None and self.file is not None:
            self._out.close()
            partial_path(self.file).unlink(missing_ok=True)
