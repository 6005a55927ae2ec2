"""Images of the twin: calibrated sensor views with colour and depth from one render, and a film camera.

A sensor view needs no camera in the model: it is drawn from any pose with any pinhole intrinsics, so that a
mount can move without compiling again. Rendering is off screen, by EGL, or by OSMesa where there is no EGL;
the environment variable MUJOCO_GL overrules that. An OpenGL context belongs to the thread that made it.
"""

from __future__ import annotations

import ctypes.util
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Self

import cv2
import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from stridetwin.sim.wearer.sensor_bodies import UPPERS
from stridetwin.sim.world.obstacles import GLASS
from stridetwin.sim.world.textures import PERIOD_M
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.rig import Mount
from stridetwin.streams.samples import Array

NEAR_M = 0.02  # distance of the near plane of a view
FAR_M = 200.0  # distance of the far plane
SEEN_M = 50.0  # largest depth
_MAX_GEOMS = 2000  # largest number of shapes in a scene
_GROUND_M = 81 * PERIOD_M  # half an edge of the rendered ground; odd, otherwise its texture is half a period off
_FILM_GROUND_M = 2001 * PERIOD_M  # likewise in a film, which has no haze: its edge is at the horizon
_FILM_SCALE = 1.5  # rendered pixels per pixel of a film, along each axis, for smooth edges
_HIDDEN_GROUP = 5  # of geoms; not rendered by default
_OPTICAL_MUJOCO = np.diag([1.0, -1.0, -1.0, 1.0])  # (4, 4) between optical axes and those of a camera in MuJoCo

_LEVELS = 2048  # number of the sky's colours, evenly over the sine of the elevation
_SIDES, _UP, _DOWN = (0, 1, 4, 5), 2, 3  # faces of MuJoCo's sky box
_EDGE = math.sqrt(0.5)  # edge of MuJoCo's endless planes, as a share of the far plane's distance

Rgb = NDArray[np.uint8]
DepthImage = NDArray[np.float32]
Intrinsics = tuple[float, float, float, float]
"""(fu, fv, pu, pv) in pixels; the centre of the top-left pixel is (0, 0)."""


def swap_camera_convention(T: ArrayLike) -> Array:
    """(..., 4, 4) pose of a camera in the other convention: of MuJoCo (x right, y up, looks down −z) or optical."""
    return np.asarray(T, dtype=float) @ _OPTICAL_MUJOCO


@dataclass(frozen=True, kw_only=True)
class _Quality:
    """Render settings that a context takes from the model when it is created.

    There are no multisamples: they blur depth at discontinuities, and in software they take more time than a larger
    image that is scaled down.

    Attributes:
        shadow_size: Edge of the shadow map, pixels; 0 for no shadows.
        slices: Facets about the axis of round shapes.
        stacks: Facets along it.
    """

    shadow_size: int
    slices: int
    stacks: int


_SENSOR = _Quality(shadow_size=0, slices=12, stacks=8)
_SHADED_SENSOR = replace(_SENSOR, shadow_size=1024)
_FILM = _Quality(shadow_size=1024, slices=16, stacks=10)


