"""The estimators' end of the bridge: listens, checks messages, and passes them on in the order of arrival.

One thread per connection reads and decodes into one bounded inbox. When that is full the connection is not read, so
that a sender notices that it is too fast, and drops and counts messages on its side.
"""

from __future__ import annotations

import socket
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.live.messages import Decoder
from stridetwin.streams.live.wire import (
    END,
    FRAME_S,
    HELLO,
    LATEST_NS,
    LOST,
    REFUSED,
    SAMPLE,
    FrameReader,
    Hello,
    Message,
    StalledError,
    WireError,
    frame,
    read_hello,
    read_lost,
    read_sample,
    taken_frame,
)
from stridetwin.streams.recording.ros_types import typestore
from stridetwin.streams.samples import Depth, Image, Sample

MOST_PEERS, MOST_TOPICS = 8, 64
INBOX_BYTES, INBOX_COUNT = 64 << 20, 4096
"""Limits of the inbox; an image counts with its decoded pixels."""
_REFUSALS_KEPT = 100
_SENDERS_KNOWN = 1000
_TAKEOVER_S = 5.0
"""How long a reconnecting sender waits for its old connection to be read out, and again for it to be closed."""
_ALIVE = {"TCP_KEEPIDLE": 10, "TCP_KEEPALIVE": 10, "TCP_KEEPINTVL": 5, "TCP_KEEPCNT": 3}
"""Seconds of silence before the system probes a peer (two names for it), seconds between probes, and the number of
unanswered probes."""
_LINGER_S, _LINGER_BYTES = 0.3, 1 << 22


@dataclass(frozen=True, kw_only=True, eq=False)
class Arrival:
    """A received sample.

    Attributes:
        sample: The decoded sample.
        message: As received.
        since_ns: When its last byte arrived, `time.perf_counter_ns()`.
        travel_ns: From its stamp until then; None if the sender's clock is unknown.
    """

    sample: Sample
    message: Message
    since_ns: int
    travel_ns: int | None


@dataclass(kw_only=True, eq=False)
class _Connection:
    """A sender's connection.

    Attributes:
        peer: Its socket.
        done: Set when its thread has finished.
        superseded: Whether the sender has reconnected and this connection is no longer read.
    """

    peer: socket.socket
    done: threading.Event = field(default_factory=threading.Event)
    superseded: bool = False


@dataclass(kw_only=True)
class Traffic:
    """Counts of one topic.

    Attributes:
        received: Samples that were passed on.
        not_finite: Samples rejected for a number that is not finite.
        not_increasing: Samples rejected for a stamp that is not after the previous one.
        lost: Samples dropped by the senders.
    """

    received: int = 0
    not_finite: int = 0
    not_increasing: int = 0
    lost: int = 0


