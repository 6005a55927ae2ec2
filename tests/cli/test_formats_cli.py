"""`import` and `export` on the command line, and the estimators on what they read."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.foreign_files import FORMATS, Walk
from stridetwin.cli.main import main
from stridetwin.estimators.dvio import Dvio
from stridetwin.outputs.feeding import runnable_instances
from stridetwin.outputs.registry import kind_of
from stridetwin.outputs.truth import true_path
from stridetwin.streams.errors import RecordingError
from stridetwin.streams.formats.imu_table import read_imu_table
from stridetwin.streams.formats.opening import open_any
from stridetwin.streams.formats.tum import read_tum
from stridetwin.streams.kalibr import write_rig
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Block, Depth, Image, Imu, Odometry


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    folder = tmp_path_factory.mktemp("foreign")
    return {name: write(folder, Walk()) for name, write in FORMATS.items()}


def call(capsys, *words):
    code = main([str(w) for w in words])
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.mark.parametrize("name", list(FORMATS))
def test_everything_that_is_imported_opens_as_a_recording(sources, capsys, tmp_path, name):
    path = tmp_path / "deep" / "walk.mcap"
    code, out, err = call(capsys, "import", sources[name], "-o", path, "--json")
    data = json.loads(out)
    assert code == 0
    assert {t: i["samples"] for t, i in data["topics"].items()} == {
        t: i.count for t, i in Recording(path).topics.items()
    }
    assert all(f"stridetwin: warning: {sources[name]}: {w}" in err for w in data["warnings"])


def standing_foot(file, n=400):
    """A table of a foot's IMU that stands still, at 100 Hz."""
    rng = np.random.default_rng(1)
    still = np.column_stack((np.arange(n) / 100, rng.normal((0, 0, 9.81), 0.02, (n, 3)), rng.normal(0, 0.002, (n, 3))))
    header = "t,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z"
    np.savetxt(file, still, delimiter=",", header=header, comments="", fmt="%.9g")
    return file


def test_estimators_take_bags_and_folders_as_they_are(sources, capsys, tmp_path):
    path, n = tmp_path / "path.txt", 400
    table = standing_foot(tmp_path / "foot.csv", n)
    recording = tmp_path / "still.mcap"
    call(capsys, "import", table, "--map", "/foot_l/imu=/foot_r/imu", "-o", recording)
    bag = tmp_path / "bag"
    assert call(capsys, "export", recording, "--format", "rosbag2", "--storage", "sqlite3", "-o", bag)[0] == 0
    code, _, err = call(capsys, "estimate", "foot_ins", bag, "--foot", "r", "-o", path)
    assert (code, len(read_tum(path))) == (0, n), err
    assert np.abs(read_tum(path).p_frame_in_world).max() < 0.05
    code, _, err = call(capsys, "estimate", "foot_ins", sources["euroc"], "-o", path)
    assert code == 2
    assert "no topic '/foot_l/imu'; it has /head/color, /head/imu" in err
    assert "if /head/imu is that sensor: --map /head/imu=/foot_l/imu" in err
    code, _, err = call(capsys, "estimate", "foot_ins", sources["euroc"], "--map", "/head/imu=/foot_l/imu", "-o", path)
    assert "no topic" not in err


def test_score_runs_the_odometry_on_a_folder_of_one_camera_as_estimate_does(sources):
    recording = open_any(sources["euroc"])
    assert not {"/head/depth", "/head/color_right"} & set(recording.topics)
    (instance,) = runnable_instances(Dvio, recording)
    assert {stream.topic for stream in instance.streams if stream.required} == {"/head/imu", "/head/color"}
    assert instance.build(recording.rig) is not None
    assert kind_of(Dvio.declaration).has_truth(recording)


