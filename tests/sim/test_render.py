from importlib import resources

import cv2
import mujoco
import numpy as np
import pytest

from stridetwin.sim.config import Level, Ramp, Route, Stairs, Thing
from stridetwin.sim.rendering import renderer as render
from stridetwin.sim.rendering.renderer import FilmCamera, SensorView, mount_pose, swap_camera_convention
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.rig import CameraCalibration, Mount

OFF_CENTRE = (392.0, 388.0, 331.3, 228.7)


def looking(position, pitch_deg, yaw_deg=0.0):
    """Optical frame at `position` that looks along +x, pitched down and rotated left."""
    pitch, yaw = np.radians([pitch_deg, yaw_deg])
    forward = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    T = np.eye(4)
    T[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    T[:3, 3] = position
    return T


def compiled(spec):
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.fixture(scope="module")
def world():
    route = Route(
        segments=(Level(length_m=3.0), Stairs(risers=4), Level(length_m=1.0), Ramp(angle_rad=0.2, rise_m=0.4))
    )
    terrain = Terrain.from_route(route)
    spec = mujoco.MjSpec()
    terrain.add_to(spec)
    return terrain, *compiled(spec)


def test_swapping_the_convention_turns_about_the_right_axis():
    T = looking([1.0, 2.0, 3.0], 30.0, 20.0)
    mj = swap_camera_convention(T)
    np.testing.assert_allclose(mj[:3, 0], T[:3, 0])  # right stays right
    np.testing.assert_allclose(-mj[:3, 2], T[:3, 2])  # MuJoCo looks down -z
    np.testing.assert_allclose(mj[:3, 1], -T[:3, 1])  # its y is up
    np.testing.assert_allclose(mj[:3, 3], T[:3, 3])
    np.testing.assert_allclose(swap_camera_convention(mj), T)


def test_a_model_camera_and_a_sensor_view_see_the_same():
    spec = mujoco.MjSpec()
    Terrain.from_route(Route(segments=(Level(length_m=2.0),))).add_to(spec)
    spec.worldbody.add_camera(name="eye", pos=[0.2, 0.1, 1.5], quat=[0.6, 0.4, -0.3, -0.5], fovy=60.0)
    model, data = compiled(spec)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.cam("eye").xmat.reshape(3, 3), data.cam("eye").xpos
    focal = 120 / np.tan(np.radians(30))
    with SensorView(model, 320, 240) as view, render._OffScreen(model, 320, 240, render._SENSOR) as plain:
        ours, _ = view.frame(data, swap_camera_convention(T), (focal, focal, 159.5, 119.5))
        camera = mujoco.MjvCamera()
        camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED.value, 0
        plain.update(data, camera)
        theirs = np.empty_like(ours)
        plain.draw(theirs, None)
    assert np.mean(np.abs(ours.astype(int) - theirs[::-1])) < 0.5


def test_discs_land_where_opencv_projects_them():
    T = looking([0.3, -0.2, 1.4], 20.0, 15.0)
    rng = np.random.default_rng(1)
    pixels = np.array([(u, v) for u in (30, 180, 330, 480, 610) for v in (25, 130, 240, 350, 455)], float)
    pixels += rng.uniform(-8, 8, pixels.shape)
    depth = rng.uniform(1.0, 4.0, len(pixels))
    fu, fv, pu, pv = OFF_CENTRE
    in_camera = depth[:, None] * np.column_stack(
        [(pixels[:, 0] - pu) / fu, (pixels[:, 1] - pv) / fv, np.ones(len(pixels))]
    )
    centres = in_camera @ T[:3, :3].T + T[:3, 3]
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, T[:3, :3].ravel())
    spec = mujoco.MjSpec()
    spec.add_material(name="glow", emission=1.0, rgba=[1, 1, 1, 1])
    for centre, z in zip(centres, depth):  # parallel to the image, so that its centre is the disc's centre
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            pos=centre,
            quat=quat,
            size=[16 * z / fu, 1e-4, 0],
            material="glow",
        )
    model, data = compiled(spec)
    with SensorView(model, 640, 480) as view:
        rgb, _ = view.frame(data, T, OFF_CENTRE)
    count, _, _, found = cv2.connectedComponentsWithStats((rgb[..., 0] > 100).astype(np.uint8))
    assert count == len(pixels) + 1
    to_camera = np.linalg.inv(T)
    K = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1.0]])
    expected = cv2.projectPoints(centres, cv2.Rodrigues(to_camera[:3, :3])[0], to_camera[:3, 3], K, None)[0][:, 0]
    error = expected[:, None] - found[None, 1:]
    error = error[np.arange(len(expected)), np.argmin(np.linalg.norm(error, axis=-1), axis=1)]
    assert np.max(np.linalg.norm(error, axis=-1)) < 0.1
    assert np.all(np.abs(error.mean(axis=0)) < 0.02)


