"""Senders and receivers over loopback: what comes through, what does not, and who is told."""

import json
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from rigs import every_small_block, small_rig
from test_wire import compressed, same, told_size

from stridetwin.streams.kalibr import rig_to_yaml
from stridetwin.streams.live.live_recorder import LiveRecorder
from stridetwin.streams.live.messages import Encoder
from stridetwin.streams.live.receiver import MOST_PEERS, Arrival, Receiver
from stridetwin.streams.live.reorder import Reorder
from stridetwin.streams.live.sender import IMAGES_HELD, SAMPLES_HELD, Sender
from stridetwin.streams.live.stored_messages import stored_messages
from stridetwin.streams.live.wire import HELLO, SAMPLE, Hello, Message, WireError, frame, hello_frame, sample_frame
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Depth, Image, Imu

LOCAL = ("127.0.0.1", 0)


def imu(i, topic="/head/imu"):
    return Imu(topic=topic, t_ns=(i + 1) * 5_000_000, angular_rate=np.full(3, 0.1 * i), specific_force=np.ones(3))


def picture(i):
    return Image(topic="/head/color", t_ns=(i + 1) * 33_000_000, pixels=np.full((24, 32, 3), i, np.uint8))


def everything(receiver, seconds=10.0):
    """All that comes until the senders are done."""
    came, until = [], time.monotonic() + seconds
    while not receiver.ended and time.monotonic() < until:
        came += receiver.take(0.05)
    return came


def take_until(receiver, came, enough, seconds=30.0):
    """Takes what comes until it is enough."""
    until = time.monotonic() + seconds
    while not enough():
        assert time.monotonic() < until
        came += receiver.take(0.05)


def test_every_kind_of_sample_comes_through_in_order():
    samples = [s for block in every_small_block() for s in block]
    with Receiver(LOCAL) as receiver:
        with Sender(small_rig(), receiver.address, metadata={"seed": "7"}, epoch_ns=0, lossless=True) as sender:
            for sample in samples:
                sender.send(sample)
        hello, *came = everything(receiver)
    assert isinstance(hello, Hello)
    assert hello.metadata == {"seed": "7"}
    assert "/head/imu" in hello.rig.imus
    assert len(came) == len(samples) == sender.sent.total()
    assert all(same(a.sample, b) for a, b in zip(came, samples))
    assert all(a.travel_ns > 0 for a in came)
    assert not sender.dropped
    assert receiver.traffic["/head/imu"].received == 57


def test_what_comes_is_recorded_byte_for_byte(recorded, tmp_path):
    recording = Recording(recorded)
    messages = list(stored_messages(recording, list(recording.topics)))
    path = tmp_path / "live.mcap"
    with LiveRecorder(path) as recorder:
        recorder.know(recording.rig, recording.metadata)
        for message in messages:
            recorder.write(message, message.t_ns)
        assert not path.exists()
    live = Recording(path)
    assert list(stored_messages(live, list(live.topics))) == messages
    assert live.metadata == recording.metadata
    assert set(live.rig.cameras) == set(recording.rig.cameras)
    assert live.unread.keys() == recording.unread.keys()  # the cameras' intrinsics, for those who read ROS
    with suppress(ZeroDivisionError), LiveRecorder(tmp_path / "half.mcap") as recorder:
        recorder.know(recording.rig, {})
        recorder.write(messages[0], messages[0].t_ns)
        raise ZeroDivisionError  # an estimator fails: what has come is kept
    assert len(list(Recording(tmp_path / "half.mcap").samples())) == 1
    with LiveRecorder(tmp_path / "none.mcap"):
        pass
    assert {p.name for p in tmp_path.iterdir()} == {"live.mcap", "half.mcap"}


def test_a_slow_receiver_is_told_how_much_it_has_missed(monkeypatch):
    monkeypatch.setattr("stridetwin.streams.live.receiver.INBOX_COUNT", 3)
    rng = np.random.default_rng(0)
    with Receiver(LOCAL) as receiver:
        with Sender(small_rig(), receiver.address, encoder=Encoder(small_rig(), jpeg_quality=None)) as sender:
            for i in range(60):  # 2 MB each: the connection's own buffers hold a few
                pixels = rng.integers(0, 256, (800, 900, 3), np.uint8)
                sender.send(Image(topic="/head/color", t_ns=i + 1, pixels=pixels))
            assert sender.dropped["/head/color"] > 20
            came = []
            take_until(receiver, came, lambda: sender.dropped.total() + len(came) > 60)
        came += everything(receiver)
    stamps = [a.sample.t_ns for a in came if isinstance(a, Arrival)]
    assert stamps == sorted(stamps)
    newest = IMAGES_HELD - 1  # the oldest go, but for the one that is on its way
    assert stamps[-newest:] == list(range(61 - newest, 61))
    assert receiver.traffic["/head/color"].lost == sender.dropped["/head/color"] == 60 - len(stamps)


