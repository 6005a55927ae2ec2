"""A mesh becomes exact boxes and wedges, with its error reported; what cannot be replaced or trusted is refused."""

import base64
import json
import math
import struct

import numpy as np
import pytest
import trimesh

from stridetwin.sim.config import Level, Ramp, Stairs
from stridetwin.sim.world.mesh_terrain import MeshWay, mesh_terrain
from stridetwin.streams.errors import StrideTwinError


def box(x0, x1, top, width=3.0):
    block = trimesh.creation.box(extents=(x1 - x0, width, top + 1.0))
    block.apply_translation(((x0 + x1) / 2, 0, (top - 1.0) / 2))
    return block


def stair(risers=(0.15, 0.15, 0.15), tread=0.30):
    """A level, a flight up, a ramp down by 0.2 m over 2 m, and a level; begins at x = -1."""
    parts, x, z = [box(-1.0, 2.0, 0.0)], 2.0, 0.0
    for i, riser in enumerate(risers):
        z += riser
        end = x + (tread if i < len(risers) - 1 else 1.5)
        parts.append(box(x, end, z))
        x = end
    ramp = trimesh.convex.convex_hull(
        [(px, y, pz) for y in (-1.5, 1.5) for px, pz in ((x, -1), (x + 2, -1), (x, z), (x + 2, z - 0.2))]
    )
    return trimesh.util.concatenate([*parts, ramp, box(x + 2.0, x + 4.0, z - 0.2)])


def way(path, mesh, **rest):
    mesh.export(path)
    return MeshWay(path=path, **rest)


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
def test_a_stair_and_a_ramp_become_segments(tmp_path, suffix):
    segments, summary = mesh_terrain(way(tmp_path / f"a.{suffix}", stair()), 2.4)
    first, flight, landing, ramp, last = segments
    assert [type(p) for p in segments] == [Level, Stairs, Level, Ramp, Level]
    assert flight.heights_m == pytest.approx((0.15,) * 3, abs=1e-6)
    assert flight.tread_m == pytest.approx(0.30, abs=0.006)
    assert (first.length_m, landing.length_m) == pytest.approx((2.0, 1.5), abs=0.01)
    assert ramp.down
    assert ramp.angle_rad == pytest.approx(math.atan2(0.2, 2.0), abs=0.003)
    assert last.length_m == pytest.approx(2.0, abs=0.02)
    assert "replaced by exact boxes and wedges" in summary
    off = float(summary.split("lies up to ")[1].split(" mm")[0])
    assert 0.0 <= off < 3.0


def test_units_axes_and_places_are_the_users(tmp_path):
    mesh = stair()
    mesh.apply_transform(trimesh.transformations.rotation_matrix(math.pi / 2, [0, 0, 1], [0, 0, 0]))
    mesh.apply_translation((5.0, 2.0, 0.3))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-math.pi / 2, [1, 0, 0], [0, 0, 0]))  # y up
    mesh.apply_scale(1000.0)
    placed = way(
        tmp_path / "b.stl", mesh, scale=1e-3, up="y", start_m=(5.0, 2.5), heading_rad=math.pi / 2, length_m=3.4
    )
    segments, _ = mesh_terrain(placed, 2.4)
    assert [type(p) for p in segments] == [Level, Stairs, Level]
    assert segments[0].length_m == pytest.approx(1.5, abs=0.01)


def test_uneven_treads_become_single_stairs(tmp_path):
    mesh = trimesh.util.concatenate([box(-1, 2, 0), box(2, 2.25, 0.1), box(2.25, 2.65, 0.25), box(2.65, 5, 0.4)])
    segments, _ = mesh_terrain(way(tmp_path / "c.stl", mesh), 2.4)
    assert [type(p) for p in segments] == [Level, Stairs, Level, Stairs, Level, Stairs, Level]
    assert [p.heights_m[0] for p in segments if isinstance(p, Stairs)] == pytest.approx([0.1, 0.15, 0.15], abs=1e-6)


def ball():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.3)
    mesh.apply_translation((1.5, 0.5, -0.2))
    return mesh


