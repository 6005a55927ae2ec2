"""Bags that are incomplete, of ROS 1 in MCAP, of two clocks or without sensors: read, or refused with a cause."""

import re
import shutil

import numpy as np
import pytest
from empty_files import touch_files
from mcap.writer import Writer
from robot_files import (
    IMAGE_TYPE,
    IMU_TYPE,
    INFO_TYPE,
    PERIOD_NS,
    START_NS,
    STORE,
    convert_to_mcap,
    grey_message,
    info_message,
    still_imu,
    write_bag,
)

from benchmarks import foreign_files
from benchmarks.foreign_files import Walk
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.bag import assign_bag_topics
from stridetwin.streams.formats.opening import ImportOptions, imu_topic, open_any
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Accelerometer, Depth, Image, Imu, Odometry


@pytest.fixture(scope="module")
def ros1_bag(tmp_path_factory):
    return foreign_files.write_rosbag1(tmp_path_factory.mktemp("ros1"), Walk())


@pytest.mark.parametrize("schema", [None, "Header header\n", "", "no definition {{"])
@pytest.mark.parametrize("chunked", [True, False])
def test_ros_1_messages_in_mcap_are_those_of_the_bag(ros1_bag, tmp_path, schema, chunked):
    recording = open_any(convert_to_mcap(ros1_bag, tmp_path / "walk.mcap", schema=schema, chunked=chunked))
    bag = open_any(ros1_bag)
    assert recording.topics == bag.topics
    for topic in ("/head/imu", "/truth/head/odometry"):
        for name, values in bag.block(topic).columns.items():
            np.testing.assert_array_equal(recording.block(topic).columns[name], values)
    for topic in ("/head/color", "/head/depth"):
        image, expected = recording.images(topic, [3])[0], bag.images(topic, [3])[0]
        attribute = "pixels" if isinstance(image, Image) else "depth"
        np.testing.assert_array_equal(getattr(image, attribute), getattr(expected, attribute))
    assert recording.rig.cameras["/head/color"].intrinsics == bag.rig.cameras["/head/color"].intrinsics


def mcap_of(file, encoding, data, name="sensor_msgs/Imu", count=3, topic="/foot_l/imu"):
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel(topic, encoding, writer.register_schema(name, encoding, b""))
        for i in range(count):
            writer.add_message(channel, log_time=START_NS + i, publish_time=START_NS + i, data=data)
        writer.finish()
    return file


def test_ros_1_messages_that_are_damaged(tmp_path):
    file = mcap_of(tmp_path / "a.mcap", "ros1", b"short")
    with pytest.raises(StrideTwinError, match=r"/foot_l/imu: cannot be decoded: not a sensor_msgs/msg/Imu of ROS 1"):
        open_any(file)
    with pytest.raises(StrideTwinError, match=r"no readable sample; .*cannot be decoded"):
        open_any(file, lenient=True)


@pytest.mark.parametrize("encoding", ["protobuf", "json", "flatbuffer"])
def test_other_encodings_are_named(tmp_path, encoding):
    file = mcap_of(tmp_path / "a.mcap", encoding, b"{}", "foxglove.Imu")
    says = rf"no readable sample: .*/foot_l/imu \(foxglove.Imu in {encoding}\); convert it to ROS 2"
    with pytest.raises(StrideTwinError, match=says):
        open_any(file)
    assert Recording(file, lenient=True).unread == {"/foot_l/imu": f"foxglove.Imu in {encoding}"}


def test_a_standard_type_without_its_definition(tmp_path):
    message = bytes(STORE.serialize_cdr(still_imu(1)[0][1], IMU_TYPE))
    recording = open_any(mcap_of(tmp_path / "a.mcap", "cdr", message, count=1))
    assert recording.topics["/foot_l/imu"].count == 1


def test_a_bag_without_sensors_says_what_it_has(tmp_path):
    text = STORE.types["std_msgs/msg/String"]("hello")
    streams = {"/chatter": ("std_msgs/msg/String", [(START_NS, text)]), "/imu": (IMU_TYPE, [])}
    with pytest.raises(StrideTwinError, match="no readable sample") as caught:
        open_any(write_bag(tmp_path / "bag", streams))
    (line,) = str(caught.value).splitlines()
    assert "it has /chatter (std_msgs/msg/String), /imu (sensor_msgs/msg/Imu, no messages)" in line
    assert "expected messages of sensor_msgs/msg/Imu" in line


