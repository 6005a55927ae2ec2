"""Renders the contact sheets of the documentation: the walker at equal steps through each walk, one row per walk.

Run as `python tools/contact_sheet.py [--physics kinematic] [SHEET ...]`; writes docs/images/walks_<sheet>.jpg. Walks
are simulated with the soft assist, or played as planned with `--physics kinematic`.
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
from stridetwin.sim.rendering.renderer import FilmCamera
from stridetwin.sim.twin import Twin

SEED, COLUMNS, WIDTH, HEIGHT = 1000, 8, 180, 180
IMAGES = Path(__file__).parents[1] / "docs" / "images"


def main() -> None:
    """Writes the sheets."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sheets", nargs="*", default=list(SHEETS), help=f"of {', '.join(SHEETS)}")
    parser.add_argument("--physics", default="dynamic", choices=("kinematic", "dynamic"))
    args = parser.parse_args()
    dynamics = Dynamics(assist=True) if args.physics == "dynamic" else None
    for name in args.sheets:
        rows = []
        for label, config in SHEETS[name]().items():
            print(f"{name}: {label}", flush=True)
            rows.append(row(label, replace(config, sensors=(), physics=args.physics, dynamics=dynamics)))
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
    with FilmCamera(twin.model, WIDTH, HEIGHT) as film:
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
        "level_20m", "shim_stairs", "zhao_stair_25cm", "uneven_stairs", "ramp_up_down", "shim_ramp_14",
        "zhao_ramp_17_8", "cross_slope", "turns", "jao_loop_126m", "zhao_parallel", "room",
    )  # fmt: skip
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


if __name__ == "__main__":
    main()
