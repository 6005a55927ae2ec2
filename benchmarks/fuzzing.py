"""Coverage-guided fuzzing of all readers: tables, calibration files, trajectories, bags and folders.

It needs Atheris (https://github.com/google/atheris), which is no dependency of the project: `pip install
atheris==3.0.0`, on Linux with Python 3.11 to 3.13. Inputs are opened as a user opens them, strictly and leniently. An
error or warning of one line is right. Findings are any other exception, a text that is no line, more than 10 times the
CPU time of the slowest seed (at least 1 s), and more than 4 times its memory (at least 200 MiB); a small input of each
is written to `--findings`, and `--replay` opens it again.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
import tempfile
from argparse import Namespace
from pathlib import Path
from typing import Any

from benchmarks.command import answer, command
from benchmarks.fuzz_judge import Limits, can_measure_growth, judge
from benchmarks.fuzz_mutators import unpack
from benchmarks.fuzz_targets import ROOT, TARGETS
from stridetwin.streams.errors import ConfigError, StrideTwinError

ATHERIS = "3.0.0"
"""The version that was used; newer ones may have other options."""
SECONDS = 720.0
"""CPU time of each target after its seeds by default, s: an hour for all five."""
_STATUS = re.compile(r"cov: (\d+) ft: (\d+) corp: (\d+)")
"""Edges, features and inputs in a line of libFuzzer, as `#2048 NEW cov: 931 ft: 2210 corp: 87/31Kb`."""
_MEMORY = Path("/dev/shm")
"""Folder in memory, where there is one: inputs are many small files."""


def fuzz_targets(arguments: Namespace) -> dict[str, Any]:
    """Fuzzes the targets of the command line one after the other.

    Returns:
        `summary` with executions, CPU time, coverage and findings by target, and the places of all findings.

    Raises:
        StrideTwinError: Atheris is not installed, or `--replay` is no saved input.
    """
    if arguments.replay is not None:
        return {"replay": _replay(arguments.replay)}
    if importlib.util.find_spec("atheris") is None:
        raise StrideTwinError(f"atheris is not installed; fuzzing needs it: pip install atheris=={ATHERIS}")
    if not can_measure_growth():
        print("the peak of memory cannot be reset here: inputs that take much memory may be missed", file=sys.stderr)
    findings = arguments.findings.resolve()  # the processes run in another folder
    findings.mkdir(parents=True, exist_ok=True)
    summary, places = {}, {}
    for name in arguments.only or TARGETS:
        with tempfile.TemporaryDirectory(dir=_MEMORY if _MEMORY.is_dir() else None) as folder:
            corpus = Path(folder) / "corpus" if arguments.corpus is None else arguments.corpus.resolve() / name
            corpus.mkdir(parents=True, exist_ok=True)
            summary[name], places[name] = _fuzz_target(name, arguments.seconds, Path(folder), corpus, findings)
        print(f"{name:12s} {json.dumps(summary[name])}", file=sys.stderr, flush=True)
    return {"benchmark": "fuzzing", "summary": summary, "findings": places}


def _fuzz_target(
    name: str, seconds: float, folder: Path, corpus: Path, findings: Path
) -> tuple[dict[str, float], dict[str, int]]:
    """Fuzzes a target, with another process after each crash, until its CPU time is over.

    Args:
        name: The target.
        seconds: CPU time, s.
        folder: For files of the processes.
        corpus: Of inputs, which grows.
        findings: For inputs with findings.

    Returns:
        Figures, and how often each place was met.
    """
    figures = {"executions": 0.0, "cpu_s": 0.0, "edges": 0.0, "features": 0.0, "corpus": 0.0, "crashes": 0.0}
    places: dict[str, int] = {}
    while figures["cpu_s"] < seconds:
        (folder / "state.json").unlink(missing_ok=True)
        rest_s = str(seconds - figures["cpu_s"])
        arguments = [sys.executable, "-m", "benchmarks.fuzz_process", name, rest_s]
        arguments += [str(folder), str(corpus), str(findings)]
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
        with (folder / "log.txt").open("wb") as log:
            code = subprocess.run(arguments, stderr=log, stdout=log, env=environment, cwd=ROOT).returncode
        log_text = (folder / "log.txt").read_text(errors="replace")
        state = _read_state(folder / "state.json")
        figures["executions"] += state["executions"]
        figures["cpu_s"] = round(figures["cpu_s"] + max(state["cpu_s"], 1.0), 1)
        for status in _STATUS.findall(log_text)[-1:]:
            figures |= dict(zip(("edges", "features", "corpus"), map(float, status)))
        for place, count in state["findings"].items():
            places[place] = places.get(place, 0) + count
        if code:
            figures["crashes"] += 1
            places[place] = places.get(place := f"crash: exit code {code}", 0) + 1
            _save_crash(name, folder, findings / f"{name}-crash-{int(figures['crashes']):03d}", log_text)
            if not state["executions"]:
                break  # it would crash again
    return {**figures, "findings": float(len(places))}, places


def _read_state(file: Path) -> dict[str, Any]:
    """The counts that a process has written; zeros if it has not come so far."""
    empty = {"executions": 0, "cpu_s": 0.0, "findings": {}}
    return {**empty, **json.loads(file.read_text())} if file.is_file() else empty


def _save_crash(name: str, folder: Path, place: Path, log: str) -> None:
    """Saves the input of a process that crashed, and the end of its log.

    Args:
        name: The target.
        folder: Of the process, with the input in `current`.
        place: Folder to write.
        log: What the process has printed.
    """
    place.mkdir(parents=True, exist_ok=True)
    (place / "finding.txt").write_text(f"crash of {name}\n{log[-6000:]}\n")
    if (folder / "current").is_file():
        (place / "packed").write_bytes((folder / "current").read_bytes())


def _replay(place: Path) -> str:
    """What a saved input gives now: `nothing`, or the finding.

    Raises:
        ConfigError: It is no saved input.
    """
    file = place / "packed" if place.is_dir() else place
    members = unpack(file.read_bytes()) if file.is_file() else None
    name = place.name.partition("-")[0]
    if members is None or name not in TARGETS:
        raise ConfigError("fuzzing", "--replay", str(place), "a folder that --findings has")
    with tempfile.TemporaryDirectory() as folder:
        finding, cost = judge(TARGETS[name], members, Path(folder), Limits())
    took = f"{cost.cpu_s:.2f} s, {cost.growth_bytes >> 20} MiB"
    return f"nothing ({took})" if finding is None else f"{finding.kind}: {finding.place} ({took})\n{finding.details}"


def main() -> int:
    """Runs the benchmark."""
    parser = command(__doc__)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="CPU time of each target, s")
    parser.add_argument("--only", nargs="+", choices=list(TARGETS), help="targets to fuzz")
    parser.add_argument("--corpus", type=Path, help="folder of inputs, which a later run continues")
    parser.add_argument(
        "--findings", type=Path, default=Path("runs/fuzz_findings"), help="folder for inputs with findings"
    )
    parser.add_argument("--replay", type=Path, help="open a saved input again in place of fuzzing")
    return answer(parser, fuzz_targets, _show)


def _show(result: dict[str, Any]) -> None:
    """Prints the figures of each target, then the places of the findings."""
    if "replay" in result:
        print(result["replay"])
        return
    for name, figures in result["summary"].items():
        print(f"{name:12s} " + " ".join(f"{key} {value:g}" for key, value in figures.items()))
        for place, count in sorted(result["findings"][name].items(), key=lambda item: -item[1]):
            print(f"  {count:6d} x {place}")


if __name__ == "__main__":
    sys.exit(main())
