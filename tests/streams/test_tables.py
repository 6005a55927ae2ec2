"""IMU tables and TUM trajectories."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.imu_table import read_imu_table
from stridetwin.streams.formats.tum import read_tum, write_tum
from stridetwin.streams.trajectory import Trajectory

N = 200
HEADER = "t,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z"


def table():
    rng = np.random.default_rng(4)
    return {
        "t": np.arange(N) / 200.0,
        "accel": rng.normal((0, 0, -9.81), 0.1, (N, 3)),
        "gyro": rng.normal(0, 1.0, (N, 3)),
    }


def write_csv(path, content, header=HEADER):
    rows = np.column_stack((content["t"], content["accel"], content["gyro"]))
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.17g")


def test_both_forms_give_the_same_samples(tmp_path):
    content = table()
    np.savez(tmp_path / "a.npz", **content, position=np.zeros((N, 3)))
    write_csv(tmp_path / "a.csv", content)
    write_csv(tmp_path / "b.csv", content, "t,ax,ay,az,gx,gy,gz")
    for name in ("a.npz", "a.csv", "b.csv"):
        block = read_imu_table(tmp_path / name, topic="/foot_l/imu")
        np.testing.assert_array_equal(block.t_ns, np.arange(N) * 5_000_000)
        np.testing.assert_array_equal(block.columns["specific_force"], content["accel"])
        np.testing.assert_array_equal(block.columns["angular_rate"], content["gyro"])
        assert next(iter(block)).topic == "/foot_l/imu"


def broken(name):
    content = table()
    if name == "nan":
        content["accel"][17, 1] = np.nan
    elif name == "backwards":
        content["t"][30] = content["t"][28]
    elif name == "short":
        content = {k: v[:5] for k, v in content.items()}
    elif name == "g":
        content["accel"] /= 9.80665
    elif name == "gravity":
        content["accel"] += [0, 0, 9.81]
    elif name == "degrees":
        content["gyro"] *= 180 / np.pi
    elif name == "milliseconds":
        content["t"] *= 1000
    return content


@pytest.mark.parametrize(
    ("t", "says"),
    [(np.float64(3.0), r"t: invalid 'float64 \(\)'"), (1e300 * np.arange(N), "t, row 200: .* a time before")],
)
def test_times_that_are_none_are_refused(tmp_path, t, says):
    np.savez(tmp_path / "walk.npz", **table() | {"t": t})
    with pytest.raises(StrideTwinError, match=rf"walk\.npz: {says}"):
        read_imu_table(tmp_path / "walk.npz")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("nan", "accel_y, row 18: invalid nan: expected a finite number"),
        ("backwards", "t, row 31: invalid 0.14: .*a time after"),
        ("short", "rows: invalid 5: .*at least 20"),
        ("g", "accel: .*is it in g"),
        ("gravity", "accel: .*gravity been taken out"),
        ("degrees", "gyro: .*is it in °/s"),
        ("milliseconds", "t: .*milliseconds"),
    ],
)
@pytest.mark.parametrize("form", ["npz", "csv"])
def test_what_cannot_be_is_refused(tmp_path, name, says, form):
    path = tmp_path / f"walk.{form}"
    if form == "npz":
        np.savez(path, **broken(name))
    else:
        write_csv(path, broken(name))
    with pytest.raises(StrideTwinError, match=rf"walk\.{form}: {says}"):
        read_imu_table(path)


def test_missing_columns_and_no_tables(tmp_path):
    np.savez(tmp_path / "a.npz", t=np.arange(9.0), accel=np.zeros((9, 3)))
    with pytest.raises(StrideTwinError, match=r"a\.npz: gyro: invalid None: .*the table has t, accel"):
        read_imu_table(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz", t=np.arange(9.0), accel=np.zeros((9, 2)), gyro=np.zeros((9, 3)))
    with pytest.raises(StrideTwinError, match=r"accel: invalid 'float64 \(9, 2\)': .*\(9, 3\)"):
        read_imu_table(tmp_path / "a.npz")
    write_csv(tmp_path / "a.csv", table(), "t,ax,ay,az,gx,gy,spin")
    with pytest.raises(StrideTwinError, match=r"gyro_z: invalid None: .*gyro_z or gz or wz; the table has t, ax"):
        read_imu_table(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text(f"{HEADER}\n0,1,2,x,4,5,6\n")
    with pytest.raises(StrideTwinError, match=r"b\.csv: accel_z, row 1: invalid 'x': expected a number"):
        read_imu_table(tmp_path / "b.csv")
    for name in ("no.npz", "no.csv", "no.txt"):
        with pytest.raises(StrideTwinError, match=name):
            read_imu_table(tmp_path / name)
    (tmp_path / "junk.npz").write_bytes(b"junk")
    with pytest.raises(StrideTwinError, match=r"junk\.npz: cannot be read"):
        read_imu_table(tmp_path / "junk.npz")


@given(
    start=st.integers(0, 2 * 10**18),
    steps=st.lists(st.integers(1, 10**10), min_size=1, max_size=9),
    seed=st.integers(0, 9),
)
def test_tum_round_trip(tmp_path_factory, start, steps, seed):
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(len(steps), 4))
    path = Trajectory(
        t_ns=start + np.cumsum(np.array(steps, np.int64)),
        p_frame_in_world=rng.normal(0, 50, (len(steps), 3)),
        q_world_frame=q / np.linalg.norm(q, axis=1, keepdims=True),
    )
    file = tmp_path_factory.mktemp("tum") / "a.tum"
    write_tum(path, file)
    back = read_tum(file)
    np.testing.assert_array_equal(back.t_ns, path.t_ns)
    np.testing.assert_allclose(back.p_frame_in_world, path.p_frame_in_world, rtol=1e-8)
    np.testing.assert_allclose(back.q_world_frame, path.q_world_frame, atol=1e-8)
    assert len(file.read_text().splitlines()) == len(path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no pose"),
        ("# t x\n1 2 3\n", r"line 2: .*8 numbers"),
        ("0 0 0 0 0 0 0 1\n0 0 1 0 0 0 0 1\n", "line 2, t: invalid '0': .*a time after"),
        ("0 0 zero 0 0 0 0 1\n", "line 1, y: invalid 'zero': .*finite"),
        ("0 0 nan 0 0 0 0 1\n", "line 1, y: invalid 'nan': .*finite"),
        ("0 0 1e200 0 0 0 0 1\n", "line 1, y: invalid '1e200': .*finite"),
        ("0 0 0 0 0 0 0 0\n", "line 1, qx qy qz qw: .*unit quaternion"),
    ],
)
def test_tum_errors(tmp_path, text, says):
    (tmp_path / "a.tum").write_text(text)
    with pytest.raises(StrideTwinError, match=rf"a\.tum: {says}"):
        read_tum(tmp_path / "a.tum")


def test_trajectory_checks_its_shapes():
    with pytest.raises(StrideTwinError, match=r"q_world_frame: invalid shape \(2, 3\): .*\(2, 4\)"):
        Trajectory(t_ns=np.arange(2), p_frame_in_world=np.zeros((2, 3)), q_world_frame=np.zeros((2, 3)))
    with pytest.raises(StrideTwinError, match="increase"):
        Trajectory(t_ns=np.zeros(2, int), p_frame_in_world=np.zeros((2, 3)), q_world_frame=np.ones((2, 4)))
