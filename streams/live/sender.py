"""The hardware's end of the bridge: sends samples at once; drops and counts those that the receiver cannot take."""

from __future__ import annotations

import secrets
import select
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from types import TracebackType
from typing import Self

from stridetwin.streams.live.messages import Encoder
from stridetwin.streams.live.wire import (
    END,
    REFUSED,
    TAKEN,
    FrameReader,
    Hello,
    Message,
    WireError,
    frame,
    hello_frame,
    lost_frame,
    read_taken,
    sample_frame,
)
from stridetwin.streams.recording.ros_images import IMAGES
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Sample

IMAGES_HELD, SAMPLES_HELD = 8, 2048
"""Most queued messages of a topic while a receiver is slow or disconnected; then the oldest is dropped."""
_RETRY_S = 0.2
_CONNECT_S = 2.0
_STALLED_S = 60.0
_REMEMBERED = 65536


class Sender:
    """Sends samples to a receiver in its own thread; a context manager.

    `send` never waits, unless `lossless`: messages that a slow receiver does not take wait in one queue per topic,
    whose oldest message is dropped when it is full; the number is reported to the receiver. A lost connection is
    restored as long as there is something to send. Leaving the context sends the queued messages and the end.

    Args:
        rig: Calibration of the sensors.
        address: Host and port.
        metadata: See `Hello`.
        epoch_ns: System time at stamp 0; 0 for stamps that are system time (`time.time_ns()`), None if unknown.
        encoder: Conversion of samples to messages; by default as in recordings.
        lossless: `send` waits while a queue is full.
        patience_s: How long a receiver may be disconnected before leaving gives up, and initially before `send` does.

    Attributes:
        sent: Messages sent, by topic.
        dropped: Messages dropped, by topic.
    """

    def __init__(
        self,
        rig: Rig,
        address: tuple[str, int],
        *,
        metadata: Mapping[str, str] | None = None,
        epoch_ns: int | None = None,
        encoder: Encoder | None = None,
        lossless: bool = False,
        patience_s: float = 10.0,
    ) -> None:
        self._address, self._lossless, self._patience_s = address, lossless, patience_s
        hello = Hello(rig=rig, metadata=metadata or {}, epoch_ns=epoch_ns, sender=secrets.token_hex(8))
        self._hello = hello_frame(hello)
        self._encoder = encoder or Encoder(rig)
        self.sent: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        self._untold: Counter[str] = Counter()
        self._queues: dict[str, deque[tuple[int, bytes]]] = {}
        self._number, self._flying = 0, -1
        self._changed = threading.Condition()
        self._ending, self._failure = False, ""
        self._peer: socket.socket | None = None
        self._answers: FrameReader | None = None
        self._out: deque[str] = deque(maxlen=_REMEMBERED)
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._changed:
            self._ending = True
            if error is not None:
                self._queues.clear()
            self._changed.notify_all()
        self._thread.join()
        if error is None:
            self._check()

    def send(self, item: Sample | Message) -> None:
        """Sends a sample, or an existing message unchanged.

        Raises:
            WireError: The receiver has refused us, or was never reachable; or the message is too long.
        """
        message = item if isinstance(item, Message) else self._encoder.message(item)
        ready = sample_frame(message)
        most = IMAGES_HELD if message.typename in IMAGES else SAMPLES_HELD
        with self._changed:
            queue = self._queues.setdefault(message.topic, deque())
            while self._lossless and len(queue) >= most and not self._failure:
                self._changed.wait()
            self._check()
            if len(queue) >= most:
                del queue[1 if queue[0][0] == self._flying else 0]
                self.dropped[message.topic] += 1
                self._untold[message.topic] += 1
            queue.append((self._number, ready))
            self._number += 1
            self._changed.notify_all()

    def _check(self) -> None:
        if self._failure:
            raise WireError(self._failure)

    def _run(self) -> None:
        try:
            self._serve()
        except WireError as error:
            self._fail(str(error))
        except Exception as error:  # `send` must fail with it instead of waiting for ever
            self._fail(f"{self._address[0]}:{self._address[1]}: {type(error).__name__}: {error}")
        finally:
            if self._peer is not None:
                self._peer.close()

    def _serve(self) -> None:
        host, port = self._address
        away_since, last = time.monotonic(), ""
        while True:
            try:
                if self._peer is None:
                    self._peer = self._connected()
                if self._deliver(self._peer):
                    return
                away_since = time.monotonic()
            except OSError as error:
                told = "" if self._peer is None else self._refusal()
                if told:
                    raise WireError(f"{host}:{port} refuses: {told}") from error
                if self._peer is not None:
                    self._peer.close()
                    away_since = time.monotonic()
                self._peer, last = None, str(error.strerror or error)
                with self._changed:
                    gives_up = self._ending or not self.sent
                    if gives_up and time.monotonic() - away_since > self._patience_s:
                        raise WireError(f"nobody takes samples at {host}:{port}: {last}") from error
                    self._changed.wait(_RETRY_S)

    def _connected(self) -> socket.socket:
        peer = socket.create_connection(self._address, timeout=_CONNECT_S)
        peer.settimeout(_STALLED_S)
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer.sendall(self._hello)
        self._answers = FrameReader(peer)
        self._count()
        return peer

    def _count(self) -> None:
        """Receives the number of messages taken; those sent after them are lost."""
        assert self._answers is not None
        told = self._answers.next(TAKEN, REFUSED, idle_s=_STALLED_S)
        if told is None:
            raise ConnectionResetError("the receiver hangs up")
        if told[0] == REFUSED:
            raise WireError(f"{self._address[0]}:{self._address[1]} refuses: {told[1].decode(errors='replace')}")
        taken = read_taken(told[1])
        with self._changed:
            missing = 0 if taken is None else self.sent.total() - taken
            for _ in range(min(missing, len(self._out))):
                topic = self._out.pop()
                self.sent[topic] -= 1
                self.dropped[topic] += 1
                self._untold[topic] += 1

    def _deliver(self, peer: socket.socket) -> bool:
        """Sends the next message; returns whether all are sent."""
        with self._changed:
            while not (waiting := [t for t, q in self._queues.items() if q]) and not self._ending:
                self._changed.wait(_RETRY_S)
                if _is_readable(peer):
                    raise ConnectionResetError("the receiver hangs up")
            lost = dict(self._untold)
            topic = min(waiting, key=lambda t: self._queues[t][0]) if waiting else ""
            self._flying, ready = self._queues[topic][0] if topic else (-1, b"")
        if _is_readable(peer):
            raise ConnectionResetError("the receiver hangs up")
        if lost:
            peer.sendall(lost_frame(lost))
            with self._changed:
                self._untold.subtract(lost)
                self._untold = +self._untold
        if not topic:
            peer.sendall(frame(END))
            peer.shutdown(socket.SHUT_WR)
            self._count()
            return True
        peer.sendall(ready)
        with self._changed:
            if topic in self._queues:  # else the user's code has failed meanwhile
                self._queues[topic].popleft()
            self._flying = -1
            self.sent[topic] += 1
            self._out.append(topic)
            self._changed.notify_all()
        return False

    def _refusal(self) -> str:
        """The receiver's reason for closing the connection, "" if it gives none."""
        try:
            told = self._answers.next(REFUSED, idle_s=_STALLED_S) if self._answers else None
        except (OSError, WireError):
            return ""
        return told[1].decode(errors="replace") if told else ""

    def _fail(self, words: str) -> None:
        with self._changed:
            self._failure = words
            self._changed.notify_all()


def _is_readable(peer: socket.socket) -> bool:
    return bool(select.select([peer], [], [], 0)[0])
