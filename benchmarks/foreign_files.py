"""Small recordings in every import format, written without the project's own writers; tests share them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

from stridetwin.streams.recording.reader import RecordingWriter
from stridetwin.streams.rig import ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Block, Image, Imu

SECOND = 1_000_000_000
START = 1_403_636_579 * SECOND
IMU_HZ, IMAGE_HZ, SECONDS = 100, 5, 2
WIDTH, HEIGHT = 32, 24
K = (26.0, 26.5, 15.5, 11.5)


class Walk:
    """The common contents of the files: 2 s of an IMU, images, depth and a true path.

    Attributes:
        t: (N,) ns, IMU and truth.
        gyro: (N, 3) rad/s.
        accel: (N, 3) m/s².
        p: (N, 3) m.
        q: (N, 4) w, x, y, z.
        t_images: (M,) ns.
        colour: (M, H, W, 3) RGB.
        depth_mm: (M, H, W), including a 0 and a 65535, which both mean no depth.
    """

    def __init__(self, seed: int = 5) -> None:
        rng = np.random.default_rng(seed)
        n, m = IMU_HZ * SECONDS, IMAGE_HZ * SECONDS
        self.t = START + np.arange(n) * (SECOND // IMU_HZ)
        self.gyro = rng.normal(0, 0.3, (n, 3))
        self.accel = rng.normal((0, 0, 9.81), 0.05, (n, 3))
        self.p = np.cumsum(rng.normal(0, 0.01, (n, 3)), axis=0)
        half = 0.2 * np.sin(np.arange(n) / 50)
        self.q = np.column_stack((np.cos(half), np.zeros((n, 2)), np.sin(half)))
        self.t_images = START + np.arange(m) * (SECOND // IMAGE_HZ)
        self.colour = rng.integers(0, 256, (m, HEIGHT, WIDTH, 3), np.uint8)
        self.depth_mm = rng.integers(500, 3000, (m, HEIGHT, WIDTH)).astype(np.uint16)
        self.depth_mm[:, 0, :2] = 0, 65535


def write_euroc(folder: Path, walk: Walk) -> Path:
    root = folder / "euroc" / "mav0"
    identity = "T_BS:\n  cols: 4\n  rows: 4\n  data: [1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0]\n"
    for name in ("imu0", "cam0/data", "state_groundtruth_estimate0"):
        (root / name).mkdir(parents=True)
    names = ",".join([f"w_RS_S_{a} [rad s^-1]" for a in "xyz"] + [f"a_RS_S_{a} [m s^-2]" for a in "xyz"])
    _csv(root / "imu0" / "data.csv", f"#timestamp [ns],{names}", walk.t, walk.gyro, walk.accel)
    noise = "".join(
        f"{sensor}_{what}: 1.0e-03\n"
        for sensor in ("gyroscope", "accelerometer")
        for what in ("noise_density", "random_walk")
    )
    (root / "imu0" / "sensor.yaml").write_text(f"%YAML:1.0\nsensor_type: imu\n{identity}rate_hz: {IMU_HZ}\n{noise}")
    rows = ["#timestamp [ns],filename"]
    for t, pixels in zip(walk.t_images.tolist(), walk.colour):
        cv2.imwrite(str(root / "cam0" / "data" / f"{t}.png"), cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))
        rows.append(f"{t},{t}.png")
    (root / "cam0" / "data.csv").write_text("\r\n".join(rows) + "\r\n")
    (root / "cam0" / "sensor.yaml").write_text(
        f"sensor_type: camera\n{identity}rate_hz: {IMAGE_HZ}\nresolution: [{WIDTH}, {HEIGHT}]\n"
        f"camera_model: pinhole\nintrinsics: {list(K)}\ndistortion_model: radial-tangential\n"
        "distortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]\n"
    )
    names = ",".join([f"p_RS_R_{a} [m]" for a in "xyz"] + [f"q_RS_{a} []" for a in "wxyz"])
    _csv(root / "state_groundtruth_estimate0" / "data.csv", f"#timestamp, {names}", walk.t, walk.p, walk.q)
    return folder / "euroc"


def write_tum(folder: Path, walk: Walk) -> Path:
    root = folder / "tum"
    for name in ("rgb", "depth"):
        (root / name).mkdir(parents=True)
    lists: dict[str, list[str]] = {"rgb": ["# color images", "# timestamp filename"], "depth": ["# depth maps"]}
    for t, pixels, mm in zip(walk.t_images.tolist(), walk.colour, walk.depth_mm):
        stamp = f"{t / 1e9:.6f}"
        depth = np.where((mm == 0) | (mm == 65535), mm, mm * 5).astype(np.uint16)
        cv2.imwrite(str(root / "rgb" / f"{stamp}.png"), pixels[..., ::-1])
        cv2.imwrite(str(root / "depth" / f"{stamp}.png"), depth)
        for name, rows in lists.items():
            rows.append(f"{stamp} {name}/{stamp}.png")
    for name, rows in lists.items():
        (root / f"{name}.txt").write_text("\n".join(rows) + "\n")
    _text(root / "groundtruth.txt", "# timestamp tx ty tz qx qy qz qw", walk.t, walk.p, walk.q[:, [1, 2, 3, 0]])
    _text(root / "accelerometer.txt", "# timestamp ax ay az", walk.t, walk.accel)
    (root / "calibration.txt").write_text(" ".join(map(str, K)) + "\n")
    return root


def write_seven_scenes(folder: Path, walk: Walk) -> Path:
    root = folder / "7scenes"
    root.mkdir()
    for i, (pixels, mm) in enumerate(zip(walk.colour, walk.depth_mm)):
        cv2.imwrite(str(root / f"frame-{i:06d}.color.png"), pixels[..., ::-1])
        cv2.imwrite(str(root / f"frame-{i:06d}.depth.png"), mm)
        T = np.eye(4)
        T[:3, 3] = walk.p[i]
        np.savetxt(root / f"frame-{i:06d}.pose.txt", T)
    np.savetxt(root / "camera-intrinsics.txt", [[K[0], 0, K[2]], [0, K[1], K[3]], [0, 0, 1]])
    return root


def write_csv_table(folder: Path, walk: Walk) -> Path:
    header = "t,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z"
    rows = np.column_stack(((walk.t - START) / 1e9, walk.accel, walk.gyro))
    np.savetxt(folder / "imu.csv", rows, delimiter=",", header=header, comments="", fmt="%.9g")
    return folder / "imu.csv"


def write_npz_table(folder: Path, walk: Walk) -> Path:
    np.savez_compressed(folder / "imu.npz", t=(walk.t - START) / 1e9, accel=walk.accel, gyro=walk.gyro)
    return folder / "imu.npz"


def write_ours(folder: Path, walk: Walk) -> Path:
    imu = ImuCalibration(
        topic="/head/imu",
        part="BMI055",
        rate_hz=IMU_HZ,
        mount=Mount(body="head"),
        gyroscope_noise_density=1e-3,
        gyroscope_random_walk=1e-5,
        accelerometer_noise_density=1e-2,
        accelerometer_random_walk=1e-4,
    )
    columns = {"angular_rate": walk.gyro, "specific_force": walk.accel}
    with RecordingWriter(folder / "walk.mcap", Rig(imus={imu.topic: imu}), {"seed": "1"}) as writer:
        writer.write(Block(topic=imu.topic, kind=Imu, t_ns=walk.t, columns=columns))
        for t, pixels in zip(walk.t_images.tolist(), walk.colour):
            writer.write(Image(topic="/head/color", t_ns=t, pixels=pixels))
    return folder / "walk.mcap"


def write_rosbag1(folder: Path, walk: Walk) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    bag = Ros1Writer(folder / "walk.bag")
    bag.set_compression(Ros1Writer.CompressionFormat.LZ4)
    with bag as writer:
        _feed(writer, store, walk, store.serialize_ros1, seq=True)
    return folder / "walk.bag"


def write_rosbag2(folder: Path, walk: Walk) -> Path:
    return _rosbag2(folder / "bag_sqlite", walk, StoragePlugin.SQLITE3)


def write_rosbag2_mcap(folder: Path, walk: Walk) -> Path:
    return _rosbag2(folder / "bag_mcap", walk, StoragePlugin.MCAP)


def write_foreign_mcap(
    folder: Path, walk: Walk, compression: CompressionType = CompressionType.LZ4, chunked: bool = True
) -> Path:
    """A file as the mcap library writes it, with its CRCs."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    path = folder / "robot.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, use_chunking=chunked, chunk_size=20_000, enable_data_crcs=True)
        writer.start("ros2", "someone")
        feed = _McapFeed(writer)
        _feed(feed, store, walk, lambda m, name: store.serialize_cdr(m, name))
        writer.finish()
    return path


