"""Folders of iPhone scanners, StrayScanner and Record3D: images, depth and the path of the camera, which is ARKit's.

StrayScanner: `odometry.csv`, `camera_matrix.csv`, `rgb.mp4`, `depth/*.png` (mm) and `imu.csv`; poses are those of the
optical frame, and depth images are smaller than those in colour. Record3D (`.r3d` is a ZIP file), unpacked: `metadata`,
`rgbd/0.jpg`, `rgbd/0.depth` and so on; depth is float32 in m, compressed with LZFSE.

ARKit's world has y up; ours z. Its camera looks along −z with y up; our optical frame along z with y down. The axes of
the device are x to the right and y to the top of the upright phone, z out of the screen; its accelerometer reports
forces with the opposite sign, in g.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from stridetwin.streams.bounded import LARGEST_TEXT, read_bytes, read_text
from stridetwin.streams.bounded_images import check_pixels
from stridetwin.streams.errors import ConfigError, StrideTwinError, explain_import_error
from stridetwin.streams.fields import Count, Number, Positive
from stridetwin.streams.formats.assumed_calibration import make_pinhole, read_first_image_size
from stridetwin.streams.formats.derived import to_odometry
from stridetwin.streams.formats.frame_intrinsics import choose_frame
from stridetwin.streams.formats.image_files import open_image_stream, select_existing
from stridetwin.streams.formats.text_rows import TextRow, read_camera_matrix, read_numbers, read_text_rows
from stridetwin.streams.formats.tum import parse_seconds
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2
from stridetwin.streams.plausible import mean_rate
from stridetwin.streams.recording.imported import ImageStream, Source
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.rig import CameraCalibration, Rig
from stridetwin.streams.samples import Array, Block, Depth, Image, Imu, Odometry, Sample, Stamps
from stridetwin.streams.validation import validate

COLOR, DEPTH, IMU = "/head/color", "/head/depth", "/head/imu"
"""Topics of a scan."""
R_ZUP_YUP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation from ARKit's world, y up, to ours, z up."""
R_ARKIT_OPTICAL = np.diag([1.0, -1.0, -1.0])
"""Rotation from our optical frame of the camera to ARKit's frame of it."""
R_DEVICE_OPTICAL = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Rotation from the optical frame to the axes of the device."""
PER_METRE = 1000.0
"""Units of StrayScanner's depth images per metre."""
ODOMETRY, MATRIX, VIDEO, INERTIAL = "odometry.csv", "camera_matrix.csv", "rgb.mp4", "imu.csv"
"""Files of StrayScanner."""
# columns of its tables: position in m and quaternion; forces; rates in rad/s, which have one of two groups of names
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_INTRINSICS = ("fx", "fy", "cx", "cy")
"""Columns with the intrinsics of each image, in newer versions of the app."""
_FORCE, _RATES = ("a_x", "a_y", "a_z"), (("alpha_x", "alpha_y", "alpha_z"), ("w_x", "w_y", "w_z"))
_MOST_IN_G = 3.0
"""Forces whose median magnitude is below this number are in g."""
_METADATA = ("metadata.json", "metadata")
"""Names of Record3D's file of metadata."""
_LZFSE = (b"bvx2", b"bvx1", b"bvxn", b"bvx-")
"""First bytes of data that are compressed with LZFSE."""


def is_stray_scanner(path: Path) -> bool:
    """Whether a folder has the layout of StrayScanner: `odometry.csv` and `camera_matrix.csv`."""
    return all((path / name).is_file() for name in (ODOMETRY, MATRIX))


