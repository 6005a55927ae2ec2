"""Frames and messages, byte by byte."""

import errno
import socket
import struct
import threading
import time

import cv2
import numpy as np
import pytest
from rigs import every_small_block, small_rig

from stridetwin.streams.bounded import image_size
from stridetwin.streams.kalibr import rig_to_yaml
from stridetwin.streams.live.messages import Decoder, Encoder
from stridetwin.streams.live.stored_messages import stored_messages
from stridetwin.streams.live.wire import (
    END,
    HELLO,
    LARGEST,
    SAMPLE,
    FrameReader,
    Hello,
    Message,
    WireError,
    frame,
    hello_frame,
    parse_address,
    read_hello,
    read_lost,
    read_sample,
    sample_frame,
)
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.recording.ros_types import serialise, typestore
from stridetwin.streams.samples import Depth, Image, Imu, Odometry

HEAD = 5


def same(a, b):
    """Whether two samples say the same."""
    close = np.allclose if type(a) is Odometry else np.array_equal  # whose velocity is turned there and back
    equal = all(close(getattr(a, n), getattr(b, n)) for n in type(a).__slots__)
    return type(a) is type(b) and a.t_ns == b.t_ns and equal


def test_what_is_sent_is_what_a_recording_holds_and_says_the_same(recorded):
    recording = Recording(recorded)
    encoder, decoders = Encoder(recording.rig), {}
    samples = {(s.topic, s.t_ns): s for s in recording.samples()}
    count = 0
    for message in stored_messages(recording, list(recording.topics)):
        body = sample_frame(message)[HEAD:]
        assert read_sample(body) == message
        decoder = decoders.setdefault(message.topic, Decoder(message.topic, message.typename))
        sample = samples.pop((message.topic, message.t_ns))
        assert same(decoder.sample(message), sample)
        if not isinstance(sample, Image | Odometry):  # a JPEG of a JPEG is another one; a turned velocity has rounded
            assert encoder.message(sample).payload == message.payload, message.topic
        count += 1
    assert not samples
    assert count == sum(t.count for t in recording.topics.values())


def test_messages_come_in_order_imus_first_and_pictures_last(recorded):
    recording = Recording(recorded)
    kinds = {Imu: 0, Image: 2, Depth: 2}
    keys = [
        (m.t_ns, kinds.get(recording.topics[m.topic].kind, 1), m.topic)
        for m in stored_messages(recording, list(recording.topics))
    ]
    assert keys == sorted(keys)


def test_pictures_can_travel_with_every_pixel():
    pixels = np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8)
    depth = np.random.default_rng(1).uniform(0.2, 5, (24, 32)).astype(np.float32)
    encoder = Encoder(small_rig(), depth_encoding="32FC1", jpeg_quality=None)
    for sample in (
        Image(topic="/head/color", t_ns=5, pixels=pixels),
        Image(topic="/foot_l/camera", t_ns=6, pixels=pixels[..., 0]),
        Depth(topic="/head/depth", t_ns=7, depth=depth),
    ):
        message = encoder.message(sample)
        assert same(Decoder(message.topic, message.typename).sample(message), sample)


def test_a_payload_is_the_ros_message_that_rosbags_reads():
    block = next(b for b in every_small_block() if b.kind is Imu)
    sample = next(iter(block))
    message = read_sample(sample_frame(Encoder(small_rig()).message(sample))[HEAD:])
    told = typestore().deserialize_cdr(message.payload, message.typename)
    assert message.typename == "sensor_msgs/msg/Imu"
    assert (told.header.stamp.sec * 10**9 + told.header.stamp.nanosec, told.header.frame_id) == (
        sample.t_ns,
        "head/imu",
    )
    assert [told.angular_velocity.x, told.angular_velocity.y, told.angular_velocity.z] == sample.angular_rate.tolist()
    force = told.linear_acceleration
    assert [force.x, force.y, force.z] == sample.specific_force.tolist()


def test_a_hello_brings_rig_texts_and_clock():
    hello = Hello(rig=small_rig(), metadata={"exoskeleton": "a: 1"}, epoch_ns=17, sender="me")
    back = read_hello(hello_frame(hello)[HEAD:])
    assert rig_to_yaml(back.rig) == rig_to_yaml(hello.rig)
    assert (back.metadata, back.epoch_ns, back.sender) == ({"exoskeleton": "a: 1"}, 17, "me")


