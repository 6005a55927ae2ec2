"""Predicted steps and modes in a Rerun file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from stridetwin.estimators.locomotion_mode import MODES, UNKNOWN, ModeEstimate, StepPrediction
from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.alignment import YawAlignment
from stridetwin.outputs.modes.figures import ellipse
from stridetwin.outputs.rerun_curves import log_curves
from stridetwin.outputs.route_figures import outline
from stridetwin.outputs.terrain.grid import CLASS_COLORS, CLASS_NAMES, GROUND_CLASSES
from stridetwin.streams.samples import Array, Footprint

if TYPE_CHECKING:
    from rerun import RecordingStream

STEPS, MODE = "world/steps", "modes"  # entities in the viewer
_STEPS_HZ = 5.0  # most predictions drawn per second
_TRUE = (240, 244, 248)  # RGB of the true footprints
_ABOVE_M = 0.01
"""How far lines lie above the ground, so that they are seen."""


def log_modes(rerun: ModuleType, stream: RecordingStream, estimates: list[ModeEstimate], walk: AlignedWalk) -> None:
    """Logs `world/steps/{true,predicted,ellipses}`, `modes/probability/MODE` and `modes/predicted` over time.

    Args:
        rerun: The module `rerun`.
        stream: Its stream.
        estimates: In time order.
        walk: The walk beside the truth.
    """
    _log_footprints(rerun, stream, walk.footprints)
    _log_steps(rerun, stream, estimates, walk)
    _log_probabilities(rerun, stream, [e for e in estimates if e.steps])


def _log_footprints(rerun: ModuleType, stream: RecordingStream, footprints: list[Footprint]) -> None:
    """Logs the outlines of the true footprints, each from its touch-down on."""
    # (5, 3) m each, in the true world
    outlines = [
        _close_outline(np.column_stack([outline(f), np.full(4, f.p_foot_in_world[2] + _ABOVE_M)])) for f in footprints
    ]
    for i, footprint in enumerate(footprints):
        stream.set_time("time", duration=footprint.t_ns * 1e-9)
        stream.log(f"{STEPS}/true", rerun.LineStrips3D(outlines[: i + 1], colors=[_TRUE], radii=[0.005]))


def _log_steps(rerun: ModuleType, stream: RecordingStream, estimates: list[ModeEstimate], walk: AlignedWalk) -> None:
    """Logs the predicted steps and their 95 % ellipses in the true world, at `_STEPS_HZ`.

    Args:
        rerun: The module `rerun`.
        stream: Its stream.
        estimates: In time order.
        walk: Aligns the odometry's world with the true one.
    """
    for estimate in _thin_out(estimates):
        alignment = walk.alignment.at(estimate.t_ns)
        predicted = [s for s in estimate.steps if np.isfinite(s.p_foot_in_world[:2]).all()]
        colors = [CLASS_COLORS[GROUND_CLASSES.index("none" if s.mode == UNKNOWN else s.mode)] for s in predicted]
        stream.set_time("time", duration=estimate.t_ns * 1e-9)
        outlines = [_sole_outline(s, estimate, alignment) for s in predicted]
        stream.log(f"{STEPS}/predicted", rerun.LineStrips3D(outlines, colors=colors, radii=[0.006]))
        # each with its colour; steps whose covariance is unknown have none
        ellipses = [
            (_flat_ellipse(sole, alignment.rotation @ s.covariance @ alignment.rotation.T), c)
            for s, sole, c in zip(predicted, outlines, colors)
            if np.isfinite(s.covariance).all()
        ]
        lines = rerun.LineStrips3D([e for e, _ in ellipses], colors=[c for _, c in ellipses], radii=[0.003])
        stream.log(f"{STEPS}/ellipses", lines)


def _log_probabilities(rerun: ModuleType, stream: RecordingStream, estimates: list[ModeEstimate]) -> None:
    """Logs the probability of each mode of the next step, and the prediction as text where it changes.

    Args:
        rerun: The module `rerun`.
        stream: Its stream.
        estimates: In time order, each with at least one predicted step.
    """
    if not estimates:
        return
    t_ns = np.array([e.t_ns for e in estimates])
    for i, mode in enumerate(MODES):
        entity = f"{MODE}/probability/{mode}"
        p = np.array([[e.steps[0].probabilities[mode]] for e in estimates])  # (N, 1)
        log_curves(rerun, stream, entity, t_ns, p, (CLASS_NAMES[mode],), colors=[CLASS_COLORS[i]])
    before = ""
    for estimate in _thin_out(estimates):
        text = prediction_text(estimate)
        if text != before:  # only a text that differs from the last logged one
            stream.set_time("time", duration=estimate.t_ns * 1e-9)
            stream.log(f"{MODE}/predicted", rerun.TextDocument(text))
            before = text


def prediction_text(estimate: ModeEstimate) -> str:
    """The prediction of the next step and of the next terrain change, as text."""
    step, change = estimate.steps[0], estimate.change
    foot = {"l": "left", "r": "right"}.get(step.foot, "next")
    lines = [f"next step ({foot}): {CLASS_NAMES[step.mode]}, {100 * step.probability:.0f} %"]
    if change is not None:
        size = ""
        if math.isfinite(change.riser):
            size = f", riser {1e3 * change.riser:.0f} mm"
        if math.isfinite(change.tread):
            size += f", tread {1e3 * change.tread:.0f} mm"
        if math.isfinite(change.slope):  # a ramp, which has no riser and no tread
            size = f", {math.degrees(change.slope):.1f}°"
        lines.append(f"then {CLASS_NAMES[change.mode]} in {change.distance:.1f} m{size}")
    return "\n".join(lines)


def _thin_out(estimates: list[ModeEstimate]) -> Iterator[ModeEstimate]:
    """Estimates at about `_STEPS_HZ`, and every one at which the number of steps changes."""
    due_ns, step = -(2**62), -1  # earlier than any estimate, and no number of steps: the first one always comes
    for estimate in estimates:
        if estimate.t_ns >= due_ns or estimate.step != step:
            # 0.9 of the period: estimates that come slightly early still count
            due_ns, step = estimate.t_ns + int(0.9e9 / _STEPS_HZ), estimate.step
            yield estimate


def _sole_outline(step: StepPrediction, estimate: ModeEstimate, alignment: YawAlignment) -> Array:
    """(5, 3) m, closed outline of the sole of a predicted step in the true world.

    Ground of unknown height is drawn at the odometry's floor.

    Args:
        step: The predicted step.
        estimate: The estimate that predicts it; its heading is the foot's.
        alignment: From the odometry's world to the true one, at the estimate.
    """
    # half of the yaw in the true world, for the quaternion; the outline uses place, foot and yaw alone
    half = 0.5 * (estimate.heading + alignment.yaw)
    place = alignment.to_true(np.nan_to_num(step.p_foot_in_world, nan=0.0))
    footprint = Footprint(
        topic="",
        t_ns=step.t_ns,
        foot=step.foot,
        p_foot_in_world=place,
        terrain="",
        mode=step.mode,
        q_world_foot=np.array([math.cos(half), 0.0, 0.0, math.sin(half)]),
    )
    return _close_outline(np.column_stack([outline(footprint), np.full(4, place[2] + _ABOVE_M)]))


def _flat_ellipse(sole: Array, covariance: Array) -> Array:
    """(25, 3) m, the 95 % ellipse of the sole's centre, at the sole's height.

    Args:
        sole: (5, 3) m, closed outline of the sole.
        covariance: (2, 2) m², of the horizontal position in the same world.
    """
    middle = sole[:4].mean(axis=0)
    xy = ellipse(middle, covariance)
    return np.column_stack([xy, np.full(len(xy), middle[2])])


def _close_outline(corners: Array) -> Array:
    """(N + 1, 3) corners of an outline (N, 3) with the first one repeated at the end."""
    return np.vstack([corners, corners[:1]])
