"""Renders the picture of the README: the walker on the stair, and what four cameras of the rig see at that moment.

Run as `python tools/readme_picture.py`; writes docs/images/walk.jpg.
"""

import argparse
from pathlib import Path

import cv2
import mujoco
import numpy as np

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.render import FilmCamera, SensorView, camera_pose
from stridetwin.sim.twin import Twin
from stridetwin.streams.samples import Array

SEED, WIDTH = 1000, 1280
VIEWS = ("/head/color", "depth", "/foot_l/camera", "/foot_r/camera")


def main() -> None:
    """Writes the picture."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    twin = Twin(load_scenario("demo").config, SEED)
    steps = [s for own in twin.reference.steps.values() for s in own if s.mode == "SA"]
    moment = sorted(s.t_touch for s in steps)[2] - 0.44
    data = mujoco.MjData(twin.model)
    pose, _, _ = twin.reference.state(np.array([moment]))
    data.qpos = pose[0]
    mujoco.mj_forward(twin.model, data)
    with FilmCamera(twin.model, WIDTH, 640) as film:
        large = film.frame(data, [pose[0, 0] + 0.7, 0.0, pose[0, 2] - 0.05], 66.0, -9.0, 3.1)
    strip = np.hstack([look(twin, data, view) for view in VIEWS])
    picture = np.vstack([large, strip])
    target = Path(__file__).parents[1] / "docs" / "images" / "walk.jpg"
    cv2.imwrite(str(target), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 88])
    print(target)


def look(twin: Twin, data: mujoco.MjData, view: str) -> Array:
    """One camera's view, a quarter of the picture wide."""
    camera = twin.rig.cameras["/head/color" if view == "depth" else view]
    with SensorView(twin.model, camera.width, camera.height) as renderer:
        rgb, depth = renderer.frame(data, camera_pose(data, camera), camera.intrinsics)
    if view == "depth":
        near = np.where(depth > 0, np.clip(1.0 - depth / 6.0, 0.0, 1.0), 0.0)
        rgb = cv2.cvtColor(cv2.applyColorMap((255 * near).astype(np.uint8), cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB)
    elif view.startswith("/foot"):
        rgb = cv2.cvtColor(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    return cv2.resize(rgb, (WIDTH // len(VIEWS), WIDTH // len(VIEWS) * 3 // 4), interpolation=cv2.INTER_AREA)


if __name__ == "__main__":
    main()