class _OffScreen:
    """OpenGL context and scene for one image size; freed by `close` or at the end of a `with` block.

    Args:
        model: The scene.
        width: Of the largest image, pixels.
        height: Of the largest image, pixels.
        quality: Render settings.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int, quality: _Quality) -> None:
        """Creates the context; it takes image size and quality from the model, which has them only meanwhile."""
        self.model, self.width, self.height = model, width, height
        self._gl = _gl_context(width, height)
        self._gl.make_current()
        with _temporary_quality(model, width, height, quality):
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        # the z-buffer is read with 0 at the far plane
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR.value
        self._rect = mujoco.MjrRect(0, 0, width, height)
        self.scene = mujoco.MjvScene(model, _MAX_GEOMS)
        self.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        self.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = quality.shadow_size > 0
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0

    def update(self, data: mujoco.MjData, camera: mujoco.MjvCamera) -> None:
        """Copies the poses of the bodies and of the camera to the scene."""
        mujoco.mjv_updateScene(
            self.model, data, self._option, None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, self.scene
        )

    def draw(self, rgb: Rgb | None, depth: DepthImage | None, rect: mujoco.MjrRect | None = None) -> None:
        """Renders the scene into upside-down images.

        Args:
            rgb: (h, w, 3) image; None for none.
            depth: (h, w) z-buffer; None for none.
            rect: Size of the images, up to that of the context, which is the default.
        """
        rect = rect or self._rect
        self._gl.make_current()
        mujoco.mjr_render(rect, self.scene, self._context)
        mujoco.mjr_readPixels(rgb, depth, rect, self._context)

    def close(self) -> None:
        """Frees the context; may be called repeatedly."""
        if self._gl is not None:
            self._gl.make_current()
            self._context.free()
            self._gl.free()
            self._gl = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class SensorView(_OffScreen):
    """Renders the view of a calibrated camera: no reflections or smoothing, so that depth is exact.

    The sky is painted afterwards (`_Sky`).

    Args:
        model: The scene.
        width, height: Size of the largest image, pixels.
        shadows: Whether the sun casts shadows, which doubles the time of an image.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int, *, shadows: bool = False) -> None:
        """Creates the context with bounded planes, and reads the sky from the model."""
        self._endless, self._shadows = _endless_planes(model), shadows  # geoms that are drawn bounded
        with _bound_planes(model, self._endless, _GROUND_M):
            super().__init__(model, width, height, _SHADED_SENSOR if shadows else _SENSOR)
        self._anywhere = mujoco.MjvCamera()  # only for `update`; `_place_camera` then sets the pose itself
        self._glass = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM.value, f"scenery_{GLASS}")  # -1: none
        self.scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = False
        self._sky = _Sky.of(model, FAR_M)

    def frame(
        self,
        data: mujoco.MjData,
        T_world_camera: ArrayLike,
        intrinsics: Intrinsics,
        size: tuple[int, int] | None = None,
    ) -> tuple[Rgb, DepthImage]:
        """Colour and depth from one render.

        Args:
            data: State of the model, kinematics up to date.
            T_world_camera: (4, 4) pose of the optical frame in the world.
            intrinsics: (fu, fv, pu, pv) of the image, pixels.
            size: (W, H) of the image, up to the view's own, which is the default.

        Returns:
            (H, W, 3) uint8 RGB, and (H, W) float32 depth along the optical axis, m, through glass; 0 where no
            surface is nearer than `SEEN_M`.
        """
        rgb, depth = self._render_view(data, T_world_camera, intrinsics, *(size or (self.width, self.height)))
        depth[depth > SEEN_M] = 0
        return rgb, depth

    def color(
        self,
        data: mujoco.MjData,
        T_world_camera: ArrayLike,
        intrinsics: Intrinsics,
        size: tuple[int, int] | None = None,
    ) -> Rgb:
        """Colour alone, (H, W, 3) uint8 RGB, for cameras without depth.

        Args:
            data: State of the model, kinematics up to date.
            T_world_camera: (4, 4) pose of the optical frame in the world.
            intrinsics: (fu, fv, pu, pv) of the image, pixels.
            size: (W, H) of the image, up to the view's own, which is the default.
        """
        return self._render_view(data, T_world_camera, intrinsics, *(size or (self.width, self.height)))[0]

    def crop(
        self, data: mujoco.MjData, T_world_camera: ArrayLike, intrinsics: Intrinsics, rows: slice, columns: slice
    ) -> Rgb:
        """Colour of some rows and columns of the image, (h, w, 3) uint8 RGB; faster, with the pixels of `color`.

        Args:
            data: State of the model, kinematics up to date.
            T_world_camera: (4, 4) pose of the optical frame in the world.
            intrinsics: (fu, fv, pu, pv) of the full image, pixels.
            rows: Rows to render.
            columns: Columns to render.
        """
        fu, fv, pu, pv = intrinsics
        width, height = columns.stop - columns.start, rows.stop - rows.start
        shifted = fu, fv, pu - columns.start, pv - rows.start
        return self._render_view(data, T_world_camera, shifted, width, height)[0]

    def _render_view(
        self, data: mujoco.MjData, T_world_camera: ArrayLike, intrinsics: Intrinsics, width: int, height: int
    ) -> tuple[Rgb, DepthImage]:
        """Colours (height, width, 3), and depth along the optical axis (height, width), m.

        Depth is inf where nothing is rendered. Glass is drawn in colour, but depth is that of what lies behind it.
        """
        rgb, z = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
        rect = mujoco.MjrRect(0, 0, width, height)
        self._place_camera(data, T_world_camera, intrinsics, width, height)
        self.draw(rgb, z, rect)
        if self._glass >= 0:  # a pane writes its own depth
            self._place_camera(data, T_world_camera, intrinsics, width, height, hidden=self._glass)
            self.draw(None, z, rect)
        rgb, depth = np.ascontiguousarray(rgb[::-1]), _metric_depth(z)
        if self._sky is not None:
            self._sky.paint(rgb, depth, np.asarray(T_world_camera, float), intrinsics)
        return rgb, depth

    def _place_camera(
        self,
        data: mujoco.MjData,
        T_world_camera: ArrayLike,
        intrinsics: Intrinsics,
        width: int,
        height: int,
        hidden: int | None = None,
    ) -> None:
        """Copies the poses of the visible bodies to the scene, and places the camera in it.

        Args:
            data: State of the model.
            T_world_camera: (4, 4) pose of the optical frame.
            intrinsics: Of the image.
            width: Of the image, pixels.
            height: Of the image, pixels.
            hidden: Geom that is left out, such as a pane of glass.
        """
        shown = self.model.geom_group.copy()  # to restore the groups afterwards
        if hidden is not None:
            self.model.geom_group[hidden] = _HIDDEN_GROUP
        if not self._shadows:  # what is out of view may cast a shadow into it
            seen = _find_geoms_in_view(self.model, data, np.asarray(T_world_camera), intrinsics, width, height)
            self.model.geom_group[~seen] = _HIDDEN_GROUP
        with _bound_planes(self.model, self._endless, _GROUND_M, data, np.asarray(T_world_camera)[:2, 3]):
            self.update(data, self._anywhere)
        self.model.geom_group[:] = shown
        T_world_mujoco = swap_camera_convention(T_world_camera)
        fu, fv, pu, pv = intrinsics
        for camera in self.scene.camera:  # the left and the right eye, which a mono view averages
            camera.pos = T_world_mujoco[:3, 3]
            camera.forward, camera.up = -T_world_mujoco[:3, 2], T_world_mujoco[:3, 1]
            # The borders of the view on the near plane, m from its axis; they lie half a pixel outside the outermost
            # pixel centres. MuJoCo takes half the width.
            camera.frustum_top = NEAR_M * (pv + 0.5) / fv
            camera.frustum_bottom = NEAR_M * (pv + 0.5 - height) / fv
            camera.frustum_center = NEAR_M * (width / 2 - pu - 0.5) / fu
            camera.frustum_width = NEAR_M * width / 2 / fu
            camera.frustum_near, camera.frustum_far = NEAR_M, FAR_M


