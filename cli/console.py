"""Progress of a command on stderr: a bar with the time left on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

_LINE_EVERY_S = 30.0
"""Time between two lines of one stage, which keeps the log of a long run short."""
_KNOWN_FROM = 0.05
"""Share of a stage from which its speed, and so the time left, is known: kernels may compile at first."""


class Console:
    """Progress on stderr, so that stdout stays for results.

    Args:
        stream: Where to write; stderr by default.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        stream = stream or sys.stderr
        self._shown: _Bar | _Lines = _Bar(stream) if stream.isatty() else _Lines(stream)

    def __call__(self, stage: str, share: float) -> None:
        """Shows the progress of a stage.

        Args:
            stage: Its name.
            share: 0-1.
        """
        self._shown.show(stage, min(max(share, 0.0), 1.0))

    def close(self) -> None:
        """Clears the bar."""
        self._shown.close()


class _Bar:
    """One line on a terminal, rewritten by Rich."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._stage = ""
        self._bar: Progress | None = None
        self._task: TaskID | None = None

    def show(self, stage: str, share: float) -> None:
        if self._bar is None:
            self._bar = _started(self._stream)
        if stage != self._stage or self._task is None:
            if self._task is not None:
                self._bar.remove_task(self._task)
            self._stage, self._task = stage, self._bar.add_task(stage, total=1.0)
        self._bar.update(self._task, completed=share)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = self._task = None


def _started(stream: TextIO) -> Progress:
    from rich.console import Console as Terminal
    from rich.progress import BarColumn, Progress, Task, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class TimeLeft(TimeRemainingColumn):
        def render(self, task: Task) -> Text:
            return super().render(task) if task.completed >= _KNOWN_FROM else Text("-:--:--")

    columns = (TextColumn("{task.description:<9}"), BarColumn(), TaskProgressColumn(), TimeLeft())
    bar = Progress(*columns, console=Terminal(file=stream), transient=True, redirect_stdout=False)
    bar.start()
    return bar


class _Lines:
    """One line per stage; long stages add a line every half minute, with the time left once it is known."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._stage = ""
        self._begun_s = self._begun_share = self._written_s = 0.0

    def show(self, stage: str, share: float) -> None:
        now_s = time.monotonic()
        if stage != self._stage:
            self._stage, self._begun_share = stage, 0.0
            self._write(f"{stage} ...", now_s)
        if not self._begun_share:  # what was prepared before the first share of the work says nothing of its speed
            self._begun_s, self._begun_share = now_s, share
        if now_s - self._written_s >= _LINE_EVERY_S and 0.0 < share < 1.0:
            done, left = share - self._begun_share, ""
            if done >= _KNOWN_FROM:
                left = f", {_clock((now_s - self._begun_s) * (1.0 - share) / done)} left"
            self._write(f"{stage} {share:.0%}{left} ...", now_s)

    def close(self) -> None:
        pass

    def _write(self, line: str, now_s: float) -> None:
        self._stream.write(f"{line}\n")
        self._stream.flush()
        self._written_s = now_s


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"
