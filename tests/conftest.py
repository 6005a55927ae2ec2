"""How the tests are spread over processes."""

from __future__ import annotations

from xdist.scheduler import LoadFileScheduling

_TOGETHER = ("tests/estimators/dvio/", "tests/estimators/test_foot", "tests/estimators/terrain_map/")


class _Scheduling(LoadFileScheduling):
    """One process a file, and one for all files that have to compile the same first."""

    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        return next((part for part in _TOGETHER if file.startswith(part)), file)


def pytest_xdist_make_scheduler(config, log):
    """Takes the place of `--dist loadfile`."""
    return _Scheduling(config, log) if config.getvalue("dist") == "loadfile" else None