class FilmCamera(_OffScreen):
    """Third-person view with shadows and smooth edges, for viewers.

    Args:
        model: The scene.
        width: Of the images, pixels.
        height: Of the images, pixels.
    """

    def __init__(self, model: mujoco.MjModel, width: int = 1280, height: int = 720) -> None:
        """Creates a context of `_FILM_SCALE` times the size of the images, which are scaled down."""
        # endless planes of the model, and (W, H) of the images
        self._endless, self._size = _endless_planes(model), (width, height)
        with _bound_planes(model, self._endless, _FILM_GROUND_M):
            super().__init__(model, round(_FILM_SCALE * width), round(_FILM_SCALE * height), _FILM)
        self._camera = mujoco.MjvCamera()

    def frame(self, data: mujoco.MjData, lookat: ArrayLike, azimuth: float, elevation: float, distance: float) -> Rgb:
        """Renders one image of the film.

        Args:
            data: State of the model, kinematics up to date.
            lookat: (3,) point in the world at the centre of the image, m.
            azimuth: Direction of view about the vertical, degrees; 0 looks along +x, 90 along +y.
            elevation: Degrees; negative looks down.
            distance: From the camera to `lookat`, m.

        Returns:
            (H, W, 3) uint8 RGB.
        """
        self._camera.lookat[:] = lookat
        self._camera.azimuth, self._camera.elevation, self._camera.distance = azimuth, elevation, distance
        with _bound_planes(self.model, self._endless, _FILM_GROUND_M, data, np.asarray(lookat)[:2]):
            self.update(data, self._camera)
        rgb = np.empty((self.height, self.width, 3), np.uint8)
        self.draw(rgb, None)
        return np.asarray(cv2.resize(rgb[::-1], self._size, interpolation=cv2.INTER_AREA), np.uint8)


