"""How long contact terrain takes for the nine samples of one instant, and whether its memory stays the same.

`python -m benchmarks.contact_terrain_speed [--json] [--minutes 5] [--seed 1000]`. The walk `shim_stairs`, kinematic,
walked once and told again and again, each time later. Time is the processor's, on one core. Memory is the growth of the
process's peak from the end of the first walk to the last.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from benchmarks.command import answer, command, show_summary
from benchmarks.foot_ins_speed import peak_mib
from benchmarks.repeated import again
from stridetwin.estimators.base import Options
from stridetwin.estimators.contact_terrain import METHODS, ContactTerrain, Exoskeleton
from stridetwin.scenarios.exo_geometry import geometry
from stridetwin.scenarios.experiments.shim_table5 import SENSORS, walked
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.twin import Twin
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Sample


def figures(exo: Exoskeleton, method: str, samples: Sequence[Sample], times: int) -> dict[str, float]:
    """Time and growth of memory over so many repetitions."""
    estimator, spent_s, before = ContactTerrain(Rig(), options=Options(method=method), exoskeleton=exo), 0.0, 0.0
    instants = len({s.t_ns for s in samples}) * times
    for turn, sample in again(lambda: samples, times, samples[-1].t_ns - samples[0].t_ns + 10_000_000):
        if turn == 1 and not before:
            before = peak_mib()
        start = time.process_time()
        estimator.update(sample)
        spent_s += time.process_time() - start
    return {"ms_per_instant": 1e3 * spent_s / instants, "instants": instants, "memory_growth_mib": peak_mib() - before}


def measure(minutes: float, seed: int) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    config = replace(load_scenario("shim_stairs").config, sensors=SENSORS, physics="kinematic")
    twin = Twin(config, seed)
    samples, _ = walked(twin)
    exo, length_s = geometry(twin.size, twin.rig), 1e-9 * (samples[-1].t_ns - samples[0].t_ns)
    times = max(2, round(60.0 * minutes / length_s))
    summary = {}
    for method in METHODS:
        figures(exo, method, samples, 1)  # compiles
        summary[method] = figures(exo, method, samples, times)
    return {"experiment": "contact_terrain_speed", "summary": summary}


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--minutes", type=float, default=5.0, help="length of the walk (5)")
    parser.add_argument("--seed", type=int, default=1000, help="of the walk (1000)")
    return answer(parser, lambda a: measure(a.minutes, a.seed), show_summary(24, "8.2f"))


if __name__ == "__main__":
    sys.exit(main())