def test_a_lossless_sender_waits(monkeypatch):
    monkeypatch.setattr("stridetwin.streams.live.receiver.INBOX_COUNT", 2)
    with Receiver(LOCAL) as receiver:
        with Sender(small_rig(), receiver.address, lossless=True) as sender:
            came = []
            for i in range(40):
                sender.send(picture(i))
                came += receiver.take(0.0)
            take_until(receiver, came, lambda: len(came) == 41)
        came += everything(receiver)
    assert [a.sample.t_ns for a in came[1:]] == [picture(i).t_ns for i in range(40)]
    assert not sender.dropped


def test_a_sender_comes_again_and_what_was_lost_between_is_counted():
    with Receiver(LOCAL) as receiver:
        with Sender(small_rig(), receiver.address) as sender:
            came = []
            for i in range(100):
                sender.send(imu(i))
            take_until(receiver, came, lambda: len(came) == 101)
            for peer in list(receiver._peers):  # the cable is pulled
                peer.shutdown(socket.SHUT_RDWR)
            for i in range(100, 200):
                sender.send(imu(i))
        came += everything(receiver)
    hellos = [item for item in came if isinstance(item, Hello)]
    arrived = [item for item in came if isinstance(item, Arrival)]
    assert len(hellos) == 2
    assert arrived[-1].sample.t_ns == imu(199).t_ns
    assert len(arrived) + sender.dropped.total() == 200
    assert receiver.traffic["/head/imu"].lost == sender.dropped.total()


def test_a_sender_comes_again_while_nobody_makes_room(monkeypatch):
    monkeypatch.setattr("stridetwin.streams.live.receiver.INBOX_COUNT", 3)
    monkeypatch.setattr("stridetwin.streams.live.receiver._TAKEOVER_S", 0.2)
    with Receiver(LOCAL) as receiver:
        with Sender(small_rig(), receiver.address) as sender:
            for i in range(100):
                sender.send(imu(i))
            until = time.monotonic() + 30
            while sender.sent.total() < 100 and time.monotonic() < until:
                time.sleep(0.01)
            (first,) = receiver._peers  # its thread waits for room
            first.shutdown(socket.SHUT_RDWR)
            while first in receiver._peers and time.monotonic() < until:
                time.sleep(0.01)
            assert first not in receiver._peers
            for i in range(100, 200):
                sender.send(imu(i))
            came = []
            take_until(receiver, came, lambda: any(getattr(a, "sample", imu(0)).t_ns == imu(199).t_ns for a in came))
        came += everything(receiver)
    arrived = [item for item in came if isinstance(item, Arrival)]
    assert not receiver.refusals
    assert len(arrived) == receiver.traffic["/head/imu"].received
    assert len(arrived) + sender.dropped.total() == 200
    assert receiver.traffic["/head/imu"].lost == sender.dropped.total() > 0


def test_an_old_connection_that_is_still_read_is_no_refusal(monkeypatch):
    monkeypatch.setattr("stridetwin.streams.live.receiver._TAKEOVER_S", 0.05)
    held = threading.Event()
    with Receiver(LOCAL) as receiver:
        put = receiver._put
        monkeypatch.setattr(receiver, "_put", lambda *words: (held.wait(30), put(*words)))
        with Sender(small_rig(), receiver.address, patience_s=30) as sender:
            sender.send(imu(0))
            until = time.monotonic() + 30
            while not receiver._senders and time.monotonic() < until:
                time.sleep(0.01)
            next(iter(receiver._peers)).shutdown(socket.SHUT_RDWR)
            time.sleep(0.5)
            assert not sender._failure
            held.set()
            sender.send(imu(1))
        came = everything(receiver)
    assert not receiver.refusals
    assert [a.sample.t_ns for a in came if isinstance(a, Arrival)][-1] == imu(1).t_ns


def test_a_peer_without_power_is_noticed():
    with Receiver(LOCAL) as receiver, socket.create_connection(receiver.address) as peer:
        peer.sendall(hello_frame(Hello()))
        take_until(receiver, [], lambda: receiver._senders)
        (accepted,) = receiver._peers
        assert accepted.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        if hasattr(socket, "TCP_KEEPIDLE"):
            idle, every, count = (
                accepted.getsockopt(socket.IPPROTO_TCP, getattr(socket, f"TCP_KEEP{n}"))
                for n in ("IDLE", "INTVL", "CNT")
            )
            assert idle + every * count <= 30


