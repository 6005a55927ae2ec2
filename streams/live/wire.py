"""Wire protocol between hardware and estimators: our ROS 2 messages in frames, after a hello with the rig.

A frame is `length u32 | kind u8 | body`, little-endian, the length being that of kind and body together:

- `HELLO` first, once: JSON `{"stridetwin": 1, "sender": ID, "rig": YAML, "metadata": {NAME: TEXT}, "epoch_ns": N}`. The
  rig is Kalibr YAML as in recordings, "" if there is none. Stamp 0 is `epoch_ns` after 1970 on the sender's system
  clock; null if unknown. A sender that reconnects with the same ID replaces its old connection.
- `SAMPLE`: `stamp i64 ns | n u8 | topic | m u8 | type name | CDR message`, the message as in a recording.
  The stamp is used if the message has no header.
- `LOST`: JSON `{TOPIC: samples}` that the sender has dropped since the last such frame.
- `END`: no more frames follow.
- `TAKEN`, from the receiver after a hello and after the end: `u64`, number of samples taken from this sender, or
  2⁶⁴ - 1 if the sender is unknown. Samples sent beyond that are lost with the connection.
- `REFUSED`, from the receiver: the reason as text; it then closes the connection.

Frames are not compressed beyond the messages and not longer than `LARGEST`. A reader allocates memory for received
bytes, not for the announced length.
"""

from __future__ import annotations

import json
import socket
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from stridetwin.streams.bounded import check_pixels
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.kalibr import rig_from_yaml, rig_to_yaml
from stridetwin.streams.recording.ros_images import IMAGES
from stridetwin.streams.rig import Rig
from stridetwin.streams.yaml_file import check_yaml

VERSION = 1
PORT = 7365
HELLO, SAMPLE, LOST, END, REFUSED, TAKEN = range(1, 7)
LARGEST = 10 << 20
"""Bytes of a frame: a depth image of 1920 × 1200 in float metres."""
LARGEST_HELLO = 1 << 18
LARGEST_SMALL = 1 << 16
"""Bytes of a message without an image."""
FRAME_S = 2.0
"""A frame must be complete this long after its beginning, s."""
LATEST_NS = 2**31 * 1_000_000_000
_HEAD = struct.Struct("<IB")
_STAMP = struct.Struct("<q")
_COUNT = struct.Struct("<Q")
_PIECE = 1 << 16
_MOST_EPOCH_NS = 2**62
_UNKNOWN = 2**64 - 1


class WireError(StrideTwinError):
    """Bytes that violate the protocol, or a refusal by the receiver."""


class StalledError(WireError):
    """A frame that is not completed: a hostile peer, or a dead connection."""


@dataclass(frozen=True, kw_only=True)
class Message:
    """One message in transit.

    Attributes:
        t_ns: Its stamp.
        topic: Name of the stream.
        typename: ROS 2 type, such as `sensor_msgs/msg/Imu`.
        payload: CDR bytes.
    """

    t_ns: int
    topic: str
    typename: str
    payload: bytes


@dataclass(frozen=True, kw_only=True)
class Hello:
    """Description of a sender.

    Attributes:
        rig: Calibration of its sensors.
        metadata: Texts as in recordings, such as the geometry of an exoskeleton.
        epoch_ns: System time at stamp 0, ns since 1970; None if unknown.
        sender: Its ID during its lifetime; "" if each connection is a new sender.
    """

    rig: Rig = field(default_factory=Rig)
    metadata: Mapping[str, str] = field(default_factory=dict)
    epoch_ns: int | None = None
    sender: str = ""


def frame(kind: int, body: bytes = b"") -> bytes:
    """A frame."""
    return _HEAD.pack(len(body) + 1, kind) + body


def hello_frame(hello: Hello) -> bytes:
    """The frame of a hello.

    Raises:
        WireError: It is longer than any receiver takes.
    """
    told = {
        "stridetwin": VERSION,
        "sender": hello.sender,
        "rig": rig_to_yaml(hello.rig),
        "metadata": dict(hello.metadata),
        "epoch_ns": hello.epoch_ns,
    }
    body = json.dumps(told).encode()
    if len(body) >= LARGEST_HELLO:
        raise WireError(f"invalid hello of {len(body)} bytes: expected less than {LARGEST_HELLO}")
    return frame(HELLO, body)


