"""Judges one input of the fuzzer: tracebacks, texts that are no line, slowness and large memory are findings."""

from __future__ import annotations

import contextlib
import re
import resource
import shutil
import signal
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.fuzz_mutators import Members, write_members
from benchmarks.fuzz_targets import Target
from stridetwin.streams.errors import StrideTwinError

LEAST_S, TIMES_S = 1.0, 10.0
"""CPU time of an input that is always allowed, s, and up to how many times that of the slowest seed is."""
LEAST_BYTES, TIMES_BYTES = 200 << 20, 4.0
"""Growth of memory that is always allowed, bytes, and up to how many times that of the largest seed is."""
_HARD_BYTES = 6 << 30
"""Address space that a process may have beyond that at its start, bytes; beyond it Python raises MemoryError."""
_MINIMISE_S = 5.0
"""CPU time spent on making an input smaller, s."""
_LONGEST_TEXT = 4000
"""Longest line that a user may get, characters: a list of many names fits."""
_CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f-\x9f\u2028\u2029]")
"""Marks that break a line, or that a terminal obeys; a tab is not one of them."""


@dataclass(frozen=True)
class Finding:
    """What is wrong with an input.

    Attributes:
        kind: `traceback`, `text`, `slow` or `memory`.
        place: Where: the type of the exception and the innermost line of ours, or the text without numbers.
        details: The whole traceback, text or figure.
    """

    kind: str
    place: str
    details: str


@dataclass(frozen=True)
class Limits:
    """What an input may take.

    Attributes:
        cpu_s: CPU time, s.
        growth_bytes: Growth of the resident memory, bytes.
    """

    cpu_s: float = 60.0
    growth_bytes: int = 4 << 30


@dataclass(frozen=True)
class Cost:
    """What an input took.

    Attributes:
        cpu_s: CPU time, s.
        growth_bytes: Growth of the resident memory at its peak, bytes.
    """

    cpu_s: float
    growth_bytes: int


class _SlowError(BaseException):
    """An input took more CPU time than allowed."""


def judge(target: Target, members: Members, folder: Path, limits: Limits) -> tuple[Finding | None, Cost]:
    """Opens an input as a user does.

    Args:
        target: Its kind.
        members: The input.
        folder: Where its files are written; emptied before and after.
        limits: What it may take.

    Returns:
        What is wrong with it, None for nothing; and what it took.
    """
    place = folder / "input"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    finding: Finding | None = None
    source = write_members(place, members)
    before_bytes = _reset_peak()
    start_s = time.process_time()
    try:
        with _limit_cpu_time(limits.cpu_s), warnings.catch_warnings():
            warnings.simplefilter("error")
            texts = target.open(source, members)
        finding = _judge_texts(texts)
    except _SlowError as error:
        finding = Finding(
            "slow", _find_place(error), f"more than {limits.cpu_s:.1f} s of CPU time\n{_format_traceback(error)}"
        )
    except StrideTwinError as error:
        finding = _judge_texts(str(error).split("\n"))
    except Exception as error:
        finding = Finding("traceback", f"{type(error).__name__} {_find_place(error)}", _format_traceback(error))
    cost = Cost(time.process_time() - start_s, _read_peak() - before_bytes)
    shutil.rmtree(place, ignore_errors=True)
    if finding is None and cost.growth_bytes > limits.growth_bytes:
        text = f"{cost.growth_bytes >> 20} MiB more than before, of {limits.growth_bytes >> 20}"
        finding = Finding("memory", "-".join(sorted({name.rpartition(".")[2] for name in members})), text)
    return finding, cost


def measure_limits(costs: list[Cost]) -> Limits:
    """What inputs may take, from the costs of the seeds."""
    return Limits(
        max(LEAST_S, TIMES_S * max(cost.cpu_s for cost in costs)),
        max(LEAST_BYTES, int(TIMES_BYTES * max(cost.growth_bytes for cost in costs))),
    )


def minimise(members: Members, is_same: Callable[[Members], bool], budget_s: float = _MINIMISE_S) -> Members:
    """A smaller input with the same finding: fewer files, then fewer lines, then shorter ends.

    Args:
        members: The input.
        is_same: Whether an input has the same finding.
        budget_s: CPU time, s.
    """
    end_s = time.process_time() + budget_s
    for name in list(members):
        less = {n: data for n, data in members.items() if n != name}
        if less and time.process_time() < end_s and is_same(less):
            members = less
    for name in list(members):
        is_binary = b"\0" in members[name]
        parts = [members[name]] if is_binary else members[name].split(b"\n")
        size = max(1, len(parts) // 2)
        while size and not is_binary and time.process_time() < end_s:
            at = 0
            while at < len(parts) and time.process_time() < end_s:
                less = {**members, name: b"\n".join(parts[:at] + parts[at + size :])}
                if is_same(less):
                    members, parts = less, parts[:at] + parts[at + size :]
                else:
                    at += size
            size //= 2
    return members


def limit_address_space() -> None:
    """Lets this process take `_HARD_BYTES` more than now."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + _HARD_BYTES, resource.RLIM_INFINITY))


def _judge_texts(texts: list[str]) -> Finding | None:
    """The first text that is no line, cannot be printed or is too long; None if all are lines."""
    for text in texts:
        reason = ""
        try:
            text.encode()
        except UnicodeEncodeError:
            reason = "cannot be printed"
        if mark := _CONTROL.search(text):
            reason = f"has the mark {mark.group()!r}"
        if len(text) > _LONGEST_TEXT:
            reason = f"has {len(text)} characters"
        if reason:
            kept = re.sub(r"\d+", "", re.sub(r"/\S*", "", ascii(text)))  # without paths and numbers, which differ
            return Finding("text", f"{reason.split()[0]} {kept[:60]}", f"a text that {reason}: {text[:2000]!r}")
    return None


def _find_place(error: BaseException) -> str:
    """The innermost line of the project in a traceback, or the innermost of all: file, function and line."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "/stridetwin/" in frame.filename]
    last = (ours or frames)[-1]
    return f"{last.filename.rpartition('/stridetwin/')[2]}:{last.name}:{last.lineno}"


def _format_traceback(error: BaseException) -> str:
    """The traceback of an exception as text, without its first lines if it is long."""
    return "".join(traceback.format_exception(error))[-6000:]


@contextlib.contextmanager
def _limit_cpu_time(cpu_s: float) -> Iterator[None]:
    """Raises `_SlowError` inside it after CPU time of `cpu_s`, and again every second, where it was swallowed."""

    def ring(*_: object) -> None:
        """Ends the input, as the handler of the signal."""
        raise _SlowError

    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, cpu_s, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def can_measure_growth() -> bool:
    """Whether the system lets a process forget its former peak of memory; some containers do not.

    Where it does not, `judge` sees only what grows beyond the former peak. Found by a peak that is made for it.
    """
    np.ones(8 << 20)  # 64 MiB, given back at once
    return _read_peak() - _reset_peak() > 32 << 20


def _reset_peak() -> int:
    """Sets the peak of the resident memory to what it is now, where that can be done; returns the peak, bytes."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return _read_peak()


def _read_peak() -> int:
    """The peak of the resident memory since `_reset_peak`, bytes."""
    status = Path("/proc/self/status").read_text()
    return int(re.search(r"VmHWM:\s*(\d+)", status)[1]) << 10  # type: ignore[index]
