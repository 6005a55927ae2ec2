"""Scores of estimated steps against the true footprints: errors, consistency of the standard deviations, classes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np

from stridetwin.estimators.contact_terrain import UNKNOWN, StepEstimate
from stridetwin.outputs.alignment import vertical_rotation
from stridetwin.outputs.base import BAD_SHARE, DESCRIPTIVE, SHARE, Score, Scores
from stridetwin.streams.samples import Array, Footprint

_EARLY_NS = 100_000_000  # an estimate may precede the true touch-down by this much, ns
_STANDING = 2  # number of initial footprints, one of each standing foot; they come first and are not steps

SCORES = (
    Score(name="slope_rmse_deg", heading="slope °"),
    Score(name="elevation_rmse_mm", heading="elevation mm"),
    Score(name="slope_in_95_pct", scale=SHARE, heading="slope in 95 %"),
    Score(name="elevation_in_95_pct", scale=SHARE, heading="elev. in 95 %"),
    Score(name="classification_accuracy_pct", scale=SHARE, heading="class %"),
    Score(name="unknown_pct", scale=BAD_SHARE, heading="unknown %"),
    Score(name="missed_pct", scale=BAD_SHARE, heading="missed %"),
    Score(name="false_pct", scale=BAD_SHARE),
    *(Score(name=f"{axis}_rmse_mm") for axis in "dhy"),
    Score(name="end_error_m", heading="end m"),
    Score(name="end_error_pct", heading="end %"),
    Score(name="steps", scale=DESCRIPTIVE),
)
"""The scores of estimated steps; see `step_scores`."""


class StepRow(TypedDict):
    """A `ScoredStep` as a mapping for JSON, which turns its tuples into lists."""

    mode: str
    slope: float
    elevation: float
    place: tuple[float, ...]
    estimated_mode: str
    estimated_slope: float
    estimated_elevation: float
    estimated_place: tuple[float, ...]
    slope_sd: float | None
    elevation_sd: float | None
    probability: float


@dataclass(frozen=True, kw_only=True)
class ScoredStep:
    """A true step and its estimate after its foot had been flat; a missed step has no estimate.

    Attributes:
        mode: True mode.
        slope: True slope of the ground in the foot's direction, rad.
        elevation: True height above the other foot's previous footprint, m.
        place: True position of the footprint, m.
        estimated_mode: Estimated mode; "" if the step was missed.
        estimated_slope: Estimate, rad.
        estimated_elevation: Estimate, m.
        estimated_place: Estimate, m, in the estimator's world.
        slope_sd: rad; None if the method reports none.
        elevation_sd: m; likewise.
        probability: Of the mode.
    """

    mode: str
    slope: float
    elevation: float
    place: tuple[float, ...]
    estimated_mode: str = ""
    estimated_slope: float = 0.0
    estimated_elevation: float = 0.0
    estimated_place: tuple[float, ...] = ()
    slope_sd: float | None = None
    elevation_sd: float | None = None
    probability: float = 0.0

    @property
    def is_matched(self) -> bool:
        """Whether an estimate belongs to the step."""
        return bool(self.estimated_place)

    @property
    def slope_error(self) -> float:
        """Estimated minus true slope, rad."""
        return self.estimated_slope - self.slope

    @property
    def elevation_error(self) -> float:
        """Estimated minus true elevation, m."""
        return self.estimated_elevation - self.elevation

    def row(self) -> StepRow:
        """The step as a mapping for JSON; `ScoredStep(**row)` restores it."""
        return {
            "mode": self.mode,
            "slope": self.slope,
            "elevation": self.elevation,
            "place": self.place,
            "estimated_mode": self.estimated_mode,
            "estimated_slope": self.estimated_slope,
            "estimated_elevation": self.estimated_elevation,
            "estimated_place": self.estimated_place,
            "slope_sd": self.slope_sd,
            "elevation_sd": self.elevation_sd,
            "probability": self.probability,
        }


def score_steps(footprints: Sequence[Footprint], estimates: Iterable[StepEstimate]) -> list[ScoredStep]:
    """Every true step of a walk with its estimate, except steps next to a footprint that the truth lacks.

    The two initial footprints come first and are not steps; there is one estimate per step. Both are in order.
    """
    estimate_list = list(estimates)
    steps = []
    for i in range(_STANDING, len(footprints)):
        print_ = footprints[i]  # `print` is a built-in
        # two footprints of one foot in a row: the truth lacks one of the other foot between them;
        # either foot may take the first step, whatever the order of the list: that is not a gap
        neighbours = (*footprints[max(i - 1, _STANDING) : i], *footprints[i + 1 : i + 2])
        before = next((p for p in footprints[i - 1 :: -1] if p.foot != print_.foot), None)  # of the other foot
        if before is None or any(p.foot == print_.foot for p in neighbours):
            continue
        first_estimate = next(iter(_estimates_of(footprints, i, estimate_list)), None)
        steps.append(_score_step(print_, before, first_estimate))
    return steps


def false_steps(footprints: Sequence[Footprint], estimates: Iterable[StepEstimate]) -> int:
    """Number of false steps: repeated estimates of a footprint, or estimates without any footprint.

    The feet alternate. Where the other foot has several footprints in a row, the truth lacks footprints of this foot
    between them. The estimates of these missing footprints are not false.

    Args:
        footprints: True footprints, in order; the two initial ones come first.
        estimates: One per estimated step, in order.
    """
    estimate_list = list(estimates)
    matched = set[int]()  # identities (`id`) of the estimates that belong to a true or missing footprint
    for i, print_ in enumerate(footprints):
        later = footprints[max(i + 1, _STANDING) :]
        # footprints of the other foot until this foot's next one: one is normal, each further one marks a missing print
        other_foot_count = next((n for n, p in enumerate(later) if p.foot == print_.foot), len(later))
        # one estimate for the footprint itself (none for an initial one), and one for each missing print after it
        max_estimates = (i >= _STANDING) + max(other_foot_count - 1, 0)
        unmatched = [id(e) for e in _estimates_of(footprints, i, estimate_list) if id(e) not in matched]
        matched.update(unmatched[:max_estimates])
    return len(estimate_list) - len(matched)


def _estimates_of(footprints: Sequence[Footprint], i: int, estimates: Iterable[StepEstimate]) -> list[StepEstimate]:
    """The estimates that may belong to the i-th footprint.

    They are of its foot, from `_EARLY_NS` before its touch-down until the foot's next one.

    Args:
        footprints: True footprints of both feet, in order.
        i: Number of the footprint.
        estimates: All estimates of the walk, in order.
    """
    foot = footprints[i].foot
    since = footprints[i].t_ns - _EARLY_NS
    until = next((p.t_ns for p in footprints[i + 1 :] if p.foot == foot), np.inf)
    return [e for e in estimates if e.foot == foot and since < e.t_ns < until]


def _score_step(print_: Footprint, before: Footprint, estimate: StepEstimate | None) -> ScoredStep:
    """A true step with its estimate.

    Args:
        print_: Footprint of the step.
        before: Previous footprint of the other foot.
        estimate: The step's estimate; None for a missed step.
    """
    w, x, y, z = print_.q_world_foot
    # the true values, which alone remain if the step was missed
    missed_step = ScoredStep(
        mode=print_.mode,
        slope=float(np.arcsin(2.0 * (x * z - w * y))),  # of the foot's x axis above the horizontal
        elevation=float(print_.p_foot_in_world[2] - before.p_foot_in_world[2]),
        place=tuple(print_.p_foot_in_world.tolist()),
    )
    if estimate is None:
        return missed_step
    return replace(
        missed_step,
        estimated_mode=estimate.mode,
        estimated_slope=float(estimate.slope),
        estimated_elevation=float(estimate.elevation),
        estimated_place=tuple(np.asarray(estimate.p_sole_in_world).tolist()),
        slope_sd=_finite_or_none(estimate.slope_sd),
        elevation_sd=_finite_or_none(estimate.elevation_sd),
        probability=float(estimate.probability),
    )


def _finite_or_none(sd: float) -> float | None:
    """The number, or None if it is not finite."""
    return float(sd) if math.isfinite(sd) else None


def displacement_errors(steps: Sequence[ScoredStep], mode: str) -> list[tuple[float, float, float]]:
    """Error of the displacement divided by the number of steps, for each run of steps of one mode, m.

    The displacement of a run goes from the footprint before it to its last one (the paper's walks begin with a standing
    subject). Where these have no estimate, the first and the last estimated footprint in between take their place.
    A run with fewer than two estimated footprints is left out.

    Args:
        steps: Steps of a walk.
        mode: Mode of the runs; "" takes the whole walk.

    Returns:
        For each run the errors along the world's x axis (forward), z axis (up) and y axis (left), m per step.
    """
    errors, start = [], 0
    for end in range(1, len(steps) + 1):  # steps[start:end] is the present run
        is_inside = not mode or steps[end - 1].mode == mode
        if is_inside and end < len(steps) and (not mode or steps[end].mode == mode):  # the run goes on
            continue
        if is_inside:
            # with the footprint before the run; only steps with an estimate have an estimated place
            run = [(i, s) for i, s in enumerate(steps[max(start - 1, 0) : end]) if s.is_matched]
            if len(run) > 1:
                (i, first), (j, last) = run[0], run[-1]
                estimated_move = np.subtract(last.estimated_place, first.estimated_place)
                true_move = np.subtract(last.place, first.place)
                forward, left, up = ((estimated_move - true_move) / (j - i)).tolist()  # per step
                errors.append((forward, up, left))
        start = end
    return errors


def align_yaw(steps: Sequence[ScoredStep]) -> list[ScoredStep]:
    """The steps of a walk with estimated positions rotated about the vertical, so that they fit the true ones best.

    Without a magnetometer the initial heading is unobservable (a gauge freedom: Zhang & Scaramuzza 2018). With fewer
    than two estimated steps, all steps come back unchanged.
    """
    matched = [s for s in steps if s.is_matched]
    if len(matched) < 2:  # no direction to fit
        return list(steps)
    true = np.array([s.place for s in matched])  # (N, 3) m
    estimated = np.array([s.estimated_place for s in matched])
    R = vertical_rotation((true - true.mean(axis=0)).T @ (estimated - estimated.mean(axis=0)))
    # about the origin of the estimator's world; only displacements count, so no translation is needed
    return [replace(s, estimated_place=tuple((R @ s.estimated_place).tolist())) if s.is_matched else s for s in steps]


def step_scores(steps: Sequence[ScoredStep]) -> Scores:
    """Every score of one walk with at least one estimated step.

    Returns:
        `slope_rmse_deg`, `elevation_rmse_mm`, `slope_in_95_pct`, `elevation_in_95_pct`; of all steps including
        missed ones `classification_accuracy_pct`, `unknown_pct`, `missed_pct`; `{d,h,y}_rmse_mm`, error of the whole
        displacement divided by the number of steps, along the world's x, z and y; `end_error_m`, `end_error_pct`, from
        the first estimated footprint to the last, unless the last two true steps are missed; `steps`.
    """
    figures = step_figures(steps, displacement_errors(steps, ""))
    matched = [s for s in steps if s.is_matched]
    # (N, 3) true and estimated positions, m
    places, estimated = np.array([s.place for s in matched]), np.array([s.estimated_place for s in matched])
    end = float(np.linalg.norm((estimated[-1] - estimated[0]) - (places[-1] - places[0])))
    is_whole = any(s.is_matched for s in steps[-2:])
    way = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    left_out = ("slope_mean_deg", "elevation_mean_mm", "steps_missed")  # figures that are no scores in `SCORES`
    return {
        **{k: float(v) for k, v in figures.items() if k not in left_out},
        "unknown_pct": percent(s.estimated_mode == UNKNOWN for s in steps),
        "missed_pct": percent(not s.is_matched for s in steps),
        **({"end_error_m": end} if is_whole else {}),
        **({"end_error_pct": 100.0 * end / way} if is_whole and way > 0.0 else {}),
    }


def step_figures(steps: Sequence[ScoredStep], places: Sequence[tuple[float, float, float]]) -> dict[str, float]:
    """RMS and mean errors of the steps with estimates, and the classes of all steps.

    Args:
        steps: Steps of one or several walks.
        places: Not places, but the errors that `displacement_errors` returns, m; empty to leave them out.

    Returns:
        `slope_rmse_deg`, `slope_mean_deg`, `elevation_rmse_mm`, `elevation_mean_mm`, `classification_accuracy_pct`,
        `steps`, `steps_missed`; with standard deviations `slope_in_95_pct` and `elevation_in_95_pct`; with places
        `d_rmse_mm`, `h_rmse_mm` and `y_rmse_mm`, along the walk, up and sideways.
    """
    matched = [s for s in steps if s.is_matched]
    slope = np.degrees([s.slope_error for s in matched])
    elevation = 1e3 * np.array([s.elevation_error for s in matched])
    figures = {
        "slope_rmse_deg": _rms(slope),
        "slope_mean_deg": float(slope.mean()) if len(slope) else 0.0,
        "elevation_rmse_mm": _rms(elevation),
        "elevation_mean_mm": float(elevation.mean()) if len(elevation) else 0.0,
        **_inside_95(matched),
        "classification_accuracy_pct": percent(s.estimated_mode == s.mode for s in steps),
        "steps": len(steps),
        "steps_missed": len(steps) - len(matched),
    }
    if len(places):
        # RMS error along each of the three axes, mm
        d, h, y = (_rms(1e3 * np.array(errors_m)) for errors_m in zip(*places))
        figures |= {"d_rmse_mm": d, "h_rmse_mm": h, "y_rmse_mm": y}
    return figures


def _inside_95(matched: Sequence[ScoredStep]) -> dict[str, float]:
    """Shares of slope and elevation errors inside the 95 % interval (1.96 standard deviations), %.

    Args:
        matched: Steps with an estimate.

    Returns:
        The two scores by their names; empty if the method reports no standard deviations.
    """
    slope = [abs(s.slope_error) < 1.96 * s.slope_sd for s in matched if s.slope_sd is not None]
    elevation = [abs(s.elevation_error) < 1.96 * s.elevation_sd for s in matched if s.elevation_sd is not None]
    if not slope or not elevation:
        return {}
    return {"slope_in_95_pct": percent(slope), "elevation_in_95_pct": percent(elevation)}


def _rms(values: Sequence[float] | Array) -> float:
    """Root mean square; 0 without values."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0


def percent(values: Iterable[object]) -> float:
    """Share of true values, %; 0 for an empty input."""
    answers = list(values)
    return 100.0 * sum(map(bool, answers)) / len(answers) if answers else 0.0
