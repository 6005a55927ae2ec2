"""Writes walks in the formats of other tools, without the project's own writers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from benchmarks.implausible.walks import START_NS, Inertial, Views, Walk
from stridetwin.streams.formats.imu_text import TableRequest
from stridetwin.streams.formats.opening import ImportOptions
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2
from stridetwin.streams.samples import Array, Stamps

_SECOND = 10**9
"""A second, ns."""
_DEGREE = np.pi / 180
"""A degree, rad."""
_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]
"""OpenCV's parameters of PNGs that are written fast rather than small."""
_LOGGER_START_NS = 7200 * _SECOND
"""How long loggers have been on before the first sample, ns."""
_LARGEST_UNIT = 65534
"""Largest number of a depth image; 65535 is none."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """A written recording.

    Attributes:
        path: File or folder.
        options: With which its user opens it.
    """

    path: Path
    options: ImportOptions = field(default_factory=ImportOptions)


_NAMES = ",".join([f"a{a} [m/s^2]" for a in "xyz"] + [f"g{a} [rad/s]" for a in "xyz"])
"""Columns of a user's own table."""


def _rate_hz(imu: Inertial) -> float:
    """Rate of the samples, by the counter."""
    return float((imu.count[-1] - imu.count[0]) * _SECOND / (imu.t_ns[-1] - imu.t_ns[0]))


def _write_table(path: Path, header: str, columns: Array, separator: str = ",") -> Path:
    """A text table; columns (N, K)."""
    np.savetxt(path, columns, fmt="%.12g", delimiter=separator, header=header, comments="")
    return path


def _to_seconds(t_ns: Stamps) -> Array:
    """Stamps (N,) ns as the times of a logger, in s; they are positive for a clock that is an hour late, too."""
    return np.asarray((t_ns - START_NS + _LOGGER_START_NS) * 1e-9)


def write_csv(folder: Path, walk: Walk) -> Source:
    """A table in SI units."""
    imu = walk.imu
    header = "t,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z"
    columns = np.column_stack([_to_seconds(imu.t_ns), imu.force, imu.rate])
    return Source(path=_write_table(folder / "imu.csv", header, columns))


def write_npz(folder: Path, walk: Walk) -> Source:
    """Arrays in SI units."""
    imu = walk.imu
    np.savez_compressed(folder / "imu.npz", t=_to_seconds(imu.t_ns), accel=imu.force, gyro=imu.rate)
    return Source(path=folder / "imu.npz")


def write_ngimu(folder: Path, walk: Walk) -> Source:
    """A table with other units, which its header names."""
    imu = walk.imu
    names = [f"Gyroscope {a} (deg/s)" for a in "XYZ"] + [f"Accelerometer {a} (g)" for a in "XYZ"]
    columns = np.column_stack([_to_seconds(imu.t_ns), imu.rate / _DEGREE, imu.force / STANDARD_GRAVITY_MPS2])
    return Source(path=_write_table(folder / "sensors.csv", ",".join(["Time (s)", *names]), columns))


def write_xsens(folder: Path, walk: Walk) -> Source:
    """MT Manager's table: a counter of packets, and the rate above the names."""
    imu = walk.imu
    names = ["PacketCounter", *(f"{s}_{a}" for s in ("Acc", "Gyr") for a in "XYZ")]
    header = f"// Start Time: Unknown\n// Update Rate: {_rate_hz(imu):.1f}Hz\n" + "\t".join(names)
    columns = np.column_stack([imu.count, imu.force, imu.rate])
    return Source(path=_write_table(folder / "MT_012-000_00B4.txt", header, columns, "\t"))


def write_counted(folder: Path, walk: Walk) -> Source:
    """A table with a counter of packets and no rate, which the user gives."""
    imu = walk.imu
    columns = np.column_stack([imu.count, imu.force, imu.rate])
    path = _write_table(folder / "log.csv", f"packet_counter,{_NAMES}", columns)
    return Source(path=path, options=ImportOptions(table=TableRequest(rate_hz=round(_rate_hz(imu)))))


