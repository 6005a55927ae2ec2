"""Cameras of a rig, rendered from the motion."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Self

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import CameraPart, Imager, RgbdPart
from stridetwin.sim.parts.nominal import depth_scale
from stridetwin.sim.rendering.imager import BLANK, ImageSensor, Pixels, RenderedLens
from stridetwin.sim.rendering.renderer import SensorView, mount_pose
from stridetwin.sim.rendering.stereo_depth import DepthModel
from stridetwin.sim.rendering.sweep import Sweep
from stridetwin.sim.sensors.mount_slip import MountSlips
from stridetwin.sim.sensors.standard_rig import SensorRig
from stridetwin.sim.wearer.sensor_bodies import UPPERS
from stridetwin.sim.world.bystanders import Crowd, pose_crowd
from stridetwin.sim.world.light import LightCourse
from stridetwin.streams.rig import Board, CameraCalibration
from stridetwin.streams.samples import Array, Depth, Image

# (8, 3) m, corners of a box around a board, in the board's frame
_AROUND_BOARD = np.array([[x, y, z] for x in (-0.024, 0.024) for y in (-0.032, 0.032) for z in (-0.003, 0.0)])
_MARGIN_PX = 16  # around a board that is rendered alone
_EDGE_ON = 0.2  # cosine of the view onto a board, below which only its position matters for motion blur
_LEAST_M = 0.03  # least distance of a board that counts as visible
_FAR_M = 10.0  # assumed distance of a scene without depth, for motion blur
_NOTHING, _AHEAD = np.zeros(3), np.array([0.0, 0.0, 1.0])  # no velocity, and the viewing direction in optical axes
_SURROUNDINGS_M = 0.5  # assumed distance from a shoe's camera to everything but the board, for motion blur


@dataclass(frozen=True, kw_only=True)
class FrameRequest:
    """One frame to render.

    Attributes:
        t_ns, topic: Time of the frame, and topic of the camera.
        twist: (2, 6) velocity of the origin (world axes, m/s) and angular rate (own axes, rad/s), first of the body
            that carries the camera (the upper of a shoe, for a camera on a foot), then of the body with the board.
    """

    t_ns: int
    topic: str
    twist: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Patch:
    """The rendered part of an otherwise empty image; it is about a hundredth of the data to send between processes.

    Attributes:
        topic, t_ns: Topic and time of the image.
        shape: (H, W) size of the full image.
        pixels: (h, w) grey values of the rendered part.
        row, column: Upper left pixel of that part.
    """

    topic: str
    t_ns: int
    shape: tuple[int, int]
    pixels: Pixels
    row: int
    column: int

    def image(self) -> Image:
        """The full image; patches without pixels share one read-only array."""
        if not self.pixels.size:
            return Image(topic=self.topic, t_ns=self.t_ns, pixels=_blank_image(self.shape))
        image, (height, width) = np.full(self.shape, BLANK, np.uint8), self.pixels.shape
        image[self.row : self.row + height, self.column : self.column + width] = self.pixels
        return Image(topic=self.topic, t_ns=self.t_ns, pixels=image)


@cache
def _blank_image(shape: tuple[int, int]) -> Pixels:
    """Read-only grey image of a shape; all images of that shape share it."""
    image = np.full(shape, BLANK, np.uint8)
    image.setflags(write=False)
    return image


class Cameras:
    """Renders the cameras of a rig; a context manager, because it holds graphics memory.

    Args:
        model: Compiled model; it is copied.
        sensor_rig: The sensors with their true calibration.
        crowd: Bystanders.
        seed: Seed of the walk, for the noise of the images.
        mount_slips: Slips of the camera mounts.
        light: Course of the light during the walk.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        sensor_rig: SensorRig,
        crowd: Crowd,
        seed: int,
        mount_slips: MountSlips | None = None,
        light: LightCourse | None = None,
    ) -> None:
        """Creates a renderer per camera, and the views in which they draw."""
        self._model = model = copy.copy(model)  # a copy, because the uppers of the shoes are moved in it
        # renderers by topic, and views by whether they have shadows: cameras of one kind share a view
        self._data, self._crowd, self._mount_slips = mujoco.MjData(model), crowd, mount_slips or MountSlips()
        self._cameras = {t: _Camera(sensor_rig, t, seed, light) for t in sensor_rig.rig.cameras}
        self._views = {shadows: self._make_view(shadows) for shadows in {c.shadows for c in self._cameras.values()}}

    def _make_view(self, shadows: bool) -> SensorView:
        """A view large enough for every camera with shadows, or for every one without."""
        lenses = [c.lens for c in self._cameras.values() if c.shadows == shadows]
        width, height = max(lens.width for lens in lenses), max(lens.height for lens in lenses)
        return SensorView(self._model, width, height, shadows=shadows)

    def frames(
        self, due: Sequence[FrameRequest], qpos: Array, uppers: Mapping[str, Array] | None = None
    ) -> Iterator[Image | Depth | Patch]:
        """Images of the requested frames, in order.

        Cameras with automatic exposure (`has_auto_exposure`) return them before exposure.

        Args:
            due: Frames in order of time.
            qpos: (len(due), nq) generalised position at each.
            uppers: (len(due), 7) pose of the shoes' uppers by foot; uppers without a pose lie on the feet.
        """
        posed_ns = None  # instant whose pose the model has: cameras often share one
        for i, (item, pose) in enumerate(zip(due, qpos)):
            if posed_ns != item.t_ns:
                for foot, on_foot in (uppers or {}).items():
                    body = self._model.body(UPPERS[foot])
                    body.pos, body.quat = on_foot[i, :3], on_foot[i, 3:]
                self._data.qpos = pose
                pose_crowd(self._model, self._data, self._crowd, 1e-9 * item.t_ns)
                self._mount_slips.move_housings(self._model, item.t_ns)
                mujoco.mj_kinematics(self._model, self._data)
                mujoco.mj_camlight(self._model, self._data)
                posed_ns = item.t_ns
            camera, T_body_frame = self._cameras[item.topic], self._mount_slips.T_body_frame(item.topic, item.t_ns)
            yield from camera.render(self._views[camera.shadows], self._data, item, T_body_frame)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        for view in self._views.values():
            view.close()


