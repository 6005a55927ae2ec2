"""Recorded orientations of segments become points on a wearer, so that joint angles are fitted as markers are.

A source of joint angles gives the orientation of each segment, the path of the middle of the hips, and the lengths that
it knows. The segments are joined with these lengths, or those of the person. Lengths of the legs that neither knows are
those with which the feet stand still: in a rest the ankle is

    hips(t) + R_pelvis(t) (o ± w) − thigh R_thigh(t) z − shank R_shank(t) z = constant,

which is linear in the lengths, half the width w of the hips, and their place o in the pelvis. What a source takes as
the sole is turned so that it lies flat in the rests. Points that are fixed to the segments are the markers of the fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.sim.motion.ik import PointSet
from stridetwin.sim.motion.parameters import MotionParameters
from stridetwin.sim.motion.rests import FootRest, FootTrack, stances_of
from stridetwin.sim.motion.skeleton import LENGTHS, Skeleton, length_values, lengths_of, with_lengths
from stridetwin.sim.people import Person
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

_ARM_M = 0.1  # from a joint to the points that show the orientation
_FITTED = ("thigh_m", "shank_m", "hip_width_m")
_SCATTER_M = (0.03, 0.03, 0.01, 0.02, 0.02)  # of these lengths, and of the place of the hips in the pelvis (x, z)
_FOOT_WEIGHT = 4.0  # of points on the feet, which the ground shows, relative to those on other segments
_STILL_SD_M = 0.005  # of a foot in its rest
_INDEPENDENT = 5.0  # rows of a rest whose errors are independent
_ROUNDS = 4
_SIDES = {"l": 1.0, "r": -1.0}  # and the side of the pelvis on which the hip is
NEEDED = ("pelvis", "thigh_l", "thigh_r", "shank_l", "shank_r", "foot_l", "foot_r")
"""Segments without whose orientation there is no walk."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SegmentMotion:
    """Orientations of a person's segments over time, z up.

    Attributes:
        source: File.
        dt: Time between two rows, s.
        hips: (N, 3) m, middle of the hip centres.
        R: (N, 3, 3) by body of the wearer, body (x forward, y left, z up) to the laboratory.
        lengths: Lengths of segments that the source knows, by names of `LENGTHS`, m.
        sole_outward_m: By which the sole's middle is farther outward than the ankle.
        knee_slide: (N, 3) m by side, in the thigh's axes, by which the shank slides in the knee; empty for hinges.
    """

    source: str
    dt: float
    hips: Array
    R: Mapping[str, Array]
    lengths: Mapping[str, float]
    sole_outward_m: float = 0.0
    knee_slide: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Checks that there is a pelvis with two legs.

        Raises:
            ConfigError: A segment is missing, or a value is no number.
        """
        missing = [body for body in NEEDED if body not in self.R]
        if missing:
            raise ConfigError(self.source, "joints", f"none for {', '.join(missing)}", "a pelvis and two whole legs")
        for name, values in {"pelvis": self.hips, **self.R}.items():
            if not np.isfinite(values).all():
                raise ConfigError(self.source, name, "NaN", "numbers in every frame")


def fit_legs(motion: SegmentMotion, person: Person, parameters: MotionParameters) -> tuple[SegmentMotion, Person]:
    """The motion and the person with legs with which the feet stand still, and with soles that lie flat in rests.

    Lengths are fitted unless thigh and shank are known.

    Args:
        motion: The source.
        person: The person.
        parameters: What a rest is.

    Returns:
        The motion, whose hips may be displaced in the pelvis; the person with all lengths.

    Raises:
        StrideTwinError: A foot never rests.
    """
    known = {} if person.segments is None else {k: v for k, v in vars(person.segments).items() if v is not None}
    known |= motion.lengths
    start = lengths_of(replace(person, segments=None))
    person = with_lengths(person, [known.get(name, value) for name, value in zip(LENGTHS, length_values(start))])
    fits_lengths = not {"thigh_m", "shank_m"} <= set(known)
    free = [LENGTHS.index(name) for name in _FITTED]
    prior = np.append(length_values(person)[free], [0.0, 0.0])
    values = prior
    R, soles = motion.R, {side: motion.R[f"foot_{side}"] for side in _SIDES}
    columns = {
        side: np.stack(
            [
                -R[f"thigh_{side}"][..., 2],
                -R[f"shank_{side}"][..., 2],
                0.5 * out * R["pelvis"][..., 1],
                R["pelvis"][..., 0],
                R["pelvis"][..., 2],
            ],
            axis=-1,
        )
        for side, out in _SIDES.items()
    }  # (N, 3, 5) by which each value moves the ankle
    starts = {side: motion.hips + _slide(motion, side) for side in _SIDES}
    for _ in range(_ROUNDS):
        skeleton = Skeleton.of(person)
        anchor = skeleton.anchor[skeleton.index("foot_l")]
        tracks = [
            FootTrack(
                side=side,
                p=starts[side] + columns[side] @ values - soles[side] @ anchor,
                R=soles[side],
                toe=np.zeros(len(motion.hips)),
            )
            for side in _SIDES
        ]
        rests = stances_of(tracks, skeleton.size.shoe, motion.dt, parameters)
        soles = {side: soles[side] @ _level_sole(soles[side], rests, side) for side in _SIDES}
        if fits_lengths:
            values = _fit_lengths(starts, columns, rests, prior)
            lengths = length_values(person)
            lengths[free] = values[: len(free)]
            person = with_lengths(person, lengths)
    hips = motion.hips + R["pelvis"] @ np.array([values[-2], 0.0, values[-1]])
    turned = {f"foot_{side}": R_sole for side, R_sole in soles.items()}
    turned |= {
        f"toe_{side}": R[f"toe_{side}"] @ np.swapaxes(R[f"foot_{side}"], 1, 2)[0] @ R_sole[0]
        for side, R_sole in soles.items()
        if f"toe_{side}" in R
    }
    return replace(motion, hips=hips, R={**R, **turned}), person


def points_of(motion: SegmentMotion, skeleton: Skeleton, parameters: MotionParameters) -> PointSet:
    """Points on all segments whose orientation is known.

    Args:
        motion: The source.
        skeleton: The wearer, whose lengths join the segments.
        parameters: Scatter of the points.
    """
    R: list[Array] = []
    p: list[Array] = []
    names, bodies, places, paths, weights = [], [], [], [], []
    for b, (body, up) in enumerate(zip(skeleton.bodies, skeleton.parent)):
        anchor = skeleton.anchor[b]
        if up < 0:  # the root, to which the pelvis is fixed
            R.append(motion.R["pelvis"])
            p.append(motion.hips)
            continue
        R.append(motion.R.get(body, R[up]))
        p.append(p[up] + R[up] @ (skeleton.offset[b] + anchor) - R[b] @ anchor)
        if body.startswith("shank"):
            p[b] = p[b] + _slide(motion, body[-1])
        if body in motion.R:
            is_foot = body.startswith(("foot", "toe"))
            aside = motion.sole_outward_m * _SIDES[body[-1]] if is_foot else 0.0
            # the rotation of an arm about its long axis is not the wearer's
            axes = np.diag([1.0, 1.0, -1.0])[2:] if "arm" in body else np.diag([1.0, 1.0, -1.0])
            for k, arm in enumerate(np.vstack([np.zeros(3), _ARM_M * axes])):
                names.append(f"{body}_{k}")
                bodies.append(b)
                places.append(anchor + arm)
                paths.append(p[b] + R[b] @ (places[-1] + [0.0, aside, 0.0]))
                weights.append((_FOOT_WEIGHT if is_foot else 1.0) / parameters.marker_sd_m)
    return PointSet(
        names=tuple(names),
        bodies=np.array(bodies),
        places=np.array(places),
        sd_m=np.zeros(len(names)),
        paths=np.stack(paths, axis=1),
        weights=np.tile(weights, (len(motion.hips), 1)),
    )


def _level_sole(R: Array, rests: list[FootRest], side: str) -> Array:
    """(3, 3) rotation of the foot's frame that lays its sole flat in the rests, on average; it keeps the direction."""
    off = []
    for rest in rests:
        if rest.side == side and rest.flat is not None:
            R_rest = R[slice(*rest.flat)]
            yaw = np.arctan2(R_rest[:, 1, 0], R_rest[:, 0, 0])
            R_flat = Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0]).as_matrix()
            off.append(Rotation.from_matrix(np.swapaxes(R_rest, 1, 2) @ R_flat).mean())
    return np.asarray(Rotation.concatenate(off).mean().as_matrix())


