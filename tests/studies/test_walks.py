"""The experiments that walk, on a walk as short as it gets: one recording, every method, every case."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.foot_ins import FootInsPath
from stridetwin.outputs.truth import TruePath
from stridetwin.streams.samples import Image, Imu
from stridetwin.streams.trajectory import Trajectory
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.experiment import Experiment, experiment
from stridetwin.studies.jao2020 import jao_faults, jao_walk
from stridetwin.studies.jao2020.two_feet import COMPARED_METHODS, FEET, score_paths
from stridetwin.studies.walks import record_shoes
from tests.studies.short_experiment import make_case, shorten

pytest.importorskip("mujoco")

SHORT = """
description: a few steps
terrain:
  - level: {length_m: 5}
gait: {stand_s: 1}
sensors:
  foot_camera: {rate_hz: 30}
"""


@pytest.fixture(scope="module")
def short(tmp_path_factory) -> tuple[ExperimentCase, dict]:
    """A case whose recordings are kept, and its row."""
    folder = tmp_path_factory.mktemp("walk")
    case = make_case(shorten("jao_loop_126m", folder, SHORT), folder, seed=3, keep=True)
    return case, jao_walk.run_case(case)


def test_every_method_has_figures_in_every_case(short) -> None:
    _, result = short
    assert set(result["cases"]) == set(jao_walk.CASES)
    for case in result["cases"].values():
        assert set(case) == {*COMPARED_METHODS, "sightings"}
        assert np.abs(case["proposed"]["end_error_m"]).max() < 0.03
        assert case["proposed"]["feet_disagree_rms_m"] < 0.005  # also with a gyro that clips at every toe-off
    seen = {name: case["sightings"] for name, case in result["cases"].items()}
    assert 0 < seen["half_blind"] < 0.8 * seen["unclipped"]


def test_the_gyros_without_limit_are_those_of_the_same_walk(short) -> None:
    case, _ = short
    with record_shoes(replace(case, resume=True)) as walk:
        limit = walk.rig().imu("/foot_l/imu").gyroscope_range
        assert limit == pytest.approx(math.radians(450), rel=0.1)
        assert walk.rig(wide=True).imu("/foot_l/imu").gyroscope_range == 0.0
        part, wide = walk.imus()["l"], walk.imus(wide=True)["l"]
        assert np.array_equal(part.t_ns, wide.t_ns)
        rates = part.columns["angular_rate"], wide.columns["angular_rate"]
        assert np.abs(rates[0]).max() <= 1.01 * limit < np.abs(rates[1]).max()
        standing = part.t_ns < 900_000_000
        np.testing.assert_allclose(rates[0][standing], rates[1][standing], atol=1e-3)
        samples = list(walk.samples(wide=True))
        assert [s.t_ns for s in samples] == sorted(s.t_ns for s in samples)
        assert sum(isinstance(s, Imu) for s in samples) == 2 * len(wide)
        lost = list(jao_walk.without_every_second_step(samples, jao_walk.touch_down_times_ns(walk)))
        assert 0 < sum(isinstance(s, Image) for s in lost) < sum(isinstance(s, Image) for s in samples)
        assert sum(isinstance(s, Imu) for s in lost) == 2 * len(wide)


def test_recordings_are_used_again_and_go_unless_they_are_kept(short, tmp_path) -> None:
    case, _ = short
    stamps = [case.file(end).stat().st_mtime_ns for end in (".mcap", "_wide.mcap")]
    with record_shoes(replace(case, resume=True)):
        pass
    assert [case.file(end).stat().st_mtime_ns for end in (".mcap", "_wide.mcap")] == stamps
    other = replace(case, folder=tmp_path, resume=True, keep=False)
    for end in (".mcap", "_wide.mcap"):
        other.file(end).write_bytes(case.file(end).read_bytes())
    with record_shoes(other):
        assert other.file(".mcap").exists()
    assert list(tmp_path.iterdir()) == []


def test_the_table_has_the_papers_figures_beside_ours(short) -> None:
    _, result = short
    found = jao_walk.collect([result | {"scenario": "jao_loop_126m"}] * 2)
    lines = jao_walk.table({**found, "cases": [result, result]})
    (row, *_) = [line for line in lines if line.startswith("zupt_relative_position")]
    assert row.split()[3:5] == ["1.53", "0.87"]
    assert {key for key in found["summary"] if key.startswith("mean_end_error")} == {
        f"mean_end_error{case}_{unit}" for case in ("", "_clipped", "_half_blind") for unit in ("m", "pct")
    }


EXCHANGES = ("left and right exchanged", "cameras exchanged", "IMUs exchanged")


@pytest.fixture(scope="module")
def exchanged(short) -> tuple[Experiment, dict]:
    """The experiment on faults, and its result without a fault and with each exchange of left and right."""
    case, _ = short
    study = experiment("jao_faults")
    faults = {label: study.setup.faults[label] for label in ("no fault", *EXCHANGES)}
    row = jao_faults.run_case(replace(case, resume=True, setup=replace(case.setup, faults=faults)))
    return study, study.result([row])


@pytest.mark.parametrize(
    ("label", "words"),
    [
        ("left and right exchanged", "IMUs and cameras"),
        ("cameras exchanged", "the cameras"),
        ("IMUs exchanged", "the IMUs"),
    ],
)
def test_exchanged_parts_are_refused_and_named_on_rendered_images(exchanged, label: str, words: str) -> None:
    _, result = exchanged
    assert words in result["summary"][label].get("error", "")


def test_the_same_walk_without_an_exchange_is_estimated(exchanged) -> None:
    study, result = exchanged
    assert np.max(result["summary"]["no fault"]["end_error_m"]) < 0.06
    assert len(study.table(result)) == 2 + 1 + len(EXCHANGES)


def straight(side: float) -> tuple[TruePath, FootInsPath]:
    """A foot that goes 10 m forward, and a path of it that is true, 0.1 m sure on each axis."""
    t_ns = np.arange(101) * 100_000_000
    p = np.column_stack([np.linspace(0.0, 10.0, 101), np.full(101, side), np.zeros(101)])
    q = np.tile([1.0, 0.0, 0.0, 0.0], (101, 1))
    truth = TruePath(t_ns=t_ns, p_frame_in_world=p, v_frame_in_world=np.tile([1.0, 0, 0], (101, 1)), q_world_frame=q)
    covariance = np.tile(0.01 * np.eye(6), (101, 1, 1))
    path = Trajectory(t_ns=t_ns, p_frame_in_world=p, q_world_frame=q, covariance=covariance)
    still = np.zeros(101)
    return truth, FootInsPath(
        trajectory=path, v_imu_in_world=truth.v_frame_in_world, standing_speed_sd=still, aligned=still == 0
    )


def test_figures_of_paths_whose_errors_are_known() -> None:
    made = {"l": straight(0.1), "r": straight(-0.1)}
    truth = {f: made[f][0] for f in FEET}
    off = made["r"][1].trajectory.p_frame_in_world + [0.0, 0.0, 0.05]
    higher = replace(made["r"][1], trajectory=replace(made["r"][1].trajectory, p_frame_in_world=off))
    found = score_paths({"l": made["l"][1], "r": higher}, truth)
    np.testing.assert_allclose(found["end_error_m"], [[0, 0, 0], [0, 0, 0.05]], atol=1e-12)
    np.testing.assert_allclose(found["end_nees"], [0.0, 0.25], atol=1e-6)
    assert found["feet_disagree_max_m"] == pytest.approx(0.05)
    assert found["end_error_pct"] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_a_heading_that_both_feet_share_is_not_their_disagreement() -> None:
    made = {"l": straight(0.1), "r": straight(-0.1)}
    turn = Rotation.from_euler("z", 0.2)
    paths = {}
    for foot, (_, path) in made.items():
        p, q = turn.apply(path.trajectory.p_frame_in_world), np.tile(turn.as_quat(scalar_first=True), (101, 1))
        paths[foot] = replace(path, trajectory=replace(path.trajectory, p_frame_in_world=p, q_world_frame=q))
    found = score_paths(paths, {f: made[f][0] for f in FEET})
    assert found["feet_disagree_max_m"] < 1e-9
    assert found["end_error_pct"][0] == pytest.approx(20.0, abs=0.2)
