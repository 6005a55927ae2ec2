"""Tables in the forms of other programs: each gives the samples that were put in, or one line that says what to do."""

from __future__ import annotations

import re

import numpy as np
import pytest
from foreign_tables import BODY, FOREIGN, MAPPING, NAMES, rows, save
from logger_files import DEG, FORCE, FORCE_R, GYRO, GYRO_R, N, T
from table_reading import assert_refused, assert_samples, read

from stridetwin.cli.main import main
from stridetwin.streams.formats.imu_columns import parse_mapping
from stridetwin.streams.formats.tum import read_tum
from tests.streams.foot_imu import STRIDE_M, STRIDES, simulate_foot


@pytest.mark.parametrize("name", FOREIGN)
def test_a_table_needs_no_options(tmp_path, name):
    _, block = read(FOREIGN[name](tmp_path))
    assert_samples(block)


@pytest.mark.parametrize("end", ["csv", "txt", "tsv", "dat"])
@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), ("\t", ","), ("  ", ".")])
def test_columns_without_names_are_numbered(tmp_path, end, separator, decimal):
    path = save(tmp_path / f"a.{end}", "", rows(T, FORCE, GYRO, separator=separator, decimal=decimal))
    _, block = read(path, columns=parse_mapping(MAPPING))
    assert_samples(block)


def test_a_header_that_is_missing_is_named(tmp_path):
    path = save(tmp_path / "a.csv", "", BODY)
    assert_refused(
        path, r'a\.csv: first row: invalid .*header is missing and the file has 7 columns: .*--columns "t=1\[s\]'
    )
    path = save(tmp_path / "b.csv", "# a preamble, of words\nDevice,4", BODY)
    assert_refused(path, r"b\.csv: first row: .*header is missing")
    columns = parse_mapping(MAPPING.replace("gz=7", "gz=8"))
    assert_refused(path, r"--columns gz: invalid '8': expected .* or its number from 1 to 7", columns=columns)


def test_a_title_above_the_header_is_skipped_in_a_folder(tmp_path):
    stamps = np.rint(1_279_034_942 + 1e3 * T)
    for name, word, unit, values in (
        ("accelerometer_1", "acc", "m/s^2", FORCE),
        ("gyroscope_2", "ang_vel", "rad/s", GYRO),
    ):
        header = "timestamp,accuracy(more=better)," + ",".join(f"{word}_{a}[{unit}]" for a in "xyz")
        body = rows(stamps, np.full(N, 3), values)
        save(tmp_path / f"{name}.csv", f"{name},maker,2024-01-01\n{header}", body)
    _, block = read(tmp_path)
    assert_samples(block)


def test_each_file_of_a_folder_may_be_a_sensor(tmp_path):
    for name, force, gyro in (("walk_left", FORCE, GYRO), ("walk_right", FORCE_R, GYRO_R)):
        save(tmp_path / f"{name}.csv", NAMES, rows(T, force, gyro))
    for topic, force, gyro in (("/foot_l/imu", FORCE, GYRO), ("/foot_r/imu", FORCE_R, GYRO_R)):
        assert_samples(read(tmp_path, topic)[1], force, gyro)


def test_the_tag_of_a_device_names_its_side(tmp_path):
    for tag, force, gyro in (("shoe left", FORCE, GYRO), ("shoe right", FORCE_R, GYRO_R)):
        head = f"sep=,\nDeviceTag:,{tag}\nOutputRate:,100Hz\n\n{PACKETS}"
        save(tmp_path / f"DOT_{len(tag)}.csv", head, rows(np.arange(N), force, gyro / DEG))
    assert_samples(read(tmp_path)[1])
    assert_samples(read(tmp_path, "/foot_r/imu")[1], FORCE_R, GYRO_R)


@pytest.mark.parametrize("others", [("_highg", "hx_m/s/s,hy_m/s/s,hz_m/s/s"), ("_mag", "mx_uT,my_uT,mz_uT")])
def test_tables_of_other_sensors_in_a_folder_are_left_out(tmp_path, others):
    FOREIGN["Blue Trident"](tmp_path)
    end, names = others
    save(tmp_path / f"TS-00556{end}.csv", f"time_s,{names}", rows(T, FORCE))
    save(tmp_path / "notes.txt", "the second walk\nof today", [])
    assert_samples(read(tmp_path)[1])


