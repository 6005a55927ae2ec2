"""Tables of makers and spreadsheets: each gives the samples that were put in, or one line that says what to do."""

from __future__ import annotations

import numpy as np
import pytest
from foreign_tables import BODY, NAMES, rows, save
from logger_files import DEG, FORCE, FORCE_R, GYRO, GYRO_R, G, N, T
from maker_tables import BOTH_FEET, ODD, UNITS_SI, clock, metamotion_late, text_rows
from scipy.signal import butter, filtfilt
from table_reading import assert_refused, assert_samples, read

from stridetwin.streams.formats.imu_columns import parse_mapping
from stridetwin.streams.formats.imu_units import factor_of
from tests.streams.foot_imu import simulate_foot

LONG = "ax={0}[{1}],ay={2}[{1}],az={3}[{1}],gx={0}[{4}],gy={2}[{4}],gz={3}[{4}]"


def assert_rounded(block, force=FORCE, gyro=GYRO):
    assert_samples(block, force, gyro, step_atol_ns=30_000, atol=1e-5)  # makers round stamps and numbers


@pytest.mark.parametrize("name", ODD)
def test_a_table_needs_no_options(tmp_path, name):
    _, block = read(ODD[name](tmp_path))
    if name != "one signal with two clocks":
        assert_rounded(block)
        return
    t = (block.t_ns - block.t_ns[0]) * 1e-9  # since 0.2 s
    np.testing.assert_allclose(block.columns["angular_rate"], GYRO[np.rint(100 * t).astype(int)], atol=1e-5)
    np.testing.assert_allclose(block.columns["specific_force"], FORCE[np.rint(100 * t).astype(int) + 20], atol=1e-5)


@pytest.mark.parametrize("name", BOTH_FEET)
def test_both_feet_need_no_options(tmp_path, name):
    path = BOTH_FEET[name](tmp_path)
    assert_rounded(read(path)[1])
    assert_rounded(read(path, "/foot_r/imu")[1], FORCE_R, GYRO_R)


def test_sensors_with_numbers_keep_them(tmp_path):
    names = [f"{q}{a}{k}" for k in (1, 2) for q in "ag" for a in "xyz"]
    path = save(tmp_path / "a.csv", ",".join(["t", *names]), rows(T, FORCE, GYRO, FORCE_R, GYRO_R))
    assert_rounded(read(path, "/imu_1/imu")[1])
    assert_rounded(read(path, "/imu_2/imu")[1], FORCE_R, GYRO_R)


def test_each_foot_may_have_its_stamps(tmp_path):
    names = [f"{s}_{q}_{a}" for s in "LR" for q in ("time", "acc", "gyr") for a in ("xyz" if q != "time" else " ")]
    head = ",".join(name.replace("time_ ", "time (s)") for name in names)
    path = save(
        tmp_path / "a.csv", head.replace("acc_x", "acc_x (m/s^2)"), rows(T, FORCE, GYRO, T + 0.5, FORCE_R, GYRO_R)
    )
    assert_refused(path, "unit of")
    head = ",".join(f"{n} (m/s^2)" if "acc" in n else f"{n} (rad/s)" if "gyr" in n else n for n in head.split(","))
    recording, right = read(save(path, head, rows(T, FORCE, GYRO, T + 0.5, FORCE_R, GYRO_R)), "/foot_r/imu")
    assert_rounded(right, FORCE_R, GYRO_R)
    assert right.t_ns[0] - recording.block("/foot_l/imu").t_ns[0] == 500_000_000


def test_pairs_of_stamps_and_values(tmp_path):
    t = np.arange(6 * N) / 600.0
    names = ["X[s]", "EMG 1 [V]"] + [
        name
        for q, u in (("ACC", "g"), ("GYRO", "deg/s"))
        for a in "XYZ"
        for name in ("X[s]", f"Avanti 1: {q}.{a} [{u}]")
    ]
    pairs = rows(*(column for values in (*(FORCE / G).T, *(GYRO / DEG).T) for column in (T, values)))
    pairs += ["," * 11] * (5 * N)
    body = [f"{a},{b}" for a, b in zip(rows(t, t), pairs, strict=True)]
    assert_rounded(read(save(tmp_path / "a.csv", ",".join(names), body))[1])


def test_tables_that_begin_at_different_times_have_the_epoch_in_common(tmp_path):
    _, block = read(metamotion_late(tmp_path))
    assert_rounded(block, FORCE[20:], GYRO[20:])


@pytest.mark.parametrize("size", [2**8, 2**16, 2**32, 100, 1000, 10_000, 60_000, 2**12, 2**15])
def test_a_counter_begins_again_after_any_usual_number(tmp_path, size):
    kept = np.arange(N) % 10 != 3
    counts = ((size - 42 + np.arange(N)) % size)[kept]
    body = rows(counts, FORCE[kept], GYRO[kept])
    _, block = read(save(tmp_path / "a.csv", UNITS_SI.replace("Time (s)", "sample_number"), body), rate_hz=100.0)
    np.testing.assert_allclose(block.t_ns, 1e9 * T, atol=2)


