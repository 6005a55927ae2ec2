"""Recordings: round trips, stock readers, and everything a loader must refuse."""

import dataclasses
import hashlib
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rigs import every_small_block, small_rig
from rosbags.highlevel import AnyReader

from stridetwin.streams.errors import ConfigError, RecordingError
from stridetwin.streams.files import partial_path
from stridetwin.streams.recording import index, mcap_contents
from stridetwin.streams.recording import writer as recorder
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Depth, Image, Imu, Range

STANDARD = {
    "/head/imu": "sensor_msgs/msg/Imu",
    "/exo/back/ahrs": "sensor_msgs/msg/Imu",
    "/chest/accelerometer": "sensor_msgs/msg/Imu",
    "/head/color": "sensor_msgs/msg/CompressedImage",
    "/head/depth": "sensor_msgs/msg/Image",
    "/head/color/camera_info": "sensor_msgs/msg/CameraInfo",
    "/head/depth/camera_info": "sensor_msgs/msg/CameraInfo",
    "/foot_l/camera": "sensor_msgs/msg/CompressedImage",
    "/foot_l/sonar": "sensor_msgs/msg/Range",
    "/exo/knee_l/encoder": "sensor_msgs/msg/JointState",
    "/truth/joints": "sensor_msgs/msg/JointState",
    "/truth/pelvis": "nav_msgs/msg/Odometry",
    "/truth/foot_l/wrench": "geometry_msgs/msg/WrenchStamped",
    "/truth/foot_l/cop": "geometry_msgs/msg/PointStamped",
    "/truth/foot_l/phase": "std_msgs/msg/UInt8",
    "/truth/footprints": "stridetwin_msgs/msg/Footprint",
    "/foot_l/insole": "stridetwin_msgs/msg/Insole",
    "/exo/thigh_l/interaction": "stridetwin_msgs/msg/Interaction",
    "/exo/hip_l/actuator": "stridetwin_msgs/msg/Actuator",
}


def imu_block(t_ns, topic="/head/imu", force=9.81):
    n = len(t_ns)
    columns = {"angular_rate": np.zeros((n, 3)), "specific_force": np.full((n, 3), force)}
    return Block(topic=topic, kind=Imu, t_ns=np.asarray(t_ns, np.int64), columns=columns)


def write(path, *items, rig=None, **options):
    with RecordingWriter(path, rig or Rig(), **options) as writer:
        for item in items:
            writer.write(item)
    return path


def test_several_topics_come_in_one_pass_and_times_without_decoding(recorded, monkeypatch):
    topics = [block.topic for block in every_small_block()]
    one_by_one = {topic: Recording(recorded).block(topic) for topic in topics}
    recording, passes = Recording(recorded), []
    read = mcap_contents.read_chunk
    monkeypatch.setattr(mcap_contents, "read_chunk", lambda *where: passes.append(where) or read(*where))
    times = {topic: recording.times(topic) for topic in recording.topics}
    imus = [topic for topic in topics if recording.topics[topic].kind is Imu]
    kept = recording.blocks(imus)
    assert (passes, bool(imus)) == ([], True)
    blocks = recording.blocks(topics)
    assert len(passes) == len(set(passes))
    for topic, block in one_by_one.items():
        for found in (blocks[topic], kept.get(topic, block)):
            np.testing.assert_array_equal(found.t_ns, block.t_ns)
            for name, column in block.columns.items():
                np.testing.assert_array_equal(found.columns[name], column)
        np.testing.assert_array_equal(times[topic], block.t_ns)
    np.testing.assert_array_equal(times["/head/color"], recording.image_times("/head/color"))


def test_imu_samples_that_are_too_many_to_keep_are_read_again(recorded, monkeypatch):
    before = Recording(recorded).block("/head/imu")
    monkeypatch.setattr(index, "KEPT_BYTES", 100)
    np.testing.assert_array_equal(Recording(recorded).block("/head/imu").t_ns, before.t_ns)


