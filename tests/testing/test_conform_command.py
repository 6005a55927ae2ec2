"""The command `conform`, and the helper in a test of another project."""

from __future__ import annotations

import json
import textwrap

import pytest

from stridetwin.cli.main import main
from stridetwin.estimators import registry
from stridetwin.testing import ConformanceError, check_conformance, conformance_cases, walk
from stridetwin.testing.cases import CHECKS

MODULE = '''
    """Two small estimators."""

    import numpy as np

    from stridetwin.streams.trajectory import Pose


    class Foot:
        frame, topics = "foot_l/imu", ["/foot_l/imu"]

        def __init__(self, rig):
            self.rate_hz = rig.imu("/foot_l/imu").rate_hz

        def update(self, sample):
            print("never on stdout")
            p = np.zeros(3) if np.isfinite(sample.specific_force).all() else np.full(3, np.nan)
            return Pose(t_ns=sample.t_ns, p_frame_in_world=p, rotation=np.array([1.0, 0.0, 0.0, 0.0]))


    no_class = 3
'''


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A working folder with the module `small_foot`."""
    (tmp_path / "small_foot.py").write_text(textwrap.dedent(MODULE), encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_one_line_per_check_and_exit_code_one(module, capsys):
    only = ["--only", "declaration", "--only", "finite", "--only", "fault_nan", "--only", "follow"]
    assert main(["conform", "small_foot:Foot", *only]) == 1
    rows = capsys.readouterr().out.splitlines()
    assert [row.split()[:2] for row in rows[:4]] == [
        ["declaration", "passed"],
        ["finite", "passed"],
        ["fault_nan", "failed"],
        ["follow", "skipped"],
    ]
    assert "pose" not in rows[0]
    assert "p_frame_in_world" in rows[2]
    assert rows[4] == "small_foot:Foot: 2 passed, 1 failed, 1 skipped"


def test_json_and_exit_code_zero(capsys):
    assert main(["conform", "foot_ins", "--foot", "r", "--only", "stamps", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data == {
        "estimator": "foot_ins",
        "passed": 1,
        "failed": 0,
        "checks": [{"check": "stamps", "outcome": "passed", "message": ""}],
    }


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nothing"], "foot_ins"),
        (["no_module:Class"], "no_module:Class: cannot be imported: ModuleNotFoundError"),
        (["small_foot:no_class"], "is not a class with an update(sample) method"),
        (["foot_ins", "--method", "best"], "--method: invalid 'best': expected proposed"),
        (["foot_ins", "--mount", "head"], "--mount: invalid 'head': expected none"),
        (["foot_ins", "--recording", "none.mcap"], "none.mcap"),
        (["foot_ins", "--only", "speed"], "only: check: invalid 'speed': expected declaration"),
    ],
)
def test_usage_errors_are_one_line(module, capsys, words, said):
    assert main(["conform", *words]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert said in captured.err
    assert captured.err.count("\n") == 1


def test_the_helper_in_a_test_of_another_project(module, pytester):
    recording = walk.find_walk(registry.estimator("foot_ins"), None, None).recording.path
    pytester.makepyfile(
        test_small_foot=f"""
        import sys
        from pathlib import Path
        import pytest
        from stridetwin.testing import conformance_cases
        sys.path.insert(0, {str(module)!r})
        from small_foot import Foot

        @pytest.mark.parametrize("case", conformance_cases(Foot, recording=Path({str(recording)!r})))
        def test_conforms(case):
            case.run()
        """
    )
    result = pytester.runpytest_subprocess("-q", "-k", "finite or fault_nan or follow", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=1, failed=1, skipped=1)
    result.stdout.fnmatch_lines(["*ConformanceError: Foot: where values are NaN, *p_frame_in_world*leave out*"])


def test_a_case_is_named_and_raises(module):
    import small_foot

    cases = {case.id: case.values[0] for case in conformance_cases(small_foot.Foot)}
    assert list(cases) == list(CHECKS)
    assert repr(cases["finite"]) == "<Case finite of Foot>"
    with pytest.raises(ConformanceError, match="Foot: where values are NaN"):
        cases["fault_nan"].run()


def test_without_the_simulator_a_person_stands_on_synthetic_samples(monkeypatch):
    monkeypatch.setattr(walk, "find_spec", lambda name: None)
    names = ["declaration", "estimates", "finite", "covariance", "plausible", "deterministic", "fault_nan"]
    for name in ("foot_ins", "terrain_map"):
        verdicts = check_conformance(registry.estimator(name), only=names)
        assert [v.outcome for v in verdicts] == ["passed"] * len(names), verdicts
    (verdict,) = check_conformance(registry.estimator("contact_terrain"), only=["declaration"])
    assert verdict.outcome == "failed"
    assert "no exoskeleton geometry" in verdict.message
    assert "pip install '.[twin]'" in verdict.message
