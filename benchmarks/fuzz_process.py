"""The process that `benchmarks.fuzzing` starts: one target under Atheris, until its CPU time is over.

It is a process of its own, because libFuzzer never returns, and because a crash in native code ends it.
"""

from __future__ import annotations

import importlib
import json
import os
import random
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import atheris

if TYPE_CHECKING:
    from benchmarks.fuzz_judge import Finding, Limits
    from benchmarks.fuzz_mutators import Members
    from benchmarks.fuzz_targets import Target

_ROOT = Path(__file__).resolve().parents[1]
"""Folder of the project."""
_STATE_EVERY_S = 2.0
"""CPU time between two writings of the counts, s."""
_COMPILED = ("numba", "entry_kernel", "INNER_KERNEL")
"""What modules of compiled functions contain; numba cannot compile instrumented ones."""


@dataclass
class State:
    """Counts of a run, which the parent reads.

    Attributes:
        executions: Inputs that were opened.
        cpu_s: CPU time of the process, s.
        findings: By place: how often.
    """

    executions: int = 0
    cpu_s: float = 0.0
    findings: dict[str, int] = field(default_factory=dict)


def main(name: str, seconds: str, folder: str, corpus: str, findings: str) -> None:
    """Fuzzes a target for a CPU time; the rest of a crashed input stays in `folder`/current.

    Args:
        name: The target.
        seconds: CPU time after the seeds, s.
        folder: For the files of inputs, and for `state.json`.
        corpus: Folder of the corpus, which grows.
        findings: Folder to which findings are written.
    """
    with atheris.instrument_imports(include=["stridetwin"], exclude=_list_uninstrumented()):
        targets = importlib.import_module("benchmarks.fuzz_targets")
    run = _Run(targets.TARGETS[name], float(seconds), Path(folder), Path(findings))
    run.open_seeds(Path(folder) / "seeds")
    dictionary = Path(folder) / "words.txt"
    targets.write_dictionary(dictionary)
    options = ["-max_len=300000", "-timeout=300", "-rss_limit_mb=0", "-detect_leaks=0", "-print_final_stats=1"]
    options += [f"-dict={dictionary}", f"-artifact_prefix={folder}/", corpus, f"{folder}/seeds"]
    atheris.Setup([sys.argv[0], *options], run.open_input, custom_mutator=run.mutate, custom_crossover=run.cross)
    atheris.Fuzz()


def _list_uninstrumented() -> list[str]:
    """Modules of the project that are not instrumented: those outside of `streams`, and those of compiled functions."""
    modules = []
    for file in _ROOT.glob("*/**/*.py"):
        parts = file.relative_to(_ROOT).with_suffix("").parts
        if parts[0] != "streams" or any(mark in file.read_text() for mark in _COMPILED):
            name = ".".join(part for part in parts if part != "__init__")
            modules.append(f"stridetwin.{name}")
    return modules


class _Run:
    """One target: opens inputs, counts, and writes findings."""

    def __init__(self, target: Target, seconds: float, folder: Path, findings: Path) -> None:
        from benchmarks import fuzz_judge, fuzz_mutators, fuzz_targets

        self._judge, self._mutators = fuzz_judge, fuzz_mutators
        self._target, self._seconds, self._folder, self._findings = target, seconds, folder, findings
        self._vocabulary = fuzz_targets.list_words()
        self._limits: Limits = fuzz_judge.Limits()
        self._state = State()
        self._start_s = self._written_s = 0.0

    def open_seeds(self, folder: Path) -> None:
        """Writes the seeds to a folder, opens each twice, and sets the limits by the second time."""
        folder.mkdir(exist_ok=True)
        costs = []
        for name, members in self._target.list_seeds(self._folder):
            (folder / name.replace("/", "_")).write_bytes(self._mutators.pack(members))
            for _ in range(2):
                finding, cost = self._judge.judge(self._target, members, self._folder, self._limits)
            costs.append(cost)
            if finding is not None:
                self._report(finding, members)
        self._limits = self._judge.measure_limits(costs)
        self._judge.limit_address_space()
        self._start_s = time.process_time()

    def open_input(self, data: bytes) -> int:
        """Opens an input of libFuzzer; returns -1, which keeps it out of the corpus, for bytes that are none."""
        members = self._mutators.unpack(data)
        if members is None:
            return -1
        (self._folder / "current").write_bytes(data)
        finding, _ = self._judge.judge(self._target, members, self._folder, self._limits)
        self._state.executions += 1
        if finding is not None:
            self._report(finding, members)
        self._keep_state()
        return 0

    def mutate(self, data: bytes, max_size: int, seed: int) -> bytes:
        """A changed input, of at most `max_size` bytes."""
        members = self._mutators.unpack(data)
        if members is None:
            return data
        rng = random.Random(seed)
        changed = self._mutators.pack(self._mutators.mutate(members, rng, self._vocabulary, _change_bytes))
        return changed if len(changed) <= max_size else data

    def cross(self, first: bytes, second: bytes, max_size: int, seed: int) -> bytes:
        """An input with parts of two, of at most `max_size` bytes."""
        pair = self._mutators.unpack(first), self._mutators.unpack(second)
        if pair[0] is None or pair[1] is None:
            return first
        crossed = self._mutators.pack(self._mutators.cross(pair[0], pair[1], random.Random(seed)))
        return crossed if len(crossed) <= max_size else first

    def _report(self, finding: Finding, members: Members) -> None:
        """Counts a finding, and writes the first input of each place, minimised."""
        count = self._state.findings.get(key := f"{finding.kind}: {finding.place}", 0)
        self._state.findings[key] = count + 1
        if count:
            return
        members = self._judge.minimise(members, self._repeats(finding))
        folder = self._findings / f"{self._target.name}-{finding.kind}-{len(self._state.findings):03d}"
        folder = folder.with_name(f"{folder.name}-{os.getpid()}")
        (folder / "input").mkdir(parents=True, exist_ok=True)
        (folder / "packed").write_bytes(self._mutators.pack(members))
        (folder / "finding.txt").write_text(f"{key}\n{finding.details}\n", errors="backslashreplace")
        self._mutators.write_members(folder / "input", members)

    def _repeats(self, finding: Finding) -> Callable[[Members], bool]:
        """A function that says whether an input gives the same finding."""

        def is_same(members: Members) -> bool:
            """Whether it has a finding of the same kind at the same place."""
            again, _ = self._judge.judge(self._target, members, self._folder, self._limits)
            return again is not None and (again.kind, again.place) == (finding.kind, finding.place)

        return is_same

    def _keep_state(self) -> None:
        """Writes the counts now and then, and ends the process when its CPU time is over."""
        cpu_s = time.process_time()
        is_over = cpu_s > self._start_s + self._seconds
        if is_over or cpu_s > self._written_s + _STATE_EVERY_S:
            self._written_s = self._state.cpu_s = cpu_s
            (self._folder / "state.json").write_text(json.dumps(asdict(self._state)))
        if is_over:
            os._exit(0)  # libFuzzer has written the corpus


def _change_bytes(data: bytes) -> bytes:
    """Bytes changed by libFuzzer's own mutators, some of which take words of the dictionary."""
    return bytes(atheris.Mutate(data, len(data) + 64)) if data else b"0"


if __name__ == "__main__":
    main(*sys.argv[1:])