def test_depth_is_that_of_the_analytic_terrain(world):
    terrain, model, data = world
    T = looking([1.8, 0.15, 1.65], 25.0, 5.0)
    with SensorView(model, 640, 480) as view:
        rgb, depth = view.frame(data, T, OFF_CENTRE)
        alone = view.color(data, T, OFF_CENTRE)
    np.testing.assert_array_equal(alone, rgb)
    assert depth.dtype == np.float32
    fu, fv, pu, pv = OFF_CENTRE
    v, u = np.mgrid[0:480:3, 0:640:3]
    rays = np.stack([(u - pu) / fu, (v - pv) / fv, np.ones(u.shape)], axis=-1)
    away = terrain.ray_cast(np.broadcast_to(T[:3, 3], (u.size, 3)), rays.reshape(-1, 3) @ T[:3, :3].T)
    expected = away.reshape(u.shape) / np.linalg.norm(rays, axis=-1)
    error = np.abs(depth[::3, ::3] - expected)
    near = expected < 2.5
    assert near.mean() > 0.1
    assert np.mean(error[near] > 0.001) < 0.001  # but for pixels that an outline cuts
    assert np.percentile(error[expected < 6.0], 99) < 0.001


@pytest.mark.parametrize(("pitch", "roll"), [(0.0, 0.0), (3.0, 40.0), (-35.0, 0.0), (-70.0, 120.0)])
def test_the_painted_sky_is_that_of_mujoco(world, pitch, roll):
    _, model, data = world
    T = looking([0.0, 0.0, 1.6], pitch, 20.0)
    T[:3, :3] = T[:3, :3] @ cv2.Rodrigues(np.array([0.0, 0.0, np.radians(roll)]))[0]
    film, intrinsics = render._OffScreen(model, 320, 240, render._SENSOR), (200.0, 200.0, 159.5, 119.5)
    with SensorView(model, 320, 240) as view, film:
        painted, depth = view.frame(data, T, intrinsics)
        film.update(data, mujoco.MjvCamera())
        for ours, theirs in zip(view.scene.camera, film.scene.camera):
            for name in (
                "pos",
                "forward",
                "up",
                "frustum_center",
                "frustum_width",
                "frustum_bottom",
                "frustum_top",
                "frustum_near",
                "frustum_far",
            ):
                setattr(theirs, name, getattr(ours, name))
        drawn = np.empty_like(painted)
        film.draw(drawn, None)
    off = np.abs(painted.astype(int) - drawn[::-1])
    assert np.mean(depth == 0) > 0.2
    assert off[depth == 0].mean() < 1.0
    assert np.percentile(off, 99.5) < 25  # but for the outermost 40 m of the ground, where the haze has corners
    high = looking([0.0, 0.0, 1.6], -5.0)  # a model without a sky stays black
    bare, its_data = compiled(mujoco.MjSpec())
    with SensorView(bare, 32, 24) as view:
        assert not view.color(its_data, high, (40.0, 40.0, 15.5, 11.5)).any()


