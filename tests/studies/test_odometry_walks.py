"""The experiments of visual-inertial odometry, with a stand-in that knows the truth and drifts as asked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from stridetwin.estimators.registry import estimator
from stridetwin.outputs.truth import TruePath
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Image, Imu, Sample
from stridetwin.streams.trajectory import Pose
from stridetwin.studies.experiment import experiment
from stridetwin.studies.fault_injection import fault_plans
from stridetwin.studies.walks import record_walk
from stridetwin.studies.zhao2023 import dvio_bench, dvio_faults, odometry_walks, zhao_closed_loop
from stridetwin.studies.zhao2023.odometry_walks import ODOMETRY_METHODS, run_case, run_odometry, true_path
from tests.studies.short_experiment import make_case, shorten

SHORT = """description: A few steps
terrain:
  - level: {length_m: 2.5}
scenery: room
gait: {stand_s: 0.5}
sensors:
  head_camera: {rate_hz: 2}
"""
DRIFT = {"proposed": 0.05, "dvio": 0.26, "vins_rgbd": 0.5, "vins_mono": 30.0}  # m over the whole walk


@dataclass
class Standin:
    """Reports the truth, but for a drift that grows with time; and a loss in the middle where asked for."""

    truth: TruePath
    drift_m: float
    lost: bool = False

    def update(self, sample: Sample) -> Pose | None:
        if not isinstance(sample, Imu):
            return None
        t, span = sample.t_ns - self.truth.t_ns[0], self.truth.t_ns[-1] - self.truth.t_ns[0]
        i = np.searchsorted(self.truth.t_ns, sample.t_ns)
        p = self.truth.p_frame_in_world[i] + [0.0, self.drift_m * t / span, 0.0]
        q = self.truth.q_world_frame[i]
        valid = not (self.lost and 0.4 < t / span < 0.5)
        return Pose(t_ns=sample.t_ns, p_frame_in_world=p, rotation=q, covariance=1e-4 * np.eye(6), valid=valid)


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """A case of the closed loop on a short walk that is recorded already, and its true path."""
    folder = tmp_path_factory.mktemp("walks")
    case = make_case(shorten("zhao_closed_loop", folder, SHORT), folder, resume=True, keep=True)
    with record_walk(case.walks()[0], case) as recording:
        return SimpleNamespace(folder=folder, case=case, truth=true_path(recording, "head"), rig=recording.rig)


def case_of(walk, name: str, **changes):
    """A case of another experiment on the same recording."""
    return make_case(shorten(name, walk.folder, SHORT, **changes), walk.folder, resume=True, keep=True)


def maker(truth: TruePath):
    return lambda method, rig, mount: Standin(truth, DRIFT[method])


def test_time_is_counted_from_image_to_image_and_the_last_pose_of_an_instant_counts() -> None:
    imu = Imu(topic="/head/imu", t_ns=0, angular_rate=np.zeros(3), specific_force=np.zeros(3))
    image = Image(topic="/head/color", t_ns=0, pixels=np.zeros((2, 2), np.uint8))
    samples = [sample for t in (0, 5, 10, 15) for sample in (replace(imu, t_ns=t), replace(image, t_ns=t))]
    number = iter(range(len(samples)))

    def update(sample: Sample) -> Pose:
        p = np.array([next(number), 0.0, 0.0])
        return Pose(t_ns=sample.t_ns, p_frame_in_world=p, rotation=np.eye(3), covariance=np.eye(6))

    run = run_odometry(SimpleNamespace(update=update), samples)
    assert run.odometry.path.t_ns.tolist() == [0, 5, 10, 15]
    assert run.odometry.path.p_frame_in_world[:, 0].tolist() == [1, 3, 5, 7]
    assert len(run.frame_ms) == 3


def test_the_closed_loop_has_every_method_and_the_paper(walk) -> None:
    result = run_case(walk.case, make=maker(walk.truth))
    assert (result["subject"], result["mount"]) == ("zhao_i_1", "head")
    for method in ODOMETRY_METHODS:
        assert result["methods"][method]["loop_drift_m"] == pytest.approx(DRIFT[method], rel=0.02)
    collected = zhao_closed_loop.collect([result])
    summary = collected["summary"]
    assert {m: summary[m]["failures"] for m in ODOMETRY_METHODS} == {
        "proposed": 0,
        "dvio": 0,
        "vins_rgbd": 0,
        "vins_mono": 1,
    }
    assert summary["proposed"]["by_mount"]["head"]["loop_drift_m"] == summary["proposed"]["loop_drift_m"]
    assert summary["time_ms"]["p99"] >= summary["time_ms"]["mean"] > 0.0
    assert collected["paper"]["dvio"]["loop_drift_m"] == pytest.approx(0.2563, abs=1e-4)
    assert collected["paper"]["vins_mono"]["loop_drift_m"] == ">10"
    lines = zhao_closed_loop.table({**collected, "cases": [result]})
    assert any(line.startswith("dvio") and "0.26" in line for line in lines)
    assert walk.case.recordings


def test_an_installed_estimator_has_a_row_of_its_own(walk) -> None:
    drift = {**DRIFT, "mine": 0.1}
    case = replace(walk.case, estimators=("mine",))
    result = run_case(case, make=lambda method, rig, mount: Standin(walk.truth, drift[method]))
    assert list(result["methods"]) == [*ODOMETRY_METHODS, "mine"]
    collected = zhao_closed_loop.collect([result])
    assert collected["summary"]["mine"]["loop_drift_m"] == pytest.approx(0.1, rel=0.02)
    lines = zhao_closed_loop.table({**collected, "cases": [result]})
    assert any(line.startswith("mine") and "0.10" in line for line in lines)


def test_names_that_are_no_method_are_those_of_installed_estimators(walk) -> None:
    assert isinstance(odometry_walks.make_odometer("dvio", walk.rig, "head"), estimator("dvio"))
    with pytest.raises(StrideTwinError, match=r"nobody.*contact_terrain, dvio"):
        odometry_walks.make_odometer("nobody", Rig(), "head")


def test_each_subject_walks_once_with_each_mount() -> None:
    loop = experiment("zhao_closed_loop")
    turns = [tuple(make_case(loop, Path(), seed).labels.values()) for seed in (*loop.seeds, *range(30))]
    assert len(set(turns[:30])) == len(loop.seeds) == 30
    assert set(turns[:30]) == set(turns[30:])  # lower seeds take the same turns
    assert {mount for _, mount in turns} == {"head", "chest"}


def test_the_bench_lays_each_sequence_beside_one_of_euroc(walk) -> None:
    names = list(dvio_bench.SEQUENCES)
    assert names == [level.name for level in experiment("dvio_bench").setup.design.turns["sequence"][1]]
    sequences = {name: {"scenario": "short.yaml"} for name in names}
    case = case_of(walk, "dvio_bench", scenarios=[], vary={"sequence": sequences})
    result = run_case(case, make=maker(walk.truth))
    assert result["sequence"] == names[0]
    collected = dvio_bench.collect([result])
    of = collected["summary"]["dvio"]["ape_rmse_m"]
    assert 0.01 < of[names[0]] == of["mean"] < DRIFT["dvio"] / np.sqrt(12)  # a turn takes much of it on a straight way
    assert collected["paper"]["dvio"]["ape_rmse_m"]["mean"] == pytest.approx(0.091, abs=1e-3)
    lines = dvio_bench.table({**collected, "cases": [result]})
    assert len([line for line in lines if "MH_01" in line]) == 1
    assert lines[-1].startswith("mean")
    assert "(0.09)" in lines[-1]


def test_ten_sequences_each_as_difficult_as_another_one_of_the_paper() -> None:
    assert len(dvio_bench.SEQUENCES) == 10
    assert {s.like for s in dvio_bench.SEQUENCES.values()} == set(
        dvio_bench.read_paper_figures()["dvio"]["ape_rmse_m"]
    ) - {"mean"}
    for name in dvio_bench.SEQUENCES:
        assert load_scenario(name).config.fittings["head_camera"].calibration_sd.depth_scale == pytest.approx(0.005)


def test_faults_are_tolerated_or_not(walk) -> None:
    made = iter(range(100))

    def make(method: str, rig: Rig, mount: str) -> Standin:
        number = next(made)  # no fault, then one that drifts twice as far, and one that is lost and comes back
        return Standin(walk.truth, {0: 0.05, 1: 0.10}.get(number, 0.3), lost=number == 2)

    case = case_of(walk, "dvio_faults")
    result = experiment("dvio_faults").result([dvio_faults.run_case(case, make=make)])
    summary = result["summary"]
    assert list(summary) == list(case.setup.faults)
    assert [figures["borne"] for figures in summary.values()][:4] == [1, 1, 1, 0]
    assert summary["no depth for 5 s"]["failures"] == 1
    assert summary["no depth for 5 s"]["unhealthy_s"] > 0.1
    assert len(experiment("dvio_faults").table(result)) == 2 + len(summary)


def test_calibration_errors_of_the_faults(walk) -> None:
    rig = walk.rig
    plans = fault_plans(case_of(walk, "dvio_faults"), rig, 10.0)
    rotated = plans["camera mount 2° off in the calibration"].rig.cameras["/head/color"].mount.T_body_sensor
    R = rotated[:3, :3].T @ rig.cameras["/head/color"].mount.T_body_sensor[:3, :3]
    assert np.degrees(np.arccos((np.trace(R) - 1) / 2)) == pytest.approx(2.0, abs=1e-4)
    late = plans["camera clock 10 ms off in the calibration"].rig.cameras["/head/color"].timeshift_cam_imu_s
    assert late - rig.cameras["/head/color"].timeshift_cam_imu_s == pytest.approx(0.010)
    clipped = plans["IMU clips at every step and turn"]
    assert clipped.rig.imu("/head/imu").gyroscope_range == pytest.approx(0.6, abs=1e-4)
    hard = Imu(topic="/head/imu", t_ns=0, angular_rate=np.full(3, 2.0), specific_force=np.full(3, -15.0))
    (soft,) = clipped.samples([hard])
    assert soft.angular_rate.tolist() == pytest.approx([0.6] * 3, abs=1e-4)
    assert soft.specific_force.tolist() == [-10.0] * 3


def test_the_methods_are_the_papers_and_ours() -> None:
    assert set(odometry_walks.ODOMETRY_METHODS) == set(zhao_closed_loop.read_paper_figures()) | {"proposed"}
