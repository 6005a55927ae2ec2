"""Runs an estimator on samples that arrive over the bridge: one thread, in order of stamps, with measured latency."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from stridetwin.run.compile_ahead import feed_synthetic_samples
from stridetwin.run.latency import Latency
from stridetwin.run.live_chain import Chain, InputCheck, Request
from stridetwin.run.warm_up import synthetic_rig
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.kalibr import read_rig
from stridetwin.streams.live.messages import LiveRecorder
from stridetwin.streams.live.receiver import Arrival, Receiver, Reorder
from stridetwin.streams.live.wire import Hello
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Depth, Image

WINDOW_S = 0.01
"""How long a sample waits for older samples of other streams if no estimator runs."""
SLOW_START_S = 5.0
"""Compiled functions are loaded within this time; if the warm-up takes longer, they are being compiled."""
_IDLE_S = 0.1  # longest time that a round waits for arrivals

Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class LiveRequest:
    """What to do with incoming samples.

    Attributes:
        chain: The estimator to run; None only records.
        address: Address to listen on.
        rig: Kalibr YAML that takes precedence over the senders' rigs.
        record: Recording to write; None writes none.
        budget_s: Latency budget; None uses the estimator's.
        window_s: Reordering window; None uses the estimator's.
        skip_images_s: Images that have waited longer are skipped; None skips none.
    """

    chain: Request | None
    address: tuple[str, int]
    rig: Path | None = None
    record: Path | None = None
    budget_s: float | None = None
    window_s: float | None = None
    skip_images_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of a live run.

    Attributes:
        latency: None without an estimator.
        files: Rows by file.
        streams: Received traffic by topic.
        refused: Refused senders, with reasons.
        refusals: Number of refusals.
        recorded: Messages in the recording.
        window_s: Reordering window.
        duration_s: From the first sample's arrival to the last one's.
    """

    latency: Latency | None
    files: dict[Path, int]
    streams: dict[str, dict[str, int]]
    refused: list[str]
    refusals: int
    recorded: int
    window_s: float
    duration_s: float


def run_live(request: LiveRequest, say: Say, emit: Say) -> Outcome:
    """Processes samples until every sender has finished or the user interrupts.

    Args:
        request: What to run and to record.
        say: Receives status messages.
        emit: Receives each estimate as a row of its file.

    Raises:
        StrideTwinError: The address or a file is unavailable, nothing arrived, or the estimator rejects the input.
    """
    files = (request.chain.output if request.chain else None, request.record)
    for file in files:
        if file is not None and not file.parent.is_dir():
            raise StrideTwinError(f"{file}: no folder {file.parent}")
    return _Live(request, say, emit).run()


