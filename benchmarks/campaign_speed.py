"""What a campaign costs: walks of 10 s without cameras, by one worker and by two.

`python -m benchmarks.campaign_speed [--walks 20] [--workers 1 2] [--json]` makes so many walks of `WALKS` with each
number of workers, and tells the time of a walk (recorded, checked, put in its place) once the workers run, the
processor's time of one, what it takes until the first is done, and how long a thousand walks would take. The manifests
must be the same.
"""

from __future__ import annotations

import contextlib
import hashlib
import multiprocessing
import os
import resource
import sys
import tempfile
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

from benchmarks.command import answer, command
from stridetwin.scenarios.campaign.campaign_file import Campaign, read_campaign
from stridetwin.scenarios.campaign.generate import Asked, generate

MANY = 1000
WALKS = """
campaign: Walks of ten seconds
walks: 1000
scenarios:
  - scenario: stairs.yaml
    set:
      terrain[1].stairs.riser_mm: {uniform: [130, 190]}
  - scenario: ramp.yaml
    set:
      terrain[1].ramp.angle_deg: {uniform: [4, 14]}
people:
  - {count: 40, height_m: {uniform: [1.55, 1.9]}, bmi: {uniform: [19, 30]}, sex: {choice: [female, male]}}
set:
  gait.speed_mps: {uniform: [1, 1.2]}
  sensors.foot_imu.part: MPU-9250
  sensors.foot_camera: false
  sensors.head_camera: false
"""
STAIRS = """
description: Up three risers
terrain:
  - level: {length_m: 2.5}
  - stairs: {risers: 3, tread_mm: 290, direction: up}
  - level: {length_m: 2.2}
gait: {stand_s: 1.5}
"""
RAMP = """
description: Up a ramp
terrain:
  - level: {length_m: 2.2}
  - ramp: {angle_deg: 8, rise_m: 0.2, direction: up}
  - level: {length_m: 2}
gait: {stand_s: 1.5}
"""


def written(folder: Path) -> Campaign:
    """The campaign, with its scenarios beside it."""
    for name, text in (("walks.yaml", WALKS), ("stairs.yaml", STAIRS), ("ramp.yaml", RAMP)):
        (folder / name).write_text(text, encoding="utf-8")
    return read_campaign(folder / "walks.yaml")


def made(campaign: Campaign, folder: Path, walks: int, workers: int) -> dict[str, float]:
    """Figures of so many walks by so many workers; the first walk of each worker, with all imports, is told apart."""
    times, used = [time.perf_counter()], [_processor_s()]

    def progress(stage: str, share: float) -> None:
        if stage == "walks":
            times.append(time.perf_counter())
            used.append(_processor_s())

    done = generate(campaign, Asked(folder=folder, workers=workers, subset=walks), progress)
    total_s, processor_s = time.perf_counter() - times[0], _processor_s() - used[0]
    ends, spent = times[2:], used[2:]  # at the end of each walk
    steady_s, steady_processor_s = (
        (series[-1] - series[workers - 1]) / (len(series) - workers) for series in (ends, spent)
    )
    seconds = [w["duration_s"] for w in done.manifest["walks"] if "duration_s" in w]
    return {
        "walks": float(walks),
        "mean_walk_s": sum(seconds) / len(seconds),
        "rejected": float(walks - done.verdicts["accepted"]),
        "total_s": total_s,
        "processor_s_a_walk": steady_processor_s,
        "processor_s_in_all": processor_s,
        "first_walk_s": ends[0] - times[0],
        "s_a_walk": steady_s,
        f"min_for_{MANY}": (ends[workers - 1] - times[0] + (MANY - workers) * steady_s) / 60,
    }


def _processor_s() -> float:
    """Of this process and of those that it has started, s; of those that live still as Linux tells it."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    ticks = 0
    for child in multiprocessing.active_children():
        with contextlib.suppress(OSError):
            after_name = Path(f"/proc/{child.pid}/stat").read_text().rsplit(")", 1)[1].split()
            ticks += int(after_name[11]) + int(after_name[12])  # proc(5): utime, stime
    return sum(u.ru_utime + u.ru_stime for u in used) + ticks / os.sysconf("SC_CLK_TCK")


def measure(arguments: Namespace) -> dict[str, Any]:
    """Figures by number of workers."""
    summary: dict[str, dict[str, float]] = {}
    digests = set()
    with tempfile.TemporaryDirectory() as name:
        campaign = written(Path(name))
        generate(campaign, Asked(folder=Path(name) / "warm", subset=1), lambda *_: None)  # caches
        for workers in arguments.workers:
            folder = Path(name) / f"by_{workers}"
            summary[f"workers_{workers}"] = made(campaign, folder, arguments.walks, workers)
            digests.add(hashlib.sha256((folder / "manifest.json").read_bytes()).hexdigest())
    assert len(digests) == 1, "the manifests differ"
    if {"workers_1", "workers_2"} <= set(summary):
        one, two = summary["workers_1"], summary["workers_2"]
        two["times_one_worker"] = one["s_a_walk"] / two["s_a_walk"]
        two["times_one_worker_by_processor"] = 2 * one["processor_s_a_walk"] / two["processor_s_a_walk"]
    return {"experiment": "campaign_speed", "summary": summary, "paper": {}, "cases": []}


def show(result: dict[str, Any]) -> None:
    """Prints the figures."""
    for name, figures in result["summary"].items():
        print(name.replace("_", " "), *(f"{key} {value:.2f}" for key, value in figures.items()), sep="\n  ")


if __name__ == "__main__":
    parser = command(__doc__)
    parser.add_argument("--walks", type=int, default=20, metavar="N", help="more than there are workers")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], metavar="N")
    sys.exit(answer(parser, measure, show))
