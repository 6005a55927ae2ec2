"""What is exported comes back to the format's precision, and the tools of others read it."""

from dataclasses import replace

import cv2
import numpy as np
import open3d
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.euroc import write_euroc
from stridetwin.streams.formats.mcap_export import write_rosbag2
from stridetwin.streams.formats.opening import open_any
from stridetwin.streams.formats.opensim_export import write_opensim
from stridetwin.streams.formats.tum_rgbd import write_tum_rgbd
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount, Rig
from stridetwin.streams.samples import Block, Depth, Image, Imu, Joints, Odometry, Point, Wrench

N, IMAGES = 400, 12
T_NS = 10**9 + np.arange(N) * 5_000_000
NAMES = ("hip_flexion_l", "knee_flexion_l", "lumbar_flexion", "neck_flexion")


def pose(rotvec, p):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(rotvec).as_matrix(), p
    return T


T_HEAD_IMU, T_HEAD_CAMERA = pose((0.1, 0, 0), (0, 0, 0.1)), pose((0, 1.8, 0), (0.1, 0.02, 0))


def rig():
    imu = ImuCalibration(
        topic="/head/imu",
        part="BMI055",
        rate_hz=200.0,
        mount=Mount(body="head", T_body_sensor=T_HEAD_IMU),
        gyroscope_noise_density=1e-3,
        gyroscope_random_walk=2e-5,
        accelerometer_noise_density=1e-2,
        accelerometer_random_walk=3e-4,
    )
    camera = CameraCalibration(
        topic="/head/color",
        part="D455",
        rate_hz=200 / 33,
        mount=Mount(body="head", T_body_sensor=T_HEAD_CAMERA),
        width=32,
        height=24,
        intrinsics=(30.0, 30.5, 15.5, 11.5),
        depth_topic="/head/depth",
        imu_topic="/head/imu",
    )
    return Rig(imus={imu.topic: imu}, cameras={camera.topic: camera})


