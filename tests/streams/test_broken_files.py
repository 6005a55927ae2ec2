"""Broken files of every format are refused in one line, read in part, or read as they are: never a traceback."""

import pytest

from benchmarks.broken_files import trials
from benchmarks.foreign_files import FORMATS


@pytest.mark.parametrize("name", list(FORMATS))
def test_broken_files_are_no_surprise(name):
    found = trials(name, 12, seed=1)
    faults = [t for t in found if t.outcome in ("traceback", "hang")]
    assert not faults
    assert any(t.outcome == "refused" for t in found)


@pytest.mark.parametrize("name", ["mcap", "mcap_foreign"])
def test_no_flipped_byte_of_an_mcap_goes_unnoticed(name):
    found = trials(name, 40, seed=2)
    assert [t for t in found if t.outcome in ("unnoticed", "traceback", "hang")] == []
