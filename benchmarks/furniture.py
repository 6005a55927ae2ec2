"""How often furniture, walls and planters are mapped as stairs on level walks in rooms that nobody has seen.

`python -m benchmarks.furniture [--seeds 0-19] [--folder DIR] [--json]`. Each seed gives a walk of a few metres on level
ground in a room that is furnished anew (the catalogue's rooms all look alike), one between planters outdoors, one with
tables, chairs, crates and walls beside the way, and a kitchen that is scanned by hand (`benchmarks.kitchen`). The map
gets the true poses. Per walk: flights in the last map, largest number in any map, and the share of maps with a flight.
`--folder` keeps the recordings for the next run.
"""

from __future__ import annotations

import re
import tempfile
from argparse import Namespace
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import kitchen
from benchmarks.command import answer, command
from stridetwin.estimators.terrain_map import Stairs, TerrainMap
from stridetwin.estimators.terrain_map.depth_camera import depth_calibration
from stridetwin.outputs.chosen_poses import find_pose_topic
from stridetwin.outputs.feeding import instance_for
from stridetwin.outputs.pose_feed import merge_poses
from stridetwin.scenarios.record import record
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import Gait, Gaze, Level, Route, Segment, Thing, Turn, TwinConfig
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.twin import Twin
from stridetwin.sim.world import obstacles
from stridetwin.sim.world.route import lay_out
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Depth, Sample
from stridetwin.streams.trajectory import Trajectory

SENSORS = ("insole", "head_imu", "head_camera")
"""Sensors of the walks."""
KINDS = ("room", "outdoor", "things", "kitchen")
"""Kinds of walks: in a room, between planters, and past furniture, crates and walls; scans of kitchens."""
_RATE_HZ = 10.0
"""Rate of the camera: a third of its usual one, for speed."""
_MOST_THINGS, _TRIES = 6, 40
"""Most things beside a way, and places that are tried for them."""
_FIRST_ROOM = 100_000
"""Seed of the furniture of walk 0; the catalogue's rooms have lower ones."""


