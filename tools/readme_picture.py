"""Renders the images of the README: the walker on the stair, and the views of four cameras.

Run as `python tools/readme_picture.py`; writes docs/images/walk.jpg (one instant) and docs/images/walk.webp (an
animation of some strides).
"""

import argparse
from pathlib import Path

import cv2
import mujoco
import numpy as np

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.rendering.renderer import FilmCamera, SensorView, camera_pose
from stridetwin.sim.twin import Twin
from stridetwin.streams.samples import Array

SEED, WIDTH = 1000, 1280
VIEWS = ("/head/color", "depth", "/foot_l/camera", "/foot_r/camera")
ANIMATION_S, FRAME_S, ANIMATION_WIDTH = 4.4, 0.1, 640
WEBP_QUALITY = 45  # keeps the animation well below 2 MB
IMAGES = Path(__file__).parents[1] / "docs" / "images"


def main() -> None:
    """Writes both images."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    twin = Twin(load_scenario("demo").config, SEED)
    steps = [s for own in twin.reference.steps.values() for s in own if s.mode == "SA"]
    moment = sorted(s.t_touch for s in steps)[2] - 0.44
    with FilmCamera(twin.model, WIDTH, WIDTH // 2) as film:
        still = scene(twin, film, moment)
        times = moment + np.arange(-0.5 * ANIMATION_S, 0.5 * ANIMATION_S, FRAME_S)
        frames = [_smaller(scene(twin, film, float(t))) for t in times]
    cv2.imwrite(str(IMAGES / "walk.jpg"), still, [cv2.IMWRITE_JPEG_QUALITY, 88])
    animation = cv2.Animation()
    animation.frames, animation.durations = frames, np.full(len(frames), round(1000 * FRAME_S))
    cv2.imwriteanimation(str(IMAGES / "walk.webp"), animation, [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY])
    print(IMAGES / "walk.jpg", IMAGES / "walk.webp")


def scene(twin: Twin, film: FilmCamera, t_s: float) -> Array:
    """(880, 1280, 3) BGR: the walker from outside, and below the views of four cameras."""
    data = mujoco.MjData(twin.model)
    pose, _, _ = twin.reference.state(np.array([t_s]))
    data.qpos = pose[0]
    mujoco.mj_forward(twin.model, data)
    large = film.frame(data, [pose[0, 0] + 0.7, 0.0, pose[0, 2] - 0.05], 66.0, -9.0, 3.1)
    strip = np.hstack([look(twin, data, view) for view in VIEWS])
    return cv2.cvtColor(np.vstack([large, strip]), cv2.COLOR_RGB2BGR)


def look(twin: Twin, data: mujoco.MjData, view: str) -> Array:
    """One camera's view, a quarter of the image wide."""
    camera = twin.rig.cameras["/head/color" if view == "depth" else view]
    with SensorView(twin.model, camera.width, camera.height) as renderer:
        rgb, depth = renderer.frame(data, camera_pose(data, camera), camera.intrinsics)
    if view == "depth":
        near = np.where(depth > 0, np.clip(1.0 - depth / 6.0, 0.0, 1.0), 0.0)
        rgb = cv2.cvtColor(cv2.applyColorMap((255 * near).astype(np.uint8), cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB)
    elif view.startswith("/foot"):
        rgb = cv2.cvtColor(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    return cv2.resize(rgb, (WIDTH // len(VIEWS), WIDTH // len(VIEWS) * 3 // 4), interpolation=cv2.INTER_AREA)


def _smaller(image: Array) -> Array:
    height = image.shape[0] * ANIMATION_WIDTH // image.shape[1]
    return cv2.resize(image, (ANIMATION_WIDTH, height), interpolation=cv2.INTER_AREA)


if __name__ == "__main__":
    main()
