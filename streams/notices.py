"""What the user reads on stderr beside the results: warnings and notes, a line each."""

from __future__ import annotations

import sys

from stridetwin.streams.errors import to_line


def warn(text: str) -> None:
    """Prints a warning on stderr; line feeds in it, as in a file's name, become escapes."""
    _print("warning", text)


def note(text: str) -> None:
    """Prints a note on stderr; line feeds in it become escapes."""
    _print("note", text)


def _print(kind: str, text: str) -> None:
    print(to_line(f"stridetwin: {kind}: {text}"), file=sys.stderr, flush=True)
