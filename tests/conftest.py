"""Recordings that many tests share, and how the tests are spread over processes."""

from __future__ import annotations

import pytest
from xdist.scheduler import LoadFileScheduling

_TOGETHER = (
    "tests/estimators/dvio/",
    "tests/estimators/test_foot",
    "tests/estimators/terrain_map/",
    "tests/estimators/test_contact_terrain",
)

_FIRST = (
    *_TOGETHER[:3],
    "tests/sim/test_dynamics.py",
    *_TOGETHER[3:],
    "tests/studies/test_walks.py",
    "tests/studies/test_jao_simulation.py",
    "tests/scenarios/campaign/test_campaign_generate.py",
    "tests/sim/test_exoskeleton.py",
    "tests/testing/test_our_estimators.py",
    "tests/outputs/test_odometry.py",
    "tests/run/test_live_bridge.py",
    "tests/outputs/test_mode_files.py",
    "tests/estimators/locomotion_mode/",
    "tests/studies/closed_loop/test_helping.py",
    "tests/cli/test_cli.py",
    "tests/sim/test_twin.py",
    "tests/estimators/test_board_twin.py",
    "tests/docs/",
    "tests/scenarios/test_page_commands.py",
    "tests/cli/test_bare_install.py",
    "tests/sim/test_calibration.py",
    "tests/sim/test_manners.py",
    "tests/scenarios/test_fault_fields.py",
    "tests/studies/",
)
"""What takes long, so that no process is left with it while the others have nothing to do.

Each process compiles what no other has written to the cache by then. So the two longest compilations, of different
kernels, come first, and what only uses them comes when they are over.
"""


def _rank(nodeid: str) -> int:
    return next((i for i, part in enumerate(_FIRST) if nodeid.startswith(part)), len(_FIRST))


class _Scheduling(LoadFileScheduling):
    """One process a file, and one for all files that have to compile the same first."""

    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        return next((part for part in _TOGETHER if file.startswith(part)), file)


def pytest_collection_modifyitems(items):
    """The longest first."""
    items.sort(key=lambda item: _rank(item.nodeid))


def pytest_xdist_make_scheduler(config, log):
    """Takes the place of `--dist loadfile`, in the order of collection instead of by the number of tests."""
    if config.getvalue("dist") != "loadfile":
        return None
    config.option.loadscopereorder = False
    return _Scheduling(config, log)


def _fake(patch):
    """The fake twin in the place of the real one."""
    from fake_twin import FakeTwin

    from stridetwin.report import runner
    from stridetwin.scenarios import record

    for module in (record, runner):
        patch.setattr(module, "make_twin", lambda scenario, seed: FakeTwin(scenario.config, seed))


@pytest.fixture
def simulator(monkeypatch):
    """The fake twin in the place of the real one."""
    _fake(monkeypatch)


@pytest.fixture(scope="session")
def walk(tmp_path_factory):
    """Folder of one `stridetwin run`, with cameras and film."""
    from stridetwin.cli.main import main

    folder = tmp_path_factory.mktemp("walk")
    with pytest.MonkeyPatch.context() as patch:
        _fake(patch)
        assert main(["run", "level_20m", "--seed", "3", "-o", str(folder)]) == 0
    return folder


@pytest.fixture(scope="session")
def seen(tmp_path_factory):
    """Recording of a few simulated steps with every sensor that an estimator of hardware takes but shoe cameras."""
    from stridetwin.scenarios.record import record
    from stridetwin.sim.config import Gait, Level, Route, TwinConfig
    from stridetwin.sim.parts.sensor_config import SensorConfig
    from stridetwin.sim.twin import Twin

    path = tmp_path_factory.mktemp("seen") / "walk.mcap"
    sensors = ("foot_imu", "insole", "head_imu", "head_camera", "ahrs", "encoder")
    route = Route(segments=(Level(length_m=0.5),))
    slower = {"head_camera": SensorConfig(rate_hz=15.0)}
    config = TwinConfig(name="seen", route=route, sensors=sensors, gait=Gait(stand_s=0.5), fittings=slower)
    record(Twin(config, 5), path, lambda *_: None)
    return path
