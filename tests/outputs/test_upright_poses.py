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
from stridetwin.estimators.terrain_map.upright import Surface, find_surfaces, normals, refine_vertical, upward

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


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.floats(25.0, 50.0), st.floats(-10.0, 10.0))
def test_planes_give_the_vertical_within_half_a_degree_and_walls_confirm_it(seed, pitch_deg, roll_deg):
    rng = np.random.default_rng(seed)
    world, surfaces = Rotation.from_rotvec(rng.uniform(-0.06, 0.06, 3)), []
    true_up = world.apply([0.0, 0.0, 1.0])
    for yaw_deg in (10.0, 130.0, 250.0):
        looking = Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True)
        R = looking.as_matrix() @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        depth = room(R, 1.6) * rng.normal(1.0, 0.002, (240, 320)).astype(np.float32)
        T = np.eye(4)
        T[:3, :3] = world.as_matrix() @ R
        surfaces += find_surfaces(depth, INTRINSICS, T, np.array([0.0, 0.0, 1.0]))
    vertical = refine_vertical(surfaces, np.array([0.0, 0.0, 1.0]))
    assert vertical is not None
    assert vertical.is_confirmed
    angle = np.arccos(min(1.0, float(vertical.up @ true_up)))
    assert np.degrees(angle) < 0.5
    assert angle < 4.0 * vertical.sd_rad


def test_a_ramp_alone_confirms_no_vertical():
    R = Rotation.from_euler("ZYX", [0.0, 60.0, 0.0], degrees=True).as_matrix()
    R = R @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    v, u = np.mgrid[:240, :320]
    rays = np.stack([(u - 159.5) / 200.0, (v - 119.5) / 200.0, np.ones_like(u, float)], -1) @ R.T
    normal = np.array([-np.sin(0.07), 0.0, np.cos(0.07)])
    depth = (-1.6 * normal[2] / (rays @ normal)).astype(np.float32)
    depth = np.where((depth > 0.0) & (depth < 4.0), depth, 0.0).astype(np.float32)
    T = np.eye(4)
    T[:3, :3] = R
    vertical = refine_vertical(
        find_surfaces(depth, INTRINSICS, T, np.array([0.0, 0.0, 1.0])), np.array([0.0, 0.0, 1.0])
    )
    assert vertical is not None
    assert not vertical.is_confirmed
    assert refine_vertical([], np.array([0.0, 0.0, 1.0])) is None


def surface(tilt_rad: float, height_m: float, image: int) -> Surface:
    """A level surface that is tilted forward, with the least standard deviation that a fit has."""
    normal = np.array([-np.sin(tilt_rad), 0.0, np.cos(tilt_rad)])
    return Surface(normal, np.radians(0.5), False, np.array([0.0, 0.0, height_m]), image)


def test_two_heights_confirm_a_vertical_only_in_one_image():
    """Parts of a ramp at two heights, each in an image of its own, are no proof that the poses are tilted."""
    z = np.array([0.0, 0.0, 1.0])
    for images, expected in (((0, 1), False), ((0, 0), True)):
        surfaces = [surface(0.06, height, image) for height, image in zip((0.0, 0.2), images)]
        vertical = refine_vertical(surfaces, z)
        assert vertical is not None
        assert vertical.is_confirmed is expected


def test_level_ground_that_agrees_with_the_given_vertical_keeps_it():
    """On a walk over long ramps most surfaces slope alike, but the landings between them are level."""
    z = np.array([0.0, 0.0, 1.0])
    ramps = [surface(0.07, 0.1 * (k % 2), k // 2) for k in range(20)]
    vertical = refine_vertical(ramps, z)
    assert vertical is not None
    assert vertical.is_confirmed
    vertical = refine_vertical([*ramps, *(surface(0.0, 0.0, k) for k in range(10))], z)
    assert vertical is not None
    assert not vertical.is_confirmed


def test_the_vertical_is_found_in_the_noise_of_a_cheap_camera():
    """Noise of 2 % at each pixel turns normals between single pixels by 15 degrees; means of squares show the floor."""
    rng = np.random.default_rng(3)
    R = Rotation.from_euler("ZYX", [0.0, 40.0, 0.0], degrees=True).as_matrix()
    R = R @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    depth = room(R, 1.4) * rng.normal(1.0, 0.02, (240, 320)).astype(np.float32)
    up = upward([(normals(depth, INTRINSICS), R)])
    assert up is not None
    assert np.degrees(np.arccos(min(1.0, float(up[2])))) < 2.0


@pytest.mark.skipif(FOLDER is None, reason="no recordings: set STRIDETWIN_DATA to their folder")
def test_given_poses_that_are_tilted_by_a_few_degrees_are_set_upright(tmp_path, capsys):
    folder = tmp_path / "scene"
    shutil.copytree(FOLDER / "stairs_depth", folder, copy_function=shutil.copyfile)
    pose = folder / "frame-000000.pose.txt"
    tilt = np.eye(4)
    tilt[:3, :3] = Rotation.from_euler("y", 4.0, degrees=True).as_matrix()
    pose.chmod(0o644)
    np.savetxt(pose, tilt @ np.loadtxt(pose))
    assert main(["estimate", "terrain_map", str(folder), "--poses", "truth", "-o", str(tmp_path / "map.json")]) == 0
    said = capsys.readouterr().out
    assert "because level ground and walls are tilted" in said
    assert " 0 ramp" in said
    assert " 0 stairs" not in said


def test_images_without_level_ground_are_said_to_show_no_vertical(tmp_path, capsys):
    import cv2

    folder = tmp_path / "wall"
    folder.mkdir()
    cv2.imwrite(str(folder / "frame-000000.depth.png"), np.full((424, 512), 1500, np.uint16))
    cv2.imwrite(str(folder / "frame-000000.color.png"), np.full((424, 512, 3), 90, np.uint8))
    looking_ahead = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    np.savetxt(folder / "frame-000000.pose.txt", looking_ahead)
    np.savetxt(folder / "camera-intrinsics.txt", np.array([[365.0, 0, 255.5], [0, 365.0, 211.5], [0, 0, 1.0]]))
    assert main(["estimate", "terrain_map", str(folder), "--poses", "truth", "-o", str(tmp_path / "map.json")]) == 0
    assert "no level ground in their depth images shows whether their z axis is up" in capsys.readouterr().out


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
