"""`send` and `live`: plays recordings as hardware would send them, and runs estimators on incoming samples."""

from __future__ import annotations

import ipaddress
import signal
import sys
import threading
import time
from collections.abc import Iterator
from itertools import chain
from typing import Any

from stridetwin.cli.commands import LiveOptions, SendOptions
from stridetwin.cli.options import Outcome, Progress
from stridetwin.cli.recording import open_source
from stridetwin.estimators import registry
from stridetwin.streams.errors import RecordingError, StrideTwinError
from stridetwin.streams.live.messages import to_messages
from stridetwin.streams.live.sender import Sender
from stridetwin.streams.live.wire import parse_address
from stridetwin.streams.recording.mcap_contents import Message
from stridetwin.streams.rig import Rig

TRUTH_PREFIX = "/truth/"
FIGURES = {
    "received": "received",
    "late": "late",
    "lost": "lost before they arrived",
    "not_increasing": "stamps not increasing",
    "not_finite": "not finite",
    "before_start": "before the start",
    "other_kind": "of another kind",
    "other_size": "of another size",
    "skipped": "skipped for having waited",
}
_OVER_BUDGET = 1
_LEAD_NS = 500_000_000
"""Time for a receiver to process the hello, so that playback starts on time."""
_SWITCH_S = 0.0005
"""Thread switch interval, a tenth of Python's default: how long receiving threads wait for a computing one."""


def send_command(arguments: SendOptions, progress: Progress) -> Outcome:
    """Runs `send`: plays a recording to `live` in real time or at another speed.

    Without `--topic`, all topics but the ground truth are sent. Each message is sent when its stamp is due; at speed 0
    they are sent as fast as the receiver takes them.

    Returns:
        How many messages were sent and dropped, by topic.

    Raises:
        StrideTwinError: The recording lacks a topic, or there is no receiver.
    """
    address = parse_address(arguments.to, "--to")
    recording = open_source(arguments)
    topics = arguments.topic or [t for t in recording.topics if not t.startswith(TRUTH_PREFIX)]
    if missing := [t for t in topics if t not in recording.topics]:
        raise RecordingError(f"{recording.path}: no topic {missing[0]!r}; {recording.describe_topics()}")
    if not topics:
        raise RecordingError(f"{recording.path}: nothing to send")
    rig = recording.rig if recording.has_rig else Rig()
    first_ns = min(recording.topics[t].first_ns for t in topics)
    span_ns = max(1, max(recording.topics[t].last_ns for t in topics) - first_ns)
    speed = arguments.speed  # 1 is real time, 0 as fast as the receiver can
    messages = _prepare_first(to_messages(recording, topics))  # reads the first chunk before the clock starts
    start_ns = time.time_ns() + (_LEAD_NS if speed else 0)
    epoch_ns = start_ns - first_ns if speed == 1.0 else None  # as of a device whose clock started then
    with Sender(
        rig,
        address,
        metadata=recording.metadata,
        epoch_ns=epoch_ns,
        lossless=speed == 0.0,
        patience_s=arguments.patience,
    ) as sender:
        for message in messages:
            if speed:
                # the time between two stamps, at the chosen speed, passes between two messages
                due_ns = start_ns + (message.t_ns - first_ns) / speed
                if (ahead_s := (due_ns - time.time_ns()) * 1e-9) > 0:
                    time.sleep(ahead_s)
            sender.send(message)
            progress("send", (message.t_ns - first_ns) / span_ns)
    counts = {t: {"sent": sender.sent[t], "dropped": sender.dropped[t]} for t in sorted(topics)}
    data = {"to": f"{address[0]}:{address[1]}", "topics": counts, "duration_s": (time.time_ns() - start_ns) * 1e-9}
    lines = [f"{data['to']}: {sum(sender.sent.values())} messages in {data['duration_s']:.1f} s"]
    lines += [f"  {t:<34} {c['sent']:>8} sent {c['dropped']:>6} dropped" for t, c in counts.items()]
    return Outcome(data=data, lines=lines)


def _prepare_first(messages: Iterator[Message]) -> Iterator[Message]:
    """Yields the same messages after the first one has been prepared, which reads the first chunk of the recording."""
    first = next(messages, None)
    return iter(()) if first is None else chain([first], messages)


