"""The one-foot filter on the twin: what the benchmark promises, for one seed outside of it."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.outputs.path.scores import compare, score
from stridetwin.outputs.truth import TruePath
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.samples import Block

bench = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "foot_ins_twin.py"), run_name="bench")


@pytest.mark.parametrize("scenario", bench["SCENARIOS"])
def test_end_error_and_certainty(scenario: str) -> None:
    """Means over both feet of three people; one foot may err as recorded people's feet do."""
    feet = [scores for seed in (7, 8, 9) for scores in bench["scores_of_walk"](scenario, seed).values()]
    mean = {name: np.mean([scores[name] for scores in feet]) for name in feet[0]}
    assert mean["end_error_pct"] < 1.0
    assert mean["armse_2d_m"] < 0.05
    assert mean["nees_position_mean"] < 3.0  # 3 if consistent; larger = too sure of itself
    assert mean["nees_position_within_95_pct"] > 95.0
    assert max(scores["armse_2d_m"] for scores in feet) < 0.10


@pytest.mark.parametrize("name", ["NGIMU-uncalibrated", "MTw-uncalibrated"])
@pytest.mark.parametrize("scenario", ["level_20m", "stair_up_down"])
def test_an_uncalibrated_part_keeps_its_height_and_knows_its_error(scenario: str, name: str) -> None:
    config = replace(load_scenario(scenario).config, sensors=("foot_imu",))
    twin = Twin(replace(config, fittings={"foot_imu": SensorConfig(part=load_part(name))}), 7)
    chunks = [{b.topic: b for b in chunk if isinstance(b, Block)} for chunk in twin.blocks()]
    for foot in "lr":
        imu, truth = (
            bench["join_blocks"]([c[t] for c in chunks])
            for t in (f"/foot_{foot}/imu", f"/truth/foot_{foot}/imu/odometry")
        )
        path = FootIns(twin.rig, options=Options(foot=foot)).run(imu)
        ready_ns = int(path.trajectory.t_ns[path.aligned.argmax()])
        scores = score(compare(path.trajectory, TruePath.of(truth).since(ready_ns)))
        way_m = 100.0 * scores["end_error_m"] / scores["end_error_pct"]
        assert abs(scores["end_height_error_m"]) <= max(0.005 * way_m, 0.05)
        assert scores["end_error_pct"] < 3.0
        assert scores["nees_position_mean"] < 4.0
        assert scores["nees_position_within_95_pct"] > 90.0
        assert np.all(np.isfinite(path.trajectory.p_frame_in_world))
