"""Walking styles on the level, by speed: timing, foot pitch, centre of pressure, pelvis and swing in one table.

The table `level_style.csv` is the result of `python -m tools.fit_gait_cycle`, fitted to the joint angles of Schwartz,
Rozumalski & Trost 2008 and the corresponding ground reactions. Speeds are dimensionless, v / sqrt(g leg), lengths are
in leg lengths (hip centre to sole), angles in rad. The style also changes with manner: outside the table's speeds, with
a shuffle, or before a pause.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Array

SWING_KNOTS = (0.0, 0.08, 0.18, 0.30, 0.44, 0.60, 0.76, 0.89, 1.0)  # shares of swing
RISE_KNOTS = (0.0, 0.30, 0.55, 0.80, 1.0)  # shares of the time from heel-off to toe-off
TRAVEL_KNOTS = (0.0, 0.08, 0.20, 0.36, 0.54, 0.72, 0.87, 1.0)  # shares of stance


@dataclass(frozen=True, kw_only=True, eq=False)
class Style:
    """Style of walking on the level.

    Attributes:
        double_support: Share of a step with both feet on the ground.
        transfer: Share of double support in which the load moves from foot to foot.
        flat_after: Time from touch-down until the foot is flat, as a share of the step.
        heel_off_before: Time from heel-off to toe-off, as a share of the step.
        rise: (3,) pitch at the inner `RISE_KNOTS`, as a share of that at toe-off.
        pitch: (9,) pitch of the foot at `SWING_KNOTS`, rad, toes down positive.
        travel: (8,) centre of pressure at `TRAVEL_KNOTS`, as a share of the toe hinge's x.
        height: (7,) pelvis height in leg lengths: mean, then cosine and sine of the first three harmonics of the step.
        forward: (7,) polynomial of the swing foot's forward offset from its smooth path, in leg lengths.
        lift: (5,) polynomial of its height above that path, in leg lengths.
        tilt: Anterior pelvis tilt, rad.
    """

    double_support: float
    transfer: float
    flat_after: float
    heel_off_before: float
    rise: Array
    pitch: Array
    travel: Array
    height: Array
    forward: Array
    lift: Array
    tilt: float

    @classmethod
    def from_vector(cls, x: Array) -> Style:
        """Style from the vector of `to_vector`, (`len(LABELS)`,), the fields in the order above."""
        parts = np.split(np.asarray(x, dtype=float), np.cumsum(list(SIZES.values()))[:-1])  # one array per field
        values: dict[str, Any] = {name: part if SIZES[name] > 1 else float(part[0]) for name, part in zip(SIZES, parts)}
        return cls(**values)

    def to_vector(self) -> Array:
        """(`len(LABELS)`,) all fields one after another, as the table of styles and its fit use them."""
        return np.concatenate([np.atleast_1d(getattr(self, f.name)) for f in fields(self)])


SIZES = {
    "double_support": 1,
    "transfer": 1,
    "flat_after": 1,
    "heel_off_before": 1,
    "rise": 3,
    "pitch": 9,
    "travel": 8,
    "height": 7,
    "forward": 7,
    "lift": 5,
    "tilt": 1,
}
"""Number of entries of each field of `Style`, in the order of the fields."""
LABELS = tuple(f"{name}_{i}" if n > 1 else name for name, n in SIZES.items() for i in range(n))
"""Names of the entries of a style's vector: the field, and its number in a field of several entries."""


def leg_length(size: Wearer) -> float:
    """Hip centre to sole of the straight leg, m."""
    return size.body.thigh_m + size.body.shank_m + size.body.ankle_height_m


def pace(speed_mps: float, size: Wearer) -> float:
    """Dimensionless speed of a walker, v / √(g l) with the leg length l: the root of the Froude number."""
    return float(speed_mps / np.sqrt(NOMINAL_GRAVITY_MPS2 * leg_length(size)))


def level_style(pace_: float) -> Style:
    """Style at a dimensionless speed; constant beyond the table's ends."""
    paces, rows = _read_table()  # dimensionless speeds, and a row of values at them for each parameter
    return Style.from_vector(np.array([np.interp(pace_, paces, row) for row in rows]))


@cache
def _read_table() -> tuple[Array, Array]:
    """The table `level_style.csv`: (K,) dimensionless speeds, and (len(LABELS), K) style parameters at each."""
    text = resources.files("stridetwin.sim.gait").joinpath("level_style.csv").read_text(encoding="utf-8")
    lines = [row for row in csv.reader(text.splitlines()) if row and not row[0].startswith("#")]
    # a line is a label and its values; that of `pace` are the speeds
    values = {row[0]: [float(v) for v in row[1:]] for row in lines}
    return np.array(values["pace"]), np.array([values[label] for label in LABELS])


# Styles outside the table and of shuffling feet; chosen by hand, so that the legs reach the footsteps.
#
# The changes beyond the table's fastest style are per unit of dimensionless speed, those of a shuffle are shares of
# the usual value at full shuffle.
_SWING_WITH_STEP = 0.35  # swing time grows as step time to this power: slow walkers stay longer on both feet
_MIN_AMPLITUDE_SHARE = 0.2  # of the table's amplitudes, at the lowest speed
_HEIGHT_SLOW = 0.985  # pelvis at the lowest speed, leg lengths
_MIN_DOUBLE_SUPPORT = 0.08  # share of a step
_SHORTER_SUPPORT_FASTER = 0.16  # share of a step by which double support continues to shrink
_LOWER_FASTER = 0.12  # leg lengths by which the pelvis is lower
_SHUFFLE_SHORTENS = 0.45  # step length
_SHUFFLE_FLATTENS = 0.75  # pitch and pelvis
_SHUFFLE_LOWERS = 0.85  # lift of the swing foot
_SHUFFLE_STAYS = 0.25  # swing time


def walk_growth(pace: Array | float) -> Array:
    """Step length over leg length at a dimensionless speed, up to a constant factor.

    The walk ratio (length / cadence) is constant at a given leg length (Sekiya & Nagasaki 1998, Gait Posture
    7:225-227), so that length grows with the root of speed; slower than 0.2 it grows as speed^0.42 (Grieve & Gear
    1966, Ergonomics 9:379-399).
    """
    positive_pace = np.maximum(pace, 1e-6)
    return np.where(positive_pace > 0.2, np.sqrt(positive_pace), np.sqrt(0.2) * (positive_pace / 0.2) ** 0.42)


def style_at(pace: float) -> Style:
    """Style at any dimensionless speed: the table's, extrapolated beyond its ends.

    Below the table, both feet stay longer on the ground while swing time hardly grows, and all amplitudes shrink with
    the step length. Above it, double support continues to shrink.
    """
    style = level_style(pace)
    paces, _ = _read_table()
    slowest, fastest = paces[[0, -1]].tolist()
    if pace > fastest:
        beyond = pace - fastest
        height = style.height.copy()
        height[0] -= _LOWER_FASTER * beyond  # mean height of the pelvis
        support = style.double_support - _SHORTER_SUPPORT_FASTER * beyond
        return replace(
            style,
            double_support=np.maximum(support, _MIN_DOUBLE_SUPPORT),
            height=height,
        )
    if pace >= slowest:
        return style
    # below the table: ratios of step length and of step time to the slowest style of the table
    shorter = float(walk_growth(pace) / walk_growth(slowest))
    longer = shorter * slowest / max(pace, 1e-6)  # time is length over speed
    style = _scale_amplitudes(style, max(shorter, _MIN_AMPLITUDE_SHARE))
    height = style.height.copy()
    height[0] += (1.0 - shorter) * (_HEIGHT_SLOW - height[0])  # the mean goes to that of the lowest speed
    return prolong(replace(style, height=height), longer, longer**_SWING_WITH_STEP)


def apply_shuffle(style: Style, shuffle: float) -> Style:
    """Style of feet that slide along the ground: flat, low, and with short swings.

    `shuffle` is the amount from 0, unchanged, to 1.
    """
    if shuffle == 0.0:
        return style
    swing_factor = 1.0 - _SHUFFLE_LOWERS * shuffle  # of the swing foot's offsets forward and up
    flat = _scale_amplitudes(style, 1.0 - _SHUFFLE_FLATTENS * shuffle)
    # for those offsets, `swing_factor` takes the place of the factor on the amplitudes
    flat = replace(flat, forward=style.forward * swing_factor, lift=style.lift * swing_factor)
    return prolong(flat, 1.0, 1.0 - _SHUFFLE_STAYS * shuffle)  # a shorter swing in a step of the same duration


def shuffle_step_share(shuffle: float) -> float:
    """Step length of a shuffling walker as a share of the normal one."""
    return 1.0 - _SHUFFLE_SHORTENS * shuffle


def prolong(style: Style, longer: float, swing_longer: float = 1.0) -> Style:
    """Style of a step that takes longer than the style's own.

    The shares of double support, heel-off and flat foot are adapted, so that the swing has its time.

    Args:
        style: Style of the shorter step.
        longer: Duration relative to that step.
        swing_longer: Duration of the swing relative to its swing.
    """
    # factor on the shares of the step that the swing and the times around it take; what is left is double support
    factor = swing_longer / longer
    return replace(
        style,
        double_support=1.0 - (1.0 - style.double_support) * factor,
        heel_off_before=style.heel_off_before * factor,
        flat_after=style.flat_after * factor,
    )


def _scale_amplitudes(style: Style, k: float) -> Style:
    """Style with smaller amplitudes: pitch, swing times k, the pelvis' oscillation times k²."""
    return replace(
        style,
        pitch=k * style.pitch,
        height=np.append(style.height[0], k**2 * style.height[1:]),
        forward=k * style.forward,
        lift=k * style.lift,
    )
