"""Tables of other apps and loggers: each gives the samples that were put in, in m/s², rad/s and ns."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import numpy as np
import pytest
from logger_files import FORCE, FORCE_R, GYRO, GYRO_R, ONE, RATE_HZ, N, T, gaitmap, opensense, other, table, x_imu

from stridetwin.cli.main import main
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.imu_columns import parse_mapping
from stridetwin.streams.formats.imu_text import TableRequest
from stridetwin.streams.formats.imu_units import unit_of
from stridetwin.streams.formats.opening import ImportOptions, open_any, recognise
from stridetwin.streams.formats.tum import read_tum

DATA = Path(os.environ.get("STRIDETWIN_DATA", Path(__file__).parents[3] / "shared" / "data"))


@pytest.mark.parametrize("name", ONE)
def test_a_sensor_is_read_in_its_units(tmp_path, name):
    write, request = ONE[name]
    path = write(tmp_path)
    assert recognise(path) == "table"
    recording = open_any(path, options=ImportOptions(table=request))
    assert list(recording.topics) == ["/foot_l/imu"]
    block = recording.block("/foot_l/imu")
    np.testing.assert_allclose(block.t_ns, np.arange(N) * 10_000_000, atol=1)
    np.testing.assert_allclose(block.columns["specific_force"], FORCE, atol=1e-9)
    np.testing.assert_allclose(block.columns["angular_rate"], GYRO, atol=1e-9)
    bridged = [w for w in recording.warnings if "gap" in w or "repeated" in w]
    assert not bridged


@pytest.mark.parametrize("write", [gaitmap, opensense])
def test_both_feet_are_read_from_one_source(tmp_path, write):
    recording = open_any(write(tmp_path))
    for topic, force, gyro in (("/foot_l/imu", FORCE, GYRO), ("/foot_r/imu", FORCE_R, GYRO_R)):
        columns = recording.block(topic).columns
        np.testing.assert_allclose(columns["specific_force"], force, atol=1e-9)
        np.testing.assert_allclose(columns["angular_rate"], gyro, atol=1e-9)


def test_the_command_takes_columns_rate_and_foot(tmp_path, capsys):
    out = tmp_path / "path.txt"
    mapping = "t=clock[ms],ax=accX[mg],ay=accY[mg],az=accZ[mg],gx=p[deg/s],gy=q[deg/s],gz=r[deg/s]"
    calls = [(other, ["--columns", mapping]), (x_imu, ["--rate", "100"]), (gaitmap, ["--foot", "r"])]
    for number, (write, more) in enumerate(calls):
        (folder := tmp_path / str(number)).mkdir()
        path = write(folder)
        assert main(["estimate", "foot_ins", str(path), *more, "-o", str(out)]) == 0
        assert len(read_tum(out)) > N // 2
        rest = more if write is not gaitmap else []
        assert main(["import", str(path), *rest, "-o", str(folder / "a.mcap")]) == 0
    assert "estimate" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("write", "options", "says"),
    [
        (x_imu, {}, r"CalInertialAndMag\.csv: t: invalid None: expected a column of time; .*without one: --rate HZ"),
        (other, {}, r"logger\.csv: .*unit of accX: invalid None: expected a unit in brackets .*--columns t=Time\[ms\]"),
        (lambda f: table(f / "a.csv", "Time (s),q", T, T), {}, r"accel_x: .*the table has Time \(s\), q; .*--columns"),
        (lambda f: table(f / "acc.csv", "timestamp,x,y,z", 1e3 * T, FORCE), {}, r"acc\.csv: gyro: .*folder of both"),
        (other, {"columns": {"t": "watch[ms]"}}, r"--columns t: invalid 'watch': expected one of .*clock, accX"),
        (other, {"columns": {"t": "clock[parsec]"}}, r"--columns t, unit: invalid 'parsec': expected one of s, ms"),
        (other, {"columns": {"ax": "accX[g]"}}, r"--columns: invalid 'ax': expected also ay"),
    ],
)
def test_what_a_header_leaves_open_is_asked_for(tmp_path, write, options, says):
    with pytest.raises(StrideTwinError, match=says) as caught:
        open_any(write(tmp_path), options=ImportOptions(table=TableRequest(**options)))
    assert "\n" not in str(caught.value)


def test_forces_without_gravity_are_refused(tmp_path):
    header = "Time (s),X (m/s^2),Y (m/s^2),Z (m/s^2)"
    table(tmp_path / "Linear Accelerometer.csv", header, T, FORCE)
    table(tmp_path / "Gyroscope.csv", header.replace("m/s^2", "rad/s"), T, GYRO)
    with pytest.raises(StrideTwinError, match=r"forces: invalid 'Linear Accelerometer\.csv': .*with gravity"):
        open_any(tmp_path, options=ImportOptions(kind="table"))


def test_orientations_of_opensense_are_no_imu(tmp_path):
    path = tmp_path / "walk_orientations.sto"
    path.write_text("DataRate=100\nDataType=Quaternion\nendheader\ntime\tpelvis_imu\n0.0\t1,0,0,0\n")
    with pytest.raises(StrideTwinError, match=r"sto: DataType: invalid 'Quaternion': expected Vec3, .*no IMU"):
        open_any(path)


@pytest.mark.parametrize("text", ["t=Time", "bx=Acc[g]", "t", "ax=Acc[g],,"])
def test_a_mapping_of_another_form_is_refused(text):
    if text == "t=Time":
        assert parse_mapping(text) == {"t": "Time"}
    else:
        with pytest.raises(StrideTwinError, match=r"--columns: invalid .*: expected t, ax, ay"):
            parse_mapping(text)


def test_units_have_many_spellings():
    for text, expected in (
        ("deg/s", ("gyro", "deg/s")),
        ("°/s", ("gyro", "deg/s")),
        ("DPS", ("gyro", "deg/s")),
        ("ms", ("time", "ms")),
        ("μs", ("time", "µs")),
        ("m/s^2", ("accel", "m/s²")),
        ("m s^-2", ("accel", "m/s²")),
        ("g", ("accel", "g")),
        ("mg", ("accel", "mg")),
        ("G", None),
        ("uT", None),
        ("", None),
    ):
        assert unit_of(text) == expected


def written(path: Path, t: np.ndarray, keep: np.ndarray | slice = slice(None)) -> Path:
    header = "t,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z"
    return table(path, header, t[keep], FORCE[keep], GYRO[keep])


def test_repeated_rows_are_left_out(tmp_path):
    at = np.sort(np.append(np.arange(N), [30, 70]))
    recording = open_any(written(tmp_path / "a.csv", T, at))
    np.testing.assert_array_equal(recording.block("/foot_l/imu").columns["specific_force"], FORCE)
    assert "IMU: 2 repeated rows are left out" in recording.warnings


def test_packets_with_one_stamp_are_spread(tmp_path):
    recording = open_any(written(tmp_path / "a.csv", 4 * (np.arange(N) // 4) / RATE_HZ))
    np.testing.assert_allclose(recording.block("/foot_l/imu").t_ns, 1e9 * T, atol=2)
    assert "IMU: 90 repeated stamps are spread over the time until the next one" in recording.warnings


def test_lost_packets_and_short_gaps_are_filled_and_long_ones_reported(tmp_path):
    keep = np.ones(N, bool)
    keep[[20, 50, 51, 52]] = False
    keep[80:100] = False
    recording = open_any(written(tmp_path / "a.csv", T, keep))
    block = recording.block("/foot_l/imu")
    np.testing.assert_array_equal(block.t_ns, np.rint(1e9 * np.delete(T, slice(80, 100))).astype(np.int64))
    np.testing.assert_allclose(block.columns["angular_rate"][20], (GYRO[19] + GYRO[21]) / 2, atol=1e-12)
    np.testing.assert_allclose(block.columns["angular_rate"][51], (GYRO[49] + GYRO[53]) / 2, atol=1e-12)
    np.testing.assert_array_equal(block.columns["angular_rate"][80:], GYRO[100:])
    assert "IMU: 2 gaps of up to 40 ms are bridged by 4 samples, interpolated linearly" in recording.warnings
    assert any(
        "IMU: 1 gaps of more than 0.1 s are not bridged, the first of them 0.21 s" in w for w in recording.warnings
    )


def test_late_stamps_are_no_gaps(tmp_path):
    t = T.copy()
    t[10::7] += 0.8 / RATE_HZ  # the sample is late, not lost
    recording = open_any(written(tmp_path / "a.csv", t))
    assert len(recording.block("/foot_l/imu")) == N
    assert not any("gap" in w for w in recording.warnings)


def real(tmp_path: Path, name: str) -> Path:
    source = DATA / f"{name}.csv.gz"
    if not source.exists():
        pytest.skip(f"no {source}: set STRIDETWIN_DATA")
    path = tmp_path / f"{source.parent.name}.csv"
    path.write_bytes(gzip.decompress(source.read_bytes()))
    return path


def test_a_real_ngimu_with_repeated_rows(tmp_path):
    path = real(tmp_path, "foot_imu_other/ngimu_short_walk")
    recording = open_any(path)
    block = recording.block("/foot_l/imu")
    steps = np.diff(block.t_ns) * 1e-9
    assert steps.max() < 0.005
    assert np.median(np.linalg.norm(block.columns["specific_force"], axis=1)) == pytest.approx(9.8, abs=0.3)
    assert any("205 repeated rows are left out" in w for w in recording.warnings)
    out = tmp_path / "path.txt"
    assert main(["estimate", "foot_ins", str(path), "-o", str(out)]) == 0
    p = read_tum(out).p_frame_in_world
    assert np.linalg.norm((p[-1] - p[0])[:2]) < 0.10


def test_real_tables_of_both_feet(tmp_path):
    recording = open_any(real(tmp_path, "foot_imu_other/gaitmap_stair_up"))
    assert {"/foot_l/imu", "/foot_r/imu"} == set(recording.topics)
    assert recording.topics["/foot_l/imu"].rate_hz == pytest.approx(204.8, rel=1e-6)
    walk = real(tmp_path, "dual_foot_walk/imu_sample")
    with pytest.raises(
        StrideTwinError, match=r"column 1: invalid 'numbers of rows': expected stamps in s, or --rate HZ"
    ):
        open_any(walk)
    recording = open_any(walk, options=ImportOptions(table=TableRequest(rate_hz=204.8)))
    assert {"/foot_l/imu", "/foot_r/imu"} == set(recording.topics)
