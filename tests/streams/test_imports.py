"""Every import format gives the samples that were put in, and says what it had to assume."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.writer import CompressionType
from scipy.spatial.transform import Rotation

from benchmarks import foreign_files
from benchmarks.foreign_files import FORMATS, HEIGHT, IMU_HZ, START, WIDTH, K, Walk, write_foreign_mcap
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats import opening
from stridetwin.streams.formats.bag import assign_bag_topics
from stridetwin.streams.formats.derived import join_gyro_and_accel
from stridetwin.streams.formats.file_formats import FILE_FORMATS
from stridetwin.streams.formats.mcap_export import write_recording
from stridetwin.streams.formats.opening import ImportOptions, open_any, recognise
from stridetwin.streams.kalibr import write_rig
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.rig import ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Accelerometer, Block, Depth, Image, Imu, Odometry

BAGS = ("mcap_foreign", "rosbag1", "rosbag2_sqlite", "rosbag2_mcap")
FIRST = f"{START / 1e9:.6f}"
KIND = {"mcap_foreign": "mcap", "rosbag2_sqlite": "rosbag2", "rosbag2_mcap": "rosbag2"}
KIND |= {"table_csv": "table", "table_npz": "table"}


@pytest.fixture(scope="session")
def walk():
    return Walk()


@pytest.fixture(scope="session")
def sources(tmp_path_factory, walk):
    folder = tmp_path_factory.mktemp("foreign")
    return {name: write(folder, walk) for name, write in FORMATS.items()}


def copied(source, folder):
    target = folder / source.name
    shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)
    return target


def replaced(file, old, new):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


def expected_depth(walk):
    return np.where(walk.depth_mm == 65535, 0, walk.depth_mm) / 1000


@pytest.mark.parametrize("name", list(FORMATS))
def test_kind_is_seen_in_the_content(sources, name):
    assert recognise(sources[name]) == KIND.get(name, name)


@pytest.mark.parametrize("name", BAGS)
def test_bags_give_what_was_put_in(sources, walk, name):
    recording = open_any(sources[name])
    imu = recording.block("/head/imu")
    np.testing.assert_array_equal(imu.t_ns, walk.t)
    np.testing.assert_array_equal(imu.columns["angular_rate"], walk.gyro)
    np.testing.assert_array_equal(imu.columns["specific_force"], walk.accel)
    truth = recording.block("/truth/head/odometry")
    np.testing.assert_allclose(truth.columns["p_frame_in_world"], walk.p, atol=1e-12)
    np.testing.assert_allclose(truth.columns["q_world_frame"], walk.q, atol=1e-12)
    np.testing.assert_array_equal(recording.image_times("/head/color"), walk.t_images)
    images, depths = recording.images("/head/color"), recording.images("/head/depth", [7, 2])
    np.testing.assert_array_equal([p.pixels for p in images], walk.colour)
    np.testing.assert_allclose(depths[0].depth, expected_depth(walk)[7], atol=1e-6)
    assert depths[1].topic == "/head/depth"
    assert recording.unread == {"/rosout_like": "std_msgs/msg/String"}
    camera = recording.rig.cameras["/head/color"]
    assert camera.intrinsics == K
    assert (camera.width, camera.height, camera.depth_topic) == (WIDTH, HEIGHT, "/head/depth")
    assert any("/head/imu: no calibration" in w for w in recording.warnings)
    assert any("/head/color: no mount in /tf_static" in w for w in recording.warnings)


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4])
@pytest.mark.parametrize("chunked", [True, False])
def test_any_mcap_is_read(tmp_path, walk, compression, chunked):
    recording = open_any(write_foreign_mcap(tmp_path, walk, compression, chunked))
    np.testing.assert_array_equal(recording.block("/head/imu").columns["angular_rate"], walk.gyro)
    np.testing.assert_array_equal(recording.images("/head/color", [3])[0].pixels, walk.colour[3])


def test_euroc(sources, walk):
    recording = open_any(sources["euroc"])
    imu = recording.block("/head/imu")
    np.testing.assert_array_equal(imu.t_ns, walk.t)
    np.testing.assert_array_equal(imu.columns["specific_force"], walk.accel)
    (first,) = recording.images("/head/color", [0])
    assert first.pixels.shape == (HEIGHT, WIDTH)
    truth = recording.block("/truth/head/imu/odometry")
    np.testing.assert_allclose(truth.columns["p_frame_in_world"], walk.p, atol=1e-12)
    camera = recording.rig.cameras["/head/color"]
    assert camera.distortion == (-0.28, 0.07, 0.0002, 1.8e-05)
    assert camera.imu_topic == "/head/imu"
    assert recording.rig.imu("/head/imu").gyroscope_noise_density == 1e-3
    assert not recording.warnings


def test_velocities_that_a_truth_lacks_are_its_differences(sources, walk):
    truth = open_any(sources["euroc"]).block("/truth/head/imu/odometry").columns
    expected = (walk.p[2:] - walk.p[:-2]) * IMU_HZ / 2
    np.testing.assert_allclose(truth["v_frame_in_world"][1:-1], expected, atol=1e-9)
    yaw_rate = 2 * 0.2 * np.cos(np.arange(len(walk.t)) / 50) * IMU_HZ / 50
    np.testing.assert_allclose(truth["angular_rate"][1:-1, 2], yaw_rate[1:-1], atol=1e-3)


def test_a_marker_s_path_becomes_the_imu_s(sources, walk, tmp_path):
    root = copied(sources["euroc"], tmp_path) / "mav0"
    (root / "state_groundtruth_estimate0").rename(root / "vicon0")
    T_imu_marker = np.eye(4)
    T_imu_marker[:3, :3] = Rotation.from_rotvec([0.3, -0.8, 1.9]).as_matrix()
    T_imu_marker[:3, 3] = 0.069, -0.028, -0.124
    body = Rotation.from_quat(walk.q, scalar_first=True)
    p = walk.p + body.apply(T_imu_marker[:3, 3])
    q = (body * Rotation.from_matrix(T_imu_marker[:3, :3])).as_quat(scalar_first=True)
    file = root / "vicon0" / "data.csv"
    header = file.read_text().splitlines()[0]
    rows = zip(walk.t.tolist(), np.column_stack((p, q)).tolist())
    file.write_text("\n".join([header, *(f"{t},{','.join(map(repr, row))}" for t, row in rows)]))
    text = f"sensor_type: pose\nT_BS:\n  cols: 4\n  rows: 4\n  data: {T_imu_marker.ravel().tolist()}\n"
    (root / "vicon0" / "sensor.yaml").write_text(text)
    truth = open_any(root).block("/truth/head/imu/odometry").columns
    np.testing.assert_allclose(truth["p_frame_in_world"], walk.p, atol=1e-9)
    signs = np.sign(np.sum(truth["q_world_frame"] * walk.q, axis=1))[:, None]
    np.testing.assert_allclose(signs * truth["q_world_frame"], walk.q, atol=1e-9)
    expected = (walk.p[2:] - walk.p[:-2]) * IMU_HZ / 2
    np.testing.assert_allclose(truth["v_frame_in_world"][1:-1], expected, atol=1e-6)


def test_euroc_columns_go_by_their_names(sources, walk, tmp_path):
    root = copied(sources["euroc"], tmp_path)
    file = root / "mav0" / "imu0" / "data.csv"
    rows = [line.split(",") for line in file.read_text().splitlines()]
    file.write_text("\n".join(",".join([row[0], *row[4:], *row[1:4]]) for row in rows))
    np.testing.assert_array_equal(open_any(root).block("/head/imu").columns["angular_rate"], walk.gyro)
    file.write_text("\n".join(",".join(row) for row in rows[1:]))
    recording = open_any(root)
    np.testing.assert_array_equal(recording.block("/head/imu").columns["specific_force"], walk.accel)
    assert any("no header" in w for w in recording.warnings)


def test_rows_of_a_folder_without_a_rate_are_left_out(sources, walk, tmp_path):
    root = copied(sources["euroc"], tmp_path)
    file = root / "mav0" / "imu0" / "data.csv"
    rows = [line.split(",") for line in file.read_text().splitlines()]
    for row in rows[2::2]:
        row[1:4] = ["0", "0", "0"]
    file.write_text("\n".join(",".join(row) for row in rows))
    recording = open_any(root)
    count = len(rows[2::2])
    assert any(f"/head/imu: {count} of {len(walk.t)} rows have no rates" in w for w in recording.warnings)
    block = recording.block("/head/imu")
    at = np.isin(walk.t[::2], block.t_ns)
    kept = np.isin(block.t_ns, walk.t[::2])
    np.testing.assert_array_equal(block.columns["angular_rate"][kept], walk.gyro[::2][at])
    assert np.all(np.any(block.columns["angular_rate"] != 0, axis=1))


def test_tum_rgbd(sources, walk):
    recording = open_any(sources["tum"])
    assert recording.topics["/head/accelerometer"].kind is Accelerometer
    np.testing.assert_array_equal(recording.block("/head/accelerometer").columns["specific_force"], walk.accel)
    np.testing.assert_allclose([d.depth for d in recording.images("/head/depth")], expected_depth(walk), atol=2e-4)
    np.testing.assert_array_equal([p.pixels for p in recording.images("/head/color")], walk.colour)
    truth = recording.block("/truth/head/color/odometry")
    np.testing.assert_allclose(truth.columns["q_world_frame"], walk.q, atol=1e-12)
    assert recording.rig.cameras["/head/color"].intrinsics == K
    scaled = open_any(sources["tum"], options=ImportOptions(depth_scale=1000.0))
    np.testing.assert_allclose(scaled.images("/head/depth", [0])[0].depth, 5 * expected_depth(walk)[0], atol=1e-3)


def test_seven_scenes(sources, walk):
    recording = open_any(sources["7scenes"])
    np.testing.assert_allclose([d.depth for d in recording.images("/head/depth")], expected_depth(walk), atol=1e-6)
    truth = recording.block("/truth/head/color/odometry").columns["p_frame_in_world"]
    np.testing.assert_allclose(truth, walk.p[: len(walk.t_images)], atol=1e-12)
    assert recording.rig.cameras["/head/color"].intrinsics == K
    assert any("30 Hz assumed" in w for w in recording.warnings)


@pytest.mark.parametrize("name", ["table_csv", "table_npz"])
def test_tables(sources, walk, name):
    block = open_any(sources[name]).block("/foot_l/imu")
    np.testing.assert_array_equal(block.t_ns, walk.t - START)
    np.testing.assert_allclose(block.columns["specific_force"], walk.accel, rtol=1e-8)


def test_samples_of_all_streams_come_in_order_of_time(sources):
    samples = list(open_any(sources["rosbag1"]).samples())
    times = [s.t_ns for s in samples]
    assert times == sorted(times)
    assert [type(s) for s in samples[:4]] == [Imu, Odometry, Image, Depth]


@pytest.mark.parametrize("name", [n for n in FORMATS if n != "mcap"])
def test_written_as_a_recording_nothing_is_lost(sources, tmp_path, name):
    source = open_any(sources[name])
    write_recording(source, tmp_path / "a.mcap")
    back = Recording(tmp_path / "a.mcap")
    assert {t: (i.kind, i.count) for t, i in back.topics.items()} == {
        t: (i.kind, i.count) for t, i in source.topics.items()
    }
    assert back.metadata["imported_from"] == KIND.get(name, name)
    for a, b in zip(source.samples(), back.samples(), strict=True):
        assert (a.topic, a.t_ns) == (b.topic, b.t_ns)
        for field in a.__dataclass_fields__:
            if field not in ("topic", "t_ns"):
                np.testing.assert_allclose(getattr(a, field), getattr(b, field), atol=1e-12)
    assert back.rig.cameras.keys() == source.rig.cameras.keys()


def test_streams_can_be_given_other_topics_and_calibrations(sources, tmp_path):
    topic = "/foot_r/imu"
    imu = ImuCalibration(
        topic=topic,
        part="mine",
        rate_hz=IMU_HZ,
        mount=Mount(body="foot_r"),
        gyroscope_noise_density=1e-4,
        gyroscope_random_walk=1e-6,
        accelerometer_noise_density=1e-3,
        accelerometer_random_walk=1e-5,
    )
    write_rig(Rig(imus={topic: imu}), tmp_path / "rig.yaml")
    options = ImportOptions(names={"/camera/imu": topic}, rig=tmp_path / "rig.yaml")
    recording = open_any(sources["rosbag1"], options=options)
    assert recording.rig.imu(topic).part == "mine"
    assert "/head/imu" not in recording.topics
    by_our_name = open_any(sources["rosbag1"], options=ImportOptions(names={"/head/imu": topic}))
    assert topic in by_our_name.topics
    for names, says in (
        ({"/nothing": "/a"}, "--map: invalid '/nothing': .*one of /camera/imu"),
        ({"/camera/imu": "imu"}, "--map: invalid 'imu': .*begins with /"),
        ({"/camera/imu": "/a/b", "/vicon/head": "/a/b"}, "--map: invalid '/a/b': .*of its own"),
    ):
        with pytest.raises(StrideTwinError, match=says):
            open_any(sources["rosbag1"], options=ImportOptions(names=names))
    with pytest.raises(StrideTwinError, match=r"--as: invalid 'zip': .*expected mcap, rosbag1"):
        open_any(sources["rosbag1"], options=ImportOptions(kind="zip"))


T_CAM_IMU = np.eye(4)
T_CAM_IMU[:3, :3] = Rotation.from_rotvec([0.3, -1.2, 0.8]).as_matrix()
T_CAM_IMU[:3, 3] = 0.02, -0.01, 0.05


def camchain(file, rostopic, imu="", focal=27.25):
    """A camera's calibration as Kalibr writes it, and of an IMU (its own second file, put behind)."""
    section = f"""cam0:
  T_cam_imu: {T_CAM_IMU.tolist()}
  camera_model: pinhole
  distortion_coeffs: [-0.2, 0.05, 0.001, 0.0]
  distortion_model: radtan
  intrinsics: [{focal}, {focal}, 15.0, 11.0]
  resolution: [{WIDTH}, {HEIGHT}]
  rostopic: {rostopic}
  timeshift_cam_imu: -0.007
"""
    noise = "".join(
        f"  {s}_{w}: 2.0e-3\n" for s in ("gyroscope", "accelerometer") for w in ("noise_density", "random_walk")
    )
    file.write_text(section + (f"imu0:\n  rostopic: {imu}\n  update_rate: {IMU_HZ}\n{noise}" if imu else ""))
    return ImportOptions(rig=file)


