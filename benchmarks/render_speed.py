"""Time of one picture: RGB-D camera (colour and depth from one render), shoe camera and film camera.

Run as `python -m benchmarks.render_speed [--json]`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable

import mujoco
import numpy as np

from stridetwin.sim.body import add_wearer, compile_model
from stridetwin.sim.config import Exo, Level, Person, Route, Stairs, TwinConfig
from stridetwin.sim.render import FilmCamera, SensorView, camera_pose
from stridetwin.sim.rig_bodies import add_rig
from stridetwin.sim.standard_rig import standard_rig
from stridetwin.sim.terrain import Terrain

_FRAMES = 60


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    args = parser.parse_args()
    cases = measure()
    time_ms = {
        name: {"median": float(np.median(ms)), "p99": float(np.percentile(ms, 99))} for name, ms in cases.items()
    }
    if args.json:
        result = {"experiment": "render_speed", "summary": {"time_ms": time_ms}, "paper": {}, "cases": cases}
        print(json.dumps(result))
    else:
        for name, row in time_ms.items():
            print(f"{name:22s} median {row['median']:6.2f} ms   p99 {row['p99']:6.2f} ms")


def measure() -> dict[str, list[float]]:
    """Milliseconds of each frame, by camera."""
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
    cases = {}
    for topic in ("/head/color", "/foot_r/camera"):
        camera = rig.cameras[topic]
        pose = camera_pose(data, camera)
        with SensorView(model, camera.width, camera.height) as view:
            look = view.frame if camera.depth_topic else view.color
            cases[topic] = _time(lambda f=look, p=pose, c=camera: f(data, p, c.intrinsics))
    with FilmCamera(model) as film:
        cases["film 1280x720"] = _time(lambda: film.frame(data, data.qpos[:3], 40.0, -12.0, 4.0))
    return cases


def _time(draw: Callable[[], object]) -> list[float]:
    draw()
    taken = []
    for _ in range(_FRAMES):
        start = time.perf_counter()
        draw()
        taken.append((time.perf_counter() - start) * 1e3)
    return taken


if __name__ == "__main__":
    main()
