import pytest
from fake_twin import FakeTwin

from stridetwin.cli.main import main
from stridetwin.report import runner
from stridetwin.scenarios import record as recorder
from stridetwin.scenarios.record import record
from stridetwin.sim.config import Gait, Level, Route, TwinConfig
from stridetwin.sim.twin import Twin


def fake(patch):
    for module in (recorder, runner):
        patch.setattr(module, "make_twin", lambda scenario, seed: FakeTwin(scenario.config, seed))


@pytest.fixture
def simulator(monkeypatch):
    """The fake twin in the place of the real one."""
    fake(monkeypatch)


@pytest.fixture(scope="session")
def walk(tmp_path_factory):
    """Folder of one `stridetwin run`, with cameras and film."""
    folder = tmp_path_factory.mktemp("walk")
    with pytest.MonkeyPatch.context() as patch:
        fake(patch)
        assert main(["run", "level_20m", "--seed", "3", "-o", str(folder)]) == 0
    return folder


@pytest.fixture(scope="session")
def seen(tmp_path_factory):
    """Recording of a few simulated steps with every sensor that an estimator of hardware takes but shoe cameras."""
    path = tmp_path_factory.mktemp("seen") / "walk.mcap"
    sensors = ("foot_imu", "insole", "head_imu", "head_camera", "ahrs", "encoder")
    route = Route(segments=(Level(length_m=0.5),))
    record(
        Twin(TwinConfig(name="seen", route=route, sensors=sensors, gait=Gait(stand_s=0.5)), 5), path, lambda *_: None
    )
    return path
