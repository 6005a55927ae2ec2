"""Progress: plain lines in a log, a bar on a terminal."""

import io
import re
import time

import pytest

from stridetwin.cli import console


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def clock(monkeypatch):
    """The time that the console reads, in seconds; a test sets it."""
    now = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    return now


def test_a_log_has_a_line_per_stage_and_the_time_left_of_a_long_one(clock):
    log = io.StringIO()
    progress = console.Console(log)
    for second in range(91):
        clock[0] = float(second)
        progress("walk", second / 120)
    progress("estimate", 0.0)
    progress.close()
    assert log.getvalue().splitlines() == [
        "walk ...",
        "walk 25%, 0:01:30 left ...",
        "walk 50%, 0:01:00 left ...",
        "walk 75%, 0:00:30 left ...",
        "estimate ...",
    ]


def test_no_time_left_is_shown_before_some_work_is_done(clock, monkeypatch):
    log = io.StringIO()
    progress = console.Console(log)
    for second, share in ((0, 0.0), (90, 0.0), (91, 0.01), (121, 0.03), (151, 0.51)):  # kernels compile for 90 s
        clock[0] = float(second)
        progress("walk", share)
    assert log.getvalue().splitlines() == ["walk ...", "walk 1% ...", "walk 3% ...", "walk 51%, 0:00:59 left ..."]


@pytest.mark.parametrize(("share", "is_known"), [(0.01, False), (0.5, True)])
def test_a_bar_has_no_time_left_before_some_work_is_done(monkeypatch, share, is_known):
    monkeypatch.setenv("TERM", "xterm")
    screen = Terminal()
    progress = console.Console(screen)
    progress("walk", 0.0)
    time.sleep(0.2)
    progress("walk", share / 2)
    time.sleep(0.2)
    progress("walk", share)
    progress.close()
    assert bool(re.search(r"[0-9]:[0-9]{2}:[0-9]{2}", screen.getvalue())) == is_known


def test_a_terminal_has_one_bar_that_goes_away(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    screen = Terminal()
    progress = console.Console(screen)
    for share in (0.0, 0.25, 1.0):
        progress("walk", share)
    progress("estimate", 0.5)
    progress.close()
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", screen.getvalue())
    assert "estimate" in shown
    assert "50%" in shown
    assert screen.getvalue().endswith("\x1b[2K")
    assert screen.getvalue().count("\x1b[?25l") == screen.getvalue().count("\x1b[?25h") == 1


def test_a_bar_that_was_never_shown_leaves_the_terminal_alone():
    screen = Terminal()
    console.Console(screen).close()
    assert screen.getvalue() == ""


def rows():
    return [console.table([["foot_ins_l", "0.123"], ["[b]:cat:", "-"]], ["estimator", "end m"], title="Scores"), "done"]


def test_tables_are_aligned_plain_text_in_a_pipe(capsys):
    console.show(rows())
    assert capsys.readouterr().out.splitlines() == [
        "Scores",
        "estimator   end m",
        "foot_ins_l  0.123",
        "[b]:cat:        -",
        "done",
    ]


def test_a_terminal_has_tables_in_colour(monkeypatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    screen = Terminal()
    monkeypatch.setattr(console.sys, "stdout", screen)
    console.show(rows())
    assert "\x1b[" in screen.getvalue()
    assert "[b]:cat:" in screen.getvalue()


def test_colours_are_never_in_a_file(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    console.show(rows())
    assert "\x1b" not in capsys.readouterr().out
