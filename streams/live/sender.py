"""The hardware's end of the bridge: sends samples at once; drops and counts those that the receiver cannot take."""

from __future__ import annotations

import json
import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from types import TracebackType
from typing import Self

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.kalibr import rig_to_yaml
from stridetwin.streams.live.messages import MessageEncoder
from stridetwin.streams.live.wire import (
    LARGEST_HELLO,
    VERSION,
    Counts,
    Hello,
    WireError,
    ZenohLink,
    check_message,
    parse_json,
)
from stridetwin.streams.recording.mcap_contents import Message
from stridetwin.streams.recording.ros_images import IMAGES
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Sample
from stridetwin.streams.validation import type_adapter

IMAGES_HELD, SAMPLES_HELD = 8, 2048
"""Most queued messages of a topic while a receiver is slow or disconnected; then the oldest is dropped."""
_POLL_S = 0.2
"""Longest time for which the sending thread waits before it looks again."""


class Sender:
    """Sends samples to a receiver in its own thread; a context manager.

    `send` never waits, unless `lossless`: messages that a slow receiver does not take wait in one queue per topic,
    whose oldest message is dropped when it is full; the receiver counts the gap. A lost connection is restored as long
    as there is something to send. Leaving the context sends the queued messages and the end.

    Args:
        rig: Calibration of the sensors.
        address: Host and port of the receiver.
        metadata: Texts for the receiver's recording, such as the geometry of an exoskeleton.
        epoch_ns: System time at stamp 0; 0 for stamps that are system time (`time.time_ns()`), None if unknown.
        encoder: Conversion of samples to messages; by default as in recordings.
        lossless: `send` waits while a queue is full.
        patience_s: How long a receiver may be disconnected before leaving gives up, and initially before `send` does.

    Attributes:
        sent: Messages sent, by topic.
        dropped: Messages dropped, by topic.

    Raises:
        WireError: Rig and metadata are too large.
    """

    def __init__(
        self,
        rig: Rig,
        address: tuple[str, int],
        *,
        metadata: Mapping[str, str] | None = None,
        epoch_ns: int | None = None,
        encoder: MessageEncoder | None = None,
        lossless: bool = False,
        patience_s: float = 10.0,
    ) -> None:
        """Prepares the hello; the thread that connects and sends starts when the context is entered."""
        self._address_text, self._lossless, self._patience_s = f"{address[0]}:{address[1]}", lossless, patience_s
        self._address = address
        self._hello = Hello(version=VERSION, rig=rig_to_yaml(rig), metadata=dict(metadata or {}), epoch_ns=epoch_ns)
        # the other half of the largest hello is for the numbers by topic
        if (size := len(self._hello.model_dump_json().encode())) > LARGEST_HELLO // 2:
            raise WireError(f"rig and metadata: invalid size of {size} bytes: expected up to {LARGEST_HELLO // 2}")
        self._encoder = encoder or MessageEncoder(rig)
        self.sent: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        # waiting messages by topic, each after its order among all topics and its number in the topic
        self._queues: dict[str, deque[tuple[int, int, Message]]] = {}
        self._order = 0  # of the next message
        self._numbers: Counter[str] = Counter()  # number of the next message, by topic; dropped ones count, too
        self._receiver, self._greeted_receiver = "", ""  # the one that is present, and the one last greeted
        self._is_greeted = False  # whether the present receiver has been greeted
        self._put_counts: Counter[str] = Counter()  # messages sent to this receiver, by topic
        self._next: dict[str, int] = {}  # number of the sample after the last one sent, by topic
        self._first: dict[str, int] = {}  # `_next` at the time when the receiver appeared
        self._changed = threading.Condition()  # lock of all of these; notifies of every change
        self._ending, self._failure = False, ""  # the context is being left; why sending has failed
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Sends what is queued and the end, and waits until that is answered; after an error only the end.

        Raises:
            WireError: Sending has failed, unless the context is left because of another error.
        """
        with self._changed:
            self._ending = True
            if error is not None:  # nothing more is sent, and the end names no messages beyond those sent
                self._queues.clear()
                self._numbers = Counter(self._next)  # number of the next message of each topic, as the end tells it
            self._changed.notify_all()
        self._thread.join()
        if error is None:
            self._raise_failure()

    def send(self, item: Sample | Message) -> None:
        """Queues a sample for sending, or an existing message, which is sent unchanged.

        If the queue of the topic is full, its oldest message is dropped, or the call waits if the sender is `lossless`.
        Dropped messages keep their numbers, so that the receiver counts the gap.

        Raises:
            WireError: The receiver has refused this sender, or was never reachable; or the message is invalid.
        """
        message = item if isinstance(item, Message) else self._encoder.encode(item)
        check_message(message)
        topic = message.topic
        most = IMAGES_HELD if message.typename in IMAGES else SAMPLES_HELD  # messages in the queue of the topic
        with self._changed:
            queue = self._queues.setdefault(topic, deque())
            while self._lossless and len(queue) >= most and not self._failure:
                self._changed.wait()
            self._raise_failure()
            if len(queue) >= most:
                queue.popleft()
                self.dropped[topic] += 1
            queue.append((self._order, self._numbers[topic], message))
            self._order += 1
            self._numbers[topic] += 1
            self._changed.notify_all()

    def _raise_failure(self) -> None:
        """Raises the error of the sending thread, if it has failed."""
        if self._failure:
            raise WireError(self._failure)

    def _run(self) -> None:
        """The sending thread: delivers hello, messages and end until the end is answered or sending fails."""
        try:
            link = ZenohLink(connect=self._address)
            try:
                link.subscribe(f"{link.name}/refused", lambda _, sample: self._on_refusal(sample.payload.to_string()))
                link.watch_presence("receiver/*", self._on_receiver)
                while self._has_receiver() and not self._deliver(link):
                    pass
            finally:
                link.close()
        except WireError as error:
            self._on_refusal(str(error))
        except Exception as error:  # `send` must fail with it instead of waiting for ever
            self._fail(str(error) if isinstance(error, StrideTwinError) else f"{type(error).__name__}: {error}")

    def _has_receiver(self) -> bool:
        """Waits until a receiver is present.

        It waits for at most `patience_s` before the first receiver, and when the context is being left. In between, a
        receiver may be away for any time.

        Returns:
            False if none appears within `patience_s`, or sending has failed.
        """
        with self._changed:
            since = time.monotonic()
            while not self._receiver and not self._failure:
                gives_up = self._ending or not self._greeted_receiver  # none was there yet, or nothing more will come
                if gives_up and time.monotonic() - since > self._patience_s:
                    self._fail(f"no `stridetwin live` of this version listens at {self._address_text}")
                self._changed.wait(min(_POLL_S, self._patience_s))
            return not self._failure

    def _deliver(self, link: ZenohLink) -> bool:
        """Does the next step of sending, in the sending thread.

        A new receiver gets the hello first. Then the oldest message of all queues is sent; it counts as sent, and
        `_count_losses` corrects that later. If all queues are empty, the method waits a moment for a message or, when
        the context is being left, sends the end with the number of the next message of each topic.

        Args:
            link: Connection to the receiver.

        Returns:
            Whether the end was sent and answered, so that nothing is left to do. If false, the method is to be called
            again.
        """
        with self._changed:  # the lock is released before anything is sent, as that may take long
            is_greeted = self._is_greeted
            waiting = [topic for topic, queue in self._queues.items() if queue]
            if is_greeted and not waiting and not self._ending:
                self._changed.wait(_POLL_S)
                return False
            if is_greeted and waiting:
                # the topic whose first message is the oldest of all; a queue has (order, number, message)
                topic = min(waiting, key=lambda t: self._queues[t][0][0])
                _, number, message = self._queues[topic].popleft()
                self.sent[topic] += 1
                self._put_counts[topic] += 1
                self._next[topic] = number + 1
                self._changed.notify_all()
        if not is_greeted:
            self._greet(link)
        elif waiting:
            link.send(message, number)
        else:
            return self._count_losses(link.query(f"{link.name}/end", json.dumps(self._numbers)))
        return False

    def _greet(self, link: ZenohLink) -> None:
        """Sends the hello with rig, metadata and, by topic, the number of the first sample for this receiver.

        A receiver that was away and is back gets the same numbers as before, so that it counts what it has missed. If
        the hello is not answered, the receiver counts as not greeted, and the next step repeats the hello.
        """
        with self._changed:
            self._is_greeted = True  # until the receiver disappears
            if self._receiver != self._greeted_receiver:  # another one than before, which has received nothing yet
                self._put_counts.clear()
                self._greeted_receiver = self._receiver
                self._first = dict(self._next)  # number of the first sample for this receiver, by topic
            hello = self._hello.model_copy(update={"next": self._first})
        if not self._count_losses(link.query(f"{link.name}/hello", hello.model_dump_json())):
            self._is_greeted = False

    def _count_losses(self, answer: bytes | None) -> bool:
        """Moves messages that the receiver lacks from the counts `sent` to the counts `dropped`.

        Args:
            answer: The receiver's counts by topic as JSON; None if the connection was lost.

        Returns:
            Whether the receiver has answered.
        """
        if answer is None:
            return False
        received = parse_json(type_adapter(Counts), answer, "answer")
        with self._changed:
            missing = self._put_counts - Counter(received)  # by topic: sent to this receiver and not received
            self.sent -= missing
            self._put_counts -= missing
            self.dropped += missing
        return True

    def _on_receiver(self, key: str, is_present: bool) -> None:
        """Notes that a receiver has appeared or disappeared; a new one is greeted by the sending thread.

        Args:
            key: Key of its liveliness token, `receiver/` and its ID.
            is_present: Whether it has appeared.
        """
        name = key.rpartition("/")[2]
        with self._changed:
            if is_present or self._receiver == name:  # that another one than the present receiver leaves is ignored
                self._receiver = name if is_present else ""
                self._is_greeted = False
                self._changed.notify_all()

    def _on_refusal(self, reason: str) -> None:
        """Stops sending because the receiver refuses it."""
        self._fail(f"{self._address_text} refuses: {reason}")

    def _fail(self, reason: str) -> None:
        """Stops sending; the first reason is kept for the error that `send` raises."""
        with self._changed:
            self._failure = self._failure or reason
            self._changed.notify_all()