def test_late_rows_and_sessions_are_refused(tmp_path):
    body = list(BODY)
    body[50], body[51] = body[51], body[50]
    assert_refused(save(tmp_path / "a.csv", UNITS_SI, body), r"row 52\b.*stamps go back 1 times: sort the rows")
    says = r"row 81\b.*: invalid 0\.0: .*did the recording begin again, .*Cut the file"
    assert_refused(save(tmp_path / "b.csv", UNITS_SI, [*BODY[:80], UNITS_SI, *BODY]), says)
    assert_refused(
        save(tmp_path / "c.csv", UNITS_SI, BODY[:80] + BODY[50:]), r"row 81\b.*sort the rows by their stamps"
    )


def test_packets_that_come_with_delays_are_even(tmp_path):
    packets = np.arange(N) // 8
    delays = np.random.default_rng(2).uniform(0.0, 0.02, packets.max() + 1)
    _, block = read(save(tmp_path / "a.csv", UNITS_SI, rows(0.08 * packets + delays[packets], FORCE, GYRO)))
    np.testing.assert_allclose(np.diff(block.t_ns), 10_000_000, rtol=0.03)


def test_lines_that_are_no_samples_are_reported(tmp_path):
    recording, _ = read(ODD["marks of the operator"](tmp_path))
    assert any("2 lines among the numbers are no samples and left out: MARK, button" in w for w in recording.warnings)
    recording, block = read(save(tmp_path / "b.csv", UNITS_SI, [*BODY, BODY[-1][:30]]))
    assert_rounded(block)
    assert any("b.csv: the last row is cut off, and left out" in w for w in recording.warnings)
    assert_refused(
        save(tmp_path / "c.csv", UNITS_SI, [*BODY[:50], BODY[50][:30], *BODY[51:]]), r"c\.csv: .*row 51: .*a number"
    )
    assert_refused(
        save(tmp_path / "d.csv", UNITS_SI, [x for row in BODY for x in (row, "busy")]), "lines that are no samples"
    )


def test_cells_without_a_measurement(tmp_path):
    body = list(BODY)
    for k, text in enumerate(("#N/A", "#VALUE!", "#DIV/0!", "NaN", "")):
        cells = body[20 * k + 10].split(",")
        cells[4:7] = [text] * 3
        body[20 * k + 10] = ",".join(cells)
    recording, block = read(save(tmp_path / "a.csv", UNITS_SI, body))
    assert any("5 of 120 rows have no rates" in w for w in recording.warnings)
    kept = np.arange(N) % 20 != 10
    np.testing.assert_allclose(block.columns["angular_rate"][kept], GYRO[kept], atol=1e-6)


def test_one_axis_of_zeros_in_every_second_row(tmp_path):
    t, force, gyro = simulate_foot()
    force[1::2, 2] = 0.0
    recording, block = read(save(tmp_path / "a.csv", NAMES, rows(t, force, gyro)))
    assert any("rows have no forces" in w for w in recording.warnings)
    assert np.median(np.linalg.norm(block.columns["specific_force"][:150], axis=1)) == pytest.approx(9.81, abs=0.05)


def test_lost_packets_are_known_by_a_counter_of_any_name(tmp_path):
    kept = np.arange(N) % 10 != 3
    for name in ("No.", "ID", "n", "#", "pkt_cnt", "Index"):
        body = rows((7 + np.arange(N))[kept], FORCE[kept], GYRO[kept])
        _, block = read(save(tmp_path / "a.csv", UNITS_SI.replace("Time (s)", name), body), rate_hz=100.0)
        np.testing.assert_allclose(block.t_ns, 1e9 * T, atol=2)


def test_rates_that_never_change_and_rates_that_are_filtered(tmp_path):
    t, force, gyro = simulate_foot()
    assert_refused(
        save(tmp_path / "a.csv", NAMES, rows(t, force, 0 * gyro)), "gyro: invalid 'the same rates in all rows'"
    )
    smooth = filtfilt(*butter(2, 2 / 50), gyro, axis=0)
    recording, _ = read(save(tmp_path / "b.csv", NAMES, rows(t, force, smooth)))
    assert any("of the forces over from one rest to the next, much more than usual" in w for w in recording.warnings)


@pytest.mark.parametrize("both", [True, False])
def test_a_sensor_that_stood_still_is_reported(tmp_path, both):
    t, force, gyro = simulate_foot()
    gyro[640:690] = gyro[640]
    force[640:690] = force[640] if both else force[640:690]
    recording, block = read(save(tmp_path / "a.csv", NAMES, rows(t, force, gyro)))
    assert any("49 of 1721 rows repeat the same rates for long" in w for w in recording.warnings)
    assert np.diff(block.t_ns).max() == pytest.approx(0.5e9)


