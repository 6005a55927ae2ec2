"""Senders and receivers over loopback: what comes through, what does not, and who learns of it."""

import json
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from rigs import every_small_block, small_rig
from test_wire import claimed_size, compressed, same

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.kalibr import rig_to_yaml
from stridetwin.streams.live.messages import LiveRecorder, Message, MessageEncoder, to_messages
from stridetwin.streams.live.receiver import MOST_SENDERS, Arrival, Receiver, Reorder
from stridetwin.streams.live.sender import IMAGES_HELD, SAMPLES_HELD, Sender
from stridetwin.streams.live.wire import LARGEST, VERSION, Hello, WireError, ZenohLink
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Depth, Image, Imu

LOCAL = ("127.0.0.1", 0)


def imu(i, topic="/head/imu"):
    return Imu(topic=topic, t_ns=(i + 1) * 5_000_000, angular_rate=np.full(3, 0.1 * i), specific_force=np.ones(3))


def image(i):
    return Image(topic="/head/color", t_ns=(i + 1) * 33_000_000, pixels=np.full((24, 32, 3), i, np.uint8))


def everything(receiver, seconds=10.0):
    """All that comes until the senders are done."""
    came, until = [], time.monotonic() + seconds
    while not receiver.ended and time.monotonic() < until:
        came += receiver.receive(0.05)
    return came


def take_until(receiver, came, enough, seconds=30.0):
    """Takes what comes until it is enough."""
    until = time.monotonic() + seconds
    while not enough():
        assert time.monotonic() < until
        came += receiver.receive(0.05)


def test_every_kind_of_sample_comes_through_in_order():
    samples = [s for block in every_small_block() for s in block]
    with Receiver(LOCAL) as receiver:
        with Sender(small_rig(), receiver.address, metadata={"seed": "7"}, epoch_ns=0, lossless=True) as sender:
            for sample in samples:
                sender.send(sample)
        hello, *came = everything(receiver)
    assert isinstance(hello, Hello)
    assert hello.metadata == {"seed": "7"}
    assert "/head/imu" in hello.calibration.imus
    assert len(came) == len(samples) == sender.sent.total()
    assert all(same(a.sample, b) for a, b in zip(came, samples))
    assert all(a.travel_ns > 0 for a in came)
    assert not sender.dropped
    assert receiver.traffic["/head/imu"].received == 57


def test_what_comes_is_recorded_byte_for_byte(recorded, tmp_path):
    recording = Recording(recorded)
    messages = list(to_messages(recording, list(recording.topics)))
    path = tmp_path / "live.mcap"
    with LiveRecorder(path) as recorder:
        recorder.set_rig(recording.rig, recording.metadata)
        for message in messages:
            recorder.write(message, message.t_ns)
        assert not path.exists()
    live = Recording(path)
    assert list(to_messages(live, list(live.topics))) == messages
    assert live.metadata == recording.metadata
    assert set(live.rig.cameras) == set(recording.rig.cameras)
    assert live.unread.keys() == recording.unread.keys()  # the cameras' intrinsics, for those who read ROS
    with suppress(ZeroDivisionError), LiveRecorder(tmp_path / "half.mcap") as recorder:
        recorder.set_rig(recording.rig, {})
        recorder.write(messages[0], messages[0].t_ns)
        raise ZeroDivisionError  # an estimator fails: what has come is kept
    assert len(list(Recording(tmp_path / "half.mcap").samples())) == 1
    with LiveRecorder(tmp_path / "none.mcap"):
        pass
    assert {p.name for p in tmp_path.iterdir()} == {"live.mcap", "half.mcap"}