@pytest.mark.parametrize(
    ("mesh", "said"),
    [
        (stair(risers=(0.3, 0.15)), "riser at 2.00 m: invalid '300 mm': expected 20-250 mm"),
        (stair(risers=(0.7, 0.15)), "no ground that can be stepped onto"),
        (stair(tread=0.12), "tread at 2.00 m: invalid '120 mm': expected at least 200 mm"),
        (trimesh.util.concatenate([box(-1, 2, 0), box(2.5, 5, 0)]), "a hole"),
        (trimesh.util.concatenate([box(-1, 5, 0), ball()]), "mm off"),
        (box(-1, 5, 0, width=1.0), "a hole"),
    ],
)
def test_what_cannot_be_replaced_is_refused_with_its_place(tmp_path, mesh, said):
    with pytest.raises(StrideTwinError, match=said) as refused:
        mesh_terrain(way(tmp_path / "d.stl", mesh), 2.4)
    assert str(tmp_path / "d.stl") in str(refused.value)


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("a.stl", bytes(80) + struct.pack("<I", 4_000_000_000), "triangles declared"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1000000000\nend_header\n", "elements declared"),
        ("a.obj", b"v 0 0 0\n" + b"f 1 1 1\n" * 200_000, "lines"),
        ("a.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "coordinates"),
        ("a.obj", b"mtllib /etc/passwd\nv 0 0 0\nv 2000000 0 0\nv 0 1 0\nf 1 2 3\n", "coordinates"),
        ("a.stl", b"solid nothing", "mesh|triangles"),
        ("a.dae", b"x", r"invalid '\.dae': expected \.stl, \.obj, \.ply"),
    ],
)
def test_hostile_meshes_are_refused(tmp_path, name, data, said):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(StrideTwinError, match=said):
        mesh_terrain(MeshWay(path=tmp_path / name), 2.4)


FOUR_STEPS = {"risers": (0.17,) * 4, "tread": 0.29}
Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])


def lying(mesh, *, y_up=False, scale=1.0, shift=(0.0, 0.0, 0.0), turn_deg=0.0):
    """A mesh as other programs export it: turned, moved, in another unit and with another axis up."""
    mesh.apply_transform(trimesh.transformations.rotation_matrix(math.radians(turn_deg), [0, 0, 1], [0, 0, 0]))
    mesh.apply_translation(shift)
    if y_up:
        mesh.apply_transform(Y_UP)
    mesh.apply_scale(scale)
    return mesh


@pytest.mark.parametrize(
    ("place", "size", "advice"),
    [
        ({"y_up": True}, "9.37 x 1.68 x 3 m", "`up: y`$"),
        ({"scale": 100.0}, "937 x 300 x 168 m", "`unit: cm`$"),
        ({"scale": 1000.0}, "9370 x 3000 x 1680 m", "`unit: mm`$"),
        ({"scale": 1 / 0.0254}, "368.9 x 118.1 x 66.14 m", "`unit: in`$"),
        ({"scale": 1000.0, "y_up": True}, "9370 x 1680 x 3000 m", "`up: y`, `unit: mm`$"),
        ({"shift": (10.0, 5.0, 0.0)}, "9.37 x 3 x 1.68 m", r"`start_m: \[9\.01, 5\]`$"),
        (
            {"turn_deg": 90.0, "shift": (20.0, 3.0, 0.0)},
            "3 x 9.37 x 1.68 m",
            r"`start_m: \[20, 2\.01\]`, `heading_deg: 90`$",
        ),
    ],
)
def test_a_mesh_that_lies_otherwise_is_refused_with_its_size_and_the_keys_that_help(tmp_path, place, size, advice):
    mesh = lying(stair(**FOUR_STEPS), **place)
    with pytest.raises(StrideTwinError, match=advice) as refused:
        mesh_terrain(way(tmp_path / "a.stl", mesh), 2.4)
    (line,) = str(refused.value).splitlines()
    assert f"the mesh is {size} along its x, y, z" in line
    for key in ("`up: y`", "`unit`", "`start_m`", "`heading_deg`"):
        assert key in line


@pytest.mark.parametrize(
    ("unit", "scale"),
    [("cm", 100.0), ("mm", 1000.0), ("in", 1 / 0.0254), ("inch", 1 / 0.0254), (0.25, 4.0), ("ft", 1 / 0.3048)],
)
def test_units_of_a_mesh(tmp_path, unit, scale):
    from stridetwin.scenarios.scenario_file import read_scenario

    lying(stair(**FOUR_STEPS), scale=scale).export(tmp_path / "stair.stl")
    (tmp_path / "walk.yaml").write_text(
        f"description: a\nterrain: {{mesh: {{file: stair.stl, unit: {unit}, length_m: 4}}}}\nwidth_m: 2\n"
    )
    (flight,) = [s for s in read_scenario(tmp_path / "walk.yaml").config.route.segments if isinstance(s, Stairs)]
    assert flight.heights_m == pytest.approx((0.17,) * 4, abs=1e-6)