def read_stray_scanner(path: Path, notes: Notes, per_metre: float = PER_METRE) -> Source:
    """Reads a folder of StrayScanner.

    Args:
        path: The folder.
        notes: Collects problems.
        per_metre: Units of the depth images per metre.

    Returns:
        Colour, depth, IMU and ARKit's path as far as their files exist, and both cameras' calibrations.

    Raises:
        StrideTwinError: A file cannot be read or a value in it is invalid, unless lenient.
    """
    file = path / ODOMETRY
    header, rows = _read_table(file)
    t_ns, table = read_numbers(file, rows, _find_columns(file, header, ("frame", *_POSE)), parse_seconds, notes)
    frame_numbers, p, q = table[:, 0], table[:, 1:4], table[:, [7, 4, 5, 6]]  # the quaternion as w, x, y, z
    images: dict[str, ImageStream] = {}
    if (path / VIDEO).is_file():
        frames = _Frames(path / VIDEO, t_ns)
        images[COLOR] = ImageStream(kind=Image, t_ns=t_ns, load=frames.load_image)
    listed = [(t, path / "depth" / f"{int(i):06d}.png") for t, i in zip(t_ns.tolist(), frame_numbers.tolist())]
    if (path / "depth").is_dir() and (depth_files := select_existing("depth", path / "depth", listed, notes)):
        images[DEPTH] = open_image_stream(depth_files, per_metre)
    poses = _to_camera_odometry(images, t_ns, p, q, True, notes, file)
    blocks: dict[str, Block[Sample]] = {poses.topic: poses}
    if (path / INERTIAL).is_file() and (imu := _read_imu(path / INERTIAL, notes)) is not None:
        blocks[IMU] = imu
    matrix = read_camera_matrix(path / MATRIX, ",")
    if all(name in header for name in _INTRINSICS):
        _, changing = read_numbers(file, rows, _find_columns(file, header, _INTRINSICS), parse_seconds, notes)
        changing = changing[(changing[:, :2] > 0).all(axis=1)]  # without those of images that have none
        matrix = _choose_intrinsics(file.name, changing, notes) if len(changing) else matrix
    rig = _to_stray_rig(path / MATRIX, images, matrix, IMU in blocks)
    return Source(kind="strayscanner", blocks=blocks, images=images, rig=rig)


def _choose_intrinsics(name: str, intrinsics: Array, notes: Notes) -> tuple[float, float, float, float]:
    """The intrinsics (fu, fv, pu, pv) in pixels that stand for those of all images.

    Args:
        name: File that they are in.
        intrinsics: (N, 4) of each image, N ≥ 1.
        notes: Collects how much they change.
    """
    fu, fv, pu, pv = intrinsics[choose_frame(name, intrinsics, notes)]
    return float(fu), float(fv), float(pu), float(pv)


def _read_table(file: Path) -> tuple[list[str], list[TextRow]]:
    """The cells of the first row of a CSV file, its header, and the rows below; both empty for an empty file."""
    _, rows = read_text_rows(file, ",")
    return (rows[0].cells, rows[1:]) if rows else ([], [])


def _find_columns(file: Path, header: list[str], names: tuple[str, ...]) -> list[tuple[str, int]]:
    """Name and index of each wanted column in a header.

    Raises:
        ConfigError: The header lacks a column.
    """
    for name in names:
        if name not in header:
            raise ConfigError(file, "header", ",".join(header), f"the columns timestamp, {', '.join(names)}")
    return [(name, header.index(name)) for name in names]


def _read_imu(file: Path, notes: Notes) -> Block[Imu] | None:
    """Reads `imu.csv`: specific forces in m/s² with the sign that an IMU has, and rates in rad/s, in the device's axes.

    The file's forces have the opposite sign. They are in g if their median magnitude is below `_MOST_IN_G`, else in
    m/s²; which one is reported. A table without rows gives None.
    """
    header, rows = _read_table(file)
    rates = next((names for names in _RATES if names[0] in header), _RATES[0])  # names of the columns
    places = _find_columns(file, header, (*_FORCE, *rates))
    if not rows:
        return None
    t_ns, table = read_numbers(file, rows, places, parse_seconds, notes)
    in_g = float(np.median(np.linalg.norm(table[:, :3], axis=1))) < _MOST_IN_G
    force = -(STANDARD_GRAVITY_MPS2 if in_g else 1.0) * table[:, :3]
    unit = "g" if in_g else "m/s²"
    notes.warn(f"{file.name}: forces taken as {unit} with the iPhone's sign, IMU at the camera in the device's axes")
    return Block(topic=IMU, kind=Imu, t_ns=t_ns, columns={"angular_rate": table[:, 3:], "specific_force": force})


def _to_stray_rig(
    file: Path, images: dict[str, ImageStream], matrix: tuple[float, float, float, float], imu: bool
) -> Rig:
    """The calibrations of a StrayScanner folder's cameras.

    Args:
        file: File of the camera matrix.
        images: Colour and depth, as far as they exist.
        matrix: (fu, fv, pu, pv) in pixels of the video.
        imu: Whether there is an IMU, which is at the camera in the axes of the device.

    Raises:
        ConfigError: There is no video, and the centre does not give the size of its images.
    """
    pu, pv = matrix[2:]
    # without the video, the centre of the image is all that gives its size
    size = (read_first_image_size(images[COLOR]) if COLOR in images else None) or (round(2 * pu), round(2 * pv))
    if min(size) < 1:
        raise ConfigError(file, "centre in pixels", [pu, pv], f"two positive numbers, or the video {VIDEO}")
    return _to_rig(images, matrix, size, imu)


class _Frames:
    """The frames of a video with stamps (N,) ns, decoded in order; going back decodes again from the start."""

    def __init__(self, path: Path, t_ns: Stamps) -> None:
        """Prepares for a video whose frames have the stamps `t_ns` (N,); nothing is decoded yet."""
        self._path, self._t_ns = path, t_ns
        self._frames: Iterator[Any] = iter(())  # the frames that are still to be decoded
        # number of the next frame, -1 if decoding has to start again; pixels (H, W, 3) of the last one
        self._next, self._last = -1, np.zeros((0, 0, 3), np.uint8)

    def load_image(self, topic: str, number: int) -> Image:
        """Loads frame `number` of the video as an image of a topic.

        Raises:
            StrideTwinError: The video cannot be decoded, or has fewer frames.
        """
        return Image(topic=topic, t_ns=int(self._t_ns[number]), pixels=self._decode_frame(number))

    def _decode_frame(self, number: int) -> NDArray[np.uint8]:
        """Decodes frame `number`: (H, W, 3) RGB; the last frame is kept for a second request.

        The frames before it, from number `_next` on, are decoded on the way. A frame behind that needs a new start.

        Raises:
            StrideTwinError: The video cannot be decoded, or has fewer frames.
        """
        if number == self._next - 1:  # the frame decoded last
            return self._last
        if self._next < 0 or number < self._next:  # nothing is open, or the frame is behind: from the start
            self._frames, self._next = self._decode(), 0
        try:
            while self._next <= number:
                frame = next(self._frames)
                self._next += 1
            check_pixels(frame.width, frame.height)
            self._last = frame.to_ndarray(format="rgb24")
        except StopIteration:
            count, self._next = self._next, -1
            raise ConfigError(self._path, "frames", count, f"at least {number + 1}, as listed") from None
        except (OSError, ValueError) as error:
            self._next = -1
            raise StrideTwinError(f"{self._path}: cannot be decoded: {error}") from error
        return self._last

    def _decode(self) -> Iterator[Any]:
        """Yields the frames of the video from its start."""
        import av  # takes long to import: only where it is needed

        with av.open(str(self._path)) as container:
            yield from container.decode(video=0)


class _Metadata(BaseModel):
    """The fields of Record3D's metadata that are read.

    Attributes:
        w: Width of the colour images, pixels.
        h: Height of the colour images, pixels.
        dw: Width of the depth images, pixels.
        dh: Height of the depth images, pixels.
        fps: Frame rate, used where stamps are missing.
        K: Camera matrix of the colour images, by columns.
        poses: Quaternion (x, y, z, w) and position in m of each frame in ARKit's world.
        frameTimestamps: Stamp of each frame in s.
        perFrameIntrinsicCoeffs: fu, fv, pu, pv of each frame's colour image in pixels.
    """

    w: Count
    h: Count
    dw: Count
    dh: Count
    fps: Positive = 30.0
    K: Annotated[list[Number], Field(min_length=9, max_length=9)]
    poses: list[tuple[Number, Number, Number, Number, Number, Number, Number]]
    frameTimestamps: list[Number] = []
    perFrameIntrinsicCoeffs: list[tuple[Positive, Positive, Number, Number]] | None = None


