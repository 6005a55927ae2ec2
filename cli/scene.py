"""`scene` and `view --mujoco`: the model of a walk as MJCF, and the walk in MuJoCo's viewer."""

from __future__ import annotations

from stridetwin.cli.commands import SceneOptions
from stridetwin.cli.options import Outcome, Progress
from stridetwin.cli.walk import load_with_notes
from stridetwin.scenarios.record import make_twin
from stridetwin.streams.errors import explain_import_error

_NEED = "scenes need the simulator"


def scene_command(arguments: SceneOptions, progress: Progress) -> Outcome:
    """Runs `scene`: writes the model of a walk as MJCF with its meshes and textures."""
    with explain_import_error(_NEED, "twin"):
        from stridetwin.sim.scene.scene_files import scene_files, write_scene
    config = load_with_notes(arguments.scenario).config
    progress("scene", 0.0)
    files = scene_files(config, arguments.texture_px)
    write_scene(files, config.name, arguments.output)
    scene = arguments.output / f"{config.name}.xml"
    size = sum(map(len, files.values()))
    data = {"scene": str(scene), "files": sorted(files), "bytes": size}
    lines = [f"{scene}: {len(files)} files, {size / 1e6:.1f} MB", f"open it: python -m mujoco.viewer --mjcf={scene}"]
    return Outcome(data=data, lines=lines)


def play_walk(source: str, seed: int, progress: Progress) -> Outcome:
    """Plays the walk of a scenario in MuJoCo's viewer until its window is closed.

    Args:
        source: Name in the catalogue, or a .yaml file.
        seed: Seed of the walk.
        progress: Receives the stage and its progress (0-1).
    """
    with explain_import_error(_NEED, "twin"):
        from stridetwin.sim.scene.playback_window import check_display, play
    scenario = load_with_notes(source)
    check_display()
    progress("walk", 0.0)
    twin = make_twin(scenario, seed)
    play(twin)
    data = {"scenario": scenario.config.name, "seed": twin.seed, "duration_s": twin.duration_s}
    return Outcome(data=data, lines=[f"{scenario.config.name}: {twin.duration_s:.1f} s"])