def test_a_slow_receiver_counts_what_it_has_missed(monkeypatch):
    monkeypatch.setattr("stridetwin.streams.live.receiver.INBOX_COUNT", 3)
    rng = np.random.default_rng(0)
    with Receiver(LOCAL) as receiver:
        with Sender(small_rig(), receiver.address, encoder=MessageEncoder(small_rig(), jpeg_quality=None)) as sender:
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
                sender.send(image(i))
                came += receiver.receive(0.0)
            take_until(receiver, came, lambda: len(came) == 41)
        came += everything(receiver)
    assert [a.sample.t_ns for a in came[1:]] == [image(i).t_ns for i in range(40)]
    assert not sender.dropped


class Cable:
    """Passes on what a sender and a receiver say to each other, until it is pulled; then it is plugged in again."""

    def __init__(self, address):
        self._there, self._ends, self.count = address, [], 0
        self._server = socket.create_server(LOCAL)
        self.address = self._server.getsockname()[:2]
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._server.close()
        self._hang_up()

    def _accept(self):
        with suppress(OSError):
            while True:
                here = self._server.accept()[0]
                there = socket.create_connection(self._there)
                self._ends += [here, there]
                self.count += 1
                for pair in ((here, there), (there, here)):
                    threading.Thread(target=self._pass_on, args=pair, daemon=True).start()

    def _pass_on(self, one, other):
        with suppress(OSError):
            while words := one.recv(1 << 16):
                other.sendall(words)
        for end in (one, other):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def pull(self):
        """Waits until the sender has noticed it: what it says before is lost."""
        before, until = self.count, time.monotonic() + 30
        self._hang_up()
        while self.count == before:
            assert time.monotonic() < until
            time.sleep(0.01)

    def _hang_up(self):
        ends, self._ends = self._ends, []
        for end in ends:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


def test_a_sender_comes_again_and_what_was_lost_between_is_counted():
    with Receiver(LOCAL) as receiver, Cable(receiver.address) as cable:
        with Sender(small_rig(), cable.address) as sender:
            came = []
            for i in range(100):
                sender.send(imu(i))
            take_until(receiver, came, lambda: len(came) == 101)
            cable.pull()
            for i in range(100, 200):
                sender.send(imu(i))
        came += everything(receiver)
    hellos = [item for item in came if isinstance(item, Hello)]
    arrived = [item for item in came if isinstance(item, Arrival)]
    assert len(hellos) == 2
    assert arrived[-1].sample.t_ns == imu(199).t_ns
    assert sender.sent.total() == len(arrived)
    assert len(arrived) + sender.dropped.total() == 200
    assert receiver.traffic["/head/imu"].lost == sender.dropped.total()


def test_a_sender_comes_again_while_nobody_makes_room(monkeypatch):
    monkeypatch.setattr("stridetwin.streams.live.receiver.INBOX_COUNT", 3)
    with Receiver(LOCAL) as receiver, Cable(receiver.address) as cable:
        with Sender(small_rig(), cable.address) as sender:
            for i in range(100):
                sender.send(imu(i))
            until = time.monotonic() + 30
            while sender.sent.total() < 100 and time.monotonic() < until:
                time.sleep(0.01)
            cable.pull()  # a thread of the receiver still waits for room
            for i in range(100, 200):
                sender.send(imu(i))
            came = []
            take_until(receiver, came, lambda: any(getattr(a, "sample", imu(0)).t_ns == imu(199).t_ns for a in came))
        came += everything(receiver)
    arrived = [item for item in came if isinstance(item, Arrival)]
    stamps = [a.sample.t_ns for a in arrived]
    assert stamps == sorted(stamps)
    assert not receiver.refusals
    assert len(arrived) == receiver.traffic["/head/imu"].received == sender.sent.total()
    assert len(arrived) + sender.dropped.total() == 200
    assert receiver.traffic["/head/imu"].lost == sender.dropped.total()