@pytest.mark.parametrize("lossless", [False, True])
def test_whatever_befalls_the_sender_s_thread_is_told(lossless):
    def send():
        with Sender(small_rig(), ("192.168..10", 7365), lossless=lossless) as sender:
            for i in range(SAMPLES_HELD + 1):
                sender.send(imu(i))

    with pytest.raises(WireError, match=r"192\.168\.\.10:7365: UnicodeError: .*label"):
        send()


def test_a_sender_waits_for_its_receiver_but_not_for_ever():
    with socket.create_server(LOCAL) as closed:
        address = closed.getsockname()[:2]
    with (
        pytest.raises(WireError, match="nobody takes samples at"),
        Sender(small_rig(), address, patience_s=0.3) as sender,
    ):
        sender.send(imu(0))


def raw(receiver, *parts):
    """Says bytes to a receiver and hears what it answers, until it hangs up."""
    with socket.create_connection(receiver if isinstance(receiver, tuple) else receiver.address, timeout=10) as peer:
        try:
            for part in parts:
                peer.sendall(part)
            peer.shutdown(socket.SHUT_WR)
            return b"".join(iter(lambda: peer.recv(65536), b""))
        except (ConnectionResetError, BrokenPipeError):
            return b""


def test_topics_belong_to_one_sender_and_one_type():
    message = Encoder(small_rig()).message(imu(0))
    with Receiver(LOCAL) as receiver:
        with Sender(small_rig(), receiver.address) as first:
            first.send(imu(0))
            take_until(receiver, [], lambda: "/head/imu" in receiver.traffic)
            said = raw(receiver, hello_frame(Hello()), sample_frame(message))
            assert b"another sender brings it already" in said
            other = Message(t_ns=9, topic="/head/imu", typename="sensor_msgs/msg/Range", payload=b"\0\1\0\0")
            first.send(other)
            take_until(receiver, [], lambda: first._failure != "")
            with pytest.raises(WireError, match=r"refuses: /head/imu: carried sensor_msgs/msg/Imu"):
                first.send(imu(1))
            first._failure = ""  # or leaving says it again
        assert receiver.refusals == 2


