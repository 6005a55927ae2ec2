"""`score`: every estimator that recordings feed, against the truth."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stridetwin.scenarios.commands.outcome import Outcome, Progress
from stridetwin.scenarios.commands.source import opened
from stridetwin.streams.errors import StrideTwinError

if TYPE_CHECKING:
    from stridetwin.scenarios.baseline import Regression
    from stridetwin.scenarios.scoring import Scores

_SHOWN_STEPS = {
    "slope_rmse_deg": "slope °",
    "elevation_rmse_mm": "elevation mm",
    "slope_in_95_pct": "slope in 95 %",
    "elevation_in_95_pct": "elev. in 95 %",
    "classification_accuracy_pct": "class %",
    "unknown_pct": "unknown %",
    "end_error_m": "end m",
    "end_error_pct": "end %",
}
_SHOWN_MODES = {
    "accuracy_pct": "right %",
    "strict_accuracy_pct": "strict %",
    "transition_accuracy_pct": "transitions %",
    "lead_median_s": "lead s",
    "lead_p5_s": "lead 5 % s",
    "changes_found_pct": "changes found %",
    "riser_rmse_mm": "riser mm",
    "tread_rmse_mm": "tread mm",
    "slope_rmse_deg": "slope °",
}
_SHOWN_MAP = {
    "accuracy_rmse_mm": "accuracy mm",
    "accuracy_p95_mm": "accuracy 95 % mm",
    "completeness_pct": "complete %",
    "edge_rmse_mm": "edges mm",
    "found_pct": "changes found %",
    "begin_rmse_mm": "begin mm",
    "riser_rmse_mm": "riser mm",
    "tread_rmse_mm": "tread mm",
    "slope_rmse_deg": "slope °",
}
_SHOWN = {
    "end_error_m": "end m",
    "end_error_pct": "end %",
    "end_height_error_m": "height m",
    "ape_rmse_m": "APE RMSE m",
    "rpe_5m_pct": "RPE 5 m %",
    "armse_2d_m": "2-D ARMSE m",
    "nees_position_within_95_pct": "in 95 % bound %",
}
_KINDS = (
    ("elevation_rmse_mm", _SHOWN_STEPS), ("completeness_pct", _SHOWN_MAP), ("strict_accuracy_pct", _SHOWN_MODES),
    ("", _SHOWN),
)  # fmt: skip
"""A score that tells an estimator's kind, and what is shown of it."""


def score_command(arguments: Namespace, progress: Progress) -> Outcome:
    """`score`."""
    from stridetwin.scenarios.ahead import look_ahead, odometry_of
    from stridetwin.scenarios.baseline import regressions
    from stridetwin.scenarios.estimates import estimates
    from stridetwin.scenarios.evaluate import Estimate, evaluate, summary
    from stridetwin.scenarios.step_scores import evaluate_steps, feeds_steps
    from stridetwin.streams.tum import read_tum

    named = [_named_file(text) for text in arguments.estimate]
    if named and len(arguments.recordings) > 1:
        raise StrideTwinError("--estimate goes with one recording; valid: one RECORDING, or no --estimate")
    baseline = _json_file(arguments.baseline) if arguments.baseline else None
    entries, scores = [], []
    for i, path in enumerate(arguments.recordings):
        progress("score", i / len(arguments.recordings))
        recording = opened(path, arguments.lenient)
        made = [Estimate(name=n, frame=arguments.frame, path=read_tum(f)) for n, f in named] or estimates(recording)
        steps = not named and feeds_steps(recording)
        if not made and not steps:
            raise StrideTwinError(
                f"{path}: feeds no estimator; valid: a recording with /foot_l/imu or /foot_r/imu, with an "
                "exoskeleton's AHRS, encoders and insoles, or with an RGB-D camera with IMU on head or chest"
            )
        scores.append({r.estimate.name: r.scores for r in evaluate(recording, made, arguments.align)})
        if steps:
            scores[-1]["contact_terrain"] = evaluate_steps(recording).scores
        odometry = None if named else odometry_of(recording, made)
        if odometry is not None:
            scores[-1] |= look_ahead(recording, odometry, progress).scores
        entries.append({"name": path.stem, "metadata": _public(recording.metadata), "estimators": scores[-1]})
    mean = summary(scores)
    data: dict[str, Any] = {"recordings": entries, "estimators": mean}
    lines, worse = score_table(mean), []
    if baseline is not None:
        worse = regressions(mean, baseline, str(arguments.baseline), arguments.tolerance / 100.0)
        data["regressions"] = [vars(r) for r in worse]
        lines += ["", *_regression_table(worse, arguments.tolerance)]
    return Outcome(data=data, lines=lines, code=1 if worse else 0)


def score_table(scores: dict[str, Scores]) -> list[str]:
    """The main scores as lines of text, one an estimator: those of paths, then of steps, of the map, of modes."""
    parts: dict[str, dict[str, Scores]] = {key: {} for key in ("", *(key for key, _ in _KINDS))}
    for name, values in scores.items():
        parts[next(key for key, _ in _KINDS if not key or key in values)][name] = values
    shown = dict(_KINDS)
    blocks = [_score_lines(found, shown[key]) for key, found in parts.items() if found]
    return [line for block in blocks for line in ("", *block)][1:] or _score_lines({}, _SHOWN)


def _score_lines(scores: dict[str, Scores], shown: dict[str, str]) -> list[str]:
    lines = [f"{'estimator':<16}" + "".join(f"{words:>17}" for words in shown.values())]
    for name, values in scores.items():
        cells = (f"{values[k]:>17.3f}" if k in values else f"{'-':>17}" for k in shown)
        lines.append(f"{name:<16}" + "".join(cells))
    return lines


def _regression_table(worse: list[Regression], tolerance: float) -> list[str]:
    if not worse:
        return [f"no score is worse than the baseline by more than {tolerance:g} %"]
    lines = [f"{'worse than the baseline':<44}{'baseline':>12}{'limit':>12}{'now':>12}"]
    for r in worse:
        now = "missing" if r.now is None else f"{r.now:.4f}"
        lines.append(f"{r.estimator + ' ' + r.metric:<44}{r.baseline:>12.4f}{r.limit:>12.4f}{now:>12}")
    return lines


def _named_file(text: str) -> tuple[str, Path]:
    name, equals, file = text.partition("=")
    if not (name and equals and file):
        raise StrideTwinError(f"--estimate: {text!r} is not valid; valid: NAME=FILE")
    return name, Path(file)


def _json_file(path: Path) -> object:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise StrideTwinError(f"{path}: is not JSON: {error}") from error


def _public(metadata: Any) -> dict[str, str]:
    return {k: metadata[k] for k in ("scenario", "seed", "physics") if k in metadata}
