"""How long the visual-inertial odometry takes for a picture, whether it keeps up, and whether its memory stays.

`python -m benchmarks.dvio_speed [--json] [--walks 3] [--seed 1000] [--scenario zhao_loop]`. A kinematic walk with the
camera on the chest, told so many times, each time later; it comes back to where it began. Time is that of `update` from
picture to picture: as a clock has it, on as many cores as OpenCV takes, and as the processor has it; reading and
decoding are left out. Whoever keeps up works off what arrives while it is busy: `latest_ms` is the longest that a
sample's answer is late behind its arrival, and `dropped` counts the pictures for which more than four would have
waited, as many as the odometry holds. Memory is the growth of the process's peak from the end of the first walk to the
last.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.command import answer, command, show_summary
from benchmarks.foot_ins_speed import peak_mib
from benchmarks.repeated import again
from stridetwin.estimators.base import Options
from stridetwin.estimators.dvio import Dvio
from stridetwin.estimators.dvio.filter import HELD
from stridetwin.scenarios.experiments.odometry_walks import SENSORS, follow, odometry_samples, time_of
from stridetwin.scenarios.record import record
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording import Recording
from stridetwin.streams.samples import Depth, Image, Imu

MOUNT = "chest"
WARM_NS = 4_000_000_000


def figures(walk: Recording, walks: int) -> dict[str, float]:
    """Times, lag and growth of memory over so many walks one after the other."""
    odometry, before = Dvio(walk.rig, options=Options(mount=MOUNT)), 0.0
    arrived: list[float] = []
    taken: list[tuple[float, float]] = []
    picture: list[bool] = []
    for turn, sample in again(lambda: odometry_samples(walk, MOUNT), walks, round(walk.duration * 1e9)):
        assert isinstance(sample, Imu | Image | Depth)
        if turn == 1 and not before:
            before = peak_mib()
        start = time.perf_counter(), time.process_time()
        odometry.update(sample)
        taken.append((time.perf_counter() - start[0], time.process_time() - start[1]))
        arrived.append(sample.t_ns * 1e-9)
        picture.append(isinstance(sample, Image))
    spent, pictures = np.array(taken), np.flatnonzero(picture)
    a_frame = 1e3 * np.add.reduceat(spent, pictures)[:-1]
    late = lag(np.array(arrived), spent[:, 0])
    period_s = float(np.median(np.diff(np.array(arrived)[pictures])))
    by_clock = time_of(a_frame[:, 0])
    return {
        "ms_a_frame": by_clock["mean"],
        "ms_a_frame_p99": by_clock["p99"],
        "processor_ms_a_frame": float(a_frame[:, 1].mean()),
        "latest_ms": 1e3 * float(late.max()),
        "dropped": int((late[pictures] > HELD * period_s).sum()),
        "frames": len(a_frame),
        "memory_growth_mib": peak_mib() - before,
    }


def lag(arrived: np.ndarray, spent: np.ndarray) -> np.ndarray:
    """(N,) s by which each answer is late, where samples that arrive at (N,) s wait for those before, (N,) s each."""
    done = np.cumsum(spent)
    # the last time at which nothing waited decides: done = max over j <= i of arrived[j] + spent[j..i]
    return np.asarray(np.maximum.accumulate(arrived - done + spent) + done - arrived)


def measure(walks: int, seed: int, scenario: str) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "walk.mcap"
        config = load_scenario(scenario).config
        config = replace(config, sensors=SENSORS, rig_mount=MOUNT, physics="kinematic")
        record(Twin(config, seed), path, lambda stage, share: None)
        walk = Recording(path)
        follow(
            Dvio(walk.rig, options=Options(mount=MOUNT)),
            takewhile(lambda s: s.t_ns < WARM_NS, odometry_samples(walk, MOUNT)),
        )  # compiles
        return {"experiment": "dvio_speed", "summary": {scenario: figures(walk, max(2, walks))}}


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--walks", type=int, default=3, help="how often the walk is told, at least twice (3)")
    parser.add_argument("--seed", type=int, default=1000, help="of the walk (1000)")
    parser.add_argument("--scenario", default="zhao_loop", help="a closed loop (zhao_loop)")
    return answer(parser, lambda a: measure(a.walks, a.seed, a.scenario), show_summary(24, "8.2f"))


if __name__ == "__main__":
    sys.exit(main())
