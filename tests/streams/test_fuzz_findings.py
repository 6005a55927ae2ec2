"""Inputs at which the fuzzer found a traceback, a slow reader or a text of several lines; each stands for its kind."""

import contextlib
import math
import re
import sqlite3
import struct
import time
import warnings

import cv2
import numpy as np
import pytest
from foreign_tables import rows, save
from logger_files import DEG, FORCE, GYRO, N, T, opensense
from mcap.writer import CompressionType, Writer
from rigs import small_rig
from robot_files import IMAGE_TYPE, IMU_TYPE, INFO_TYPE, STORE, grey_message, info_message, still_imu, write_bag
from rosbags import rosbag2
from scan_files import stray_scanner

from benchmarks.foreign_files import Walk, write_rosbag1
from stridetwin.scenarios.check import check_recording, check_table
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.opening import open_any
from stridetwin.streams.formats.trajectory_file import read_trajectory
from stridetwin.streams.kalibr import read_rig, rig_to_yaml
from stridetwin.streams.motion_consistency import find_motion_fault
from stridetwin.streams.rate_consistency import find_rate_fault
from stridetwin.streams.recording.index import Problem
from stridetwin.streams.recording.mcap_writer import MAGIC
from stridetwin.streams.recording.reader import Recording

MCAP = rosbag2.StoragePlugin.MCAP
UNITS = "ax (m/s^2),ay (m/s^2),az (m/s^2),gx (rad/s),gy (rad/s),gz (rad/s)"


def dot_table(folder, ticks):
    """A table of an Xsens DOT with decimal commas and the given ticks."""
    names = "SampleTimeFine;Acc_X;Acc_Y;Acc_Z;Gyr_X;Gyr_Y;Gyr_Z"
    body = [";".join([tick, *(f"{v:.6f}" for v in (*f, *w))]) for tick, f, w in zip(ticks, FORCE, GYRO / DEG)]
    return save(folder / "a.csv", names, [row.replace(".", ",") for row in body])


def test_ticks_with_decimal_commas(tmp_path):
    recording = open_any(dot_table(tmp_path, [f"{1e6 * t:.1f}" for t in T]))
    imu = recording.block("/foot_l/imu")
    assert len(imu) == N
    np.testing.assert_allclose(np.diff(imu.t_ns), 10_000_000)


@pytest.mark.parametrize("place", [0, 5])
def test_a_tick_beyond_the_range_of_numbers_is_refused_in_one_line(tmp_path, place):
    ticks = [f"{10_000 * k}" for k in range(N)]
    ticks[place] = "9" * 400
    with pytest.raises(StrideTwinError, match=r"a\.csv: SampleTimeFine, row \d+: invalid inf: expected a count"):
        open_any(dot_table(tmp_path, ticks))


@pytest.mark.parametrize("second", ["²", "9" * 5000, "-1"])
def test_a_part_of_a_second_that_is_no_count(tmp_path, second):
    body = [f"{k // 60},{16_000_000 * (k % 60)},0.1,0.2,9.8,{0.01 * (k % 7)},0,0" for k in range(N)]
    body[7] = f"0,{second},0.1,0.2,9.8,0,0,0"
    table = save(tmp_path / "a.csv", f"stamp.sec,stamp.nanosec,{UNITS}", body)
    assert not any("\n" in text for text in read_texts(table))


def test_a_number_of_a_row_that_is_no_count(tmp_path):
    body = [f"{k},{0.01 * k},0.1,0.2,9.8,0,0,0" for k in range(N)]
    body[3] = "²" + body[3][1:]
    assert len(read_texts(save(tmp_path / "a.csv", f"t,{UNITS}", body))) == 1


@pytest.mark.parametrize("cell", ["1e308", "-1e300", "9" * 400])
@pytest.mark.parametrize("column", range(7))
def test_a_number_beyond_all_sensors_is_refused(tmp_path, cell, column):
    body = rows(T, FORCE, GYRO)
    cells = body[30].split(",")
    cells[column] = cell
    body[30] = ",".join(cells)
    table = save(tmp_path / "a.csv", f"t,{UNITS}", body)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (text,) = read_texts(table)
    assert re.search(r"a\.csv: \w+, row 3[12]: invalid \S+: expected", text)