def board_seen_by(sensor_rig: SensorRig, topic: str) -> Board | None:
    """The board on the other shoe, if the camera of this topic is on a shoe; otherwise None."""
    other_foot = {"/foot_l/camera": "foot_r", "/foot_r/camera": "foot_l"}.get(topic)
    return sensor_rig.rig.boards.get(other_foot) if other_foot else None


def has_auto_exposure(sensor_rig: SensorRig, topic: str) -> bool:
    """Whether a camera has automatic exposure: its images must be exposed in order of time."""
    return bool(_imager(sensor_rig, topic).auto_exposure_s)


def make_image_sensor(sensor_rig: SensorRig, topic: str, seed: int, light: LightCourse | None = None) -> ImageSensor:
    """Image sensor of a camera, with the noise of the walk's seed, in the course of the walk's light."""
    calibration, imager = sensor_rig.rig.cameras[topic], _imager(sensor_rig, topic)
    shape = (calibration.height, calibration.width, *(() if imager.colour == "grey" else (3,)))
    setting = sensor_rig.sensors[topic].sensor_config.light
    return ImageSensor(shape, imager, setting, Noise.of_topic(seed, topic), light)


def _imager(sensor_rig: SensorRig, topic: str) -> Imager:
    """True parameters of the image sensor and lens of a camera."""
    part = sensor_rig.sensors[topic].part
    assert isinstance(part, CameraPart | RgbdPart)
    return part.imager


@dataclass(frozen=True, kw_only=True, eq=False)
class _VisibleBoard:
    """A board in an image.

    Attributes:
        box: Rows and columns around it, motion blur included.
        sweep: Its motion relative to the camera.
    """

    box: tuple[slice, slice]
    sweep: Sweep