def odometry(topic, rng):
    q = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.01, (N, 3)), axis=0)).as_quat(scalar_first=True)
    columns = {"p_frame_in_world": rng.normal(size=(N, 3)), "q_world_frame": q}
    columns |= {"v_frame_in_world": rng.normal(size=(N, 3)), "angular_rate": rng.normal(size=(N, 3))}
    return Block(topic=topic, kind=Odometry, t_ns=T_NS, columns=columns)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    rng = np.random.default_rng(2)
    path = tmp_path_factory.mktemp("export") / "walk.mcap"
    loaded = np.arange(N) % 100 < 60
    force = np.where(loaded[:, None], rng.normal((0, 0, 700), 20, (N, 3)), 0)
    with RecordingWriter(path, rig(), {"seed": "4"}, depth_encoding="32FC1", jpeg_quality=None) as writer:
        imu = {"angular_rate": rng.normal(0, 0.3, (N, 3)), "specific_force": rng.normal((0, 0, 9.81), 0.1, (N, 3))}
        writer.write(Block(topic="/head/imu", kind=Imu, t_ns=T_NS, columns=imu))
        for frame in ("pelvis", "head/imu", "foot_l"):
            writer.write(odometry(f"/truth/{frame}/odometry", rng))
        joints = {name: rng.normal(size=(N, len(NAMES))) for name in ("position", "velocity", "torque")}
        writer.write(Block(topic="/truth/joints", kind=Joints, t_ns=T_NS, columns=joints, constants={"names": NAMES}))
        wrench = {"force_in_world": force, "torque_in_world": rng.normal(size=(N, 3)) * loaded[:, None]}
        writer.write(Block(topic="/truth/foot_l/wrench", kind=Wrench, t_ns=T_NS, columns=wrench))
        cop = {"p_in_world": rng.normal(size=(N, 3))[loaded]}
        writer.write(Block(topic="/truth/foot_l/cop", kind=Point, t_ns=T_NS[loaded], columns=cop))
        for t in T_NS[:: N // IMAGES][:IMAGES].tolist():
            writer.write(Image(topic="/head/color", t_ns=t, pixels=rng.integers(0, 256, (24, 32, 3), np.uint8)))
            depth = rng.integers(0, 12_000, (24, 32)).astype(np.float32) / np.float32(1000)
            writer.write(Depth(topic="/head/depth", t_ns=t, depth=depth))
    return Recording(path)


def same_block(a, b, topic, atol=0.0):
    x, y = a.block(topic), b.block(topic)
    np.testing.assert_array_equal(x.t_ns, y.t_ns)
    for name, values in x.columns.items():
        if values.dtype.kind == "f" and name != "angular_rate":
            np.testing.assert_allclose(values, y.columns[name], rtol=0, atol=atol)


def same_mounts(a, b):
    def between(r):
        camera, imu = r.rig.cameras["/head/color"], r.rig.imu("/head/imu")
        return np.linalg.inv(imu.mount.T_body_sensor) @ camera.mount.T_body_sensor

    np.testing.assert_allclose(between(a), between(b), atol=1e-12)


def worn_at(place, recording, file):
    """The same walk with camera and IMU at another place, whose calibration has every value."""
    full = rig()
    body = {"chest": "torso"}.get(place, place)
    mounts = {t: replace(i.mount, body=body) for t, i in {**full.imus, **full.cameras}.items()}
    imu = replace(
        full.imu("/head/imu"),
        topic=f"/{place}/imu",
        mount=mounts["/head/imu"],
        gyroscope_bias_sd=0.01,
        accelerometer_bias_sd=0.2,
        gyroscope_range=8.7,
        accelerometer_range=39.2,
    )
    camera = replace(
        full.cameras["/head/color"],
        topic=f"/{place}/color",
        depth_topic=f"/{place}/depth",
        imu_topic=imu.topic,
        mount=mounts["/head/color"],
        distortion=(-0.3, 0.1, 1e-3, -2e-3),
        timeshift_cam_imu_s=0.008,
    )
    with RecordingWriter(
        file, Rig(imus={imu.topic: imu}, cameras={camera.topic: camera}), {}, depth_encoding="32FC1", jpeg_quality=None
    ) as writer:
        for sample in recording.samples(["/head/imu", "/head/color", "/head/depth", "/truth/head/imu/odometry"]):
            writer.write(replace(sample, topic=sample.topic.replace("head", place)))
    return Recording(file)


def same_calibration(a, b, but=()):
    for name in (n for n in a.__dataclass_fields__ if n not in ("topic", "mount", "imu_topic", *but)):
        assert getattr(a, name) == getattr(b, name), name
    assert a.mount.body == b.mount.body
    np.testing.assert_allclose(a.mount.T_body_sensor, b.mount.T_body_sensor, atol=1e-12)


@pytest.mark.parametrize("place", ["head", "chest"])
def test_euroc_comes_back(recording, tmp_path, place):
    recording = worn_at(place, recording, tmp_path / "worn.mcap")
    (folder := tmp_path / "out").mkdir()
    counts = write_euroc(recording, folder)
    assert counts == {"imu0": N, "cam0": IMAGES, "state_groundtruth_estimate0": N}
    back = open_any(folder)
    for name in ("imu", "imu/odometry"):
        mine, read = (f"{'/truth' * ('odometry' in name)}/{p}/{name}" for p in (place, "head"))
        x, y = recording.block(mine), back.block(read)
        np.testing.assert_array_equal(x.t_ns, y.t_ns)
        for column in x.columns.keys() - ({"angular_rate"} if "odometry" in name else set()):
            np.testing.assert_allclose(x.columns[column], y.columns[column], rtol=0, atol=1e-12)
    for a, b in zip(recording.images(f"/{place}/color"), back.images("/head/color"), strict=True):
        np.testing.assert_array_equal(a.pixels, b.pixels)
    same_calibration(recording.rig.imu(f"/{place}/imu"), back.rig.imu("/head/imu"))
    camera = recording.rig.cameras[f"/{place}/color"], back.rig.cameras["/head/color"]
    same_calibration(*camera, but=["depth_topic"])  # the layout has no depth
    assert camera[1].imu_topic == "/head/imu"
    assert not back.warnings
    (folder / "rig.yaml").unlink()
    T_imu_cam = np.linalg.inv(T_HEAD_IMU) @ T_HEAD_CAMERA  # its sensor.yaml alone says as much
    np.testing.assert_allclose(open_any(folder).rig.cameras["/head/color"].mount.T_body_sensor, T_imu_cam, atol=1e-12)


def test_euroc_is_laid_out_as_published(recording, tmp_path):
    write_euroc(recording, tmp_path)
    root = tmp_path / "mav0"
    lines = (root / "imu0" / "data.csv").read_text().splitlines()
    assert lines[0].startswith("#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y")
    stamp, *values = lines[1].split(",")
    assert (int(stamp), len(values)) == (T_NS[0], 6)
    assert len((root / "state_groundtruth_estimate0" / "data.csv").read_text().splitlines()[1].split(",")) == 17
    name = (root / "cam0" / "data.csv").read_text().splitlines()[1].split(",")[1]
    assert cv2.imread(str(root / "cam0" / "data" / name), cv2.IMREAD_UNCHANGED).shape == (24, 32, 3)


def test_tum_comes_back(recording, tmp_path):
    write_tum_rgbd(recording, tmp_path)
    back = open_any(tmp_path)
    x, y = recording.block("/head/imu"), back.block("/head/accelerometer")
    np.testing.assert_array_equal(x.t_ns, y.t_ns)
    np.testing.assert_array_equal(x.columns["specific_force"], y.columns["specific_force"])
    for a, b in zip(recording.images("/head/color"), back.images("/head/color"), strict=True):
        assert a.t_ns == b.t_ns
        np.testing.assert_array_equal(a.pixels, b.pixels)
    for a, b in zip(recording.images("/head/depth"), back.images("/head/depth"), strict=True):
        np.testing.assert_allclose(a.depth, b.depth, atol=1e-4)
    camera = back.rig.cameras["/head/color"]
    assert camera.intrinsics == (30.0, 30.5, 15.5, 11.5)


@pytest.mark.parametrize("place", ["head", "chest"])
def test_a_tum_folder_feeds_visual_inertial_odometry(recording, tmp_path, place):
    """Rates, forces, and how camera and IMU sit to each other come back, wherever they were worn."""
    source = tmp_path / "worn.mcap"
    full = rig()
    if place != "head":
        names = {"topic": f"/{place}/color", "depth_topic": f"/{place}/depth", "imu_topic": f"/{place}/imu"}
        camera = replace(full.cameras["/head/color"], **names)
        imu = replace(full.imu("/head/imu"), topic=f"/{place}/imu")
        full = Rig(cameras={camera.topic: camera}, imus={imu.topic: imu})
    with RecordingWriter(source, full, {}, depth_encoding="32FC1", jpeg_quality=None) as writer:
        for sample in recording.samples(["/head/imu", "/head/color", "/head/depth"]):
            writer.write(replace(sample, topic=sample.topic.replace("head", place)))
    (tmp_path / "out").mkdir()
    write_tum_rgbd(Recording(source), tmp_path / "out")
    back = open_any(tmp_path / "out")
    same_block(recording, back, "/head/imu")
    np.testing.assert_array_equal(
        back.block("/head/imu").columns["angular_rate"], recording.block("/head/imu").columns["angular_rate"]
    )
    same_mounts(recording, back)
    camera = back.rig.cameras["/head/color"]
    assert (camera.depth_topic, camera.imu_topic) == ("/head/depth", "/head/imu")
    assert not back.warnings


def test_gyroscope_and_accelerometer_of_a_tum_folder_are_joined(recording, tmp_path):
    write_tum_rgbd(recording, tmp_path)
    rows = [line.split() for line in (tmp_path / "imu.txt").read_text().splitlines()[1:]]
    (tmp_path / "gyroscope.txt").write_text("\n".join(" ".join(row[:4]) for row in rows) + "\n")
    (tmp_path / "imu.txt").unlink()
    back = open_any(tmp_path)
    same_block(recording, back, "/head/imu")
    np.testing.assert_array_equal(
        back.block("/head/imu").columns["angular_rate"], recording.block("/head/imu").columns["angular_rate"]
    )
    assert "joined" in back.warnings[0]


def test_the_header_of_imu_txt_names_its_columns(recording, tmp_path):
    write_tum_rgbd(recording, tmp_path)
    rows = [line.split() for line in (tmp_path / "imu.txt").read_text().splitlines()[1:]]
    swapped = ["# timestamp ax ay az wx wy wz", *(" ".join([row[0], *row[4:], *row[1:4]]) for row in rows)]
    (tmp_path / "imu.txt").write_text("\n".join(swapped) + "\n")
    back = open_any(tmp_path)
    same_block(recording, back, "/head/imu")
    np.testing.assert_array_equal(
        back.block("/head/imu").columns["angular_rate"], recording.block("/head/imu").columns["angular_rate"]
    )


def test_tum_truth_is_that_of_the_camera(recording, tmp_path):
    write_tum_rgbd(recording, tmp_path)
    truth = open_any(tmp_path).block("/truth/head/color/odometry").columns
    imu = recording.block("/truth/head/imu/odometry").columns
    T_imu_cam = (
        np.linalg.inv(rig().imu("/head/imu").mount.T_body_sensor) @ rig().cameras["/head/color"].mount.T_body_sensor
    )
    R = Rotation.from_quat(imu["q_world_frame"], scalar_first=True)
    np.testing.assert_allclose(
        truth["p_frame_in_world"], imu["p_frame_in_world"] + R.apply(T_imu_cam[:3, 3]), atol=1e-7
    )
    turn = (
        Rotation.from_quat(truth["q_world_frame"], scalar_first=True).inv()
        * R
        * Rotation.from_matrix(T_imu_cam[:3, :3])
    )
    assert turn.magnitude().max() < 1e-7


def test_opencv_and_open3d_read_the_tum_folder(recording, tmp_path):
    write_tum_rgbd(recording, tmp_path)
    stamp, name = (tmp_path / "depth.txt").read_text().splitlines()[1].split()
    depth = cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED)
    expected = recording.images("/head/depth", [0])[0].depth
    np.testing.assert_allclose(depth / 5000, expected, atol=1e-4)
    colour = open3d.io.read_image(str(tmp_path / "rgb" / f"{stamp}.png"))
    rgbd = open3d.geometry.RGBDImage.create_from_tum_format(colour, open3d.io.read_image(str(tmp_path / name)), False)
    seen = np.asarray(rgbd.depth)
    near = (expected < 4) & (expected > 0)
    np.testing.assert_allclose(seen[near], expected[near], atol=1e-3)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_rosbag2_comes_back_and_rosbags_reads_it(recording, tmp_path, storage):
    counts = write_rosbag2(recording, tmp_path, "walk", storage)
    assert counts["/head/imu"] == N
    with AnyReader([tmp_path]) as reader:
        assert reader.message_count == sum(counts.values())
        (connection,) = (c for c in reader.connections if c.topic == "/head/imu")
        _, t_ns, raw = next(reader.messages([connection]))
        message = reader.deserialize(raw, connection.msgtype)
    assert t_ns == T_NS[0]
    assert message.angular_velocity.x == recording.block("/head/imu").columns["angular_rate"][0, 0]
    back = open_any(tmp_path)
    assert back.topics.keys() == recording.topics.keys()
    for topic, info in recording.topics.items():
        if info.kind not in (Image, Depth):
            same_block(recording, back, topic, 1e-12)
    np.testing.assert_array_equal(
        back.images("/head/depth", [5])[0].depth, recording.images("/head/depth", [5])[0].depth
    )
    same_mounts(recording, back)
    assert not back.warnings


