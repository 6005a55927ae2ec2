"""What scored steps and changes of walks come to: accuracy, lead, errors, and whether deviations are honest."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.scenarios.change_score import ScoredApproach
from stridetwin.scenarios.mode_score import ModeScores, ScoredMode

_BINS = 10
_STEADY = 0.2
"""Steps in steady walking differ by no more, as a share of the shortest."""
_SIZES = (
    ("distance_m", "distance_sd_m"), ("riser_m", "riser_sd_m"), ("tread_m", "tread_sd_m"), ("slope_rad", "slope_sd_rad")
)  # fmt: skip
_SEEN = {"riser_m": 0.02, "tread_m": 0.04, "slope_rad": math.radians(1.5)}
"""A size that is told with a larger deviation is a guess at what is usual: behind a brink nothing is seen."""


def mode_figures(walks: Iterable[ModeScores]) -> dict[str, Any]:
    """Figures over walks, ready for JSON; None where there is nothing to tell of.

    Returns:
        `accuracy_pct`, `strict_accuracy_pct`, `straddling_pct`, `transition_accuracy_pct`,
        `accuracy_by_mode_pct: {MODE}`, `confusion: {true: {told: steps}}`, `lead_time_s: {median, p5}`,
        `transition_lead_time_s` likewise, `footprint_rmse_m: {forward, left}` one step ahead,
        `footprint_steady_rmse_m` likewise of steps in steady walking (`_steady`), `calibration_error`, `steps`,
        `transitions`; of the ground `changes` (their number), `changes_found_pct`, `begins_found_pct` (stairs and
        ramps, not their ends), `distance_median_mm: {stairs, ramps, ends}`, `riser_rmse_mm`, `tread_rmse_mm`,
        `slope_rmse_deg` of sizes that were seen and not only guessed (`_SEEN`); `sizes: {riser_mm, tread_mm,
        slope_deg}`, of each `{up, down}`, `seen_pct` of all stairs or ramps, `rmse` of those, and `told_rmse` of all
        that were told, guesses too; `inside_95_pct` of all those sizes, `distance_inside_95_pct`.
    """
    walks = list(walks)
    steps = [s for w in walks for s in w.steps]
    approaches = [a for w in walks for a in w.approaches]
    transitions = [s for s in steps if s.transition]
    lead = [s.lead_s for s in steps]
    steady = [s for w in walks for s in _steady(w.steps)]
    confusion = {m: {t: sum(s.mode == m and s.told == t for s in steps) for t in (*MODES, "")} for m in MODES}
    return {
        "accuracy_pct": _percent(s.right for s in steps),
        "strict_accuracy_pct": _percent(s.strictly_right for s in steps),
        "straddling_pct": _percent(s.straddles for s in steps),
        "transition_accuracy_pct": _percent(s.right for s in transitions),
        "accuracy_by_mode_pct": {m: _percent(s.right for s in steps if s.mode == m) for m in MODES},
        "confusion": confusion,
        "lead_time_s": {"median": _quantile(lead, 50), "p5": _quantile(lead, 5)},
        "transition_lead_time_s": {
            "median": _quantile([s.lead_s for s in transitions], 50),
            "p5": _quantile([s.lead_s for s in transitions], 5),
        },
        "footprint_rmse_m": {"forward": _rms([s.forward_m for s in steps]), "left": _rms([s.left_m for s in steps])},
        "footprint_steady_rmse_m": {
            "forward": _rms([s.forward_m for s in steady]), "left": _rms([s.left_m for s in steady])
        },
        "calibration_error": _calibration(steps),
        "steps": len(steps),
        "transitions": len(transitions),
        **_change_figures(approaches),
    }  # fmt: skip


def _steady(steps: Sequence[ScoredMode]) -> list[ScoredMode]:
    """Steps of the same mode as those beside them and nearly as long, without the first three and the last two.

    Who pauses, or gathers speed, does not walk steadily.
    """
    found = []
    for i in range(3, len(steps) - 2):
        around = steps[i - 1 : i + 2]
        lengths = [s.length_m for s in around]
        if len({s.mode for s in around}) == 1 and not max(lengths) > (1.0 + _STEADY) * min(lengths):
            found.append(steps[i])
    return found


def _change_figures(approaches: Sequence[ScoredApproach]) -> dict[str, Any]:
    kinds = {"stairs": ("SA", "SD"), "ramps": ("RA", "RD"), "ends": ("LG",)}
    median = {
        kind: _quantile([1e3 * abs(a.distance_m) for a in approaches if a.mode in modes and a.found], 50)
        for kind, modes in kinds.items()
    }
    sizes = {name: [(getattr(a, name), getattr(a, sd)) for a in approaches] for name, sd in _SIZES}
    seen = {name: [e for e, sd in sizes[name] if sd < most] for name, most in _SEEN.items()}
    begins = [a for a in approaches if a.mode != "LG"]
    return {
        "changes": len(approaches),
        "changes_found_pct": _percent(a.found for a in approaches),
        "begins_found_pct": _percent(a.found for a in begins),
        "distance_median_mm": median,
        "riser_rmse_mm": _scaled(_rms(seen["riser_m"]), 1e3),
        "tread_rmse_mm": _scaled(_rms(seen["tread_m"]), 1e3),
        "slope_rmse_deg": _scaled(_rms(seen["slope_rad"]), 180.0 / math.pi),
        "sizes": {
            told: {way: _size_figures(name, factor, [a for a in approaches if a.mode == mode])
                   for way, mode in zip(("up", "down"), modes)}
            for told, name, factor, modes in (
                ("riser_mm", "riser_m", 1e3, ("SA", "SD")),
                ("tread_mm", "tread_m", 1e3, ("SA", "SD")),
                ("slope_deg", "slope_rad", 180.0 / math.pi, ("RA", "RD")),
            )
        },
        "inside_95_pct": _inside([p for name in ("riser_m", "tread_m", "slope_rad") for p in sizes[name]]),
        "distance_inside_95_pct": _inside(sizes["distance_m"]),
    }  # fmt: skip


def _size_figures(name: str, factor: float, approaches: Sequence[ScoredApproach]) -> dict[str, float | None]:
    """Of one size: the share of the changes of which it was seen, errors of those, errors of all that were told."""
    sd = name.replace("_", "_sd_")
    own = [(getattr(a, name), getattr(a, sd)) for a in approaches]
    return {
        "seen_pct": _percent(math.isfinite(e) and d < _SEEN[name] for e, d in own),
        "rmse": _scaled(_rms([e for e, d in own if d < _SEEN[name]]), factor),
        "told_rmse": _scaled(_rms([e for e, _ in own]), factor),
    }


def _inside(told: Iterable[tuple[float, float]]) -> float | None:
    """Share of errors within the told 95 % interval, of pairs of error and deviation, %."""
    return _percent(abs(e) < 1.96 * sd for e, sd in told if math.isfinite(e) and math.isfinite(sd))


def _calibration(steps: Sequence[ScoredMode]) -> float | None:
    """Expected calibration error of the told modes' probabilities, 0-1."""
    told = told_and_right(steps)
    if not told:
        return None
    return sum(abs(p - right) * count for p, right, count in told) / sum(count for _, _, count in told)


def told_and_right(steps: Sequence[ScoredMode]) -> list[tuple[float, float, int]]:
    """By tenths of the told mode's probability: its mean, the share of steps that were right, and their number."""
    told = [(max(s.probabilities), s.right) for s in steps if s.probabilities]
    p, right = np.array([t[0] for t in told]), np.array([t[1] for t in told], float)
    bins = np.minimum((p * _BINS).astype(int), _BINS - 1)
    return [
        (float(p[bins == b].mean()), float(right[bins == b].mean()), int((bins == b).sum())) for b in np.unique(bins)
    ]


def _percent(right: Iterable[bool]) -> float | None:
    answers = list(right)
    return 100.0 * sum(map(bool, answers)) / len(answers) if answers else None


def _quantile(values: Sequence[float], percent: float) -> float | None:
    return float(np.percentile(values, percent)) if len(values) else None


def _rms(values: Sequence[float]) -> float | None:
    known = [v for v in values if math.isfinite(v)]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor
