"""RGB-D folders in the 7-Scenes layout: `frame-000000.color.png`, `.depth.png` (mm), `.pose.txt` (camera to world).

Shotton et al., Scene coordinate regression forests, CVPR 2013. The layout has no time stamps: frames are assumed at
30 Hz. An optional `camera-intrinsics.txt`, a 3 x 3 matrix, is read.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.assumed_calibration import make_pinhole, read_first_image_size
from stridetwin.streams.formats.derived import to_odometry
from stridetwin.streams.formats.image_files import open_image_stream
from stridetwin.streams.formats.text_rows import read_camera_matrix, read_matrix
from stridetwin.streams.recording.imported import ImageStream, Source
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Block, Sample

RATE_HZ = 30.0
PER_METRE = 1000.0
COLOR, DEPTH, TRUTH_TOPIC = "/head/color", "/head/depth", "/truth/head/color/odometry"
_FRAME = re.compile(r"frame-(\d{1,9})\.(color\.(?:png|jpg|jpeg)|depth\.png|pose\.txt)")
"""A file of a frame: the number of the frame, and what the file contains with its ending."""
_INTRINSICS = "camera-intrinsics.txt"
"""Usual name of the file of a camera matrix."""
_PUBLISHED = (585.0, 585.0, 320.0, 240.0)  # of the Kinect that took the published scenes, 640 x 480


def find_frames_folder(path: Path) -> Path | None:
    """The folder with the frames: `path`, or its first `seq-..` that has frames; None without any."""
    for folder in (path, *sorted(path.glob("seq-*"))):
        if folder.is_dir() and any(_FRAME.fullmatch(p.name) for p in folder.iterdir()):
            return folder
    return None


def find_intrinsics(folder: Path) -> Path | None:
    """The file of a camera matrix in a folder: `camera-intrinsics.txt`, or another one that is called so."""
    names = sorted(file.name for file in folder.glob("*.txt") if "intrinsic" in file.name.lower())
    names.sort(key=lambda name: name != _INTRINSICS)
    return folder / names[0] if names else None


def read_seven_scenes(path: Path, notes: Notes, per_metre: float = PER_METRE) -> Source:
    """Reads a folder in the 7-Scenes layout.

    Args:
        path: The folder.
        notes: Collects problems.
        per_metre: Units of the depth images per metre.

    Returns:
        Colour, depth and true poses of the camera, as far as there are files, with stamps at an assumed 30 Hz.

    Raises:
        StrideTwinError: A file cannot be read or a value in it is invalid, unless lenient.
    """
    folder = find_frames_folder(path)
    if folder is None:
        raise ConfigError(path, "", "no frame-*.depth.png", "a folder in the 7-Scenes layout")
    # files by what they contain and by the number of the frame
    frame_files: dict[str, dict[int, Path]] = {"color": {}, "depth": {}, "pose": {}}
    for file in sorted(folder.iterdir()):
        if name := _FRAME.fullmatch(file.name):
            content, frame = name[2].partition(".")[0], int(name[1])
            frame_files[content][frame] = file
    notes.warn(f"the 7-Scenes layout has no time stamps: {RATE_HZ:g} Hz assumed")
    _warn_about_missing(frame_files, notes)
    images: dict[str, ImageStream] = {}
    # with the units per metre, which colour does not have
    for topic, files, scale in ((COLOR, frame_files["color"], None), (DEPTH, frame_files["depth"], per_metre)):
        if files:
            images[topic] = open_image_stream([(_to_stamp(frame), file) for frame, file in files.items()], scale)
    blocks: dict[str, Block[Sample]] = {}
    if frame_files["pose"]:
        blocks[TRUTH_TOPIC] = _read_poses(frame_files["pose"], notes)
    return Source(kind="7scenes", blocks=blocks, images=images, rig=_read_rig(path, folder, images), unread={})


def _warn_about_missing(frame_files: dict[str, dict[int, Path]], notes: Notes) -> None:
    """Warns of numbers that are missing between the first and the last frame, for each kind of file."""
    frames = sorted({f for files in frame_files.values() for f in files})
    for what, files in frame_files.items():
        count = frames[-1] + 1 - frames[0] - len(files) if files else 0
        if count:
            numbers = sorted(files)
            after = (k for k, number in enumerate(numbers, frames[0]) if number != k)  # where the numbering breaks off
            first = next(after, frames[0] + len(numbers))
            notes.warn(f"{what}: {count} frames are missing, the first of them frame-{first:06d}")


def _to_stamp(frame: int) -> int:
    """Stamp of a frame in ns at the assumed rate of 30 Hz."""
    return round(frame * 1e9 / RATE_HZ)


def _read_poses(files: dict[int, Path], notes: Notes) -> Block[Sample]:
    """Reads the pose files as odometry of the camera in the world; invalid files are left out, when lenient.

    Args:
        files: File of each pose, by the number of the frame.
        notes: Collects problems.
    """
    stamps: list[int] = []
    poses: list[Array] = []
    for frame, file in sorted(files.items()):
        try:
            poses.append(_read_pose(file))
            stamps.append(_to_stamp(frame))
        except StrideTwinError as error:
            notes.add_error(error)
    T = np.array(poses).reshape(-1, 4, 4)  # T_world_camera of each, m
    from scipy.spatial.transform import Rotation  # takes long to import: only where it is needed

    q = Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True) if len(T) else np.zeros((0, 4))
    return to_odometry(TRUTH_TOPIC, np.array(stamps, np.int64), T[:, :3, 3], q, None, notes, files[min(files)].parent)


def _read_pose(file: Path) -> Array:
    """Reads T_world_camera (4, 4) of one pose file.

    Raises:
        StrideTwinError: The file cannot be read, or is no rigid transform.
    """
    T = read_matrix(file, None, 4)
    R = T[:3, :3]
    if not (np.allclose(R @ R.T, np.eye(3), atol=1e-2) and np.linalg.det(R) > 0 and np.allclose(T[3], (0, 0, 0, 1))):
        raise ConfigError(file, "pose", np.round(T, 4).tolist(), "a rigid transform, camera to world")
    return T


def _read_rig(path: Path, folder: Path, images: dict[str, ImageStream]) -> Rig:
    """The camera's calibration, from `camera-intrinsics.txt` or, for images of 640 x 480, as published; else empty.

    The camera is that of colour if its images have the size of depth, or if there is no depth; else that of depth.

    Args:
        path: The folder that the user names, whose file counts if there is none in `folder`.
        folder: The folder of the frames.
        images: Colour and depth, as far as they exist.
    """
    depth_size = read_first_image_size(images[DEPTH]) if DEPTH in images else None
    color_size = read_first_image_size(images[COLOR]) if COLOR in images else None
    size = depth_size or color_size
    file = find_intrinsics(folder) or find_intrinsics(path)
    if size is None:
        return Rig()
    if file is not None:
        intrinsics = read_camera_matrix(file, None)
    elif size == (640, 480):
        intrinsics = _PUBLISHED
    else:
        return Rig()
    topic = COLOR if size == color_size else DEPTH
    return Rig(cameras={topic: make_pinhole(topic, size, intrinsics, RATE_HZ, DEPTH if DEPTH in images else "")})