def write_rows(folder: Path, walk: Walk) -> Source:
    """A table without stamps and counter, whose user gives the rate."""
    imu = walk.imu
    path = _write_table(folder / "log.csv", _NAMES, np.column_stack([imu.force, imu.rate]))
    return Source(path=path, options=ImportOptions(table=TableRequest(rate_hz=round(_rate_hz(imu)))))


def write_two_tables(folder: Path, walk: Walk) -> Source:
    """MetaMotion's folder: rates and forces in a file each, with stamps of their own."""
    imu, root = walk.imu, folder / "metamotion"
    root.mkdir()
    streams = (
        ("Accelerometer", "g", imu.force_t_ns, imu.force / STANDARD_GRAVITY_MPS2),
        ("Gyroscope", "deg/s", imu.t_ns, imu.rate / _DEGREE),
    )
    for name, unit, t_ns, values in streams:
        header = ",".join(["elapsed (s)", *(f"{a}-axis ({unit})" for a in "xyz")])
        file = root / f"Walk_MetaWear_2019-12-10T09.46.40_E1F2_{name}_100.000Hz_1.4.4.csv"
        _write_table(file, header, np.column_stack([_to_seconds(t_ns), values]))
    return Source(path=root)


# --- folders of images ---


def _take_views(walk: Walk) -> Views:
    """The images of a walk that has them."""
    assert walk.views is not None
    return walk.views


def _to_units(depth_m: Array, per_metre: float) -> Array:
    """Depth images as 16-bit numbers; what is beyond their range is no depth."""
    units = np.rint(depth_m * per_metre)
    return np.where(units > _LARGEST_UNIT, 0, units).astype(np.uint16)


def _list_rows(t_ns: Stamps, *columns: Array, separator: str = " ", in_seconds: bool = True) -> list[str]:
    """Lines of a stamp and numbers; columns (N, K)."""
    stamps = [f"{t / _SECOND:.6f}" if in_seconds else str(t) for t in t_ns.tolist()]
    cells = [separator.join(f"{v:.9g}" for v in row) for row in np.column_stack(columns).tolist()]
    return [f"{stamp}{separator}{text}" for stamp, text in zip(stamps, cells)]


def _to_quaternions(T: Array) -> Array:
    """(M, 4) x, y, z, w of transforms (M, 4, 4)."""
    return np.asarray(Rotation.from_matrix(T[:, :3, :3]).as_quat())


def write_euroc(folder: Path, walk: Walk) -> Source:
    """EuRoC's layout with one grey camera, whose calibration is in its `sensor.yaml`."""
    imu, views, root = walk.imu, _take_views(walk), folder / "euroc" / "mav0"
    for name in ("imu0", "cam0/data"):
        (root / name).mkdir(parents=True)
    names = ",".join([f"w_RS_S_{a} [rad s^-1]" for a in "xyz"] + [f"a_RS_S_{a} [m s^-2]" for a in "xyz"])
    rows = _list_rows(imu.t_ns, imu.rate, imu.force, separator=",", in_seconds=False)
    (root / "imu0" / "data.csv").write_text("\n".join([f"#timestamp [ns],{names}", *rows]) + "\n")
    noise = walk.noise
    (root / "imu0" / "sensor.yaml").write_text(
        f"sensor_type: imu\n{_print_transform(np.eye(4))}rate_hz: {round(_rate_hz(imu))}\n"
        f"gyroscope_noise_density: {noise.gyroscope_noise_density}\n"
        f"gyroscope_random_walk: {noise.gyroscope_random_walk}\n"
        f"accelerometer_noise_density: {noise.accelerometer_noise_density}\n"
        f"accelerometer_random_walk: {noise.accelerometer_random_walk}\n"
    )
    listed = ["#timestamp [ns],filename"]
    for t, pixels in zip(views.t_ns.tolist(), views.colour):
        grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
        cv2.imwrite(str(root / "cam0" / "data" / f"{t}.png"), grey, _FAST_PNG)
        listed.append(f"{t},{t}.png")
    (root / "cam0" / "data.csv").write_text("\n".join(listed) + "\n")
    height, width = views.colour.shape[1:3]
    rate_hz = 1e9 / float(np.median(np.diff(views.t_ns)))
    (root / "cam0" / "sensor.yaml").write_text(
        f"sensor_type: camera\n{_print_transform(views.T_imu_cam)}rate_hz: {rate_hz:.1f}\n"
        f"resolution: [{width}, {height}]\n"
        f"camera_model: pinhole\nintrinsics: {list(views.intrinsics)}\ndistortion_model: radial-tangential\n"
        "distortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n"
    )
    return Source(path=folder / "euroc")


