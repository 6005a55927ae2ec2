"""Trajectories in tables of ROS tools and others: which column is the stamp, units in names, rows without a pose."""

from __future__ import annotations

import re

import numpy as np
import pytest
from foot_walk import write_rows
from scipy.spatial.transform import Rotation

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.trajectory_file import read_trajectory
from stridetwin.streams.formats.trajectory_options import TrajectoryOptions
from stridetwin.streams.recording.index import Notes

T_NS = 1_700_000_000 * 10**9 + 50_000_000 * np.arange(120)
T_S = T_NS / 1e9
P = np.column_stack([1.2 * (T_S - T_S[0]), np.sin(T_S - T_S[0]), np.full(120, 1.6)])
R = Rotation.from_euler("zyx", np.column_stack([0.3 * (T_S - T_S[0]) + 0.2, 0.1 * np.ones(120), 0.02 * np.arange(120)]))
LAST, FIRST = R.as_quat(), R.as_quat(scalar_first=True)
SPAN_NS = (int(T_NS[0]) - 10**8, int(T_NS[-1]) + 10**8)
ARRIVAL_NS = T_NS + 80_000_000
"""When the messages arrived: later than their stamps."""


def cells(*columns):
    """Rows of text from stamps, words and arrays of numbers."""
    parts = [np.asarray(column) for column in columns]
    parts = [part[:, None] if part.ndim == 1 else part for part in parts]
    return [
        [f"{v:.9f}" if isinstance(v, float) else str(v) for part in parts for v in part[i].tolist()] for i in range(120)
    ]


def seconds(t_ns):
    return [f"{t // 10**9}.{t % 10**9:09d}" for t in t_ns.tolist()]


def read(tmp_path, rows, header="", separator=",", **options):
    """The trajectory of some rows, and its warnings."""
    notes = Notes(tmp_path, lenient=False)
    file = write_rows(tmp_path / "path.txt", rows, header, separator)
    return read_trajectory(file, TrajectoryOptions(**options), span_ns=SPAN_NS, notes=notes), notes.warnings


