"""Do two versions of the code give the same figures?

`python tools/same_numbers.py record FOLDER [--only NAME ...]` runs the jobs below with the installed version and writes
one JSON file per job; an existing file is kept. `python tools/same_numbers.py compare BEFORE AFTER` prints one line per
job and exits with 1 where a figure differs. A figure that only AFTER has is counted as new. Timings are left out, and
`RENAMED` maps the keys of older versions.
"""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
import tempfile
from argparse import ArgumentParser
from collections.abc import Iterator
from pathlib import Path
from typing import Any

BIN = Path(sys.executable).parent
STRIDETWIN = (str(BIN / "stridetwin"),)
EXPERIMENTS = {"shim_table5": 6, "jao_simulation": 100, "zhao_closed_loop": 2, "zhao_generality": 6, "terrain_zoo": 4}
DEMO_SEEDS = range(1, 4)
TIMINGS = ("_ms", "real_time", "_s_per", "seconds", "cpu", "rate_x", "latency")  # parts of the names of timings
RENAMED = {
    "stridetwin": "proposed",
    "told_rmse": "all_rmse",
    "told": "predicted",
    "single_picture": "single_image",
    **{f"told_{name}": f"estimated_{name}" for name in ("elevation", "mode", "place", "probability", "slope")},
}
"""The key or word of an older version: today's."""
IGNORED = ("key", "version", "folder", "recording")


def jobs() -> list[str]:
    """Names of all jobs."""
    return ["foot_ins_real", *(f"demo_{seed}" for seed in DEMO_SEEDS), *EXPERIMENTS]


def run(name: str, folder: Path) -> Any:
    """The figures of one of `jobs()`, which uses the folder for its files."""
    if name == "foot_ins_real":
        command = (sys.executable, "-m", "benchmarks.foot_ins_real", "--json")
        return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    if name.startswith("demo_"):
        seed = name.removeprefix("demo_")
        _quietly(*STRIDETWIN, "run", "demo", "--seed", seed, "--no-film", "-o", str(folder))
        return json.loads((folder / "scores.json").read_text(encoding="utf-8"))
    command = (*STRIDETWIN, "experiment", name, "--subset", str(EXPERIMENTS[name]), "--physics", "kinematic", "--json")
    return json.loads(_quietly(*command, "--workers", "2", "-o", str(folder)))


def _quietly(*command: str) -> str:
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True).stdout


def record(target: Path, only: list[str]) -> None:
    """Runs the jobs whose file does not exist yet."""
    target.mkdir(parents=True, exist_ok=True)
    for name in only or jobs():
        file = target / f"{name}.json"
        if file.exists():
            continue
        scratch = Path(tempfile.mkdtemp(prefix="same_numbers_"))
        try:
            figures = run(name, scratch / name)
        finally:
            shutil.rmtree(scratch)
        file.write_text(json.dumps(figures, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        print(f"{name}: recorded", flush=True)


def figures_of(value: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every leaf of a JSON value with its path, under today's keys, without timings."""
    if isinstance(value, dict):
        for key, inner in value.items():
            key = RENAMED.get(key, key)
            if key not in IGNORED and not any(part in key for part in TIMINGS):
                yield from figures_of(inner, (*path, key))
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from figures_of(inner, (*path, str(i)))
    else:
        yield path, RENAMED.get(value, value) if isinstance(value, str) else value


def _relative(old: Any, new: Any) -> float:
    """Difference of two figures over the larger of them; infinite where they are not two numbers."""
    if not isinstance(old, int | float) or not isinstance(new, int | float):
        return math.inf
    return float(abs(old - new) / max(abs(old), abs(new)))


def compare(before: Path, after: Path) -> bool:
    """Prints which jobs agree; true where all do."""
    same = True
    for file in sorted(before.glob("*.json")):
        other = after / file.name
        if not other.exists():
            print(f"{file.stem}: missing in {after}")
            same = False
            continue
        old, new = (dict(figures_of(json.loads(f.read_text(encoding="utf-8")))) for f in (file, other))
        unequal = [path for path in old if old[path] != new.get(path, ...)]
        largest = max((_relative(old.get(path), new.get(path)) for path in unequal), default=0.0)
        print(
            f"{file.stem}: {len(old)} figures, {len(unequal)} differ, by {largest:.1e} of the larger value at most; "
            f"{len(new.keys() - old.keys())} are new"
        )
        for path in sorted(unequal)[:10]:
            print(f"  {'.'.join(path)}: {old.get(path, 'missing')} -> {new.get(path, 'missing')}")
        same = same and not unequal
    return same


def main() -> int:
    """Runs the command."""
    parser = ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    recording = commands.add_parser("record")
    recording.add_argument("folder", type=Path)
    recording.add_argument("--only", nargs="+", default=[], choices=jobs())
    comparing = commands.add_parser("compare")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "record":
        record(arguments.folder, arguments.only)
        return 0
    return 0 if compare(arguments.before, arguments.after) else 1


if __name__ == "__main__":
    sys.exit(main())
