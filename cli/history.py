"""`history`: draws scores over versions."""

from __future__ import annotations

from stridetwin.cli.commands import HistoryOptions
from stridetwin.cli.options import Outcome, Progress
from stridetwin.gate.history_file import read_history
from stridetwin.streams.errors import explain_import_error
from stridetwin.streams.files import atomic_file


def history_command(arguments: HistoryOptions, progress: Progress) -> Outcome:
    """Runs `history`: draws the means of all versions in a history file as a page.

    `progress`, which every command gets, is not used, as this takes a moment only.
    """
    with explain_import_error("pages need it", "report"):
        from stridetwin.report.history import history_page
    lines = read_history(arguments.history)
    with atomic_file(arguments.output) as file:
        file.write_text(history_page(lines, arguments.title), encoding="utf-8")
    data = {"file": str(arguments.output), "versions": len(lines), "last": lines[-1]["verdict"]}
    return Outcome(data=data, lines=[f"{arguments.output}: {len(lines)} versions, the last: {lines[-1]['verdict']}"])