def test_a_table_is_estimated_with_its_options(capsys, tmp_path):
    table, rig, path = standing_foot(tmp_path / "foot.csv"), tmp_path / "rig.yaml", tmp_path / "path.txt"
    imu = ImuCalibration(
        topic="/foot_l/imu",
        part="",
        rate_hz=100.0,
        mount=Mount(body="foot_l"),
        gyroscope_noise_density=2e-2,
        gyroscope_random_walk=1e-3,
        accelerometer_noise_density=0.1,
        accelerometer_random_walk=1e-2,
    )
    write_rig(Rig(imus={imu.topic: imu}), rig)
    for words, says in (
        (("--rig", tmp_path / "nowhere.yaml"), "nowhere.yaml: cannot be read"),
        (("--map", "/a=/b"), "--map: invalid '/a': expected one of /foot_l/imu"),
        (("--map", "/foot_l/imu=/foot_r/imu"), "no topic '/foot_l/imu'; it has /foot_r/imu"),
        (("--as", "euroc"), "ASL layout"),
    ):
        code, _, err = call(capsys, "estimate", "foot_ins", table, *words, "-o", path)
        assert (code, path.exists()) == (2, False)
        assert says in err
    assert call(capsys, "estimate", "foot_ins", table, "-o", path)[0] == 0
    bare = path.read_bytes()
    assert call(capsys, "estimate", "foot_ins", table, "--rig", rig, "-o", path)[0] == 0
    calibrated = path.read_bytes()
    recording = tmp_path / "foot.mcap"
    assert call(capsys, "import", table, "--rig", rig, "-o", recording)[0] == 0
    assert call(capsys, "estimate", "foot_ins", recording, "-o", path)[0] == 0
    assert path.read_bytes() == calibrated != bare


def test_truth_of_a_camera_scores_the_imu_beside_it(capsys, tmp_path):
    t = np.arange(0, 4, 0.01)
    t_ns = np.rint(t * 1e9).astype(np.int64)
    p = np.column_stack((t, 0.3 * np.sin(2 * t), 0.05 * np.cos(5 * t)))
    v = np.column_stack((np.ones_like(t), 0.6 * np.cos(2 * t), -0.25 * np.sin(5 * t)))
    R = Rotation.from_rotvec(np.outer(0.8 * np.sin(3 * t), (0, 0, 1)))
    rate = np.column_stack((np.zeros((len(t), 2)), 2.4 * np.cos(3 * t)))
    truth = {"p_frame_in_world": p, "q_world_frame": R.as_quat(scalar_first=True), "v_frame_in_world": v}
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], (0.1, -0.05, 0.02)  # optical, before the IMU
    imu = ImuCalibration(
        topic="/head/imu",
        part="",
        rate_hz=100.0,
        mount=Mount(body="head"),
        gyroscope_noise_density=1e-3,
        gyroscope_random_walk=1e-5,
        accelerometer_noise_density=1e-2,
        accelerometer_random_walk=1e-4,
    )
    camera = CameraCalibration(
        topic="/head/color",
        part="",
        rate_hz=5.0,
        mount=Mount(body="head", T_body_sensor=T),
        width=32,
        height=24,
        intrinsics=(26.0, 26.5, 15.5, 11.5),
        depth_topic="/head/depth",
        imu_topic="/head/imu",
    )
    rig = Rig(imus={imu.topic: imu}, cameras={camera.topic: camera})
    force = np.tile((0.0, 0.0, 9.81), (len(t), 1))
    columns = {"angular_rate": rate, "specific_force": force}
    recorded, folder, path = tmp_path / "walk.mcap", tmp_path / "tum", tmp_path / "imu.txt"
    with RecordingWriter(recorded, rig) as writer:
        writer.write(Block(topic=imu.topic, kind=Imu, t_ns=t_ns, columns=columns))
        measured = {**truth, "angular_rate": rate}
        writer.write(Block(topic="/truth/head/imu/odometry", kind=Odometry, t_ns=t_ns, columns=measured))
        for now in t_ns[::20].tolist():
            writer.write(Image(topic=camera.topic, t_ns=now, pixels=np.full((24, 32, 3), 99, np.uint8)))
            writer.write(Depth(topic=camera.depth_topic, t_ns=now, depth=np.full((24, 32), 2.0, np.float32)))
    assert call(capsys, "export", recorded, "--format", "tum", "--frame", "head/imu", "-o", path)[0] == 0
    assert call(capsys, "export", recorded, "--format", "tum", "-o", folder)[0] == 0
    words = ("score", folder, "--estimate", f"own={path}", "--frame", "/head/imu", "--json")
    code, out, err = call(capsys, *words)
    assert code == 0, err
    scores = json.loads(out)["estimators"]["own"]
    assert scores["ape_max_m"] < 1e-6
    carried, own = true_path(open_any(folder), "/head/imu"), true_path(Recording(recorded), "head/imu")
    np.testing.assert_allclose(carried.v_frame_in_world[1:-1], own.v_frame_in_world[1:-1], atol=2e-3)
    turn = Rotation.from_quat(carried.q_world_frame, scalar_first=True).inv() * R
    assert turn.magnitude().max() < 1e-6
    with pytest.raises(RecordingError, match="no truth of frame 'foot_l/imu'; it has head/color"):
        true_path(open_any(folder), "foot_l/imu")