@pytest.mark.parametrize(
    ("name", "rostopic", "imu"),
    [
        ("euroc", "/cam0/image_raw", "/imu0"),
        ("euroc", "/cam0/image_raw", ""),
        ("euroc", "/head/color", ""),
        ("euroc", "/camera/color/image_raw", "/camera/imu"),  # of another record; cam0 is cam0
        ("rosbag1", "/camera/color/image_raw", "/camera/imu"),
        ("rosbag1", "camera/color/image_raw/compressed", ""),
        ("tum", "/cam0/image_raw", ""),
    ],
)
def test_a_kalibr_file_goes_before_all(sources, tmp_path, name, rostopic, imu):
    recording = open_any(sources[name], options=camchain(tmp_path / "camchain-imucam.yaml", rostopic, imu))
    camera = recording.rig.cameras["/head/color"]
    assert camera.intrinsics == (27.25, 27.25, 15.0, 11.0)
    assert camera.timeshift_cam_imu_s == -0.007
    assert camera.mount.body == "head"
    np.testing.assert_allclose(np.linalg.inv(camera.mount.T_body_sensor), T_CAM_IMU, atol=1e-12)
    assert camera.depth_topic == ("" if name == "euroc" else "/head/depth")  # Kalibr has no word for it
    assert recording.topics["/head/color"].rate_hz == pytest.approx(camera.rate_hz)  # nor for that
    if name != "tum":
        assert camera.imu_topic == "/head/imu"
        assert recording.rig.imu("/head/imu").mount.body == "head"
        assert (recording.rig.imu("/head/imu").gyroscope_noise_density == 2e-3) is bool(imu)
    assert not any("not used" in w or "no mount" in w or "size alone" in w for w in recording.warnings)


