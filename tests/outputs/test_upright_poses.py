"""Poses of a world whose z axis is not up: a real image, and rooms in which every direction is drawn."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.real_walks import data_folder
from stridetwin.cli.main import main
from stridetwin.estimators.terrain_map.upright import normals, upward

FOLDER = data_folder("stairs_depth")
INTRINSICS = np.array([200.0, 200.0, 159.5, 119.5])


def room(R_world_camera: np.ndarray, height_m: float) -> np.ndarray:
    """(240, 320) m, depth of a floor and four walls 2.5 m away, by exact rays."""
    v, u = np.mgrid[:240, :320]
    rays = np.stack([(u - 159.5) / 200.0, (v - 119.5) / 200.0, np.ones_like(u, float)], -1) @ R_world_camera.T
    with np.errstate(divide="ignore"):
        distances = [-height_m / rays[..., 2], 2.5 / rays[..., 0], -2.5 / rays[..., 0], 2.5 / rays[..., 1]]
        distances.append(-2.5 / rays[..., 1])
    return np.min([np.where(d > 0.0, d, np.inf) for d in distances], axis=0).astype(np.float32)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(25.0, 60.0), st.floats(-25.0, 25.0))
def test_the_vertical_of_a_room_is_found_in_any_world(seed, pitch_deg, roll_deg):
    rng = np.random.default_rng(seed)
    world, views = Rotation.random(rng=rng), []
    for yaw_deg in (10.0, 130.0, 250.0):
        looking = Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True)
        R = looking.as_matrix() @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        depth = room(R, 1.6) * rng.normal(1.0, 0.002, (240, 320)).astype(np.float32)
        views.append((normals(depth, INTRINSICS), world.as_matrix() @ R))
    up = upward(views)
    assert up is not None
    assert np.degrees(np.arccos(min(1.0, float(up @ world.apply([0.0, 0.0, 1.0]))))) < 1.0


def test_without_a_level_surface_there_is_no_vertical():
    rng = np.random.default_rng(1)
    any_way = rng.standard_normal((4000, 3))
    assert upward([(any_way / np.linalg.norm(any_way, axis=1)[:, None], np.eye(3))]) is None
    assert upward([]) is None


@pytest.mark.skipif(FOLDER is None, reason="no recordings: set STRIDETWIN_DATA to their folder")
@pytest.mark.parametrize("world", ["camera", "y up"])
def test_a_staircase_is_found_in_a_world_that_is_not_upright(world, tmp_path, capsys):
    """As 7-Scenes publishes its poses, in the frame of the first image; and as tablets do, y up."""
    folder = tmp_path / "scene"
    shutil.copytree(FOLDER / "stairs_depth", folder, copy_function=shutil.copyfile)
    pose = folder / "frame-000000.pose.txt"
    T = np.loadtxt(pose)
    turn = np.eye(4)
    turn[:3, :3] = T[:3, :3].T if world == "camera" else Rotation.from_euler("x", -90, degrees=True).as_matrix()
    pose.chmod(0o644)
    np.savetxt(pose, turn @ T)
    assert main(["estimate", "terrain_map", str(folder), "--poses", "truth", "-o", str(tmp_path / "map.json")]) == 0
    said = capsys.readouterr().out
    assert "because their z axis is not up" in said
    assert "stairs" in said
    assert " 0 stairs" not in said