def yaml_of(text):
    return ('{"stridetwin": 1, "rig": ' + repr(text).replace("'", '"') + "}").encode()


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a]\\nc: [*b,*b,*b,*b,*b,*b,*b,*b,*b]"


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b"\xff\xfe", "no JSON"),
        (b"[" * 100_000, "no JSON"),
        (b"[]", "no JSON object"),
        (b"{}", "invalid version None: expected 1"),
        (b'{"stridetwin": 2}', "version 2"),
        (b'{"stridetwin": 1, "rig": 5}', "texts"),
        (b'{"stridetwin": 1, "epoch_ns": "now"}', "epoch_ns"),
        (b'{"stridetwin": 1, "epoch_ns": 1' + b"0" * 300 + b"}", "epoch_ns"),
        (yaml_of("imu0: 1"), "imu0"),
        (yaml_of("[" * 50_000), "levels"),
        (yaml_of("- " * 50_000), "levels"),
        ((b'{"stridetwin": 1, "rig": "' + BOMB.encode() + b'"}'), "aliases"),
    ],
)
def test_a_hello_that_is_none_is_refused_at_once(body, said):
    began = time.perf_counter()
    with pytest.raises(WireError, match=said):
        read_hello(body)
    assert time.perf_counter() - began < 2.0


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b"", "damaged head"),
        (bytes(8) + b"\x09/a", "damaged head"),
        (bytes(8) + b"\x01/\x01x", "topic '/'"),
        (bytes(8) + b"\x04/a\n/\x01x", "topic"),
        (struct.pack("<q", -1) + b"\x02/a\x01x", "stamp -1 ns"),
        (struct.pack("<q", 2**62) + b"\x02/a\x01x", "stamp"),
        (bytes(8) + b"\x02/a\x16sensor_msgs/msg/Imu123" + bytes(70_000), "70000 bytes"),
    ],
)
def test_a_sample_that_is_none_is_refused(body, said):
    with pytest.raises(WireError, match=said):
        read_sample(body)


def test_counts_of_what_was_lost_are_checked():
    assert read_lost(b'{"/a": 3}') == {"/a": 3}
    for body in (b'{"/a": -1}', b'{"/a": 1.5}', b'{"/a": 1' + b"0" * 40 + b"}", b"[1]"):
        with pytest.raises(WireError):
            read_lost(body)


def told_size(width, height):
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
        (compressed(told_size(50_000, 50_000)), "50000 × 50000"),
        (compressed(bytes(12) + told_size(30_000, 30_000), "16UC1; compressedDepth png"), "30000"),
        (compressed(b"II*\0" + bytes(64)), "neither JPEG nor PNG"),
        (compressed(b"\xff\xd8\xff\xe0"), "neither JPEG nor PNG"),
        (compressed(b""), "neither"),
        (
            Message(
                t_ns=1, topic="/head/color", typename="sensor_msgs/msg/Image",
                payload=serialise("sensor_msgs/msg/Image", {"height": 2**31, "width": 2, "encoding": "rgb8"}),
            ),
            "2147483648",
        ),
        (Message(t_ns=1, topic="/i", typename="sensor_msgs/msg/Imu", payload=b"garbage"), "encapsulation"),
        (Message(t_ns=1, topic="/i", typename="sensor_msgs/msg/Imu", payload=b"\0\1\0\0" + b"\xff" * 400), "length of"),
        (Message(t_ns=1, topic="/i", typename="sensor_msgs/msg/Image", payload=b"\0\1\0\0" + b"\xff" * 400), "no"),
    ],
)  # fmt: skip
def test_payloads_that_lie_are_refused(message, said):
    with pytest.raises(ValueError, match=said):
        Decoder(message.topic, message.typename).sample(message)


def test_sizes_of_pictures_are_read_without_unpacking_them():
    pixels = np.zeros((37, 53, 3), np.uint8)
    for form in (".jpg", ".png"):
        assert image_size(cv2.imencode(form, pixels)[1].tobytes()) == (53, 37)


def test_progressive_pictures_are_read():
    message = compressed(of_scans(20), "jpeg")
    assert Decoder(message.topic, message.typename).sample(message).pixels.shape == (64, 64)