def test_a_receiver_that_starts_later_is_greeted_and_counts_what_it_has_missed():
    def taken(receiver, count):
        came = []
        take_until(receiver, came, lambda: len(came) == count)
        return came

    with ExitStack() as stack:
        first = Receiver(LOCAL)
        with Sender(small_rig(), first.address, metadata={"seed": "7"}, patience_s=30) as sender:
            for i in range(SAMPLES_HELD + 10):  # before anybody listens
                sender.send(imu(i))
            with first:
                hello, *came = taken(first, SAMPLES_HELD + 1)
            assert came[0].sample.t_ns == imu(10).t_ns
            assert first.traffic["/head/imu"].lost == 10
            until = time.monotonic() + 30
            while sender._receiver and time.monotonic() < until:
                time.sleep(0.01)
            for i in range(SAMPLES_HELD + 10, SAMPLES_HELD + 20):
                sender.send(imu(i))
            second = stack.enter_context(Receiver(first.address))
            again, *came = taken(second, 11)
        assert again.metadata == hello.metadata == {"seed": "7"}
        assert len(came) == 10
        assert second.traffic["/head/imu"].lost == 0
        assert sender.dropped.total() == 10


def test_a_sender_that_starts_first_connects_later():
    with socket.create_server(LOCAL) as free:
        address = free.getsockname()[:2]
    with ExitStack() as stack:
        with Sender(small_rig(), address, patience_s=30) as sender:
            sender.send(imu(0))
            time.sleep(0.5)  # nobody listens
            receiver, came = stack.enter_context(Receiver(address)), []
            take_until(receiver, came, lambda: len(came) == 2)
            sender.send(imu(1))
        came += everything(receiver)
    assert [a.sample.t_ns for a in came[1:]] == [imu(0).t_ns, imu(1).t_ns]


@pytest.mark.parametrize("lossless", [False, True])
def test_an_address_without_a_machine_is_reported(lossless):
    def send():
        with Sender(small_rig(), ("nowhere.invalid", 7365), lossless=lossless, patience_s=0.3) as sender:
            for i in range(SAMPLES_HELD + 1):
                sender.send(imu(i))

    with pytest.raises(WireError, match=r"no `stridetwin live` of this version listens at nowhere\.invalid:7365"):
        send()


def test_whatever_fails_in_the_sender_s_thread_is_reported(monkeypatch):
    monkeypatch.setattr(Sender, "_deliver", lambda *_: 1 // 0)
    with (
        Receiver(LOCAL) as receiver,
        pytest.raises(WireError, match="ZeroDivisionError"),
        Sender(small_rig(), receiver.address) as sender,
    ):
        sender.send(imu(0))


def test_a_sender_waits_for_its_receiver_but_not_for_ever():
    with socket.create_server(LOCAL) as mute:
        address = mute.getsockname()[:2]
        with (
            pytest.raises(WireError, match=f"no `stridetwin live` of this version listens at 127.0.0.1:{address[1]}"),
            Sender(small_rig(), address, patience_s=0.3) as sender,
        ):
            sender.send(imu(0))


def test_an_address_that_is_taken_is_reported():
    with Receiver(LOCAL) as receiver, pytest.raises(StrideTwinError, match=r"cannot listen at .*: Address already in"):
        Receiver(receiver.address)


def test_zenoh_that_is_missing_is_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "zenoh", None)
    with pytest.raises(StrideTwinError, match=r"zenoh is not installed; .*: pip install '\.\[live\]'"):
        Receiver(LOCAL)
    with pytest.raises(WireError, match="zenoh is not installed"), Sender(small_rig(), ("127.0.0.1", 1)):
        pass


def test_only_the_given_address_is_listened_at_and_connected_to():
    with Receiver(LOCAL) as receiver, linked(receiver.address) as link:
        there, here = (one._session.info.links() for one in (receiver._link, link))
        assert [end.src for end in there] == [f"tcp/127.0.0.1:{receiver.address[1]}"] == [end.dst for end in here]
        assert link._session.info.routers_zid() == []


