"""Renders the images of the README and of the gallery.

    python tools/images.py [readme | terrains | people | gaits ...] [--physics kinematic]

`readme` writes docs/images/walk.jpg (the walker on the stair, and the views of four cameras) and docs/images/walk.webp
(an animation of some strides). The others write docs/images/walks_NAME.jpg: the walker at equal steps through each
walk, one row per walk, simulated with the soft assist, or played as planned with `--physics kinematic`.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import Dynamics, Exo, Gait, Level, Person, Route, Stairs, TwinConfig
from stridetwin.sim.rendering.renderer import FilmCamera, SensorView, mount_pose
from stridetwin.sim.twin import Twin
from stridetwin.streams.samples import Array

SEED, COLUMNS, CELL = 1000, 8, 180
WIDTH, VIEWS = 1280, ("/head/color", "depth", "/foot_l/camera", "/foot_r/camera")
ANIMATION_S, FRAME_S, ANIMATION_WIDTH = 4.4, 0.1, 640
WEBP_QUALITY = 45  # keeps the animation well below 2 MB
IMAGES = Path(__file__).parents[1] / "docs" / "images"


def main() -> None:
    """Writes the images."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", default=["readme", *SHEETS], help=f"of readme, {', '.join(SHEETS)}")
    parser.add_argument("--physics", default="dynamic", choices=("kinematic", "dynamic"))
    arguments = parser.parse_args()
    for name in arguments.names:
        if name == "readme":
            readme_images()
        else:
            contact_sheet(name, arguments.physics)


def contact_sheet(name: str, physics: str) -> None:
    """Writes one sheet of `SHEETS`."""
    dynamics = Dynamics(assist=True) if physics == "dynamic" else None
    rows = []
    for label, config in SHEETS[name]().items():
        print(f"{name}: {label}", flush=True)
        rows.append(row(label, replace(config, sensors=(), physics=physics, dynamics=dynamics)))
    target = IMAGES / f"walks_{name}.jpg"
    cv2.imwrite(str(target), cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 78])
    print(target)


def row(label: str, config: TwinConfig) -> NDArray[np.uint8]:
    """Frames of one walk side by side, seen from its right, with a label."""
    twin = Twin(config, SEED)
    walk = twin.walk
    moments = np.linspace(config.gait.stand_s, walk.duration_s - config.gait.stand_s, COLUMNS)
    pose, _, _ = walk.state(moments)
    data, frames = mujoco.MjData(twin.model), []
    with FilmCamera(twin.model, CELL, CELL) as film:
        for q in pose:
            data.qpos = q
            mujoco.mj_forward(twin.model, data)
            heading = float(np.degrees(np.arctan2(*data.body("pelvis").xmat.reshape(3, 3)[[1, 0], 0])))
            frames.append(film.frame(data, [q[0], q[1], q[2] - 0.05], heading + 66.0, -8.0, 2.9))
    strip = np.hstack(frames)
    strip[:20, : 12 * len(label)] //= 3
    cv2.putText(strip, label, (6, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
    return strip


def _terrains() -> dict[str, TwinConfig]:
    names = (
        "level_20m",
        "shim_stairs",
        "zhao_stair_25cm",
        "uneven_stairs",
        "ramp_up_down",
        "shim_ramp_14",
        "zhao_ramp_17_8",
        "cross_slope",
        "turns",
        "jao_loop_126m",
        "zhao_parallel",
        "room",
    )
    return {name: load_scenario(name).config for name in names}


def _people() -> dict[str, TwinConfig]:
    route = Route(segments=(Level(length_m=3.0), Stairs(risers=4), Level(length_m=2.0)))
    people = {
        "1.50 m, 45 kg": Person(height_m=1.50, mass_kg=45.0, sex="female"),
        "1.75 m, 75 kg": Person(),
        "1.95 m, 110 kg": Person(height_m=1.95, mass_kg=110.0),
    }
    walks = {f"{who}, mode 0": TwinConfig(name="people", route=route, person=p) for who, p in people.items()}
    walks["1.75 m, no exoskeleton"] = TwinConfig(name="people", route=route, exo=None)
    walks["1.75 m, mode 1"] = TwinConfig(name="people", route=route, exo=Exo(mode=1))
    return walks


def _gaits() -> dict[str, TwinConfig]:
    level = Route(segments=(Level(length_m=6.0),))
    stairs = Route(segments=(Level(length_m=2.5), Stairs(risers=3), Level(length_m=2.0)))
    gaits = {f"{speed} m/s": (level, Gait(speed_mps=speed)) for speed in (0.1, 0.4, 0.8, 1.2, 1.6, 2.1)}
    gaits["wander"] = (level, Gait.of_pattern("wander"))
    gaits["jog"] = (level, Gait.of_pattern("jog"))
    gaits["step by step"] = (stairs, Gait(stairs="step_by_step"))
    gaits["shuffling"] = (level, Gait(speed_mps=0.6, shuffle=1.0))
    gaits["asymmetry 0.3"] = (level, Gait(speed_mps=0.9, asymmetry=0.3))
    return {name: TwinConfig(name="gaits", route=route, gait=gait) for name, (route, gait) in gaits.items()}


SHEETS = {"terrains": _terrains, "people": _people, "gaits": _gaits}


def readme_images() -> None:
    """Writes the still and the animation."""
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
        rgb, depth = renderer.frame(data, mount_pose(data, camera.mount), camera.intrinsics)
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