class _Camera:
    """Renderer of one camera of the rig: lens, motion during the exposure, image sensor and depth.

    Args:
        sensor_rig: The sensors with their true calibration.
        topic: Topic of the camera.
        seed: Seed of the walk, for the noise.
        light: Course of the light during the walk.

    Attributes:
        shadows: Whether the sun casts shadows in its images.
        lens: Its lens.
    """

    def __init__(self, sensor_rig: SensorRig, topic: str, seed: int, light: LightCourse | None = None) -> None:
        """Prepares lens, image sensor and depth of the camera with this topic."""
        mounted = sensor_rig.sensors[topic]
        assert isinstance(mounted.calibration, CameraCalibration)
        assert isinstance(mounted.part, CameraPart | RgbdPart)
        calibration, part = mounted.calibration, mounted.part
        self._calibration, self._imager = calibration, part.imager
        self._board = board_seen_by(sensor_rig, topic)
        self._grey = self._imager.colour == "grey"
        self.shadows = mounted.sensor_config.shadows
        # None with automatic exposure: such images are exposed elsewhere, in order of time
        self._sensor = (
            None if has_auto_exposure(sensor_rig, topic) else make_image_sensor(sensor_rig, topic, seed, light)
        )
        self.lens = RenderedLens(calibration)
        # camera matrix of the pinhole image
        self._K = np.array([[self.lens.intrinsics[0], 0, self.lens.intrinsics[2]],
                            [0, self.lens.intrinsics[1], self.lens.intrinsics[3]], [0, 0, 1.0]])  # fmt: skip
        # whether only the board and its surroundings are rendered; not in colour, because a `Patch` holds grey values,
        # and not with distortion, which needs the whole image
        self._around_board = (
            mounted.sensor_config.frames == "board" and self._board is not None and self._grey and self.lens.straight
        )
        self._depth: DepthModel | None = None
        if isinstance(part, RgbdPart):
            fu, _, pu, pv = calibration.intrinsics
            noise = Noise.of_topic(seed, calibration.depth_topic)
            self._depth = DepthModel((calibration.height, calibration.width), fu, (pu, pv), part.depth, noise)
            # measured over true depth, without noise
            self._depth_scale = np.float32(depth_scale(topic, mounted.sensor_config.calibration_sd, seed))

    def render(
        self, view: SensorView, data: mujoco.MjData, due: FrameRequest, T_body_frame: Array
    ) -> Iterator[Image | Depth | Patch]:
        """Renders one frame: the image, and the depth image with it for a camera with depth.

        Args:
            view: View that is large enough for the camera.
            data: State of the model, kinematics up to date.
            due: The frame.
            T_body_frame: (4, 4) pose on the body of the frame that holds the mount, after slips.
        """
        T_world_camera = mount_pose(data, self._calibration.mount, T_body_frame)
        board = self._find_board(data, due, T_world_camera)
        if self._around_board:
            yield self._render_board(view, data, due, T_world_camera, board)
            return
        size = self.lens.width, self.lens.height
        # `away`: distance of the scene, which stands for one plane across the view as regards motion blur
        if self._depth is None:
            rgb, away = view.color(data, T_world_camera, self.lens.intrinsics, size), _SURROUNDINGS_M
        else:
            rgb, depth = view.frame(data, T_world_camera, self.lens.intrinsics, size)
            away = _median_depth(depth)
        clean = self._to_sensor_colours(rgb)
        # the scene does not move: its motion in the image is that of the camera
        sweep = self._sweep(data, due, T_world_camera, _NOTHING, _NOTHING, _AHEAD, away)
        swept = self._apply_motion(clean, sweep)
        if board is not None:  # it moves differently from the ground
            rows, columns = board.box
            part_pixels = np.ascontiguousarray(clean[board.box])
            swept = swept.copy() if swept is clean else swept  # `clean` must stay as it is
            swept[board.box] = self._apply_motion(part_pixels, board.sweep.crop(rows.start, columns.start))
        yield Image(topic=due.topic, t_ns=due.t_ns, pixels=self._expose(due.t_ns, self.lens.distort(swept)))
        if self._depth is not None:
            # brightness of the surfaces: the green channel
            grey = rgb[..., 1] if self.lens.straight else self.lens.distort(np.ascontiguousarray(rgb[..., 1]))
            scaled = self._depth_scale * self.lens.distort(depth, cv2.INTER_NEAREST)
            measured = self._depth.image(due.t_ns, scaled, grey)
            yield Depth(topic=self._calibration.depth_topic, t_ns=due.t_ns, depth=measured)

    def _to_sensor_colours(self, rgb: Pixels) -> Pixels:
        """The RGB image in the colours of the sensor: grey values (H, W) or RGB (H, W, 3)."""
        return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8) if self._grey else rgb

    def _render_board(
        self,
        view: SensorView,
        data: mujoco.MjData,
        due: FrameRequest,
        T_world_camera: Array,
        board: _VisibleBoard | None,
    ) -> Patch:
        """Patch with the board on the other shoe and its surroundings; without pixels if no board is visible."""
        pixels, row, column = np.zeros((0, 0), np.uint8), 0, 0
        if board is not None:
            row, column = board.box[0].start, board.box[1].start  # upper left pixel of the part
            clean = self._to_sensor_colours(view.crop(data, T_world_camera, self.lens.intrinsics, *board.box))
            pixels = self._expose(due.t_ns, self._apply_motion(clean, board.sweep.crop(row, column)), row, column)
        shape = (self._calibration.height, self._calibration.width)
        return Patch(topic=due.topic, t_ns=due.t_ns, shape=shape, pixels=pixels, row=row, column=column)

    def _expose(self, t_ns: int, clean: Pixels, row: int = 0, column: int = 0) -> Pixels:
        """Grey values or colours that the image sensor measures, for a part of the image with noise-free levels.

        `row` and `column` are the upper left pixel of that part. Levels of a camera with automatic exposure come back
        unchanged, because they are exposed elsewhere, in order of time.
        """
        return clean if self._sensor is None else self._sensor.expose(t_ns, clean, row, column)

    def _apply_motion(self, clean: Pixels, sweep: Sweep) -> Pixels:
        """The image with rolling shutter and motion blur, for the motion of one plane relative to the camera."""
        if self._imager.rolling_s:
            clean = sweep.apply_rolling_shutter(clean, self._imager.rolling_s)
        return sweep.blur(clean, self._imager.exposure_s) if self._imager.exposure_s else clean

    def _find_board(self, data: mujoco.MjData, due: FrameRequest, T_world_camera: Array) -> _VisibleBoard | None:
        """Pixels around the board and its motion in the middle of the exposure; None when it is out of view.

        Args:
            data: State of the model, kinematics up to date.
            due: The frame, with the twists of the bodies that carry the camera and the board.
            T_world_camera: (4, 4) pose of the camera's optical frame.
        """
        if self._board is None:
            return None
        # the board in the camera's axes: normal, centre, and the corners of a box around it
        T_world_board = mount_pose(data, self._board.mount)
        R = T_world_camera[:3, :3].T
        normal, centre = R @ T_world_board[:3, 2], R @ (T_world_board[:3, 3] - T_world_camera[:3, 3])
        points = _AROUND_BOARD @ (R @ T_world_board[:3, :3]).T + centre
        if points[:, 2].min() < _LEAST_M:
            return None  # behind the camera or too close
        pixels = points @ self._K.T
        uv = pixels[:, :2] / pixels[:, 2:]  # (8, 2) column and row of each corner
        low, high = uv.min(axis=0), uv.max(axis=0)
        size = np.array([self.lens.width, self.lens.height])
        if np.any(high < 0) or np.any(low > size):
            return None  # beside the image
        away = float(normal @ centre)
        if abs(away) < _EDGE_ON * centre[2]:  # seen edge-on: only its position matters
            normal, away = _AHEAD, float(centre[2])
        # motion of the board's plane where the camera is
        v, w = _point_velocity(data, self._board.mount.body, due.twist[1], T_world_camera[:3, 3])
        sweep = self._sweep(data, due, T_world_camera, v, w, normal, away)
        # pixels around the board: a margin, and its way in the exposure time
        margin = _MARGIN_PX + sweep.path_px(self._imager.exposure_s, *((low + high) / 2))
        left, top = np.maximum(np.floor(low - margin), 0).astype(int).tolist()
        right, bottom = np.minimum(np.ceil(high + margin), size).astype(int).tolist()
        if right - left < 2 or bottom - top < 2:
            return None  # only its edge is in the image
        return _VisibleBoard(box=(slice(top, bottom), slice(left, right)), sweep=sweep)

    def _sweep(
        self,
        data: mujoco.MjData,
        due: FrameRequest,
        T_world_camera: Array,
        v: Array,
        w: Array,
        normal: Array,
        away_m: float,
    ) -> Sweep:
        """Motion of a plane relative to the camera, in the camera's axes.

        Args:
            data: State of the model.
            due: The frame, with the twist of the body that carries the camera.
            T_world_camera: (4, 4) pose of the camera.
            v: (3,) m/s of the plane where the camera is, world axes.
            w: (3,) rad/s of the plane, world axes.
            normal: (3,) unit normal of the plane, camera axes.
            away_m: Distance of the plane along its normal, m, signed.
        """
        camera_v, camera_w = _point_velocity(data, self._calibration.mount.body, due.twist[0], T_world_camera[:3, 3])
        R = T_world_camera[:3, :3].T  # world to camera
        return Sweep(K=self._K, normal=normal, distance=away_m, velocity=R @ (v - camera_v), rate=R @ (w - camera_w))