def test_a_missing_topic_is_reported_with_those_that_are_not_read(tmp_path):
    text = STORE.types["std_msgs/msg/String"]("hello")
    streams = {"/imu/data": (IMU_TYPE, still_imu()), "/chatter": ("std_msgs/msg/String", [(START_NS, text)])}
    recording = open_any(write_bag(tmp_path / "bag", streams))
    says = r"no topic '/foot_l/imu'; it has /head/imu; not read: /chatter \(std_msgs/msg/String\); if /head/imu is"
    with pytest.raises(StrideTwinError, match=says):
        recording.block("/foot_l/imu")


NAMES = [
    ("/camera/gyro/sample", "/camera/accel/sample", "/camera/imu"),
    ("/phone/gyroscope", "/phone/accelerometer", "/phone/imu"),
    ("/imu/angular_velocity", "/imu/linear_acceleration", "/imu/imu"),
]


@pytest.mark.parametrize(("gyro", "accel", "joined"), NAMES)
def test_rates_and_forces_of_two_clocks(tmp_path, gyro, accel, joined):
    zero = np.zeros(3)
    apart_ns = 300_000_000 * 10**9
    streams = {
        gyro: (IMU_TYPE, still_imu(force=zero, shift_ns=apart_ns)),
        accel: (IMU_TYPE, still_imu(rate=zero)),
    }
    bag = write_bag(tmp_path / "apart", streams)
    spans = "stamps from 2000000000.000 to 2000000000.590 s, those of {} from 1700000000.000 to 1700000000.590 s"
    with pytest.raises(StrideTwinError) as caught:
        open_any(bag)
    (line,) = str(caught.value).splitlines()
    assert f"{gyro}: {spans.format(accel)}: they do not overlap" in line
    lenient = open_any(bag, lenient=True)
    assert {topic: info.kind for topic, info in lenient.topics.items()} == {"/head/accelerometer": Accelerometer}
    streams[gyro] = (IMU_TYPE, still_imu(force=zero, shift_ns=20 * PERIOD_NS))
    partly = open_any(write_bag(tmp_path / "partly", streams))
    assert partly.topics["/head/imu"].count == 40
    assert any(f"joined as {joined}" in w for w in partly.warnings)
    (warning,) = (w for w in partly.warnings if "33% of the rates have no forces and are left out" in w)
    assert "the rates are probably stamped 0.200 s later, by another clock" in warning
    streams[accel] = (IMU_TYPE, still_imu(rate=zero)[:30])  # whose forces end early
    short = open_any(write_bag(tmp_path / "short", {**streams, gyro: (IMU_TYPE, still_imu(force=zero))}))
    (warning,) = (w for w in short.warnings if "rates have no forces" in w)
    assert "another clock" not in warning


def test_a_database_without_metadata_is_read(tmp_path):
    bag = write_bag(tmp_path / "walk", {"/foot_l/imu": (IMU_TYPE, still_imu())})
    (bag / "metadata.yaml").unlink()
    recording = open_any(bag)
    assert recording.topics["/foot_l/imu"].count == 60
    assert any("no metadata.yaml" in w and "walk.db3" in w for w in recording.warnings)


def test_databases_without_metadata_are_read_in_the_order_of_their_numbers(tmp_path):
    whole = tmp_path / "whole"
    whole.mkdir()
    for number in (0, 1, 2, 10):
        start = START_NS + number * 60 * PERIOD_NS
        images = [(start, grey_message(start))]
        streams = {"/foot_l/imu": (IMU_TYPE, still_imu(start_ns=start)), "/foot_l/camera": (IMAGE_TYPE, images)}
        part = write_bag(tmp_path / f"part_{number}", streams)
        shutil.move(part / f"part_{number}.db3", whole / f"walk_{number}.db3")
    recording = open_any(whole)
    assert recording.topics["/foot_l/imu"].count == 240
    assert recording.images("/foot_l/camera", [3])[0].t_ns == START_NS + 600 * PERIOD_NS