def test_single_rows_that_repeat_are_left_out(tmp_path):
    t, force, gyro = simulate_foot()
    at = np.arange(len(t))
    repeated = np.random.default_rng(3).choice(at[2:], len(t) // 10, replace=False)
    at[repeated] -= 1
    recording, _ = read(save(tmp_path / "a.csv", NAMES, rows(t, force, gyro[at])))
    assert any("rows repeat the rates of the row before" in w for w in recording.warnings)


def test_times_of_day_as_numbers(tmp_path):
    numbers = np.array([float(text) for text in clock("{h:02d}{m:02d}{s:06.3f}", 43_199.5)])
    recording, block = read(
        save(tmp_path / "a.csv", f"utc_time (s),{UNITS_SI.split(',', 1)[1]}", rows(numbers, FORCE, GYRO))
    )
    assert_rounded(block)
    assert any("times of day as numbers, hhmmss" in w for w in recording.warnings)


def test_a_name_of_the_right_foot_counts_for_the_only_sensor(tmp_path):
    assert_rounded(read(save(tmp_path / "walk_right_foot.csv", UNITS_SI, BODY), "/foot_r/imu")[1])
    names = "t," + ",".join(f"right_{q}_{a}" for q in ("acc", "gyr") for a in "xyz")
    assert_rounded(read(save(tmp_path / "a.csv", names, BODY), "/foot_r/imu")[1])
    (folder := tmp_path / "b").mkdir()
    save(folder / "right_acc.csv", "Time (s),X (g),Y (g),Z (g)", rows(T, FORCE / G))
    save(folder / "right_gyro.csv", "Time (s),X (dps),Y (dps),Z (dps)", rows(T, GYRO / DEG))
    assert_rounded(read(folder, "/foot_r/imu")[1])


def test_columns_that_are_not_used_are_named(tmp_path):
    head = f"{UNITS_SI},index,Magn X (uT),q_w,Temperature (C)"
    recording, _ = read(save(tmp_path / "a.csv", head, rows(T, FORCE, GYRO, np.arange(N), T, T, T)))
    assert any("columns that are not used: Magn X (uT), q_w, Temperature (C)" in w for w in recording.warnings)
    recording, _ = read(save(tmp_path / "b.csv", UNITS_SI, BODY))
    assert not [w for w in recording.warnings if "not used" in w]


def test_raw_counts_need_their_number_per_unit(tmp_path):
    body = rows(np.arange(0, 10 * N, 10), np.rint(FORCE / G * 16384).astype(int), np.rint(GYRO / DEG * 131).astype(int))
    assert_refused(
        save(tmp_path / "a.csv", NAMES.replace("t,", "t (ms),"), body), r"raw counts\? .*--columns ax=NAME\[g\]"
    )
    names = "time_ms,AcX,AcY,AcZ,GyX,GyY,GyZ"
    assert_refused(save(tmp_path / "b.csv", names, body), r"unit of AcX: .*raw counts .*ax=AcX\[g/16384\]")
    mapping = ",".join(f"a{a}=Ac{a.upper()}[g/16384],g{a}=Gy{a.upper()}[deg/s/131]" for a in "xyz")
    _, block = read(tmp_path / "b.csv", columns=parse_mapping(f"t=time_ms,{mapping}"))
    np.testing.assert_allclose(block.columns["specific_force"], FORCE, atol=1e-3)
    np.testing.assert_allclose(block.columns["angular_rate"], GYRO, atol=1e-4)


def test_units_may_have_a_scale():
    for text, expected in (
        ("g/16384", G / 16384),
        ("0.061 mg", 0.061e-3 * G),
        ("mg*0.061", 0.061e-3 * G),
        ("1/2048 g", G / 2048),
        ("LSB", None),
        ("g/0", None),
        ("dps", None),
    ):
        assert factor_of(text, "accel") == (None if expected is None else pytest.approx(expected))
    assert factor_of("deg/s/131", "gyro") == pytest.approx(DEG / 131)


def test_a_unit_that_is_unknown_is_never_replaced(tmp_path):
    path = save(tmp_path / "a.csv", NAMES.replace("gx,gy,gz", "gx [furlong],gy [furlong],gz [furlong]"), BODY)
    assert_refused(path, r"unit of gx \[furlong\]: invalid 'furlong'")


def test_increments_are_refused(tmp_path):
    names = "PacketCounter,SampleTimeFine,dq_W,dq_X,dq_Y,dq_Z,dv[1],dv[2],dv[3]"
    assert_refused(
        save(tmp_path / "a.txt", names, rows(np.arange(N), 10_000 * np.arange(N), T, GYRO, FORCE)), "increments as dq_W"
    )


def test_readings_without_names_by_the_kind_of_their_rows(tmp_path):
    body = [
        f"{8_000_000_000 + 10_000_000 * k};{name};{x!r};{y!r};{z!r}"
        for k in range(N)
        for name, (x, y, z) in (("A", (FORCE[k] / G).tolist()), ("G", (GYRO[k] / DEG).tolist()), ("M", (0.0, 1.0, 2.0)))
    ]
    columns = parse_mapping("t=1[ns],kind=2," + LONG.format(3, "g", 4, 5, "deg/s"))
    assert_rounded(read(save(tmp_path / "a.csv", "", body), columns=columns)[1])
    named = parse_mapping("t=when[ns],kind=what," + LONG.format("v1", "g", "v2", "v3", "deg/s"))
    assert_rounded(read(save(tmp_path / "b.csv", "when;what;v1;v2;v3", body), columns=named)[1])
    wrong = [row.replace(";A;", ";one;") for row in body]
    assert_refused(
        save(tmp_path / "c.csv", "", wrong), r"--columns kind: invalid '2': expected names of sensors", columns=columns
    )


def test_columns_of_a_folder_are_those_of_each_quantity(tmp_path):
    save(tmp_path / "accelerometer.csv", "", rows(T, FORCE / G))
    save(tmp_path / "gyro.csv", "", rows(T, GYRO / DEG))
    assert_refused(tmp_path, r"accelerometer\.csv: first row: .*--columns")
    assert_rounded(read(tmp_path, columns=parse_mapping("t=1[s]," + LONG.format(2, "g", 3, 4, "deg/s")))[1])


def test_columns_of_a_folder_of_sensors(tmp_path):
    for name, force, gyro in (("left", FORCE, GYRO), ("right", FORCE_R, GYRO_R)):
        save(tmp_path / f"{name}.csv", "", text_rows(clock("2024-03-01 {h:02d}:{m:02d}:{s:06.3f}"), rows(force, gyro)))
    columns = parse_mapping("t=1,ax=2[m/s^2],ay=3[m/s^2],az=4[m/s^2],gx=5[rad/s],gy=6[rad/s],gz=7[rad/s]")
    assert_rounded(read(tmp_path, columns=columns)[1])
    assert_rounded(read(tmp_path, "/foot_r/imu", columns=columns)[1], FORCE_R, GYRO_R)


def test_a_folder_without_gravity_says_so(tmp_path):
    save(tmp_path / "Linear Acceleration.csv", "Time (s),X (m/s^2),Y (m/s^2),Z (m/s^2)", rows(T, FORCE - 9.8))
    save(tmp_path / "Gyroscope.csv", "Time (s),X (rad/s),Y (rad/s),Z (rad/s)", rows(T, GYRO))
    assert_refused(tmp_path, r"forces: invalid 'Linear Acceleration\.csv': .*with gravity")


@pytest.mark.parametrize(
    ("factors", "says"),
    [
        ((1e3, 1, 1), r"t: invalid '0\.1 Hz': .*is t in milliseconds.*--columns t=NAME\[ms\]"),
        ((1e-3, 1, 1), r"t: invalid '1e\+05 Hz': .*1000 times larger"),
        ((1, 1 / G, 1), r"accel: .*is it in g\?.*--columns ax=NAME\[g\]"),
        ((1, G, 1), r"accel: .*is it in m/s², and was taken for g"),
        ((1, 1e3, 1), r"accel: .*is it in mg or mm/s²"),
        ((1, 1670, 1), r"accel: .*raw counts"),
        ((1, 1, DEG), r"gyro: .*in rad/s, and were taken for °/s"),
        ((1, 1, 1 / DEG), r"gyro: .*in °/s"),
        ((1, 1, 1000), r"gyro: .*1000 times too large"),
        ((1, 1, 1.6), r"gyro: .*times too large, or the time between samples is .* times too long"),
        ((1, 1, 0.7), r"gyro: .*1\.4 times too small"),
        ((1.4, 1, 1), r"gyro: .*or the time between samples is 1\.4 times too long"),
        ((1, 1, 1 / 16.4), r"gyro: .*times too small"),
    ],
)
def test_a_wrong_unit_is_named(tmp_path, factors, says):
    t, force, gyro = simulate_foot()
    path = save(tmp_path / "a.csv", NAMES, rows(factors[0] * t, factors[1] * force, factors[2] * gyro))
    assert_refused(path, says)


def test_an_axis_that_never_changes_is_named(tmp_path):
    t, force, gyro = simulate_foot()
    gyro[:, 1] = 0.0
    assert_refused(save(tmp_path / "a.csv", NAMES, rows(t, force, gyro)), r"gyro: .*the rates about y never change")
