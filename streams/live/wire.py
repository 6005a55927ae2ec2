"""Protocol between hardware and estimators: ROS 2 messages over Zenoh, after a hello with the rig.

The receiver listens at one TCP endpoint, senders connect to it, and discovery is off. `ID` is a sender's Zenoh ID:

- `stridetwin/receiver/RID`: liveliness token of a receiver. A sender greets each one that appears.
- `stridetwin/ID/hello`: query of a sender with a `Hello` in JSON. The reply is JSON `{TOPIC: samples received from this
  sender}`, or an error with the reason of a refusal.
- `stridetwin/ID/samples/TOPIC`: the message as in a recording (CDR), with the encoding `application/cdr;TYPE` and the
  attachment `stamp i64 ns | number u64`, little-endian. The stamp is used if the message has no header. Numbers count
  the samples of a topic, also those that the sender drops, so that each gap is a number of lost samples.
- `stridetwin/ID/end`: query after the last sample, JSON `{TOPIC: number of the next one}`; reply as above.
- `stridetwin/ID/refused`: from the receiver: the reason why it takes nothing more from this sender.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from stridetwin.streams.bounded_images import check_pixels
from stridetwin.streams.errors import StrideTwinError, explain_import_error
from stridetwin.streams.kalibr import rig_from_yaml
from stridetwin.streams.recording.mcap_contents import Message
from stridetwin.streams.recording.ros_images import IMAGES
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import LATEST_NS
from stridetwin.streams.yaml_file import check_yaml

if TYPE_CHECKING:
    import zenoh

VERSION: Literal[2] = 2
"""Version of the protocol."""
PORT = 7365
"""Port of a receiver, unless another one is given."""
LARGEST = 10 << 20
"""Bytes of a message: a depth image of 1920 × 1200 in float metres."""
LARGEST_HELLO = 1 << 19
"""Bytes of a hello; half of it is for rig and metadata, the rest for numbers by topic."""
LARGEST_SMALL = 1 << 16
"""Bytes of a message without an image."""
_TOPIC = re.compile(r"(/[^/*$?#\s]+)+")
"""A valid topic: names, each after a slash, without the characters that mean something in Zenoh's keys."""
_ROOT, _CDR = "stridetwin", "application/cdr;"
"""First part of every key, and the beginning of the encoding of a message, which its ROS 2 type follows."""
_MARK = struct.Struct("<qQ")
"""Attachment of a message: its stamp in ns, and its number among those of its topic."""
_ANSWER_S = 60.0
"""How long a query waits for its answer."""
# Zenoh's settings: connections to one address alone, and limits for what a peer may send
_CONFIG: Mapping[str, object] = {
    "mode": "peer",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,
    "connect/timeout_ms": -1,
    "connect/exit_on_failure": False,  # a sender may start before its receiver
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
    "transport/unicast/max_sessions": 32,
    "transport/unicast/open_timeout": 2000,  # ms, of a peer that says nothing
    "transport/unicast/accept_timeout": 2000,
    "transport/link/rx/max_message_size": LARGEST + LARGEST_SMALL,
    "transport/link/tx/lease": 60_000,  # ms, as an estimator that compiles takes nothing for so long
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 60_000_000,  # µs, as above
    "transport/shared_memory/enabled": False,
}

Counts = Annotated[
    dict[Annotated[str, Field(max_length=255)], Annotated[int, Field(ge=0, lt=2**53)]], Field(max_length=1000)
]
"""Numbers of samples by topic."""

T = TypeVar("T")


class WireError(StrideTwinError):
    """Data that violate the protocol, a refusal by the receiver, or a receiver that is absent."""


class Hello(BaseModel):
    """Description of a sender.

    Attributes:
        version: Version of the protocol.
        rig: Calibration of its sensors as Kalibr YAML; "" if there is none.
        metadata: Texts as in recordings, such as the geometry of an exoskeleton.
        epoch_ns: System time at stamp 0, ns since 1970; None if unknown.
        next: Number of the first sample for this receiver, by topic; 0 for topics that it lacks.
    """

    model_config = ConfigDict(strict=True, frozen=True)

    version: Literal[2]
    rig: str = ""
    metadata: dict[str, str] = {}
    epoch_ns: Annotated[int, Field(gt=-(2**62), lt=2**62)] | None = None
    next: Counts = {}

    @cached_property
    def calibration(self) -> Rig:
        """The rig, parsed.

        Raises:
            WireError: It is invalid.
        """
        try:
            check_yaml(self.rig, "hello: rig", most_aliases=0)  # by aliases, a short text unpacks to a large one
            rig = rig_from_yaml(self.rig, "hello: rig") if self.rig.strip() else Rig()
            for camera in rig.cameras.values():  # an estimator allocates memory by these values
                check_pixels(camera.width, camera.height)
        except (StrideTwinError, ValueError) as error:
            raise WireError(str(error)) from error
        return rig