def mount_pose(data: mujoco.MjData, mount: Mount, T_body_frame: ArrayLike | None = None) -> Array:
    """(4, 4) pose in the world of a camera's optical frame or a board, from the body that carries it.

    Args:
        data: State of the model, kinematics up to date.
        mount: Its mount.
        T_body_frame: (4, 4) pose on the body of the frame that holds the mount, after slips.
    """
    # what is mounted on a foot moves with the upper of the shoe
    body, T_world_body = data.body(UPPERS.get(mount.body, mount.body)), np.eye(4)
    T_world_body[:3, :3], T_world_body[:3, 3] = body.xmat.reshape(3, 3), body.xpos
    T_world_frame = T_world_body if T_body_frame is None else T_world_body @ np.asarray(T_body_frame)
    return T_world_frame @ mount.T_body_sensor


@contextmanager
def _bound_planes(
    model: mujoco.MjModel,
    endless: NDArray[np.intp],
    half_m: float,
    data: mujoco.MjData | None = None,
    about: ArrayLike = (0.0, 0.0),
) -> Iterator[None]:
    """Bounds endless level planes within a `with` block; MuJoCo would draw them as 40 000 tiles.

    Args:
        model: The scene.
        endless: Its endless planes.
        half_m: Half an edge of the bounded planes, an odd number of texture periods.
        data: State whose planes are moved, too.
        about: (2,) place in the world at the middle of the planes, rounded to texture periods.
    """
    sizes = model.geom_size[endless]  # half edges x and y, and the spacing of the grid
    model.geom_size[endless] = half_m, half_m, 2 * half_m
    if data is not None:
        places = data.geom_xpos[endless]
        # whole periods, so that the texture stays where it is in the world
        data.geom_xpos[endless, :2] += PERIOD_M * np.round((about - places[:, :2]) / PERIOD_M)
    try:
        yield
    finally:
        model.geom_size[endless] = sizes
        if data is not None:
            data.geom_xpos[endless] = places


def _find_geoms_in_view(
    model: mujoco.MjModel, data: mujoco.MjData, T_world_camera: Array, intrinsics: Intrinsics, width: int, height: int
) -> NDArray[np.bool_]:
    """(ngeom,) whether the bounding sphere of a geom reaches into the view frustum.

    Drawing the others would cost as much as drawing these.

    Args:
        model: The scene.
        data: Its state.
        T_world_camera: (4, 4) pose of the optical frame.
        intrinsics: Of the image.
        width: Of the image, pixels.
        height: Of the image, pixels.
    """
    fu, fv, pu, pv = intrinsics
    # inward normals of the left, right, upper and lower side of the frustum, and of the plane through the camera
    inward = np.array([
        [fu, 0.0, pu + 0.5], [-fu, 0.0, width - 0.5 - pu], [0.0, fv, pv + 0.5], [0.0, -fv, height - 0.5 - pv],
        [0.0, 0.0, 1.0],
    ])  # fmt: skip
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    centre = (data.geom_xpos - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]  # of each geom, camera axes
    reach = np.where(model.geom_rbound > 0, model.geom_rbound, np.inf)  # 0: a plane, which has no end
    return np.asarray(np.all(centre @ inward.T >= -reach[:, None], axis=1))