def _print_transform(T: Array) -> str:
    """A transform (4, 4) as the layout's YAML has it."""
    return f"T_BS:\n  cols: 4\n  rows: 4\n  data: {[float(v) for v in T.ravel()]}\n"


def _write_tum(folder: Path, walk: Walk) -> Path:
    """TUM's RGB-D layout without its inertial files, with the camera's calibration as `rig.yaml` of Kalibr."""
    views, root = _take_views(walk), folder / "tum"
    lists: dict[str, list[str]] = {"rgb": ["# timestamp filename"], "depth": ["# timestamp filename"]}
    for name, rows in lists.items():
        (root / name).mkdir(parents=True)
        rows += [f"{t / _SECOND:.6f} {name}/{t / _SECOND:.6f}.png" for t in views.t_ns.tolist()]
        (root / f"{name}.txt").write_text("\n".join(rows) + "\n")
    for t, pixels, depth in zip(views.t_ns.tolist(), views.colour, views.depth_m):
        name = f"{t / _SECOND:.6f}.png"
        cv2.imwrite(str(root / "rgb" / name), pixels[..., ::-1], _FAST_PNG)
        cv2.imwrite(str(root / "depth" / name), _to_units(depth, 5000.0), _FAST_PNG)
    T = views.T_world_cam
    rows = _list_rows(views.t_ns, T[:, :3, 3], _to_quaternions(T))
    (root / "groundtruth.txt").write_text("\n".join(["# timestamp tx ty tz qx qy qz qw", *rows]) + "\n")
    (root / "rig.yaml").write_text(kalibr_text(walk, "/head/color", "/head/imu"))
    (root / "calibration.txt").write_text(" ".join(map(str, views.intrinsics)) + "\n")
    return root


def write_tum(folder: Path, walk: Walk) -> Source:
    """TUM's RGB-D layout with rates and forces in `imu.txt`."""
    root, imu = _write_tum(folder, walk), walk.imu
    rows = _list_rows(imu.t_ns, imu.rate, imu.force)
    (root / "imu.txt").write_text("\n".join(["# timestamp wx wy wz ax ay az", *rows]) + "\n")
    return Source(path=root)


def write_tum_in_parts(folder: Path, walk: Walk) -> Source:
    """TUM's RGB-D layout with `gyroscope.txt` and `accelerometer.txt`."""
    root, imu = _write_tum(folder, walk), walk.imu
    rates, forces = _list_rows(imu.t_ns, imu.rate), _list_rows(imu.force_t_ns, imu.force)
    (root / "gyroscope.txt").write_text("\n".join(["# timestamp wx wy wz", *rates]) + "\n")
    (root / "accelerometer.txt").write_text("\n".join(["# timestamp ax ay az", *forces]) + "\n")
    return Source(path=root)


def kalibr_text(walk: Walk, camera: str, imu: str) -> str:
    """Camera and IMU as Kalibr writes them, with the topics `camera` and `imu`."""
    views, noise = _take_views(walk), walk.noise
    height, width = views.colour.shape[1:3]
    rows = "\n".join(f"    - {[float(v) for v in row]}" for row in np.linalg.inv(views.T_imu_cam))
    return (
        f"cam0:\n  camera_model: pinhole\n  intrinsics: {list(views.intrinsics)}\n  distortion_model: radtan\n"
        f"  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]\n  resolution: [{width}, {height}]\n  rostopic: {camera}\n"
        f"  T_cam_imu:\n{rows}\n  timeshift_cam_imu: 0.0\n"
        f"imu0:\n  accelerometer_noise_density: {noise.accelerometer_noise_density}\n"
        f"  accelerometer_random_walk: {noise.accelerometer_random_walk}\n"
        f"  gyroscope_noise_density: {noise.gyroscope_noise_density}\n"
        f"  gyroscope_random_walk: {noise.gyroscope_random_walk}\n"
        f"  rostopic: {imu}\n  update_rate: {float(round(_rate_hz(walk.imu)))}\n"
    )


