"""Speed of a campaign: walks of 10 s without cameras, by one worker and by two."""

from __future__ import annotations

import contextlib
import hashlib
import multiprocessing
import os
import resource
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.speed.timing import Summary
from stridetwin.scenarios.campaign.campaign_file import Campaign, read_campaign
from stridetwin.scenarios.campaign.generate import CampaignOptions, generate

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


def write_campaign(folder: Path) -> Campaign:
    """Writes the campaign and its scenarios into a folder."""
    for name, text in (("walks.yaml", WALKS), ("stairs.yaml", STAIRS), ("ramp.yaml", RAMP)):
        (folder / name).write_text(text, encoding="utf-8")
    return read_campaign(folder / "walks.yaml")


def campaign(walks: int, workers: Sequence[int]) -> Summary:
    """A campaign of short walks by each number of workers: recorded, checked and stored; the manifests must be equal.

    Times per walk are those of a running campaign: the first walk of each worker, which imports everything, is left
    out; `first_walk_s` is the time until the first is done.
    """
    summary: Summary = {}
    digests = set()
    with tempfile.TemporaryDirectory() as name:
        short_walks = write_campaign(Path(name))
        generate(short_walks, CampaignOptions(folder=Path(name) / "warm_up", subset=1), lambda *_: None)  # caches
        for count in workers:
            folder = Path(name) / f"by_{count}"
            summary[f"workers_{count}"] = _figures(short_walks, folder, walks, count)
            digests.add(hashlib.sha256((folder / "manifest.json").read_bytes()).hexdigest())
    assert len(digests) == 1, "the manifests differ"
    if {"workers_1", "workers_2"} <= set(summary):
        one, two = summary["workers_1"], summary["workers_2"]
        two["times_one_worker"] = one["s_per_walk"] / two["s_per_walk"]
        two["times_one_worker_by_cpu"] = 2 * one["cpu_s_per_walk"] / two["cpu_s_per_walk"]
    return summary


def _figures(short_walks: Campaign, folder: Path, walks: int, workers: int) -> dict[str, float]:
    times, used = [time.perf_counter()], [_cpu_s()]

    def progress(stage: str, share: float) -> None:
        if stage == "walks":
            times.append(time.perf_counter())
            used.append(_cpu_s())

    done = generate(short_walks, CampaignOptions(folder=folder, workers=workers, subset=walks), progress)
    total_s, cpu_s = time.perf_counter() - times[0], _cpu_s() - used[0]
    ends, spent = times[2:], used[2:]  # at the end of each walk
    steady_s, steady_cpu_s = ((series[-1] - series[workers - 1]) / (len(series) - workers) for series in (ends, spent))
    seconds = [w["duration_s"] for w in done.manifest["walks"] if "duration_s" in w]
    return {
        "walks": float(walks),
        "mean_walk_s": sum(seconds) / len(seconds),
        "rejected": float(walks - done.verdicts["accepted"]),
        "total_s": total_s,
        "cpu_s_per_walk": steady_cpu_s,
        "cpu_s_total": cpu_s,
        "first_walk_s": ends[0] - times[0],
        "s_per_walk": steady_s,
        f"min_for_{MANY}": (ends[workers - 1] - times[0] + (MANY - workers) * steady_s) / 60,
    }


def _cpu_s() -> float:
    """CPU time of this process and of its child processes, s; that of running children from Linux's /proc."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    ticks = 0
    for child in multiprocessing.active_children():
        with contextlib.suppress(OSError):
            after_name = Path(f"/proc/{child.pid}/stat").read_text().rsplit(")", 1)[1].split()
            ticks += int(after_name[11]) + int(after_name[12])  # proc(5): utime, stime
    return sum(u.ru_utime + u.ru_stime for u in used) + ticks / os.sysconf("SC_CLK_TCK")