def test_every_small_sample_comes_back(recorded):
    recording = Recording(recorded)
    for block in every_small_block():
        back = recording.block(block.topic)
        assert back.kind is block.kind
        np.testing.assert_array_equal(back.t_ns, block.t_ns)
        assert dict(back.constants) == dict(block.constants)
        assert set(back.columns) == set(block.columns)
        for name, values in block.columns.items():
            if values.dtype.kind == "f":
                np.testing.assert_allclose(back.columns[name], values, atol=1e-12)
            else:
                assert back.columns[name].tolist() == values.tolist()


def test_stock_mcap_reader_agrees(recorded):
    with recorded.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        types = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
        assert types == STANDARD
        messages = list(reader.iter_messages())
        assert summary.statistics.message_count == len(messages)
        assert [m.log_time for _, _, m in messages] == sorted(m.log_time for _, _, m in messages)
        assert [a.name for a in reader.iter_attachments()] == ["rig.yaml"]
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        assert metadata == {"stridetwin": {"seed": "7"}, "stridetwin_schema": {"version": "1.0"}}
        per_topic = {}
        for _, channel, _ in messages:
            per_topic[channel.topic] = per_topic.get(channel.topic, 0) + 1
        assert {t: info.count for t, info in Recording(recorded).topics.items()} == {
            t: n for t, n in per_topic.items() if not t.endswith("camera_info")
        }
        assert per_topic["/head/color/camera_info"] == 2


def test_rosbags_reads_every_message_from_the_bare_file(recorded):
    with AnyReader([recorded]) as reader:
        seen = {}
        for connection, log_time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if hasattr(message, "header"):
                stamp = message.header.stamp
                assert stamp.sec * 1_000_000_000 + stamp.nanosec == log_time
            seen.setdefault(connection.topic, message)
    assert set(seen) == set(STANDARD)
    assert seen["/head/imu"].orientation_covariance[0] == -1
    assert seen["/exo/back/ahrs"].linear_acceleration_covariance[0] == -1
    assert seen["/head/color/camera_info"].k.tolist() == [38.1, 0, 15.5, 0, 38.2, 11.5, 0, 0, 1]
    assert seen["/head/depth"].encoding == "16UC1"
    assert seen["/foot_l/sonar"].range == np.inf
    odometry, block = (
        seen["/truth/pelvis"],
        next(b for b in every_small_block() if b.topic == "/truth/pelvis"),
    )
    q, twist = odometry.pose.pose.orientation, odometry.twist.twist.linear
    assert [q.w, q.x, q.y, q.z] == block.columns["q_world_frame"][0].tolist()
    assert np.linalg.norm([twist.x, twist.y, twist.z]) == pytest.approx(
        np.linalg.norm(block.columns["v_frame_in_world"][0])
    )
    assert not np.allclose([twist.x, twist.y, twist.z], block.columns["v_frame_in_world"][0])


def test_samples_of_all_topics_come_in_time_order_and_images_last(recorded):
    recording = Recording(recorded)
    samples = list(recording.samples())
    assert len(samples) == sum(t.count for t in recording.topics.values())
    times = [s.t_ns for s in samples]
    assert times == sorted(times)
    for a, b in pairwise(samples):
        assert a.t_ns < b.t_ns or not (isinstance(a, (Image, Depth)) and isinstance(b, Imu))
    only = list(recording.samples(["/head/imu"]))
    assert [type(s) for s in only] == [Imu] * 57


def test_images(recorded):
    recording = Recording(recorded)
    times = recording.image_times("/head/color")
    last, first = recording.images("/head/color", [59, 0])
    assert (first.t_ns, last.t_ns) == (times[0], times[59])
    assert recording.images("/head/color", t_ns=[int(times[7]) + 1000])[0].t_ns == times[7]
    (grey,) = recording.images("/foot_l/camera", [3])
    assert grey.pixels.shape == (24, 32)
    assert first.pixels.shape == (24, 32, 3)
    assert first.pixels[..., 0].mean() == pytest.approx(200, abs=5)
    assert first.pixels[..., 2].mean() == pytest.approx(30, abs=5)
    (depth,) = recording.images("/head/depth", [0])
    expected = np.linspace(0, 3, 32 * 24, dtype=np.float32).reshape(24, 32)
    np.testing.assert_allclose(depth.depth, expected, atol=0.0006)
    with pytest.raises(RecordingError, match="no image 60: expected 0 to 59"):
        recording.images("/head/color", [60])