def write_seven_scenes(folder: Path, walk: Walk) -> Source:
    """The 7-Scenes layout: images and poses of the camera, without stamps and IMU."""
    views, root = _take_views(walk), folder / "7scenes"
    root.mkdir()
    for i, (pixels, depth, T) in enumerate(zip(views.colour, views.depth_m, views.T_world_cam)):
        cv2.imwrite(str(root / f"frame-{i:06d}.color.png"), pixels[..., ::-1], _FAST_PNG)
        cv2.imwrite(str(root / f"frame-{i:06d}.depth.png"), _to_units(depth, 1000.0), _FAST_PNG)
        np.savetxt(root / f"frame-{i:06d}.pose.txt", T)
    fu, fv, pu, pv = views.intrinsics
    np.savetxt(root / "camera-intrinsics.txt", np.array([[fu, 0.0, pu], [0.0, fv, pv], [0.0, 0.0, 1.0]]))
    return Source(path=root)


# --- bags ---

_Messages = list[tuple[int, str, str, Any]]
"""Time in ns, topic, type and message of each."""
_COLOUR, _DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
"""Topics of the images, as RealSense's driver calls them."""
_IMU_FRAME, _CAMERA_FRAME = "camera_imu_optical_frame", "camera_color_optical_frame"
"""Its names of the frames."""
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
"""Type of the messages in `/tf_static`."""