def both_by_names(folder):
    names = ["t", *(f"{side}_{q}_{a}" for side in ("left", "right") for q in ("acc", "gyr") for a in "xyz")]
    return save(folder / "a.csv", ",".join(names), rows(T, FORCE, GYRO, FORCE_R, GYRO_R))


def both_by_a_column(folder):
    left = [f"left,{row}" for row in rows(T, FORCE, GYRO)]
    right = [f"right,{row}" for row in rows(T, FORCE_R, GYRO_R)]
    body = [row for pair in zip(left, right) for row in pair]
    return save(folder / "a.csv", f"sensor,{NAMES}", body)


def both_in_long_form(folder):
    body = []
    sources = (("left", "accelerometer", FORCE), ("left", "gyroscope", GYRO))
    sources += (("right", "accelerometer", FORCE_R), ("right", "gyroscope", GYRO_R))
    for sensor, kind, values in sources:
        body += [f"{sensor},{kind},{row}" for row in rows(T, values)]
    return save(folder / "a.csv", "location,type,t,x,y,z", body)


@pytest.mark.parametrize("write", [both_by_names, both_by_a_column, both_in_long_form])
def test_two_sensors_of_one_table(tmp_path, write):
    path = write(tmp_path)
    assert_samples(read(path, "/foot_l/imu")[1])
    assert_samples(read(path, "/foot_r/imu")[1], FORCE_R, GYRO_R)


def test_commas_for_cells_and_decimals_are_refused(tmp_path):
    path = save(tmp_path / "a.csv", NAMES, rows(T + 0.001, FORCE, GYRO, decimal=","))
    says = r"a\.csv: cells of a row: invalid 14: expected 7, .*decimals have commas"
    assert_refused(path, says)
    named = ",".join(f"{key}={key}[{u}]" for key, u in zip(NAMES.split(","), UNITS))
    assert_refused(path, says, columns=parse_mapping(named))


def test_a_row_wider_than_the_names_is_refused_or_numbered(tmp_path):
    path = save(tmp_path / "a.csv", NAMES, [f"a{k},{row}" for k, row in enumerate(BODY)])
    assert_refused(path, r"a\.csv: cells of a row: invalid 8: expected 7, as many as names .*--columns numbers")
    numbered = ",".join(f"{key}={k}[{u}]" for k, (key, u) in enumerate(zip(NAMES.split(","), UNITS), 2))
    assert_samples(read(path, columns=parse_mapping(numbered))[1])


def test_a_property_above_a_narrow_table_is_no_row(tmp_path):
    body = [f"{10 * k},{name},{v!r}" for k in range(N) for name, v in zip(AXIS_NAMES, [*FORCE[k], *(GYRO[k] / DEG)])]
    body = [line.replace("np.float64(", "").replace(")", "") for line in body]
    assert_samples(read(save(tmp_path / "a.csv", "Rate,100\nSensor,12\nt [ms],name,value", body), rate_hz=None)[1])


@pytest.mark.parametrize(("name", "says"), [("walk.xlsx", "export the table as CSV"), ("walk.zip", "unpack it")])
def test_files_that_may_have_a_table_say_what_to_do(tmp_path, name, says):
    (tmp_path / name).write_bytes(b"PK\x03\x04 and so on, for sixteen bytes")
    assert_refused(tmp_path / name, rf"{name}: \.\w+ files are not read: {says}")


def test_text_of_numbers_alone_says_how_to_number_its_columns(tmp_path):
    path = save(tmp_path / "a.txt", "", BODY)
    assert_refused(
        path, r'a\.txt: unknown content: .*needs names of its columns, or their numbers: --columns "t=1\[s\]'
    )


def test_a_file_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "a.csv").write_bytes(bytes(range(256)) * 20)
    assert_refused(tmp_path / "a.csv", r"a\.csv: is not text")


UNITS = ["s", *["m/s^2"] * 3, *["rad/s"] * 3]
AXIS_NAMES = [f"acc_{a}" for a in "xyz"] + [f"gyr_{a} [deg/s]" for a in "xyz"]
PACKETS = "PacketCounter,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z"