def test_a_kalibr_file_follows_its_stream_to_another_topic(sources, tmp_path):
    given = camchain(tmp_path / "a.yaml", "/camera/color/image_raw", "/camera/imu")
    names = {"/camera/imu": "/foot_r/imu", "/camera/color/image_raw": "/foot_r/camera"}
    rig = open_any(sources["rosbag1"], options=ImportOptions(rig=given.rig, names=names)).rig
    camera = rig.cameras["/foot_r/camera"]
    assert (camera.imu_topic, camera.mount.body, rig.imu("/foot_r/imu").mount.body) == ("/foot_r/imu", *["foot_r"] * 2)
    assert camera.intrinsics[0] == 27.25
    table = open_any(sources["table_csv"], options=camchain(tmp_path / "b.yaml", "/cam0", "/imu0")).rig
    assert table.imu("/foot_l/imu").gyroscope_noise_density == 2e-3
    assert table.imu("/foot_l/imu").mount.body == "foot_l"


def test_a_calibration_without_a_stream_is_reported(sources, tmp_path):
    file = tmp_path / "camchain.yaml"
    with pytest.raises(
        StrideTwinError, match=r"camchain\.yaml: rostopic: invalid '/cam7/image_raw': .*/camera/color/image_raw"
    ):
        open_any(sources["rosbag1"], options=camchain(file, "/cam7/image_raw"))
    assert open_any(sources["rosbag1"], True, camchain(file, "/cam7/image_raw")).problems
    recording = open_any(sources["rosbag1"], options=camchain(file, "/cam7/image_raw", "/camera/imu"))
    assert recording.rig.imu("/head/imu").gyroscope_noise_density == 2e-3
    assert any("/cam7/image_raw: no stream of this name" in w for w in recording.warnings)