class _RosTypes:
    """Messages of one release of ROS."""

    def __init__(self, release: Stores) -> None:
        self.store = get_typestore(release)
        self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TRANSFORMS))
        self.is_ros1 = release == Stores.ROS1_NOETIC

    def build(self, name: str, **fields: Any) -> Any:
        """A message of a type such as `sensor_msgs/msg/Imu`."""
        return self.store.types[name](**fields)

    def header(self, t_ns: int, frame: str) -> Any:
        """A header with a stamp and the name of a frame."""
        sec, nanosec = divmod(t_ns, _SECOND)
        stamp = self.build("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        count = {"seq": 0} if self.is_ros1 else {}
        return self.build("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **count)

    def vector(self, xyz: Array) -> Any:
        """A Vector3 of (3,) numbers."""
        x, y, z = (float(v) for v in xyz)
        return self.build("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def quaternion(self, xyzw: Array) -> Any:
        """A Quaternion of (4,) numbers x, y, z, w."""
        x, y, z, w = (float(v) for v in xyzw)
        return self.build("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def imu(self, t_ns: int, rate: Array, force: Array) -> Any:
        """An Imu without attitude, of a rate (3,) rad/s and a force (3,) m/s²."""
        return self.build(
            "sensor_msgs/msg/Imu",
            header=self.header(t_ns, _IMU_FRAME),
            orientation=self.quaternion(np.array([0, 0, 0, 1])),
            orientation_covariance=np.array([-1.0, 0, 0, 0, 0, 0, 0, 0, 0]),
            angular_velocity=self.vector(rate),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self.vector(force),
            linear_acceleration_covariance=np.zeros(9),
        )

    def image(self, t_ns: int, encoding: str, pixels: Array) -> Any:
        """An Image of pixels (H, W) or (H, W, 3)."""
        data = np.ascontiguousarray(pixels).reshape(-1).view(np.uint8)
        return self.build(
            "sensor_msgs/msg/Image",
            header=self.header(t_ns, _CAMERA_FRAME),
            height=len(pixels),
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=len(data) // len(pixels),
            data=data,
        )

    def camera_info(self, t_ns: int, views: Views) -> Any:
        """A CameraInfo with the intrinsics of views, and no distortion."""
        fu, fv, pu, pv = views.intrinsics
        K = np.array([fu, 0, pu, 0, fv, pv, 0, 0, 1.0])
        P = np.array([fu, 0, pu, 0, 0, fv, pv, 0, 0, 0, 1.0, 0])
        values = {"d": np.zeros(5), "k": K, "r": np.eye(3).ravel(), "p": P}
        roi = self.build(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        return self.build(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(t_ns, _CAMERA_FRAME),
            height=views.colour.shape[1],
            width=views.colour.shape[2],
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=roi,
            **{name.upper() if self.is_ros1 else name: value for name, value in values.items()},
        )

    def static_transform(self, t_ns: int, T: Array) -> Any:
        """The pose (4, 4) of the camera in the IMU's frame, as `/tf_static` has it."""
        transform = self.build(
            "geometry_msgs/msg/Transform",
            translation=self.vector(T[:3, 3]),
            rotation=self.quaternion(_to_quaternions(T[None])[0]),
        )
        stamped = self.build(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(t_ns, _IMU_FRAME),
            child_frame_id=_CAMERA_FRAME,
            transform=transform,
        )
        return self.build(_TRANSFORMS, transforms=[stamped])


def _list_imu(ros: _RosTypes, imu: Inertial, topic: str) -> _Messages:
    """Rates and forces as one topic."""
    rows = zip(imu.t_ns.tolist(), imu.rate, imu.force)
    return [(t, topic, "sensor_msgs/msg/Imu", ros.imu(t, rate, force)) for t, rate, force in rows]


def _list_gyro_and_accel(ros: _RosTypes, imu: Inertial) -> _Messages:
    """Rates and forces as two topics, as RealSense's driver publishes them."""
    none = np.zeros(3)
    rates = zip(imu.t_ns.tolist(), imu.rate)
    forces = zip(imu.force_t_ns.tolist(), imu.force)
    kind = "sensor_msgs/msg/Imu"
    messages = [(t, "/camera/gyro/sample", kind, ros.imu(t, rate, none)) for t, rate in rates]
    return messages + [(t, "/camera/accel/sample", kind, ros.imu(t, none, force)) for t, force in forces]


def _list_views(ros: _RosTypes, views: Views) -> _Messages:
    """Images, their calibration and their mount."""
    messages: _Messages = []
    for t, pixels, depth in zip(views.t_ns.tolist(), views.colour, views.depth_m):
        messages.append((t, _COLOUR, "sensor_msgs/msg/Image", ros.image(t, "rgb8", pixels)))
        messages.append((t, _DEPTH, "sensor_msgs/msg/Image", ros.image(t, "16UC1", _to_units(depth, 1000.0))))
        for topic in (_COLOUR, _DEPTH):
            info = topic.replace("image_raw", "camera_info")
            messages.append((t, info, "sensor_msgs/msg/CameraInfo", ros.camera_info(t, views)))
    first = int(views.t_ns[0])
    messages.append((first, "/tf_static", _TRANSFORMS, ros.static_transform(first, views.T_imu_cam)))
    return messages


def _write_messages(path: Path, ros: _RosTypes, messages: _Messages, storage: StoragePlugin | None) -> Path:
    """A bag of ROS 1, or of ROS 2 with a storage, with messages in the order of their times."""
    writer: Any = Ros1Writer(path) if storage is None else Ros2Writer(path, version=9, storage_plugin=storage)
    serialise = ros.store.serialize_ros1 if storage is None else ros.store.serialize_cdr
    with writer as bag:
        kinds = {topic: kind for _, topic, kind, _ in messages}
        channels = {topic: bag.add_connection(topic, kind, typestore=ros.store) for topic, kind in kinds.items()}
        for t, topic, kind, message in sorted(messages, key=lambda m: m[0]):
            bag.write(channels[topic], t, serialise(message, kind))
    return path


_ROS1, _SQLITE, _MCAP = None, StoragePlugin.SQLITE3, StoragePlugin.MCAP
"""Storages of bags; ROS 1 has none to choose."""


def _write_bag(folder: Path, list_messages: Callable[[_RosTypes], _Messages], storage: StoragePlugin | None) -> Source:
    """A bag with the messages that a function gives for the types of its release of ROS."""
    ros = _RosTypes(Stores.ROS1_NOETIC if storage is None else Stores.ROS2_HUMBLE)
    path = folder / ("walk.bag" if storage is None else "bag")
    return Source(path=_write_messages(path, ros, list_messages(ros), storage))


def write_foot_bag1(folder: Path, walk: Walk) -> Source:
    """A ROS 1 bag with the IMU of a foot."""
    return _write_bag(folder, lambda ros: _list_imu(ros, walk.imu, "/left_foot/imu/data"), _ROS1)


def write_foot_bag2(folder: Path, walk: Walk) -> Source:
    """A ROS 2 bag with the IMU of a foot."""
    return _write_bag(folder, lambda ros: _list_imu(ros, walk.imu, "/left_foot/imu/data"), _SQLITE)


def write_head_bag1(folder: Path, walk: Walk) -> Source:
    """A ROS 1 bag with an RGB-D camera and its IMU."""
    return _write_bag(
        folder, lambda ros: _list_imu(ros, walk.imu, "/camera/imu") + _list_views(ros, _take_views(walk)), _ROS1
    )


def write_head_bag2(folder: Path, walk: Walk) -> Source:
    """A ROS 2 bag with an RGB-D camera and its IMU."""
    return _write_bag(
        folder, lambda ros: _list_imu(ros, walk.imu, "/camera/imu") + _list_views(ros, _take_views(walk)), _MCAP
    )


def write_head_bag_in_parts(folder: Path, walk: Walk) -> Source:
    """A ROS 2 bag with an RGB-D camera, whose rates and forces are topics of their own."""
    return _write_bag(
        folder, lambda ros: _list_gyro_and_accel(ros, walk.imu) + _list_views(ros, _take_views(walk)), _SQLITE
    )


def write_calibrated_bag(folder: Path, walk: Walk) -> Source:
    """A ROS 2 bag with an RGB-D camera and its IMU, opened with a file of Kalibr's."""
    source = write_head_bag2(folder, walk)
    rig = folder / "camchain-imucam.yaml"
    rig.write_text(kalibr_text(walk, _COLOUR, "/camera/imu"))
    return Source(path=source.path, options=ImportOptions(rig=rig))


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format, and what its recordings hold.

    Attributes:
        family: `table`, `bag`, `euroc`, `tum` or `7scenes`.
        body: `foot` or `head`: whose walks it holds.
        write: Writes a walk into an empty folder.
        has: Which of `imu`, `parts` (rates and forces with stamps of their own), `stamps`, `counter`, `camera`,
            `depth` it has.
    """

    family: str
    body: str
    write: Callable[[Path, Walk], Source]
    has: frozenset[str]


def _define_format(family: str, body: str, write: Callable[[Path, Walk], Source], has: str) -> Format:
    """A format; `has` are the words of `Format.has`, separated by blanks."""
    return Format(family=family, body=body, write=write, has=frozenset(has.split()))


_ALL = "imu stamps camera depth"
"""What the formats of a head with depth have."""
FORMATS: Mapping[str, Format] = {
    "csv": _define_format("table", "foot", write_csv, "imu stamps"),
    "npz": _define_format("table", "foot", write_npz, "imu stamps"),
    "ngimu": _define_format("table", "foot", write_ngimu, "imu stamps"),
    "xsens": _define_format("table", "foot", write_xsens, "imu counter"),
    "counted": _define_format("table", "foot", write_counted, "imu counter"),
    "rows": _define_format("table", "foot", write_rows, "imu"),
    "two_tables": _define_format("table", "foot", write_two_tables, "imu stamps parts"),
    "foot_bag1": _define_format("bag", "foot", write_foot_bag1, "imu stamps"),
    "foot_bag2": _define_format("bag", "foot", write_foot_bag2, "imu stamps"),
    "head_bag1": _define_format("bag", "head", write_head_bag1, _ALL),
    "head_bag2": _define_format("bag", "head", write_head_bag2, _ALL),
    "head_bag_in_parts": _define_format("bag", "head", write_head_bag_in_parts, f"{_ALL} parts"),
    "calibrated_bag": _define_format("bag", "head", write_calibrated_bag, _ALL),
    "euroc": _define_format("euroc", "head", write_euroc, "imu stamps camera"),
    "tum": _define_format("tum", "head", write_tum, _ALL),
    "tum_in_parts": _define_format("tum", "head", write_tum_in_parts, f"{_ALL} parts"),
    "7scenes": _define_format("7scenes", "head", write_seven_scenes, "camera depth"),
}
"""The formats by their names."""