def is_record3d(path: Path) -> bool:
    """Whether a folder has the layout of an unpacked Record3D file: `rgbd/` and its metadata."""
    return (path / "rgbd").is_dir() and any((path / name).is_file() for name in _METADATA)


def read_record3d(path: Path, notes: Notes) -> Source:
    """Reads an unpacked recording of Record3D.

    Args:
        path: The folder.
        notes: Collects problems.

    Returns:
        Colour and depth as far as their files exist, ARKit's path of the optical frame, and the cameras' calibrations.

    Raises:
        StrideTwinError: A file cannot be read, a value in it is invalid, or depth is compressed and its package is not
            installed.
    """
    if not is_record3d(path):
        raise ConfigError(path, "", "no metadata and no rgbd/", "an unpacked recording of Record3D")
    file = next(path / name for name in _METADATA if (path / name).is_file())
    try:
        content = json.loads(read_text(file, LARGEST_TEXT))
    except ValueError as error:
        raise StrideTwinError(f"{file}: {error}") from error
    metadata = validate(_Metadata, content, file)
    count = len(metadata.poses)
    timestamps = metadata.frameTimestamps if len(metadata.frameTimestamps) == count else []
    t = np.array(timestamps) if timestamps else np.arange(count) / metadata.fps
    if not timestamps:
        notes.warn(f"{file.name}: no stamp for each frame; {metadata.fps:g} Hz assumed")
    start = min(0.0, float(t.min(initial=0.0)))  # s; stamps that begin below 0 are moved to begin at 0
    t_ns = np.rint(1e9 * (t - start)).astype(np.int64)
    poses = np.array(metadata.poses, float).reshape(count, 7)
    images: dict[str, ImageStream] = {}
    for topic, suffix in ((COLOR, "jpg"), (DEPTH, "depth")):
        listed = [(t, path / "rgbd" / f"{i}.{suffix}") for i, t in enumerate(t_ns.tolist())]
        if image_files := select_existing("rgbd", path / "rgbd", listed, notes):
            images[topic] = (
                open_image_stream(image_files)
                if topic == COLOR
                else _to_depth_stream(image_files, (metadata.dh, metadata.dw))
            )
    p, q = poses[:, 4:], poses[:, [3, 0, 1, 2]]  # the quaternion as w, x, y, z
    block = _to_camera_odometry(images, t_ns, p, q, False, notes, file)
    if metadata.perFrameIntrinsicCoeffs:
        matrix = _choose_intrinsics(file.name, np.array(metadata.perFrameIntrinsicCoeffs), notes)
    else:
        K = metadata.K  # the camera matrix column by column
        matrix = K[0], K[4], K[6], K[7]
    rig = _to_rig(images, matrix, (metadata.w, metadata.h), imu=False)
    return Source(kind="record3d", blocks={block.topic: block}, images=images, rig=rig)


def _to_depth_stream(files: list[tuple[int, Path]], shape: tuple[int, int]) -> ImageStream:
    """A stream of depth files of the given (height, width), read on request; the first is read at once as a check."""
    check_pixels(shape[1], shape[0])
    _read_depth(files[0][1], shape)  # a missing package is an error now, not in the middle of a walk

    def load(topic: str, i: int) -> Depth:
        """Reads depth image `i` under a topic; where there is no depth, it is 0."""
        t_ns, file = files[i]
        raw = _read_depth(file, shape)
        return Depth(topic=topic, t_ns=t_ns, depth=np.where(np.isfinite(raw), raw, 0).astype(np.float32))

    return ImageStream(kind=Depth, t_ns=np.array([t for t, _ in files], np.int64), load=load)