@contextmanager
def linked(address):
    """A peer that speaks Zenoh and is no sender of ours."""
    link = ZenohLink(connect=address)
    present = threading.Event()
    link.watch_presence("receiver/*", lambda *_: present.set())
    assert present.wait(10)
    try:
        yield link
    finally:
        link.close()


def refusal(link, receiver, *messages, hello=None):
    """Why a peer is refused that says hello and sends messages."""
    heard = []
    link.subscribe(f"{link.name}/refused", lambda _, sample: heard.append(sample.payload.to_string()))
    try:
        link.query(f"{link.name}/hello", hello or Hello(version=VERSION).model_dump_json())
        for number, message in enumerate(messages):
            link.send(message, number)
        link.query(f"{link.name}/end", "{}")
    except WireError as error:
        return str(error)
    return "".join(heard)


def test_topics_belong_to_one_sender_and_one_type():
    message = MessageEncoder(small_rig()).encode(imu(0))
    with Receiver(LOCAL) as receiver:
        with Sender(small_rig(), receiver.address) as first:
            first.send(imu(0))
            take_until(receiver, [], lambda: "/head/imu" in receiver.traffic)
            with linked(receiver.address) as second:
                assert refusal(second, receiver, message) == "/head/imu: another sender provides it already"
            other = Message(t_ns=9, topic="/head/imu", typename="sensor_msgs/msg/Range", payload=b"\0\1\0\0")
            first.send(other)
            take_until(receiver, [], lambda: first._failure != "")
            with pytest.raises(WireError, match=r"refuses: /head/imu: .*expected sensor_msgs/msg/Imu"):
                first.send(imu(1))
            first._failure = ""  # or leaving says it again
        assert receiver.refusals == 2


def test_a_ninth_sender_is_refused():
    with Receiver(LOCAL) as receiver, ExitStack() as stack:
        for i in range(MOST_SENDERS):
            sender = stack.enter_context(Sender(small_rig(), receiver.address))
            sender.send(imu(0, f"/imu{i}"))
        take_until(receiver, [], lambda: len(receiver.traffic) == MOST_SENDERS)
        with linked(receiver.address) as ninth:
            assert refusal(ninth, receiver) == "8 senders are there already"
        with pytest.raises(WireError, match="refuses: 8 senders"), Sender(small_rig(), receiver.address):
            pass