def sample_frame(message: Message) -> bytes:
    """The frame of a message.

    Raises:
        WireError: It is longer than any receiver takes.
    """
    topic, typename = message.topic.encode(), message.typename.encode()
    head = _STAMP.pack(message.t_ns) + bytes([len(topic)]) + topic + bytes([len(typename)]) + typename
    made = frame(SAMPLE, head + message.payload)
    if len(made) > LARGEST:
        raise WireError(f"{message.topic}: invalid length of {len(message.payload)} bytes: expected up to {LARGEST}")
    return made


def lost_frame(lost: Mapping[str, int]) -> bytes:
    """The frame with the number of dropped samples of each topic."""
    return frame(LOST, json.dumps(dict(lost)).encode())


def taken_frame(count: int | None) -> bytes:
    """The frame with the number of samples taken from a sender; None for a new one."""
    return frame(TAKEN, _COUNT.pack(_UNKNOWN if count is None else count))


def read_taken(body: bytes) -> int | None:
    """Number of samples taken; None if the receiver does not know us.

    Raises:
        WireError: The body is invalid.
    """
    if len(body) != _COUNT.size:
        raise WireError("taken: invalid: expected 8 bytes")
    (count,) = _COUNT.unpack(body)
    return None if count == _UNKNOWN else int(count)


def read_hello(body: bytes) -> Hello:
    """A hello from its frame's body.

    Raises:
        WireError: The body is not a hello or of another version, or its rig is invalid.
    """
    told = _json(body, "hello")
    if told.get("stridetwin") != VERSION:
        raise WireError(f"hello: invalid version {told.get('stridetwin')!r}: expected {VERSION}")
    rig, metadata, epoch = told.get("rig", ""), told.get("metadata", {}), told.get("epoch_ns")
    sender = told.get("sender", "")
    texts = isinstance(metadata, dict) and all(isinstance(v, str) for v in (rig, sender, *metadata.values()))
    if not texts or not (epoch is None or (isinstance(epoch, int) and abs(epoch) < _MOST_EPOCH_NS)):
        raise WireError(
            "hello: invalid: expected texts for sender, rig and metadata, a whole number or null for epoch_ns"
        )
    try:
        check_yaml(rig, "hello: rig", most_aliases=0)
        known = rig_from_yaml(rig, "hello: rig") if rig.strip() else Rig()
        for camera in known.cameras.values():  # an estimator allocates memory by these values
            check_pixels(camera.width, camera.height)
    except (StrideTwinError, ValueError) as error:
        raise WireError(f"{error}") from error
    return Hello(rig=known, metadata=metadata, epoch_ns=epoch, sender=sender)


def read_sample(body: bytes) -> Message:
    """A message from its frame's body.

    Raises:
        WireError: The body is invalid.
    """
    try:
        (t_ns,) = _STAMP.unpack_from(body)
        at = _STAMP.size
        names = []
        for _ in range(2):
            end = at + 1 + body[at]
            names.append(body[at + 1 : end].decode("ascii"))
            at = end
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise WireError("a sample's frame with a damaged head") from error
    topic, typename = names
    if at > len(body) or not topic.startswith("/") or not topic.isprintable() or len(topic) < 2:
        raise WireError(f"invalid topic {topic[:40]!r}: expected a name that begins with /")
    if not 0 <= t_ns < LATEST_NS:
        raise WireError(f"{topic}: invalid stamp {t_ns} ns: expected 0 to {LATEST_NS}")
    if typename not in IMAGES and len(body) - at > LARGEST_SMALL:
        raise WireError(f"{topic}: invalid {typename[:60]!r} of {len(body) - at} bytes: expected up to {LARGEST_SMALL}")
    return Message(t_ns=t_ns, topic=topic, typename=typename, payload=body[at:])