def _point_velocity(data: mujoco.MjData, name: str, twist: Array, point: Array) -> tuple[Array, Array]:
    """Velocity of a point fixed to a body, m/s, and angular rate of the body, rad/s, both in world axes.

    Args:
        data: State of the model.
        name: Body; for a foot, the shoe's upper.
        twist: (6,) velocity of its origin in world axes, and angular rate in its own axes.
        point: (3,) m in the world.
    """
    body = data.body(UPPERS.get(name, name))
    w = body.xmat.reshape(3, 3) @ twist[3:]  # in world axes
    x, y, z = point - body.xpos
    # velocity of the origin, plus w × arm
    return twist[:3] + [w[1] * z - w[2] * y, w[2] * x - w[0] * z, w[0] * y - w[1] * x], w


def _median_depth(depth: NDArray[np.float32]) -> float:
    """Median of the depths of every 16th pixel that sees a surface, m; `_FAR_M` if none does."""
    depths = np.sort(depth[::16, ::16], axis=None)
    visible = depths[np.searchsorted(depths, 0.0, "right") :]  # without the zeros, which stand for no surface
    half = len(visible) // 2  # the mean of the two depths in the middle, which are one for an odd number
    return float((visible[half] + visible[-half - 1]) / 2) if len(visible) else _FAR_M
