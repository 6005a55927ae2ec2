"""The recording that a command reads."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from stridetwin.scenarios.commands.options import ImportableOptions
from stridetwin.streams.errors import StrideTwinError

if TYPE_CHECKING:
    from stridetwin.streams.opening import ImportOptions
    from stridetwin.streams.recording import Recording


def opened(path: Path, lenient: bool, options: ImportOptions | None = None, *, tell: bool = True) -> Recording:
    """A recording, or anything that can be imported; what had to be assumed is told on stderr."""
    from stridetwin.streams.opening import open_any

    recording = open_any(path, lenient, options)
    for words in (*recording.warnings, *map(str, recording.problems)) if tell else ():
        print(f"stridetwin: warning: {path}: {words}", file=sys.stderr)
    return recording


def imported(arguments: ImportableOptions, *, tell: bool = True) -> Recording:
    """`opened`, as the arguments of a command tell how."""
    from stridetwin.streams.opening import ImportOptions

    options = ImportOptions(
        kind=arguments.kind,
        names=dict(_mapped(text) for text in arguments.map),
        rig=arguments.rig,
        depth_scale=arguments.depth_scale,
    )
    return opened(arguments.source, arguments.lenient, options, tell=tell)


def _mapped(text: str) -> tuple[str, str]:
    old, equals, new = text.partition("=")
    if not (old and equals and new):
        raise StrideTwinError(f"--map: {text!r} is not valid; valid: FROM=TO")
    return old, new