def _read_depth(file: Path, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Reads a depth file of float32: (H, W) m, NaN where there is none.

    Args:
        file: The file.
        shape: (height, width) of the image.

    Raises:
        StrideTwinError: The file is damaged or of another size, or is compressed with LZFSE and `lzfse` is not
            installed.
    """
    size = 4 * shape[0] * shape[1]  # bytes of the image, unpacked
    data = read_bytes(file, size + 4096)  # compression adds a little to data that it cannot reduce
    if data.startswith(_LZFSE):
        with explain_import_error(f"{file}: depth compressed with LZFSE", "record3d"):
            import lzfse
        try:
            data = lzfse.decompress(data)
        except (lzfse.error, ValueError) as error:
            raise ConfigError(file, "", "damaged LZFSE data", "a depth image of Record3D") from error
    if len(data) != size:
        raise ConfigError(file, "size in bytes, unpacked", len(data), f"{size}: float32 of {shape[1]} x {shape[0]}")
    return np.frombuffer(data, "<f4").reshape(shape)


def _to_camera_odometry(
    images: dict[str, ImageStream], t_ns: Stamps, p: Array, q: Array, optical: bool, notes: Notes, file: object
) -> Block[Odometry]:
    """ARKit's estimate of the camera's path as odometry of the optical frame in a world with z up.

    Args:
        images: Colour or depth, whose cameras are in one place; the topic is named after the first that is there.
        t_ns: (N,) stamps.
        p: (N, 3) m, camera in ARKit's world.
        q: (N, 4) quaternions (w, x, y, z), camera to ARKit's world.
        optical: Whether the camera's frame is already the optical one.
        notes: Collects problems.
        file: Named by errors.

    Raises:
        ConfigError: A quaternion far from unit norm, unless lenient.
    """
    topic = f"{COLOR if COLOR in images else DEPTH}/odometry"
    from scipy.spatial.transform import Rotation  # takes long to import: only where it is needed

    block = to_odometry(topic, t_ns, p, q, None, notes, file)  # leaves out invalid rows, still in ARKit's axes
    R = Rotation.from_matrix(R_ZUP_YUP) * Rotation.from_quat(block.columns["q_world_frame"], scalar_first=True)
    if not optical:
        R = R * Rotation.from_matrix(R_ARKIT_OPTICAL)
    p = block.columns["p_frame_in_world"] @ R_ZUP_YUP.T
    # again, for velocities and rates in the new axes
    return to_odometry(topic, block.t_ns, p, R.as_quat(scalar_first=True), None, notes, file)


def _to_rig(
    images: dict[str, ImageStream], intrinsics: tuple[float, float, float, float], size: tuple[int, int], imu: bool
) -> Rig:
    """The calibrations of the colour and the depth camera, which have one view and different image sizes.

    Intrinsics scale with the size s of an image: f' = s f, p' = s (p + 0.5) - 0.5, for pixel centres at whole numbers.

    Args:
        images: Colour and depth, if they are there.
        intrinsics: (fu, fv, pu, pv) in pixels of images of `size`.
        size: (width, height).
        imu: Whether there is an IMU, in the axes of the device, at the camera.
    """
    cameras: dict[str, CameraCalibration] = {}
    for topic, stream in images.items():
        stream_size = read_first_image_size(stream) or size
        su, sv = stream_size[0] / size[0], stream_size[1] / size[1]  # scale of the columns and of the rows
        fu, fv, pu, pv = intrinsics
        scaled = (su * fu, sv * fv, su * (pu + 0.5) - 0.5, sv * (pv + 0.5) - 0.5)
        camera = make_pinhole(topic, stream_size, scaled, mean_rate(stream.t_ns), DEPTH if topic == DEPTH else "")
        if imu:  # the body then has the axes of the device, as the IMU
            T_body_camera = np.eye(4)
            T_body_camera[:3, :3] = R_DEVICE_OPTICAL
            camera = replace(camera, mount=replace(camera.mount, T_body_sensor=T_body_camera))
        cameras[topic] = camera
    return Rig(cameras=cameras)
