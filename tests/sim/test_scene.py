"""The scene of a walk as MJCF: the twin's model, which MuJoCo alone loads and steps."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.plain_mujoco import load
from stridetwin.cli.main import main
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.composition import compose
from stridetwin.sim.config import Exo, Level, Person, Route, Stairs, TwinConfig
from stridetwin.sim.rendering.renderer import mount_pose, swap_camera_convention
from stridetwin.sim.scene.exact_xml import format_numbers
from stridetwin.sim.scene.scene_files import scene_files, write_scene
from stridetwin.sim.wearer.body import compile_model
from stridetwin.streams.errors import StrideTwinError

ROOT = Path(__file__).parents[2]
ROUTE = Route(segments=(Level(length_m=2.0), Stairs(risers=3), Level(length_m=2.0)))
OWN_EXO = """description: Own exoskeleton
terrain: [{level: {length_m: 1.5}}]
exo: {model: MODEL.xml, rig: MODEL.yaml}
sensors: {exo_imu: true}
"""


def config(**rest: object) -> TwinConfig:
    return TwinConfig(name="walk", **{"route": ROUTE, **rest})  # type: ignore[arg-type]


def own_exo(folder: Path) -> TwinConfig:
    path = folder / "own.yaml"
    path.write_text(OWN_EXO.replace("MODEL", str(ROOT / "examples/own_exo/my_exo")))
    return load_scenario(str(path)).config


CONFIGS = {
    "standard": config(),
    "modules": config(exo=Exo(mode=1), person=Person(height_m=1.93, mass_kg=104), rig_mount="chest"),
    "bare": config(exo=None),
    "crowd": config(route=replace(ROUTE, bystanders=2, scenery="room", texture="plain")),
}


@pytest.fixture(scope="module", params=[*CONFIGS, "own"])
def walk(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[TwinConfig, Path]:
    """A configuration, and its scene on disk."""
    folder = tmp_path_factory.mktemp(request.param)
    what = own_exo(folder) if request.param == "own" else CONFIGS[request.param]
    write_scene(scene_files(what, texture_px=16), what.name, folder)
    return what, folder / f"{what.name}.xml"


@pytest.fixture
def twins(walk: tuple[TwinConfig, Path]) -> mujoco.MjModel:
    """The model that the twin compiles."""
    return compile_model(compose(walk[0]).spec)


@pytest.fixture
def scene(walk: tuple[TwinConfig, Path]) -> mujoco.MjModel:
    """The model that MuJoCo reads."""
    return mujoco.MjModel.from_xml_path(str(walk[1]))


def test_bodies_masses_geoms_and_joints_are_the_twins(twins: mujoco.MjModel, scene: mujoco.MjModel) -> None:
    for kind, count in (("body", twins.nbody), ("geom", twins.ngeom), ("joint", twins.njnt)):
        names = [[getattr(model, kind)(i).name for i in range(count)] for model in (twins, scene)]
        assert names[0] == names[1]
    arrays = [name for name in dir(twins) if name.startswith(("body_", "geom_", "jnt_", "dof_", "qpos"))]
    assert len(arrays) > 70
    for name in arrays:
        if name != "geom_matid":  # the wearer's materials are listed after the terrain's
            np.testing.assert_allclose(getattr(scene, name), getattr(twins, name), rtol=1e-12, atol=1e-13, err_msg=name)
    assert materials(scene) == materials(twins)


def materials(model: mujoco.MjModel) -> list[str]:
    """Materials by geom; a geom without one has its own colour, compared above."""
    return [model.mat(m).name if m >= 0 else "" for m in model.geom_matid.tolist()]


def test_visible_terrain_has_the_twins_faces_texture_and_shading(twins: mujoco.MjModel, scene: mujoco.MjModel) -> None:
    names = [name for i in range(twins.nmesh) if (name := twins.mesh(i).name).startswith("scenery_")]
    assert len(names) > 4
    for name in names:
        for found, wanted in zip(faces(scene, name), faces(twins, name)):
            np.testing.assert_allclose(found, wanted, atol=3e-6)


def faces(model: mujoco.MjModel, name: str) -> list[np.ndarray]:
    """Smallest and largest coordinate, texture coordinate and normal of each rectangle of a mesh.

    They do not depend on the diagonal by which MuJoCo cuts it.
    """
    mesh = model.mesh(name).id
    rows = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    return [
        extreme(values[first[mesh] + indices[rows]].reshape(-1, 6, values.shape[1]), axis=1)
        for extreme in (np.min, np.max)
        for values, first, indices in (
            (model.mesh_vert, model.mesh_vertadr, model.mesh_face),
            (model.mesh_texcoord, model.mesh_texcoordadr, model.mesh_facetexcoord),
            (model.mesh_normal, model.mesh_normaladr, model.mesh_facenormal),
        )
    ]


def test_scene_stands_for_a_second_in_a_process_without_stridetwin(walk: tuple[TwinConfig, Path]) -> None:
    (found,) = load([walk[1]], seconds=1.0)
    assert found["finite"]
    assert found["warnings"] == 0
    assert found["moved_m"] < 0.05  # the pelvis, of a person who stands on servos
    assert {"foot_l_imu", "foot_r_sonar", "foot_l_board"} < set(found["sites"])
    assert {"foot_l_camera", "foot_r_camera"} < set(found["cameras"])


def test_cameras_look_where_the_twins_look_and_as_far(walk: tuple[TwinConfig, Path], scene: mujoco.MjModel) -> None:
    data = mujoco.MjData(scene)
    mujoco.mj_forward(scene, data)
    rig = compose(walk[0]).sensor_rig.rig
    assert len(rig.cameras) == scene.ncam == 3
    for topic, camera in rig.cameras.items():
        found = data.camera(topic.strip("/").replace("/", "_"))
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = found.xmat.reshape(3, 3), found.xpos
        np.testing.assert_allclose(swap_camera_convention(T), mount_pose(data, camera.mount), atol=1e-9)
        fovy = math.radians(scene.cam_fovy[found.id])
        assert 0.5 * camera.height / math.tan(0.5 * fovy) == pytest.approx(camera.intrinsics[1], rel=1e-6)
        assert scene.cam_resolution[found.id].tolist() == [camera.width, camera.height]


def test_imu_sites_sense_gravity_where_the_rig_mounts_them(
    walk: tuple[TwinConfig, Path], scene: mujoco.MjModel
) -> None:
    data = mujoco.MjData(scene)
    mujoco.mj_resetDataKeyframe(scene, data, 0)
    mujoco.mj_step(scene, data, 1000)
    for topic, imu in compose(walk[0]).sensor_rig.rig.imus.items():
        name = topic.strip("/").replace("/", "_")
        up = data.site(name).xmat.reshape(3, 3).T @ [0.0, 0.0, 9.81]
        assert np.abs(data.sensor(f"{name}_accelerometer").data - up).max() < 0.5
        body = data.body(imu.mount.body)
        p = body.xmat.reshape(3, 3) @ imu.mount.T_body_sensor[:3, 3] + body.xpos
        np.testing.assert_allclose(data.site(name).xpos, p, atol=1e-9)


@pytest.mark.parametrize("name", ["demo", "stair_up_down", "ramp_up_down"])
def test_scenes_in_the_repository_are_those_that_the_command_writes(name: str, tmp_path: Path) -> None:
    folder = ROOT / "assets/mjcf/scenes"
    assert main(["scene", name, "--texture-px", "64", "-o", str(tmp_path)]) == 0
    written = {path.relative_to(tmp_path): path for path in tmp_path.rglob("*") if path.is_file()}
    assert len(written) > 10
    for place, path in written.items():
        assert (folder / place).read_bytes() == path.read_bytes(), place


def test_scenes_in_the_repository_are_small() -> None:
    sizes = [path.stat().st_size for path in (ROOT / "assets/mjcf/scenes").rglob("*") if path.is_file()]
    assert sum(sizes) < 300e3


def test_another_wearer_does_not_share_the_folder(tmp_path: Path) -> None:
    write_scene(scene_files(CONFIGS["standard"], 16), "walk", tmp_path)
    write_scene(scene_files(replace(CONFIGS["standard"], name="other"), 16), "other", tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.xml")}
    with pytest.raises(StrideTwinError, match=r"wearer\.xml: .*: expected an empty folder, or one with scenes of"):
        write_scene(scene_files(replace(CONFIGS["bare"], name="third"), 16), "third", tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.xml")} == before


def test_a_scenario_called_wearer_is_refused() -> None:
    with pytest.raises(StrideTwinError, match="invalid 'wearer': expected another one"):
        scene_files(replace(CONFIGS["bare"], name="wearer"), 16)


def test_numbers_have_the_digits_that_they_need() -> None:
    assert format_numbers(np.array([0.92, 1.0], np.float32)) == "0.92 1"
    assert format_numbers([-0.0, 0.1 + 0.2, 1e-13]) == "0 0.30000000000000004 1e-13"
