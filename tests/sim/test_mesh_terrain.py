"""A mesh becomes exact boxes and wedges, with its error reported; what cannot be replaced or trusted is refused."""

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
