"""CPU time of Numba's compilation with an empty cache, by package and by function that Python calls.

`python -m benchmarks.compile_time [PART ...] [--recording FILE] [--json]` records a short walk with every sensor, then
runs each part on it, by the commands of the command line, in a process of its own whose cache is empty: `walk` records
the walk, any other part is an estimator. Without a part all of them are run. A function that several others call counts
for the first; each process compiles it anew, but the total counts it once. Rendering runs in further processes, which
are not measured.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from collections import defaultdict
from pathlib import Path
from typing import Any

from benchmarks.command import answer, command
from stridetwin.streams.errors import ConfigError

WALK = "walk"
ESTIMATORS = ("foot_ins", "foot_to_foot", "contact_terrain", "dvio", "terrain_map", "locomotion_mode")
SCENARIO = """description: level ground, a stair, level ground
terrain:
  - level: {length_m: 2.5}
  - stairs: {risers: 4, riser_mm: 165, tread_mm: 290, direction: up}
  - level: {length_m: 2.5}
"""
_OUTPUTS = {"contact_terrain": ".csv", "locomotion_mode": ".csv", "terrain_map": ".json"}
_MEASURED = "import sys; from benchmarks.compile_time import run_measured; sys.exit(run_measured(*sys.argv[1:]))"
_PLAIN = "import sys; from stridetwin.cli.main import main; sys.exit(main(sys.argv[1:]))"


def run_measured(result: str, *arguments: str) -> int:
    """Runs a command in this process and writes the seconds of each compiled function to a JSON file."""
    from numba.core import event

    from stridetwin.cli.main import main

    seconds, started = defaultdict[str, float](float), list[float]()

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            started.append(time.process_time())

        def on_end(self, event: Any) -> None:
            spent, function = time.process_time() - started.pop(), event.data["dispatcher"].py_func
            if not started:  # not within another function's compilation
                seconds[f"{function.__module__.removeprefix('stridetwin.')}.{function.__qualname__}"] += spent

    event.register("numba:compile", Listener())
    code = main(arguments)
    Path(result).write_text(json.dumps(seconds))
    return code


def _compiled_by(folder: Path, arguments: list[str]) -> dict[str, float]:
    """Seconds by function of a command that starts with an empty cache."""
    with tempfile.TemporaryDirectory(dir=folder) as cache:
        result = folder / "seconds.json"
        subprocess.run(
            [sys.executable, "-c", _MEASURED, str(result), *arguments],
            env=os.environ | {"NUMBA_CACHE_DIR": cache},
            stdout=subprocess.DEVNULL,
            check=True,
        )
        return dict(json.loads(result.read_text()))


def measure(arguments: Namespace) -> dict[str, Any]:
    """Seconds by part and function."""
    parts = arguments.part or [WALK, *ESTIMATORS]
    for part in parts:
        if part not in (WALK, *ESTIMATORS):
            raise ConfigError("compile_time", "PART", part, ", ".join((WALK, *ESTIMATORS)))
    seconds_by_command: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "short.yaml").write_text(SCENARIO)
        recorded = arguments.recording or folder / "walk.mcap"
        generate = ["generate", str(folder / "short.yaml"), "-o"]
        if WALK in parts:
            seconds_by_command[WALK] = _compiled_by(folder, [*generate, str(folder / "measured.mcap"), "--no-cameras"])
        if arguments.recording is None and parts != [WALK]:
            run = [sys.executable, "-c", _PLAIN, *generate, str(recorded)]
            subprocess.run(run, stdout=subprocess.DEVNULL, check=True)
        for part in parts:
            if part != WALK:
                output = str(folder / f"{part}{_OUTPUTS.get(part, '.txt')}")
                seconds_by_command[part] = _compiled_by(folder, ["estimate", part, str(recorded), "-o", output])
    once = {name: seconds for functions in seconds_by_command.values() for name, seconds in functions.items()}
    return {"seconds": seconds_by_command, "total": sum(once.values())}


def show(result: dict[str, Any]) -> None:
    """Prints the costliest function first, and totals."""
    for part, functions in result["seconds"].items():
        packages = defaultdict[str, float](float)
        print(f"{part}: {sum(functions.values()):.1f} s")
        for name, seconds in sorted(functions.items(), key=lambda item: -item[1]):
            packages[".".join(name.split(".")[:2])] += seconds
            print(f"  {seconds:6.2f}  {name}")
        print("  " + ", ".join(f"{name} {seconds:.1f}" for name, seconds in packages.items()))
    print(f"all: {result['total']:.1f} s of CPU time")


if __name__ == "__main__":
    parser = command(__doc__)
    parser.add_argument("part", nargs="*", help=f"{WALK} or an estimator; all by default")
    parser.add_argument("--recording", type=Path, help="an existing recording in place of the short walk")
    raise SystemExit(answer(parser, measure, show))
