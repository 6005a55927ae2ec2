"""Scores of predicted steps and terrain changes: accuracy, lead time, errors, consistency of the standard deviations.

The true mode of a step is that of the ground from the previous footprint to its own (`Footprint.mode`). A prediction
is scored at the last update before touch-down; its lead time is how long before that it became right and stayed so.
A footprint across a ramp's edge, on a slope just below that of a ramp, or beyond a riser of about the least height of a
stair may count as either of two modes, except in the strict accuracy; the calibration leaves it out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, TypedDict

import numpy as np

from stridetwin.estimators.locomotion_mode import MODES, UNKNOWN, ModeEstimate
from stridetwin.outputs.alignment import MovingAlignment
from stridetwin.outputs.base import DESCRIPTIVE, LEAD, SHARE, Score, Scores
from stridetwin.outputs.coverage import COVERAGE
from stridetwin.outputs.modes.approaches import score_approaches
from stridetwin.outputs.modes.true_steps import alternative_modes, first_predictions, predictions_by_step, slope_under
from stridetwin.outputs.terrain.changes import ScoredChange
from stridetwin.outputs.truth import project_on_way
from stridetwin.streams.samples import Footprint
from stridetwin.streams.terrain_truth import Layout

_CHANGES = {
    "LG": ("level", "level ground"),
    "SA": ("stairs_up", "stairs up"),
    "SD": ("stairs_down", "stairs down"),
    "RA": ("ramp_up", "ramps up"),
    "RD": ("ramp_down", "ramps down"),
}
"""Mode that a change leads to: its part of a score's name, and of the score's label."""

SCORES = (
    Score(
        name="accuracy_pct",
        scale=SHARE,
        heading="right %",
        label="Steps whose mode was predicted correctly",
        unit="%",
        digits=1,
    ),
    Score(
        name="strict_accuracy_pct",
        scale=SHARE,
        heading="strict %",
        unit="%",
        digits=1,
        label="the same, with one correct mode for soles across a ramp's edge",
    ),
    Score(name="straddling_pct", scale=DESCRIPTIVE),
    Score(
        name="transition_accuracy_pct",
        scale=SHARE,
        heading="transitions %",
        unit="%",
        digits=1,
        label="Steps that change the mode, predicted correctly",
    ),
    Score(name="steps", scale=DESCRIPTIVE, label="Steps", digits=0),
    Score(name="transitions", scale=DESCRIPTIVE, label="steps that change the mode", digits=0),
    Score(
        name="lead_median_s",
        scale=LEAD,
        heading="lead s",
        unit="s",
        label="Lead time of the final correct prediction, median",
    ),
    Score(name="lead_p5_s", scale=LEAD, heading="lead 5 % s", label="the same, 5th percentile", unit="s"),
    Score(name="transition_lead_median_s", scale=LEAD),
    *(
        Score(
            name=f"lead_to_{name}_median_s",
            scale=LEAD,
            unit="s",
            label=f"Lead time of changes to {change_text}, median",
        )
        for name, change_text in _CHANGES.values()
    ),
    Score(name="footprint_forward_rmse_m", label="Footprint one step ahead, forward, RMS error", unit="m", digits=3),
    Score(name="footprint_left_rmse_m", label="the same, sideways", unit="m", digits=3),
    Score(name="calibration_error", label="Predicted probabilities, calibration error", digits=3),
    Score(
        name="changes_found_pct",
        scale=SHARE,
        heading="changes found %",
        unit="%",
        digits=1,
        label="Terrain changes detected 1.5 s ahead",
    ),
    Score(name="riser_rmse_mm", heading="riser mm", label="their risers, RMS error", unit="mm", digits=1),
    Score(name="tread_rmse_mm", heading="tread mm", label="their treads, RMS error", unit="mm", digits=1),
    Score(name="slope_rmse_deg", heading="slope °", label="their slopes, RMS error", unit="°"),
    COVERAGE,
)
"""The scores of predicted modes; see `scores_of_walk`."""


@dataclass(frozen=True, kw_only=True)
class ScoredMode:
    """A true step and its prediction.

    Attributes:
        t_s: Touch-down, s.
        mode: True mode.
        before: True mode of the previous step.
        predicted: The last mode predicted before touch-down, or `UNKNOWN`; "" if there was no prediction.
        allowed: Modes that count as right.
        lead_s: How long before touch-down the predicted mode had become right for good, 0 if it was wrong.
        probabilities: Of `MODES`, at the last prediction.
        forward_m: Predicted minus true footprint in the direction of the true foot, when the previous foot had just
            landed; NaN if there was no prediction.
        left_m: Likewise to the left of the true foot.
        length_m: Horizontal distance of the true footprint from the previous one, which is the other foot's.
        slope_rad: Estimated minus true slope of the ground under the foot, at the last prediction; NaN on treads and
            across edges.
        slope_sd_rad: Its reported standard deviation.
    """

    t_s: float
    mode: str
    before: str
    predicted: str
    allowed: tuple[str, ...]
    lead_s: float
    probabilities: tuple[float, ...] = ()
    forward_m: float = math.nan
    left_m: float = math.nan
    length_m: float = math.nan
    slope_rad: float = math.nan
    slope_sd_rad: float = math.nan

    @property
    def is_correct(self) -> bool:
        """Whether the predicted mode is one of the allowed ones."""
        return self.predicted in self.allowed

    @property
    def is_strictly_correct(self) -> bool:
        """Whether the predicted mode is the true one, even where another one may count."""
        return self.predicted == self.mode

    @property
    def is_transition(self) -> bool:
        """Whether the mode differs from that of the previous step."""
        return self.mode != self.before

    @property
    def is_straddling(self) -> bool:
        """Whether the step may count as either of two modes."""
        return len(self.allowed) > 1


class ModeRows(TypedDict):
    """The scores of one walk for JSON: the fields of each `ScoredMode` and each `ScoredChange`; NaN is null."""

    steps: list[dict[str, object]]
    approaches: list[dict[str, object]]


@dataclass(frozen=True, kw_only=True, eq=False)
class ModeScores:
    """Scores of one walk: its steps and the terrain changes that were approached, in order."""

    steps: list[ScoredMode] = field(default_factory=list)
    approaches: list[ScoredChange] = field(default_factory=list)

    @classmethod
    def of(cls, rows: ModeRows) -> ModeScores:
        """Restores the scores from the result of `rows`, which JSON may have stored."""
        steps = [_from_json(row) for row in rows["steps"]]
        for row in steps:  # JSON has turned the tuples of a step into lists
            row.update({name: tuple(row[name]) for name in ("allowed", "probabilities")})
        return cls(
            steps=[ScoredMode(**row) for row in steps],
            approaches=[ScoredChange(**_from_json(row)) for row in rows["approaches"]],
        )

    def rows(self) -> ModeRows:
        """The scores as rows of `steps` and `approaches` for JSON; NaN becomes null."""
        return {"steps": [_to_json(s) for s in self.steps], "approaches": [_to_json(a) for a in self.approaches]}


def _to_json(scored: ScoredMode | ScoredChange) -> dict[str, object]:
    """A scored step or change as plain values; NaN becomes None."""
    return {k: (None if isinstance(v, float) and math.isnan(v) else v) for k, v in asdict(scored).items()}


def _from_json(row: Mapping[str, object]) -> dict[str, Any]:
    """The values of a row; None becomes NaN."""
    return {k: math.nan if v is None else v for k, v in row.items()}


def score_modes(
    footprints: Sequence[Footprint],
    estimates: Sequence[ModeEstimate],
    alignment: MovingAlignment,
    layout: Layout | None,
    sole_m: float,
) -> ModeScores:
    """Every true step and terrain change of a walk, with its prediction.

    Args:
        footprints: True footprints, in order; the two initial ones come first.
        estimates: In time order.
        alignment: Alignment of the estimator's world with the true one.
        layout: The true terrain; None if it is not known: then every step has one allowed mode, and no terrain change
            is scored.
        sole_m: Length of the soles.
    """
    landed = footprints[2:]  # without the two initial footprints
    by_step = predictions_by_step(landed, estimates)
    first = first_predictions(landed, by_step)
    alternatives: list[tuple[str, ...]] = [() for _ in landed]
    slopes = [math.nan for _ in landed]  # true slope under each step, rad
    approaches: list[ScoredChange] = []
    if layout is not None:
        all_places = project_on_way([f.p_foot_in_world for f in footprints], layout)
        places, behind = all_places[2:], all_places[1:-1]  # of each footprint, and of the one before it
        alternatives = [alternative_modes(f.mode, (s0, s), layout, sole_m) for f, s0, s in zip(landed, behind, places)]
        slopes = [slope_under(s, layout, sole_m) for s in places]
        approaches = score_approaches(landed, places, estimates, alignment, layout)
    steps = []
    before = "LG"
    for i, print_ in enumerate(landed):  # `print` is a built-in
        allowed = (print_.mode, *alternatives[i])
        # an estimate e predicts this step as e.steps[k]; the lead time counts from the first estimate after the last
        # wrong one
        predictions = by_step[i]
        wrong_ns = [e.t_ns for e, k in predictions if e.steps[k].mode not in allowed]
        right_since = [e.t_ns for e, k in predictions if not wrong_ns or e.t_ns > wrong_ns[-1]]
        forward, left = _footprint_error(print_, first[i], alignment)
        step = None  # the last prediction of this step
        if predictions:
            last_estimate, k = predictions[-1]
            step = last_estimate.steps[k]
        steps.append(
            ScoredMode(
                t_s=print_.t_ns * 1e-9,
                mode=print_.mode,
                before=before,
                allowed=allowed,
                predicted=step.mode if step else "",
                lead_s=(print_.t_ns - right_since[0]) * 1e-9 if right_since else 0.0,
                probabilities=tuple(step.probabilities[m] for m in MODES) if step else (),
                forward_m=forward,
                left_m=left,
                length_m=float(np.linalg.norm((print_.p_foot_in_world - footprints[i + 1].p_foot_in_world)[:2])),
                slope_rad=step.slope - slopes[i] if step else math.nan,
                slope_sd_rad=step.slope_sd if step else math.nan,
            )
        )
        before = print_.mode
    return ModeScores(steps=steps, approaches=approaches)


def _footprint_error(
    print_: Footprint, prediction: tuple[ModeEstimate, int] | None, alignment: MovingAlignment
) -> tuple[float, float]:
    """Predicted minus true footprint, forward and to the left of the true foot, m; NaN without a prediction.

    Args:
        print_: The true footprint.
        prediction: The first estimate that predicts it as the next one, and the step's index in it.
        alignment: From the odometry's world to the true one.
    """
    if prediction is None:
        return math.nan, math.nan
    estimate, k = prediction
    p = alignment.point(estimate.t_ns, estimate.steps[k].p_foot_in_world[:2])
    w, x, y, z = print_.q_world_foot
    # horizontal part of the foot's x axis: first column of the quaternion's rotation matrix
    forward = np.array([1.0 - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y)])
    forward /= np.linalg.norm(forward)
    left = [-forward[1], forward[0]]
    error = p - print_.p_foot_in_world[:2]
    return float(error @ forward), float(error @ left)


_BINS = 10  # of probabilities, for the calibration
_STEADY = 0.2
"""Steps in steady walking differ by no more, as a share of the shortest."""
_SIZES = (
    ("distance_m", "distance_sd_m"),
    ("riser_m", "riser_sd_m"),
    ("tread_m", "tread_sd_m"),
    ("slope_rad", "slope_sd_rad"),
)
"""Attributes of a `ScoredChange`: the error of each size, and its reported standard deviation."""
_MAX_OBSERVED_SD = {"riser_m": 0.02, "tread_m": 0.04, "slope_rad": math.radians(1.5)}
"""A size with a larger standard deviation is only a prior guess: nothing is visible behind a drop-off."""


class LeadTimes(TypedDict):
    """Median and 5th percentile of lead times, s; None without steps."""

    median: float | None
    p5: float | None


class FootprintErrors(TypedDict):
    """RMS errors of predicted footprints in the direction of the true feet and to their left, m; None without any."""

    forward: float | None
    left: float | None


class SizeFigures(TypedDict):
    """Share of the changes where a size was observed, not guessed, and RMS errors of those and of all."""

    seen_pct: float | None
    rmse: float | None
    all_rmse: float | None


class ChangeFigures(TypedDict):
    """Figures of predicted terrain changes over walks, see `mode_figures`."""

    changes: int
    changes_found_pct: float | None
    begins_found_pct: float | None
    distance_median_mm: dict[str, float | None]
    riser_rmse_mm: float | None
    tread_rmse_mm: float | None
    slope_rmse_deg: float | None
    sizes: dict[str, dict[str, SizeFigures]]
    inside_95_pct: float | None
    distance_inside_95_pct: float | None


class ModeFigures(ChangeFigures):
    """Figures of predicted modes over walks, see `mode_figures`."""

    accuracy_pct: float | None
    strict_accuracy_pct: float | None
    straddling_pct: float | None
    transition_accuracy_pct: float | None
    accuracy_by_mode_pct: dict[str, float | None]
    confusion: dict[str, dict[str, int]]
    lead_time_s: LeadTimes
    transition_lead_time_s: LeadTimes
    footprint_rmse_m: FootprintErrors
    footprint_steady_rmse_m: FootprintErrors
    calibration_error: float | None
    steps: int
    transitions: int


def mode_figures(walks: Iterable[ModeScores]) -> ModeFigures:
    """Figures over walks, ready for JSON; None for undefined ones.

    Returns:
        `accuracy_pct`, `strict_accuracy_pct`, `straddling_pct`, `transition_accuracy_pct`,
        `accuracy_by_mode_pct: {MODE}`, `confusion: {true: {predicted: steps}}`, `lead_time_s: {median, p5}`,
        `transition_lead_time_s` likewise, `footprint_rmse_m: {forward, left}` one step ahead,
        `footprint_steady_rmse_m` likewise of steps in steady walking (`_steady_steps`), `calibration_error`, `steps`,
        `transitions`; of the ground `changes` (their number), `changes_found_pct`, `begins_found_pct` (stairs and
        ramps, not their ends), `distance_median_mm: {stairs, ramps, ends}`, `riser_rmse_mm`, `tread_rmse_mm`,
        `slope_rmse_deg` of sizes that were observed, not guessed (`_MAX_OBSERVED_SD`); `sizes: {riser_mm, tread_mm,
        slope_deg}`, of each `{up, down}`, `seen_pct` of all stairs or ramps, `rmse` of those, and `all_rmse` of all
        estimates including guesses; `inside_95_pct` of all those sizes, `distance_inside_95_pct`.
    """
    walks = list(walks)
    steps = [s for w in walks for s in w.steps]
    approaches = [a for w in walks for a in w.approaches]
    transitions = [s for s in steps if s.is_transition]
    # by true and by predicted mode, "" where there was no prediction or the mode was said to be unknown
    confusion = {true: dict.fromkeys((*MODES, ""), 0) for true in MODES}
    for s in steps:
        confusion[s.mode][s.predicted if s.predicted in MODES else ""] += 1
    return {
        "accuracy_pct": _percent(s.is_correct for s in steps),
        "strict_accuracy_pct": _percent(s.is_strictly_correct for s in steps),
        "straddling_pct": _percent(s.is_straddling for s in steps),
        "transition_accuracy_pct": _percent(s.is_correct for s in transitions),
        "accuracy_by_mode_pct": {m: _percent(s.is_correct for s in steps if s.mode == m) for m in MODES},
        "confusion": confusion,
        "lead_time_s": _lead_times(steps),
        "transition_lead_time_s": _lead_times(transitions),
        "footprint_rmse_m": _footprint_rmse(steps),
        "footprint_steady_rmse_m": _footprint_rmse([s for w in walks for s in _steady_steps(w.steps)]),
        "calibration_error": _calibration_error(steps),
        "steps": len(steps),
        "transitions": len(transitions),
        **_change_figures(approaches),
    }


def _lead_times(steps: Sequence[ScoredMode]) -> LeadTimes:
    """Median and 5th percentile of the lead times, s."""
    lead_s = [step.lead_s for step in steps]
    return {"median": _quantile(lead_s, 50), "p5": _quantile(lead_s, 5)}


def _footprint_rmse(steps: Sequence[ScoredMode]) -> FootprintErrors:
    """RMS errors of the footprints in the direction of the true feet and to their left, m; None without any."""
    return {"forward": rms([s.forward_m for s in steps]), "left": rms([s.left_m for s in steps])}


def _steady_steps(steps: Sequence[ScoredMode]) -> list[ScoredMode]:
    """Steps of the same mode as the steps before and after them, and about as long as these.

    This excludes pauses and changes of speed. The first three and the last two steps of the walk are left out.
    """
    steady = []
    for i in range(3, len(steps) - 2):
        around = steps[i - 1 : i + 2]
        lengths = [s.length_m for s in around]
        has_one_mode = len({s.mode for s in around}) == 1
        if has_one_mode and not max(lengths) > (1.0 + _STEADY) * min(lengths):
            steady.append(steps[i])
    return steady


def _change_figures(approaches: Sequence[ScoredChange]) -> ChangeFigures:
    """Figures of the predicted terrain changes of some walks: how many were found, and the errors of their sizes.

    Each figure is defined in `mode_figures`, which returns them among its own.
    """
    # the modes that the changes of each kind lead to
    kinds = {"stairs": ("SA", "SD"), "ramps": ("RA", "RD"), "ends": ("LG",)}
    median = {  # of the distance errors of the detected changes, mm
        kind: _quantile([1e3 * abs(a.distance_m) for a in approaches if a.mode in modes and a.is_detected], 50)
        for kind, modes in kinds.items()
    }
    # per attribute, (error, standard deviation) of each change; NaN where the change lacks the size
    sizes = {name: [(getattr(a, name), getattr(a, sd)) for a in approaches] for name, sd in _SIZES}
    # per attribute, the errors of the sizes that were observed, not guessed
    observed = {name: [e for e, sd in sizes[name] if sd < max_sd] for name, max_sd in _MAX_OBSERVED_SD.items()}
    begins = [a for a in approaches if a.mode != "LG"]
    # for each size and each way, up or down, the figures of the changes to the one mode that has this size and way
    figures_by_size: dict[str, dict[str, SizeFigures]] = {}
    for size, name, factor, size_modes in (
        ("riser_mm", "riser_m", 1e3, ("SA", "SD")),
        ("tread_mm", "tread_m", 1e3, ("SA", "SD")),
        ("slope_deg", "slope_rad", 180.0 / math.pi, ("RA", "RD")),
    ):
        figures_by_size[size] = {}
        for way, mode in zip(("up", "down"), size_modes):
            of_mode = [a for a in approaches if a.mode == mode]
            figures_by_size[size][way] = _size_figures(name, factor, of_mode)
    return {
        "changes": len(approaches),
        "changes_found_pct": _percent(a.is_detected for a in approaches),
        "begins_found_pct": _percent(a.is_detected for a in begins),
        "distance_median_mm": median,
        "riser_rmse_mm": rms(observed["riser_m"], 1e3),
        "tread_rmse_mm": rms(observed["tread_m"], 1e3),
        "slope_rmse_deg": rms(observed["slope_rad"], 180.0 / math.pi),
        "sizes": figures_by_size,
        "inside_95_pct": inside_pct([p for name in ("riser_m", "tread_m", "slope_rad") for p in sizes[name]]),
        "distance_inside_95_pct": inside_pct(sizes["distance_m"]),
    }


def _size_figures(name: str, factor: float, approaches: Sequence[ScoredChange]) -> SizeFigures:
    """Figures of one size over some changes.

    Args:
        name: Attribute of the size's error, such as `riser_m`.
        factor: From the unit of the attribute to that of the figures, such as 1000 from m to mm.
        approaches: Scored changes that have the size.

    Returns:
        `seen_pct`, share of the changes where the size was observed, not guessed; `rmse` of those; `all_rmse` of all.
    """
    sd = name.replace("_", "_sd_")  # `riser_m` has the standard deviation `riser_sd_m`
    pairs = [(getattr(a, name), getattr(a, sd)) for a in approaches]  # error and standard deviation of each change
    return {
        "seen_pct": _percent(math.isfinite(e) and d < _MAX_OBSERVED_SD[name] for e, d in pairs),
        "rmse": rms([e for e, d in pairs if d < _MAX_OBSERVED_SD[name]], factor),
        "all_rmse": rms([e for e, _ in pairs], factor),
    }


def inside_pct(errors: Iterable[tuple[float, float]]) -> float | None:
    """Share of errors within the reported 95 % interval (1.96 standard deviations), %; None without any.

    Args:
        errors: Pairs of error and standard deviation; pairs with NaN are left out.
    """
    return _percent(abs(e) < 1.96 * sd for e, sd in errors if math.isfinite(e) and math.isfinite(sd))


def _calibration_error(steps: Sequence[ScoredMode]) -> float | None:
    """Expected calibration error of the predicted modes' probabilities, 0-1; None without steps.

    It is Σ n |p - share of right steps| / Σ n over the bins of `reliability`.
    """
    bins = reliability(steps)
    if not bins:
        return None
    return sum(abs(p - right) * count for p, right, count in bins) / sum(count for _, _, count in bins)


def reliability(steps: Sequence[ScoredMode]) -> list[tuple[float, float, int]]:
    """Calibration of the probability of the predicted mode, by tenths.

    Steps that may count as either of two modes are left out: no one outcome belongs to their probability.

    Returns:
        For each tenth with steps: mean probability, share of steps that were right, and their number.
    """
    predicted = [s for s in steps if s.probabilities and s.predicted != UNKNOWN and not s.is_straddling]
    p = np.array([max(s.probabilities) for s in predicted])  # the largest one is that of the predicted mode
    right = np.array([s.is_correct for s in predicted], float)
    bins = np.minimum((p * _BINS).astype(int), _BINS - 1)  # a probability of 1 belongs to the last bin
    rows = []
    for b in np.unique(bins):
        in_bin = bins == b
        rows.append((float(p[in_bin].mean()), float(right[in_bin].mean()), int(in_bin.sum())))
    return rows


def _percent(values: Iterable[bool]) -> float | None:
    """Share of true values, %; None without values."""
    answers = list(values)
    return 100.0 * sum(map(bool, answers)) / len(answers) if answers else None


def _quantile(values: Sequence[float], percent: float) -> float | None:
    """Percentile of the values, linear between neighbours; None without any."""
    return float(np.percentile(values, percent)) if len(values) else None


def rms(values: Sequence[float], factor: float = 1.0) -> float | None:
    """Root mean square of the finite values times a factor to another unit; None without any."""
    finite = [v for v in values if math.isfinite(v)]
    return float(np.sqrt(np.mean(np.square(finite)))) * factor if finite else None


def scores_of_walk(modes: ModeScores) -> Scores:
    """The scores of one walk's steps; undefined scores are left out.

    Returns:
        `accuracy_pct`, `strict_accuracy_pct`, `straddling_pct`, `transition_accuracy_pct`, `changes_found_pct`;
        `lead_median_s`, `lead_p5_s`, `transition_lead_median_s`, and the median lead time of the steps that change
        the mode to each other one, `lead_to_{level,stairs_up,...}_median_s`; `footprint_forward_rmse_m`,
        `footprint_left_rmse_m`; `riser_rmse_mm`, `tread_rmse_mm`, `slope_rmse_deg`; `calibration_error`; `steps`,
        `transitions`.
    """
    figures = mode_figures([modes])
    flat = {
        "accuracy_pct": figures["accuracy_pct"],
        "strict_accuracy_pct": figures["strict_accuracy_pct"],
        "straddling_pct": figures["straddling_pct"],
        "transition_accuracy_pct": figures["transition_accuracy_pct"],
        "changes_found_pct": figures["changes_found_pct"],
        "riser_rmse_mm": figures["riser_rmse_mm"],
        "tread_rmse_mm": figures["tread_rmse_mm"],
        "slope_rmse_deg": figures["slope_rmse_deg"],
        "calibration_error": figures["calibration_error"],
        "steps": figures["steps"],
        "transitions": figures["transitions"],
        "lead_median_s": figures["lead_time_s"]["median"],
        "lead_p5_s": figures["lead_time_s"]["p5"],
        "transition_lead_median_s": figures["transition_lead_time_s"]["median"],
        "footprint_forward_rmse_m": figures["footprint_rmse_m"]["forward"],
        "footprint_left_rmse_m": figures["footprint_rmse_m"]["left"],
        **{f"lead_to_{name}_median_s": _median_lead_to(mode, modes.steps) for mode, (name, _) in _CHANGES.items()},
    }
    return {name: float(value) for name, value in flat.items() if value is not None}


def _median_lead_to(mode: str, steps: Sequence[ScoredMode]) -> float | None:
    """Median lead time, s, of the steps that change the mode to this one; None without any."""
    return _quantile([step.lead_s for step in steps if step.is_transition and step.mode == mode], 50)