def test_exports_of_an_imported_folder(sources, capsys, tmp_path):
    for name, form in (("euroc", "euroc"), ("tum", "tum"), ("euroc", "rosbag2")):
        code, out, _ = call(
            capsys, "export", sources[name], "--format", form, "-o", tmp_path / f"{name}_{form}", "--json"
        )
        assert code == 0
        assert json.loads(out)["rows"]
    table = tmp_path / "imu.csv"
    assert call(capsys, "export", sources["rosbag1"], "--format", "table", "--frame", "head/imu", "-o", table)[0] == 0
    assert len(read_imu_table(table)) == 200
    truth = tmp_path / "truth.txt"
    words = ("export", sources["rosbag1"], "--format", "tum", "--frame", "head", "-o", truth)
    assert call(capsys, *words)[0] == 0
    np.testing.assert_allclose(read_tum(truth).p_frame_in_world, Walk().p, atol=1e-8)


def test_a_taken_place_is_left_as_it_is(sources, capsys, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    code, _, err = call(capsys, "export", sources["euroc"], "--format", "euroc", "-o", tmp_path / "mine")
    assert code == 2
    assert "expected a folder that is new or empty" in err
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--map", "imu"), "--map: invalid 'imu': expected FROM=TO"),
        (("--as", "zip"), "--as: invalid 'zip': expected mcap"),
        (("--as", "euroc"), "a folder in the ASL layout"),
        (("--depth-scale", "0"), "'--depth-scale': '0': expected a number above 0"),
        (("--rig", "nowhere.yaml"), "nowhere.yaml: cannot be read"),
    ],
)
def test_wrong_options_are_reported_in_one_line(sources, capsys, tmp_path, words, says):
    try:
        code, _, err = call(capsys, "import", sources["tum"], "-o", tmp_path / "a.mcap", *words)
    except SystemExit as stop:
        code, err = stop.code, capsys.readouterr().err
    assert code == 2
    assert says in err
    assert len([line for line in err.splitlines() if "error:" in line]) == 1
    assert not (tmp_path / "a.mcap").exists()


def test_the_imu_of_a_table_is_measured_named_or_unknown(capsys, tmp_path):
    t = np.arange(600) / 100.0
    rng = np.random.default_rng(0)
    rest = np.tile([0.0, 0.0, 9.81], (600, 1)) + 0.01 * rng.standard_normal((600, 3))
    table = tmp_path / "imu.npz"
    np.savez(table, t=t, accel=rest, gyro=0.001 * rng.standard_normal((600, 3)) + [0.0, 0.03, 0.0])
    said = {
        choice: call(capsys, "estimate", "foot_ins", table, "-o", tmp_path / "path.txt", *choice)
        for choice in ((), ("--imu", "auto"), ("--imu", "none"), ("--imu", "MPU-9250"))
    }
    assert all(code == 0 for code, _, _ in said.values())
    assert said[()][1] == said[("--imu", "auto")][1]
    assert "as measured: 100 Hz" in said[()][1]
    assert "gyro bias 1.7 °/s" in said[()][1]
    assert "IMU" not in said[("--imu", "none")][1]
    assert "MPU-9250" in said[("--imu", "MPU-9250")][1]
    code, _, error = call(capsys, "estimate", "foot_ins", table, "-o", tmp_path / "path.txt", "--imu", "AMT203")
    assert code == 2
    assert "invalid --imu AMT203: expected auto, none" in error
    assert "MPU-9250" in error


def test_imu_goes_with_a_table_alone(capsys, sources, tmp_path):
    for words in (("foot_ins", sources["EuRoC"] if "EuRoC" in sources else next(iter(sources.values()))),):
        code, _, error = call(capsys, "estimate", *words, "-o", tmp_path / "path.txt", "--imu", "auto")
        assert code == 2
        assert "--imu is only valid for foot_ins and an IMU table" in error
