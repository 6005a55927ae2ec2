"""How fast the twin walks and records, against real time.

`python -m benchmarks.twin_speed [--json]` measures, on the scenario `demo`:

- `kinematic_one_core`: everything but the cameras, on one core;
- `whole_rig`: every sensor at its rate (RGB-D 30 Hz, both shoe cameras 60 Hz), on all cores;
- `whole_rig_faults`: the same with every fault of `demo_faults`;
- `whole_rig_dynamic`: and simulated with contacts.

Planning the walk and writing the recording count in all of them; the first is the median of three runs.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from stridetwin.scenarios.record import record
from stridetwin.scenarios.runner import without_cameras
from stridetwin.scenarios.scenario_file import Scenario, load_scenario
from stridetwin.sim.twin import Twin

ASKED = {"kinematic_one_core": 20.0, "whole_rig": 1.5, "whole_rig_faults": 1.5, "whole_rig_dynamic": 1.0}
SEED = 1


def measure(scenario: Scenario) -> dict[str, float]:
    """Seconds of walk, wall-clock seconds and their ratio."""
    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        twin = Twin(scenario.config, SEED)
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


def summary() -> dict[str, dict[str, float]]:
    """What is measured, by name."""
    demo = load_scenario("demo")
    faults = replace(demo, config=replace(demo.config, faults=load_scenario("demo_faults").config.faults))
    dynamic = replace(faults, config=replace(faults.config, physics="dynamic"))
    cores = os.sched_getaffinity(0)
    measure(without_cameras(load_scenario("level_20m")))  # imports and caches
    os.sched_setaffinity(0, {min(cores)})
    runs = sorted((measure(without_cameras(demo)) for _ in range(3)), key=lambda run: run["times_real_time"])
    os.sched_setaffinity(0, cores)
    whole = {"whole_rig": demo, "whole_rig_faults": faults, "whole_rig_dynamic": dynamic}
    return {"kinematic_one_core": runs[1], **{name: measure(scenario) for name, scenario in whole.items()}}


def main() -> None:
    """Prints the table, or one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    as_json = parser.parse_args().json
    measured = summary()
    if as_json:
        print(json.dumps({"experiment": "twin_speed", "summary": measured, "paper": {}, "cases": []}))
        return
    for name, row in measured.items():
        print(f"{name:20} {row['walk_s']:6.1f} s walked in {row['wall_s']:6.1f} s: "
              f"{row['times_real_time']:6.2f} x real time (asked {ASKED[name]}), "
              f"{row['megabyte_per_s']:.1f} MB/s")  # fmt: skip


if __name__ == "__main__":
    main()