def test_ideal_depth_is_lossless(tmp_path):
    depth = np.random.default_rng(1).random((4, 6), np.float32)
    sample = Depth(topic="/d", t_ns=5, depth=depth)
    path = write(tmp_path / "a.mcap", sample, depth_encoding="32FC1")
    np.testing.assert_array_equal(Recording(path).images("/d")[0].depth, depth)
    with pytest.raises(ConfigError, match="16UC1 or 32FC1"):
        RecordingWriter(path, Rig(), depth_encoding="8UC1")


def test_depth_in_mm_has_two_ways_to_say_none(tmp_path):
    depth = np.array([[0.0, 65.535, 100.0, 65.534, 0.001]], np.float32)
    path = write(tmp_path / "a.mcap", Depth(topic="/d", t_ns=5, depth=depth))
    assert Recording(path).images("/d")[0].depth.tolist()[0] == pytest.approx([0, 0, 0, 65.534, 0.001])


def test_same_input_same_bytes(tmp_path, recorded):
    digests = set()
    for name in ("a.mcap", "b.mcap"):
        path = tmp_path / name
        with RecordingWriter(path, small_rig(), {"seed": "1"}) as writer:
            for sample in Recording(recorded).samples():
                writer.write(sample)
        digests.add(hashlib.sha256(path.read_bytes()).hexdigest())
    assert len(digests) == 1


def test_single_samples_and_blocks_give_the_same_messages(tmp_path):
    block = every_small_block(40)[0]
    a = write(tmp_path / "a.mcap", block)
    b = write(tmp_path / "b.mcap", *block)
    assert a.read_bytes() == b.read_bytes()


def test_rig_and_metadata_travel_along(recorded):
    recording = Recording(recorded)
    assert recording.metadata == {"seed": "7"}
    assert recording.rig.cameras["/head/color"].intrinsics == (38.1, 38.2, 15.5, 11.5)
    assert recording.duration == pytest.approx(59 * 0.033333333 + 0.0, abs=0.05)


def test_an_error_leaves_the_good_file_and_a_readable_partial(tmp_path):
    path = write(tmp_path / "a.mcap", imu_block(range(0, 10**9, 5_000_000)))
    before = path.read_bytes()
    good = imu_block(range(0, 2 * 10**9, 5_000_000))
    with pytest.raises(RecordingError, match=r"invalid stamp .* s: expected stamps"):
        write(path, good, good)
    assert path.read_bytes() == before
    assert len(Recording(partial_path(path), lenient=True).block("/head/imu")) == 400


@pytest.mark.parametrize("times", [[10, 20, 20, 30], [10, 20, 15], [-5, 3]])
def test_writer_refuses_stamps_that_do_not_increase(tmp_path, times):
    with pytest.raises(RecordingError, match=r"/head/imu: invalid stamp .* increase strictly"):
        write(tmp_path / "a.mcap", imu_block(times))
    with pytest.raises(RecordingError, match=r"/head/imu: invalid stamp"):
        write(tmp_path / "b.mcap", *imu_block(times))
    assert not (tmp_path / "a.mcap").exists()


def test_writer_refuses_a_topic_that_changes_its_kind(tmp_path):
    with pytest.raises(RecordingError, match="invalid Range: expected Imu, as before"):
        write(tmp_path / "a.mcap", imu_block([1]), Range(topic="/head/imu", t_ns=2, distance=1.0))


def test_missing_topic_lists_those_there_are(recorded):
    with pytest.raises(RecordingError, match=r"no topic '/foot_r/imu'; it has .*/head/imu"):
        Recording(recorded).block("/foot_r/imu")
    with pytest.raises(RecordingError, match="no topic 'head/imu': expected '/head/imu', with a slash"):
        Recording(recorded).block("head/imu")
    with pytest.raises(RecordingError, match="carries images"):
        Recording(recorded).block("/head/color")


