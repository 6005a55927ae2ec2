"""Scenes of the catalogue as MJCF: each written, loaded and stepped by plain MuJoCo, and shown on contact sheets.

Run as `python -m benchmarks.scenes [--folder DIR] [--scenarios NAME ...] [--json]`; the folder keeps the scenes and the
sheets, `sheet_1.png` and so on: each row is one scene, the person, the whole terrain, and the first camera's view.
"""

from __future__ import annotations

import tempfile
from argparse import Namespace
from pathlib import Path
from typing import Any

import cv2
import mujoco
import numpy as np

from benchmarks.command import answer, command
from benchmarks.plain_mujoco import load
from stridetwin.scenarios.scenario_file import catalogue, load_scenario
from stridetwin.sim.composition import compose
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.scene.scene_files import scene_files, write_scene
from stridetwin.sim.wearer.body import compile_model

SECONDS = 1.0
ROWS = 8  # of a sheet
_TEXTURE_PX = 256


def difference(config: TwinConfig, scene: Path) -> float:
    """Largest difference of a scene's bodies, masses, geoms and joints from the twin's; inf if their number differs."""
    read, compiled = mujoco.MjModel.from_xml_path(str(scene)), compile_model(compose(config).spec)
    worst = 0.0
    for name in dir(compiled):
        if name.startswith(("body_", "geom_", "jnt_", "dof_")) and name != "geom_matid":
            a, b = np.asarray(getattr(read, name), float), np.asarray(getattr(compiled, name), float)
            worst = max(worst, float(np.abs(a - b).max(initial=0.0)) if a.shape == b.shape else np.inf)
    return worst


def sheet(rows: list[tuple[str, Any]]) -> Any:
    """One image of some scenes, (H, W, 3) BGR; each is its name and (3, h, w, 3) RGB."""
    strips = []
    for name, shots in rows:
        strip = np.ascontiguousarray(np.concatenate(list(shots), axis=1)[..., ::-1])
        strip[:26, : 12 * len(name) + 16] = 0
        cv2.putText(strip, name, (8, 19), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 1, cv2.LINE_AA)
        strips.append(strip)
    return np.concatenate(strips)


def measure(arguments: Namespace) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(arguments.folder or temporary)
        scenes, differences = [], {}
        for name in arguments.scenarios or catalogue():
            config = load_scenario(name).config
            write_scene(scene_files(config, _TEXTURE_PX), config.name, folder / name)
            scenes.append(folder / name / f"{config.name}.xml")
            differences[config.name] = difference(config, scenes[-1])
        rows = load(scenes, SECONDS, folder)
        for first in range(0, len(rows), ROWS):
            part = [(row["scene"], np.load(folder / f"{row['scene']}.npy")) for row in rows[first : first + ROWS]]
            cv2.imwrite(str(folder / f"sheet_{first // ROWS + 1}.png"), sheet(part))
        for row in rows:
            (folder / f"{row['scene']}.npy").unlink()
    return {"scenes": [row | {"difference": differences[row["scene"]]} for row in rows]}


def show(figures: dict[str, Any]) -> None:
    print(f"{'scene':18} {'bodies':>6} {'geoms':>6} {'mass kg':>8} {'difference':>10} {'moved mm':>9} {'warnings':>9}")
    for row in figures["scenes"]:
        print(
            f"{row['scene']:18} {row['bodies']:6} {row['geoms']:6} {row['mass_kg']:8.2f} {row['difference']:10.1e} "
            f"{1e3 * row['moved_m']:9.1f} {row['warnings']:9}"
        )


if __name__ == "__main__":
    parser = command(__doc__)
    parser.add_argument("--folder", help="keep the scenes and the contact sheets here")
    parser.add_argument("--scenarios", nargs="+", help="scenarios of the catalogue (default all)")
    raise SystemExit(answer(parser, measure, show))
