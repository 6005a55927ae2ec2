"""How a walking style changes with manner: below or above the table's speeds, with a shuffle, or before a pause."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stridetwin.sim.gait.style import Style, level_style, tabled
from stridetwin.streams.samples import Array

_SWING_WITH_STEP = 0.35  # swing time grows as step time to this power: slow walkers stay longer on both feet
_LEAST_SHARE = 0.2  # of the tabled amplitudes
_HEIGHT_SLOW = 0.985  # pelvis, legs
_LEAST_DOUBLE_SUPPORT = 0.08
# Beyond the table's fastest style, per unit of dimensionless speed: double support continues to shrink at its rate,
# the pelvis is lower (leg lengths) and the swing foot reaches less far forward (share), so that the legs reach.
_SHORTER_SUPPORT_FASTER, _LOWER_FASTER, _LESS_LEAD = 0.16, 0.12, 2.0
_SHUFFLE_SHORTENS, _SHUFFLE_FLATTENS, _SHUFFLE_LOWERS, _SHUFFLE_STAYS = 0.45, 0.75, 0.85, 0.25


def walk_growth(pace: Array | float) -> Array:
    """Step length over leg length at a dimensionless speed, up to a constant factor.

    The walk ratio (length / cadence) is constant at a given leg length (Sekiya & Nagasaki 1998, Gait Posture
    7:225-227), so that length grows with the root of speed; slower than 0.2 it grows as speed^0.42 (Grieve & Gear
    1966, Ergonomics 9:379-399).
    """
    own = np.maximum(pace, 1e-6)
    return np.where(own > 0.2, np.sqrt(own), np.sqrt(0.2) * (own / 0.2) ** 0.42)


def style_at(pace: float) -> Style:
    """Style at any dimensionless speed: the table's, extrapolated beyond its ends.

    Below the table, both feet stay longer on the ground while swing time hardly grows, and all amplitudes shrink with
    the step length. Above it, double support continues to shrink.
    """
    style = level_style(pace)
    slowest, fastest = tabled()
    if pace > fastest:
        beyond = pace - fastest
        height = style.height.copy()
        height[0] -= _LOWER_FASTER * beyond
        support = np.maximum(style.double_support - _SHORTER_SUPPORT_FASTER * beyond, _LEAST_DOUBLE_SUPPORT)
        return replace(
            style, double_support=support, height=height, forward=style.forward * max(1.0 - _LESS_LEAD * beyond, 0.0)
        )
    if pace >= slowest:
        return style
    shorter = float(walk_growth(pace) / walk_growth(slowest))
    longer = shorter * slowest / max(pace, 1e-6)
    style = _scaled(style, max(shorter, _LEAST_SHARE))
    height = style.height.copy()
    height[0] += (1.0 - shorter) * (_HEIGHT_SLOW - height[0])
    return held(replace(style, height=height), longer, longer**_SWING_WITH_STEP)


def shuffled(style: Style, shuffle: float) -> Style:
    """Style of feet that slide along: flat, low, and with short swings; `shuffle` from 0 to 1."""
    if shuffle == 0.0:
        return style
    k = 1.0 - _SHUFFLE_LOWERS * shuffle
    flat = _scaled(style, 1.0 - _SHUFFLE_FLATTENS * shuffle)
    flat = replace(flat, forward=style.forward * k, lift=style.lift * k)
    return held(flat, 1.0, 1.0 - _SHUFFLE_STAYS * shuffle)


def shuffled_share(shuffle: float) -> float:
    """Step length of a shuffling walker as a share of the normal one."""
    return 1.0 - _SHUFFLE_SHORTENS * shuffle


def held(style: Style, longer: float, swing_longer: float = 1.0) -> Style:
    """Style of a step that takes `longer` times as long, while its swing takes `swing_longer` times as long."""
    share = swing_longer / longer
    return replace(
        style,
        double_support=1.0 - (1.0 - style.double_support) * share,
        heel_off_before=style.heel_off_before * share,
        flat_after=style.flat_after * share,
    )


def _scaled(style: Style, k: float) -> Style:
    """Style with the amplitudes of feet and pelvis scaled."""
    height = np.concatenate([style.height[:1], k**2 * style.height[1:]])
    return replace(
        style, pitch=k * style.pitch, height=height, forward=k * style.forward, lift=k * style.lift,
        list_=k * style.list_,
    )  # fmt: skip
