"""Estimated paths in a Rerun file."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from stridetwin.outputs.path.evaluate import Result
from stridetwin.outputs.path.figures import part_of
from stridetwin.outputs.rerun_curves import log_curves

if TYPE_CHECKING:
    from rerun import RecordingStream

_COLORS = {"l": (11, 107, 203), "r": (217, 72, 15), "camera": (95, 61, 196), "truth": (70, 84, 104)}


def log_paths(rerun: ModuleType, stream: RecordingStream, results: Sequence[Result]) -> None:
    """Logs each path as lines, `world/NAME/{truth,estimate}`, and its error over time, `error_mm/NAME`."""
    for result in results:
        for entity, path, color in (
            ("truth", result.comparison.truth, _COLORS["truth"]),
            ("estimate", result.comparison.estimate, _COLORS[part_of(result.estimate)]),
        ):
            # every other position is enough for a line
            line = rerun.LineStrips3D([path.p_frame_in_world[::2]], colors=[color], radii=[0.004])
            stream.log(f"world/{result.name}/{entity}", line, static=True)
    for result in results:
        error_mm = np.linalg.norm(result.comparison.error_m, axis=1)[:, None] * 1000.0  # (N, 1): one curve
        log_curves(rerun, stream, f"error_mm/{result.name}", result.comparison.truth.t_ns, error_mm, ("",))
