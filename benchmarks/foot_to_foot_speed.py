"""How fast the filter of two feet is with both shoe cameras on one core, and whether its memory stays the same.

`python -m benchmarks.foot_to_foot_speed [--json] [--minutes 5] [--seed 1000]`. The walk `level_20m` with rendered shoe
cameras at 60 Hz, walked once and told again and again, each time later. Time is the processor's: of the filter with the
search for boards alone, and with reading the recording. Memory is the growth of the process's peak from the end of the
first walk to the last.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.command import answer, command, show_summary
from benchmarks.foot_ins_speed import peak_mib
from benchmarks.repeated import again
from stridetwin.estimators.foot_to_foot import FootToFoot
from stridetwin.scenarios.experiments.walks import CAMERAS, IMUS, SHOES, SONARS
from stridetwin.scenarios.record import record
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording import Recording
from stridetwin.streams.samples import Image, Imu, Range

TOPICS = (*IMUS, *CAMERAS, *SONARS)


def figures(walk: Recording, times: int) -> dict[str, float]:
    """Speed and growth of memory over so many repetitions."""
    estimator, spent_s, seen, pictures, before = FootToFoot(walk.rig), 0.0, 0, 0, 0.0
    begin = time.process_time()
    for turn, sample in again(lambda: walk.samples(TOPICS), times, round(walk.duration * 1e9)):
        assert isinstance(sample, Imu | Image | Range)
        if turn == 1 and not before:
            before = peak_mib()
        start = time.process_time()
        estimate = estimator.update(sample)
        spent_s += time.process_time() - start
        pictures += isinstance(sample, Image)
        seen += len(estimate.sightings) if estimate else 0
    whole_s, length_s = time.process_time() - begin, walk.duration * times
    return {
        "times_real_time": length_s / spent_s,
        "with_reading": length_s / whole_s,
        "pictures_a_second": pictures / length_s,
        "boards_seen_pct": 100.0 * seen / pictures,
        "minutes": length_s / 60.0,
        "memory_growth_mib": peak_mib() - before,
    }


def measure(minutes: float, seed: int) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "walk.mcap"
        config = replace(load_scenario("level_20m").config, sensors=SHOES)
        record(Twin(config, seed), path, lambda stage, share: None)
        walk = Recording(path)
        figures(walk, 1)  # compiles
        times = max(2, round(60.0 * minutes / walk.duration))
        return {"experiment": "foot_to_foot_speed", "summary": {"both cameras": figures(walk, times)}}


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--minutes", type=float, default=5.0, help="length of the walk (5)")
    parser.add_argument("--seed", type=int, default=1000, help="of the walk (1000)")
    return answer(parser, lambda a: measure(a.minutes, a.seed), show_summary(24, "8.2f"))


if __name__ == "__main__":
    sys.exit(main())
