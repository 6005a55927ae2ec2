"""A pytest plugin: fixtures for walks, and for the scores of an estimator on them.

```python
def test_my_filter_stays_close(stridetwin_scenario, stridetwin_score):
    walk = stridetwin_scenario("level_20m", seed=3)
    scores = stridetwin_score(walk, MyFilter(walk.rig), frame="foot_l/imu")
    assert scores["rpe_5m_pct"] < 1.0
```

Only this file is imported until a test requests a fixture.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from stridetwin.gate.own_estimators import PathEstimator
    from stridetwin.outputs.base import Scores
    from stridetwin.scenarios.scenario_file import Scenario
    from stridetwin.sim.config import TwinConfig
    from stridetwin.streams.recording.reader import Recording
    from stridetwin.streams.trajectory import Trajectory


@pytest.fixture(scope="session")
def stridetwin_scenario(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Recording]:
    """Walks: `stridetwin_scenario(scenario, seed=0, cameras=False)` gives a recording, made once per session.

    The scenario is a name of the catalogue, the path of a YAML file, the content of such a file as a mapping, or a
    `TwinConfig`. File names in a mapping are relative to the working folder. Cameras, which take most of the time to
    render, are off by default.
    """
    # by configuration, seed and whether cameras are on
    recordings: dict[tuple[str, int, bool], Recording] = {}
    folder = tmp_path_factory.mktemp("stridetwin")

    def walk(
        scenario: str | Path | Mapping[str, object] | TwinConfig, seed: int = 0, *, cameras: bool = False
    ) -> Recording:
        """The recording of a scenario with a seed, from an earlier call if there was one."""
        from stridetwin.scenarios.record import make_twin, record, without_cameras
        from stridetwin.streams.recording.reader import Recording

        walk_scenario = _load_scenario(scenario)
        walk_scenario = walk_scenario if cameras else without_cameras(walk_scenario)
        key = (repr(walk_scenario.config), seed, cameras)  # what determines the recording
        if key not in recordings:
            path = folder / f"walk_{len(recordings)}.mcap"
            record(make_twin(walk_scenario, seed), path, lambda *_: None)
            # faults may leave a recording that is refused unless it is read leniently
            recordings[key] = Recording(path, lenient=bool(walk_scenario.config.faults))
        return recordings[key]

    return walk


@pytest.fixture(scope="session")
def stridetwin_score() -> Callable[..., Scores]:
    """Scores: `stridetwin_score(recording, estimator, frame, align="start")`, by the names of `stridetwin score`.

    The estimator is an object with `update(sample)` (see `gate.own_estimators`), a `Trajectory`, or the
    path of a trajectory's file.
    """

    def score(
        recording: Recording,
        estimator: PathEstimator | Trajectory | str | Path,
        frame: str = "foot_l/imu",
        align: str = "start",
    ) -> Scores:
        """Scores of an estimator or a path on a recording.

        `align` says how the path is fitted to the truth: at the `start`, or as a whole by `yaw` or by `se3`.
        """
        from stridetwin.estimators.base import PathEstimate
        from stridetwin.outputs.path.evaluate import evaluate

        estimate = PathEstimate(name="tested", frame=frame, path=_path_of(recording, estimator, frame))
        return evaluate(recording, [estimate], align)[0].scores

    return score


def _path_of(recording: Recording, estimator: PathEstimator | Trajectory | str | Path, frame: str) -> Trajectory:
    """The path of a frame that an estimator, a `Trajectory` or the file of one gives for a recording."""
    from stridetwin.gate.own_estimators import estimate_path
    from stridetwin.outputs.path.estimate_file import read_estimate
    from stridetwin.streams.trajectory import Trajectory

    if isinstance(estimator, Trajectory):
        return estimator
    if isinstance(estimator, (str, Path)):
        return read_estimate(Path(estimator), recording, frame)
    return estimate_path(estimator, recording)


def _load_scenario(source: str | Path | Mapping[str, object] | TwinConfig) -> Scenario:
    """The scenario from a name, a file, the content of a file, or a `TwinConfig`."""
    from stridetwin.scenarios.scenario_file import Scenario, load_scenario, scenario_of
    from stridetwin.sim.config import TwinConfig

    if isinstance(source, TwinConfig):
        return Scenario(description="", config=source)
    if not isinstance(source, Mapping):
        return load_scenario(str(source))
    plain = json.loads(json.dumps({"description": "of a test", **source}))  # JSON turns tuples into lists
    # as if the content came from a file in the working folder, so that file names in it are relative to that
    return scenario_of(plain, Path.cwd() / "scenario.yaml")
