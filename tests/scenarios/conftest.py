import pytest
from fake_twin import FakeTwin

from stridetwin.scenarios import runner
from stridetwin.scenarios.cli import main


def fake(patch):
    patch.setattr(runner, "make_twin", lambda scenario, seed: FakeTwin(scenario.config, seed))


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
