"""Walking styles on the level, by speed: timing, foot pitch, centre of pressure, pelvis and swing in one table.

The table `level_style.csv` is the result of `python -m tools.fit_gait_cycle`, fitted to the joint angles of Schwartz,
Rozumalski & Trost 2008 and the corresponding ground reactions. Speeds are dimensionless, v / sqrt(g leg), lengths are
in leg lengths (hip centre to sole), angles in rad.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, fields
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from stridetwin.sim.body import Wearer
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
        forward: (5,) polynomial of the swing foot's forward offset from its smooth path, in leg lengths.
        lift: (5,) likewise of its height.
        tilt: Anterior pelvis tilt, rad.
        turn: Pelvis rotation per leg length of distance between the feet, rad.
        list_: Amplitude of the pelvis obliquity, rad.
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
    turn: float
    list_: float

    @classmethod
    def of_vector(cls, x: Array) -> Style:
        """Style from a vector of its fields in the order above."""
        ends = np.cumsum(list(SIZES.values()))[:-1]
        parts = np.split(np.asarray(x, dtype=float), ends)
        values: dict[str, Any] = {name: part if SIZES[name] > 1 else float(part[0]) for name, part in zip(SIZES, parts)}
        return cls(**values)

    def vector(self) -> Array:
        """The fields as one vector."""
        return np.concatenate([np.atleast_1d(getattr(self, f.name)) for f in fields(self)])


SIZES = {
    "double_support": 1, "transfer": 1, "flat_after": 1, "heel_off_before": 1, "rise": 3, "pitch": 9, "travel": 8,
    "height": 7, "forward": 5, "lift": 5, "tilt": 1, "turn": 1, "list_": 1,
}  # fmt: skip
LABELS = tuple(f"{name}_{i}" if n > 1 else name for name, n in SIZES.items() for i in range(n))


def leg_length(size: Wearer) -> float:
    """Hip centre to sole of the straight leg, m."""
    return size.body.thigh_m + size.body.shank_m + size.body.ankle_height_m


def pace(speed_mps: float, size: Wearer) -> float:
    """Dimensionless speed, the root of the Froude number."""
    return float(speed_mps / np.sqrt(NOMINAL_GRAVITY_MPS2 * leg_length(size)))


def level_style(pace_: float) -> Style:
    """Style at a dimensionless speed; constant beyond the table's ends."""
    paces, rows = _table()
    return Style.of_vector(np.array([np.interp(pace_, paces, row) for row in rows]))


def tabled() -> tuple[float, float]:
    """Slowest and fastest dimensionless speed of the table."""
    paces, _ = _table()
    return float(paces[0]), float(paces[-1])


@cache
def _table() -> tuple[Array, Array]:
    """Dimensionless speeds (K,) and the style parameters at each (len(LABELS), K)."""
    text = resources.files("stridetwin.sim.gait").joinpath("level_style.csv").read_text(encoding="utf-8")
    lines = [row for row in csv.reader(text.splitlines()) if row and not row[0].startswith("#")]
    values = {row[0]: [float(v) for v in row[1:]] for row in lines}
    return np.array(values["pace"]), np.array([values[label] for label in LABELS])
