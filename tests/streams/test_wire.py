"""Messages, hellos and addresses, byte by byte."""

import json
import struct
import time
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from rigs import every_small_block, small_rig

from stridetwin.streams.bounded_images import image_size
from stridetwin.streams.kalibr import rig_to_yaml
from stridetwin.streams.live.messages import Message, MessageDecoder, MessageEncoder, to_messages
from stridetwin.streams.live.wire import (
    LARGEST_HELLO,
    VERSION,
    Counts,
    Hello,
    WireError,
    check_message,
    parse_address,
    parse_json,
    read_message,
)
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.recording.ros_types import serialise, typestore
from stridetwin.streams.samples import Depth, Image, Imu, Odometry
from stridetwin.streams.validation import type_adapter


def arrived(message, **other):
    """A message as Zenoh hands it over."""
    values = {
        "key_expr": f"stridetwin/1a/samples{message.topic}",
        "payload": Bytes(message.payload),
        "attachment": struct.pack("<qQ", message.t_ns, 5),
        "encoding": f"application/cdr;{message.typename}",
    }
    return SimpleNamespace(**{**values, **other})


class Bytes(bytes):
    def to_bytes(self):
        return bytes(self)


def same(a, b):
    """Whether two samples say the same."""
    close = np.allclose if type(a) is Odometry else np.array_equal  # whose velocity is turned there and back
    equal = all(close(getattr(a, n), getattr(b, n)) for n in type(a).__slots__)
    return type(a) is type(b) and a.t_ns == b.t_ns and equal


def test_what_is_sent_is_what_a_recording_holds_and_says_the_same(recorded):
    recording = Recording(recorded)
    encoder, decoders = MessageEncoder(recording.rig), {}
    samples = {(s.topic, s.t_ns): s for s in recording.samples()}
    count = 0
    for message in to_messages(recording, list(recording.topics)):
        assert read_message(arrived(message)) == (message, 5)
        decoder = decoders.setdefault(message.topic, MessageDecoder(message.topic, message.typename))
        sample = samples.pop((message.topic, message.t_ns))
        assert same(decoder.decode(message), sample)
        if not isinstance(sample, Image | Odometry):  # a JPEG of a JPEG is another one; a turned velocity has rounded
            assert encoder.encode(sample).payload == message.payload, message.topic
        count += 1
    assert not samples
    assert count == sum(t.count for t in recording.topics.values())


def test_messages_come_in_order_imus_first_and_images_last(recorded):
    recording = Recording(recorded)
    kinds = {Imu: 0, Image: 2, Depth: 2}
    keys = [
        (m.t_ns, kinds.get(recording.topics[m.topic].kind, 1), m.topic)
        for m in to_messages(recording, list(recording.topics))
    ]
    assert keys == sorted(keys)


def test_images_can_travel_with_every_pixel():
    pixels = np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8)
    depth = np.random.default_rng(1).uniform(0.2, 5, (24, 32)).astype(np.float32)
    encoder = MessageEncoder(small_rig(), depth_encoding="32FC1", jpeg_quality=None)
    for sample in (
        Image(topic="/head/color", t_ns=5, pixels=pixels),
        Image(topic="/foot_l/camera", t_ns=6, pixels=pixels[..., 0]),
        Depth(topic="/head/depth", t_ns=7, depth=depth),
    ):
        message = encoder.encode(sample)
        assert same(MessageDecoder(message.topic, message.typename).decode(message), sample)


def test_a_payload_is_the_ros_message_that_rosbags_reads():
    block = next(b for b in every_small_block() if b.kind is Imu)
    sample = next(iter(block))
    message = MessageEncoder(small_rig()).encode(sample)
    decoded = typestore().deserialize_cdr(message.payload, message.typename)
    assert message.typename == "sensor_msgs/msg/Imu"
    assert (decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec, decoded.header.frame_id) == (
        sample.t_ns,
        "head/imu",
    )
    assert [
        decoded.angular_velocity.x,
        decoded.angular_velocity.y,
        decoded.angular_velocity.z,
    ] == sample.angular_rate.tolist()
    force = decoded.linear_acceleration
    assert [force.x, force.y, force.z] == sample.specific_force.tolist()


