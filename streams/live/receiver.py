"""The estimators' end of the bridge: listens, checks messages, and passes them on in the order of arrival or of stamps.

Zenoh's threads decode into one bounded inbox. When that is full they wait, so that connections are not read and a
sender notices that it is too fast: it drops messages, and the gaps in their numbers are counted here.
"""

from __future__ import annotations

import heapq
import json
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import TracebackType
from typing import TYPE_CHECKING, Self

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.live.messages import MessageDecoder, rank_of
from stridetwin.streams.live.wire import Counts, Hello, WireError, ZenohLink, parse_json, read_message
from stridetwin.streams.recording.mcap_contents import Message
from stridetwin.streams.recording.ros_types import typestore
from stridetwin.streams.samples import LATEST_NS, Depth, Image, Sample
from stridetwin.streams.validation import type_adapter

if TYPE_CHECKING:
    import zenoh

MOST_SENDERS, MOST_TOPICS = 8, 64
"""Most senders that are connected at once, and most topics of each."""
INBOX_BYTES, INBOX_COUNT = 64 << 20, 4096
"""Limits of the inbox; an image counts with its decoded pixels."""
_REFUSALS_KEPT = 100
"""Most refusals whose reasons are kept."""
_SENDERS_KNOWN = 1000
"""Most senders that are gone whose counts are remembered, for when they come back."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Arrival:
    """A received sample.

    Attributes:
        sample: The decoded sample.
        message: As received.
        since_ns: When it arrived, `time.perf_counter_ns()`.
        travel_ns: From its stamp until then; None if the sender's clock is unknown.
    """

    sample: Sample
    message: Message
    since_ns: int
    travel_ns: int | None


@dataclass(kw_only=True)
class Traffic:
    """Counts of one topic.

    Attributes:
        received: Samples that were passed on.
        not_finite: Samples rejected for a number that is not finite.
        not_increasing: Samples rejected for a stamp that is not after the previous one.
        lost: Samples that a sender had and that did not arrive.
    """

    received: int = 0
    not_finite: int = 0
    not_increasing: int = 0
    lost: int = 0


@dataclass(kw_only=True, eq=False)
class _Sender:
    """What the receiver knows of a sender.

    Attributes:
        epoch_ns: System time at stamp 0, ns since 1970; None if unknown.
        expected: Number of the next sample, by topic; senders number the samples of each topic from 0.
        received: Samples that arrived, by topic.
        is_connected: Whether it may send.
    """

    epoch_ns: int | None = None
    expected: dict[str, int] = field(default_factory=dict)
    received: Counter[str] = field(default_factory=Counter)
    is_connected: bool = False


class Receiver:
    """Listens for senders, checks what they send, and queues it for `receive`; a context manager.

    Args:
        address: Host and port to listen at; port 0 takes a free one.

    Attributes:
        address: Where it listens.
        traffic: Counts of samples, by topic.
        refused: The first hundred refused senders, with reasons.
        refusals: Number of refusals.

    Raises:
        StrideTwinError: The address cannot be listened at.
    """

    def __init__(self, address: tuple[str, int]) -> None:
        """Opens the endpoint; samples are taken only once the context is entered."""
        self.address = address if address[1] else (address[0], _find_free_port(address[0]))
        self._link = ZenohLink(listen=self.address)
        typestore()  # slow: done here so that the first sample does not wait
        self.traffic: dict[str, Traffic] = {}
        self.refused: list[str] = []
        self.refusals = 0
        self._inbox: deque[tuple[Arrival | Hello, int]] = deque()  # each with its size in bytes
        self._bytes = 0  # size of all of the inbox
        self._changed = threading.Condition()  # lock of all of these; notifies of every change
        self._senders: dict[str, _Sender] = {}  # by ID, the one that said hello last at the end
        self._owner: dict[str, str] = {}  # ID of the connected sender that provides a topic
        self._decoders: dict[str, MessageDecoder] = {}  # by topic
        self._last_ns: dict[str, int] = {}  # stamp of the last sample passed on, by topic
        self._has_ended = self._is_closed = False  # whether a sender has ended; whether the context is left

    def __enter__(self) -> Self:
        """Begins to answer senders and to take samples; at last senders get to know that the receiver is there."""
        link = self._link
        link.answer_queries("*/hello", self._answer_with(self._on_hello))
        link.answer_queries("*/end", self._answer_with(self._on_end))
        link.subscribe("*/samples/**", self._on_sample)
        link.on_disconnect(self._disconnect)
        link.declare_presence(f"receiver/{link.name}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes the connections; threads that wait for room in the inbox give up."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        self._link.close()

    def receive(self, timeout_s: float) -> list[Arrival | Hello]:
        """Takes all queued samples and hellos, in the order of arrival.

        Args:
            timeout_s: How long it waits if there are none.

        Returns:
            The items; empty after the time or once the receiver has `ended`.
        """
        with self._changed:
            if not self._inbox and not self.ended:
                self._changed.wait(timeout_s)
            items = [item for item, _ in self._inbox]
            self._inbox.clear()
            self._bytes = 0
            self._changed.notify_all()  # threads that wait for room in the inbox go on
        return items

    @property
    def ended(self) -> bool:
        """Whether a sender has ended, no sender is connected and the inbox is empty."""
        return self._has_ended and not self._inbox and not self._count_connected()

    def _count_connected(self) -> int:
        """Number of senders that are connected and not refused."""
        return sum(sender.is_connected for sender in self._senders.values())

    def _answer_with(self, handle: Callable[[str, bytes], _Sender]) -> Callable[[str, bytes], tuple[str, bool]]:
        """Makes the answer to a query from a handler that returns the sender's state or raises an error.

        Returns:
            A function of the sender's ID and the query's body that returns a text and whether the query succeeded: as
            JSON, the number of samples received from the sender by topic, or the reason why the sender is refused.
        """

        def answer(name: str, body: bytes) -> tuple[str, bool]:
            """Handles one query; any error refuses its sender."""
            try:
                return json.dumps(handle(name, body).received), True
            except Exception as error:  # whatever unexpected bytes lead to
                return self._refuse(name, error), False

        return answer

    def _on_hello(self, name: str, body: bytes) -> _Sender:
        """Accepts a new sender, or one that reconnects, and queues its hello.

        A sender that reconnects keeps its counts. Of the senders that are gone, only the last `_SENDERS_KNOWN` are
        remembered.

        Args:
            name: ID of the sender.
            body: The hello as JSON.

        Returns:
            What is known of the sender.

        Raises:
            WireError: The hello or its rig is invalid, or there are `MOST_SENDERS` already.
        """
        hello = parse_json(type_adapter(Hello), body, "hello")
        _ = hello.calibration  # parsed here, so that the sender of an invalid one is refused
        with self._changed:
            if self._count_connected() >= MOST_SENDERS:
                raise WireError(f"{MOST_SENDERS} senders are there already")
            sender = self._senders.pop(name, None) or _Sender(expected=dict(hello.next))
            gone = [other for other, state in self._senders.items() if not state.is_connected]  # IDs, the oldest first
            for other in gone[: max(0, len(gone) - _SENDERS_KNOWN)]:
                del self._senders[other]
            self._senders[name] = sender  # now the last one
            sender.epoch_ns, sender.is_connected = hello.epoch_ns, True
            self._enqueue(hello)
        return sender

    def _on_end(self, name: str, body: bytes) -> _Sender:
        """Counts the samples that a sender had and that did not arrive; the sender disconnects when it has the answer.

        Args:
            name: ID of the sender.
            body: Number of the sample that would come next, by topic, as JSON.

        Returns:
            What is known of the sender.

        Raises:
            WireError: The query is invalid, or the sender has not said hello.
        """
        numbers = parse_json(type_adapter(Counts), body, "end")
        with self._changed:
            sender = self._senders.get(name)
            if sender is None:
                raise WireError("end without a hello")
            if sender.is_connected:  # not one that was refused
                for topic, number in numbers.items():
                    self._count_gap(sender, topic, number)
                self._has_ended = True  # the receiver ends once no sender is connected and its inbox is empty
        return sender

    def _on_sample(self, name: str, item: zenoh.Sample) -> None:
        """Decodes, checks, counts and queues a sample; the sender of an invalid one is refused.

        Runs in a thread of Zenoh. A sample with a number that is not finite, or whose stamp is not after the last one,
        is counted only.

        Args:
            name: ID of the sender.
            item: The Zenoh sample with the message.
        """
        since_ns, system_ns = time.perf_counter_ns(), time.time_ns()  # when the sample arrived, on two clocks
        sender = self._senders.get(name)
        if sender is None or not sender.is_connected:
            return  # not greeted, or refused
        try:
            message, number = read_message(item)
            sample = self._find_decoder(name, message).decode(message)
            if sample is not None and not 0 <= sample.t_ns < LATEST_NS:
                raise WireError(f"{message.topic}: invalid stamp {sample.t_ns} ns: expected 0 to {LATEST_NS}")
            with self._changed:
                if self._count_sample(sender, message.topic, number, sample) and sample is not None:
                    # the stamp counts from the sender's epoch
                    travel_ns = None if sender.epoch_ns is None else system_ns - sender.epoch_ns - sample.t_ns
                    arrival = Arrival(sample=sample, message=message, since_ns=since_ns, travel_ns=travel_ns)
                    self._enqueue(arrival, _size_in_bytes(arrival))
        except Exception as error:  # whatever unexpected bytes lead to
            self._link.publish_text(f"{name}/refused", self._refuse(name, error))

    def _count_sample(self, sender: _Sender, topic: str, number: int, sample: Sample | None) -> bool:
        """Counts a sample, and the gap before its number; the caller holds the lock.

        Args:
            sender: Its sender, whose counts change.
            topic: Its topic.
            number: Its number among the samples of the topic.
            sample: The sample; None if one of its numbers is not finite.

        Returns:
            Whether the sample is passed on: its numbers are finite and its stamp is after the previous one.
        """
        self._count_gap(sender, topic, number)
        sender.expected[topic] = max(number + 1, sender.expected.get(topic, 0))  # a late sample changes nothing
        sender.received[topic] += 1
        traffic = self._traffic_of(topic)
        if sample is None:
            traffic.not_finite += 1
        elif sample.t_ns <= self._last_ns.get(topic, -1):
            traffic.not_increasing += 1
        else:
            self._last_ns[topic] = sample.t_ns
            traffic.received += 1
            return True
        return False

    def _count_gap(self, sender: _Sender, topic: str, number: int) -> None:
        """Counts the samples of a topic that a sender had before number `number` and that did not arrive, as lost.

        These are the samples from the number that is expected next. Then `number` is the one that is expected.
        """
        expected = sender.expected.get(topic, 0)
        if number > expected:
            self._traffic_of(topic).lost += number - expected
            sender.expected[topic] = number

    def _traffic_of(self, topic: str) -> Traffic:
        """The counts of a topic, which begin at its first sample.

        Raises:
            WireError: There are too many topics.
        """
        if topic not in self.traffic and len(self.traffic) >= MOST_SENDERS * MOST_TOPICS:
            raise WireError("too many topics")
        return self.traffic.setdefault(topic, Traffic())

    def _find_decoder(self, name: str, message: Message) -> MessageDecoder:
        """The decoder of a message's topic; a topic belongs to its first sender as long as that is connected.

        Args:
            name: ID of the sender.
            message: The message.

        Raises:
            WireError: Another sender has the topic, the sender has too many, or the type has changed.
        """
        topic = message.topic
        with self._changed:
            if self._owner.setdefault(topic, name) != name:  # `_owner`: ID of the sender that provides each topic
                raise WireError(f"{topic}: another sender provides it already")
            if sum(owner == name for owner in self._owner.values()) > MOST_TOPICS:
                raise WireError(f"more than {MOST_TOPICS} topics")
            known = self._decoders.get(topic)
            if known is None:  # the first message of the topic
                self._traffic_of(topic)  # refuses it if there are too many topics
                self._decoders[topic] = known = MessageDecoder(topic, message.typename)
        if known.typename != message.typename:
            raise WireError(f"{topic}: invalid type {message.typename[:60]}: expected {known.typename} as before")
        return known

    def _enqueue(self, item: Arrival | Hello, size: int = 0) -> None:
        """Puts an item of `size` bytes into the inbox; waits while the inbox is full. The caller holds the lock.

        An item that is larger than the inbox is put into an empty one. Once the receiver is closed, nothing is taken
        out any more: then a full inbox drops the item.
        """
        while (self._bytes + size > INBOX_BYTES or len(self._inbox) >= INBOX_COUNT) and self._inbox:
            if self._is_closed:
                return
            self._changed.wait()  # releases the lock until something changes
        self._inbox.append((item, size))
        self._bytes += size
        self._changed.notify_all()

    def _disconnect(self, name: str) -> None:
        """Marks a sender as disconnected, and frees its topics for others."""
        with self._changed:
            if name in self._senders:
                self._senders[name].is_connected = False
            # `_owner`: ID of the sender that provides each topic
            self._owner = {topic: owner for topic, owner in self._owner.items() if owner != name}
            self._changed.notify_all()

    def _refuse(self, name: str, error: Exception) -> str:
        """Takes nothing more from a sender because of an error, and lists it among the refused ones.

        Args:
            name: ID of the sender.
            error: The error, such as that of an invalid message.

        Returns:
            The reason as text, which the sender gets.
        """
        is_expected = isinstance(error, StrideTwinError | ValueError)  # the message of any other needs its type
        reason = str(error) if is_expected else f"{type(error).__name__}: {error}"
        with self._changed:
            self.refusals += 1
            if len(self.refused) < _REFUSALS_KEPT:
                self.refused.append(f"sender {name[:8]}: {reason}")
        self._disconnect(name)
        return reason[:4096]


def _size_in_bytes(arrival: Arrival) -> int:
    """Bytes that a queued sample occupies: those of its message, and the pixels of its decoded image."""
    sample, size = arrival.sample, len(arrival.message.payload)
    if isinstance(sample, Image | Depth):
        size += (sample.pixels if isinstance(sample, Image) else sample.depth).nbytes
    return size


def _find_free_port(host: str) -> int:
    """A port at the host that no program listens at: one that the system gives for port 0, and that is closed again."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.create_server((host, 0), family=family) as server:
        port: int = server.getsockname()[1]  # of host and port, and further numbers for IPv6
    return port