class Receiver:
    """Listens for senders; a context manager.

    Args:
        address: Host and port to listen at; port 0 takes a free one.

    Attributes:
        address: Where it listens.
        traffic: By topic.
        refused: The first hundred refused peers, with reasons.
        refusals: Number of refusals.

    Raises:
        StrideTwinError: The address cannot be listened at.
    """

    def __init__(self, address: tuple[str, int]) -> None:
        try:
            family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
            self._listener = socket.create_server(address, family=family, backlog=MOST_PEERS)
        except (OSError, UnicodeError) as error:
            words = getattr(error, "strerror", None) or error
            raise StrideTwinError(f"cannot listen at {address[0]}:{address[1]}: {words}") from error
        typestore()  # slow: done here so that the first sample does not wait
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        self.traffic: dict[str, Traffic] = {}
        self.refused: list[str] = []
        self.refusals = 0
        self._inbox: deque[tuple[Arrival | Hello, int]] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._peers: set[socket.socket] = set()
        self._owner: dict[str, str] = {}
        self._senders: dict[str, _Connection] = {}
        self._taken: dict[str, int] = {}
        self._decoders: dict[str, Decoder] = {}
        self._last_ns: dict[str, int] = {}
        self._ended = self._closed = False

    def __enter__(self) -> Self:
        threading.Thread(target=self._accept, name="listener", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._changed:
            self._closed = True
            peers = list(self._peers)
            self._changed.notify_all()
        self._listener.close()
        for peer in peers:
            _hang_up(peer)

    def take(self, timeout_s: float) -> list[Arrival | Hello]:
        """New samples and hellos in the order of arrival; waits for them up to `timeout_s`."""
        with self._changed:
            if not self._inbox and not self.ended:
                self._changed.wait(timeout_s)
            items = [item for item, _ in self._inbox]
            self._inbox.clear()
            self._bytes = 0
            self._changed.notify_all()
        return items

    @property
    def ended(self) -> bool:
        """Whether a sender has ended, no sender is connected and the inbox is empty."""
        return self._ended and not self._peers and not self._inbox

    def _accept(self) -> None:
        while True:
            try:
                peer, where = self._listener.accept()
            except OSError:
                return
            name = f"{where[0]}:{where[1]}"
            with self._changed:
                crowded = len(self._peers) >= MOST_PEERS
                if not crowded:
                    self._peers.add(peer)
            if crowded:
                self._refuse(peer, name, f"{MOST_PEERS} senders are there already", linger=False)
                peer.close()
            else:
                threading.Thread(target=self._serve, args=(peer, name), name=name, daemon=True).start()

    def _serve(self, peer: socket.socket, name: str) -> None:
        try:
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            _keep_alive(peer)
            self._listen_to(peer, name)
        except StalledError as error:  # a regular sender reconnects
            self._note(name, str(error))
        except (WireError, ValueError) as error:
            self._refuse(peer, name, str(error))
        except OSError:
            pass  # it may reconnect
        except Exception as error:  # unexpected bytes
            self._refuse(peer, name, f"{type(error).__name__}: {error}")
        finally:
            with self._changed:
                self._peers.discard(peer)
                for sender, own in list(self._senders.items()):
                    if own.peer is peer:
                        del self._senders[sender]
                        own.done.set()
                self._owner = {t: s for t, s in self._owner.items() if s in self._senders}
                self._changed.notify_all()
            _hang_up(peer)
            peer.close()

    def _listen_to(self, peer: socket.socket, name: str) -> None:
        frames = FrameReader(peer)
        first = frames.next(HELLO, idle_s=FRAME_S)
        if first is None:
            return
        hello = read_hello(first[1])
        sender = hello.sender or name
        own = self._begin(sender, peer)
        self._put(hello, 0, own)
        while (got := frames.next(SAMPLE, LOST, END)) is not None:
            since_ns, system_ns = time.perf_counter_ns(), time.time_ns()
            kind, body = got
            if kind == END:
                self._ended = True
                peer.sendall(taken_frame(self._taken[sender]))
                return
            if kind == LOST:
                for topic, count in read_lost(body).items():
                    self._of(topic).lost += count
                continue
            message = read_sample(body)
            sample = self._decoder(sender, message).sample(message)
            traffic = self._of(message.topic)
            if sample is None:
                traffic.not_finite += 1
            elif not 0 <= sample.t_ns < LATEST_NS:
                raise WireError(f"{message.topic}: invalid stamp {sample.t_ns} ns: expected 0 to {LATEST_NS}")
            elif sample.t_ns <= self._last_ns.get(message.topic, -1):
                traffic.not_increasing += 1
            else:
                travel_ns = None if hello.epoch_ns is None else system_ns - hello.epoch_ns - sample.t_ns
                size = len(message.payload)
                if isinstance(sample, Image | Depth):
                    size += (sample.pixels if isinstance(sample, Image) else sample.depth).nbytes
                arrival = Arrival(sample=sample, message=message, since_ns=since_ns, travel_ns=travel_ns)
                self._put(arrival, size, own)
                self._last_ns[message.topic] = sample.t_ns
                traffic.received += 1
            self._taken[sender] += 1

    def _begin(self, sender: str, peer: socket.socket) -> _Connection:
        """Accepts a new sender, or a reconnecting one: it may notice a lost connection before we do.

        The rest of the old connection is read first, unless the inbox stays full.

        Raises:
            ConnectionError: The old connection is still being read; the sender may try again.
        """
        own = _Connection(peer=peer)
        with self._changed:
            before = self._senders.get(sender)
        if before is not None:
            _hang_up(before.peer)
            if not before.done.wait(_TAKEOVER_S):
                with self._changed:
                    before.superseded = True
                    self._changed.notify_all()
                before.done.wait(_TAKEOVER_S)
        with self._changed:
            if sender in self._senders:
                raise ConnectionError("another connection of this sender is still being read")
            self._senders[sender] = own
            count = self._taken.pop(sender, None)
            while len(self._taken) >= _SENDERS_KNOWN:
                del self._taken[next(s for s in self._taken)]
            self._taken[sender] = count or 0
        peer.sendall(taken_frame(count))
        return own

    def _of(self, topic: str) -> Traffic:
        with self._changed:
            if topic not in self.traffic and len(self.traffic) >= MOST_PEERS * MOST_TOPICS:
                raise WireError("too many topics")
            return self.traffic.setdefault(topic, Traffic())

    def _decoder(self, sender: str, message: Message) -> Decoder:
        """The topic's decoder; a topic belongs to its first sender as long as that is connected."""
        topic = message.topic
        if self._owner.get(topic) != sender:
            with self._changed:
                if self._owner.setdefault(topic, sender) != sender:
                    raise WireError(f"{topic}: another sender brings it already")
                if sum(s == sender for s in self._owner.values()) > MOST_TOPICS:
                    raise WireError(f"more than {MOST_TOPICS} topics")
        known = self._decoders.get(topic)
        if known is None or known.typename != message.typename:
            if known is not None:
                raise WireError(f"{topic}: invalid {message.typename[:60]}: expected {known.typename}, as before")
            self._of(topic)
            self._decoders[topic] = known = Decoder(topic, message.typename)
        return known

    def _put(self, item: Arrival | Hello, size: int, own: _Connection) -> None:
        """Puts an item of a connection into the inbox; waits for space.

        Raises:
            ConnectionError: The sender has reconnected meanwhile; the item is not taken.
        """
        with self._changed:
            while (self._bytes + size > INBOX_BYTES or len(self._inbox) >= INBOX_COUNT) and self._inbox:
                if self._closed:
                    return
                if own.superseded:
                    raise ConnectionError("this sender has another connection")
                self._changed.wait()
            self._inbox.append((item, size))
            self._bytes += size
            self._changed.notify_all()

    def _note(self, name: str, words: str) -> None:
        with self._changed:
            self.refusals += 1
            if len(self.refused) < _REFUSALS_KEPT:
                self.refused.append(f"{name}: {words}")

    def _refuse(self, peer: socket.socket, name: str, words: str, *, linger: bool = True) -> None:
        """Sends the reason to a sender, and waits briefly until it is read: data in flight would discard it."""
        self._note(name, words)
        try:
            peer.settimeout(_LINGER_S)
            peer.sendall(frame(REFUSED, words.encode()[:4096]))
            peer.shutdown(socket.SHUT_WR)
            until, left = time.monotonic() + _LINGER_S, _LINGER_BYTES
            while linger and left > 0 and time.monotonic() < until and (piece := peer.recv(1 << 16)):
                left -= len(piece)
        except OSError:
            pass


def _keep_alive(peer: socket.socket) -> None:
    """Lets the system end a connection whose peer has vanished, for example after a power loss."""
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in _ALIVE.items():
        if hasattr(socket, name):
            peer.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def _hang_up(peer: socket.socket) -> None:
    """Closes a connection, which wakes every thread that waits on it."""
    with suppress(OSError):
        peer.shutdown(socket.SHUT_RDWR)