def test_images_that_share_read_only_pixels_are_encoded_once(tmp_path, monkeypatch):
    blank = np.full((12, 16), 96, np.uint8)
    encoded = []
    data = recorder.encode_pixels
    monkeypatch.setattr(recorder, "encode_pixels", lambda *args: encoded.append(1) or data(*args))
    files = []
    for writeable in (True, False):
        blank.setflags(write=writeable)
        with RecordingWriter(tmp_path / f"{writeable}.mcap", Rig()) as writer:
            for t in (1, 2, 3):
                writer.write(Image(topic="/foot_l/camera", t_ns=t, pixels=blank))
        files.append((tmp_path / f"{writeable}.mcap").read_bytes())
    assert files[0] == files[1]
    assert len(encoded) == 1


def test_nan_is_refused_by_name_and_time_and_dropped_when_lenient(tmp_path):
    block = imu_block(range(0, 10**9, 10_000_000))
    block.columns["specific_force"][40, 1] = np.nan
    block.columns["angular_rate"][60, 0] = np.inf
    path = write(tmp_path / "a.mcap", block)
    with pytest.raises(RecordingError, match=r"a\.mcap: /head/imu at 0\.400000 s: NaN.*--lenient"):
        Recording(path)
    recording = Recording(path, lenient=True)
    assert recording.topics["/head/imu"].count == len(recording.block("/head/imu")) == 98
    assert np.isfinite(recording.block("/head/imu").columns["specific_force"]).all()
    assert [str(p) for p in recording.problems] == ["/head/imu at 0.400000 s: NaN or infinity (2 samples)"]


def test_truth_may_say_nan(tmp_path):
    path = write(tmp_path / "a.mcap", imu_block([1, 2, 3], topic="/truth/x", force=np.nan))
    assert len(Recording(path).block("/truth/x")) == 3


def test_backward_stamps_are_refused_and_dropped_when_lenient(tmp_path):
    t = np.arange(100) * 10_000_000
    t[50:60] -= 200_000_000
    t[80] = t[79]
    path = tmp_path / "a.mcap"
    with RecordingWriter(path, Rig()) as writer:
        writer.write(imu_block(t), log_ns=np.arange(100) * 10_000_000)
    with pytest.raises(
        RecordingError, match=r"/head/imu at 0\.300000 s: the stamp is not after the previous one, 0\.490000 s"
    ):
        Recording(path)
    back = Recording(path, lenient=True).block("/head/imu").t_ns
    assert np.all(np.diff(back) > 0)
    assert len(back) == 89
    assert [s.t_ns for s in Recording(path, lenient=True).samples()] == back.tolist()


def test_a_rate_far_from_the_declared_one_is_refused(tmp_path):
    slow = imu_block(range(0, 10**9, 8_000_000))
    path = write(tmp_path / "a.mcap", slow, rig=small_rig())
    with pytest.raises(RecordingError, match=r"/head/imu .*125\.0 Hz where the rig declares 200 Hz"):
        Recording(path)
    assert Recording(path, lenient=True).topics["/head/imu"].count == 125
    write(path, imu_block(range(0, 10**9, 5_500_000)), rig=small_rig())
    assert not Recording(path).problems


def test_missing_rig_is_named(tmp_path, recorded):
    from mcap.writer import Writer

    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        writer.finish()
    with pytest.raises(RecordingError, match="no calibration inside"):
        _ = Recording(path).rig
    assert Recording(path).topics == {}


def test_what_is_no_recording(tmp_path):
    path = tmp_path / "a.mcap"
    with pytest.raises(RecordingError, match="cannot be read"):
        Recording(path)
    for content in (b"", b"hello world, hello"):
        path.write_bytes(content)
        for lenient in (False, True):
            with pytest.raises(RecordingError, match="no MCAP file"):
                Recording(path, lenient)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.001, 0.9999))
