"""The terminal: tables and results on stdout, progress on stderr; plain text where the output is not a terminal."""

from __future__ import annotations

import io
import sys
import time
from collections.abc import Iterable, Sequence
from datetime import timedelta
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID
    from rich.table import Table

_LINE_EVERY_S = 30.0
"""Time between two progress lines of one stage, which keeps the log of a long run short."""
_KNOWN_FROM = 0.05
"""Share of a stage from which its speed, and so the time left, is known: kernels may compile at first."""
_PLAIN_WIDTH = 10_000
"""Width of plain text, characters: rows of a table are neither wrapped nor cut."""


def table(
    rows: Iterable[Sequence[str]], head: Sequence[str] = (), *, title: str | None = None, text_columns: int = 1
) -> Table:
    """Builds a table of `text_columns` columns of text followed by columns of numbers, which are aligned at the right.

    Args:
        rows: Cells of each row.
        head: Heads of the columns; empty for a table without.
        title: Text above the table.
        text_columns: Number of columns of text.
    """
    from rich.table import Table
    from rich.text import Text

    text_rows = list(rows)
    column_count = len(head) or max(map(len, text_rows), default=0)
    new_table = Table(title=title, title_justify="left", box=None, pad_edge=False, show_header=bool(head))
    new_table.padding = (0, 2, 0, 0)
    for i in range(column_count):
        new_table.add_column(
            Text(head[i]) if head else "", justify="left" if i < text_columns else "right", overflow="fold"
        )
    for row in text_rows:
        new_table.add_row(*map(Text, row))
    return new_table


def plain_text(lines: Iterable[str | Table]) -> str:
    """Lines and tables as text without colours, for pipes and files."""
    from rich.console import Console as Terminal

    out: list[str] = []
    for line in lines:
        if isinstance(line, str):
            out.append(line)
            continue
        file = io.StringIO()
        Terminal(file=file, width=_PLAIN_WIDTH, color_system=None, force_terminal=False).print(line)
        out += [row.rstrip() for row in file.getvalue().splitlines()]
    return "\n".join(out)


def show(lines: Iterable[str | Table]) -> None:
    """Prints lines and tables: formatted on a terminal, as plain text elsewhere."""
    if not sys.stdout.isatty():
        print(plain_text(lines), flush=True)
        return
    from rich import box
    from rich.console import Console as Terminal

    terminal = Terminal()
    for line in lines:
        if isinstance(line, str):
            terminal.print(line, markup=False, highlight=False, soft_wrap=True)
        else:
            line.box = box.SIMPLE_HEAD if line.show_header else None
            terminal.print(line)


class Console:
    """Progress on a stream, by default stderr, so that stdout stays for results."""

    def __init__(self, stream: TextIO | None = None) -> None:
        """Shows a bar if the stream is a terminal, and lines of text elsewhere; None is stderr."""
        stream = stream or sys.stderr
        self._shown: _Bar | _Lines = _Bar(stream) if stream.isatty() else _Lines(stream)

    def __call__(self, stage: str, share: float) -> None:
        """Shows the progress of a stage, 0-1."""
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
        """Shows the progress of a stage, 0-1; another stage replaces the bar."""
        if self._bar is None:
            self._bar = _start_bar(self._stream)
        if stage != self._stage or self._task is None:
            if self._task is not None:
                self._bar.remove_task(self._task)
            self._stage, self._task = stage, self._bar.add_task(stage, total=1.0)
        self._bar.update(self._task, completed=share)

    def close(self) -> None:
        """Clears the bar."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = self._task = None


def _start_bar(stream: TextIO) -> Progress:
    """A bar of Rich on a terminal, which shows the time left only once it is known."""
    from rich.console import Console as Terminal
    from rich.progress import BarColumn, Progress, Task, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class TimeLeft(TimeRemainingColumn):
        """The time left, once enough of the stage is done to know its speed."""

        def render(self, task: Task) -> Text:
            return super().render(task) if task.completed >= _KNOWN_FROM else Text("-:--:--")

    columns = (TextColumn("{task.description:<9}"), BarColumn(), TaskProgressColumn(), TimeLeft())
    bar = Progress(*columns, console=Terminal(file=stream), transient=True, redirect_stdout=False)
    bar.start()
    return bar


class _Lines:
    """One line per stage; long stages add a line every half minute, with the time left once it is known."""

    def __init__(self, stream: TextIO) -> None:
        """Begins before the first stage, on a stream of text."""
        self._stream = stream
        self._stage = ""
        # time and share at which the work of the stage began; time of the last line; s of the monotonic clock
        self._begun_s = self._begun_share = self._written_s = 0.0

    def show(self, stage: str, share: float) -> None:
        """Writes a line for a new stage, and for a long one its progress (0-1) and the time left every half minute."""
        now_s = time.monotonic()
        if stage != self._stage:
            self._stage, self._begun_share = stage, 0.0
            self._write(f"{stage} ...", now_s)
        if not self._begun_share:  # what was prepared before the first share of the work says nothing of its speed
            self._begun_s, self._begun_share = now_s, share
        if now_s - self._written_s >= _LINE_EVERY_S and 0.0 < share < 1.0:
            # share done since the work began, and the text of the time left
            done, left = share - self._begun_share, ""
            if done >= _KNOWN_FROM:
                left_s = (now_s - self._begun_s) * (1.0 - share) / done
                left = f", {timedelta(seconds=round(left_s))} left"
            self._write(f"{stage} {share:.0%}{left} ...", now_s)

    def close(self) -> None:
        """Does nothing, as lines stay."""
        pass

    def _write(self, line: str, now_s: float) -> None:
        """Writes a line at once, and remembers when."""
        self._stream.write(f"{line}\n")
        self._stream.flush()
        self._written_s = now_s