@pytest.mark.parametrize(("size", "per_sample"), [(2**16, 1), (2**8, 1), (2**16, 3)])
def test_a_rate_is_that_of_the_counter(tmp_path, size, per_sample):
    kept = np.arange(N) % 10 != 3
    counts = (size - 40 + per_sample * np.arange(N)) % size
    path = save(tmp_path / "a.txt", f"// DeviceId: 00000000\n{PACKETS}", rows(counts[kept], FORCE[kept], GYRO[kept]))
    assert_refused(path, r"a\.txt: t: .*without one: --rate HZ, which is then the rate of PacketCounter")
    recording, block = read(path, rate_hz=100.0)
    assert len(block) == N
    np.testing.assert_allclose(block.t_ns, 1e9 * T, atol=2)
    assert any("12 gaps of up to 20 ms are bridged by 12 samples" in w for w in recording.warnings)


def test_a_counter_that_restarts_or_counts_something_else(tmp_path):
    counts = np.concatenate([np.arange(500, 560), np.arange(60)])
    path = save(tmp_path / "a.csv", PACKETS, rows(counts, FORCE, GYRO))
    assert_refused(
        path, r"a\.csv: PacketCounter, row 61: invalid 0\.0: expected a count from 559 on; .*restart", rate_hz=100.0
    )
    counts = np.cumsum(np.random.default_rng(1).integers(1, 9, N))
    recording, block = read(save(tmp_path / "b.csv", PACKETS, rows(counts, FORCE, GYRO)), rate_hz=100.0)
    assert_samples(block)
    assert any("PacketCounter is no counter of samples" in w for w in recording.warnings)


def test_stamps_without_their_last_digits(tmp_path):
    many = np.arange(2000)
    t = many / 100.0
    force, gyro = np.resize(FORCE, (len(t), 3)), np.resize(GYRO, (len(t), 3))
    tenths = save(tmp_path / "a.csv", NAMES, rows(np.floor(10 * t + 1e-9) / 10, force, gyro))
    recording, block = read(tenths)
    np.testing.assert_allclose(block.t_ns, 1e9 * t, atol=1000)
    assert any("repeated stamps are spread" in w for w in recording.warnings)
    seconds = save(tmp_path / "b.csv", NAMES, rows(np.floor(t + 1e-9), force, gyro))
    assert_refused(
        seconds, r"IMU, t: invalid '20 different stamps in 2000 rows, up to 100 rows .*digits of the stamps lost"
    )
    _, block = read(seconds, rate_hz=100.0)
    np.testing.assert_allclose(block.t_ns, 1e9 * t, atol=2)
    single = save(tmp_path / "c.csv", NAMES, rows(np.full(2000, 1.7e9), force, gyro))
    assert_refused(single, r"c\.csv: t: .*stamps that increase; were their last digits lost\? .*--rate HZ")


def test_a_rate_that_contradicts_the_stamps_is_reported(tmp_path):
    kept = np.arange(N) % 10 != 3
    path = save(tmp_path / "a.csv", NAMES, rows(T[kept], FORCE[kept], GYRO[kept]))
    recording, block = read(path, rate_hz=100.0)
    assert len(block) == kept.sum()
    assert any("--rate counts the rows, although 12 are missing by the stamps of t" in w for w in recording.warnings)
    recording, _ = read(save(tmp_path / "b.csv", NAMES, BODY), rate_hz=80.0)
    assert any("--rate 80 replaces the stamps of t, which give 100 Hz" in w for w in recording.warnings)
    recording, _ = read(save(tmp_path / "c.csv", NAMES, BODY), rate_hz=100.0)
    assert not [w for w in recording.warnings if "--rate" in w]


