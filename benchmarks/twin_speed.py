"""How fast the twin walks and records, against real time.

`python -m benchmarks.twin_speed [--json]` measures, on the scenario `demo`:

- `kinematic_one_core`: everything but the cameras, on one core, recording written;
- `full_suite`: every sensor at its rate (RGB-D 30 Hz, both shoe cameras 60 Hz), on all cores, recording written.

Planning the walk counts in both; the first is the median of three runs.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

from stridetwin.scenarios.runner import record, without_cameras
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.twin import Twin

FLOOR = {"kinematic_one_core": 20.0, "full_suite": 0.5}


def measure(scenario_name: str, cameras: bool, seed: int = 1) -> dict[str, float]:
    """Seconds of walk, wall-clock seconds and their ratio."""
    scenario = load_scenario(scenario_name)
    if not cameras:
        scenario = without_cameras(scenario)
    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        twin = Twin(scenario.config, seed)
        path = Path(folder) / "recording.mcap"
        record(twin, path, lambda *_: None)
        wall = time.perf_counter() - started
        size = path.stat().st_size
    walked = twin.duration_s
    return {
        "walk_s": walked,
        "wall_s": wall,
        "times_real_time": walked / wall,
        "megabyte_per_s": size / walked / 1e6,
    }


def main() -> None:
    """Prints the table, or one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    as_json = parser.parse_args().json
    cores = os.sched_getaffinity(0)
    measure("level_20m", cameras=False)  # imports and caches
    os.sched_setaffinity(0, {min(cores)})
    runs = sorted((measure("demo", cameras=False) for _ in range(3)), key=lambda run: run["times_real_time"])
    summary = {"kinematic_one_core": runs[1]}
    os.sched_setaffinity(0, cores)
    summary["full_suite"] = measure("demo", cameras=True)
    if as_json:
        print(json.dumps({"experiment": "twin_speed", "summary": summary, "paper": {}, "cases": []}))
        return
    for name, row in summary.items():
        print(f"{name:20} {row['walk_s']:6.1f} s walked in {row['wall_s']:6.1f} s: "
              f"{row['times_real_time']:6.2f} x real time (floor {FLOOR[name]}), "
              f"{row['megabyte_per_s']:.1f} MB/s")  # fmt: skip


if __name__ == "__main__":
    main()