PARTS_NS = (T_NS // 10**9, T_NS % 10**9)
POSE = "position.x,{0}position.y,{0}position.z,{0}orientation.x,{0}orientation.y,{0}orientation.z,{0}orientation.w\n"
TABLES = {
    "stamp_of_the_header": (
        cells(ARRIVAL_NS, T_NS, ["odom"] * 120, P, LAST),
        "%time,field.header.stamp,field.header.frame_id,field.pose." + POSE.format("field.pose."),
    ),
    "stamp_in_two_columns": (
        cells(seconds(ARRIVAL_NS), *PARTS_NS, P, LAST),
        "Time,header.stamp.secs,header.stamp.nsecs,pose." + POSE.format("pose."),
    ),
    "ros2_echo_of_poses": (cells(*PARTS_NS, ["map"] * 120, P, LAST), ""),
    "ros2_echo_of_odometry": (cells(*PARTS_NS, ["odom"] * 120, ["base"] * 120, P, LAST, np.zeros((120, 36))), ""),
    "millimetres_in_brackets": (
        cells(T_NS, 1e3 * P, FIRST),
        "timestamp [ns],x [mm],y [mm],z [mm],qw,qx,qy,qz\n",
    ),
    "centimetres_in_names": (cells(seconds(T_NS), 1e2 * P, LAST), "time_s,x_cm,y_cm,z_cm,qx,qy,qz,qw\n"),
    "other_words": (cells(seconds(T_NS), P, FIRST), "timestamp,pose_x,pose_y,pose_z,ori_w,ori_x,ori_y,ori_z\n"),
    "numbers_of_rows_first": (cells(np.arange(120), seconds(T_NS), P, LAST), ""),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_give_the_same_path(tmp_path, name):
    rows, header = TABLES[name]
    result, warnings = read(tmp_path, rows, header)
    assert np.abs(result.path.t_ns - T_NS).max() < 1000
    np.testing.assert_allclose(result.path.p_frame_in_world, P, atol=1e-6)
    assert np.abs(np.sum(result.path.q_world_frame * FIRST, axis=1)).min() > 1 - 1e-9
    assert warnings == []


@pytest.mark.parametrize(
    ("separator", "encoding", "comma"), [("\t", "utf-8", True), (" ", "utf-16", False), (";", "cp1252", True)]
)
def test_separators_decimal_commas_and_encodings(tmp_path, separator, encoding, comma):
    rows = cells(seconds(T_NS), P, LAST)
    text = "\r\n".join(separator.join(row) for row in rows)
    (tmp_path / "path.txt").write_text(text.replace(".", ",") if comma else text, encoding=encoding, newline="")
    path = read_trajectory(tmp_path / "path.txt", span_ns=SPAN_NS).path
    np.testing.assert_allclose(path.p_frame_in_world, P, atol=1e-6)


def test_rows_without_a_pose_and_repeated_rows_are_left_out(tmp_path):
    rows = cells(seconds(T_NS), P, LAST)
    lost = [[row[0], *["nan"] * 7] if 30 <= i < 50 else row for i, row in enumerate(rows)]
    result, (warning,) = read(tmp_path, lost, separator=" ")
    assert (len(result.path), warning) == (100, "20 of its 120 rows have no pose, and are left out")
    header = "time,other,x,y,z,qx,qy,qz,qw\n"
    between = [part for row in rows for part in ([row[0], "", *row[1:]], [row[0], "0.3", *[""] * 7])]
    assert len(read(tmp_path, between, header)[0].path) == 120
    result, (warning,) = read(tmp_path, [*rows[:40], *rows[39:]], separator=" ")
    assert (len(result.path), warning) == (120, "rows that repeat the one before are left out: 1")


@pytest.mark.parametrize(
    ("rows", "header", "says"),
    [
        (
            cells(seconds(T_NS), P, FIRST),
            "time,foo_x,foo_y,foo_z,a,b,c,d\n",
            "not known, time,foo_x,.*as t x y z qx qy",
        ),
        (cells(seconds(T_NS), 1e3 * P, LAST), "", r"move at 1\.\d+e\+03 m/s: are they in cm or mm \(--length-unit\)"),
        (cells(seconds(T_NS), P, np.tile([0.0, 0, 0, 1], (120, 1))), "", "all its attitudes are the same"),
    ],
)
def test_what_is_doubtful_is_said(tmp_path, rows, header, says):
    warnings = read(tmp_path, rows, header)[1]
    assert len(warnings) == 1
    assert re.search(says, warnings[0])


def test_the_unit_of_positions_is_an_option(tmp_path):
    result, warnings = read(tmp_path, cells(seconds(T_NS), 1e3 * P, LAST), separator=" ", length_unit="mm")
    np.testing.assert_allclose(result.path.p_frame_in_world, P, atol=1e-6)
    assert warnings == []


COLMAP = "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n#   POINTS2D[] as (X, Y, POINT3D_ID)\n"
ROWS = cells(seconds(T_NS), P, LAST)


@pytest.mark.parametrize(
    ("rows", "header", "says"),
    [
        (
            cells(np.arange(1, 121), FIRST, P, [1] * 120, ["a.png"] * 120),
            COLMAP,
            "COLMAP.*expected poses of the camera",
        ),
        (ROWS, "Format Version,1.23,Take Name,Take 1\n", "export of Motive.*one body with z up"),
        ([['{"t":', "1}"]], "", "invalid 'JSON': expected rows of text"),
        (
            cells(seconds(T_NS), P, P),
            "timestamp,x,y,z,roll,pitch,yaw\n",
            "header: .*expected a quaternion; angles are not",
        ),
        (cells(seconds(T_NS), P, np.zeros((120, 4))), "", "the tool has written no attitudes, 0 0 0 0 in all rows"),
        ([["2023-11-14T22:13:20", "1"]], "", "no pose: .*the file begins with '2023-11-14T22"),
        ([*ROWS, *ROWS], "", "line 121, t: .*two runs in one file, or unsorted"),
        (cells(["1.7e+09"] * 120, P, LAST), "", "line 2, t: .*have the stamps lost digits"),
        (ROWS[:1], "", "rows: invalid 1: expected at least 2 poses"),
        (cells(50 * np.arange(120), P, LAST), "", r"--time-unit ms, .* --time-offset 1699999999\.900"),
    ],
)
def test_what_cannot_be_read_says_why(tmp_path, rows, header, says):
    with pytest.raises(StrideTwinError, match=says) as error:
        read(tmp_path, rows, header)
    assert "\n" not in str(error.value)
