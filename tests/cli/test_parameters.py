"""`--set ESTIMATOR.PARAMETER=VALUE` changes one parameter, and the results say so."""

import json

import numpy as np
import pytest

from stridetwin.cli.main import main
from stridetwin.estimators import registry
from stridetwin.estimators.dvio import Dvio, DvioParameters
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.estimators.foot_to_foot import FootToFoot
from stridetwin.outputs.parameters import parameter_keywords, parse_parameters, to_texts, use_parameters
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.imu_table import write_imu_table
from stridetwin.streams.formats.tum import read_tum
from stridetwin.streams.recording.reader import Recording
from stridetwin.studies import experiment as experiment_module
from stridetwin.studies.experiment import Experiment, experiment
from stridetwin.studies.registry import ExperimentBatchOptions, run_experiment
from stridetwin.studies.study_file.study import read_study
from stridetwin.studies.zhao2023 import odometry_walks

LEVER = "foot_ins.lever_arm_m=0.15"
STUDY = """
study: lever arms
scenarios: [level_20m]
seeds: [1000]
methods:
  usual: {estimator: foot_ins}
  other: {estimator: foot_ins, parameters: {contact_sd_m: 0.05}}
scores: [end_error_m]
"""


def run(capsys, *words):
    code = main([str(word) for word in words])
    printed = capsys.readouterr()
    assert code == 0, printed.err
    return json.loads(printed.out)


def test_score_takes_a_parameter_and_records_it(walk, capsys):
    recording = walk / "recording.mcap"
    usual, same, changed = (
        run(capsys, "score", recording, "--only", "foot_ins", "--json", *words)
        for words in ((), ("--set", "foot_ins.lever_arm_m=0.072"), ("--set", LEVER))
    )
    assert "parameters" not in usual
    assert same["estimators"] == usual["estimators"]
    assert changed["parameters"] == {"foot_ins": {"lever_arm_m": 0.15}}
    end_errors = [scores["estimators"]["foot_ins_l"]["end_error_m"] for scores in (usual, changed)]
    assert end_errors[0] != end_errors[1]


def test_run_takes_a_parameter_and_records_it(walk, simulator, capsys, tmp_path):
    words = ("run", "level_20m", "--seed", 3, "--no-cameras", "--no-film", "--only", "foot_ins", "--set", LEVER)
    run(capsys, *words, "--json", "-o", tmp_path / "walk")
    document = json.loads((tmp_path / "walk" / "scores.json").read_text())
    assert document["parameters"] == {"foot_ins": {"lever_arm_m": 0.15}}
    assert f"--set {LEVER}" in (tmp_path / "walk" / "report.html").read_text()
    usual = json.loads((walk / "scores.json").read_text())
    assert "parameters" not in usual
    assert document["estimators"]["foot_ins_l"] != usual["estimators"]["foot_ins_l"]


@pytest.mark.parametrize("lag", [(), ("--lag", "0.5")])
def test_estimate_takes_a_parameter_with_recordings_and_tables(walk, capsys, tmp_path, lag):
    recording, table = walk / "recording.mcap", tmp_path / "imu.npz"
    write_imu_table(table, Recording(recording).block("/foot_l/imu"))
    for source in (recording, table):
        paths = []
        for words in ((), ("--set", LEVER)):
            file = tmp_path / "path.txt"
            data = run(capsys, "estimate", "foot_ins", source, *lag, *words, "--json", "-o", file)
            assert data.get("parameters") == ({"foot_ins": {"lever_arm_m": 0.15}} if words else None)
            paths.append(read_tum(file).p_frame_in_world)
        assert np.abs(paths[0] - paths[1]).max() > 1e-6


