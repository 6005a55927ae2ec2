"""`check` on walks of the catalogue, with sound and with faulty clocks of the depth camera.

`python -m benchmarks.camera_clocks [--clean 60] [--faulty 20] [--workers 1] [--longest 45] [--json]`. Seeds from 1000
on. A clean walk should be valid, and the interval of its camera's clock should contain 0. The images of a faulty walk
are stamped 10 to 60 ms early or late, without a word in the calibration: `check` should find that, and its interval
should contain the offset. Walks without the depth camera or longer than `--longest` s are left out; shoe cameras, whose
clocks are not estimated, are off.
"""

from __future__ import annotations

import tempfile
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import answer, command
from stridetwin.batch.processes import open_pool
from stridetwin.scenarios.check import check_recording
from stridetwin.scenarios.record import make_twin, record
from stridetwin.scenarios.scenario_file import catalogue, load_scenario
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.parts.sensor_config import Clock, SensorConfig
from stridetwin.sim.world.route import lay_out
from stridetwin.streams.recording.reader import Recording

CAMERA = "head_camera"
FIRST_SEED = 1000
OFFSETS_S = (0.010, 0.060)


@dataclass(frozen=True, kw_only=True)
class Case:
    """A walk: name of its scenario, seed, and offset of the camera's stamps, s."""

    scenario: str
    seed: int
    offset_s: float


def cases(count: int, offsets: Sequence[float], longest_s: float, first_seed: int) -> Iterator[Case]:
    """Walks over the catalogue, in turn."""
    names = [name for name in catalogue() if _is_fit(load_scenario(name).config, longest_s)]
    for i in range(count):
        yield Case(scenario=names[i % len(names)], seed=first_seed + i, offset_s=offsets[i])


def _is_fit(config: TwinConfig, longest_s: float) -> bool:
    way_m = lay_out(config.route).way.segments[-1].s1
    return CAMERA in config.sensors and not config.faults and way_m / config.gait.speed_mps < longest_s


def checked(case: Case) -> dict[str, Any]:
    """Errors of `check` on the walk, and the clock of its camera."""
    config = load_scenario(case.scenario).config
    fittings = dict(config.fittings)
    if case.offset_s:
        fittings[CAMERA] = replace(fittings.get(CAMERA, SensorConfig()), clock=Clock(offset_s=case.offset_s))
    sensors = tuple(group for group in config.sensors if group != "foot_camera")
    scenario = replace(load_scenario(case.scenario), config=replace(config, fittings=fittings, sensors=sensors))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "walk.mcap"
        record(make_twin(scenario, case.seed), path)
        check = check_recording(Recording(path, lenient=True))
    clock = next(iter(check.data["camera_clocks"].values()), None)
    row: dict[str, Any] = {**vars(case), "errors": [f.what for f in check.findings if f.is_error]}
    if clock is not None:
        # stamps that are late by the offset: the IMU's time is the camera's minus the offset
        error_s = clock["unexplained_s"] + case.offset_s
        row |= {"error_s": error_s, "half_s": clock["half_s"], "is_inside": abs(error_s) <= clock["half_s"]}
    return row


def measure(arguments: Namespace) -> dict[str, Any]:
    """Rows of all walks, and how many were estimated, found, and inside their interval."""
    rng = np.random.default_rng(FIRST_SEED)
    signs = rng.choice([-1.0, 1.0], arguments.faulty)
    offsets = {
        "clean": np.zeros(arguments.clean).tolist(),
        "faulty": (signs * rng.uniform(*OFFSETS_S, arguments.faulty)).tolist(),
    }
    result: dict[str, Any] = {"summary": {}}
    for kind, some in offsets.items():
        first = FIRST_SEED + (arguments.clean if kind == "faulty" else 0)
        walks = list(cases(len(some), some, arguments.longest, first))
        with open_pool(arguments.workers) as pool:
            rows = list(pool.map(checked, walks))
        estimated = [row for row in rows if "error_s" in row]
        result[kind] = rows
        result["summary"][kind] = {
            "walks": len(rows),
            "with an error": sum(bool(row["errors"]) for row in rows),
            "clock estimated": len(estimated),
            "clock in its interval": sum(row["is_inside"] for row in estimated),
            "median half width, ms": 1e3 * float(np.median([row["half_s"] for row in estimated])) if estimated else 0.0,
        }
    return result


def show(result: dict[str, Any]) -> None:
    """The summary, then the walks that went wrong."""
    for kind, figures in result["summary"].items():
        print(kind, ", ".join(f"{name} {value:.3g}" for name, value in figures.items()))
    for kind in ("clean", "faulty"):
        for row in result[kind]:
            if bool(row["errors"]) != (kind == "faulty") or not row.get("is_inside", True):
                print(kind, row)


if __name__ == "__main__":
    parser = command(__doc__)
    parser.add_argument("--clean", type=int, default=60)
    parser.add_argument("--faulty", type=int, default=20)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--longest", type=float, default=45.0, help="s")
    raise SystemExit(answer(parser, measure, show))