def test_rosbag2_in_mcap_keeps_every_crc(recording, tmp_path):
    write_rosbag2(recording, tmp_path, "walk")
    assert (tmp_path / "walk.mcap").read_bytes() == recording.path.read_bytes()
    with (tmp_path / "walk.mcap").open("rb") as file:
        assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) > 0
    assert open_any(tmp_path).metadata == {"seed": "4"}


def test_a_bag_can_be_made_of_an_imported_folder(recording, tmp_path):
    (tmp_path / "euroc").mkdir()
    (tmp_path / "bag").mkdir()
    write_euroc(recording, tmp_path / "euroc")
    counts = write_rosbag2(open_any(tmp_path / "euroc"), tmp_path / "bag", "walk", "sqlite3")
    assert counts["/head/color"] == IMAGES
    same_block(recording, open_any(tmp_path / "bag"), "/head/imu")


def mot(path):
    lines = path.read_text().splitlines()
    end = lines.index("endheader")
    header = dict(line.split("=") for line in lines[1:end] if "=" in line)
    names = lines[end + 1].split("\t")
    table = np.array([[float(w) for w in line.split("\t")] for line in lines[end + 2 :]])
    assert table.shape == (int(header["nRows"]), int(header["nColumns"])) == (N, len(names))
    return dict(zip(names, table.T)), header