def test_messages_that_are_still_in_the_journal(tmp_path):
    bag = write_bag(tmp_path / "walk", {"/foot_l/imu": (IMU_TYPE, still_imu())})
    (bag / "metadata.yaml").unlink()
    (bag / "walk.db3-wal").write_bytes(b"pages")
    with pytest.raises(StrideTwinError, match=r"walk\.db3-wal beside it holds messages .*PRAGMA wal_checkpoint"):
        open_any(bag)
    assert open_any(bag, lenient=True).topics["/foot_l/imu"].count == 60


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("- walk.db3", "- renamed.db3", r"invalid 'renamed\.db3': .*the folder has walk\.db3; `ros2 bag reindex`"),
        ("relative_file_paths", "paths", "no description of a ROS 2 bag: .*`ros2 bag reindex`"),
    ],
)
def test_metadata_that_do_not_fit(tmp_path, old, new, says):
    bag = write_bag(tmp_path / "walk", {"/foot_l/imu": (IMU_TYPE, still_imu())})
    metadata = bag / "metadata.yaml"
    text = metadata.read_text()
    assert old in text
    metadata.write_text(text.replace(old, new))
    with pytest.raises(StrideTwinError, match=says):
        open_any(bag)


@pytest.mark.parametrize(
    ("names", "says"),
    [
        (["a/rgb.txt", "notes.md"], r"recordings inside; give one of them: .*/a$"),
        (["walk.bag", "notes.md"], r"recordings inside; give one of them: .*walk\.bag$"),
        (["walk_0.db3.zstd"], r"walk_0\.db3\.zstd is packed: unpack it first"),
        ([f"{i:02d}.png" for i in range(10)], r"it has 00\.png, .*07\.png, and 2 more"),
        ([], "it is empty"),
    ],
)
def test_a_folder_of_no_known_layout_says_what_it_has(tmp_path, names, says):
    with pytest.raises(StrideTwinError, match="unknown layout: expected a folder of one of the kinds") as caught:
        open_any(touch_files(tmp_path, *names))
    (line,) = str(caught.value).splitlines()
    assert re.search(says, line)


def test_images_beside_tables_are_named(tmp_path):
    rng = np.random.default_rng(1)
    for name, mean in (("accelerometer", (0, 0, 9.81)), ("gyroscope", (0, 0, 0))):
        table = np.column_stack((np.arange(40) / 100, rng.normal(mean, 0.01, (40, 3))))
        header = ",".join(["t[s]", *(f"{a}[{'m/s²' if mean[2] else 'rad/s'}]" for a in "xyz")])
        np.savetxt(tmp_path / f"{name}.csv", table, delimiter=",", header=header, comments="", encoding="utf-8")
    touch_files(tmp_path, "left/000.png")
    recording = open_any(tmp_path)
    assert any("the images in left/ have no layout that is read" in w for w in recording.warnings)


def test_a_database_of_another_name(tmp_path):
    bag = write_bag(tmp_path / "walk", {"/foot_l/imu": (IMU_TYPE, still_imu())})
    shutil.copy(bag / "walk.db3", tmp_path / "walk.sqlite3")
    with pytest.raises(StrideTwinError, match=r"invalid '\.sqlite3': expected a file \.db3"):
        open_any(tmp_path / "walk.sqlite3")


@pytest.mark.parametrize(("head", "name"), [(b"PK\3\4more", "zip"), (b"\x28\xb5\x2f\xfdmore", "zstd")])
def test_packed_files_are_named(tmp_path, head, name):
    (tmp_path / "walk.db3.zstd").write_bytes(head)
    with pytest.raises(StrideTwinError, match=f"invalid '{name} content': .*unpack it first"):
        open_any(tmp_path / "walk.db3.zstd")


@pytest.mark.parametrize(
    ("kinds", "ours"),
    [
        ({"/pelvis/imu": Imu}, {}),
        ({"/pelvis/imu": Imu, "/imu/data": Imu}, {"/imu/data": "/head/imu"}),
        ({"/imu/data": Imu, "/helmet/imu": Imu}, {"/helmet/imu": "/head/imu"}),
        (
            {"/xsens/lfoot/imu": Imu, "/xsens/rfoot/imu": Imu, "/xsens/lthigh/imu": Imu, "/xsens/sternum/imu": Imu},
            {"/xsens/lfoot/imu": "/foot_l/imu", "/xsens/rfoot/imu": "/foot_r/imu", "/xsens/sternum/imu": "/chest/imu"},
        ),
        (
            {"/left_foot/imu/data": Imu, "/imu_right_shoe": Imu, "/imu/RightShank": Imu},
            {"/left_foot/imu/data": "/foot_l/imu", "/imu_right_shoe": "/foot_r/imu"},
        ),
        ({"/suit/LeftFoot": Imu, "/suit/Pelvis": Imu}, {"/suit/LeftFoot": "/foot_l/imu"}),
        (
            {"/waist_camera/color": Image, "/waist_camera/depth": Depth, "/waist_camera/imu": Imu},
            {},
        ),
        ({"/vicon/pelvis": Odometry, "/vicon/helmet": Odometry}, {"/vicon/helmet": "/truth/head/odometry"}),
        ({"/ship/imu": Imu}, {"/ship/imu": "/head/imu"}),
        ({"/dot/left": Imu, "/dot/right": Imu}, {}),
    ],
)
def test_names_of_other_makers(kinds, ours):
    assert assign_bag_topics(kinds) == ours


