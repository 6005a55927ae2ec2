"""Trajectories as common tools write them: columns, order of the quaternion and unit of the stamps are recognised."""

from __future__ import annotations

import numpy as np
import pytest
from foot_walk import write_rows
from scipy.spatial.transform import Rotation

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.trajectory_file import read_trajectory
from stridetwin.streams.formats.trajectory_options import TrajectoryOptions
from stridetwin.streams.recording.index import Notes

T_S = np.arange(0, 22, 0.05)
P = np.column_stack([T_S, np.sin(T_S), 0.1 * np.cos(T_S)])
R = Rotation.from_euler("zyx", np.column_stack([0.3 * T_S + 0.2, 0.4 * np.sin(T_S), 0.1 * T_S]))
LAST, FIRST = R.as_quat(), R.as_quat(scalar_first=True)
SPAN_NS = (0, 22_000_000_000)
EPOCH_S = 1_403_636_579
EUROC = (
    "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
    "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], "
    "b_w_RS_S_z [rad s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2]\n"
)
OPENVINS = "# timestamp(s) tx ty tz qx qy qz qw Pr11 Pr12 Pr13 Pr22 Pr23 Pr33 Pt11 Pt12 Pt13 Pt22 Pt23 Pt33\n"
ROS = (
    "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.pose.position.x,"
    "field.pose.pose.position.y,field.pose.pose.position.z,field.pose.pose.orientation.x,"
    "field.pose.pose.orientation.y,field.pose.pose.orientation.z,field.pose.pose.orientation.w,twist.linear.x\n"
)
ARIA = (
    "graph_uid,tracking_timestamp_us,utc_timestamp_ns,tx_world_device,ty_world_device,tz_world_device,"
    "qx_world_device,qy_world_device,qz_world_device,qw_world_device\n"
)


def text(*blocks):
    """Rows of cells from a column of stamps and arrays of numbers."""
    columns = [np.asarray(block) for block in blocks]
    columns = [c[:, None] if c.ndim == 1 else c for c in columns]
    return [[v if isinstance(v, str) else f"{v:.9g}" for c in columns for v in c[i].tolist()] for i in range(len(T_S))]


def stamps(per_second, offset_s=0):
    return np.array([str(round((offset_s + t) * per_second)) for t in np.round(T_S, 3).astype(object)])


def matrices(rows=3):
    matrix = np.tile(np.eye(4), (len(T_S), 1, 1))
    matrix[:, :3, :3], matrix[:, :3, 3] = R.as_matrix(), P
    return matrix[:, :rows].reshape(len(T_S), -1)


MORE = np.full((len(T_S), 12), 0.25)
FORMS = {
    "tum": (text(T_S, P, LAST), "", " ", {}),
    "tum_with_commas": (text(T_S, P, LAST), "", ",", {}),
    "evo": ([[f"{float(c):.18e}" for c in row] for row in text(T_S, P, LAST)], "", " ", {}),
    "header_w_first": (text(T_S, P, FIRST), "# t x y z qw qx qy qz\n", " ", {}),
    "header_without_mark": (text(T_S, P, FIRST), "timestamp;x;y;z;qw;qx;qy;qz\n", ";", {}),
    "other_order_of_columns": (text(LAST, P, T_S), "qx,qy,qz,qw,pos_x,pos_y,pos_z,time\n", ",", {}),
    "euroc": (text(stamps(10**9), P, FIRST, MORE[:, :9]), EUROC, ",", {}),
    "euroc_without_header": (text(stamps(10**9), P, FIRST, MORE[:, :9]), "", ",", {}),
    "orb_slam3": (text(stamps(10**9), P, LAST), "", " ", {}),
    "openvins": (text(T_S, P, LAST, MORE), OPENVINS, " ", {}),
    "openvins_without_header": (text(T_S, P, LAST, MORE[:, :6]), "", " ", {}),
    "openvins_header_of_longer_rows": (text(T_S, P, LAST), OPENVINS, " ", {}),
    "openvins_state": (text(T_S, LAST, P, MORE), "# timestamp(s) q p v bg ba cam_imu_dt\n", " ", {}),
    "milliseconds": (text(stamps(10**3), P, LAST), "", " ", {}),
    "microseconds": (text(stamps(10**6), P, LAST), "", " ", {}),
    "unit_in_the_header": (text(stamps(10**6), P, LAST), "time_us,x,y,z,qx,qy,qz,qw\n", ",", {}),
    "another_epoch": (text(stamps(10**9, EPOCH_S), P, LAST), "", " ", {"time_offset_s": -float(EPOCH_S)}),
    "vins_fusion": (
        [[*row, ""] for row in text(stamps(10**9, EPOCH_S), P, FIRST, MORE[:, :3])],
        "",
        ",",
        {"time_offset_s": -float(EPOCH_S)},
    ),
    "rostopic": (
        text(stamps(10**9), stamps(10**9), stamps(10**9), ["odom"] * len(T_S), P, LAST, MORE[:, :1]),
        ROS,
        ",",
        {},
    ),
    "aria": (text(["a-b"] * len(T_S), stamps(10**6), stamps(10**9), P, LAST), ARIA, ",", {}),
    "kitti_with_stamps": (text(T_S, matrices()), "", " ", {}),
    "kitti": (text(matrices()), "", " ", {"times": T_S}),
    "square_matrices": (text(matrices(4)), "", " ", {"times": T_S}),
    "pose_without_stamps": (text(P, LAST), "", " ", {"times": T_S}),
    "numbers_of_frames": (text(np.arange(len(T_S)), P, LAST), "", " ", {"times": T_S}),
    "order_given": (text(T_S, P, FIRST), "", " ", {"quaternion": "wxyz"}),
}