TO_AXIS = {
    "x": [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
    "-x": [[0, 0, -1], [1, 0, 0], [0, -1, 0]],
    "-y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
}
"""Rotations that bring the z axis onto another one."""


def rotate(mesh, R):
    mesh.apply_transform(np.block([[np.array(R, float), np.zeros((3, 1))], [0, 0, 0, 1]]))
    return mesh


@pytest.mark.parametrize("up", TO_AXIS)
def test_any_axis_may_point_up(tmp_path, up):
    mesh = rotate(stair(**FOUR_STEPS), TO_AXIS[up])
    segments, _ = mesh_terrain(way(tmp_path / "a.stl", mesh, up=up), 2.4)
    assert [s.heights_m for s in segments if isinstance(s, Stairs)] == [pytest.approx((0.17,) * 4, abs=1e-6)]
    if up == "-z":  # its underside is level
        assert "stairs on its underside: `up: -z`" in mesh_terrain(MeshWay(path=tmp_path / "a.stl"), 2.4)[1]
        return
    with pytest.raises(StrideTwinError, match=f"there is a way with `up: {up}`"):
        mesh_terrain(MeshWay(path=tmp_path / "a.stl"), 2.4)


def test_a_mesh_that_is_inside_out_is_turned(tmp_path):
    mesh = stair(**FOUR_STEPS)
    mesh.invert()
    segments, _ = mesh_terrain(way(tmp_path / "a.stl", mesh), 2.4)
    assert [type(p) for p in segments] == [Level, Stairs, Level, Ramp, Level]


def test_some_inverted_normals_are_named(tmp_path):
    mesh = stair(**FOUR_STEPS)
    faces = mesh.faces.copy()
    faces[-12:] = faces[-12:, ::-1]
    mesh.faces = faces
    with pytest.raises(StrideTwinError, match=r"faces down: are some normals inverted .*there is no way"):
        mesh_terrain(way(tmp_path / "a.stl", mesh), 2.4)


def test_a_mesh_far_away_is_to_be_moved(tmp_path):
    mesh = stair()
    mesh.apply_translation([5e5, 4e6, 300])
    with pytest.raises(StrideTwinError, match=r"within 1000 m; move the mesh to its origin.*there is no way"):
        mesh_terrain(way(tmp_path / "a.stl", mesh), 2.4)


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_gltf_has_y_up(tmp_path, suffix):
    mesh = lying(stair(), y_up=True)
    file = tmp_path / f"a.{suffix}"
    exported = mesh.export(file_type=suffix)
    for name, data in ({file.name: exported} if suffix == "glb" else exported).items():
        (tmp_path / (file.name if name == "model.gltf" else name)).write_bytes(data)
    segments, _ = mesh_terrain(MeshWay(path=file), 2.4)
    assert [type(p) for p in segments] == [Level, Stairs, Level, Ramp, Level]
    with pytest.raises(StrideTwinError, match=r"with up: z .*there is a way with `up: y`"):
        mesh_terrain(MeshWay(path=file, up="z"), 2.4)


def gltf(**changes):
    """The text of a glTF file of one triangle, whose numbers are in the text."""
    numbers = np.array([[0, 0, 0], [1, 0, 0], [0, 0, -1]], "<f4").tobytes()
    header = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": len(numbers)}],
        "buffers": [{"uri": f"data:;base64,{base64.b64encode(numbers).decode()}", "byteLength": len(numbers)}],
    }
    return json.dumps(header | changes).encode()


MANY = {"componentType": 5126, "count": 2_000_000_000, "type": "VEC3"}


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("a.glb", b"glTF", "no GLB mesh"),
        ("a.gltf", b"[1]", "no GLTF mesh"),
        ("a.gltf", b"[" * 100_000, "no GLTF mesh"),
        ("a.gltf", gltf(accessors=[MANY]), "elements declared"),
        ("a.gltf", gltf(nodes=[{"mesh": 0}] * 200_000), "nodes declared"),
        ("a.gltf", gltf(nodes=[{"mesh": 0, "children": [0] * 200_000}]), "nodes declared"),
        ("a.gltf", gltf(meshes=[{"primitives": [{"attributes": {"POSITION": 0}}] * 200_000}]), "nodes declared"),
        ("a.gltf", gltf(nodes=[{"mesh": 7}]), "no GLTF mesh"),
        ("a.gltf", gltf(buffers=[{"uri": "../secret.bin", "byteLength": 36}]), "files in the same folder"),
        ("a.gltf", gltf(buffers=[{"uri": "missing.bin", "byteLength": 36}]), "missing.bin: cannot be read"),
        ("a.gltf", gltf(extensionsRequired=["KHR_draco_mesh_compression"]), "geometry that is not packed"),
    ],
)
def test_hostile_gltf_is_refused(tmp_path, name, data, said):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(StrideTwinError, match=said):
        mesh_terrain(MeshWay(path=tmp_path / name), 2.4)


def test_a_scenario_takes_a_mesh_and_reports_its_replacement(tmp_path):
    from stridetwin.scenarios.scenario_file import read_scenario

    stair().export(tmp_path / "stair.stl")
    file = tmp_path / "walk.yaml"
    file.write_text("description: a\nterrain: {mesh: {file: stair.stl, length_m: 7.5}}\nwidth_m: 2\n")
    scenario = read_scenario(file)
    assert any(isinstance(s, Stairs) for s in scenario.config.route.segments)
    assert "replaced by exact boxes and wedges" in scenario.notes[0]
    file.write_text("description: a\nterrain: {mesh: {file: stair.stl, unit: furlong}}\n")
    with pytest.raises(StrideTwinError, match=r"walk.yaml: terrain.mesh.unit: invalid 'furlong': expected m, mm, cm"):
        read_scenario(file)
    assert np.isfinite(scenario.config.route.width_m)
