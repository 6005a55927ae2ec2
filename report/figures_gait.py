"""Figures of the gait: joint angles over the gait cycle, ground reaction, centre of pressure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import FOOT_NAMES
from stridetwin.outputs.path.figures import COLORS
from stridetwin.pages.plot import MUTED, Plot, faint
from stridetwin.reference.norms import level_norm, read_reference, speed_group
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array, Footprint

_JOINTS = {
    "hip_flexion": "Hip flexion",
    "knee_flexion": "Knee flexion",
    "ankle_dorsiflexion": "Ankle dorsiflexion",
}
_CYCLE = np.linspace(0.0, 100.0, 101)  # parts of the gait cycle at which curves are drawn, %
_LOAD_PCT = {"first_peak": (10.0, 20.0), "valley": (25.0, 37.0), "second_peak": (43.0, 53.0)}
"""Where in the gait cycle the vertical load has its peaks and valley at a comfortable speed: begin and end, %."""
# rectangle whose points of the centre of pressure are drawn: ahead of the heel, from and to, and half of its width
_SOLE_FROM_M, _SOLE_TO_M, _SOLE_HALF_WIDTH_M = -0.05, 0.32, 0.08
_PAUSE_NS = 30_000_000  # a longer pause breaks a path of the centre of pressure


@dataclass(frozen=True, kw_only=True, eq=False)
class Stride:
    """One stride of one foot on the level, from touchdown to touchdown of that foot.

    Attributes:
        foot: `l` or `r`.
        start_ns: Touchdown.
        end_ns: Next touchdown of the foot.
        speed_mps: Length of the stride divided by its duration.
    """

    foot: str
    start_ns: int
    end_ns: int
    speed_mps: float


def level_strides(footprints: list[Footprint]) -> list[Stride]:
    """Strides whose footprints are all level walking, without the first and last steps of the walk.

    Args:
        footprints: Of both feet, in time order.
    """
    steady = footprints[1:-1]
    strides = []
    for first, other, last in zip(steady, steady[1:], steady[2:]):  # three footprints in a row
        # a stride of one foot with one step of the other within it
        is_stride = first.foot == last.foot != other.foot
        if is_stride and all(p.mode == "LG" and p.terrain == "level" for p in (first, other, last)):
            length_m = float(np.linalg.norm(last.p_foot_in_world - first.p_foot_in_world))
            seconds = (last.t_ns - first.t_ns) * 1e-9
            stride = Stride(foot=first.foot, start_ns=first.t_ns, end_ns=last.t_ns, speed_mps=length_m / seconds)
            strides.append(stride)
    return strides


def over_cycle(stride: Stride, t_ns: NDArray[np.int64], values: Array) -> Array:
    """Interpolates values over the gait cycle: (101,) values at 0, 1, ... 100 % of the stride.

    Args:
        stride: The stride.
        t_ns: (N,) stamps that increase.
        values: (N,) values at the stamps.
    """
    instants_ns = stride.start_ns + _CYCLE / 100.0 * (stride.end_ns - stride.start_ns)
    return np.interp(instants_ns, t_ns, values)


def joint_figures(recording: Recording, strides: list[Stride]) -> list[Markup]:
    """Draws hip, knee and ankle angles in degrees over the gait cycle, with the norm band of people at that speed.

    Returns:
        A figure per joint; none without true joint angles or level strides.
    """
    if "/truth/joints" not in recording.topics or not strides:
        return []
    block = recording.block("/truth/joints")
    # (N,) degrees, by the name of the joint, such as `hip_flexion_l`
    angles = dict(zip(block.constants["names"], np.degrees(block.columns["position"]).T))
    # people's curves at the mean speed of the walk
    group = speed_group(float(np.mean([s.speed_mps for s in strides])))
    figures = []
    for joint, title in _JOINTS.items():
        x, mean, sd = level_norm(group, f"{joint}_deg")  # gait cycle, %; mean and standard deviation, degrees
        plot = Plot(title=f"{title} over the gait cycle", x=(0, 100), x_label="gait cycle, %", y_label=f"{title}, °")
        for within, opacity in ((2, 0.1), (1, 0.2)):
            plot.band(x, mean - within * sd, mean + within * sd, faint(MUTED, opacity), label=f"people, ±{within} SD")
        curves = {f: (block.t_ns, angles[f"{joint}_{f}"]) for f in FOOT_NAMES if f"{joint}_{f}" in angles}
        _draw_strides(plot, strides, curves)
        figures.append(plot.html())
    return figures


def ground_reaction_figure(recording: Recording, strides: list[Stride], carried_weight_n: float) -> str:
    """Vertical load of one foot over the gait cycle, in multiples of the carried weight; empty without its truth.

    At a comfortable speed, boxes show the ranges of people's two peaks and of the valley between them.

    Args:
        recording: The walk.
        strides: Strides on the level.
        carried_weight_n: Weight that the feet carry at the site of the walk: of the person and of the exoskeleton.
    """
    loads = {}  # by foot: stamps, ns, and vertical load as a share of the carried weight
    for foot in FOOT_NAMES:
        topic = f"/truth/foot_{foot}/wrench"
        if topic in recording.topics and any(s.foot == foot for s in strides):
            block = recording.block(topic)
            load = block.columns["force_in_world"][:, 2] / carried_weight_n
            loads[foot] = block.t_ns, load
    if not loads:
        return ""
    plot = Plot(
        title="Vertical ground reaction",
        x=(0, 100),
        x_label="gait cycle, %",
        y_label="force / carried weight",
    )
    # "Free" is the comfortable speed in the reference, the only one for which it has these ranges
    if speed_group(float(np.mean([s.speed_mps for s in strides]))) == "Free":
        level_norms: Any = read_reference("gait_norms")["level_walking"]
        norms = level_norms["vertical_grf_bw"]
        for name, (begin_pct, end_pct) in _LOAD_PCT.items():
            low, high = norms[name]
            plot.bars(begin_pct, end_pct, low, high, faint(MUTED, 0.2), label="people, range")
    _draw_strides(plot, strides, loads)
    return plot.html()


def _draw_strides(plot: Plot, strides: list[Stride], curves: Mapping[str, tuple[NDArray[np.int64], Array]]) -> None:
    """Draws every stride of a foot as one curve over the gait cycle.

    Args:
        plot: Where they are drawn.
        strides: Strides of both feet.
        curves: Stamps (N,) ns and values (N,) by foot.
    """
    for foot, (t_ns, values) in curves.items():
        over_cycles = [np.column_stack([_CYCLE, over_cycle(s, t_ns, values)]) for s in strides if s.foot == foot]
        plot.curves(over_cycles, COLORS[foot], width=0.9, label=f"{FOOT_NAMES[foot]} strides")


def pressure_figure(recording: Recording, footprints: list[Footprint]) -> str:
    """Draws the path of the centre of pressure under each foot, in the frame of the footprint that it belongs to.

    The frame has its origin at the heel, x along the foot's axis and y to the left. Points outside the sole are left
    out, and a pause of more than 30 ms breaks a path.
    """
    plot = Plot(
        title="Centre of pressure",
        x_label="ahead of the heel, m",
        y_label="left of the axis, m",
        x=(-0.04, 0.30),
        y=(-0.11, 0.11),
    )
    for foot in FOOT_NAMES:
        topic = f"/truth/foot_{foot}/cop"
        prints = [p for p in footprints if p.foot == foot]
        if topic not in recording.topics or not prints:
            continue
        block = recording.block(topic)
        # number of the footprint at each sample, -1 before the first
        of_print = np.searchsorted([p.t_ns for p in prints], block.t_ns, side="right") - 1
        paths = []
        for i, p in enumerate(prints[:-1]):  # the last footprint has no next one that ends it
            rows = np.flatnonzero(of_print == i)
            local = _in_footprint(block.columns["p_in_world"][rows], p)
            ahead, left = local.T
            inside = (np.abs(left) < _SOLE_HALF_WIDTH_M) & (ahead > _SOLE_FROM_M) & (ahead < _SOLE_TO_M)
            # where a part of the path begins after a pause
            breaks = np.flatnonzero(np.diff(block.t_ns[rows][inside]) > _PAUSE_NS) + 1
            # at most some 120 points of each part
            paths += [part[:: max(1, len(part) // 60)] for part in np.split(local[inside], breaks) if len(part)]
        if paths:
            plot.curves(paths, COLORS[foot], width=0.8, label=f"{FOOT_NAMES[foot]} foot")
    return plot.html() if plot.drawn else ""


def _in_footprint(points_in_world: Array, footprint: Footprint) -> Array:
    """Transforms points (N, 3) in the world to (N, 2) m: ahead of the heel, and left of the axis of a footprint."""
    rotation = Rotation.from_quat(footprint.q_world_foot, scalar_first=True)
    return np.asarray(rotation.apply(points_in_world - footprint.p_foot_in_world, inverse=True))[:, :2]