def parse_json(adapter: TypeAdapter[T], body: bytes, what: str) -> T:
    """Parses the JSON body of a query.

    Args:
        adapter: Of `Hello` or `Counts`.
        body: The bytes.
        what: Name of the query in errors.

    Returns:
        The value, of the adapter's type.

    Raises:
        WireError: The body is too long or no such value; names the first invalid field.
    """
    if len(body) > LARGEST_HELLO:
        raise WireError(f"invalid {what} of {len(body)} bytes: expected up to {LARGEST_HELLO}")
    try:
        return adapter.validate_json(body)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        # cut off, as an untrusted sender determines their length
        place, value = ".".join(map(str, first["loc"]))[:60], repr(first["input"])[:40]
        # without a place, as when the whole body is invalid, two blanks would follow each other
        raise WireError(f"{what}: invalid {place} {value}: {first['msg']}".replace("  ", " ")) from error


def check_message(message: Message) -> None:
    """Checks topic, stamp, type and size of a message before it is sent or decoded.

    Raises:
        WireError: One of them is invalid.
    """
    topic, typename, size = message.topic, message.typename, len(message.payload)
    if len(topic) > 255 or not (topic.isascii() and topic.isprintable() and _TOPIC.fullmatch(topic)):
        raise WireError(f"invalid topic {topic[:40]!r}: expected a name such as /head/imu")
    if not 0 <= message.t_ns < LATEST_NS:
        raise WireError(f"{topic}: invalid stamp {message.t_ns} ns: expected 0 to {LATEST_NS}")
    if len(typename) > 200:
        raise WireError(f"{topic}: invalid type {typename[:60]!r}: expected a name such as sensor_msgs/msg/Imu")
    if size > (limit := LARGEST if typename in IMAGES else LARGEST_SMALL):
        raise WireError(f"{topic}: invalid {typename[:60]!r} of {size} bytes: expected up to {limit}")


def read_message(sample: zenoh.Sample) -> tuple[Message, int]:
    """Reads the message in a Zenoh sample, and its number among those of its topic.

    Raises:
        WireError: The sample has another form, or the message is invalid.
    """
    topic = "/" + str(sample.key_expr).split("/", 3)[3]  # of a key `stridetwin/ID/samples/TOPIC`
    mark, encoding = bytes(sample.attachment or b""), str(sample.encoding)  # `mark`: stamp and number, packed
    if len(mark) != _MARK.size or not encoding.startswith(_CDR):
        raise WireError(f"{topic[:40]}: invalid sample: expected {_CDR}TYPE with stamp and number")
    t_ns, number = _MARK.unpack(mark)
    payload, typename = sample.payload.to_bytes(), encoding.removeprefix(_CDR)
    message = Message(t_ns=t_ns, topic=topic, typename=typename, payload=payload)
    check_message(message)
    return message, number