@pytest.mark.parametrize("is_folder", [False, True])
def test_our_own_recording_keeps_what_it_holds(recorded, tmp_path, is_folder):
    plain = Recording(recorded)
    path = recorded
    if is_folder:
        (path := tmp_path / "bag").mkdir()
        shutil.copy(recorded, path)
    back = open_any(path, options=ImportOptions(names={"/head/imu": "/chest/imu"}))
    assert back.metadata == plain.metadata == {"seed": "7"}
    assert back.topics.keys() - plain.topics.keys() == {"/chest/imu"}
    assert {t for t in back.topics if t in plain.topics} == plain.topics.keys() - {"/head/imu"}
    a, b = plain.rig.cameras["/head/color"], back.rig.cameras["/head/color"]
    for name in ("part", "rate_hz", "intrinsics", "distortion", "depth_topic", "timeshift_cam_imu_s"):
        assert getattr(a, name) == getattr(b, name)
    np.testing.assert_array_equal(a.mount.T_body_sensor, b.mount.T_body_sensor)
    imu = back.rig.imu("/chest/imu")
    assert (imu.part, imu.gyroscope_bias_sd, imu.mount.body) == ("BMI055", 0.01, "torso")
    assert back.rig.boards.keys() == {"foot_l"}
    assert back.rig.others["/foot_l/sonar"].part == "SRF08"