def test_sky_has_no_depth(world):
    _, model, data = world
    with SensorView(model, 64, 48) as view:
        _, depth = view.frame(data, looking([0.0, 0.0, 1.6], -60.0), (40.0, 40.0, 31.5, 23.5))
    assert np.all(depth == 0)


def test_the_camera_rides_on_its_body():
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="head", pos=[1.0, 2.0, 3.0], quat=[0, 0, 0, 1])
    model, data = compiled(spec)
    mount = Mount(body="head", T_body_sensor=looking([0.1, 0.0, 0.2], 0.0))
    camera = CameraCalibration(
        topic="/head/color", part="", rate_hz=30, mount=mount, width=4, height=4, intrinsics=(1, 1, 1, 1)
    )
    T = mount_pose(data, camera.mount)
    np.testing.assert_allclose(T[:3, 3], [0.9, 2.0, 3.2], atol=1e-12)
    np.testing.assert_allclose(T[:3, 2], [-1.0, 0.0, 0.0], atol=1e-12)
    assert model.nbody == 2


@pytest.mark.parametrize("distance", [0.2, 0.3])
def test_opencv_finds_the_whole_checkerboard(distance):
    text = resources.files("stridetwin.assets").joinpath("mjcf", "checkerboard.xml").read_text()
    spec = mujoco.MjSpec.from_string(text)
    spec.visual.headlight.ambient = [0.7, 0.7, 0.7]
    model, data = compiled(spec)
    tilt = cv2.Rodrigues(np.array([0.25, -0.2, 0.1]))[0] @ np.diag([1.0, -1.0, -1.0])
    T_board_camera = np.eye(4)
    T_board_camera[:3, :3] = tilt.T
    T_board_camera[:3, 3] = -tilt.T @ np.array([0.01, -0.005, distance])
    intrinsics = (540.0, 540.0, 399.5, 299.5)
    with SensorView(model, 800, 600) as view:
        rgb, _ = view.frame(data, T_board_camera, intrinsics)
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    found, corners = cv2.findChessboardCorners(grey, (5, 8))
    assert found
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    corners = cv2.cornerSubPix(grey, corners, (3, 3), (-1, -1), criteria).reshape(-1, 2)
    x, y = np.meshgrid((np.arange(5) - 2) * 0.005, (np.arange(8) - 3.5) * 0.005)
    grid = np.column_stack([x.ravel(), y.ravel(), np.zeros(40)])
    in_camera = grid @ tilt.T + [0.01, -0.005, distance]
    expected = in_camera[:, :2] / in_camera[:, 2:] * 540.0 + [399.5, 299.5]
    nearest = np.linalg.norm(expected[:, None] - corners, axis=-1).min(axis=1)
    assert nearest.max() < 0.5
    assert np.sqrt(np.mean(nearest**2)) < 0.2


def test_film_and_sensor_share_a_model_and_close_twice(world):
    _, model, data = world
    before = model.vis.quality.offsamples, model.vis.global_.offwidth
    film, view = FilmCamera(model, 320, 180), SensorView(model, 160, 120)
    image = film.frame(data, [2.0, 0.0, 0.8], 40.0, -15.0, 4.0)
    rgb, _ = view.frame(data, looking([1.0, 0.0, 1.6], 25.0), (100.0, 100.0, 79.5, 59.5))
    again = film.frame(data, [2.0, 0.0, 0.8], 40.0, -15.0, 4.0)
    assert image.shape == (180, 320, 3)
    assert rgb.std() > 10
    assert image.std() > 10
    np.testing.assert_array_equal(image, again)
    assert (model.vis.quality.offsamples, model.vis.global_.offwidth) == before
    for renderer in (film, view):
        renderer.close()
        renderer.close()


