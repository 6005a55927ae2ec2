"""Speed of the twin: walks recorded against real time, rendering, and recordings written and read."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.speed.timing import Stopwatch, Summary
from stridetwin.scenarios.record import record, without_cameras
from stridetwin.scenarios.scenario_file import Scenario, load_scenario
from stridetwin.sim.config import Exo, Level, Person, Route, Stairs, TwinConfig
from stridetwin.sim.rendering.renderer import FilmCamera, SensorView, mount_pose
from stridetwin.sim.sensors.standard_rig import standard_rig
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.body import add_wearer, compile_model
from stridetwin.sim.wearer.sensor_bodies import add_rig
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Imu

REQUIRED = {"kinematic_one_core": 20.0, "whole_rig": 1.5, "whole_rig_faults": 1.5, "whole_rig_dynamic": 1.0}
"""Required speed, as a multiple of real time."""
SEED = 1
FRAMES = 60
TOPICS = 25
RATE_HZ = 200


def twin() -> Summary:
    """The scenario `demo` against real time, planning and recording included.

    `kinematic_one_core`: without cameras, on one core, median of three runs. `whole_rig`: every sensor at its rate, on
    all cores. `whole_rig_faults`: the same with the faults of `demo_faults`. `whole_rig_dynamic`: also with contacts.
    """
    demo = load_scenario("demo")
    faults = replace(demo, config=replace(demo.config, faults=load_scenario("demo_faults").config.faults))
    dynamic = replace(faults, config=replace(faults.config, physics="dynamic"))
    _twin_figures(without_cameras(load_scenario("level_20m")))  # imports and caches
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    runs = [_twin_figures(without_cameras(demo)) for _ in range(3)]
    os.sched_setaffinity(0, cores)
    summary = {"kinematic_one_core": sorted(runs, key=lambda run: run["times_real_time"])[1]}
    for name, scenario in (("whole_rig", demo), ("whole_rig_faults", faults), ("whole_rig_dynamic", dynamic)):
        summary[name] = _twin_figures(scenario)
    return {name: figures | {"required_times_real_time": REQUIRED[name]} for name, figures in summary.items()}


def _twin_figures(scenario: Scenario) -> dict[str, float]:
    watch = Stopwatch()

    def generate(path: Path) -> float:
        walker = Twin(scenario.config, SEED)
        record(walker, path, lambda *_: None)
        return walker.duration_s

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.mcap"
        walk_s = watch.time(lambda: generate(path))
        size = path.stat().st_size
    return {
        "walk_s": walk_s,
        "wall_s": watch.wall_s,
        "times_real_time": walk_s / watch.wall_s,
        "megabyte_per_s": size / walk_s / 1e6,
    }


def render() -> Summary:
    """One image: RGB-D camera (colour and depth from one render), shoe camera and film camera; wall-clock ms."""
    route = Route(segments=(Level(length_m=3.0), Stairs(risers=6), Level(length_m=3.0)))
    rig = standard_rig(TwinConfig(name="render_speed", route=route))
    spec = mujoco.MjSpec()
    Terrain.from_route(route).add_to(spec)
    add_wearer(spec, Person(), Exo())
    add_rig(spec, rig)
    model = compile_model(spec)
    data = mujoco.MjData(model)
    data.qpos[0] = 1.5
    mujoco.mj_forward(model, data)
    summary = {}
    for topic in ("/head/color", "/foot_r/camera"):
        camera = rig.cameras[topic]
        pose = mount_pose(data, camera.mount)
        with SensorView(model, camera.width, camera.height) as view:
            draw = view.frame if camera.depth_topic else view.color
            summary[topic] = _draw_figures(lambda f=draw, p=pose, c=camera: f(data, p, c.intrinsics))
    with FilmCamera(model) as film:
        summary["film 1280x720"] = _draw_figures(lambda: film.frame(data, data.qpos[:3], 40.0, -12.0, 4.0))
    return summary


def _draw_figures(draw: Callable[[], object]) -> dict[str, float]:
    draw()  # compiles shaders
    watch, ms = Stopwatch(), list[float]()
    for _ in range(FRAMES):
        watch.reset()
        watch.time(draw)
        ms.append(1e3 * watch.wall_s)
    return {"median_ms": float(np.median(ms)), "p99_ms": float(np.percentile(ms, 99))}


def recording(seconds: int) -> Summary:
    """Small messages written in blocks, opened with every check, and streamed: messages per s of wall-clock time."""
    rng = np.random.default_rng(0)
    blocks = [block for second in range(seconds) for block in _second_of_samples(second, rng)]
    count = sum(map(len, blocks))
    writing, opening, streaming = Stopwatch(), Stopwatch(), Stopwatch()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "speed.mcap"

        def write() -> None:
            with RecordingWriter(path, Rig()) as writer:
                for block in blocks:
                    writer.write(block)

        writing.time(write)
        opened = opening.time(lambda: Recording(path))
        streaming.time(lambda: sum(1 for _ in opened.samples()))
        size = path.stat().st_size
    return {
        f"{TOPICS} IMUs at {RATE_HZ} Hz": {
            "messages": count,
            "write_per_s": count / writing.wall_s,
            "open_and_check_per_s": count / opening.wall_s,
            "samples_per_s": count / streaming.wall_s,
            "bytes_per_message": size / count,
        }
    }


def _second_of_samples(second: int, rng: np.random.Generator) -> list[Block[Imu]]:
    """One simulated second of noisy IMUs, one block per topic."""
    t_ns = second * 1_000_000_000 + np.arange(RATE_HZ) * (1_000_000_000 // RATE_HZ)
    shape = (RATE_HZ, 3)
    return [
        Block(
            topic=f"/imu_{i:02d}",
            kind=Imu,
            t_ns=t_ns,
            columns={"angular_rate": rng.normal(size=shape), "specific_force": rng.normal(size=shape)},
        )
        for i in range(TOPICS)
    ]
