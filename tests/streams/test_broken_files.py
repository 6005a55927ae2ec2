"""Broken files of every format are refused in one line, read in part, or read as they are: never a traceback."""

import foreign_tables
import logger_files
import pytest
import scan_files

from benchmarks.broken_files import trials
from benchmarks.foreign_files import FORMATS


@pytest.mark.parametrize("name", list(FORMATS))
def test_broken_files_are_no_surprise(name):
    found = trials(name, 12, seed=1)
    faults = [t for t in found if t.outcome in ("traceback", "hang")]
    assert not faults
    assert any(t.outcome == "refused" for t in found)


WRITERS = (
    logger_files.ngimu,
    logger_files.xsens,
    logger_files.metamotion,
    logger_files.movesense,
    logger_files.phyphox,
    logger_files.sensor_logger,
    logger_files.gaitmap,
    logger_files.opensense,
    foreign_tables.shimmer,
    foreign_tables.xsens_dot,
    foreign_tables.android,
    foreign_tables.one_value_per_row,
    foreign_tables.realsense,
    scan_files.stray_scanner,
    scan_files.record3d,
)


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_broken_tables_and_scans_are_no_surprise(write):
    def written(folder, _):
        (source := folder / "source").mkdir()
        return write(source)

    found = trials(write.__name__, 12, seed=1, write=written)
    assert not [t for t in found if t.outcome in ("traceback", "hang")]
    assert any(t.outcome == "refused" for t in found)


@pytest.mark.parametrize("name", ["mcap", "mcap_foreign"])
def test_no_flipped_byte_of_an_mcap_goes_unnoticed(name):
    found = trials(name, 40, seed=2)
    assert [t for t in found if t.outcome in ("unnoticed", "traceback", "hang")] == []
