"""What the peers of the odometry are given, and what becomes of their answers."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks import vio_peers
from benchmarks.peers.folder import row
from benchmarks.peers.vocabulary import BRANCHES, write_vocabulary
from stridetwin.outputs.truth import TruePath
from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.sim.sensors.standard_rig import standard_rig

RIG = standard_rig(TwinConfig(name="walk", route=Route(segments=(Level(length_m=3.0),))))
CAMERA, IMU = RIG.cameras["/head/color"], RIG.imu("/head/imu")


def test_a_vocabulary_is_a_tree_whose_words_are_leaves(tmp_path) -> None:
    rng = np.random.default_rng(1)
    images = [cv2.resize(rng.integers(0, 256, (30, 40), np.uint8), (320, 240)) for _ in range(4)]
    words = write_vocabulary(images, tmp_path / "voc.txt", rng)
    text = (tmp_path / "voc.txt").read_text()
    head, *lines = text.split("\n")
    assert head.split() == [str(BRANCHES), "4", "0", "0"]
    assert not text.endswith("\n")
    nodes = [line.split() for line in lines]
    assert {len(node) for node in nodes} == {2 + 32 + 1}
    parents = [int(node[0]) for node in nodes]
    assert all(parent < number for number, parent in enumerate(parents, 1))
    leaves = [number for number, node in enumerate(nodes, 1) if node[1] == "1"]
    assert len(leaves) == words > BRANCHES
    assert set(leaves).isdisjoint(parents)
    assert max(np.bincount(parents)) <= BRANCHES
    assert all(0 <= int(octet) <= 255 for node in nodes for octet in node[2:34])


def test_orbslam3_gets_the_rig() -> None:
    storage = cv2.FileStorage(vio_peers.settings(CAMERA, IMU, 10.0), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    assert storage.getNode("Camera1.fx").real() == CAMERA.intrinsics[0]
    assert storage.getNode("IMU.NoiseGyro").real() == pytest.approx(10.0 * IMU.gyroscope_noise_density)
    T = np.linalg.inv(IMU.mount.T_body_sensor) @ CAMERA.mount.T_body_sensor
    np.testing.assert_allclose(storage.getNode("IMU.T_b_c1").mat(), T, atol=1e-6)


def test_a_peer_that_estimates_the_truth_in_a_world_of_its_own_has_no_error(tmp_path, monkeypatch) -> None:
    t_ns = np.arange(0, 12_000_000_000, 33_333_333)
    s = t_ns * 1e-9
    p = np.stack([s, 0.3 * np.sin(s), 0.02 * np.sin(6 * s)], -1)
    R = Rotation.from_euler("zyx", np.stack([0.3 * np.cos(s), 0.2 * np.sin(s), 0.1 * s], -1))
    v = np.stack([np.ones_like(s), 0.3 * np.cos(s), 0.12 * np.cos(6 * s)], -1)
    truth = TruePath(t_ns=t_ns, p_frame_in_world=p, v_frame_in_world=v, q_world_frame=R.as_quat(scalar_first=True))
    monkeypatch.setattr(vio_peers, "true_path", lambda recording, mount: truth)
    T = np.tile(np.eye(4), (len(s), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R.as_matrix(), p
    T_imu_camera = np.linalg.inv(IMU.mount.T_body_sensor) @ CAMERA.mount.T_body_sensor
    own = np.linalg.inv(T[30] @ T_imu_camera) @ T @ T_imu_camera
    lines = [row(f"{t * 1e-9:.9f}", k >= 30, 12.5, own[k]) for k, t in enumerate(t_ns.tolist())]
    (tmp_path / "out.txt").write_text("".join(lines))
    figures = vio_peers.peer_figures(SimpleNamespace(rig=RIG), "head", tmp_path / "out.txt")
    assert figures["failure"] == ""
    assert figures["loop_drift_m"] < 1e-6
    assert figures["ape_rmse_m"] < 1e-6
    assert figures["time_ms"] == {"mean": 12.5, "p99": 12.5}


def test_a_peer_that_could_not_be_run_says_why(tmp_path) -> None:
    environment = vio_peers.Environment(folder=tmp_path, missing={})
    (tmp_path / "bin").mkdir()
    python = tmp_path / "bin" / "python"
    python.write_text("#!/bin/sh\necho no such thing >&2\nexit 3\n")
    python.chmod(0o755)
    assert environment.run("opencv_rgbd.py") == "no such thing"
    python.write_text("#!/bin/sh\nkill -11 $$\n")
    assert environment.run("opencv_rgbd.py") == "crashed with signal 11"
    cases = {"walk": {"orbslam3_rgbd": {"error": "no such package"}}}
    summary = vio_peers.summary(cases, "orbslam3_rgbd")
    assert summary["error"] == "no such package"
    assert summary["failures"] == {"walk": "not run"}