def test_opensim_motion_is_the_truth_in_its_axes(recording, tmp_path):
    write_opensim(recording, tmp_path)
    columns, header = mot(tmp_path / "motion.mot")
    assert header["inDegrees"] == "yes"
    joints = recording.block("/truth/joints").columns["position"]
    np.testing.assert_allclose(columns["knee_angle_l"], np.degrees(joints[:, 1]), rtol=1e-8)
    np.testing.assert_allclose(columns["lumbar_extension"], -np.degrees(joints[:, 2]), rtol=1e-8)
    np.testing.assert_allclose(columns["neck_flexion"], np.degrees(joints[:, 3]), rtol=1e-8)
    pelvis = recording.block("/truth/pelvis/odometry").columns
    angles = np.column_stack([columns[f"pelvis_{n}"] for n in ("tilt", "list", "rotation")])
    R = Rotation.from_euler("ZXY", angles, degrees=True).as_matrix()
    C = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    p = np.column_stack([columns[f"pelvis_t{a}"] for a in "xyz"])
    hips = (p + R @ [-0.056276, -0.07849, 0]) @ C  # Rajagopal2015.osim: hip_r in pelvis, without its z
    np.testing.assert_allclose(hips, pelvis["p_frame_in_world"], atol=1e-7)
    expected = Rotation.from_quat(pelvis["q_world_frame"], scalar_first=True).as_matrix()
    np.testing.assert_allclose(C.T @ R @ C, expected, atol=1e-7)


