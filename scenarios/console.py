"""What the command line says while it works: a bar on a terminal, a line a stage elsewhere."""

from __future__ import annotations

import sys
from typing import TextIO

_BAR = 28


class Console:
    """Progress on stderr, so that stdout stays for results.

    Args:
        stream: Where to write; stderr by default.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._live = self._stream.isatty()
        self._stage, self._shown = "", -1

    def __call__(self, stage: str, share: float) -> None:
        """Says how far a stage is.

        Args:
            stage: Its name.
            share: 0-1.
        """
        percent = int(100 * min(max(share, 0.0), 1.0))
        if stage == self._stage and (not self._live or percent == self._shown):
            return
        if self._live:
            full = percent * _BAR // 100
            self._stream.write(f"\r\x1b[K{stage:<9} [{'#' * full}{'.' * (_BAR - full)}] {percent:3d} %")
        else:
            self._stream.write(f"{stage} ...\n")
        self._stage, self._shown = stage, percent
        self._stream.flush()

    def close(self) -> None:
        """Clears the bar."""
        if self._live and self._stage:
            self._stream.write("\r\x1b[K")
            self._stream.flush()
