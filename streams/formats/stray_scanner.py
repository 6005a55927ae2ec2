"""Folders of the iPhone app StrayScanner.

`odometry.csv`, `camera_matrix.csv`, `rgb.mp4`, `depth/*.png` (mm) and `imu.csv`. The path is ARKit's, of the
camera's optical frame in a world with y up. Depth images are smaller than those in colour.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.formats.arkit import COLOR, DEPTH, IMU, arkit_path, path_topic, scanner_rig
from stridetwin.streams.formats.assumed_calibration import image_size
from stridetwin.streams.formats.image_files import image_stream
from stridetwin.streams.formats.text_rows import Row, numbers, read_text_rows
from stridetwin.streams.formats.tum import decimal_seconds
from stridetwin.streams.formats.video_images import video_stream
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2
from stridetwin.streams.recording.imported import ImageStream, Source
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Block, Imu

PER_METRE = 1000.0
ODOMETRY, MATRIX, VIDEO, INERTIAL = "odometry.csv", "camera_matrix.csv", "rgb.mp4", "imu.csv"
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_FORCE, _RATES = ("a_x", "a_y", "a_z"), (("alpha_x", "alpha_y", "alpha_z"), ("w_x", "w_y", "w_z"))
_MOST_IN_G = 3.0


def is_stray_scanner(path: Path) -> bool:
    """Whether a folder has the layout."""
    return all((path / name).is_file() for name in (ODOMETRY, MATRIX))


def read_stray_scanner(path: Path, notes: Notes, per_metre: float = PER_METRE) -> Source:
    """Reads a folder of StrayScanner.

    Args:
        path: The folder.
        notes: Collects problems.
        per_metre: Units of the depth images per metre.

    Raises:
        StrideTwinError: A file cannot be read or a value in it is invalid, unless lenient.
    """
    file = path / ODOMETRY
    header, rows = _table(file)
    t_ns, table = numbers(file, rows, _places(file, header, ("frame", *_POSE)), decimal_seconds, notes)
    images: dict[str, ImageStream] = {}
    if (path / VIDEO).is_file():
        images[COLOR] = video_stream(path / VIDEO, t_ns)
    depth = _depth(path, t_ns, table[:, 0], notes, per_metre)
    if depth is not None:
        images[DEPTH] = depth
    topic = path_topic(images)
    poses = arkit_path(topic, t_ns, table[:, 1:4], table[:, [7, 4, 5, 6]], True, notes, file)
    blocks: dict[str, Block[Any]] = {topic: poses}
    if (path / INERTIAL).is_file() and (imu := _imu(path / INERTIAL, notes)) is not None:
        blocks[IMU] = imu
    return Source(kind="strayscanner", blocks=blocks, images=images, rig=_rig(path, images, IMU in blocks))


def _table(file: Path) -> tuple[list[str], list[Row]]:
    _, rows = read_text_rows(file, ",")
    return (rows[0].words, rows[1:]) if rows else ([], [])


def _places(file: Path, header: list[str], names: tuple[str, ...]) -> list[tuple[str, int]]:
    for name in names:
        if name not in header:
            raise ConfigError(file, "header", ",".join(header), f"the columns timestamp, {', '.join(names)}")
    return [(name, header.index(name)) for name in names]


def _depth(path: Path, t_ns: NDArray[np.int64], frames: Array, notes: Notes, per_metre: float) -> ImageStream | None:
    """The depth images with a pose; those that are missing are reported."""
    folder = path / "depth"
    listed = [(t, folder / f"{int(frame):06d}.png") for t, frame in zip(t_ns.tolist(), frames.tolist())]
    there = [(t, file) for t, file in listed if file.is_file()]
    if there and len(there) < len(listed):
        first = next(file.name for _, file in listed if not file.is_file())
        notes.warn(f"depth: {len(listed) - len(there)} of {len(listed)} images are missing, the first of them {first}")
    return image_stream([t for t, _ in there], [file for _, file in there], per_metre) if there else None


def _imu(file: Path, notes: Notes) -> Block[Imu] | None:
    header, rows = _table(file)
    rates = next((names for names in _RATES if names[0] in header), _RATES[0])
    places = _places(file, header, (*_FORCE, *rates))
    if not rows:
        return None
    t_ns, table = numbers(file, rows, places, decimal_seconds, notes)
    in_g = float(np.median(np.linalg.norm(table[:, :3], axis=1))) < _MOST_IN_G
    force = -(STANDARD_GRAVITY_MPS2 if in_g else 1.0) * table[:, :3]
    unit = "g" if in_g else "m/s²"
    notes.warn(f"{file.name}: forces taken as {unit} with the iPhone's sign, IMU at the camera in the device's axes")
    return Block(topic=IMU, kind=Imu, t_ns=t_ns, columns={"angular_rate": table[:, 3:], "specific_force": force})


def _rig(path: Path, images: dict[str, ImageStream], imu: bool) -> Rig:
    file = path / MATRIX
    _, rows = read_text_rows(file, ",")
    try:
        K = np.array([[float(w) for w in row.words] for row in rows])
    except ValueError:
        K = np.zeros(0)
    if K.shape != (3, 3) or not np.isfinite(K).all() or min(K[0, 0], K[1, 1]) <= 0:
        valid = "fx,0,cx / 0,fy,cy / 0,0,1 in pixels of rgb.mp4"
        raise ConfigError(file, "matrix", [row.text for row in rows[:3]], valid)
    # without the video, the centre of the image is all that gives its size
    size = (image_size(images[COLOR]) if COLOR in images else None) or (round(2 * K[0, 2]), round(2 * K[1, 2]))
    return scanner_rig(images, (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])), size, imu)
