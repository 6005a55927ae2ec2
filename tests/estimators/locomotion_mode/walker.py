"""Someone who walks up a flight of stairs, scripted: poses of the head, both insoles, depth of exact boxes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from stridetwin.streams.samples import Insole, Sample
from tests.estimators.terrain_map.scenes import EYE_M, attitude, depth, flight, image, pose

RISER, TREAD, STEPS = 0.15, 0.30, 4
STEP_M, STEP_S, STAIR_S = 0.55, 0.60, 0.75
INSOLE_NS, POSE_NS, IMAGE_NS = 10_000_000, 20_000_000, 100_000_000
BOXES = flight(RISER, TREAD, STEPS, landing=4.0)


def footprints(*, both: bool = False) -> list[tuple[float, float, str, str]]:
    """Time (s), place along x (m), foot and mode of each step: five on the level, four up, three on the landing.

    With `both`, the other foot joins each of the four before the walker goes on.
    """
    found, t, feet = [], 1.5, "rl"
    places = [-0.30 - STEP_M * k for k in range(4, -1, -1)]
    modes = ["LG"] * len(places)
    for k in range(STEPS):
        places += [0.06 + TREAD * k] * (1 + both)
        modes += ["SA", "LG"][: 1 + both]
    places += [places[-1] + STEP_M * k for k in (1, 2, 3)]
    modes += ["LG"] * 3
    for k, (place, mode) in enumerate(zip(places, modes)):
        found.append((round(t, 3), place, feet[k % 2], mode))
        following = modes[k + 1] if k + 1 < len(modes) else "LG"
        t += STAIR_S if following == "SA" else STEP_S
    return found


def samples(*, both: bool = False) -> list[Sample]:
    """Everything in time order; a pose before the image of its instant."""
    prints = footprints(both=both)
    times = np.array([0.0, 1.0, *(p[0] for p in prints)])
    joined = [False, *(b[1] == a[1] for a, b in pairwise(prints))]
    ahead = [-0.13 if j else 0.05 if p[3] == "SA" else 0.45 * STEP_M for p, j in zip(prints, joined)]
    at = np.array([prints[0][1] - STEP_M, prints[0][1] - STEP_M, *(p[1] - a for p, a in zip(prints, ahead))])
    ground = np.clip(np.floor(np.array([p[1] for p in prints]) / TREAD) + 1, 0, STEPS) * RISER
    high = np.array([0.0, 0.0, *(g - 0.1 * (p[3] == "SA") for g, p in zip(ground, prints))])
    rng = np.random.default_rng(3)
    end_ns = round(prints[-1][0] * 1e9) + 200_000_000
    found: list[Sample] = []
    for t_ns in range(0, end_ns, INSOLE_NS):
        t = t_ns * 1e-9
        for foot in "lr":
            own = [p[0] for p in prints if p[2] == foot]
            swing = any(touch - 0.42 < t < touch for touch in own)
            load = 4.0 if swing else 500.0
            found.append(Insole(topic=f"/foot_{foot}/insole", t_ns=t_ns, force=np.full(4, load / 4)))
        if t_ns % POSE_NS == 0:
            eye = np.array([np.interp(t, times, at), 0.0, EYE_M + np.interp(t, times, high)])
            R = attitude(0.0, 0.5 + 0.05 * np.sin(3.0 * t))
            found.append(pose(t_ns, eye, R))
            if t_ns % IMAGE_NS == 0:
                found.append(depth(t_ns, image(BOXES, eye, R, rng)))
    return found