def test_an_unforeseen_hello_is_refused(monkeypatch):
    rig = rig_to_yaml(small_rig())
    with Receiver(LOCAL) as receiver, linked(receiver.address) as link:
        for values, said in (
            ({"rig": rig.replace("update_rate: 200.0", f"update_rate: {'9' * 400}")}, "update_rate: invalid 9999"),
            (
                {"rig": rig.replace("resolution: [32, 24]", f"resolution: [{'9' * 400}, 24]")},
                "resolution[0]: invalid 9999",
            ),
            ({"rig": rig.replace("resolution: [32, 24]", "resolution: [32000, 24000]")}, "32000 × 24000"),
            ({"rig": rig.replace("update_rate: 200.0", f"update_rate: 0x{'9' * 9000}")}, "thousands of digits"),
            ({"version": 1}, "hello: invalid version 1: Input should be 2"),
        ):
            assert values != {"rig": rig}
            body = json.dumps({"version": VERSION, **values})
            assert said in refusal(link, receiver, hello=body)
        monkeypatch.setattr("stridetwin.streams.live.receiver.parse_json", lambda *_: 1 // 0)
        assert "ZeroDivisionError" in refusal(link, receiver)
        assert receiver.refusals == 6


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
    message = MessageEncoder(small_rig()).encode(sample)
    return Arrival(sample=sample, message=message, since_ns=since_ms * 1_000_000, travel_ns=None)


def test_streams_are_put_in_order_within_the_window():
    reorder = Reorder(0.010)

    def ready(now_ms):
        return [a.sample.t_ns // 1_000_000 for a in reorder.release_due(now_ms * 1_000_000)]

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
    assert reorder.compute_wait_s(9_000_000) == pytest.approx(0.001)
    assert ready(10) == [25]  # it has waited for a window
    reorder.add(arrival(imu(3, "/foot_l/imu")))
    assert ready(10) == [20]
    assert reorder.late == {"/foot_l/imu": 1}
    depth = Depth(topic="/head/depth", t_ns=imu(9).t_ns, depth=np.zeros((24, 32), np.float32))
    reorder.add(arrival(depth))
    reorder.add(arrival(imu(9)))
    assert [type(a.sample) for a in reorder.flush()] == [Imu, Depth]


SERVER = """
import sys
from stridetwin.streams.live.receiver import Receiver
with Receiver(("127.0.0.1", 0)) as receiver:
    print(receiver.address[1], flush=True)
    while not receiver.ended:
        receiver.receive(0.1)
    print(receiver.traffic["/head/imu"].received, receiver.refusals, flush=True)
"""


def peak_mib(process):
    status = Path(f"/proc/{process.pid}/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


def raw(address, words):
    """Says bytes to a receiver, until it hangs up."""
    with socket.create_connection(address, timeout=10) as peer, suppress(OSError):
        peer.sendall(words)
        peer.shutdown(socket.SHUT_WR)
        while peer.recv(65536):
            pass


def bytes_that_are_no_zenoh():
    rng = np.random.default_rng(0)
    yield from (
        b"",
        b"GET / HTTP/1.1\r\n\r\n",
        rng.bytes(1000),
        rng.bytes(20_000_000),
        struct.pack("<H", 65_000) + b"half",
    )


def hostile_messages():
    """What a peer sends that speaks Zenoh."""
    rng = np.random.default_rng(0)

    def message(payload, typename="sensor_msgs/msg/JointState", topic="/a"):
        return Message(t_ns=1, topic=topic, typename=typename, payload=payload)

    yield from (
        message(rng.bytes(1000)),
        message(rng.bytes(1000), "sensor_msgs/msg/CompressedImage"),
        message(bytes(LARGEST - 1), "sensor_msgs/msg/Image"),
        message(bytes(100_000)),
        message(b"", "x" * 200),
        compressed(claimed_size(60_000, 60_000)),
        message(b"\0\1\0\0" + b"\xff\xff\xff\x7f" * 9000),
        message(b"\0\1\0\0" + bytes(12) + struct.pack("<I", 15_000) + struct.pack("<I", 0) * 15_000, topic="/b"),
    )


def test_a_hostile_peer_is_refused_soon_and_costs_little():
    """Within 2 s and 500 MiB, while an honest sender goes on."""
    server = subprocess.Popen([sys.executable, "-c", SERVER], stdout=subprocess.PIPE, text=True)
    try:
        address = ("127.0.0.1", int(server.stdout.readline()))
        with Sender(small_rig(), address) as sender:
            for i, words in enumerate(bytes_that_are_no_zenoh()):
                sender.send(imu(i))
                began = time.perf_counter()
                raw(address, words)
                assert time.perf_counter() - began < 4.0, i
            for message in hostile_messages():
                i += 1
                sender.send(imu(i))
                began = time.perf_counter()
                with linked(address) as link:
                    assert refusal(link, None, message) != "", message.typename
                assert time.perf_counter() - began < 4.0, i
            with linked(address) as link:  # longer than any message
                link.query(f"{link.name}/hello", Hello(version=VERSION).model_dump_json())
                link.send(Message(t_ns=1, topic="/c", typename="sensor_msgs/msg/Image", payload=bytes(200 << 20)), 0)
            sender.send(imu(i + 1))
            peak = peak_mib(server)
        received, refusals = map(int, server.stdout.readline().split())
        assert peak < 500
        assert received == i + 2
        assert refusals >= len(list(hostile_messages()))
    finally:
        server.kill()
        server.wait()
