"""The standard depth camera with a quarter of its pixels: walks with images in a quarter of the time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path

import pytest

from stridetwin.sim.parts.kinds import Part
from stridetwin.sim.parts.library import read_part
from stridetwin.sim.rendering import camera_processes

_HALVED = (("width_px", 640, 320), ("height_px", 480, 240), ("focal_px", 384, 192))


def write_small_camera(path: Path) -> Path:
    """Writes the part's file, for the scenario beside it."""
    text = (files("stridetwin.sim.parts") / "D455.yaml").read_text(encoding="utf-8")
    for key, whole, half in _HALVED:
        assert f"{key}: {{value: {whole}," in text
        text = text.replace(f"{key}: {{value: {whole},", f"{key}: {{value: {half},")
    path.write_text(text, encoding="utf-8")
    return path


def small_camera(folder: Path) -> Part:
    """The part."""
    return read_part(write_small_camera(folder / "small_camera.yaml"))


@contextmanager
def one_renderer() -> Iterator[None]:
    """Walks rendered by one process beside the twin's, since a few images take less time than its start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(camera_processes, "PROCESSES", 1)
        yield