@entry_kernel(__file__, error_model="numpy")
def _metric_depth(z: DepthImage) -> DepthImage:
    """(H, W) m, depth along the optical axis from an upside-down z-buffer z: near far / (z (far − near) + near).

    In the z-buffer 1 is the near plane and 0 the far one, which becomes inf.
    """
    near, far = np.float32(NEAR_M), np.float32(FAR_M)
    depth = np.empty_like(z)
    for i in range(len(z)):
        row, z_row = depth[i], z[len(z) - 1 - i]
        for j in range(z.shape[1]):
            away = near * far / (z_row[j] * (far - near) + near)
            row[j] = away if z_row[j] > 0 else np.float32(np.inf)
    return depth


def _gl_context(width: int, height: int) -> Any:
    """Off-screen OpenGL context: of the library in MUJOCO_GL, otherwise EGL, otherwise OSMesa."""
    if os.environ.get("MUJOCO_GL"):
        from mujoco.gl_context import GLContext
    elif ctypes.util.find_library("EGL"):
        from mujoco.egl import GLContext
    else:
        from mujoco.osmesa import GLContext
    return GLContext(width, height)


@contextmanager
def _temporary_quality(model: mujoco.MjModel, width: int, height: int, quality: _Quality) -> Iterator[None]:
    """Sets image size and quality of the model within a `with` block, and restores them."""
    screen, look = model.vis.global_, model.vis.quality
    # (part of the model's visual settings, name of a setting, its value within the block)
    values = (
        (screen, "offwidth", width), (screen, "offheight", height), (look, "offsamples", 0),
        (look, "shadowsize", quality.shadow_size), (look, "numslices", quality.slices),
        (look, "numstacks", quality.stacks),
    )  # fmt: skip
    kept = [(group, name, getattr(group, name)) for group, name, _ in values]
    for group, name, value in values:
        setattr(group, name, value)
    try:
        yield
    finally:
        for group, name, value in kept:
            setattr(group, name, value)