def read_lost(body: bytes) -> dict[str, int]:
    """Number of samples dropped by a sender, by topic.

    Raises:
        WireError: The body is invalid.
    """
    told = _json(body, "lost")
    if len(told) > 1000 or not all(isinstance(n, int) and 0 <= n < 2**53 for n in told.values()):
        raise WireError("lost: invalid: expected numbers of samples by topic")
    return told


def limit_of(kind: int) -> int:
    """Largest frame of a kind, bytes."""
    return {
        HELLO: LARGEST_HELLO,
        SAMPLE: LARGEST,
        LOST: LARGEST_SMALL,
        END: 1,
        REFUSED: LARGEST_SMALL,
        TAKEN: 1 + _COUNT.size,
    }.get(kind, 0)


class FrameReader:
    """Reads frames from a socket, many small ones at a time.

    Args:
        peer: Connected socket; this object sets its timeout.
    """

    def __init__(self, peer: socket.socket) -> None:
        self._peer = peer
        self._held = bytearray()

    def next(self, *wanted: int, idle_s: float | None = None) -> tuple[int, bytes] | None:
        """The next frame, kind and body; None if the peer has closed the connection between frames.

        Args:
            wanted: Accepted kinds.
            idle_s: Time within which it must begin; None waits for ever.

        Raises:
            WireError: An invalid frame, one of another kind, one too long, or one that is not completed in time.
            OSError: The connection is lost.
        """
        if not self._held:
            self._peer.settimeout(idle_s)
            try:
                self._held += self._peer.recv(_PIECE)
            except TimeoutError as error:
                if idle_s is None:  # the system's timeout: the peer does not answer any more
                    raise
                raise WireError(f"nothing came for {idle_s:g} s") from error
            if not self._held:
                return None
        until = time.monotonic() + FRAME_S
        self._fill(_HEAD.size, until)
        length, kind = _HEAD.unpack_from(self._held)
        if kind not in wanted:
            raise WireError(f"invalid frame of kind {kind}: expected {', '.join(map(str, wanted))}")
        if not 1 <= length <= limit_of(kind):
            raise WireError(f"invalid frame of kind {kind} of {length} bytes: expected 1 to {limit_of(kind)}")
        end = _HEAD.size + length - 1
        self._fill(end, until)
        body = bytes(memoryview(self._held)[_HEAD.size : end])
        del self._held[:end]
        return kind, body

    def _fill(self, count: int, until: float) -> None:
        """Reads until the buffer has at least `count` bytes."""
        while (missing := count - len(self._held)) > 0:
            left_s = until - time.monotonic()
            late = left_s <= 0
            self._peer.settimeout(max(left_s, 0.0))
            try:  # available bytes are read once even after the deadline, as the delay may be ours
                piece = self._peer.recv(missing if late else _PIECE)
            except (TimeoutError, BlockingIOError) as error:
                raise _stalled() from error
            if not piece:
                raise WireError(f"the connection ends {missing} bytes before its frame")
            self._held += piece
            if late and len(piece) < missing:
                raise _stalled()


def parse_address(text: str, flag: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT`, `HOST`, `:PORT` or `[HOST6]:PORT`.

    Raises:
        StrideTwinError: The text is not an address.
    """
    host, colon, port = text.rpartition(":") if not text.endswith("]") else (text, "", "")
    if not colon:
        host, port = text, ""
    host = host.strip("[]")
    number = int(port) if port.isdecimal() and len(port) < 6 else PORT if not port else -1
    if not 0 <= number < 65536 or not _may_be_host(host):
        raise StrideTwinError(f"{flag}: invalid {text!r}: expected HOST:PORT, such as 127.0.0.1:{PORT}")
    return host or "127.0.0.1", number


def _may_be_host(host: str) -> bool:
    try:
        host.encode("idna")  # as the socket does: rejects empty or too long parts of a name
    except UnicodeError:
        return False
    return not any(character in host for character in "/ \0")


def _stalled() -> StalledError:
    return StalledError(f"a frame that is not whole after {FRAME_S:g} s")


def _json(body: bytes, what: str) -> dict[str, Any]:
    try:
        told = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise WireError(f"{what}: no JSON") from error
    if not isinstance(told, dict):
        raise WireError(f"{what}: no JSON object")
    return told
