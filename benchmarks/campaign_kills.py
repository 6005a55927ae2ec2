"""Robustness of campaigns to SIGKILL at random times during `generate CAMPAIGN`.

`python -m benchmarks.campaign_kills [--kills 200] [--workers 1] [--walks 5] [--json]` kills `stridetwin generate` on a
campaign of the given number of short walks at random times, resumes it in the same folder, and checks after every kill
that

- every file under a visible name is complete: recordings, scenarios, rows, manifest and card have the bytes of an
  undisturbed campaign;
- no finished walk is lost or generated again;
- the campaign ends with the bytes of the undisturbed one.

With two workers, the command's own process is killed; its workers end by themselves.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import answer, command, show_summary
from benchmarks.kills import start
from stridetwin.scenarios.campaign.campaign_file import read_campaign
from stridetwin.scenarios.campaign.generate import CampaignOptions, generate

SHORT = """
description: a few steps
terrain:
  - level: {length_m: 2}
gait: {stand_s: 0.5}
sensors: [foot_imu, insole]
"""
CAMPAIGN = """
campaign: A few steps
walks: {walks}
scenarios: [short.yaml]
set:
  gait.speed_mps: {{uniform: [0.9, 1.2]}}
  sensors.foot_imu.part: MPU-9250
"""


def visible(folder: Path) -> dict[str, bytes]:
    """The visible files by name."""
    files = (p for p in folder.rglob("*") if not any(part.startswith(".") for part in p.relative_to(folder).parts))
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(files) if p.is_file()}


def rows(folder: Path) -> dict[str, int]:
    """The finished walks, and when each row was written, ns."""
    return {p.name: p.stat().st_mtime_ns for p in (folder / "rows").glob("*.json")}


def measure_kills(kills: int, workers: int = 1, walks: int = 5, seed: int = 0) -> dict[str, float]:
    """Kills the given number of runs of a campaign; raises AssertionError if a check fails."""
    rng = np.random.default_rng(seed)
    counts = {"kills": 0.0, "with_walks_before": 0.0, "campaigns_completed": 0.0, "walks_kept": 0.0}
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        (home / "short.yaml").write_text(SHORT)
        (home / "small.yaml").write_text(CAMPAIGN.format(walks=walks))
        generate(read_campaign(home / "small.yaml"), CampaignOptions(folder=home / "whole"), lambda *_: None)
        whole, number = visible(home / "whole"), 0
        life_s = _life(home / "small.yaml", home / "timed", workers)
        folder = home / "killed"
        finished: dict[str, int] = {}
        while counts["kills"] < kills:
            child = start(_command(home / "small.yaml", folder, workers))
            time.sleep(life_s * rng.random())
            os.kill(child, signal.SIGKILL)
            _, status = os.waitpid(child, 0)
            if os.WIFSIGNALED(status):
                counts["kills"] += 1
                counts["with_walks_before"] += bool(finished)
            else:
                assert os.waitstatus_to_exitcode(status) == 0, "generate failed"
            there = rows(folder) if folder.exists() else {}
            assert finished.items() <= there.items(), "a finished walk was lost, or made again"
            visible_files = visible(folder)
            assert all(whole[file] == data for file, data in visible_files.items()), "a file that is not whole is seen"
            finished = there
            if "manifest.json" in visible_files:
                assert visible_files == whole, "the campaign differs from the undisturbed one"
                counts["campaigns_completed"] += 1
                counts["walks_kept"] += len(finished)
                number += 1
                folder, finished = home / f"killed_{number}", {}
        if finished or folder.exists():
            _life(home / "small.yaml", folder, workers)
            assert finished.items() <= rows(folder).items(), "a finished walk was made again"
            assert visible(folder) == whole, "the campaign differs from the undisturbed one"
            assert not list(folder.rglob(".*")), "something hidden is left"
            counts["campaigns_completed"] += 1
    return {**counts, "life_s": life_s}


def _command(campaign: Path, folder: Path, workers: int) -> list[str]:
    return ["generate", str(campaign), "-o", str(folder), "--workers", str(workers)]


def _life(campaign: Path, folder: Path, workers: int) -> float:
    """Generates a campaign undisturbed; returns how long it took, s."""
    began = time.perf_counter()
    assert os.waitstatus_to_exitcode(os.waitpid(start(_command(campaign, folder, workers)), 0)[1]) == 0
    return time.perf_counter() - began


def measure(arguments: Namespace) -> dict[str, Any]:
    """Figures in the form of an experiment's."""
    figures = measure_kills(arguments.kills, arguments.workers, arguments.walks)
    return {
        "experiment": "campaign_kills",
        "summary": {f"workers_{arguments.workers}": figures},
        "paper": {},
        "cases": [],
    }


if __name__ == "__main__":
    parser = command(__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--walks", type=int, default=5, help="more with workers, which take some seconds to start")
    sys.exit(answer(parser, measure, show_summary(22, "8.2f")))