def test_a_hello_that_nobody_has_thought_of_is_refused(monkeypatch):
    rig = rig_to_yaml(small_rig())
    with Receiver(LOCAL) as receiver:
        for told, said in (
            (rig.replace("update_rate: 200.0", f"update_rate: {'9' * 400}"), b"update_rate: 9999"),
            (rig.replace("resolution: [32, 24]", f"resolution: [{'9' * 400}, 24]"), b"resolution[0]: 9999"),
            (rig.replace("resolution: [32, 24]", "resolution: [32000, 24000]"), b"32000 \xc3\x97 24000"),
            (rig.replace("update_rate: 200.0", f"update_rate: 0x{'9' * 9000}"), b"thousands of digits"),
        ):
            assert told != rig
            body = json.dumps({"stridetwin": 1, "rig": told}).encode()
            assert said in raw(receiver, frame(HELLO, body))
        monkeypatch.setattr("stridetwin.streams.live.receiver.read_hello", lambda body: 1 // 0)
        assert b"ZeroDivisionError" in raw(receiver, hello_frame(Hello()))
        assert receiver.refusals == 5


def test_stamps_that_do_not_increase_and_numbers_that_are_none_are_left_out_and_counted():
    bad = Imu(topic="/head/imu", t_ns=11_000_000, angular_rate=np.full(3, np.nan), specific_force=np.ones(3))
    with Receiver(LOCAL) as receiver:
        with Sender(small_rig(), receiver.address) as sender:
            for sample in (imu(0), imu(1), imu(1), imu(0), bad, imu(2)):
                sender.send(sample)
        came = everything(receiver)
    assert [a.sample.t_ns for a in came[1:]] == [5_000_000, 10_000_000, 15_000_000]
    traffic = receiver.traffic["/head/imu"]
    assert (traffic.received, traffic.not_increasing, traffic.not_finite) == (3, 2, 1)


def arrival(sample, since_ms=0):
    message = Encoder(small_rig()).message(sample)
    return Arrival(sample=sample, message=message, since_ns=since_ms * 1_000_000, travel_ns=None)


def test_streams_are_put_in_order_within_the_window():
    reorder = Reorder(0.010)

    def ready(now_ms):
        return [a.sample.t_ns // 1_000_000 for a in reorder.ready(now_ms * 1_000_000)]

    reorder.add(arrival(imu(0)))
    assert ready(0) == [5]  # nothing else is known yet
    reorder.add(arrival(imu(1, "/foot_l/imu")))
    reorder.add(arrival(imu(2, "/foot_l/imu")))
    assert ready(0) == []  # the other stream may still bring something older
    reorder.add(arrival(imu(1)))
    assert ready(0) == [10, 10]
    reorder.add(arrival(imu(4)))
    assert ready(0) == [15]  # a stream is a window beyond it
    assert ready(9) == []
    assert reorder.due_s(9_000_000) == pytest.approx(0.001)
    assert ready(10) == [25]  # it has waited for a window
    reorder.add(arrival(imu(3, "/foot_l/imu")))
    assert ready(10) == [20]
    assert reorder.late == {"/foot_l/imu": 1}
    depth = Depth(topic="/head/depth", t_ns=imu(9).t_ns, depth=np.zeros((24, 32), np.float32))
    reorder.add(arrival(depth))
    reorder.add(arrival(imu(9)))
    assert [type(a.sample) for a in reorder.rest()] == [Imu, Depth]


SERVER = """
import sys
from stridetwin.streams.live.receiver import Receiver
with Receiver(("127.0.0.1", 0)) as receiver:
    print(receiver.address[1], flush=True)
    while not receiver.ended:
        receiver.take(0.1)
    print(receiver.traffic["/head/imu"].received, receiver.refusals, flush=True)
"""


def peak_mib(process):
    status = Path(f"/proc/{process.pid}/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


def attacks():
    """What a hostile peer says."""
    hello = hello_frame(Hello(rig=small_rig()))
    rng = np.random.default_rng(0)
    bomb = sample_frame(compressed(told_size(60_000, 60_000)))
    huge = Message(
        t_ns=1, topic="/a", typename="sensor_msgs/msg/JointState", payload=b"\0\1\0\0" + b"\xff\xff\xff\x7f" * 9000
    )
    names = Message(  # sixteen thousand empty names
        t_ns=1, topic="/b", typename="sensor_msgs/msg/JointState",
        payload=b"\0\1\0\0" + bytes(12) + struct.pack("<I", 15_000) + struct.pack("<I", 0) * 15_000,
    )  # fmt: skip
    yield from (
        [b""],
        [rng.bytes(1000)],
        [rng.bytes(20_000_000)],
        [struct.pack("<IB", 10**9, 1)],
        [struct.pack("<IB", 2**32 - 1, 2) + bytes(10_000_000)],
        [hello, struct.pack("<IB", 10**9, SAMPLE)],
        [hello, frame(SAMPLE, rng.bytes(100_000))],
        [hello, bomb],
        [hello, sample_frame(huge)],
        [hello, sample_frame(names)],
        [hello, hello],
        [hello_frame(Hello())[:-5]],
        [hello, *[frame(SAMPLE, bytes(8) + b"\2/%c\1x" % (97 + i)) for i in range(20)]],
    )


def test_a_hostile_peer_is_refused_soon_and_costs_little():
    """Within 2 s and 500 MiB, while an honest sender goes on."""
    server = subprocess.Popen([sys.executable, "-c", SERVER], stdout=subprocess.PIPE, text=True)
    try:
        address = ("127.0.0.1", int(server.stdout.readline()))
        with Sender(small_rig(), address) as sender:
            for i, words in enumerate(attacks()):
                sender.send(imu(i))
                began = time.perf_counter()
                raw(address, *words)
                assert time.perf_counter() - began < 2.5, i
            crowd = [socket.create_connection(address) for _ in range(3 * MOST_PEERS)]
            for peer in crowd[: MOST_PEERS - 1]:  # each announces much and says little
                peer.sendall(struct.pack("<IB", 200_000, 1) + b"{")
            began = time.perf_counter()
            for peer in crowd:
                peer.settimeout(10)
                try:
                    while peer.recv(65536):
                        pass
                except ConnectionResetError:
                    pass
                peer.close()
            assert time.perf_counter() - began < 4.0
            sender.send(imu(100))
            peak = peak_mib(server)
        received, refusals = map(int, server.stdout.readline().split())
        assert peak < 500
        assert received == i + 2
        assert refusals >= 10 + 2 * MOST_PEERS
    finally:
        server.kill()
        server.wait()
