"""Files of estimated paths: which poses they hold, and their status and covariance."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from stridetwin.estimators.base import PathEstimate
from stridetwin.estimators.dvio.filter import IMU_ONLY, LOST, TRACKING
from stridetwin.outputs.path.files import COLUMNS, is_reliable, write_path
from stridetwin.streams.formats.tum import read_tum
from stridetwin.streams.trajectory import Trajectory


def estimated(words: list[str], *, covariance: bool = True) -> PathEstimate:
    """One pose per half second, of the given status."""
    n = len(words)
    path = Trajectory(
        t_ns=np.arange(n) * 500_000_000,
        p_frame_in_world=np.arange(3.0 * n).reshape(n, 3),
        q_world_frame=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        covariance=np.arange(n)[:, None, None] + np.arange(36.0).reshape(6, 6) if covariance else None,
    )
    healthy = np.array([word != LOST for word in words])
    return PathEstimate(name="dvio", frame="head/imu", path=path, status=np.array(words), healthy=healthy)


def test_a_path_ends_a_second_after_the_last_tracked_pose(tmp_path):
    estimate = estimated([TRACKING] * 3 + [IMU_ONLY] * 5)
    assert is_reliable(estimate).tolist() == [True] * 5 + [False] * 3
    count, message = write_path(estimate, tmp_path / "path.txt")
    assert count == len(read_tum(tmp_path / "path.txt")) == 5
    assert message.endswith(
        ": 5 poses; tracking ended 1.5 s before the recording; 3 poses without tracking left out, "
        "--dead-reckoning includes them"
    )
    assert write_path(estimate, tmp_path / "all.txt", dead_reckoning=True)[0] == 8
    assert len(read_tum(tmp_path / "all.txt")) == 8


def test_short_dead_reckoning_stays_and_lost_poses_go(tmp_path):
    words = [IMU_ONLY, TRACKING, IMU_ONLY, IMU_ONLY, TRACKING, LOST, TRACKING, IMU_ONLY, IMU_ONLY, IMU_ONLY, TRACKING]
    assert np.flatnonzero(~is_reliable(estimated(words))).tolist() == [0, 5, 9]
    assert "tracking ended" not in write_path(estimated(words), tmp_path / "path.txt")[1]


def test_a_table_has_status_and_covariance(tmp_path):
    estimate = estimated([TRACKING, IMU_ONLY])
    write_path(estimate, tmp_path / "path.csv")
    rows = list(csv.reader((tmp_path / "path.csv").open(encoding="utf-8")))
    assert tuple(rows[0]) == COLUMNS
    assert [row[8] for row in rows[1:]] == [TRACKING, IMU_ONLY]
    named = dict(zip(rows[0], rows[2]))
    assert (float(named["t_s"]), float(named["z_m"])) == (0.5, 5.0)
    assert (float(named["cov_x_x"]), float(named["cov_y_rz"]), float(named["cov_rz_rz"])) == (1.0, 12.0, 36.0)


@pytest.mark.parametrize("file", ["path.csv", "path.txt"])
def test_a_path_without_status_or_covariance_is_written_whole(tmp_path, file):
    path = estimated([TRACKING] * 4, covariance=False).path
    count, message = write_path(PathEstimate(name="foot_ins", frame="", path=path), tmp_path / file)
    assert (count, message) == (4, f"{tmp_path / file}: 4 poses")


def test_where_tracking_never_began_all_is_written_and_reported(tmp_path):
    count, message = write_path(estimated([LOST] * 3), tmp_path / "path.txt")
    assert count == 3
    assert "tracking never began" in message
