"""A folder of depth images with poses becomes planes and terrains in files; and the measures of the map's score."""

import json
import math

import cv2
import numpy as np
import pytest

from stridetwin.cli.main import main
from stridetwin.outputs.terrain.files import COLORS
from stridetwin.outputs.terrain.grid import GROUND_CLASSES, GroundGrid, ground_classes_at
from stridetwin.outputs.terrain.scores import distance_to, mesh_of, true_changes
from stridetwin.sim.config import Level, Ramp, Route, Stairs
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.formats.opening import open_any
from stridetwin.streams.terrain_truth import Slab
from tests.mapped_recording import map_recording

WIDTH, HEIGHT, FOCAL = 320, 240, 192.0
RISER, TREAD = 0.15, 0.30


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three images, 7-Scenes layout, of three risers 1.2 m ahead of a camera 1.6 m over the floor, 35° down."""
    where = tmp_path_factory.mktemp("frames")
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([(u - (WIDTH - 1) / 2) / FOCAL, (v - (HEIGHT - 1) / 2) / FOCAL, np.ones_like(u, float)], -1)
    c, s = math.cos(math.radians(35)), math.sin(math.radians(35))
    R = np.array([[0, -s, c], [-1, 0, 0], [0, -c, -s]])
    eye = np.array([-1.2, 0.0, 1.6])
    d = rays @ R.T
    depth = np.full((HEIGHT, WIDTH), np.inf)
    for k in range(4):  # treads from the floor up, and the risers between them
        t = (k * RISER - eye[2]) / d[..., 2]
        x = eye[0] + t * d[..., 0]
        on = (t > 0) & (x < k * TREAD) & ((x > (k - 1) * TREAD) | (k == 0)) if k < 3 else (t > 0) & (x > 2 * TREAD)
        depth = np.where(on & (t < depth), t, depth)
        t = (k * TREAD - eye[0]) / d[..., 0]
        z = eye[2] + t * d[..., 2]
        on = (t > 0) & (z > k * RISER) & (z < (k + 1) * RISER) & (k < 3)
        depth = np.where(on & (t < depth), t, depth)
    pixels = np.where(depth < 5, depth * 1000, 0).astype(np.uint16)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, eye
    for i in range(3):
        cv2.imwrite(str(where / f"frame-{i:06d}.depth.png"), pixels)
        np.savetxt(where / f"frame-{i:06d}.pose.txt", T)
    np.savetxt(where / "camera-intrinsics.txt", [[FOCAL, 0, (WIDTH - 1) / 2], [0, FOCAL, (HEIGHT - 1) / 2], [0, 0, 1]])
    return where


def test_estimate_writes_planes_terrains_and_points(folder, tmp_path, capsys):
    file = tmp_path / "map.json"
    assert main(["estimate", "terrain_map", str(folder), "--poses", "truth", "-o", str(file), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert output["files"] == [str(file), str(tmp_path / "map.ply")]
    found = json.loads(file.read_text())
    stairs = max((t for t in found["terrains"] if t["type"] == "stairs"), key=lambda t: t["steps"])
    assert stairs["riser_m"] == pytest.approx(RISER, abs=0.005)
    assert stairs["tread_m"] == pytest.approx(TREAD, abs=0.01)
    assert stairs["heading_deg"] == pytest.approx(0.0, abs=1.0)
    assert output["rows"] == len(found["planes"])
    header, _, points = (tmp_path / "map.ply").read_bytes().partition(b"end_header\n")
    count = int(header.split(b"element vertex ")[1].split()[0])
    assert len(points) == 19 * count > 0


def test_the_ground_is_a_mesh_as_well_where_one_is_asked_for(folder, tmp_path, capsys):
    trimesh = pytest.importorskip("trimesh")
    file = tmp_path / "map.json"
    assert main(["estimate", "terrain_map", str(folder), "--poses", "truth", "-o", str(file), "--mesh", "--json"]) == 0
    surface = tmp_path / "map.glb"
    assert json.loads(capsys.readouterr().out)["files"][-1] == str(surface)
    scene = trimesh.load(surface)
    (mesh,) = scene.geometry.values()
    points = (tmp_path / "map.ply").read_bytes().partition(b"end_header\n")[2]
    rows = np.frombuffer(points, [("xyz", "<f4", 3), ("rgb", "u1", 3), ("plane", "<i4")])
    low, high = rows["xyz"].min(axis=0), rows["xyz"].max(axis=0)
    assert high[2] - low[2] == pytest.approx(3 * RISER, abs=0.05)
    # the file's own vertices are the map's, in metres; the scene shows them with y up, as every glTF viewer takes it
    column = 0.02  # a column at the border with no three beside it is part of no triangle
    np.testing.assert_allclose(mesh.bounds, [low, high], atol=column)
    np.testing.assert_allclose(scene.bounds, [[low[0], low[2], -high[1]], [high[0], high[2], -low[1]]], atol=column)
    assert 0.98 * len(rows) < len(mesh.vertices) <= len(rows)
    assert np.all(mesh.face_normals[:, 2] > 0.0)
    assert np.all(mesh.vertex_normals[:, 2] > 0.0)
    plan = (mesh.area_faces * mesh.face_normals[:, 2]).sum()
    assert 0.5 * column**2 * len(rows) < plan < column**2 * len(rows)
    assert {tuple(c[:3]) for c in mesh.visual.vertex_colors.tolist()} == {tuple(c) for c in rows["rgb"].tolist()}
    assert COLORS["stairs"] in {tuple(c) for c in rows["rgb"].tolist()}


def test_the_published_map_writes_the_same_files_and_all_surfaces(folder, tmp_path, capsys):
    trimesh = pytest.importorskip("trimesh")
    arguments = ["--poses", "truth", "--backend", "open3d", "--mesh", "-o", str(tmp_path / "map.json"), "--json"]
    assert main(["estimate", "terrain_map", str(folder), *arguments]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    assert files == [str(tmp_path / name) for name in ("map.json", "map.ply", "map.glb", "map_mesh.ply")]
    found = json.loads((tmp_path / "map.json").read_text())
    stairs = max((t for t in found["terrains"] if t["type"] == "stairs"), key=lambda t: t["steps"])
    assert stairs["riser_m"] == pytest.approx(RISER, abs=0.02)
    assert trimesh.load(tmp_path / "map_mesh.ply").area > 3.0  # m²


def test_a_backend_goes_with_estimators_that_have_it(folder, tmp_path, capsys):
    assert main(["estimate", "dvio", str(folder), "--backend", "open3d", "-o", str(tmp_path / "path.txt")]) == 2
    assert "--backend is only valid for terrain_map, locomotion_mode" in capsys.readouterr().err


def test_true_poses_are_used_on_request_alone(folder, tmp_path, capsys):
    file = tmp_path / "map.json"
    assert main(["estimate", "terrain_map", str(folder), "-o", str(file)]) == 2
    assert "dvio cannot run on this recording; pass --poses truth, or --poses FILE" in capsys.readouterr().err
    assert not file.exists()
    assert main(["estimate", "terrain_map", str(folder), "--poses", "truth", "-o", str(file)]) == 0
    assert "true poses of /truth/head/color/odometry" in capsys.readouterr().out


def test_a_mesh_is_refused_where_there_is_no_ground(tmp_path, capsys):
    assert main(["estimate", "foot_ins", str(tmp_path), "--mesh", "-o", str(tmp_path / "path.txt")]) == 2
    assert "--mesh is only valid for terrain_map" in capsys.readouterr().err


def test_a_grid_of_the_ground_has_heights_and_classes_by_direction(folder):
    terrain_map = map_recording(open_any(folder))
    grid = GroundGrid.of(terrain_map)
    xy = np.random.default_rng(0).uniform([-0.5, -0.4], [0.8, 0.4], (200, 2))
    height, plane = grid.at(xy.reshape(20, 10, 2))
    np.testing.assert_array_equal(height.ravel(), terrain_map.heights(xy))
    points, ids = grid.points()
    theirs, planes = terrain_map.surface_points()
    assert sorted(map(tuple, points.round(6))) == sorted(map(tuple, theirs.round(6)))
    assert sorted(ids) == sorted(planes)
    tread = plane.ravel()[(xy[:, 0] > 0.05) & (xy[:, 0] < 0.25) & (plane.ravel() >= 0)]
    names = [
        {GROUND_CLASSES[k] for k in ground_classes_at(terrain_map.estimate, np.array(tread), heading)}
        for heading in (0.0, math.pi)
    ]
    assert names == [{"SA"}, {"SD"}]
    assert grid.at(np.array([[99.0, 99.0]]))[1] == -1


def test_a_folder_without_poses_is_refused(folder, tmp_path, capsys):
    for file in folder.glob("*.depth.png"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "camera-intrinsics.txt").write_bytes((folder / "camera-intrinsics.txt").read_bytes())
    assert main(["estimate", "terrain_map", str(tmp_path), "-o", str(tmp_path / "map.json")]) == 2
    assert "--poses" in capsys.readouterr().err
    poses = tmp_path / "poses.txt"
    row = [-1.2, 0, 1.6, *_xyzw(folder)]
    poses.write_text("".join(f"{i / 30:.9f} {' '.join(map(str, row))}\n" for i in range(3)))
    out = tmp_path / "map.json"
    assert main(["estimate", "terrain_map", str(tmp_path), "--poses", str(poses), "-o", str(out)]) == 0
    assert any(t["type"] == "stairs" for t in json.loads(out.read_text())["terrains"])


@pytest.mark.parametrize("has_truth", [True, False])
def test_poses_with_w_first_are_noticed_by_the_truth_or_by_the_ground(folder, tmp_path, capsys, has_truth):
    for file in (*folder.glob("*.depth.png"), *(folder.glob("*.pose.txt") if has_truth else ())):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "camera-intrinsics.txt").write_bytes((folder / "camera-intrinsics.txt").read_bytes())
    poses, out = tmp_path / "poses.csv", tmp_path / "map.json"
    x, y, z, w = _xyzw(folder)
    poses.write_text("".join(f"{i / 30:.9f},-1.2,0,1.6,{w},{x},{y},{z}\n" for i in range(3)))
    command = ["estimate", "terrain_map", str(tmp_path), "-o", str(out), "--poses", str(poses)]
    assert main(command) == 0
    printed = capsys.readouterr()
    assert "--quaternion wxyz" in printed.err or "quaternions as wxyz" in printed.err
    assert "rotated" not in printed.out
    assert any(t["type"] == "stairs" for t in json.loads(out.read_text())["terrains"])
    assert main([*command, "--quaternion", "wxyz"]) == 0
    assert "quaternion" not in capsys.readouterr().err


def test_poses_without_stamps_need_times(folder, tmp_path, capsys):
    poses, out, times = tmp_path / "poses.txt", tmp_path / "map.json", tmp_path / "times.txt"
    T = np.loadtxt(folder / "frame-000000.pose.txt")
    np.savetxt(poses, np.tile(T[:3].ravel(), (3, 1)))
    np.savetxt(times, np.arange(3) / 30)
    command = ["estimate", "terrain_map", str(folder), "-o", str(out), "--poses", str(poses)]
    assert main(command) == 2
    assert "--times FILE" in capsys.readouterr().err
    assert main([*command, "--times", str(times)]) == 0
    assert any(t["type"] == "stairs" for t in json.loads(out.read_text())["terrains"])


def _xyzw(folder):
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(np.loadtxt(folder / "frame-000000.pose.txt")[:3, :3]).as_quat()


def test_the_true_changes_of_a_route():
    segments = (
        Level(length_m=3),
        Stairs(risers=4, riser_m=0.15, tread_m=0.28, down=False),
        Level(length_m=2),
        Stairs(risers=4, riser_m=0.15, tread_m=0.28, down=True),
        Level(length_m=3),
        Ramp(angle_rad=0.2, rise_m=0.5, down=False),
        Level(length_m=3),
    )
    up, down, ramp = true_changes(Terrain.from_route(Route(segments=segments)).layout.profile)
    assert (up.mode, up.risers, down.mode, ramp.mode) == ("SA", 4, "SD", "RA")
    assert (up.s, up.riser, up.tread) == pytest.approx((3.0, 0.15, 0.28))
    assert (down.s, down.riser) == pytest.approx((3.0 + 3 * 0.28 + 2.0, -0.15))
    assert ramp.slope == pytest.approx(0.2)


def test_distances_from_a_mesh_are_exact():
    low = Slab(x=-1.0, y=0.0, heading=0.0, length=2.0, left=0.5, right=0.5, z0=0.5, z1=0.5, terrain="level")
    ramp = Slab(x=1.0, y=0.0, heading=0.0, length=4.0, left=0.5, right=0.5, z0=0.5, z1=3.5, terrain="ramp")
    points = np.array([[0.0, 0.0, 0.7], [0.5, 0.2, 0.5], [-2.0, 0.0, 0.5], [-1.3, 0.9, 0.5], [0.0, 0.0, 0.4]])
    mesh = mesh_of([low])
    np.testing.assert_allclose(distance_to(mesh, points), [0.2, 0.0, 1.0, 0.5, 0.1], atol=1e-9)
    over = np.array([[3.0 - 0.6, 0.1, 2.0 + 0.8], [3.0, 0.0, 2.0], [3.0, 1.0, 1.9]])
    np.testing.assert_allclose(distance_to(mesh_of([low, ramp]), over), [1.0, 0.0, 0.5], atol=1e-9)
