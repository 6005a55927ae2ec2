"""Landing time of each foot, and the style of each step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stridetwin.sim.body import Wearer
from stridetwin.sim.config import Gait
from stridetwin.sim.gait.curves import speed_share, turn_share
from stridetwin.sim.gait.manner import held, shuffled, style_at
from stridetwin.sim.gait.placement import STEEP_RAD, Place, limp
from stridetwin.sim.gait.style import Style, level_style, pace
from stridetwin.sim.gait.tempo import Tempo
from stridetwin.sim.way import Way
from stridetwin.streams.samples import Array

# Share of a step; the same share of the stride is spent on both feet. Downstairs it takes time to lower the heel.
_STAIR_DOUBLE_SUPPORT, _COME_DOWN_DOUBLE_SUPPORT = 0.18, 0.30
_STAIR_TRANSFER, _DOWN_TRANSFER = 0.85, 0.60
_STEP_TIME = {"level": 1.0, "ramp": 1.04, "up": 1.16, "down": 1.04}
_STAIR_STEP_S = 0.60  # at the preferred speed of 1.2 m/s
_STAIR_SWING_MAX_S = 0.75  # slower climbers stand on both feet for longer
_HIGH_RISER_M = 0.18  # steps over higher ones take longer, in proportion
_RISER_M = 0.02
_SLOWER_STEEP = 2.5  # per radian beyond `STEEP_RAD`, where steps are shorter as well


def timing(
    way: Way, prints: Sequence[Place], size: Wearer, gait: Gait, tempo: Tempo, rng: np.random.Generator
) -> tuple[Array, list[Style]]:  # fmt: skip
    """(N,) time from the previous touch-down to each touch-down, s, and the style of each step."""
    rises = _rises(prints)
    even = _durations(way, prints, rises, gait, tempo, rng)
    styles = [shuffled(style, gait.shuffle) for style in _styles(prints, rises, even, size)]
    durations = even * [limp(gait, place.foot) for place in prints]
    pauses = np.array([0.0, *(place.pause_s for place in prints[:-1])])
    styles = [held(style, 1.0 + pause / t) for style, pause, t in zip(styles, pauses.tolist(), durations.tolist())]
    return durations + pauses, styles


def _rises(prints: Sequence[Place]) -> list[float]:
    """Height of the riser of each step, m, including steps that bring one foot beside the other; 0 for none."""
    rises = []
    for i, place in enumerate(prints):
        before = prints[i - 1] if i else None
        if before is not None and before.s == place.s and before.strip is place.strip and i > 1:
            before = prints[i - 2]
        far = before is None or place.strip is before.strip or place.s - before.s >= 1.0
        rise = 0.0 if far or before is None else place.strip.z0 - before.strip.z1
        rises.append(rise if abs(rise) > _RISER_M else 0.0)
    return rises


def _durations(
    way: Way, prints: Sequence[Place], rises: Sequence[float], gait: Gait, tempo: Tempo, rng: np.random.Generator
) -> Array:  # fmt: skip
    """Durations of the steps of an even gait, s."""
    durations, previous = [], 0.0
    for i, (place, rise) in enumerate(zip(prints, rises)):
        s = place.s
        middle = (s + previous) / 2
        level_step = tempo.duration(middle)
        if rise:
            stair_step = _STAIR_STEP_S * np.sqrt(1.2 / tempo.on_stairs(s))
            duration = stair_step * _STEP_TIME["up" if rise > 0 else "down"] * max(abs(rise) / _HIGH_RISER_M, 1.0)
        else:
            slower = float(np.sqrt(speed_share(way, np.array(middle))))
            ratio = np.clip(
                max((s - previous) / (float(tempo.step(middle)) * slower), turn_share(way, previous, s)), 0.3, 1.3
            )
            ramp = place.strip.terrain == "ramp"
            steep = max(abs(place.strip.slope) - STEEP_RAD, 0.0) if ramp else 0.0
            own = _STEP_TIME["ramp" if ramp else "level"] * (1.0 + _SLOWER_STEEP * steep) / slower
            duration = level_step * own * (0.55 + 0.45 * ratio)
        if i == 0 or i == len(prints) - 1:
            duration = max(duration, 0.9 * level_step)
        durations.append(duration * (1.0 + np.clip(rng.normal(0.0, gait.step_sd), -0.06, 0.06)))
        previous = s
    # neighbouring steps share their tempo: people do not change cadence abruptly
    return np.convolve(np.pad(durations, 1, mode="edge"), [0.2, 0.6, 0.2], mode="valid")


def _styles(prints: Sequence[Place], rises: Sequence[float], durations: Array, size: Wearer) -> list[Style]:
    """Style of each step, by its own speed."""
    speeds = np.diff([0.0, *(place.s for place in prints)]) / durations
    speeds = np.convolve(np.pad(speeds, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
    styles = []
    for speed, rise, before, duration in zip(speeds, rises, [0.0, *rises], durations.tolist()):
        style = style_at(pace(speed, size))
        if rise:
            level = level_style(pace(speed, size))
            transfer = _STAIR_TRANSFER if rise > 0.0 else _DOWN_TRANSFER
            style = replace(level, double_support=_STAIR_DOUBLE_SUPPORT, transfer=transfer)
        if before < 0.0:
            style = replace(style, double_support=max(style.double_support, _COME_DOWN_DOUBLE_SUPPORT))
        swing = duration * (1.0 - float(style.double_support))
        styles.append(held(style, max(swing / _STAIR_SWING_MAX_S, 1.0)) if rise else style)
    return styles
