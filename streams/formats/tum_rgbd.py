"""RGB-D folders in the TUM layout: `rgb.txt`, `depth.txt`, `groundtruth.txt`, `accelerometer.txt` and the images.

Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012. Depth PNGs have 5000 units per metre. The
poses are those of the colour camera's optical frame. `calibration.txt` (fx fy cx cy) is that of the ETH3D datasets. The
layout has only the accelerometer of the IMU: rates are read from an additional `gyroscope.txt`, or rates and forces
from one `imu.txt`, whose header names its columns (wx wy wz ax ay az, in this order without a header).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.assumed_calibration import BODY, image_size
from stridetwin.streams.formats.image_files import read_image_list
from stridetwin.streams.formats.poses import odometry
from stridetwin.streams.formats.split_imu import joined_at_rates
from stridetwin.streams.formats.text_rows import numbers, read_text_rows
from stridetwin.streams.formats.tum import decimal_seconds
from stridetwin.streams.plausible import mean_rate
from stridetwin.streams.recording.imported import ImageStream, Notes, Source
from stridetwin.streams.rig import CameraCalibration, Mount, Rig
from stridetwin.streams.samples import Accelerometer, Array, Block, Depth, Imu

PER_METRE = 5000.0
COLOR, DEPTH, ACCELEROMETER, IMU = "/head/color", "/head/depth", "/head/accelerometer", "/head/imu"
TRUTH = "/truth/head/color/odometry"
_RATE, _FORCE = ("wx", "wy", "wz"), ("ax", "ay", "az")
_POSE = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
_PLAUSIBLE_M = (0.25, 15.0)


def is_tum_rgbd(path: Path) -> bool:
    """Whether a folder has the layout."""
    return any((path / name).is_file() for name in ("rgb.txt", "depth.txt"))


def read_tum_rgbd(path: Path, notes: Notes, per_metre: float = PER_METRE) -> Source:
    """Reads a folder in the TUM layout.

    Args:
        path: The folder.
        notes: Collects problems.
        per_metre: Units of the depth images per metre.

    Raises:
        StrideTwinError: A file cannot be read or a value in it is invalid, unless lenient.
    """
    images: dict[str, ImageStream] = {}
    blocks: dict[str, Block[Any]] = {}
    if (path / "rgb.txt").is_file():
        images[COLOR] = read_image_list(path / "rgb.txt", path, None, decimal_seconds, notes)
    if (path / "depth.txt").is_file():
        images[DEPTH] = read_image_list(path / "depth.txt", path, None, decimal_seconds, notes, per_metre)
        _check_depth(images[DEPTH], per_metre, notes)
    blocks |= _inertial(path, notes)
    file = path / "groundtruth.txt"
    if file.is_file():
        _, rows = read_text_rows(file, None)
        t_ns, table = numbers(file, rows, [(n, i + 1) for i, n in enumerate(_POSE)], decimal_seconds, notes)
        blocks[TRUTH] = odometry(TRUTH, t_ns, table[:, :3], table[:, [6, 3, 4, 5]], None, notes, file)
    return Source(kind="tum", blocks=blocks, images=images, rig=_rig(path, images), unread={})


def _inertial(path: Path, notes: Notes) -> dict[str, Block[Any]]:
    """Accelerometer and IMU, if their files exist."""
    blocks: dict[str, Block[Any]] = {}
    force, rate, both = (path / f"{name}.txt" for name in ("accelerometer", "gyroscope", "imu"))
    if force.is_file():
        t_ns, table = _columns(force, _FORCE, notes)
        columns = {"specific_force": table}
        blocks[ACCELEROMETER] = Block(topic=ACCELEROMETER, kind=Accelerometer, t_ns=t_ns, columns=columns)
    if both.is_file():
        t_ns, table = _columns(both, (*_RATE, *_FORCE), notes)
        columns = {"angular_rate": table[:, :3], "specific_force": table[:, 3:]}
        blocks[IMU] = Block(topic=IMU, kind=Imu, t_ns=t_ns, columns=columns)
    elif rate.is_file() and len(blocks.get(ACCELEROMETER, ())) > 1:
        t_ns, table = _columns(rate, _RATE, notes)
        gyro = Block(topic=IMU, kind=Imu, t_ns=t_ns, columns={"angular_rate": table})
        blocks[IMU] = joined_at_rates(IMU, gyro, blocks[ACCELEROMETER])
        notes.warn("gyroscope.txt and accelerometer.txt are joined, the force interpolated to the stamps of the rate")
    return blocks


def _columns(file: Path, names: tuple[str, ...], notes: Notes) -> tuple[NDArray[np.int64], Array]:
    """Stamps (N,) ns and (N, K) columns of a file, by the names in its header, or in this order after the stamp."""
    header, rows = read_text_rows(file, None)
    named = all(name in header for name in names)
    places = [(name, header.index(name) if named else i) for i, name in enumerate(names, 1)]
    return numbers(file, rows, places, decimal_seconds, notes)


def _check_depth(images: ImageStream, per_metre: float, notes: Notes) -> None:
    """Warns of a distance that no such camera measures, the effect of a wrong scale."""
    try:
        first = images.load(DEPTH, 0)
    except (StrideTwinError, IndexError):
        return  # reported when the image is read
    seen = first.depth[first.depth > 0] if isinstance(first, Depth) else np.zeros(0)
    if len(seen) and not _PLAUSIBLE_M[0] < (median := float(np.median(seen))) < _PLAUSIBLE_M[1]:
        notes.warn(
            f"depth: {median:.3g} m in the median of the first image at {per_metre:g} units per metre; "
            "if the images have another unit, give it with --depth-scale"
        )


def _rig(path: Path, images: dict[str, ImageStream]) -> Rig:
    file = path / "calibration.txt"
    topic = COLOR if COLOR in images else DEPTH
    if not file.is_file() or topic not in images or (size := image_size(images[topic])) is None:
        return Rig()
    _, rows = read_text_rows(file, None)
    words = [w for row in rows for w in row.words]
    try:
        fu, fv, pu, pv = (float(w) for w in words[:4])
        sound = bool(np.isfinite([fu, fv, pu, pv]).all() and fu > 0 and fv > 0)
    except ValueError:
        sound = False
    if not sound:
        raise ConfigError(file, "calibration", " ".join(words[:8]), "fx fy cx cy, focal lengths above 0")
    camera = CameraCalibration(
        topic=topic,
        part="",
        rate_hz=mean_rate(images[topic].t_ns),
        mount=Mount(body=BODY),
        width=size[0],
        height=size[1],
        intrinsics=(fu, fv, pu, pv),
        depth_topic=DEPTH if DEPTH in images else "",
    )
    return Rig(cameras={topic: camera})
