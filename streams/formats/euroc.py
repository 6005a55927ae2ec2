"""EuRoC MAV folders (ASL layout): `mav0/imu0/data.csv`, `mav0/cam0/data/*.png`, `sensor.yaml` beside each.

Burri et al., The EuRoC micro aerial vehicle datasets, IJRR 2016; TUM-VI uses the same layout. The body frame is the
IMU's; the ground truth of another frame, such as the marker of `vicon0`, is converted with its `T_BS`. Columns are
found by the names in the header, or in the published order without a header.

A recording is written as one IMU, one camera (or the two of a stereo pair), and the true states. The right camera of a
stereo pair can be rendered from the left image and its depth (depth-image-based rendering, Fehn, SPIE 5291, 2004): the
disparity fu·b/z is warped to the right image, nearest surface first, and the left image is sampled with it. Areas that
only the right camera would see are filled with the adjacent background.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator

from stridetwin.streams.bounded import LARGEST_SETTING, read_text
from stridetwin.streams.calibration_keys import has_no_effect
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.fields import Count, NotNegative, Number, OneOf, Positive
from stridetwin.streams.formats.assumed_calibration import BODY
from stridetwin.streams.formats.derived import to_odometry
from stridetwin.streams.formats.image_files import choose_camera, list_images, read_image_list, write_image
from stridetwin.streams.formats.text_rows import (
    TextRow,
    parse_nanoseconds,
    read_numbers,
    read_text_rows,
    write_text_rows,
)
from stridetwin.streams.kalibr import write_rig
from stridetwin.streams.kalibr_sections import ImuNoise
from stridetwin.streams.lenses import (
    COEFFICIENTS,
    DISTORTIONS,
    EXACT_FIT_PX,
    EXTRA_TERMS,
    VALID_LENS,
    WORST_FIT_PX,
    to_rig_lens,
)
from stridetwin.streams.matrix_fields import RigidTransform, to_matrix_rows
from stridetwin.streams.recording.imported import ImageStream, Source
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.recording.recording_schema import RIG_NAME
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Array, Block, Depth, Image, Imu, Odometry, Sample, Stamps
from stridetwin.streams.validation import validate
from stridetwin.streams.yaml_file import clear_opencv_marks, parse_yaml

# names and units of the layout's columns after the stamp: angular rate and specific force of an IMU; position,
# quaternion and velocity of a ground truth (R: reference frame, S: sensor frame)
IMU_COLUMNS = ("w_RS_S_x", "w_RS_S_y", "w_RS_S_z", "a_RS_S_x", "a_RS_S_y", "a_RS_S_z")
IMU_UNITS = ("rad s^-1",) * 3 + ("m s^-2",) * 3
POSE_COLUMNS = ("p_RS_R_x", "p_RS_R_y", "p_RS_R_z", "q_RS_w", "q_RS_x", "q_RS_y", "q_RS_z")
POSE_UNITS = ("m",) * 3 + ("",) * 4 + ("m s^-1",) * 3
VELOCITY_COLUMNS = ("v_RS_R_x", "v_RS_R_y", "v_RS_R_z")
GROUND_TRUTHS = ("state_groundtruth_estimate0", "mocap0", "vicon0")
"""Folders of a ground truth; the first that exists is read."""
TRUTH_TOPIC = "/truth/head/imu/odometry"
NAMES = {"imu0": "/head/imu", "cam0": "/head/color", "cam1": "/head/color_right"}
"""Our topic of a sensor, by its folder."""
S = TypeVar("S", bound=BaseModel)
_DESCRIPTIVE = ("sensor_type", "comment", "rate_hz", "camera_model")
"""Keys of a `sensor.yaml` that describe a sensor without being part of its calibration."""


def find_euroc_root(path: Path) -> Path | None:
    """The folder that has `imu0` or `cam0`: the subfolder `mav0` or `path` itself; None if neither has one."""
    for root in (path / "mav0", path):
        if any((root / name).is_dir() for name in ("imu0", "cam0")):
            return root
    return None


def read_euroc(path: Path, notes: Notes) -> Source:
    """Reads a folder in the ASL layout.

    Returns:
        Its IMUs, cameras and the first ground truth of `GROUND_TRUTHS`, under our topics (further sensors
        under their folder's name).

    Raises:
        StrideTwinError: A file cannot be read or a value in it is invalid, unless lenient.
    """
    root = find_euroc_root(path)
    if root is None:
        raise ConfigError(path, "", "no imu0 and no cam0", "a folder in the ASL layout")
    blocks: dict[str, Block[Sample]] = {}
    images: dict[str, ImageStream] = {}
    imus: dict[str, ImuCalibration] = {}
    cameras: dict[str, CameraCalibration] = {}
    folders = sorted(p for p in root.iterdir() if p.is_dir())
    for folder in folders:
        topic = NAMES.get(folder.name, f"/{folder.name}")
        if re.fullmatch(r"imu\d+", folder.name):
            blocks[topic] = _read_imu(folder, topic, notes)
            if (imu := _read_sensor(folder, _ImuSensor, notes)) is not None:
                imus[topic] = imu.to_calibration(topic)
        elif re.fullmatch(r"cam\d+", folder.name):
            listed, data = folder / "data.csv", folder / "data"
            if listed.is_file() or not data.is_dir():
                stream = read_image_list(listed, data, ",", parse_nanoseconds, notes)
            else:
                stream = list_images(data, parse_nanoseconds, notes)
            if not len(stream.t_ns):  # no image of the list exists
                continue
            images[topic] = stream
            if (camera := _read_sensor(folder, _CameraSensor, notes)) is not None:
                cameras[topic] = camera.to_calibration(topic, folder / "sensor.yaml", notes)
    truth = next((n for n in GROUND_TRUTHS if (root / n / "data.csv").exists()), None)  # the folder that is read
    if truth is not None:
        blocks[TRUTH_TOPIC] = _read_truth(root / truth / "data.csv", notes)
    first_imu = next(iter(imus), "")
    rig = Rig(imus=imus, cameras={topic: replace(cam, imu_topic=first_imu) for topic, cam in cameras.items()})
    read_names = {"imu0", "cam0", truth} | {f.name for f in folders if re.fullmatch(r"(imu|cam)\d+", f.name)}
    unread = {f"/{f.name}": "folder" for f in folders if f.name not in read_names}
    return Source(kind="euroc", blocks=blocks, images=images, rig=rig, unread=unread)


def _read_imu(folder: Path, topic: str, notes: Notes) -> Block[Imu]:
    """Reads `data.csv` of an IMU: angular rate in rad/s and specific force in m/s²."""
    file = folder / "data.csv"
    header, rows = read_text_rows(file, ",")
    columns = _find_columns(file, header, IMU_COLUMNS, IMU_UNITS, notes)
    t_ns, table = read_numbers(file, rows, columns, parse_nanoseconds, notes)
    return Block(
        topic=topic, kind=Imu, t_ns=t_ns, columns={"angular_rate": table[:, :3], "specific_force": table[:, 3:]}
    )


def _read_truth(file: Path, notes: Notes) -> Block[Odometry]:
    """Reads `data.csv` of a ground truth, with or without velocities, as odometry of the body's frame.

    Without a header, velocities are assumed if there are enough columns. If the poses are those of another frame, such
    as a marker, the `T_BS` in `sensor.yaml` beside the file converts them.
    """
    header, rows = read_text_rows(file, ",")
    names = [_split_unit(word)[0] for word in header]
    # a row without velocities has a stamp and the pose
    has_velocity = VELOCITY_COLUMNS[0] in names or (not names and _count_columns(rows) > len(POSE_COLUMNS) + 3)
    wanted = (*POSE_COLUMNS, *VELOCITY_COLUMNS) if has_velocity else POSE_COLUMNS
    columns = _find_columns(file, header, wanted, POSE_UNITS, notes)
    t_ns, table = read_numbers(file, rows, columns, parse_nanoseconds, notes)
    velocity = table[:, 7:10] if has_velocity else None
    return to_odometry(
        TRUTH_TOPIC, t_ns, table[:, :3], table[:, 3:7], velocity, notes, file, _read_marker(file.parent, notes)
    )


def _read_marker(folder: Path, notes: Notes) -> Array | None:
    """T_BS (4, 4), m, pose in the body of a ground truth's sensor, such as Vicon's marker; None if it is the body."""
    marker = _read_sensor(folder, _Marker, notes)
    if marker is None or marker.T_BS is None or np.array_equal(marker.T_BS, np.eye(4)):
        return None
    return marker.T_BS


def _find_columns(
    file: Path, header: list[str], wanted: Sequence[str], units: Sequence[str], notes: Notes
) -> list[tuple[str, int]]:
    """Finds columns by the names in the header, or (reported) in the published order if there is no header.

    Args:
        file: Named by errors.
        header: Cells of the header, each a name and a unit in brackets; empty without a header.
        wanted: Names of the columns.
        units: Expected unit of each; further columns of `wanted` are not checked.
        notes: Collects the warning.

    Returns:
        Name and index of each wanted column.

    Raises:
        ConfigError: A column is missing or occurs twice, or has another unit.
    """
    where = f"{file.parent.name}/{file.name}"
    names, header_units = zip(*(_split_unit(word) for word in header)) if header else ((), ())
    if not header:
        notes.warn(f"{where}: no header; columns assumed in the published order")
    elif not any(name in names for name in wanted):
        raise ConfigError(file, "header", ",".join(header), f"the columns timestamp, {', '.join(wanted)}")
    else:
        for name, valid in zip(wanted, units):
            if names.count(name) != 1:
                raise ConfigError(file, "header", ",".join(header), f"one column {name}")
            unit = header_units[names.index(name)]
            if unit and unit.replace("/s", " s^-1") != valid:  # `rad/s` is accepted for `rad s^-1`
                raise ConfigError(file, f"header, unit of {name}", unit, valid)
        return [(name, names.index(name)) for name in wanted]
    return [(name, 1 + i) for i, name in enumerate(wanted)]  # after the stamp


def _split_unit(word: str) -> tuple[str, str]:
    """Name and unit of a header's cell such as `a_RS_S_x [m s^-2]`; the unit is "" without one."""
    match = re.fullmatch(r"(\w+)\s*(?:\[(.*)\])?", word)
    return (match[1], (match[2] or "").strip()) if match else (word, "")


def _count_columns(rows: list[TextRow]) -> int:
    """Number of cells in the first row."""
    return len(rows[0].cells) if rows else 0


class _Marker(BaseModel):
    """A `sensor.yaml` of a ground truth."""

    T_BS: Annotated[RigidTransform | None, BeforeValidator(to_matrix_rows)] = None


class _Sensor(BaseModel):
    """A `sensor.yaml`; keys that are not read are left alone."""

    T_BS: Annotated[RigidTransform, BeforeValidator(to_matrix_rows)]
    comment: Annotated[str, BeforeValidator(lambda node: node if isinstance(node, str) else "")] = ""

    @property
    def mount(self) -> Mount:
        """Pose in the body."""
        return Mount(body=BODY, T_body_sensor=self.T_BS)


class _ImuSensor(_Sensor, ImuNoise):
    """A `sensor.yaml` of an IMU: pose, rate and noise densities."""

    rate_hz: Positive

    def to_calibration(self, topic: str) -> ImuCalibration:
        """The calibration of the IMU of a topic."""
        noise = {name: getattr(self, name) for name in ImuNoise.model_fields}
        return ImuCalibration(topic=topic, part=self.comment, rate_hz=self.rate_hz, mount=self.mount, **noise)


class _CameraSensor(_Sensor):
    """A `sensor.yaml` of a camera: pose, pinhole intrinsics, image size and distortion."""

    camera_model: Literal["pinhole", "omni", "eucm", "ds"] = "pinhole"
    intrinsics: list[Number]
    resolution: tuple[Count, Count]
    distortion_coefficients: Annotated[list[Number], BeforeValidator(lambda node: node or [])] = []
    distortion_model: Annotated[str, OneOf([name for name in DISTORTIONS if name])] = "radtan"
    rate_hz: NotNegative = 0.0

    def to_calibration(self, topic: str, file: Path, notes: Notes) -> CameraCalibration:
        """The calibration of the camera of a topic.

        Args:
            topic: Topic of the images.
            file: The `sensor.yaml`, for errors.
            notes: Collects the error of a lens that is fitted.

        Raises:
            ConfigError: The lens has too few or too many numbers, or is none that can be represented.
        """
        model, coefficients = DISTORTIONS[self.distortion_model], tuple(self.distortion_coefficients)
        coefficients = coefficients or (0.0,) * COEFFICIENTS[model][0]
        count = EXTRA_TERMS[self.camera_model] + 4
        if len(self.intrinsics) != count or min(self.intrinsics[-4:-2]) <= 0:
            valid = f"{count} numbers of {self.camera_model}, with focal lengths above 0"
            raise ConfigError(file, "intrinsics", self.intrinsics, valid)
        if len(coefficients) not in COEFFICIENTS[model]:
            valid = f"{' or '.join(map(str, COEFFICIENTS[model]))} numbers of {model}"
            raise ConfigError(file, "distortion_coefficients", list(coefficients), valid)
        lens = to_rig_lens(self.camera_model, tuple(self.intrinsics), model, coefficients, self.resolution)
        if not lens.error_px <= WORST_FIT_PX:
            raise ConfigError(file, "distortion_coefficients", list(coefficients), VALID_LENS)
        if lens.error_px > EXACT_FIT_PX:
            off = f"up to {lens.error_px:.2g} px off"
            notes.warn(f"{file.parent.name}/{file.name}: {self.camera_model} is fitted by {lens.model}, {off}")
        return CameraCalibration(
            topic=topic,
            part=self.comment,
            rate_hz=self.rate_hz,
            mount=self.mount,
            width=self.resolution[0],
            height=self.resolution[1],
            intrinsics=lens.intrinsics,
            distortion_model=lens.model,
            distortion=lens.distortion,
        )


def _read_sensor(folder: Path, kind: type[S], notes: Notes) -> S | None:
    """The contents of `sensor.yaml` in a sensor's folder as `kind`; None without the file.

    A warning lists the keys of the file that are not used.

    Raises:
        StrideTwinError: The file is no YAML, or a value is invalid.
    """
    file = folder / "sensor.yaml"
    if not file.exists():
        return None
    text = clear_opencv_marks(read_text(file, LARGEST_SETTING))
    document = parse_yaml(text, str(file))
    sensor = validate(kind, document, file)
    unused = (
        [key for key, value in document.items() if not _is_used(kind, key, value)] if isinstance(document, dict) else []
    )
    if unused:
        notes.warn(f"{folder.name}/{file.name}: keys that are not used: {', '.join(unused)}")
    return sensor


def _is_used(kind: type[BaseModel], key: str, value: object) -> bool:
    """Whether a key of a `sensor.yaml` is read as a field of `kind`, or changes nothing."""
    return key in kind.model_fields or key in _DESCRIPTIVE or has_no_effect(value)


BASELINE_M = (0.001, 1.0)
"""Least and largest distance of the cameras of a stereo pair."""


def make_right_camera(left: CameraCalibration, baseline_m: float, topic: str) -> CameraCalibration:
    """The calibration of a virtual right camera: `baseline_m` along +x of the left one, with parallel axes.

    Raises:
        ConfigError: The baseline is outside `BASELINE_M`, or the left camera has distortion, so that the rows of the
            pair would not match.
    """
    low, high = BASELINE_M
    if not low <= baseline_m <= high:
        raise ConfigError("export", "--stereo-baseline", baseline_m, f"{low:g} to {high:g} m")
    if any(left.distortion):
        raise ConfigError(
            left.topic, "distortion", list(left.distortion), "a camera without distortion for a right view"
        )
    T_left_right = np.eye(4)
    T_left_right[0, 3] = baseline_m
    mount = Mount(body=left.mount.body, T_body_sensor=left.mount.T_body_sensor @ T_left_right)
    part = f"virtual, {baseline_m:g} m to the right of {left.topic}"
    return replace(left, topic=topic, part=part, mount=mount, distortion_model="radtan", depth_topic="")


def render_right_view(
    left: NDArray[np.uint8], depth: NDArray[np.float32], focal_px: float, baseline_m: float
) -> NDArray[np.uint8]:
    """Renders the image of a virtual right camera from the left image and its depth, for rectified stereo.

    Each pixel moves left by its disparity fu·b/z, the nearest surface wins, and the left image is sampled bilinearly at
    the place that each pixel of the right image comes from.

    Args:
        left: (H, W) or (H, W, 3) uint8.
        depth: (H, W) m, registered to the left image; pixels without depth (0) take the disparity of the farther
            neighbour in the row.
        focal_px: fu.
        baseline_m: Distance of the two cameras.

    Returns:
        Image with the shape and type of `left`.
    """
    with np.errstate(divide="ignore"):
        measured = np.where(depth > 0, focal_px * baseline_m / depth, np.nan).astype(np.float64)
    # (H, W) pixels by which each pixel of the left image moves to the left
    disparity = np.nan_to_num(np.take_along_axis(measured, _find_background(measured), axis=1))
    width = disparity.shape[1]
    rows: Any
    columns: Any
    rows, columns = np.indices(disparity.shape)
    # (H, W) disparity of each pixel of the right image; the largest, which is that of the nearest surface, stays
    right_disparity = np.full(disparity.shape, -np.inf)
    for to_whole in (np.floor, np.ceil):  # both columns next to a warped pixel, so that slopes leave no cracks
        target = to_whole(columns - disparity).astype(np.int64)  # column in the right image
        inside = (target >= 0) & (target < width)
        np.maximum.at(right_disparity, (rows[inside], target[inside]), disparity[inside])
    right_disparity[~np.isfinite(right_disparity)] = np.nan  # holes, which no pixel of the left image has reached
    from_column = _find_background(right_disparity)
    # (H, W) column of the left image that each pixel of the right one comes from
    x = from_column + np.nan_to_num(np.take_along_axis(right_disparity, from_column, axis=1))
    right = cv2.remap(
        left, x.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(right, np.uint8)


def _find_background(disparity: Array) -> NDArray[np.int64]:
    """Finds where each pixel takes its disparity from: itself, or in a hole the farther of the row's two neighbours.

    Args:
        disparity: (H, W) pixels; NaN is a hole.

    Returns:
        (H, W) columns; a pixel of a row without any disparity keeps its own column.
    """
    known = np.isfinite(disparity)
    at = np.arange(disparity.shape[1])
    # column of the nearest pixel with a disparity to the left and to the right; -1 and the width without one
    before = np.maximum.accumulate(np.where(known, at, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, at, len(at))[:, ::-1], axis=1)[:, ::-1]
    # disparities of these; beyond the ends of a row they are infinite, so that the other neighbour is taken
    padded = np.pad(np.where(known, disparity, np.inf), ((0, 0), (1, 1)), constant_values=np.inf)
    left, right = (np.take_along_axis(padded, i + 1, axis=1) for i in (before, after))
    farther = np.where(left <= right, before, after)  # the surface of the smaller disparity is farther away
    return np.asarray(np.where(np.isfinite(np.minimum(left, right)), farther, at), np.int64)


RIGHT_SUFFIX = "_right"
"""What the topic of a right camera has after that of its left camera."""


def write_euroc(
    recording: Recording, folder: Path, camera_topic: str | None = None, stereo_baseline_m: float | None = None
) -> dict[str, int]:
    """Writes `folder/mav0` in the ASL layout, and the complete calibration beside it as `rig.yaml`.

    A camera whose topic ends in `_right` becomes `cam1` beside its left camera; without one, a right camera can be made
    from depth. The biases of the true states are not recorded and written as 0.

    Args:
        recording: Needs a camera, and an IMU on the same body.
        folder: An empty folder.
        camera_topic: Topic of the camera; by default the first one with depth.
        stereo_baseline_m: Adds a virtual right camera at this distance; the camera then needs depth.

    Returns:
        Rows written, by sensor.

    Raises:
        StrideTwinError: The recording lacks the camera or the IMU.
    """
    camera = choose_camera(recording, camera_topic)
    if camera.imu_topic not in recording.topics:
        raise ConfigError(recording.path, f"IMU of {camera.topic}", camera.imu_topic, "an IMU on the camera's body")
    imu = recording.rig.imu(camera.imu_topic)
    root = folder / "mav0"
    counts = {"imu0": _write_imu(recording, imu, root / "imu0")}
    cameras = [camera]
    right_topic = f"{camera.topic}{RIGHT_SUFFIX}"
    if stereo_baseline_m is not None:
        cameras.append(make_right_camera(camera, stereo_baseline_m, right_topic))
        counts |= _write_stereo(recording, cameras[0], cameras[1], imu, root)
    else:
        if right_topic in recording.topics:  # a stereo pair was recorded
            cameras.append(recording.rig.cameras[right_topic])
        for i, each in enumerate(cameras):
            images = (s for s in recording.samples([each.topic]) if isinstance(s, Image))
            counts[f"cam{i}"] = _write_camera(images, each, imu, root / f"cam{i}")
    truth = f"/truth{imu.topic}/odometry"
    if truth in recording.topics:
        counts["state_groundtruth_estimate0"] = _write_truth(recording, truth, root / "state_groundtruth_estimate0")
    write_rig(_with_both_names(recording.rig, imu, cameras), folder / RIG_NAME)
    return counts


def _write_imu(recording: Recording, imu: ImuCalibration, folder: Path) -> int:
    """Writes `data.csv` and `sensor.yaml` of the IMU, whose frame is the body's; returns the number of rows."""
    block = recording.block(imu.topic)
    header = ["timestamp [ns]", *(f"{n} [{u}]" for n, u in zip(IMU_COLUMNS, IMU_UNITS))]
    _write_csv(folder, header, block.t_ns, block.columns["angular_rate"], block.columns["specific_force"])
    lines = [
        "sensor_type: imu",
        f"comment: {_quote(imu.part)}",
        _format_transform(np.eye(4)),
        f"rate_hz: {imu.rate_hz!r}",
        f"gyroscope_noise_density: {imu.gyroscope_noise_density!r}  # rad/s/sqrt(Hz)",
        f"gyroscope_random_walk: {imu.gyroscope_random_walk!r}  # rad/s^2/sqrt(Hz)",
        f"accelerometer_noise_density: {imu.accelerometer_noise_density!r}  # m/s^2/sqrt(Hz)",
        f"accelerometer_random_walk: {imu.accelerometer_random_walk!r}  # m/s^3/sqrt(Hz)",
    ]
    (folder / "sensor.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return len(block)


def _write_stereo(
    recording: Recording, left: CameraCalibration, right: CameraCalibration, imu: ImuCalibration, root: Path
) -> dict[str, int]:
    """Writes `cam0` and the rendered `cam1`, both only of the images that have depth at the same stamp.

    Args:
        recording: The recording.
        left: Calibration of the recorded camera.
        right: Calibration of the virtual one.
        imu: IMU, in whose frame the cameras' poses are written.
        root: The folder `mav0`.

    Returns:
        Number of images by folder.

    Raises:
        ConfigError: The left camera has no depth.
    """
    if left.depth_topic not in recording.topics:
        raise ConfigError(recording.path, f"depth of {left.topic}", left.depth_topic or None, "a camera with depth")
    times = np.intersect1d(recording.image_times(left.topic), recording.image_times(left.depth_topic))
    baseline = float(np.linalg.norm(right.mount.T_body_sensor[:3, 3] - left.mount.T_body_sensor[:3, 3]))
    topics = {"cam0": left, "cam1": right}

    def images(camera: CameraCalibration) -> Iterator[Image]:
        """Yields the images of the left camera or, for the right one, those rendered from them and their depth."""
        for t in times.tolist():
            (image,) = recording.images(left.topic, t_ns=[t])
            assert isinstance(image, Image)
            if camera is right:
                (depth,) = recording.images(left.depth_topic, t_ns=[t])
                assert isinstance(depth, Depth)
                pixels = render_right_view(image.pixels, depth.depth, left.intrinsics[0], baseline)
                image = Image(topic=right.topic, t_ns=t, pixels=pixels)
            yield image

    return {name: _write_camera(images(camera), camera, imu, root / name) for name, camera in topics.items()}


def _write_camera(images: Iterable[Image], camera: CameraCalibration, imu: ImuCalibration, folder: Path) -> int:
    """Writes a camera's folder: the images as PNG, `data.csv` and `sensor.yaml`; returns the number of images.

    Args:
        images: The images in time order.
        camera: Calibration.
        imu: IMU on the same body; the pose T_BS is that of the optical frame in its frame.
        folder: The folder, which is made.
    """
    data = folder / "data"
    data.mkdir(parents=True)
    rows = ["#timestamp [ns],filename"]
    for sample in images:
        write_image(data / f"{sample.t_ns}.png", sample)
        rows.append(f"{sample.t_ns},{sample.t_ns}.png")
    (folder / "data.csv").write_text("\n".join(rows) + "\n", encoding="ascii")
    model = "radial-tangential" if camera.distortion_model == "radtan" else camera.distortion_model
    lines = [
        "sensor_type: camera",
        f"comment: {_quote(camera.part)}",
        _format_transform(np.linalg.inv(imu.mount.T_body_sensor) @ camera.mount.T_body_sensor),  # T_imu_camera
        f"rate_hz: {camera.rate_hz!r}",
        f"resolution: [{camera.width}, {camera.height}]",
        "camera_model: pinhole",
        f"intrinsics: {[float(v) for v in camera.intrinsics]}  # fu, fv, cu, cv",
        f"distortion_model: {model}",
        f"distortion_coefficients: {[float(v) for v in camera.distortion]}",
    ]
    (folder / "sensor.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return len(rows) - 1


def _write_truth(recording: Recording, topic: str, folder: Path) -> int:
    """Writes the true states of the IMU's frame, with biases of 0; returns the number of rows.

    A row has the stamp, position, quaternion and velocity, and the biases of gyroscope and accelerometer.

    Args:
        recording: The recording.
        topic: Topic of the true odometry of the IMU's frame.
        folder: The folder, which is made.
    """
    c = recording.block(topic).columns
    t_ns = recording.block(topic).t_ns
    biases = [f"b_{sensor}_RS_S_{axis}" for sensor in "wa" for axis in "xyz"]  # w: gyroscope, a: accelerometer
    units = ["m"] * 3 + [""] * 4 + ["m s^-1"] * 3 + ["rad s^-1"] * 3 + ["m s^-2"] * 3
    names = [*POSE_COLUMNS, *VELOCITY_COLUMNS, *biases]
    header = ["timestamp [ns]", *(f"{n} [{u}]" for n, u in zip(names, units))]
    zeros = np.zeros((len(t_ns), 6))
    _write_csv(folder, header, t_ns, c["p_frame_in_world"], c["q_world_frame"], c["v_frame_in_world"], zeros)
    (folder / "sensor.yaml").write_text(
        f"sensor_type: visual-inertial\n{_format_transform(np.eye(4))}\n", encoding="utf-8"
    )
    return len(t_ns)


def _write_csv(folder: Path, header: list[str], t_ns: Stamps, *columns: Array) -> None:
    """Writes `data.csv` in a new folder: stamps (N,) ns and columns (N, ...) side by side."""
    folder.mkdir(parents=True)
    write_text_rows(folder / "data.csv", f"#{','.join(header)}", ",", t_ns.tolist(), np.column_stack(columns))


def _with_both_names(rig: Rig, imu: ImuCalibration, cameras: list[CameraCalibration]) -> Rig:
    """A rig with the IMU and the cameras twice: under their own topics, and under those of an import of this layout.

    Args:
        rig: Rig of the recording, whose boards are kept.
        imu: IMU that is written.
        cameras: Cameras that are written as `cam0` and `cam1`.
    """
    as_imported = [replace(c, topic=NAMES[f"cam{i}"], imu_topic=NAMES["imu0"]) for i, c in enumerate(cameras)]
    all_imus = [imu, replace(imu, topic=NAMES["imu0"])]
    all_cameras = [*cameras, *as_imported]  # those of the import last, because they take precedence there
    return Rig(imus={i.topic: i for i in all_imus}, cameras={c.topic: c for c in all_cameras}, boards=rig.boards)


def _format_transform(T: Array) -> str:
    """A transform (4, 4) as the lines of YAML that OpenCV's matrices have in this layout."""
    return f"T_BS:\n  cols: 4\n  rows: 4\n  data: [{', '.join(repr(float(v)) for v in T.ravel())}]"


def _quote(text: str) -> str:
    """A text as a quoted YAML string."""
    return "'" + text.replace("'", "''") + "'"