@pytest.mark.parametrize("name", FORMS)
def test_forms_of_common_tools_give_the_same_path(tmp_path, name):
    rows, header, separator, options = FORMS[name]
    if "times" in options:
        times = write_rows(tmp_path / "times.txt", [[f"{t:.3f}"] for t in T_S])
        options = {**options, "times": times}
    file = write_rows(tmp_path / name, rows, header, separator)
    read = read_trajectory(file, TrajectoryOptions(**options), span_ns=SPAN_NS)
    np.testing.assert_allclose(read.path.t_ns, T_S * 1e9, atol=200)
    np.testing.assert_allclose(read.path.p_frame_in_world, P, atol=1e-7)
    assert np.abs(np.sum(read.path.q_world_frame * FIRST, axis=1)) == pytest.approx(1, abs=1e-7)


def test_the_first_pose_of_an_odometry_tells_the_order(tmp_path):
    still = R[0].inv() * R
    for order, q in (("xyzw", still.as_quat()), ("wxyz", still.as_quat(scalar_first=True))):
        read = read_trajectory(write_rows(tmp_path / order, text(T_S, P, q)))
        assert (read.order, read.is_order_known) == (order, False)
        there_and_back = read.with_other_order().with_other_order()
        np.testing.assert_array_equal(there_and_back.path.q_world_frame, read.path.q_world_frame)
        other = "xyzw" if order == "wxyz" else "wxyz"
        forced = read_trajectory(tmp_path / order, TrajectoryOptions(quaternion=other))
        np.testing.assert_allclose(forced.path.q_world_frame, read.with_other_order().path.q_world_frame, atol=1e-12)


@pytest.mark.parametrize(
    ("rows", "options", "says"),
    [
        (text(matrices()), {}, r"time stamps: .*--times FILE"),
        (text(P, LAST), {}, r"time stamps: .*--times FILE"),
        (text(T_S, P, P), {}, r"line 1: .*8 numbers: t x y z qx qy qz qw"),
        (text(T_S, P, LAST), {"times": T_S[:5]}, r"time stamps: .*no --times"),
        (text(matrices()), {"times": T_S[:5]}, r"times\.txt: rows: invalid 5: expected 440"),
        (text(stamps(10**9, EPOCH_S), P, LAST), {}, r"in ns: is it another clock\? --time-offset -1403636579\.000"),
        (text(T_S, P, LAST), {"time_unit": "ms"}, None),
        (text(stamps(10**9, 10**10), P, LAST), {}, r"line 1, t: .*a time in ns from 0 to 9e\+18; --time-unit"),
        (text(T_S - 3.0, P, LAST), {}, r"line 1, t: invalid '-3': expected a time in s"),
        ([*text(T_S, P, LAST), ["23", "1"]], {}, r"line 441: .*8 cells, as in the rows above"),
        (
            [["x", *row[1:]] if i == 3 else row for i, row in enumerate(text(T_S, P, LAST))],
            {},
            r"line 4, t: invalid 'x'",
        ),
    ],
)
def test_what_cannot_be_read_is_refused_with_what_mends_it(tmp_path, rows, options, says):
    if "times" in options:
        options = {"times": write_rows(tmp_path / "times.txt", [[f"{t:.3f}"] for t in options["times"]])}
    file = write_rows(tmp_path / "path.txt", rows)
    if says is None:  # with a wrong unit all of it is in the first moments of the recording
        read = read_trajectory(file, TrajectoryOptions(**options), span_ns=SPAN_NS)
        assert read.path.t_ns[-1] < 25_000_000
        return
    with pytest.raises(StrideTwinError, match=says) as error:
        read_trajectory(file, TrajectoryOptions(**options), span_ns=SPAN_NS)
    assert "\n" not in str(error.value)


def test_numbers_of_frames_in_place_of_stamps_are_noticed(tmp_path):
    notes = Notes(tmp_path, lenient=False)
    file = write_rows(tmp_path / "path.txt", text(np.arange(len(T_S)), P, LAST))
    read_trajectory(file, span_ns=SPAN_NS, notes=notes)
    (warning,) = notes.warnings
    assert warning.startswith("only 23 of its 440 poses lie within the recording's 0.000-22.000 s: ")
    assert "--times" in warning