class ZenohLink:
    """A Zenoh session whose only connections are those of one address.

    Callbacks run in the thread that reads the connection: in order, and while one waits, the other end waits, too.

    Args:
        listen: Host and port to listen at.
        connect: Host and port to connect to, again and again.

    Attributes:
        name: Its Zenoh ID.

    Raises:
        StrideTwinError: The address cannot be listened at, or Zenoh is not installed.
    """

    def __init__(self, *, listen: tuple[str, int] | None = None, connect: tuple[str, int] | None = None) -> None:
        """Opens a session that listens at one address or connects to one; only one of the two is given."""
        with explain_import_error("live and send need it", "live"):
            import zenoh
        self._zenoh, config = zenoh, zenoh.Config()  # the module is kept, as it may not be installed
        endpoints = {"listen/endpoints": _endpoints(listen), "connect/endpoints": _endpoints(connect)}
        for key, value in {**_CONFIG, **endpoints}.items():
            config.insert_json5(key, json.dumps(value))
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            # of Zenoh's text only the system's reason, without the places in its Rust code
            text = str(error)
            reason = re.split(r" \(os error| at /", text.partition("[")[2] or text)[0].rpartition(": ")[2]
            host, port = listen or connect or ("", 0)
            raise StrideTwinError(f"cannot listen at {host}:{port}: {reason}") from error
        self.name = str(self._session.zid())
        self._tokens: list[zenoh.LivelinessToken] = []  # kept, as a token ends when it is garbage collected

    def close(self) -> None:
        """Closes all connections."""
        self._session.close()

    def send(self, message: Message, number: int) -> None:
        """Sends a message; waits while the connection is busy. Without a connection, it is lost.

        Args:
            message: The message.
            number: Its number among the messages of its topic, by which the receiver finds gaps.
        """
        self._session.put(
            f"{_ROOT}/{self.name}/samples{message.topic}",
            message.payload,
            encoding=_CDR + message.typename,
            attachment=_MARK.pack(message.t_ns, number),
            congestion_control=self._zenoh.CongestionControl.BLOCK,
        )

    def publish_text(self, key: str, text: str) -> None:
        """Publishes a text under a key, without waiting for an answer."""
        self._session.put(f"{_ROOT}/{key}", text)

    def subscribe(self, key: str, act: Callable[[str, zenoh.Sample], None]) -> None:
        """Calls `act` with the sender's ID and the sample for each sample from now on whose key matches.

        Args:
            key: The key without its first part `stridetwin/`; it may have wildcards.
            act: Function of the ID, which the sample's key contains, and of the sample.
        """
        handler = self._to_callback(lambda sample: act(_sender_id(sample.key_expr), sample))
        self._session.declare_subscriber(f"{_ROOT}/{key}", handler)

    def on_disconnect(self, act: Callable[[str], None]) -> None:
        """Calls `act` with the Zenoh ID of each peer whose connection ends."""
        put = self._zenoh.SampleKind.PUT  # the event of a new connection
        handler = self._to_callback(lambda event: None if event.kind == put else act(str(event.transport.zid)))
        self._session.info.declare_transport_events_listener(handler)

    def declare_presence(self, key: str) -> None:
        """Shows a liveliness token under a key as long as this session is open."""
        self._tokens.append(self._session.liveliness().declare_token(f"{_ROOT}/{key}"))

    def watch_presence(self, key: str, act: Callable[[str, bool], None]) -> None:
        """Calls `act` with the key of each liveliness token that appears (true) or disappears (false).

        Args:
            key: The key without its first part `stridetwin/`, which may have wildcards; tokens that are there already
                count as well.
            act: Function of a token's key without `stridetwin/`, and of whether the token has appeared.
        """
        put = self._zenoh.SampleKind.PUT  # the event of a token that appears
        handler = self._to_callback(lambda s: act(str(s.key_expr).removeprefix(f"{_ROOT}/"), s.kind == put))
        self._session.liveliness().declare_subscriber(f"{_ROOT}/{key}", handler, history=True)

    def answer_queries(self, key: str, act: Callable[[str, bytes], tuple[str, bool]]) -> None:
        """Answers all queries of a key from now on.

        Args:
            key: The key, which may have wildcards.
            act: Function of the ID of the sender that asks and the body of its query. It returns a text, and whether
                that is a reply (true) or an error (false).
        """

        def reply(query: zenoh.Query) -> None:
            """Answers one query by what `act` returns: with a reply if it succeeded, else with an error."""
            body = query.payload.to_bytes() if query.payload is not None else b""
            answer, has_succeeded = act(_sender_id(query.key_expr), body)
            with query:  # at its end the asking side gets to know that no further reply follows
                if has_succeeded:
                    query.reply(query.key_expr, answer)
                else:
                    query.reply_err(answer)

        self._session.declare_queryable(f"{_ROOT}/{key}", self._to_callback(reply))

    def query(self, key: str, body: str) -> bytes | None:
        """Sends a query, and waits up to a minute for the answer.

        Args:
            key: The key without its first part `stridetwin/`.
            body: The text of the query.

        Returns:
            The answer; None without one, as when the connection was lost.

        Raises:
            WireError: The receiver refuses; the message is its reason.
        """
        for reply in self._session.get(f"{_ROOT}/{key}", payload=body, timeout=_ANSWER_S):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
            if reply.err is not None and (reason := reply.err.payload.to_string()) != "Timeout":
                raise WireError(reason)
        return None

    def _to_callback(self, act: Callable[[Any], None]) -> Any:
        """A Zenoh handler that calls `act` in Zenoh's own thread, so that a slow function slows the other end down."""
        return self._zenoh.handlers.Callback(act, indirect=False)


def _endpoints(address: tuple[str, int] | None) -> list[str]:
    """Zenoh's name of a TCP address, in a list; empty for None."""
    if address is None:
        return []
    host, port = address
    return [f"tcp/[{host}]:{port}" if ":" in host else f"tcp/{host}:{port}"]


def _sender_id(key: zenoh.KeyExpr) -> str:
    """The sender's ID in a key `stridetwin/ID/...`."""
    return str(key).split("/")[1]


def parse_address(text: str, flag: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT`, `HOST`, `:PORT` or `[HOST6]:PORT`; by default 127.0.0.1 and `PORT`.

    Args:
        text: The address.
        flag: Name of the command line's option, for errors.

    Raises:
        StrideTwinError: The text is not an address.
    """
    # an IPv6 address in brackets, or a name or IPv4 address; and a port of up to five digits, which may be missing
    match = re.fullmatch(r"(\[[0-9a-fA-F.]*:[0-9a-fA-F:.]*\]|[^][:/ \0?#]*)(?::(\d{0,5}))?", text)
    host, port = (match[1].strip("[]"), int(match[2] or PORT)) if match else ("", -1)  # port -1: no address
    try:
        host.encode("idna")  # rejects empty or too long parts of a name
    except UnicodeError:
        port = -1
    if not 0 <= port < 65536:
        raise StrideTwinError(f"{flag}: invalid address {text!r}: expected HOST:PORT, such as 127.0.0.1:{PORT}")
    return host or "127.0.0.1", port