def live_command(arguments: LiveOptions, progress: Progress) -> Outcome:
    """Runs `live`: listens for senders until they end, and estimates, records, or both.

    `progress`, which every command gets, is not used: how long a live run takes is not known.

    Returns:
        Counts by stream, files and latency; the exit code is 1 if the latency is over `--budget`.
    """
    from stridetwin.cli.estimate import estimators_that, options_of
    from stridetwin.run.live import LiveRequest, run_live
    from stridetwin.run.live_chain import Request

    if arguments.estimator is not None and arguments.own_class is not None:
        raise StrideTwinError("--estimator names a class: expected no other estimator before it")
    name = arguments.estimator if arguments.own_class is None else arguments.own_class.partition("=")[0]
    if name is None and arguments.record is None:
        raise StrideTwinError("live: nothing to do: expected an estimator, --record FILE, or both")
    if name is None and arguments.output is not None:
        raise StrideTwinError("-o is only valid with an estimator; --record FILE writes a recording")
    if name is None and arguments.foot:
        raise StrideTwinError(f"--foot is only valid for {estimators_that(lambda d: d.per_foot)}")
    wanted = None  # the estimator to run; without one, samples are only recorded
    if name is not None:
        estimator_class = _load_own_class(arguments)
        options = options_of(
            (registry.estimator(name) if estimator_class is None else estimator_class).declaration,
            foot=arguments.foot,
            method=arguments.method,
            backend=arguments.backend,
            exoskeleton=arguments.exoskeleton,
        )
        wanted = Request(
            estimator=name,
            options=options,
            output=arguments.output,
            estimator_class=estimator_class,
            warms_up=estimator_class is None,
        )
    address = parse_address(arguments.listen, "--listen")
    if not _is_loopback(address[0]):
        _say(f"warning: {address[0]} can be reached from other machines, and there is no password")
    request = LiveRequest(
        chain=wanted,
        address=address,
        rig=arguments.rig,
        record=arguments.record,
        budget_s=None if arguments.budget is None else arguments.budget * 1e-3,
        window_s=None if arguments.window is None else arguments.window * 1e-3,
        skip_images_s=None if arguments.skip_images is None else arguments.skip_images * 1e-3,
    )
    prints = wanted is not None and wanted.output is None and not arguments.json  # each estimate on stdout at once
    sys.setswitchinterval(_SWITCH_S)
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # a stopped service writes its files, too
    done = run_live(request, _say, _print if prints else lambda _: None)
    code = _OVER_BUDGET if arguments.budget is not None and done.latency and not done.latency.within else 0
    data = {
        "estimator": name,
        "files": [str(f) for f in done.files],
        "rows": {str(f): n for f, n in done.files.items()},
        "recording": str(arguments.record) if arguments.record else None,
        "recorded": done.recorded,
        "duration_s": done.duration_s,
        "window_ms": 1e3 * done.window_s,
        "streams": done.streams,
        "refused": done.refused,
        "refusals": done.refusals,
        "latency": done.latency.data() if done.latency else None,
    }
    lines = [f"{file}: {rows} rows" for file, rows in done.files.items()]
    if arguments.record:
        lines.append(f"{arguments.record}: {done.recorded} messages")
    for topic, counts in done.streams.items():
        counted = ", ".join(f"{counts[n]} {label}" for n, label in FIGURES.items() if counts[n] or n == "received")
        lines.append(f"  {topic:<34} {counted}")
    lines += done.latency.table() if done.latency else []
    if prints:  # the estimates have already gone to stdout
        print("\n".join(lines), file=sys.stderr)
        lines = []
    return Outcome(data=data, lines=lines, code=code)


def _load_own_class(arguments: LiveOptions) -> type[Any] | None:
    """The class that the user names as `MODULE:CLASS`, as an estimator of paths; None for an installed estimator."""
    from stridetwin.gate.own_estimators import load_estimator

    if arguments.own_class is not None:
        name, _, place = arguments.own_class.partition("=")
        if not (name and place):
            raise StrideTwinError(f"--estimator: invalid {arguments.own_class!r}: expected NAME=MODULE:CLASS")
        return load_estimator(name, place, "--estimator")
    if arguments.estimator is not None and ":" in arguments.estimator:
        return load_estimator(arguments.estimator, arguments.estimator, "live")
    return None


def _is_loopback(host: str) -> bool:
    """Whether a host is this machine alone, so that no other machine can connect."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _say(message: str) -> None:
    """Prints a message on stderr, at once."""
    print(f"stridetwin: {message}", file=sys.stderr, flush=True)


def _print(line: str) -> None:
    """Prints a row of estimates on stdout, at once."""
    print(line, flush=True)