def _endless_planes(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Geoms of a model that are endless planes."""
    return np.flatnonzero((model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_size[:, 0] == 0))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Sky:
    """A sky without dependence on azimuth, and the haze at the edge of the ground.

    MuJoCo first draws the sky over the whole image, and everything else on top of it, which costs a third of a
    software-rendered frame. A sensor view omits it and paints it here where nothing else was rendered.

    Attributes:
        colours: (N, 3) uint8 RGB, evenly over the sine of the elevation from straight down to straight up.
        ground: Height of the endless ground in the world, m; -inf without one, and then there is no haze.
        edge: Distance of its edge, m.
        depth: Width of the haze in front of that edge, as a share of its distance.
        haze: (3,) RGB, 0-255.
    """

    colours: NDArray[np.uint8]
    ground: float
    edge: float
    depth: float
    haze: Array

    @classmethod
    def of(cls, model: mujoco.MjModel, far: float) -> Self | None:
        """The sky box of a model, averaged over azimuth; None without one. The far plane is at `far` m."""
        boxes = np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)
        if not len(boxes):
            return None
        # edge of a face, pixels, and where the texture begins in the data of all; six square faces of three channels
        width, first = int(model.tex_width[boxes[0]]), int(model.tex_adr[boxes[0]])
        faces = model.tex_data[first : first + 18 * width * width].reshape(6, width, width, 3)
        # sine of the elevation of each pixel of the six faces of the sky box, a cube of half edge 1
        along = (2 * np.arange(width) + 1) / width - 1
        column, row = np.meshgrid(along, along)
        length = np.sqrt(1 + column**2 + row**2)
        rise = np.empty((6, width, width))
        rise[_SIDES, :], rise[_UP], rise[_DOWN] = -row / length, 1 / length, -1 / length
        # mean colour of all pixels of one elevation
        sines, sine_of_pixel = np.unique(np.round(rise.ravel(), 6), return_inverse=True)
        counts = np.bincount(sine_of_pixel)
        channels = [np.bincount(sine_of_pixel, faces[..., i].ravel()) / counts for i in range(3)]
        colours = np.stack([np.interp(np.linspace(-1, 1, _LEVELS), sines, channel) for channel in channels], axis=1)
        return cls(
            colours=np.round(colours).astype(np.uint8),
            ground=float(model.geom_pos[_endless_planes(model), 2].max(initial=-np.inf)),
            edge=_EDGE * far,
            depth=float(model.vis.map.haze),
            haze=255.0 * model.vis.rgba.haze[:3],
        )

    def paint(
        self,
        rgb: NDArray[np.uint8],
        depth: NDArray[np.float32],
        T_world_camera: Array,
        intrinsics: tuple[float, float, float, float],
    ) -> None:
        """Colours in place the pixels of an image where nothing was rendered, and the far ground.

        Args:
            rgb: (H, W, 3) image, which is painted on.
            depth: (H, W) m along the optical axis, inf where nothing was rendered.
            T_world_camera: (4, 4) pose of the optical frame.
            intrinsics: (fu, fv, pu, pv) of the image, pixels.
        """
        # distance of the ground's edge over the camera's height above the ground; 0 without ground
        steepness = max(self.edge / max(T_world_camera[2, 3] - self.ground, 1e-3), 0.0)
        _paint(
            rgb,
            depth,
            self.colours,
            np.ascontiguousarray(T_world_camera[2, :3], float),
            np.array(intrinsics, float),
            steepness,
            self.edge,
            self.depth,
            self.haze,
        )


@entry_kernel(__file__)
def _paint(
    rgb: NDArray[np.uint8],
    depth: NDArray[np.float32],
    colours: NDArray[np.uint8],
    vertical: Array,
    intrinsics: Array,
    steepness: float,
    edge: float,
    share: float,
    haze: Array,
) -> None:
    """Colours in place the pixels of an image that show the sky, and those of the ground in the haze.

    A pixel beyond the edge of the ground gets the sky's colour at the sine of its elevation. Between the beginning of
    the haze, (1 − `share`) `edge`, and the horizon, the haze is blended in, most at the edge.

    Args:
        rgb: (H, W, 3) image, which is painted on.
        depth: (H, W) m, inf where nothing was rendered.
        colours: (N, 3) sky by the sine of the elevation.
        vertical: (3,) world's vertical in camera axes.
        intrinsics: (4,) fu, fv, pu, pv.
        steepness: Distance of the ground's edge over the camera's height.
        edge: Distance of the ground's edge, m.
        share: Width of the haze as a share of that distance.
        haze: (3,) RGB of the haze.
    """
    fu, fv, pu, pv = intrinsics
    # half the number of colours, from a sine to its colour. Pixels nearer than half the distance of the haze are
    # skipped: a ray is at most about twice as long as its depth
    half, near = np.float32((len(colours) - 1) / 2), np.float32(0.5 * (1 - share) * edge)
    slope, across, middle, top = np.float32(vertical[0]), np.float32(1 / fu), np.float32(pu), len(colours) - 1
    for row in range(depth.shape[0]):
        y = (row - pv) / fv
        # parts of the ray's vertical part and of its squared length that are common to the row
        level, base = np.float32(vertical[1] * y + vertical[2]), np.float32(1 + y * y)
        for column in range(depth.shape[1]):
            away = depth[row, column]
            if away < near:
                continue
            x = (np.float32(column) - middle) * across
            # the ray (x, y, 1): its vertical part, squared length, and horizontal part
            up, squared = slope * x + level, x * x + base
            flat = np.sqrt(squared - up * up)
            if away * flat > edge:  # beyond the edge of the ground: the sky
                i = int(half * (up / np.sqrt(squared) + np.float32(1)) + np.float32(0.5))
                for k in range(3):
                    rgb[row, column, k] = colours[min(max(i, 0), top), k]
            if up < 0 and away * flat > (1 - share) * edge:  # below the horizon, from the beginning of the haze on
                q = -up / flat * steepness  # 0 at the horizon, 1 at the edge
                # 0 at the horizon, 1 / (1 + share) at the edge, 1 where the haze begins
                s = min(q / (1 + share * q), 1.0)
                # opacity of the haze: it grows from the horizon to the edge, and fades from there to its beginning
                a = s * (1 + share) if q < 1 else (1 - s) * (1 + share) / share
                for k in range(3):
                    rgb[row, column, k] += int(a * (haze[k] - rgb[row, column, k]))
