"""Opens the recording that a command or a gate reads."""

from __future__ import annotations

import sys
from pathlib import Path

from stridetwin.streams.formats.opening import ImportOptions, open_any
from stridetwin.streams.recording.reader import Recording


def opened(path: Path, lenient: bool, options: ImportOptions | None = None, *, tell: bool = True) -> Recording:
    """A recording, or any source that can be imported; assumptions are reported on stderr."""
    recording = open_any(path, lenient, options)
    for words in (*recording.warnings, *map(str, recording.problems)) if tell else ():
        print(f"stridetwin: warning: {path}: {words}", file=sys.stderr)
    return recording
