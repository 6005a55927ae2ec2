"""Robustness of a recording to SIGKILL at random times during `generate`.

`python -m benchmarks.kills [--kills 200] [--json]` kills `stridetwin generate` on a short walk without cameras at
random times, and checks that

- a recording under the final name is complete;
- the file under the hidden name is readable (`--lenient`) up to its last complete chunk, sample for sample;
- another `generate` completes, with the bytes of an undisturbed one.

Each `generate` runs in a forked child with the walk already planned: imports and planning, which write nothing, take
none of its run time.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from unittest import mock

import numpy as np
from mcap.reader import make_reader

from stridetwin.cli.main import main as stridetwin
from stridetwin.report import runner
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.streams.files import partial_path
from stridetwin.streams.recording.index import RecordingIndex
from stridetwin.streams.recording.reader import Recording

SHORT = """
description: a few steps
terrain:
  - level: {length_m: 4}
gait: {stand_s: 2}
sensors: [foot_imu, insole, sonar, ahrs, head_imu]
"""


def start(arguments: Sequence[str]) -> int:
    """Runs a command in a forked child, without its output; returns the process id."""
    child = os.fork()
    if child == 0:
        code = 70
        with suppress(BaseException):
            silent = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silent, 1)
            os.dup2(silent, 2)
            code = stridetwin(arguments)
        os._exit(code)
    return child


def generate(scenario: Path, recording: Path, kill_after_s: float | None = None) -> int | None:
    """Runs `generate` in a child process.

    Args:
        scenario: Walk to record.
        recording: Output file.
        kill_after_s: When to kill it; None lets it finish.

    Returns:
        Its exit code, None if it was killed.
    """
    child = start(["generate", str(scenario), "-o", str(recording)])
    if kill_after_s is not None:
        time.sleep(kill_after_s)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return None if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)


def whole_chunks(partial: Path, whole: Path) -> int:
    """Number of chunks of an undisturbed recording that a killed one holds.

    Raises:
        AssertionError: The killed one is not a prefix of the undisturbed one, or is not readable up to its last chunk.
    """
    data = partial.read_bytes()
    assert whole.read_bytes().startswith(data), "not a piece of the whole recording"
    if not data:
        return 0  # killed between opening the file and its first byte
    with whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    there = {c.chunk_start_offset for c in summary.chunk_indexes if c.chunk_start_offset + c.chunk_length <= len(data)}
    expected: Counter[str] = Counter()
    for chunk in RecordingIndex(whole, lenient=False).chunks:
        if chunk.offset in there:
            expected.update({topic: part.count for topic, part in chunk.parts.items()})
    read, undisturbed = Recording(partial, lenient=True), Recording(whole)
    assert {t: i.count for t, i in read.topics.items()} == expected, "samples of a whole chunk are missing"
    for topic, count in expected.items():
        a, b = read.block(topic), undisturbed.block(topic)
        assert np.array_equal(a.t_ns, b.t_ns[:count]), topic
        assert all(np.array_equal(a.columns[n], b.columns[n][:count]) for n in a.columns), topic
    return len(there)


def measure(kills: int, seed: int = 0) -> dict[str, float]:
    """Kills the given number of runs; raises AssertionError if a check fails."""
    rng = np.random.default_rng(seed)
    counts = {"kills": 0, "before_the_file": 0, "no_chunk_yet": 0, "some_chunks": 0, "whole": 0, "too_late": 0}
    with tempfile.TemporaryDirectory() as folder:
        scenario, whole, target = (Path(folder) / name for name in ("short.yaml", "whole.mcap", "target.mcap"))
        scenario.write_text(SHORT)
        twin = runner.make_twin(load_scenario(str(scenario)), 0)
        with mock.patch.object(runner, "make_twin", return_value=twin):
            generate(scenario, whole)  # caches
            started = time.perf_counter()
            assert generate(scenario, whole) == 0
            life_s = time.perf_counter() - started
            reference, partial = whole.read_bytes(), partial_path(target)
            while counts["kills"] < kills:
                code = generate(scenario, target, life_s * rng.random())
                assert code in (None, 0), f"generate ended with {code}"
                counts["too_late" if code == 0 else "kills"] += 1
                if code is None:
                    counts[_outcome(target, partial, whole)] += 1
                if target.exists():
                    assert target.read_bytes() == reference, "a recording under its final name is not whole"
                assert generate(scenario, target) == 0, "another generate does not complete"
                assert target.read_bytes() == reference, "another generate gives other bytes"
                assert not partial.exists()
                target.unlink()
        chunks = len(RecordingIndex(whole, lenient=False).chunks)
    return {**counts, "chunks": chunks, "life_s": life_s}


def _outcome(target: Path, partial: Path, whole: Path) -> str:
    if target.exists():
        return "whole"
    if not partial.exists():
        return "before_the_file"
    return "some_chunks" if whole_chunks(partial, whole) else "no_chunk_yet"


def main() -> None:
    """Prints a line, or one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    row = measure(arguments.kills)
    if arguments.json:
        print(json.dumps({"experiment": "kills", "summary": row, "paper": {}, "cases": []}))
        return
    print(
        f"{row['kills']} kills: {row['before_the_file']} before there was a file, {row['no_chunk_yet']} before its "
        f"first chunk, {row['some_chunks']} later, {row['whole']} at the very end; all read up to their last chunk, "
        "and each rerun gave the same bytes"
    )


if __name__ == "__main__":
    main()