@pytest.mark.parametrize(
    ("name", "topic"),
    [
        ("left_sensor", "/foot_l/imu"),
        ("RightFoot", "/foot_r/imu"),
        ("pelvis", "/pelvis/imu"),
        ("left_thigh", "/left_thigh/imu"),
        ("wrist_r", "/wrist_r/imu"),
    ],
)
def test_topics_of_the_sensors_of_a_table(name, topic):
    assert imu_topic(name) == topic


def test_an_imu_of_another_part_of_the_body_keeps_its_name_and_body(tmp_path):
    bag = write_bag(tmp_path / "walk", {"/xsens/pelvis/imu": (IMU_TYPE, still_imu())})
    recording = open_any(bag)
    assert set(recording.topics) == {"/xsens/pelvis/imu"}
    assert recording.rig.imu("/xsens/pelvis/imu").mount.body == "pelvis"
    moved = open_any(bag, options=ImportOptions(names={"/xsens/pelvis/imu": "/head/imu"}))
    assert moved.rig.imu("/head/imu").mount.body == "head"


def test_the_missing_imu_may_be_one_of_the_same_side(tmp_path):
    streams = {topic: (IMU_TYPE, still_imu()) for topic in ("/dot/left", "/dot/right")}
    recording = open_any(write_bag(tmp_path / "walk", streams))
    with pytest.raises(StrideTwinError, match="if /dot/right is that sensor: --map /dot/right=/foot_r/imu"):
        recording.block("/foot_r/imu")


def test_the_choice_among_imus_without_a_place_is_reported(tmp_path):
    streams = {topic: (IMU_TYPE, still_imu()) for topic in ("/imu_a", "/imu_b")}
    recording = open_any(write_bag(tmp_path / "walk", streams))
    assert set(recording.topics) == {"/head/imu", "/imu_b"}
    assert any("/imu_a is taken as /head/imu, of /imu_a, /imu_b" in w for w in recording.warnings)


@pytest.mark.parametrize(
    ("focals", "sizes", "used", "says"),
    [
        ((26.0,) * 9, ((32, 24),) * 9, 26.0, ""),
        ((26.0, 26.1, 26.2) * 3, ((32, 24),) * 9, 26.1, ""),
        ((24.0, 26.0, 30.0) * 3, ((32, 24),) * 9, 26.0, r"intrinsics change from image to image \(fu 24\.0 to 30\.0"),
        ((0.0, 26.0, 26.0), ((32, 24),) * 3, 26.0, ""),
        ((26.0, 52.0), ((32, 24), (64, 48)), 26.0, "images of several sizes, 32 x 24 and 64 x 48"),
    ],
)
def test_intrinsics_that_change_are_reported(tmp_path, focals, sizes, used, says):
    stamps = START_NS + 10 * PERIOD_NS * np.arange(len(focals))
    streams = {
        "/camera/color/image_raw": (IMAGE_TYPE, [(int(t), grey_message(t)) for t in stamps]),
        "/camera/color/camera_info": (
            INFO_TYPE,
            [(int(t), info_message(t, f, size)) for t, f, size in zip(stamps, focals, sizes)],
        ),
        "/camera/imu": (IMU_TYPE, still_imu(30)),
    }
    recording = open_any(write_bag(tmp_path / "walk", streams))
    assert recording.rig.cameras["/head/color"].intrinsics[0] == used
    reports = [w for w in recording.warnings if "camera_info" in w]
    assert bool(reports) == bool(says)
    assert re.search(says, " ".join(reports))
