"""Where the tests find recordings under motion capture; without them, tests that need one are skipped."""

from pathlib import Path

import pytest

from benchmarks.real_walks import data_folder

_FOLDER = data_folder("mocap")
MOCAP = (_FOLDER or Path()) / "mocap"
"""Folder of the recordings; it does not exist where there are none."""
needs_mocap = pytest.mark.skipif(_FOLDER is None, reason="no recordings: set STRIDETWIN_DATA to their folder")
"""Mark of a test that reads from `MOCAP`."""