def test_depth_without_its_colour_keeps_its_camera(tmp_path, recorded):
    plain = Recording(recorded)
    with RecordingWriter(tmp_path / "depth.mcap", plain.rig) as writer:
        for sample in plain.samples(["/head/imu", "/head/depth"]):
            writer.write(sample)
    back = open_any(tmp_path / "depth.mcap", options=ImportOptions(names={"/head/imu": "/head/other"}))
    camera = back.rig.cameras["/head/color"]
    assert (camera.depth_topic, camera.intrinsics) == ("/head/depth", plain.rig.cameras["/head/color"].intrinsics)
    assert not back.warnings


def test_our_own_recording_takes_a_kalibr_file(recorded, tmp_path):
    known = Recording(recorded).rig
    rig = open_any(recorded, options=camchain(tmp_path / "camchain.yaml", "/head/color")).rig
    camera = rig.cameras["/head/color"]
    assert (camera.intrinsics[0], camera.timeshift_cam_imu_s) == (27.25, -0.007)
    assert (camera.part, camera.depth_topic, camera.rate_hz) == ("D455", "/head/depth", 30.0)
    T_imu = known.imu("/head/imu").mount.T_body_sensor
    np.testing.assert_allclose(np.linalg.inv(camera.mount.T_body_sensor) @ T_imu, T_CAM_IMU, atol=1e-9)
    np.testing.assert_array_equal(rig.imu("/head/imu").mount.T_body_sensor, T_imu)


def test_an_imu_that_is_joined_sits_where_its_gyro_does(tmp_path, walk):
    store = foreign_files.get_typestore(foreign_files.Stores.ROS2_HUMBLE)
    path, types = tmp_path / "realsense.mcap", store.types
    none = np.zeros((len(walk.t), 3))
    with path.open("wb") as file:
        writer = foreign_files.Writer(file)
        writer.start("ros2", "someone")
        feed = foreign_files._McapFeed(writer)

        def put(topic, name, messages):
            channel = feed.add_connection(topic, name, typestore=store)
            for t, message in messages:
                feed.write(channel, t, store.serialize_cdr(message, name))

        for sort, rates, forces in (("gyro", walk.gyro, none), ("accel", none, walk.accel)):
            imus = [
                (t, foreign_files._imu(store, t, w, f)) for t, w, f in zip(walk.t.tolist(), rates, forces, strict=True)
            ]
            put(f"/camera/{sort}/sample", "sensor_msgs/msg/Imu", imus)
        t = walk.t_images.tolist()
        shots = [(s, foreign_files._image(store, s, "rgb8", c)) for s, c in zip(t, walk.colour, strict=True)]
        put("/camera/color/image_raw", "sensor_msgs/msg/Image", shots)
        infos = [(t[0], foreign_files._info(store, t[0], False))]
        put("/camera/color/camera_info", "sensor_msgs/msg/CameraInfo", infos)
        vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
        mount = types["geometry_msgs/msg/Transform"](vector(0.03, 0.02, 0.01), quaternion(0.0, 0.0, 0.0, 1.0))
        stamped = types["geometry_msgs/msg/TransformStamped"](
            foreign_files._header(store, t[0], "camera_imu"), "camera_color", mount
        )
        put("/tf_static", "tf2_msgs/msg/TFMessage", [(t[0], types["tf2_msgs/msg/TFMessage"]([stamped]))])
        writer.finish()
    recording = open_any(path)
    mount = recording.rig.cameras["/head/color"].mount
    np.testing.assert_allclose(mount.T_body_sensor[:3, 3], (0.03, 0.02, 0.01), atol=1e-12)
    assert not any("no mount" in w for w in recording.warnings)