def test_stamps_beyond_the_range_of_numbers_are_refused(tmp_path):
    body = [",".join(["9" * 400, *row.split(",")[1:]]) for row in rows(T, FORCE, GYRO)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (text,) = read_texts(save(tmp_path / "a.csv", f"t,{UNITS}", body))
    assert "a.csv: t, row 1: invalid inf: expected a finite number" in text


LONG = 16_000
"""Characters of a line, near the most that a table may have."""


@pytest.mark.parametrize("cell", ["9" * LONG + "x", "9." * (LONG // 2), "\t" * LONG, "(" * LONG, " (" * (LONG // 2)])
@pytest.mark.parametrize("line", [0, 1, 4])
def test_long_cells_take_no_longer_than_others(tmp_path, cell, line):
    body = [f"t,{UNITS}", *rows(T, FORCE, GYRO)]
    body[line] = cell + body[line]
    start_s = time.process_time()
    read_texts(save(tmp_path / "a.csv", "", body))
    assert time.process_time() - start_s < 1.0


@pytest.mark.parametrize("line", ["sampl" * (LONG // 5), "data rate " * (LONG // 10), "rate(" * (LONG // 5)])
def test_long_lines_above_the_numbers_take_no_longer_than_others(tmp_path, line):
    head = "\n".join([line] * 30)
    start_s = time.process_time()
    assert read_texts(save(tmp_path / "a.csv", f"{head}\nt,{UNITS}", rows(T, FORCE, GYRO)))
    assert time.process_time() - start_s < 1.0


def test_blank_lines_of_a_calibration_take_no_time(tmp_path):
    (tmp_path / "rig.yaml").write_text("\n" * 500_000 + "cam0: 1\n")
    start_s = time.process_time()
    with pytest.raises(StrideTwinError):
        read_rig(tmp_path / "rig.yaml")
    assert time.process_time() - start_s < 2.0


@pytest.mark.parametrize("mark", ["\x1b[2J", "\x85", "\u2028", "\r"])
def test_marks_in_texts_of_a_file_are_escaped_in_messages(tmp_path, mark):
    names = UNITS.replace("ay", f"a{mark}b")
    texts = read_texts(save(tmp_path / "a.csv", f"t,{names}", rows(T, FORCE, GYRO)))
    calibration = tmp_path / "rig.yaml"
    calibration.write_text(rig_to_yaml(small_rig()) + f'"{ascii(mark + "a")[1:-1]}": 1\n')
    read_rig(calibration, warn=texts.append)
    texts += [str(error) for error in (StrideTwinError(mark), ConfigError("a", mark, mark, mark))]
    assert len(texts) > 3
    assert all(text.isprintable() for text in [*texts, str(Problem("/a", 0, mark))])


@pytest.mark.parametrize(
    ("color", "missing"),
    [((0, 1, 999_999_998), (999_999_996, 2)), ((0, 1, 2), (999_999_996, 3)), ((5, 999_999_998), (999_999_997, 0))],
)
def test_numbers_of_frames_far_apart_take_no_time(tmp_path, color, missing):
    for frame in (0, 1, 2, 999_999_998):
        (tmp_path / f"frame-{frame:06d}.pose.txt").write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    for frame in color:
        cv2.imwrite(str(tmp_path / f"frame-{frame:06d}.color.png"), np.zeros((2, 2), np.uint8))
    start_s = time.process_time()
    texts = read_texts(tmp_path, lenient=True)
    assert time.process_time() - start_s < 1.0
    assert f"color: {missing[0]} frames are missing, the first of them frame-{missing[1]:06d}" in texts


def test_long_texts_of_a_file_are_cut_in_the_middle_of_messages(tmp_path):
    keys = "".join(f"an_unused_key_{i}: 1\n" for i in range(2000))
    (tmp_path / "rig.yaml").write_text(rig_to_yaml(small_rig()) + keys)
    texts: list[str] = []
    read_rig(tmp_path / "rig.yaml", warn=texts.append)
    texts.append(str(ConfigError("a.csv", "x" * 9000, 1, "a name")))
    assert texts[0].endswith("an_unused_key_1999")
    assert texts[-1].endswith("invalid 1: expected a name")
    assert len(texts[-1]) < 3100 > len(texts[0])


def test_two_sensors_of_one_name(tmp_path):
    for file in opensense(tmp_path).iterdir():
        file.write_text(file.read_text().replace("calcn_r_imu", "calcn_l_imu"))
    (text,) = read_texts(tmp_path)
    assert text.endswith(
        "names of the sensors: invalid 'time calcn_l_imu calcn_l_imu': expected another name for each sensor"
    )


def test_numbers_of_a_bag_beyond_all_sensors_are_a_problem(tmp_path):
    messages = still_imu()
    messages[20][1].linear_acceleration.x = 1e300
    bag = write_bag(tmp_path / "bag", {"/foot_l/imu": (IMU_TYPE, messages)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (text, *_) = read_texts(bag)
        assert "/foot_l/imu at 1700000000.200000 s: a number beyond 1e+12" in text
        assert len(open_any(bag, lenient=True).block("/foot_l/imu")) == len(messages) - 1


def test_topics_and_types_of_a_bag_with_marks_are_escaped(tmp_path):
    file = tmp_path / "a.mcap"
    messages = [(t, bytes(STORE.serialize_cdr(message, IMU_TYPE))) for t, message in still_imu()]
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        names = ((IMU_TYPE, "/a\x1bimu", "cdr"), ("std_msgs/msg/Str\x1bing", "/b\x01", "cdr"), ("x", "/c", "js\0on"))
        for name, topic, encoding in names:
            channel = writer.register_channel(topic, encoding, writer.register_schema(name, "ros2msg", b""))
            for t, data in messages:
                writer.add_message(channel, log_time=t, publish_time=t, data=data)
        writer.finish()
    recording = open_any(file)
    assert all(topic.isprintable() for topic in recording.topics)
    assert len(list(recording.samples())) == len(messages)
    assert set(recording.unread) == {r"/b\x01", "/c"}
    assert all(text.isprintable() for text in [*recording.unread.values(), *check_table(check_recording(recording))])


def test_messages_of_a_channel_without_a_definition_are_left_out(tmp_path):
    messages = [(t, bytes(STORE.serialize_cdr(message, IMU_TYPE))) for t, message in still_imu()]
    file = tmp_path / "a.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, enable_crcs=False)
        writer.start()
        schema = writer.register_schema(IMU_TYPE, "ros2msg", STORE.generate_msgdef(IMU_TYPE, ros_version=2)[0].encode())
        for topic in ("/a", "/b"):
            channel = writer.register_channel(topic, "cdr", schema)
            for t, data in messages:
                writer.add_message(channel, log_time=t, publish_time=t, data=data)
        writer.finish()
    name = struct.pack("<I", 2) + b"/b"
    data = file.read_bytes().replace(struct.pack("<HH", channel, schema) + name, struct.pack("<HH", 7, schema) + name)
    file.write_bytes(data)
    for recording in (Recording(file, lenient=True), open_any(file, lenient=True)):
        assert len(list(recording.samples())) == len(messages)


def test_a_camera_whose_topic_has_no_slash(tmp_path):
    images = [(t, grey_message(t)) for t, _ in still_imu(count=12)]
    streams = {
        "camera/image": (IMAGE_TYPE, images),
        "camera/camera_info": (INFO_TYPE, [(t, info_message(t, 30.0)) for t, _ in images[:1]]),
        "/imu": (IMU_TYPE, still_imu()),
    }
    recording = open_any(write_bag(tmp_path / "bag", streams), lenient=True)
    assert len(recording.rig.cameras) == 1


def test_a_position_beyond_all_rooms_is_left_out(tmp_path):
    walk = Walk()
    walk.p[20] = 1e300
    bag = write_rosbag1(tmp_path, walk)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (text, *_) = read_texts(bag)
        truth = open_any(bag, lenient=True).block("/truth/head/odometry")
    assert "a number beyond 1e+12" in text
    assert len(truth) == len(walk.p) - 1
    assert np.abs(truth.columns["v_frame_in_world"]).max() < 10.0


@pytest.mark.parametrize("entry", ["timestamp = 'text'", "timestamp = 0.5", "data = 'text'", f"data = {10**11}"])
def test_a_database_whose_entries_are_of_other_types(tmp_path, entry):
    bag = write_bag(tmp_path / "bag", {"/imu": (IMU_TYPE, still_imu())})
    (file,) = bag.glob("*.db3")
    with contextlib.closing(sqlite3.connect(file)) as database:
        database.execute(f"UPDATE messages SET {entry} WHERE id = 20")
        database.commit()
    (text,) = read_texts(bag)
    assert "/imu: a message at" in text
    assert len(open_any(bag, lenient=True).block("/head/imu")) == len(still_imu())  # the gap is bridged


def test_a_database_whose_names_names_are_no_text(tmp_path):
    bag = write_bag(tmp_path / "bag", {"/imu": (IMU_TYPE, still_imu())})
    (file,) = bag.glob("*.db3")
    file.write_bytes(file.read_bytes().replace(b"CREATE TABLE", b"CREATE TABL\xff"))
    texts = read_texts(bag)
    assert len(texts) == 1
    assert texts[0].isprintable()


def test_a_scan_of_depth_images_alone_is_checked(tmp_path):
    check = check_recording(open_any(stray_scanner(tmp_path, video=False)))
    assert any("depth images alone do not show how it turns" in finding.what for finding in check.findings)


def test_a_scan_without_video_whose_centre_is_the_corner(tmp_path):
    scan = stray_scanner(tmp_path, video=False)
    (scan / "camera_matrix.csv").write_text("300.0, 0.0, 0.2\n0.0, 300.0, 40.0\n0.0, 0.0, 1.0\n")
    (text,) = read_texts(scan, lenient=True)
    assert "camera_matrix.csv: centre in pixels: invalid [0.2, 40.0]: expected two positive numbers" in text


def read_texts(source, lenient=False):
    """What a user reads about a source: its error, or its warnings and problems."""
    try:
        recording = open_any(source, lenient)
        for _ in recording.samples():
            pass
    except StrideTwinError as error:
        return [str(error)]
    return [*recording.warnings, *map(str, recording.problems)]


def write_mcap(file, *records):
    """An MCAP file of records (opcode, body) between a header and the records of its end."""
    ends = ((15, bytes(4)), (2, bytes(20))) if records[-1][0] != 15 else ((2, bytes(20)),)
    parts = [struct.pack("<BQ", opcode, len(body)) + body for opcode, body in ((1, bytes(8)), *records, *ends)]
    file.write_bytes(MAGIC + b"".join(parts) + MAGIC)
    return file


@pytest.mark.parametrize(
    "record",
    [
        (6, struct.pack("<QQQII", 0, 0, 0, 0, 0) + b"\xff" * 8),  # a chunk with a length beyond the address space
        (9, struct.pack("<QQI", 0, 0, 0) + bytes(4) + b"\xff" * 8),  # an attachment
        (15, b""),  # an end of the data without its CRC
        (15, bytes(9)),
    ],
    ids=["chunk", "attachment", "empty end", "long end"],
)
@pytest.mark.parametrize("lenient", [False, True])
def test_lengths_of_mcap_records_that_cannot_be(tmp_path, record, lenient):
    texts = read_texts(write_mcap(tmp_path / "a.mcap", record), lenient)
    assert texts
    assert not any("\n" in text for text in texts)


def test_a_long_table_of_forces_without_a_measurement(tmp_path):
    lines = []
    for k in range(40):
        name, unit, size = ("acc", "g", 0.0) if k % 2 else ("gyr", "deg/s", 10.0)
        lines += [f"{10 * k}|{name}_{axis}|{size * math.sin(k + i)}|{unit}\n" for i, axis in enumerate("xyz")]
    file = tmp_path / "log.csv"
    file.write_text("time [ms]|signal|value|unit\n" + "".join(lines))
    assert len(read_texts(file)) == 1


def test_names_of_columns_without_a_row(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z")
    assert read_texts(file) == [f"{file}: rows: invalid 0: expected rows of numbers below the names of the columns"]


def test_a_table_of_gravity_that_is_none(tmp_path):
    (tmp_path / "Accelerometer.csv").write_text("time,seconds_elapsed,z,y,x")
    frames = "".join(f'Depth,0,{k},"{1000010 + k}.000",3.000\n' for k in range(3))
    head = "Configuration:\nStream Type,Stream Name,Format,FPS,Width,Height\nDepth 0,Depth,Z16,30,640,480\n\n"
    (tmp_path / "Gravity.csv").write_text(f"{head}Stream Type,Index,F#,HW Timestamp (ms),Host Timestamp(ms)\n{frames}")
    assert len(read_texts(tmp_path)) == 1


def test_samples_before_and_after_a_month_are_checked_at_once():
    t_ns = np.concatenate([np.arange(600), np.arange(600) + 30 * 86400 * 100]) * 10_000_000
    rng = np.random.default_rng(0)
    force, rate = rng.normal(0.0, 3.0, (1200, 3)) + [0.0, 0.0, 9.8], rng.normal(0.0, 1.0, (1200, 3))
    start_s = time.process_time()
    find_motion_fault(t_ns, force, rate)
    find_rate_fault(t_ns, force, rate)
    assert time.process_time() - start_s < 2.0  # a grid over the month takes a minute and gigabytes


@pytest.mark.parametrize(
    "text",
    [
        ' Intrinsic of "Color" / 640x480 / {RGB8}\n  Width: 1e999\n  Height: 9\n  PPX: 9\n  PPY: 9\n  Fx: 9\n  Fy: 9\n',
        "relative_config_imu:  ~\n\n Hz",
    ],
)
def test_calibrations_with_numbers_and_names_that_cannot_be(tmp_path, text):
    file = tmp_path / "rig.yaml"
    file.write_text(text)
    with pytest.raises(StrideTwinError) as error:
        read_rig(file)
    assert all(line.startswith(str(file)) for line in str(error.value).split("\n"))


def test_a_topic_of_several_lines_is_one(tmp_path):
    document = rig_to_yaml(small_rig()).replace("rostopic: /head/color", "rostopic: /head/color\n\n    - 1")
    file = tmp_path / "rig.yaml"
    file.write_text(document)
    assert "/head/color - 1" in read_rig(file).cameras


@pytest.mark.parametrize(
    "text",
    [
        "\u2028",
        "14036365790000000009223372036854779807\t0\t0\t0\t1\t0\t0\t0\t0.25\t.nan\t ty\t\n" * 2,
        "1" + "0" * 400 + " 0 0 0 1 0 0 0 0 0\n" + "1" + "0" * 400 + " 0 0 0 1 0 0 0 0 0\n",
        "//qx,qy,qz,qw,pos_x,pos_y,pos_z,time\nqx, nan,qz,qw,pos_x, [,po, ;",
    ],
)
def test_rows_of_a_trajectory_that_are_none(tmp_path, text):
    file = tmp_path / "path.csv"
    file.write_text(text)
    with pytest.raises(StrideTwinError) as error:
        read_trajectory(file)
    assert str(file) in str(error.value)


def test_a_definition_of_an_image_without_one_of_its_fields(tmp_path):
    messages = [(1_600_000_000_000_000_000 + k * 10**8, grey_message(k)) for k in range(3)]
    bag = write_bag(tmp_path / "bag", {"/camera": (IMAGE_TYPE, messages), "/imu": (IMU_TYPE, still_imu())}, MCAP)
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes().replace(b"uint8 is_bigendian", b"uint8 is_bogendian"))
    assert not any("\n" in text for text in read_texts(bag, lenient=True))