def _slide(motion: SegmentMotion, side: str) -> Array:
    """(N, 3) m, by which the shank slides in the knee, in the laboratory."""
    slide = motion.knee_slide.get(side, np.zeros((len(motion.hips), 3)))
    return np.einsum("nij,nj->ni", motion.R[f"thigh_{side}"], slide)


def _fit_lengths(
    starts: Mapping[str, Array], columns: Mapping[str, Array], rests: list[FootRest], prior: Array
) -> Array:
    """(5,) lengths, and place of the hips in the pelvis, with which the ankles move least in rests.

    Args:
        starts: (N, 3) m by side, the hips and what is not fitted.
        columns: (N, 3, 5) by side, displacement of the ankle by each value.
        rests: Stances of both feet.
        prior: (5,) values that are usual.
    """
    scatter = np.array(_SCATTER_M)
    A, b = [np.diag(1.0 / scatter)], [prior / scatter]
    for rest in rests:
        if rest.flat is not None:
            rows = slice(*rest.flat)
            count = rest.flat[1] - rest.flat[0]
            weight = np.sqrt(min(1.0, _INDEPENDENT / count)) / _STILL_SD_M
            moves, moved = columns[rest.side][rows], starts[rest.side][rows]
            A.append(weight * (moves - moves.mean(0)).reshape(-1, len(prior)))
            b.append(-weight * (moved - moved.mean(0)).ravel())
    return np.asarray(np.linalg.lstsq(np.vstack(A), np.concatenate(b), rcond=None)[0])