@pytest.mark.parametrize("units_m", [0.001, 0.00025])
def test_a_bag_of_realsense_s_viewer(tmp_path, walk, units_m):
    recording = open_any(foreign_files.write_realsense_bag(tmp_path, walk, units_m))
    imu = recording.block("/head/imu")
    np.testing.assert_array_equal(imu.columns["angular_rate"], walk.gyro)
    np.testing.assert_allclose(imu.columns["specific_force"], walk.accel, atol=1e-12)
    np.testing.assert_array_equal([p.pixels for p in recording.images("/head/color")], walk.colour)
    scale = units_m / 0.001
    np.testing.assert_allclose(
        recording.images("/head/depth", [4])[0].depth, scale * expected_depth(walk)[4], atol=1e-6
    )
    camera = recording.rig.cameras["/head/color"]
    assert (camera.intrinsics, camera.imu_topic) == (K, "/head/imu")
    infrared = recording.rig.cameras["/device_0/sensor_0/Infrared_1/image/data"]
    assert infrared.depth_topic == "/head/depth"  # depth has the frame of the left infrared camera
    assert not recording.unread


def test_names_of_common_drivers():
    kinds = {
        "/imu/left_foot": Imu,
        "/imu/right_foot": Imu,
        "/camera/infra1/image_rect_raw": Image,
        "/camera/color/image_raw/compressed": Image,
        "/camera/depth/image_rect_raw": Depth,
        "/camera/aligned_depth_to_color/image_raw": Depth,
        "/camera/imu": Imu,
        "/imu/data": Imu,
        "/odom": Odometry,
        "/optitrack/person": Odometry,
        "/chest/imu": Imu,
    }
    assert assign_bag_topics(kinds) == {
        "/imu/left_foot": "/foot_l/imu",
        "/imu/right_foot": "/foot_r/imu",
        "/camera/imu": "/head/imu",
        "/camera/color/image_raw/compressed": "/head/color",
        "/camera/aligned_depth_to_color/image_raw": "/head/depth",
        "/optitrack/person": "/truth/head/odometry",
    }


@pytest.mark.parametrize(
    ("name", "file", "old", "new", "says"),
    [
        ("euroc", "mav0/imu0/data.csv", "w_RS_S_y", "w_RS_S_q", r"data\.csv: header: .*one column w_RS_S_y"),
        (
            "euroc",
            "mav0/imu0/data.csv",
            "[rad s^-1]",
            "[deg/s]",
            r"unit of w_RS_S_x: invalid 'deg/s': expected rad s\^-1",
        ),
        ("euroc", "mav0/imu0/data.csv", f"\n{START + 10**7},", f"\n{START + 10**7}.5,", "line 3, time stamp: .*whole"),
        (
            "euroc",
            "mav0/imu0/data.csv",
            f"\n{START + 10**7},",
            f"\n{START - 10**7},",
            "/head/imu at .*is not after the previous one",
        ),
        ("euroc", "mav0/imu0/data.csv", f"\n{START + 10**7},", f"\n{'9' * 19},", "line 3, time stamp: .*whole"),
        ("euroc", "mav0/cam0/data.csv", f"{START}.png", "../../../x.png", "filename: .*an image inside data/"),
        ("euroc", "mav0/cam0/sensor.yaml", "pinhole", "dome", r"sensor\.yaml: camera_model: invalid 'dome': .*pinhole"),
        ("euroc", "mav0/cam0/sensor.yaml", "[32, 24]", "[64, 48]", "/head/color, size: invalid '32 x 24': .*64 x 48"),
        ("euroc", "mav0/imu0/sensor.yaml", "rate_hz: 100", "rate_hz: fast", r"sensor\.yaml: rate_hz: invalid 'fast'"),
        (
            "tum",
            "accelerometer.txt",
            FIRST,
            f"{FIRST} x",
            r"accelerometer\.txt: line 2, ax: invalid 'x': .*a finite number",
        ),
        (
            "tum",
            "accelerometer.txt",
            FIRST,
            "9999999999.0",
            r"accelerometer\.txt: line 2, time stamp: .*seconds from 0",
        ),
        ("tum", "calibration.txt", "26.0", "-26", r"calibration\.txt: calibration: .*focal lengths above 0"),
        ("tum", "groundtruth.txt", "\n", "\n-", r"groundtruth\.txt: line 2, time stamp: invalid '-.*seconds from 0 on"),
        ("7scenes", "frame-000003.pose.txt", "1.0", "7.0", r"frame-000003\.pose\.txt: pose: .*rigid transform"),
        (
            "rosbag2_sqlite",
            "metadata.yaml",
            "- bag_sqlite.db3",
            "- x.db3",
            r"metadata\.yaml: relative_file_paths: invalid 'x\.db3'",
        ),
    ],
)
def test_what_is_wrong_is_named_with_its_place(sources, tmp_path, name, file, old, new, says):
    source = copied(sources[name], tmp_path)
    replaced(source / file, old, new)
    with pytest.raises(StrideTwinError, match=says) as caught:
        list(open_any(source).samples())
    assert "\n" not in str(caught.value)
    assert str(source) in str(caught.value)


