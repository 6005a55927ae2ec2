"""Intrinsics that change from image to image, as those of a phone with autofocus: one set of them for all images."""

from __future__ import annotations

import numpy as np

from stridetwin.streams.formats.assumed_calibration import GIVE
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.samples import Array

_SAME_PX = 0.5
"""Changes of a focal length or a centre up to this size are not reported."""
_NAMES = ("fu", "fv", "pu", "pv")


def choose_frame(name: str, intrinsics: Array, notes: Notes) -> int:
    """The image whose intrinsics stand for those of all; a warning says how much they change.

    Args:
        name: What the warning calls the camera or the file.
        intrinsics: (N, 4) fu, fv, pu, pv of each image in pixels, N ≥ 1.
        notes: Collects the warning.

    Returns:
        Number of the image whose intrinsics are nearest to the median.
    """
    chosen = int(np.argmin(np.abs(intrinsics - np.median(intrinsics, axis=0)).max(axis=1)))
    changes = np.abs(intrinsics - intrinsics[chosen]).max(axis=0)
    if changes.max() > _SAME_PX:
        low, high = intrinsics.min(axis=0), intrinsics.max(axis=0)
        ranges = ", ".join(f"{n} {a:.1f} to {b:.1f}" for n, a, b in zip(_NAMES, low, high))
        used = " ".join(f"{v:.1f}" for v in intrinsics[chosen])
        notes.warn(
            f"{name}: the intrinsics change from image to image ({ranges} px); {used} px are used for all, "
            f"up to {changes.max():.1f} px off; fix the focus when you record, or {GIVE}"
        )
    return chosen
