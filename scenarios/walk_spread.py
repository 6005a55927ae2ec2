"""How a walker's camera pitched and how fast he went, as moments and histograms that add up over walks.

Figure 4 of Zhao et al. 2023, from the truth: between the first step and the last one, the pitch of the camera's axis
below the horizon, and the horizontal speed of the camera over a second.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stridetwin.scenarios.footprints import FOOTPRINTS
from stridetwin.scenarios.truth import TruePath
from stridetwin.streams.recording import Recording
from stridetwin.streams.samples import Array

EDGES = {"camera_pitch_rad": np.linspace(-1.0, 1.5, 26), "speed_mps": np.linspace(0.0, 2.4, 25)}
"""Edges of the histograms' bins; what lies beyond counts in the outermost."""
_RATE_HZ = 30.0
_OVER_S = 1.0

Spread = Mapping[str, Any]
"""`count`, `mean`, `sd`, `min`, `max`, and `bins`: counts between `EDGES`."""


def walk_spread(recording: Recording, mount: str) -> dict[str, Spread]:
    """Of one walk, by quantity (`EDGES`).

    Args:
        recording: Of the walk, with its truth.
        mount: Where the camera sits.
    """
    truth = TruePath.of(recording.block(f"/truth/{mount}/imu/odometry"))  # its axes are the camera's
    half = round(_OVER_S / 2 * 1e9)
    steps = recording.block(FOOTPRINTS).t_ns[2:]  # those of the feet that stand at the start come first
    first, last = (steps[0], steps[-1]) if len(steps) else (truth.t_ns[0], truth.t_ns[-1])
    t_ns = np.arange(max(first, truth.t_ns[0] + half), min(last, truth.t_ns[-1] - half), round(1e9 / _RATE_HZ))
    way = truth.at(t_ns + half).p_frame_in_world - truth.at(t_ns - half).p_frame_in_world
    speed = np.linalg.norm(way[:, :2], axis=1) / _OVER_S
    return {
        "camera_pitch_rad": spread(pitch_down(truth.at(t_ns).q_world_frame), EDGES["camera_pitch_rad"]),
        "speed_mps": spread(speed, EDGES["speed_mps"]),
    }


def pitch_down(q_world_camera: Array) -> Array:
    """(N,) rad, how far the axis of an optical frame points below the horizon, of (N, 4) quaternions."""
    w, x, y, z = q_world_camera.T
    return -np.arcsin(np.clip(w * w - x * x - y * y + z * z, -1.0, 1.0))


def spread(values: Array, edges: Array) -> Spread:
    """Of (N,) values, N > 0."""
    bins = np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0]
    return {
        "count": len(values), "mean": float(np.mean(values)), "sd": float(np.std(values)),
        "min": float(np.min(values)), "max": float(np.max(values)), "bins": bins.tolist(),
    }  # fmt: skip


def together(parts: Sequence[Spread]) -> Spread:
    """Of all values of the parts, one part at least."""
    counts = np.array([p["count"] for p in parts], float)
    means, sds = (np.array([p[name] for p in parts]) for name in ("mean", "sd"))
    mean = float(counts @ means / counts.sum())
    return {
        "count": int(counts.sum()), "mean": mean,
        "sd": math.sqrt(float(counts @ (sds**2 + (means - mean) ** 2) / counts.sum())),
        "min": min(p["min"] for p in parts), "max": max(p["max"] for p in parts),
        "bins": np.sum([p["bins"] for p in parts], axis=0).tolist(),
    }  # fmt: skip
