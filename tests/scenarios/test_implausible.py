"""The benchmark of implausible recordings: its corruptions, its files, and what counts as reported."""

import pickle

import numpy as np
import pytest

from benchmarks.implausible.__main__ import count_by_corruption, summarise
from benchmarks.implausible.clean import CleanTrial, is_alarm
from benchmarks.implausible.corruptions import CORRUPTIONS
from benchmarks.implausible.files import FORMATS
from benchmarks.implausible.trials import OTHER, RIGHT, SILENT, Case, Trial, draw_cases, list_reports, try_case
from benchmarks.implausible.walks import START_NS, Inertial, Views, Walk
from stridetwin.streams.formats.opening import open_any
from stridetwin.streams.rig import ImuCalibration, Mount
from stridetwin.streams.samples import Depth, Image, Imu
from tests.streams.foot_imu import RATE_HZ, STRIDE_M, simulate_foot

SIZE = (24, 32)
ROWS = 700  # 2 s at rest and four strides


def make_foot_walk():
    """A foot's IMU, from formulas."""
    t, force, rate = (values[:ROWS] for values in simulate_foot())
    t_ns = START_NS + np.rint(t * 1e9).astype(np.int64)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1))
    imu = Inertial(t_ns=t_ns, force_t_ns=t_ns, rate=rate, force=force, count=np.arange(len(t)), q_world_imu=upright)
    noise = ImuCalibration(
        topic="/foot_l/imu",
        part="",
        rate_hz=RATE_HZ,
        mount=Mount(body="foot_l"),
        gyroscope_noise_density=1e-3,
        gyroscope_random_walk=1e-5,
        accelerometer_noise_density=1e-2,
        accelerometer_random_walk=1e-4,
    )
    return Walk(imu=imu, noise=noise, views=None, length_m=4 * STRIDE_M)


def make_head_walk():
    """The samples of `make_foot_walk` as those of a head, with images of noise."""
    walk = make_foot_walk()
    rng = np.random.default_rng(0)
    t_ns = walk.imu.t_ns[::25]
    views = Views(
        t_ns=t_ns,
        colour=rng.integers(0, 256, (len(t_ns), *SIZE, 3), np.uint8),
        depth_m=np.round(rng.uniform(1.0, 3.0, (len(t_ns), *SIZE)), 3).astype(np.float32),
        intrinsics=(26.0, 26.0, 15.5, 11.5),
        T_imu_cam=np.eye(4),
        T_world_cam=np.tile(np.eye(4), (len(t_ns), 1, 1)),
    )
    return Walk(imu=walk.imu, noise=walk.noise, views=views, length_m=walk.length_m)


@pytest.mark.parametrize("name", FORMATS)
def test_a_format_holds_the_walk(name, tmp_path):
    form = FORMATS[name]
    walk = make_foot_walk() if form.body == "foot" else make_head_walk()
    source = form.write(tmp_path, walk)
    recording = open_any(source.path, lenient=True, options=source.options)
    assert not recording.problems
    if "imu" in form.has:
        block = recording.block("/foot_l/imu" if form.body == "foot" else "/head/imu")
        assert block.kind is Imu
        assert np.allclose(block.columns["specific_force"], walk.imu.force, atol=1e-6)
        assert np.allclose(block.columns["angular_rate"], walk.imu.rate, atol=1e-6)
        assert np.allclose(np.diff(block.t_ns), np.diff(walk.imu.t_ns), atol=2000)
    if "camera" in form.has:
        camera = recording.rig.cameras["/head/color"]
        assert camera.intrinsics == pytest.approx(walk.views.intrinsics)
        (image,) = recording.images("/head/color", [3])
        assert isinstance(image, Image)
    if "depth" in form.has:
        (depth,) = recording.images("/head/depth", [3])
        assert isinstance(depth, Depth)
        assert np.allclose(depth.depth, walk.views.depth_m[3], atol=1e-4)


@pytest.mark.parametrize(("name", "corruption"), CORRUPTIONS.items())
def test_a_corruption_changes_the_walk_alone(name, corruption):
    walk = make_head_walk()
    before = pickle.dumps(walk)
    changed, what = corruption.edit(walk, np.random.default_rng(1))
    assert pickle.dumps(walk) == before
    assert pickle.dumps(changed) != before
    assert what
    assert corruption.formats()


@pytest.mark.parametrize(
    ("corruption", "form", "outcome"), [("unit of forces", "csv", RIGHT), ("gravity removed", "foot_bag1", RIGHT)]
)
def test_a_reported_corruption_is_right(corruption, form, outcome, tmp_path):
    file = tmp_path / "foot_0.pickle"
    file.write_bytes(pickle.dumps(make_foot_walk()))
    trial = try_case(Case(corruption=corruption, form=form, number=3, seed=1, walk=file), ())
    assert trial.outcome == outcome
    assert trial.reports


@pytest.mark.parametrize("seed", range(20))
def test_forces_are_never_mirrored_as_a_whole(seed):
    walk = make_foot_walk()
    changed, _ = CORRUPTIONS["axes of forces"].edit(walk, np.random.default_rng(seed))
    assert not np.allclose(changed.imu.force, -walk.imu.force)


def test_a_good_table_gives_no_alarm(tmp_path):
    assert not any(map(is_alarm, list_reports(FORMATS["csv"].write(tmp_path, make_foot_walk()))))


def test_a_case_is_drawn_by_its_seed(tmp_path):
    cases = list(draw_cases(40, 5, tmp_path))
    assert cases == list(draw_cases(40, 5, tmp_path))
    assert {case.corruption for case in cases} == set(CORRUPTIONS)
    assert all(case.form in CORRUPTIONS[case.corruption].formats() for case in cases)
    assert {case.form for case in draw_cases(20, 5, tmp_path, ["tum"])} <= {"tum", "tum_in_parts"}


def trial(outcome, change, corruption="zero rows"):
    return Trial(corruption=corruption, form="csv", number=0, what="", outcome=outcome, change=change, reports=())


def test_only_what_matters_counts():
    trials = [trial(RIGHT, None), trial(OTHER, 0.2), trial(SILENT, 0.01), trial(SILENT, 0.3), trial(RIGHT, 0.0)]
    clean = [CleanTrial(seed=1, part="D455", form="csv", alarms=alarms) for alarms in ((), ("gap",))]
    summary = summarise(trials, clean)
    assert (summary["that matter"], summary["reported with the right cause"]) == (3, 1)
    assert summary["false alarms, %"] == 50.0
    row = count_by_corruption(trials)["zero rows, table"]
    assert (row["count"], row["right"], row["silent, harmful"], row["other, harmful"]) == (5, 2, 1, 1)