def test_opensim_ground_reactions_have_the_moment_of_the_truth(recording, tmp_path):
    write_opensim(recording, tmp_path)
    columns, _ = mot(tmp_path / "ground_reactions.mot")
    C = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    force, point, torque = (
        np.column_stack([columns[n.format(a)] for a in "xyz"]) @ C
        for n in ("ground_force_l_v{}", "ground_force_l_p{}", "ground_torque_l_{}")
    )
    wrench = recording.block("/truth/foot_l/wrench").columns
    foot = recording.block("/truth/foot_l/odometry").columns["p_frame_in_world"]
    np.testing.assert_allclose(force, wrench["force_in_world"], atol=1e-5)
    about_foot = torque + np.cross(point - foot, force)
    np.testing.assert_allclose(about_foot, wrench["torque_in_world"], atol=1e-3)
    assert not force[~np.any(point, axis=1)].any()


def test_what_a_format_needs_is_named(tmp_path):
    with RecordingWriter(tmp_path / "bare.mcap", Rig()) as writer:
        writer.write(odometry("/truth/pelvis/odometry", np.random.default_rng(0)))
    bare = Recording(tmp_path / "bare.mcap")
    for write, says in (
        (write_euroc, "at least one colour"),
        (write_tum_rgbd, "colour"),
        (write_opensim, "/truth/joints"),
    ):
        (folder := tmp_path / write.__name__).mkdir()
        with pytest.raises(StrideTwinError, match=says):
            write(bare, folder)
        assert not list(folder.iterdir())


def test_a_stereo_pair_is_made_where_asked(recording, tmp_path):
    counts = write_euroc(recording, tmp_path, stereo_baseline_m=0.05)
    assert (counts["cam0"], counts["cam1"]) == (IMAGES, IMAGES)
    back = open_any(tmp_path)
    assert back.topics["/head/color_right"].count == IMAGES
    left, right = (back.rig.cameras[f"/head/color{s}"].mount.T_body_sensor for s in ("", "_right"))
    expected = np.eye(4)
    expected[0, 3] = 0.05
    np.testing.assert_allclose(np.linalg.inv(left) @ right, expected, atol=1e-12)