def test_a_study_takes_a_parameter_for_every_method_of_the_estimator(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text(STUDY)
    usual, changed = (read_study(file, parse_parameters(texts)).methods for texts in ((), (LEVER,)))
    assert [method.parameters and method.parameters.lever_arm_m for method in usual] == [None, 0.072]
    assert [method.parameters.lever_arm_m for method in changed] == [0.15, 0.15]
    assert changed[1].parameters.contact_sd_m == 0.05
    with pytest.raises(ConfigError, match=r"--set: gait_phase: invalid 'gait_phase': .* runs here: foot_ins"):
        read_study(file, parse_parameters(["gait_phase.stride_s=1.1"]))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lever_arm_m=0.09", "--set: invalid 'lever_arm_m=0.09': expected ESTIMATOR.PARAMETER=VALUE"),
        ("foot_ins.lever_arm_m", "--set: invalid 'foot_ins.lever_arm_m': expected ESTIMATOR.PARAMETER=VALUE"),
        ("foot_inz.lever_arm_m=1", r"foot_inz.lever_arm_m: invalid 'foot_inz': .*\(did you mean 'foot_ins'\?\)"),
        ("foot_ins.lever_m=1", r"foot_ins.lever_m: invalid 'lever_m': .*\(did you mean 'lever_sd_m'\?\)"),
        ("foot_ins.lever_arm_m=high", "foot_ins.lever_arm_m: invalid 'high': expected a number"),
        ("foot_ins.lever_arm_m=-1", "foot_ins.lever_arm_m: invalid -1.*: expected a finite number ≥ 0"),
    ],
)
def test_an_invalid_parameter_is_refused_with_the_nearest_name(text, said):
    with pytest.raises(ConfigError, match=said):
        parse_parameters([text])


def test_a_parameter_without_effect_is_refused(walk, capsys, tmp_path):
    recording = walk / "recording.mcap"
    for words in (
        ("score", recording, "--only", "gait_phase", "--set", LEVER),
        ("estimate", "gait_phase", recording, "-o", tmp_path / "phase.csv", "--set", LEVER),
    ):
        assert main([str(word) for word in words]) == 2
        assert "--set: foot_ins: invalid 'foot_ins': expected an estimator that runs here: gait_phase" in (
            capsys.readouterr().err
        )


def test_values_come_back_as_texts():
    texts = ["foot_ins.lever_arm_m=0.09", "foot_ins.contact_sd_m=1e-3"]
    values = parse_parameters(texts)
    assert values == {"foot_ins": {"lever_arm_m": 0.09, "contact_sd_m": 0.001}}
    assert parse_parameters(to_texts(values)) == values
    assert FootIns.declaration.name in values


def test_an_experiment_builds_its_estimators_with_a_parameter_and_records_it(tmp_path, monkeypatch):
    built = []

    def run_case(case):
        keywords = parameter_keywords(FootToFoot, "zupt")
        built.append(keywords["parameters"].camera_clock_sd_s if keywords else None)
        return {"seed": case.seed, "physics": case.physics}

    small = Experiment(
        name="small",
        seeds=(5,),
        run_case=run_case,
        collect=lambda rows: {"summary": {}, "paper": {}},
        table=lambda result: [],
        adjustable=("foot_to_foot",),
    )
    monkeypatch.setitem(experiment_module._LOADED, "small", small)
    values = parse_parameters(["foot_to_foot.camera_clock_sd_s=0.003"])
    usual, changed = (
        run_experiment("small", ExperimentBatchOptions(folder=tmp_path, parameters=p, resume=True), lambda *_: None)
        for p in ({}, values)
    )
    assert built == [None, 0.003]  # the row of other values is not reused
    assert parameter_keywords(FootToFoot, "zupt") == {}
    assert ("parameters" in usual, changed["parameters"]) == (False, values)
    with pytest.raises(ConfigError, match=r"--set: foot_ins: .* an estimator that runs here: foot_to_foot"):
        run_experiment(
            "small",
            ExperimentBatchOptions(folder=tmp_path, parameters=parse_parameters([LEVER])),
            lambda *_: None,
        )


@pytest.mark.parametrize("name", ["jao_straight_53m", "shim_table5", "zhao_closed_loop", "zhao_generality"])
def test_every_estimator_that_an_experiment_adjusts_is_one_of_ours(name):
    assert experiment(name).adjustable
    assert set(experiment(name).adjustable) <= set(registry.names())


def test_the_constructors_of_the_experiments_get_the_parameters(monkeypatch):
    seen = []

    class Odometry(Dvio):
        def __init__(self, rig, *, options=None, parameters: DvioParameters | None = None):
            seen.append(parameters)

    monkeypatch.setattr(odometry_walks, "Dvio", Odometry)
    with use_parameters(parse_parameters(["dvio.pixel_noise_px=0.5"])):
        odometry_walks.make_odometer("proposed", None, "head")
    odometry_walks.make_odometer("proposed", None, "head")
    assert [parameters and parameters.pixel_noise_px for parameters in seen] == [0.5, None]