def test_a_hello_brings_rig_texts_and_clock():
    hello = Hello(
        version=VERSION,
        rig=rig_to_yaml(small_rig()),
        metadata={"exoskeleton": "a: 1"},
        epoch_ns=17,
        next={"/a": 3},
        visit=2,
    )
    back = parse_json(type_adapter(Hello), hello.model_dump_json().encode(), "hello")
    assert rig_to_yaml(back.calibration) == hello.rig
    assert back == hello


def hello_of(**values):
    return json.dumps({"version": VERSION, **values}).encode()


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a]\nc: [*b,*b,*b,*b,*b,*b,*b,*b,*b]"


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b"\xff\xfe", "Invalid JSON"),
        (b"[" * 100_000, "Invalid JSON"),
        (b"[]", "hello: .*an object"),
        (b"{}", "hello: invalid version .*required"),
        (hello_of(version=3), "hello: invalid version 3: Input should be 2"),
        (hello_of(rig=5), "hello: invalid rig 5: .*string"),
        (hello_of(metadata={"a": 1}), r"hello: invalid metadata\.a 1"),
        (hello_of(epoch_ns="now"), "epoch_ns 'now'"),
        (hello_of(epoch_ns=10**300), "epoch_ns"),
        (hello_of(next={"/a": -1}), r"hello: invalid next\./a -1"),
        (b" " * (LARGEST_HELLO + 1), "hello of 524289 bytes: expected up to 524288"),
        (hello_of(rig="imu0: 1"), "imu0"),
        (hello_of(rig="[" * 50_000), "levels"),
        (hello_of(rig="- " * 50_000), "levels"),
        (hello_of(rig=BOMB), "aliases"),
    ],
)
def test_an_invalid_hello_is_refused_at_once(body, said):
    began = time.perf_counter()
    with pytest.raises(WireError, match=said):
        _ = parse_json(type_adapter(Hello), body, "hello").calibration
    assert time.perf_counter() - began < 2.0


IMU = Message(t_ns=0, topic="/a", typename="sensor_msgs/msg/Imu", payload=b"x")


@pytest.mark.parametrize(
    ("sample", "said"),
    [
        (arrived(IMU, attachment=None), "/a: invalid sample: expected application/cdr"),
        (arrived(IMU, attachment=b"short"), "invalid sample"),
        (arrived(IMU, encoding="zenoh/bytes"), "invalid sample"),
        (arrived(replace(IMU, topic="/" + "a" * 300)), "invalid topic"),
        (arrived(replace(IMU, topic="/a b")), "invalid topic '/a b': expected a name such as /head/imu"),
        (arrived(replace(IMU, t_ns=-1)), "stamp -1 ns"),
        (arrived(replace(IMU, t_ns=2**62)), "stamp"),
        (arrived(replace(IMU, typename="x" * 300)), "invalid type 'xxx"),
        (arrived(replace(IMU, payload=bytes(70_000))), "70000 bytes: expected up to 65536"),
        (arrived(replace(IMU, typename="sensor_msgs/msg/Image", payload=bytes(11 << 20))), "expected up to 10485760"),
    ],
)
def test_an_invalid_sample_is_refused(sample, said):
    with pytest.raises(WireError, match=said):
        read_message(sample)


@pytest.mark.parametrize("topic", ["", "/", "head/imu", "/a//b", "/a/", "/a*", "/a$", "/a?b", "/a#b", "/a\n", "/ä"])
def test_a_topic_that_is_no_key_is_not_sent(topic):
    with pytest.raises(WireError, match="invalid topic"):
        check_message(replace(IMU, topic=topic))


def test_numbers_of_samples_are_checked():
    assert parse_json(type_adapter(Counts), b'{"/a": 3}', "end") == {"/a": 3}
    many = json.dumps({f"/{i}": 1 for i in range(2000)}).encode()
    for body in (b'{"/a": -1}', b'{"/a": 1.5}', b'{"/a": 1' + b"0" * 40 + b"}", b"[1]", many):
        with pytest.raises(WireError, match="end: invalid"):
            parse_json(type_adapter(Counts), body, "end")


def claimed_size(width, height):
    """A small PNG that claims to be large."""
    data = bytearray(cv2.imencode(".png", np.zeros((4, 4), np.uint8))[1].tobytes())
    data[16:24] = struct.pack(">II", width, height)
    return bytes(data)