def test_pictures_of_endless_marks_cost_nothing():
    began = time.process_time()
    for mark in (b"\xff", b"\xff\x01", b"\xff\xe0\0\0"):
        with pytest.raises(ValueError, match="neither"):
            image_size(b"\xff\xd8" + mark * 10_000_000)
    assert time.process_time() - began < 0.5


def test_a_type_that_is_not_read_is_refused():
    with pytest.raises(ValueError, match=r"is not read: expected .*sensor_msgs/msg/Imu"):
        Decoder("/a", "sensor_msgs/msg/PointCloud2")


def test_a_number_that_is_none_is_no_sample():
    imu = Imu(topic="/head/imu", t_ns=3, angular_rate=np.array([0, np.nan, 0]), specific_force=np.zeros(3))
    message = Encoder(small_rig()).message(imu)
    assert Decoder(message.topic, message.typename).sample(message) is None


@pytest.fixture
def ends():
    a, b = socket.socketpair()
    with a, b:
        yield a, b


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        (struct.pack("<IB", 10**9, SAMPLE), "1000000000 bytes"),
        (struct.pack("<IB", LARGEST + 1, SAMPLE), " bytes: expected"),
        (struct.pack("<IB", 0, SAMPLE), "0 bytes"),
        (frame(99), "kind 99"),
        (frame(HELLO), "kind 1"),
        (b"GET / HTTP/1.1\r\n\r\n", "kind 47"),
        (struct.pack("<IB", 100, SAMPLE) + b"half", "95 bytes before its frame"),
        (b"\1\0", "3 bytes before its frame"),
    ],
)
def test_bytes_that_are_no_frame_are_refused(ends, sent, said):
    a, b = ends
    a.sendall(sent)
    a.shutdown(socket.SHUT_WR)
    with pytest.raises(WireError, match=said):
        FrameReader(b).next(SAMPLE, END)


def test_half_a_frame_is_not_waited_for(ends, monkeypatch):
    monkeypatch.setattr("stridetwin.streams.live.wire.FRAME_S", 0.1)
    a, b = ends
    a.sendall(struct.pack("<IB", 100, SAMPLE) + b"half")
    began = time.perf_counter()
    with pytest.raises(WireError, match="not whole after"):
        FrameReader(b).next(SAMPLE)
    assert time.perf_counter() - began < 1.5
    with pytest.raises(WireError, match="nothing came"):
        FrameReader(b).next(SAMPLE, idle_s=0.05)


def test_a_frame_that_drips_is_given_up_at_its_time(ends, monkeypatch):
    monkeypatch.setattr("stridetwin.streams.live.wire.FRAME_S", 0.2)
    a, b = ends
    a.sendall(struct.pack("<IB", 1000, SAMPLE))
    enough = threading.Event()

    def drip():
        while not enough.wait(0.002):
            a.sendall(b"x")

    dripping = threading.Thread(target=drip)
    dripping.start()
    began = time.perf_counter()
    try:
        with pytest.raises(WireError, match="not whole after"):
            FrameReader(b).next(SAMPLE)
        assert time.perf_counter() - began < 0.4
    finally:
        enough.set()
        dripping.join()


def test_what_is_there_is_taken_after_the_time(ends, monkeypatch):
    monkeypatch.setattr("stridetwin.streams.live.wire.FRAME_S", -1.0)  # it is we who were late
    a, b = ends
    a.sendall(frame(SAMPLE, bytes(100_000)))
    assert FrameReader(b).next(SAMPLE) == (SAMPLE, bytes(100_000))


def test_a_peer_that_is_gone_is_a_lost_connection():
    class Gone:
        def settimeout(self, seconds):
            pass

        def recv(self, size):
            raise TimeoutError(errno.ETIMEDOUT, "Connection timed out")

    with pytest.raises(TimeoutError):
        FrameReader(Gone()).next(SAMPLE)


def test_addresses():
    assert parse_address("", "--to") == ("127.0.0.1", 7365)
    assert parse_address(":80", "--to") == ("127.0.0.1", 80)
    assert parse_address("robot", "--to") == ("robot", 7365)
    assert parse_address("[::1]:9", "--to") == ("::1", 9)
    for text in ("a:b", "a:70000", "a b:1", "http://x", "192.168..10", "192.168..10:80", ".local", "a" * 64):
        with pytest.raises(Exception, match=r"--to: invalid .*"):
            parse_address(text, "--to")