def test_units_and_clocks_that_cannot_be_are_refused(sources, tmp_path):
    root = copied(sources["euroc"], tmp_path)
    file = root / "mav0" / "imu0" / "data.csv"
    header, *rows = file.read_text().splitlines()
    table = [[w for w in row.split(",")] for row in rows]

    def written(change):
        file.write_text("\n".join([header, *(",".join(change(list(row))) for row in table)]))

    def scaled(row, columns, by):
        return [repr(float(w) * by) if i in columns else w for i, w in enumerate(row)]

    for change, says in (
        (lambda r: scaled(r, (4, 5, 6), 1 / 9.81), "accel: .*is it in g"),
        (lambda r: scaled(r, (1, 2, 3), 5 * 180 / np.pi), "gyro: .*is it in °/s"),
        (lambda r: [str(int(r[0]) // 1000), *r[1:]], r"invalid .*Hz: expected a rate"),
        (lambda r: [str(int(r[0]) + 10**12), *r[1:]], "expected stamps of one clock"),
    ):
        written(change)
        with pytest.raises(StrideTwinError, match=says):
            open_any(root)
        assert open_any(root, lenient=True).problems


def test_images_that_are_listed_and_missing_are_left_out_and_reported(sources, walk, tmp_path):
    euroc, tum = copied(sources["euroc"], tmp_path), copied(sources["tum"], tmp_path)
    replaced(euroc / "mav0" / "cam0" / "data.csv", ".png", "x.png")
    recording = open_any(euroc)
    np.testing.assert_array_equal(recording.image_times("/head/color"), walk.t_images[1:])
    assert any("data.csv: 1 of 10 images are listed and missing, the first of them" in w for w in recording.warnings)
    for file in sorted((tum / "depth").glob("*.png"))[3:5]:
        file.unlink()
    recording = open_any(tum)
    assert [len(recording.image_times(t)) for t in ("/head/color", "/head/depth")] == [10, 8]
    assert len(list(recording.samples(["/head/depth"]))) == 8
    shutil.rmtree(tum / "rgb")
    recording = open_any(tum)
    assert "/head/color" not in recording.topics
    assert any("rgb.txt: 10 of 10 images are listed and missing" in w for w in recording.warnings)


def test_lenient_leaves_out_what_cannot_be_read(sources, tmp_path):
    root = copied(sources["euroc"], tmp_path)
    replaced(root / "mav0" / "imu0" / "data.csv", f"\n{START + 10**7},", f"\n{START + 10**7},x")
    (root / "mav0" / "cam0" / "data" / f"{START}.png").write_bytes(b"junk")
    with pytest.raises(StrideTwinError, match="w_RS_S_x: invalid 'x"):
        open_any(root)
    recording = open_any(root, lenient=True)
    assert len(recording.block("/head/imu")) == 200
    assert any("/head/imu: 1 gaps of up to 20 ms are bridged by 1 samples" in w for w in recording.warnings)
    assert sum(isinstance(s, Image) for s in recording.samples()) == 9
    assert any("damaged image" in str(p) for p in recording.problems)
    write_recording(recording, tmp_path / "a.mcap")
    assert Recording(tmp_path / "a.mcap").topics["/head/color"].count == 9


def test_a_damaged_image_leaves_no_half_recording(sources, tmp_path):
    root = copied(sources["7scenes"], tmp_path)
    (root / "frame-000004.color.png").write_bytes(b"junk")
    with pytest.raises(StrideTwinError, match="damaged image"):
        write_recording(open_any(root), tmp_path / "a.mcap")
    assert {p.name for p in tmp_path.iterdir()} == {root.name}


def test_a_short_stream_is_reported(sources, tmp_path):
    root = copied(sources["tum"], tmp_path)
    lines = (root / "groundtruth.txt").read_text().splitlines()
    (root / "groundtruth.txt").write_text("\n".join(lines[:50]))
    assert any("/truth/head/color/odometry: covers" in w for w in open_any(root).warnings)


def test_what_is_no_recording_is_said_to_be_none(tmp_path):
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / "walk.bag").write_text("hello")
    (tmp_path / "folder").mkdir()
    for name, says in (
        ("empty.mcap", "empty"),
        ("notes.txt", "unknown content: expected a recording of one of the kinds mcap"),
        ("walk.bag", "no ROS 1 bag"),
        ("folder", "unknown layout: expected a folder of one of the kinds .*euroc, tum, 7scenes"),
        ("nowhere", "No such file"),
    ):
        with pytest.raises(StrideTwinError, match=says):
            open_any(tmp_path / name)


def test_a_gyro_and_an_accelerometer_apart_become_one_imu():
    t = np.arange(50) * 10_000_000
    zeros, rng = np.zeros((50, 3)), np.random.default_rng(0)
    ramp = np.column_stack((t[::5], -t[::5], np.full(10, 9.81e9))) * 1e-9
    gyro = {"angular_rate": rng.normal(size=(50, 3)), "specific_force": zeros}
    accel = {"angular_rate": zeros[:10], "specific_force": ramp}
    blocks = {
        "/camera/gyro/sample": Block(topic="/camera/gyro/sample", kind=Imu, t_ns=t, columns=gyro),
        "/camera/accel/sample": Block(topic="/camera/accel/sample", kind=Imu, t_ns=t[::5] + 1000, columns=accel),
    }
    notes = Notes(Path("bag"), False)
    (imu,) = join_gyro_and_accel(blocks, notes).values()
    assert imu.topic == "/camera/imu"
    np.testing.assert_array_equal(imu.t_ns, t[1:46])
    np.testing.assert_array_equal(imu.columns["angular_rate"], gyro["angular_rate"][1:46])
    np.testing.assert_allclose(imu.columns["specific_force"][:, 0], t[1:46] * 1e-9, atol=2e-6)
    assert "joined as /camera/imu" in notes.warnings[0]


@pytest.mark.parametrize("kind", FILE_FORMATS)
def test_a_wrong_kind_is_an_error_in_one_line(sources, kind):
    for name, source in sources.items():
        if kind not in (KIND.get(name, name), "rosbag2" if source.suffix == ".mcap" else ""):
            with pytest.raises(StrideTwinError) as caught:
                list(open_any(source, options=ImportOptions(kind=kind)).samples())
            assert "\n" not in str(caught.value)


def test_a_bag_in_several_files_is_one_recording(tmp_path, walk):
    later = Walk()
    later.t, later.t_images = walk.t + 2 * 10**9, walk.t_images + 2 * 10**9
    for name, part in (("bag_0.mcap", walk), ("bag_1.mcap", later)):
        write_foreign_mcap(tmp_path, part).rename(tmp_path / name)
    recording = open_any(tmp_path)
    np.testing.assert_array_equal(recording.block("/head/imu").t_ns, np.concatenate((walk.t, later.t)))
    last = len(walk.t_images) + 4
    np.testing.assert_array_equal(recording.images("/head/color", [last])[0].pixels, walk.colour[4])


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_a_cut_off_mcap_of_anyone_is_read_up_to_its_last_chunk(sources, walk, tmp_path, share):
    data = sources["mcap_foreign"].read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: int(share * len(data))])
    with pytest.raises(StrideTwinError, match="cut off"):
        open_any(tmp_path / "cut.mcap")
    recording = open_any(tmp_path / "cut.mcap", lenient=True)
    block = recording.block("/head/imu")
    assert 0.5 * share < len(block) / len(walk.t) <= 1
    np.testing.assert_array_equal(block.columns["angular_rate"], walk.gyro[: len(block)])
    assert len(recording.problems) == 1


@pytest.mark.parametrize(("late_s", "seconds", "says_clocks"), [(2.5, 10, True), (2.5, 7, False)])
def test_a_stream_that_lasts_as_long_and_begins_later_has_another_clock(late_s, seconds, says_clocks):
    def topic(first_s, last_s, count):
        first_ns, last_ns = (round(1e9 * second) for second in (first_s, last_s))
        return SimpleNamespace(first_ns=first_ns, last_ns=last_ns, count=count, kind=Image)

    topics = {"/imu": topic(0.0, 10.0, 1000), "/camera": topic(late_s, late_s + seconds, 300)}
    notes = Notes(Path("folder"), lenient=True)
    opening._check_overlap(SimpleNamespace(topics=topics), notes)
    (warning,) = notes.warnings
    assert "/camera: covers 2.500" in warning
    assert ("clocks are probably 2.500 s apart" in warning) == says_clocks