def compressed(data, form="png"):
    values = {"format": form, "data": np.frombuffer(data, np.uint8)}
    payload = serialise("sensor_msgs/msg/CompressedImage", values)
    return Message(t_ns=1, topic="/head/color", typename="sensor_msgs/msg/CompressedImage", payload=payload)


def of_scans(count):
    """A small progressive JPEG with a scan that says nothing many times over."""
    data = cv2.imencode(".jpg", np.zeros((64, 64), np.uint8), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1))[1].tobytes()
    at = data.index(b"\xff\xda", data.index(b"\xff\xda") + 2)  # the first may come but once
    scan = data[at : at + 2 + int.from_bytes(data[at + 2 : at + 4], "big")]
    return data[:-2] + scan * count + data[-2:]


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (compressed(of_scans(4000), "jpeg"), "invalid JPEG of 40.. scans: expected up to 100"),
        (compressed(b"\xff\xd8" + b"\xff" * 4_000_000, "jpeg"), "neither JPEG nor PNG"),
        (compressed(claimed_size(50_000, 50_000)), "50000 × 50000"),
        (compressed(bytes(12) + claimed_size(30_000, 30_000), "16UC1; compressedDepth png"), "30000"),
        (compressed(b"II*\0" + bytes(64)), "neither JPEG nor PNG"),
        (compressed(b"\xff\xd8\xff\xe0"), "neither JPEG nor PNG"),
        (compressed(b""), "neither"),
        (
            Message(
                t_ns=1,
                topic="/head/color",
                typename="sensor_msgs/msg/Image",
                payload=serialise("sensor_msgs/msg/Image", {"height": 2**31, "width": 2, "encoding": "rgb8"}),
            ),
            "2147483648",
        ),
        (Message(t_ns=1, topic="/i", typename="sensor_msgs/msg/Imu", payload=b"garbage"), "encapsulation"),
        (Message(t_ns=1, topic="/i", typename="sensor_msgs/msg/Imu", payload=b"\0\1\0\0" + b"\xff" * 400), "length of"),
        (Message(t_ns=1, topic="/i", typename="sensor_msgs/msg/Image", payload=b"\0\1\0\0" + b"\xff" * 400), "no"),
    ],
)
def test_payloads_that_lie_are_refused(message, said):
    with pytest.raises(ValueError, match=said):
        MessageDecoder(message.topic, message.typename).decode(message)


def test_sizes_of_images_are_read_without_unpacking_them():
    pixels = np.zeros((37, 53, 3), np.uint8)
    for form in (".jpg", ".png"):
        assert image_size(cv2.imencode(form, pixels)[1].tobytes()) == (53, 37)


def test_progressive_images_are_read():
    message = compressed(of_scans(20), "jpeg")
    assert MessageDecoder(message.topic, message.typename).decode(message).pixels.shape == (64, 64)


def test_images_of_endless_marks_cost_nothing():
    began = time.process_time()
    for mark in (b"\xff", b"\xff\x01", b"\xff\xe0\0\0"):
        with pytest.raises(ValueError, match="neither"):
            image_size(b"\xff\xd8" + mark * 10_000_000)
    assert time.process_time() - began < 0.5


def test_a_type_that_is_not_read_is_refused():
    with pytest.raises(ValueError, match=r"unsupported type .*: expected one of .*sensor_msgs/msg/Imu"):
        MessageDecoder("/a", "sensor_msgs/msg/PointCloud2")


def test_a_number_that_is_none_is_no_sample():
    imu = Imu(topic="/head/imu", t_ns=3, angular_rate=np.array([0, np.nan, 0]), specific_force=np.zeros(3))
    message = MessageEncoder(small_rig()).encode(imu)
    assert MessageDecoder(message.topic, message.typename).decode(message) is None


def test_addresses():
    assert parse_address("", "--to") == ("127.0.0.1", 7365)
    assert parse_address(":80", "--to") == ("127.0.0.1", 80)
    assert parse_address("robot", "--to") == ("robot", 7365)
    assert parse_address("[::1]:9", "--to") == ("::1", 9)
    for text in (
        "a:b",
        "a:70000",
        "a b:1",
        "a:1:2",
        "a?b",
        "[a]:1",
        "http://x",
        "192.168..10",
        "192.168..10:80",
        ".local",
        "a" * 64,
    ):
        with pytest.raises(Exception, match="--to: invalid address"):
            parse_address(text, "--to")