class _Live:
    """One live run: receives, reorders and checks samples, and gives them to the estimator and the recorder.

    Args:
        request: What to run and to record.
        say: Receives status messages.
        emit: Receives each estimate as a row of its file.
    """

    def __init__(self, request: LiveRequest, say: Say, emit: Say) -> None:
        """Reads the given rig; budget and window are those of the request or else of the estimator."""
        self._request, self._say, self._emit = request, say, emit
        declaration = request.chain.load().declaration if request.chain else None
        default_window_s = declaration.window_s if declaration else WINDOW_S
        default_budget_s = declaration.budget_s if declaration else 0.0
        window_s = default_window_s if request.window_s is None else request.window_s
        self._latency = Latency(default_budget_s if request.budget_s is None else request.budget_s)
        self._window_s, self._reorder = window_s, Reorder(window_s)
        self._given = Rig() if request.rig is None else read_rig(request.rig)
        self._rig, self._metadata = self._given, dict[str, str]()  # merged with those of the senders so far
        self._chain: Chain | None = None  # None until the rig is sufficient
        self._compiled = False  # whether the warm-up is done
        self._recorder: LiveRecorder | None = None
        self._start_error = ""  # why the estimator has not started yet
        self._warned = set[tuple[str, str]]()  # topics and problems that have been reported
        self._span: tuple[int, int] | None = None  # arrival of the first and of the last sample, `perf_counter_ns`
        self._input_check = InputCheck({}, Rig())
        # samples that were not used, by reason and topic
        self._counts = {name: Counter[str]() for name in ("before_start", "other_kind", "other_size", "skipped")}
        self._refusals_reported = 0  # how many refused senders have been reported

    def run(self) -> Outcome:
        """Compiles the estimator, listens until the senders have ended, and writes the files.

        After an error, existing files of estimates stay unchanged; the recording keeps what has arrived.

        Raises:
            StrideTwinError: The address or a file is unavailable, or nothing was estimated.
        """
        with ExitStack() as stack:
            self._compile()
            if self._request.rig is not None:
                self._try_chain()
            if self._request.record is not None:
                self._recorder = stack.enter_context(LiveRecorder(self._request.record))
            receiver = stack.enter_context(Receiver(self._request.address))
            self._say(f"listening at {receiver.address[0]}:{receiver.address[1]}")
            try:
                self._follow(receiver)
                files = self._finish()
            except BaseException:
                if self._chain is not None:
                    self._chain.abandon()
                raise
            counted = {"late": self._reorder.late, **self._counts}
            streams = {
                topic: {**vars(traffic), **{name: counts[topic] for name, counts in counted.items()}}
                for topic, traffic in sorted(receiver.traffic.items())
            }
            return Outcome(
                latency=self._latency if self._chain is not None else None,
                files=files,
                streams=streams,
                refused=receiver.refused,
                refusals=receiver.refusals,
                window_s=self._window_s,
                recorded=self._recorder.count if self._recorder else 0,
                duration_s=(self._span[1] - self._span[0]) * 1e-9 if self._span else 0.0,
            )

    def _follow(self, receiver: Receiver) -> None:
        """Handles hellos and samples until the senders have ended or the user interrupts, then buffered samples.

        Each round waits for arrivals, but not longer than until the next buffered sample is due.
        """
        try:
            while not receiver.ended:
                due_s = self._reorder.compute_wait_s(time.perf_counter_ns())
                for item in receiver.receive(_IDLE_S if due_s is None else min(due_s, _IDLE_S)):
                    if isinstance(item, Hello):
                        self._on_hello(item)
                    else:
                        self._arrive(item)
                self._process(self._reorder.release_due(time.perf_counter_ns()))
                self._warn(receiver)
        except KeyboardInterrupt:
            self._say("stopped")
        self._process(self._reorder.flush())
        self._warn(receiver)

    def _finish(self) -> dict[Path, int]:
        """Writes the estimator's files; returns the number of rows by file.

        Raises:
            StrideTwinError: No sample arrived, or none that the estimator reads.
        """
        if self._span is None:
            raise StrideTwinError("no samples arrived")
        if self._request.chain is not None and self._chain is None:
            raise StrideTwinError(f"nothing was estimated: {self._start_error}")
        if self._chain is not None and not self._latency.took_any:
            raise StrideTwinError(f"nothing was estimated: no samples arrived of {', '.join(self._chain.takes)}")
        return self._chain.finish() if self._chain is not None else {}

    def _on_hello(self, hello: Hello) -> None:
        """Merges a sender's rig and metadata into those known, warns where two senders differ, and tries to start."""
        self._rig, differing = _merge_rigs(self._rig, hello.calibration)
        # the rig of the request takes precedence on purpose, so that no warning is due for its sensors
        given = {*self._given.imus, *self._given.cameras, *self._given.boards, *self._given.others}
        for name in differing - given:
            self._say(f"warning: another sender describes {name} differently; the first description is used")
        self._metadata = hello.metadata | self._metadata
        if self._recorder is not None:
            self._recorder.set_rig(self._rig, self._metadata)
        self._try_chain()

    def _try_chain(self) -> None:
        """Starts the estimator once the rig is sufficient; otherwise reports what is missing, once.

        Does nothing if no estimator is wanted, or one has started.
        """
        wanted = self._request.chain
        if wanted is None or self._chain is not None:
            return
        self._compile()
        try:
            self._chain = Chain(wanted, self._rig, self._metadata)
        except StrideTwinError as error:
            if str(error) != self._start_error:
                self._start_error = str(error)
                self._say(f"waiting: {error}")
            return
        self._input_check = InputCheck(self._chain.takes, self._rig)
        self._say(f"{wanted.estimator} reads {', '.join(self._chain.takes)}")

    def _compile(self) -> None:
        """Compiles the estimator once on synthetic samples, so that the first real ones do not wait.

        It is put off until its inputs are known, such as the geometry of an exoskeleton in a sender's metadata.
        """
        wanted = self._request.chain
        if wanted is None or self._compiled or not wanted.warms_up:
            return
        try:
            trial = Chain(replace(wanted, output=None), synthetic_rig(), self._metadata)
        except StrideTwinError:  # its inputs are not known yet, or the synthetic rig lacks them
            return
        note = f"{wanted.estimator} is being compiled, which takes minutes the first time"
        timer = threading.Timer(SLOW_START_S, self._say, [note])  # compiled functions are loaded in less
        timer.daemon = True
        timer.start()
        try:
            feed_synthetic_samples(trial)
        finally:
            timer.cancel()
        self._compiled = True

    def _arrive(self, arrival: Arrival) -> None:
        """Records a sample that has arrived, and queues it by its stamp if the estimator reads it and it fits."""
        topic = arrival.sample.topic
        self._span = (self._span[0] if self._span else arrival.since_ns, arrival.since_ns)
        if arrival.travel_ns is not None:  # None if the sender's clock is not known
            self._latency.add_travel(topic, arrival.travel_ns * 1e-9)
        if self._recorder is not None:
            self._recorder.write(arrival.message, arrival.sample.t_ns)
        if self._chain is None:  # counted if an estimator is wanted, but has not started
            self._counts["before_start"][topic] += self._request.chain is not None
        elif topic in self._chain.takes:
            if (wrong := self._input_check.find_problem(arrival.sample)) is None:
                self._reorder.add(arrival)
            else:
                what, case, counted_as = wrong
                self._counts[counted_as][topic] += 1
                self._warn_once(topic, what, case)

    def _process(self, arrivals: Iterable[Arrival]) -> None:
        """Gives samples to the estimator in order, measures the latency of each, and emits its rows."""
        for arrival in arrivals:
            assert self._chain is not None
            topic, begin_ns = arrival.sample.topic, time.perf_counter_ns()
            if self._is_stale(arrival, begin_ns):
                self._counts["skipped"][topic] += 1
                continue
            for estimator, line in self._chain.update(arrival.sample):  # yields when an estimator has finished
                now_ns = time.perf_counter_ns()
                self._latency.add(
                    estimator,
                    topic,
                    whole_s=(now_ns - arrival.since_ns) * 1e-9,
                    work_s=(now_ns - begin_ns) * 1e-9,
                    estimated=line is not None,
                )
                if line:  # an odometry before the estimator gives "" for a new pose
                    self._emit(line)
                begin_ns = time.perf_counter_ns()  # of the next estimator's work

    def _is_stale(self, arrival: Arrival, now_ns: int) -> bool:
        """Whether an image has waited longer than allowed; other samples are never skipped."""
        most_s, is_image = self._request.skip_images_s, isinstance(arrival.sample, Image | Depth)
        return most_s is not None and is_image and now_ns - arrival.since_ns > most_s * 1e9

    def _warn(self, receiver: Receiver) -> None:
        """Reports each problem of a stream and each refused sender once."""
        for topic, traffic in list(receiver.traffic.items()):
            for count, what in (
                (traffic.lost, "samples are lost: they come faster than they are taken, or the connection breaks"),
                (traffic.not_increasing, "stamps do not increase: such samples are left out"),
                (traffic.not_finite, "NaN or infinity: such samples are left out"),
            ):
                if count:
                    self._warn_once(topic, what)
        for refusal in receiver.refused[self._refusals_reported :]:
            self._refusals_reported += 1
            self._say(f"warning: refused {refusal}")

    def _warn_once(self, topic: str, what: str, first: str = "") -> None:
        """Reports a problem of a topic once, with its first case.

        Args:
            topic: The topic.
            what: The problem in general.
            first: The problem in this case; "" if there is nothing to add.
        """
        if (topic, what) not in self._warned:
            self._warned.add((topic, what))
            self._say(f"warning: {topic}: {what}{first and f' ({first})'}")


def _merge_rigs(first: Rig, second: Rig) -> tuple[Rig, set[str]]:
    """Merges two rigs; where both have an entry of one name, that of the first is kept.

    Returns:
        The merged rig; names (topics, or names of boards) of which the two rigs have different entries.
    """
    differing: set[str] = set()
    pairs: tuple[tuple[Mapping[str, object], Mapping[str, object]], ...] = (
        (first.imus, second.imus),
        (first.cameras, second.cameras),
        (first.boards, second.boards),
        (first.others, second.others),
    )
    for one, two in pairs:
        # compared as text, because entries hold arrays
        differing |= {name for name in one.keys() & two.keys() if repr(one[name]) != repr(two[name])}
    merged = Rig(
        imus={**second.imus, **first.imus},
        cameras={**second.cameras, **first.cameras},
        boards={**second.boards, **first.boards},
        others={**second.others, **first.others},
    )
    return merged, differing