class Reorder:
    """Buffers samples until no older one can arrive, or the window has passed.

    A sample is released as soon as every stream has delivered one that is not older, or one stream is a window ahead of
    it, or it has waited for a window. A sample that arrives after newer ones were released follows at once and counts
    as late.

    Args:
        window_s: The window.

    Attributes:
        late: Number of late samples, by topic.
    """

    def __init__(self, window_s: float) -> None:
        """Begins with an empty buffer; the window is in s."""
        self._window_ns = round(window_s * 1e9)
        # buffered samples, each after its order (stamp, rank of its kind, topic) and its number, which decides ties
        self._heap: list[tuple[tuple[int, int, str], int, Arrival]] = []
        self._newest: dict[str, int] = {}  # stamp of the newest sample, by topic
        self._released_ns = -1  # latest stamp of the released samples
        self._count = 0  # samples added
        self.late: Counter[str] = Counter()

    def add(self, arrival: Arrival) -> None:
        """Buffers a sample until `release_due` yields it; within a stream, stamps increase."""
        t_ns, topic = arrival.sample.t_ns, arrival.sample.topic
        if t_ns < self._released_ns:  # a newer one has been released already
            self.late[topic] += 1
        self._newest[topic] = t_ns
        self._count += 1
        heapq.heappush(self._heap, ((t_ns, rank_of(type(arrival.sample)), topic), self._count, arrival))

    def release_due(self, now_ns: int) -> Iterator[Arrival]:
        """Yields the samples that need not wait any longer for older ones, in the order of their stamps.

        Args:
            now_ns: Present time on the clock of `Arrival.since_ns`, `time.perf_counter_ns()`.
        """
        while self._heap:
            (t_ns, _, _), _, oldest = self._heap[0]
            newest = self._newest.values()  # stamp of the newest sample of each stream
            no_older_comes = min(newest) >= t_ns  # as the stamps of each stream increase
            is_ahead = max(newest) - t_ns >= self._window_ns  # one stream is ahead of it by the window
            has_waited = now_ns - oldest.since_ns >= self._window_ns
            if not (no_older_comes or is_ahead or has_waited):
                return
            yield self._pop()

    def flush(self) -> Iterator[Arrival]:
        """Yields all buffered samples in the order of their stamps, whether they are due or not; use it at the end."""
        while self._heap:
            yield self._pop()

    def compute_wait_s(self, now_ns: int) -> float | None:
        """Seconds until the oldest sample has waited for a window and is released; None if the buffer is empty.

        Args:
            now_ns: Present time on the clock of `Arrival.since_ns`, `time.perf_counter_ns()`.
        """
        if not self._heap:
            return None
        _, _, oldest = self._heap[0]
        return max(0.0, (oldest.since_ns + self._window_ns - now_ns) * 1e-9)

    def _pop(self) -> Arrival:
        """Takes the sample with the earliest stamp; later arrivals with an earlier stamp count as late."""
        _, _, arrival = heapq.heappop(self._heap)
        self._released_ns = max(self._released_ns, arrival.sample.t_ns)
        return arrival