FORMATS: dict[str, Callable[[Path, Walk], Path]] = {
    "mcap": write_ours,
    "mcap_foreign": write_foreign_mcap,
    "rosbag1": write_rosbag1,
    "rosbag2_sqlite": write_rosbag2,
    "rosbag2_mcap": write_rosbag2_mcap,
    "euroc": write_euroc,
    "tum": write_tum,
    "7scenes": write_seven_scenes,
    "table_csv": write_csv_table,
    "table_npz": write_npz_table,
}


class _McapFeed:
    """The mcap library's writer, with the interface of the rosbags writers."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}

    def add_connection(self, topic: str, name: str, *, typestore: Any) -> int:
        if name not in self._schemas:
            text, _ = typestore.generate_msgdef(name, ros_version=2)
            self._schemas[name] = self._writer.register_schema(name, "ros2msg", text.encode())
        return int(self._writer.register_channel(topic, "cdr", self._schemas[name]))

    def write(self, connection: int, t_ns: int, data: Any) -> None:
        self._writer.add_message(connection, log_time=t_ns, publish_time=t_ns, data=bytes(data))


def _rosbag2(folder: Path, walk: Walk, storage: StoragePlugin) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Ros2Writer(folder, version=9, storage_plugin=storage) as writer:
        _feed(writer, store, walk, store.serialize_cdr)
    return folder


def _feed(writer: Any, store: Any, walk: Walk, serialise: Callable[[Any, str], Any], seq: bool = False) -> None:
    """Messages under the topic names of a RealSense driver and of a motion capture system, in time order."""
    names = {
        "/camera/imu": "sensor_msgs/msg/Imu",
        "/camera/color/image_raw": "sensor_msgs/msg/Image",
        "/camera/color/camera_info": "sensor_msgs/msg/CameraInfo",
        "/camera/aligned_depth_to_color/image_raw": "sensor_msgs/msg/Image",
        "/camera/aligned_depth_to_color/camera_info": "sensor_msgs/msg/CameraInfo",
        "/vicon/head": "geometry_msgs/msg/PoseStamped",
        "/rosout_like": "std_msgs/msg/String",
    }
    to = {topic: writer.add_connection(topic, name, typestore=store) for topic, name in names.items()}
    messages: list[tuple[int, str, Any]] = [(int(walk.t[0]), "/rosout_like", store.types["std_msgs/msg/String"]("hi"))]
    for i, t in enumerate(walk.t.tolist()):
        messages.append((t, "/camera/imu", _imu(store, t, walk.gyro[i], walk.accel[i])))
        messages.append((t, "/vicon/head", _pose(store, t, walk.p[i], walk.q[i])))
    for t, colour, mm in zip(walk.t_images.tolist(), walk.colour, walk.depth_mm):
        messages.append((t, "/camera/color/image_raw", _image(store, t, "rgb8", colour)))
        messages.append((t, "/camera/aligned_depth_to_color/image_raw", _image(store, t, "16UC1", mm)))
        for topic in ("/camera/color/camera_info", "/camera/aligned_depth_to_color/camera_info"):
            messages.append((t, topic, _info(store, t, seq)))
    for t, topic, message in sorted(messages, key=lambda m: m[0]):
        writer.write(to[topic], t, serialise(message, names[topic]))


def _header(store: Any, t: int, frame: str) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](*divmod(t, SECOND))
    header = store.types["std_msgs/msg/Header"]
    return header(stamp=stamp, frame_id=frame) if "seq" not in header.__dataclass_fields__ else header(0, stamp, frame)


def _imu(store: Any, t: int, gyro: Any, accel: Any) -> Any:
    vector, quaternion = store.types["geometry_msgs/msg/Vector3"], store.types["geometry_msgs/msg/Quaternion"]
    absent = np.array([-1.0, 0, 0, 0, 0, 0, 0, 0, 0])
    return store.types["sensor_msgs/msg/Imu"](
        _header(store, t, "camera_imu"),
        quaternion(0.0, 0.0, 0.0, 1.0),
        absent,
        vector(*gyro.tolist()),
        np.zeros(9),
        vector(*accel.tolist()),
        np.zeros(9),
    )


def _pose(store: Any, t: int, p: Any, q: Any) -> Any:
    point, quaternion = store.types["geometry_msgs/msg/Point"], store.types["geometry_msgs/msg/Quaternion"]
    w, x, y, z = q.tolist()
    pose = store.types["geometry_msgs/msg/Pose"](point(*p.tolist()), quaternion(x, y, z, w))
    return store.types["geometry_msgs/msg/PoseStamped"](_header(store, t, "world"), pose)


def _image(store: Any, t: int, encoding: str, pixels: Any) -> Any:
    data = np.ascontiguousarray(pixels).reshape(-1).view(np.uint8)
    step = len(data) // HEIGHT
    header = _header(store, t, "camera_color")
    return store.types["sensor_msgs/msg/Image"](header, HEIGHT, WIDTH, encoding, 0, step, data)


def _info(store: Any, t: int, upper: bool) -> Any:
    roi = store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    k = np.array([K[0], 0, K[2], 0, K[1], K[3], 0, 0, 1])
    names = ("D", "K", "R", "P") if upper else ("d", "k", "r", "p")
    parts = dict(zip(names, (np.zeros(5), k, np.eye(3).ravel(), np.zeros(12))))
    return store.types["sensor_msgs/msg/CameraInfo"](
        header=_header(store, t, "camera_color"),
        height=HEIGHT,
        width=WIDTH,
        distortion_model="plumb_bob",
        binning_x=0,
        binning_y=0,
        roi=roi,
        **parts,
    )


def _csv(path: Path, header: str, t: Any, *columns: Any) -> None:
    rows = zip(t.tolist(), np.column_stack(columns).tolist())
    path.write_text("\r\n".join([header, *(f"{s},{','.join(map(repr, row))}" for s, row in rows)]) + "\r\n")


def _text(path: Path, header: str, t: Any, *columns: Any) -> None:
    rows = zip(t.tolist(), np.column_stack(columns).tolist())
    path.write_text("\n".join([header, *(f"{s / 1e9:.6f} {' '.join(map(repr, row))}" for s, row in rows)]) + "\n")


def write_realsense_bag(folder: Path, walk: Walk, depth_units_m: float = 0.001) -> Path:
    """A ROS 1 bag as RealSense's viewer records it: gyro, accelerometer, colour, depth and infrared."""
    store, path = get_typestore(Stores.ROS1_NOETIC), folder / "realsense.bag"
    sensors = {"Depth_0": 0, "Infrared_1": 0, "Color_0": 1, "Gyro_0": 2, "Accel_0": 2}
    topics = {name: f"/device_0/sensor_{sensor}/{name}" for name, sensor in sensors.items()}
    messages: list[tuple[int, str, str, Any]] = []
    units = store.types["std_msgs/msg/Float32"](depth_units_m)
    messages.append((int(walk.t[0]), "/device_0/sensor_0/option/Depth_Units/value", "std_msgs/msg/Float32", units))
    for t, gyro, accel in zip(walk.t.tolist(), walk.gyro, walk.accel):
        for name, rates, forces in (("Gyro_0", gyro, np.zeros(3)), ("Accel_0", np.zeros(3), accel)):
            messages.append((t, f"{topics[name]}/imu/data", "sensor_msgs/msg/Imu", _imu(store, t, rates, forces)))
    for t, colour, mm in zip(walk.t_images.tolist(), walk.colour, walk.depth_mm):
        grey = colour[:, :, 1]
        for name, encoding, pixels in (
            ("Depth_0", "mono16", mm),
            ("Infrared_1", "mono8", grey),
            ("Color_0", "rgb8", colour),
        ):
            image = _image(store, t, encoding, pixels)
            messages.append((t, f"{topics[name]}/image/data", "sensor_msgs/msg/Image", image))
    for name in ("Depth_0", "Infrared_1", "Color_0"):
        info = _info(store, int(walk.t[0]), True)
        messages.append((int(walk.t[0]), f"{topics[name]}/info/camera_info", "sensor_msgs/msg/CameraInfo", info))
    with Ros1Writer(path) as writer:
        kinds = {topic: name for _, topic, name, _ in messages}
        to = {topic: writer.add_connection(topic, name, typestore=store) for topic, name in kinds.items()}
        for t, topic, name, message in sorted(messages, key=lambda m: m[0]):
            writer.write(to[topic], t, store.serialize_ros1(message, name))
    return path