def test_cut_off_anywhere(recorded, tmp_path, share):
    whole = recorded.read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[: max(8, int(len(whole) * share))])
    with pytest.raises(RecordingError, match=r"cut\.mcap: .*(cut off|no sample lies before).*--lenient"):
        Recording(path)
    reference = {t: Recording(recorded).block(t).t_ns for t in ("/head/imu", "/truth/pelvis")}
    recording = Recording(path, lenient=True)
    assert recording.problems
    for topic, t in reference.items():
        if topic in recording.topics:
            back = recording.block(topic).t_ns
            np.testing.assert_array_equal(back, t[: len(back)])
    times = [s.t_ns for s in recording.samples()]
    assert times == sorted(times)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0, 0.999999), bit=st.integers(0, 7))
def test_a_flipped_bit_anywhere_is_noticed(recorded, tmp_path, share, bit):
    data = bytearray(recorded.read_bytes())
    data[int(len(data) * share)] ^= 1 << bit
    path = tmp_path / "flipped.mcap"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"lenient|no MCAP|valid"):
        Recording(path)


def foreign(path, stamps, log_offset=5_000_000, names=("a",), frame="imu"):
    """A recording by the stock writer, by a driver with another frame, latency and a big-endian machine."""
    from mcap.writer import Writer

    from stridetwin.streams.recording.ros_types import build_message, definition, typestore

    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4096)
        writer.start(profile="ros2")
        for typename, topic in (("sensor_msgs/msg/Imu", "/imu"), ("sensor_msgs/msg/JointState", "/joints")):
            schema = writer.register_schema(typename, "ros2msg", definition(typename).encode())
            channel = writer.register_channel(topic, "cdr", schema)
            for i, t in enumerate(stamps):
                values = {"header.stamp.sec": t // 10**9, "header.stamp.nanosec": t % 10**9}
                if topic == "/imu":
                    values |= {"header.frame_id": frame * (1 + i % 2), "linear_acceleration.z": 9.8 + i}
                else:
                    values |= {"name": list(names), "position": np.full(len(names), float(i))}
                data = typestore().serialize_cdr(build_message(typename, values), typename, little_endian=bool(i % 3))
                writer.add_message(channel, t + log_offset, bytes(data), t + log_offset)
        writer.finish()
    return path


def test_a_foreign_recording_reads_by_its_header_stamps(tmp_path):
    stamps = [10**15 + i * 10_000_000 for i in range(100)]
    recording = Recording(foreign(tmp_path / "f.mcap", stamps))
    assert {t: i.kind.__name__ for t, i in recording.topics.items()} == {"/imu": "Imu", "/joints": "Encoder"}
    imu = recording.block("/imu")
    assert imu.t_ns.tolist() == stamps
    assert imu.columns["specific_force"][:, 2].tolist() == [9.8 + i for i in range(100)]
    times = [s.t_ns for s in recording.samples()]
    assert times == sorted(times)
    assert len(times) == 200


def test_a_foreign_joint_state_of_several_joints(tmp_path):
    recording = Recording(foreign(tmp_path / "f.mcap", [10**9, 2 * 10**9], names=("hip", "knee")))
    joints = recording.block("/joints")
    assert joints.constants == {"names": ("hip", "knee")}
    assert joints.columns["position"].tolist() == [[0, 0], [1, 1]]
    assert [f.name for f in dataclasses.fields(joints.kind)][2:] == [
        "names",
        "position",
        "velocity",
        "torque",
    ]


def test_a_damaged_chunk_costs_only_itself_when_lenient(tmp_path):
    t = np.arange(0, 10 * 10**9, 5_000_000)
    path = write(tmp_path / "a.mcap", imu_block(t))
    with path.open("rb") as file:
        chunk = make_reader(file).get_summary().chunk_indexes[2]
    data = bytearray(path.read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"a\.mcap: .*(CRC|damaged).*--lenient"):
        Recording(path)
    recording = Recording(path, lenient=True)
    kept = recording.block("/head/imu").t_ns
    assert len(kept) == len(t) - 400  # a chunk holds 2 s
    assert set(kept) < set(t)
    assert recording.has_rig
