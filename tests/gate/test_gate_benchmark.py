"""What the benchmark injects: into sensors alone, the same each time, and something each time."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import gate
from benchmarks.gate import FOOT, REGRESSIONS, Spoilt, injected
from stridetwin.estimators import foot_ins
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.streams.samples import Block, Imu

COLUMNS = ("angular_rate", "specific_force")
RNG = np.random.default_rng(2)
BLOCK = Block(
    topic="/foot_l/imu",
    kind=Imu,
    t_ns=np.arange(400) * 8_000_000,
    columns={"angular_rate": RNG.normal(0.0, 3.0, (400, 3)), "specific_force": RNG.normal(0.0, 40.0, (400, 3))},
)
RECORDING = SimpleNamespace(block=lambda topic: BLOCK)


@pytest.mark.parametrize("how", [r for r in REGRESSIONS if r.imu], ids=lambda r: r.name)
def test_faults_of_the_imu_are_reproducible_and_leave_the_truth_alone(how):
    corrupted = Spoilt(RECORDING, how)
    before = {name: BLOCK.columns[name].copy() for name in COLUMNS}
    once, twice = (corrupted.block("/foot_l/imu").columns for _ in range(2))
    assert all(np.array_equal(once[name], twice[name]) for name in COLUMNS)
    assert any(not np.array_equal(once[name], before[name]) for name in COLUMNS)
    assert all(np.array_equal(BLOCK.columns[name], before[name]) for name in COLUMNS)
    assert corrupted.block("/truth/foot_l/imu/odometry") is BLOCK


@pytest.mark.parametrize("how", [r for r in REGRESSIONS if r.parameters], ids=lambda r: r.name)
def test_the_filter_has_other_parameters_where_that_is_asked_for(how):
    plain = FootIns()._parameters
    corrupted = injected(how)()._parameters
    for name, factor in how.parameters.items():
        assert getattr(corrupted, name) == factor * getattr(plain, name)
    assert FootIns()._parameters == plain


def test_there_are_enough_of_them():
    assert len(REGRESSIONS) >= 20
    assert {r.name for r in REGRESSIONS if r.source and r.estimator == FOOT}
    assert len({r.name for r in REGRESSIONS}) == len(REGRESSIONS)


def test_its_walks_are_those_of_a_campaign_with_the_seed_that_is_asked_for(monkeypatch, tmp_path):
    accepted = [{"recording": "walks/a.mcap", "status": "accepted"}, {"recording": "b", "status": "rejected"}]
    asked = []

    def generate(campaign, options, progress):
        asked.append(options)
        return SimpleNamespace(manifest={"walks": accepted})

    monkeypatch.setattr(gate, "generate", generate)
    assert gate.walks(tmp_path, 1000, 30) == [tmp_path / "walks_1000" / "walks" / "a.mcap"]
    assert (asked[0].seed, asked[0].subset) == (1000, 30)


def test_a_line_that_is_replaced_occurs_once_in_the_sources():
    for file, old, _ in (r.source for r in REGRESSIONS if r.source):
        assert (Path(str(foot_ins.__file__)).parent / file).read_text(encoding="utf-8").count(old) == 1