@pytest.mark.parametrize(
    "box", [(slice(100, 228), slice(200, 361)), (slice(0, 31), slice(0, 640)), (slice(470, 480), slice(600, 640))]
)
def test_a_crop_has_the_pixels_of_the_whole_image(world, box):
    _, model, data = world
    with SensorView(model, 640, 480) as view:
        T = looking([1.0, 0.2, 1.6], 25.0, 10.0)
        whole, crop = view.color(data, T, OFF_CENTRE), view.crop(data, T, OFF_CENTRE, *box)
    assert np.mean(np.any(whole[box] != crop, axis=-1)) < 0.02  # a texel's edge may fall to either side
    assert np.mean(np.abs(whole[box].astype(int) - crop)) < 0.3


def test_what_is_out_of_view_is_left_out_and_nothing_else(world, monkeypatch):
    _, model, data = world
    with SensorView(model, 320, 240) as view:
        poses = [looking([x, 0.2, 1.6], 25.0, yaw) for x in (0.0, 2.0) for yaw in (0.0, 80.0, 200.0)]
        culled, shown = [], []
        for T in poses:
            culled.append(view.color(data, T, (196.0, 194.0, 165.0, 114.0)))
            shown.append(view.scene.ngeom)
        monkeypatch.setattr(render, "_find_geoms_in_view", lambda model, *_: np.ones(model.ngeom, bool))
        for T, image, count in zip(poses, culled, shown):
            np.testing.assert_array_equal(view.color(data, T, (196.0, 194.0, 165.0, 114.0)), image)
            assert count <= view.scene.ngeom
        assert min(shown) < view.scene.ngeom


def test_a_view_with_shadows_is_darker_beside_a_pillar_and_has_the_same_depth():
    spec = mujoco.MjSpec()
    Terrain.from_route(Route(segments=(Level(length_m=4.0),))).add_to(spec)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.5], pos=[2.0, 0.0, 0.5])
    model, data = compiled(spec)
    T, intrinsics = looking([0.5, 0.0, 1.6], 40.0), (100.0, 100.0, 79.5, 59.5)
    with SensorView(model, 160, 120) as plain, SensorView(model, 160, 120, shadows=True) as shaded:
        (clear, near), (dark, far) = (view.frame(data, T, intrinsics) for view in (plain, shaded))
    np.testing.assert_array_equal(near, far)
    darker = clear.mean(axis=2) - dark.mean(axis=2) > 20
    assert 50 < darker.sum() < 0.2 * darker.size


def test_a_film_has_smooth_edges_and_ground_up_to_the_horizon(world):
    _, model, data = world
    with FilmCamera(model, 320, 180) as film:
        image = film.frame(data, [2.0, 0.0, 1.6], 90.0, 0.0, 4.0).astype(int)
    green = image[..., 1] - image[..., 2] > 20
    assert green[93, :20].all()  # the horizon is at half the height; two pixels below it are 2 km away
    assert not green[:88, :20].any()


def test_colour_and_depth_show_what_is_behind_glass():
    things = (Thing(kind="glass", at_m=1.5, left_m=2.2), Thing(kind="table", at_m=2.5, left_m=2.2))
    spec = mujoco.MjSpec()
    Terrain.from_route(Route(segments=(Level(length_m=6.0),), things=things)).add_to(spec)
    model, data = compiled(spec)
    seen = []
    with SensorView(model, 640, 480) as view:
        for group in (0, 5):
            model.geom("scenery_glass").group = group
            seen.append(view.frame(data, looking([0.0, 0.0, 1.5], 10.0, 45.0), OFF_CENTRE))
    (through, depth), (clear, bare) = seen
    np.testing.assert_array_equal(depth, bare)
    tinted = np.abs(through.astype(int) - clear).max(axis=-1) > 3
    assert 0.1 < tinted.mean() < 0.9
    assert np.corrcoef(through[tinted].mean(axis=-1), clear[tinted].mean(axis=-1))[0, 1] > 0.95