def draw_walk(kind: str, seed: int) -> TwinConfig:
    """A short walk on level ground, drawn from a seed: length, turn, width, speed, gaze, camera, and things beside."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    segments: tuple[Segment, ...] = (Level(length_m=3.0),)
    if rng.uniform() < 0.4:
        angle_rad, radius_m = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.6), rng.choice([0.0, rng.uniform(1.0, 2.0)])
        turn = Turn(angle_rad=float(angle_rad), radius_m=float(radius_m))
        segments = (Level(length_m=rng.uniform(1.5, 2.0)), turn, Level(length_m=1.5))
    scenery = "outdoor" if kind == "outdoor" else "room"
    route = Route(segments=segments, width_m=float(rng.uniform(0.9, 2.4)), scenery=scenery)
    gaze = Gaze(kind=str(rng.choice(["ahead", "terrain", "wandering"])))
    config = replace(
        load_scenario("level_20m").config,
        name=f"{kind}_{seed}",
        sensors=SENSORS,
        physics="kinematic",
        route=route,
        gait=Gait(speed_mps=float(rng.uniform(0.7, 1.4)), stand_s=0.5, gaze=gaze),
        rig_mount=str(rng.choice(["head", "head", "chest"])),
        fittings={"head_camera": SensorConfig(rate_hz=_RATE_HZ)},
    )
    return _add_things(config, rng) if kind == "things" else config


def _add_things(config: TwinConfig, rng: np.random.Generator) -> TwinConfig:
    """The walk with up to `_MOST_THINGS` things beside the way, each where it does not obstruct the walker."""
    length_m = sum(segment.length_m for segment in config.route.segments if isinstance(segment, Level))
    for _ in range(_TRIES):
        thing = Thing(
            kind=str(rng.choice(["table", "chair", "crate", "crate", "wall"])),
            at_m=float(rng.uniform(0.5, length_m)),
            left_m=float(rng.choice([-1.0, 1.0]) * rng.uniform(0.7, 1.8)),
        )
        route = replace(config.route, things=(*config.route.things, thing))
        try:
            obstacles.check_things(route.things, lay_out(route), route.width_m)
        except ConfigError:
            continue
        config = replace(config, route=route)
        if len(route.things) == _MOST_THINGS:
            break
    return config


def record_walk(kind: str, seed: int, folder: Path) -> Path:
    """The recording of a walk, which is generated if the folder lacks it; the furniture is drawn from the seed."""
    path = folder / f"{kind}_{seed}.mcap"
    if not path.exists():
        with furnish_rooms(_FIRST_ROOM + seed):
            record(Twin(draw_walk(kind, seed), seed), path)
    return path


@contextmanager
def furnish_rooms(seed: int, margin_m: float | None = None) -> Iterator[None]:
    """Context manager: rooms of the twin have other furniture than usual.

    Args:
        seed: Of the furniture.
        margin_m: From the way to the walls; None: as usual.
    """
    usual = obstacles._SEED, obstacles._ROOM_MARGIN_M
    obstacles._SEED, obstacles._ROOM_MARGIN_M = seed, usual[1] if margin_m is None else margin_m
    try:
        yield
    finally:
        obstacles._SEED, obstacles._ROOM_MARGIN_M = usual


def map_flights(path: Path) -> dict[str, Any]:
    """Flights in the maps of a recording along the true poses.

    Returns:
        `last`: flights of the last map; `most`: most of any map; `share` of the maps that have one; `maps`: how many
        there are; `flights`: those of the last map in words.
    """
    recording = Recording(path)
    topic, frame = find_pose_topic(recording, depth_calibration(recording.rig))
    block = recording.block(topic)
    poses = Trajectory(
        t_ns=block.t_ns,
        p_frame_in_world=block.columns["p_frame_in_world"],
        q_world_frame=block.columns["q_world_frame"],
    )
    instance = instance_for(TerrainMap, recording).with_poses_of(frame)
    terrain_map = TerrainMap(recording.rig, options=instance.options)
    return _count_flights(terrain_map, merge_poses(poses, recording, [depth_calibration(recording.rig).depth_topic]))


def map_kitchen(seed: int) -> dict[str, Any]:
    """Flights in the maps of a kitchen that is scanned by hand, as `map_flights` has them for a recording."""
    return _count_flights(TerrainMap(kitchen.RIG), kitchen.scan_kitchen(seed))


def _count_flights(terrain_map: TerrainMap, samples: Iterable[Sample]) -> dict[str, Any]:
    """Figures of `map_flights`, of a map that takes samples in time order."""
    counts, last = [], None
    for sample in samples:
        estimate = terrain_map.update(sample)
        if isinstance(sample, Depth) and estimate is not None:
            counts.append(len(estimate.stairs))
            last = estimate
    flights = [] if last is None else [_describe(flight) for flight in last.stairs]
    share = float(np.mean(np.array(counts) > 0)) if counts else 0.0
    most = max(counts, default=0)
    return {"last": len(flights), "most": most, "share": share, "maps": len(counts), "flights": flights}


def _describe(flight: Stairs) -> str:
    """Steps, riser, tread, base, width and place of a flight in one line."""
    low, high = flight.across
    return (
        f"{flight.steps} x {flight.riser:.2f} m, tread {flight.tread:.2f}, base {flight.base:.2f}, "
        f"wide {high - low:.2f}, at {flight.start:.1f}"
    )


def measure(arguments: Namespace) -> dict[str, Any]:
    """Figures of `map_flights` for each walk of the command line's seeds and kinds."""
    first, last = (int(n) for n in re.split("-", arguments.seeds))
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(arguments.folder or temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for seed in range(first, last + 1):
            for kind in arguments.kinds:
                figures = map_kitchen(seed) if kind == "kitchen" else map_flights(record_walk(kind, seed, folder))
                rows.append({"walk": kind, "seed": seed, **figures})
                if not arguments.json:
                    _show_row(rows[-1])
    return {"walks": rows}


def _show_row(row: dict[str, Any]) -> None:
    """Prints the figures of a walk, and the flights of its last map."""
    print(f"{row['walk']:8} {row['seed']:5} {row['last']:5} {row['most']:5} {100 * row['share']:6.1f} %", flush=True)
    for line in row["flights"]:
        print(f"      {line}")


def show(figures: dict[str, Any]) -> None:
    """Prints a line for each kind of walks."""
    for kind in KINDS:
        rows = [row for row in figures["walks"] if row["walk"] == kind]
        if rows:
            last, ever = sum(row["last"] > 0 for row in rows), sum(row["most"] > 0 for row in rows)
            share = 100 * float(np.mean([row["share"] for row in rows]))
            print(f"{kind}: {len(rows)} walks; flights at the end {last}, at any time {ever}; {share:.1f} % of maps")


if __name__ == "__main__":
    parser = command(__doc__)
    parser.add_argument("--seeds", default="0-19", help="first-last")
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    parser.add_argument("--folder", help="keep the recordings here")
    raise SystemExit(answer(parser, measure, show))