def test_whole_seconds_and_their_rest_are_added(tmp_path):
    names = ["header.stamp.sec", "header.stamp.nanosec"]
    names += [f"{q}.{a}" for q in ("angular_velocity", "linear_acceleration") for a in "xyz"]
    stamps = 1_990_000_000 + 10_000_000 * np.arange(N)
    _, block = read(save(tmp_path / "a.csv", ",".join(names), rows(stamps // 10**9, stamps % 10**9, GYRO, FORCE)))
    assert_samples(block)
    assert block.t_ns[0] == 1_990_000_000


def test_a_clock_of_32_bits_begins_again(tmp_path):
    stamps = (2**32 - 400_000 + 10_000 * np.arange(N)) % 2**32
    recording, block = read(save(tmp_path / "a.csv", NAMES.replace("t,", "t (us),"), rows(stamps, FORCE, GYRO)))
    assert_samples(block)
    assert any("t (us) begins again after 2³² counts 1 times" in w for w in recording.warnings)


@pytest.mark.parametrize("unit", ["Â°/s", "\ufffd/s", "?/s", "°·s⁻¹", "deg.s-1", "DPS", "°/sec"])
def test_units_of_rates_in_other_spellings(tmp_path, unit):
    names = NAMES.replace("gx,gy,gz", ",".join(f"g{a} [{unit}]" for a in "xyz"))
    assert_samples(read(save(tmp_path / "a.csv", names, rows(T, FORCE, GYRO / DEG)))[1])


def test_units_above_the_names_and_forces_without_gravity(tmp_path):
    units = "s,m/s^2,m/s^2,m/s^2,rad/s,rad/s,rad/s"
    assert_samples(read(save(tmp_path / "a.csv", f"{units}\ntime,ax,ay,az,gx,gy,gz", BODY))[1])
    names = PACKETS.replace("Acc", "FreeAcc")
    path = save(tmp_path / "b.csv", names, rows(np.arange(N), FORCE, GYRO))
    assert_refused(path, r"b\.csv: forces: invalid 'FreeAcc_X': expected forces with gravity", rate_hz=100.0)


def test_a_lost_packet_is_bridged_and_a_late_one_spread(tmp_path):
    packets = np.arange(N) // 4
    kept = packets != 12
    stamps = 4 * packets / 100.0
    recording, block = read(save(tmp_path / "a.csv", NAMES, rows(stamps[kept], FORCE[kept], GYRO[kept])))
    np.testing.assert_allclose(block.t_ns, 1e9 * T, atol=2)
    assert any("1 gaps of up to 50 ms are bridged by 4 samples" in w for w in recording.warnings)
    late = stamps + np.where(packets % 5 == 3, 0.028, 0.0)
    recording, block = read(save(tmp_path / "b.csv", NAMES, rows(late, FORCE, GYRO)))
    assert len(block) == N
    assert not [w for w in recording.warnings if "gap" in w]


LONG_T = np.arange(600) / 100.0


def moving():
    """Forces and rates at rest, and in motion from 2 s on; noise of a sensor throughout."""
    rng = np.random.default_rng(5)
    moves = LONG_T >= 2
    rate = np.where(moves, 3.0 * np.sin(4 * (LONG_T - 2)), 0.0)  # about y, rad/s
    angle = np.where(moves, 0.75 * (1.0 - np.cos(4 * (LONG_T - 2))), 0.0)  # its integral: gravity turns with it
    none = np.zeros(600)
    force = 9.81 * np.column_stack([-np.sin(angle), none, np.cos(angle)]) + rng.normal(0, 0.03, (600, 3))
    return force, np.column_stack([none, rate, none]) + rng.normal(0, 0.003, (600, 3))


@pytest.mark.parametrize("fill", ["0", "0.0", "-999", "nan", "", "NULL"])
@pytest.mark.parametrize("quantity", ["forces", "rates"])
def test_rows_without_a_measurement_are_left_out(tmp_path, fill, quantity):
    force, gyro = moving()
    body = rows(LONG_T, force, gyro)
    for k in range(1, len(body), 2):
        cells = body[k].split(",")
        cells[1:4] = [fill] * 3 if quantity == "forces" else cells[1:4]
        cells[4:7] = [fill] * 3 if quantity == "rates" else cells[4:7]
        body[k] = ",".join(cells)
    recording, block = read(save(tmp_path / "a.csv", NAMES, body))
    assert any(re.search(rf"IMU: (299|300) of 600 rows have no {quantity}", w) for w in recording.warnings)
    at = np.searchsorted((block.t_ns * 1e-9).round(3), LONG_T[10:590])
    np.testing.assert_allclose(block.columns["angular_rate"][at], gyro[10:590], atol=0.03)
    np.testing.assert_allclose(block.columns["specific_force"][at], force[10:590], atol=0.3)


def test_a_few_rows_of_zeros_and_a_table_of_zeros(tmp_path):
    force, gyro = moving()
    gyro[250:262] = 0.0
    gyro[[70, 300, 301]] = 0.0
    recording, _ = read(save(tmp_path / "a.csv", NAMES, rows(LONG_T, force, gyro)))
    assert any("IMU: 15 of 600 rows have no rates" in w for w in recording.warnings)
    assert any("1 gaps of more than 0.1 s" in w for w in recording.warnings)
    gyro[np.arange(600) % 15 != 0] = 0.0
    path = save(tmp_path / "b.csv", NAMES, rows(LONG_T, force, gyro))
    assert_refused(path, r"IMU, gyro: invalid 'zeros.*in 5[0-9][0-9] of 600 rows'")


@pytest.mark.parametrize("rows_per_reading", [2, 4])
@pytest.mark.parametrize("quantity", ["forces", "rates"])
def test_readings_that_are_held_are_left_out(tmp_path, rows_per_reading, quantity):
    force, gyro = moving()
    at = np.arange(600) // rows_per_reading * rows_per_reading
    columns = (force[at], gyro) if quantity == "forces" else (force, gyro[at])
    recording, block = read(save(tmp_path / "a.csv", NAMES, rows(LONG_T, *columns)))
    count = 600 - 600 // rows_per_reading
    assert any(f"IMU: {count} of 600 rows repeat the {quantity} of the row before" in w for w in recording.warnings)
    at = np.searchsorted((block.t_ns * 1e-9).round(3), LONG_T[10:590])
    np.testing.assert_allclose(block.columns["angular_rate"][at], gyro[10:590], atol=0.05)


def test_zeros_of_a_sensor_at_rest_are_measured(tmp_path):
    force, gyro = moving()
    coarse = np.round(gyro / 0.0012) * 0.0012  # steps of 0.07 °/s
    coarser = np.round(gyro / 0.02) * 0.02  # most rows at rest are zeros
    exact = np.where(LONG_T[:, None] < 2, 0.0, gyro * np.minimum(1, (LONG_T[:, None] - 2) / 0.3))
    for values in (coarse, coarser, exact):
        recording, block = read(save(tmp_path / "a.csv", NAMES, rows(LONG_T, force, values)))
        assert len(block) == 600
        assert not [w for w in recording.warnings if "rows have no" in w or "repeat" in w]


def test_the_unit_of_ticks_and_rates_of_xsens(tmp_path):
    path = FOREIGN["Xsens DOT without preamble"](tmp_path)
    recording, _ = read(path)
    assert any("SampleTimeFine counts µs, as of a DOT: rates in deg/s assumed" in w for w in recording.warnings)
    body = rows(np.arange(N), 100 * np.arange(N), FORCE, GYRO)
    names = PACKETS.replace("PacketCounter", "PacketCounter,SampleTimeFine")
    assert_samples(read(save(tmp_path / "mtw.csv", names, body))[1])
    given = names.replace("Gyr_X", "Gyr_X (deg/s)").replace("Gyr_Y", "Gyr_Y (deg/s)").replace("Gyr_Z", "Gyr_Z (deg/s)")
    body = rows(np.arange(N), 100 * np.arange(N), FORCE, GYRO / DEG)
    assert_samples(read(save(tmp_path / "units.csv", given, body))[1])


def without_every_second_rate(folder):
    t, force, gyro = simulate_foot()
    gyro[1::2] = 0.0
    return save(folder / "a.csv", NAMES, rows(t, force, gyro)), []


def without_every_third_force(folder):
    t, force, gyro = simulate_foot()
    force[1::3] = 0.0
    return save(folder / "a.csv", NAMES, rows(t, force, gyro)), []


def without_every_tenth_packet(folder):
    t, force, gyro = simulate_foot()
    kept = np.arange(len(t)) % 10 != 3
    counts = (65000 + np.arange(len(t))) % 65536
    path = save(folder / "a.txt", f"// DeviceId: 0\n{PACKETS}", rows(counts[kept], force[kept], gyro[kept]))
    return path, ["--rate", "100"]


def with_stamps_of_tenths(folder):
    t, force, gyro = simulate_foot()
    return save(folder / "a.csv", NAMES, rows(np.floor(10 * t + 1e-9) / 10, force, gyro)), []


@pytest.mark.parametrize(
    "write",
    [without_every_second_rate, without_every_third_force, without_every_tenth_packet, with_stamps_of_tenths],
)
def test_the_path_of_a_walk_is_right_all_the_same(tmp_path, write, capsys):
    path, options = write(tmp_path)
    assert main(["estimate", "foot_ins", str(path), *options, "-o", str(tmp_path / "out.txt")]) == 0
    assert "warning" in capsys.readouterr().err
    estimate = read_tum(tmp_path / "out.txt")
    moved = estimate.p_frame_in_world[-1] - estimate.p_frame_in_world[0]
    assert np.linalg.norm(moved[:2]) == pytest.approx(STRIDES * STRIDE_M, abs=0.25)
    assert abs(moved[2]) < 0.15
    assert (estimate.t_ns[-1] - estimate.t_ns[0]) * 1e-9 == pytest.approx(simulate_foot()[0][-1], abs=0.05)
