"""Loads scenes as a MuJoCo user without StrideTwin does: steps each from its keyframe, and renders it.

    python -I -S benchmarks/plain_mujoco.py SITE_PACKAGES SECONDS SCENE.xml ... [--images DIR]

Prints a JSON list, one entry per scene. `-S` leaves out what an editable installation adds to the path, so that only
MuJoCo and NumPy come from SITE_PACKAGES; `load` runs the script that way.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_WIDTH, _HEIGHT = 480, 270


def load(scenes: Sequence[Path], seconds: float, images: Path | None = None) -> list[dict[str, Any]]:
    """Loads and steps scenes in one process that cannot import StrideTwin.

    Args:
        scenes: The scenes' files.
        seconds: How long each is stepped.
        images: Folder for images of each, NAME.npy (3, H, W, 3) uint8: the person, the whole terrain, and what its
            first camera sees (again the person without one).

    Raises:
        RuntimeError: The process failed; the message is its last line.
    """
    spec = importlib.util.find_spec("mujoco")
    assert spec is not None
    assert spec.origin is not None
    command = [sys.executable, "-I", "-S", __file__, str(Path(spec.origin).parents[1]), str(seconds), *map(str, scenes)]
    done = subprocess.run(
        command + (["--images", str(images)] if images else []),
        capture_output=True,
        text=True,
        check=False,
        env={"MUJOCO_GL": "egl"} | os.environ,
    )
    if done.returncode:
        raise RuntimeError((done.stderr.splitlines() or ["no output"])[-1])
    return list(json.loads(done.stdout))


def _measure(path: str, seconds: float, images: str | None) -> dict[str, Any]:
    import mujoco
    import numpy as np

    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.keyframe("stand").id)
    mujoco.mj_forward(model, data)
    if images is not None:
        with mujoco.Renderer(model, _HEIGHT, _WIDTH) as renderer:
            shots = []
            for camera in _cameras(model, data):
                renderer.update_scene(data, camera)
                shots.append(renderer.render())
        np.save(Path(images) / f"{Path(path).stem}.npy", shots)
    start = data.body("pelvis").xpos.copy()
    away = 0.0
    while data.time < seconds:
        mujoco.mj_step(model, data)
        away = max(away, float(np.abs(data.body("pelvis").xpos - start).max()))
    return {
        "scene": Path(path).stem,
        "bodies": model.nbody,
        "geoms": model.ngeom,
        "cameras": [model.camera(i).name for i in range(model.ncam)],
        "sites": [model.site(i).name for i in range(model.nsite)],
        "mass_kg": float(model.body_subtreemass[0]),
        "moved_m": away,
        "warnings": int(sum(warning.number for warning in data.warning)),
        "finite": bool(np.isfinite(data.qpos).all()),
    }


def _cameras(model: Any, data: Any) -> list[Any]:
    import mujoco
    import numpy as np

    person, over = mujoco.MjvCamera(), mujoco.MjvCamera()
    for camera in (person, over):
        mujoco.mjv_defaultFreeCamera(model, camera)
    ground = [i for i in range(model.ngeom) if model.geom(i).name.startswith("terrain_")]
    reach = model.geom_rbound[ground, None]
    low, high = (data.geom_xpos[ground] - reach).min(axis=0), (data.geom_xpos[ground] + reach).max(axis=0)
    over.lookat, over.distance = (low + high) / 2, 0.6 * float(np.linalg.norm((high - low)[:2])) + 2.0
    over.azimuth, over.elevation = 110.0, -45.0
    return [person, over, 0 if model.ncam else person]


def _main() -> None:
    arguments = sys.argv[1:]
    images = arguments.pop() if "--images" in arguments else None
    site, seconds, *scenes = (word for word in arguments if word != "--images")
    sys.path.append(site)
    assert importlib.util.find_spec("stridetwin") is None, "StrideTwin can be imported here"
    print(json.dumps([_measure(scene, float(seconds), images) for scene in scenes]))


if __name__ == "__main__":
    _main()
