"""Sections of the report about estimated paths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from markupsafe import Markup

from stridetwin.estimators import registry
from stridetwin.estimators.base import FOOT_NAMES, PATH
from stridetwin.outputs.coverage import COVERAGE, partial_outputs
from stridetwin.outputs.path.evaluate import Result
from stridetwin.outputs.path.figures import (
    by_part,
    error_over_time,
    estimate_colors,
    label_of,
    nees_over_time,
    part_of,
    plan_view,
    side_view,
)
from stridetwin.outputs.path.scores import SCORES
from stridetwin.outputs.score_rows import score_table
from stridetwin.outputs.truth import FOOTPRINTS
from stridetwin.pages.html import boxes, number_text, render_template, section, table
from stridetwin.reference.norms import read_reference
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Footprint
from stridetwin.streams.terrain_truth import terrain_layout

# score, title, unit, factor from the score to the unit, decimals, note
_CARDS = (
    ("end_error_pct", "End error", "%", 1.0, 2, "of the distance that foot or camera travelled"),
    ("end_error_m", "End error, absolute", "cm", 100.0, 1, "position and yaw agree at the start"),
    ("end_height_error_m", "Height error at the end", "cm", 100.0, 1, "positive: the estimate is too high"),
    ("ape_rmse_m", "Position error, RMS", "cm", 100.0, 1, "over the whole walk"),
    ("rpe_5m_pct", "Relative error over 5 m", "%", 1.0, 2, "drift over any five metres"),
    (
        "nees_position_within_95_pct",
        "Within its own 95 % bound",
        "%",
        1.0,
        0,
        "of the time. A consistent filter has 95 over many walks; errors persist within one walk, so there it is "
        "mostly near 100, and sometimes far lower",
    ),
)
_COVERAGE_CARD = (
    COVERAGE.name,
    "Covered",
    "%",
    1.0,
    1,
    "of the walk's time. Below 95 % the other scores are those of a part, not comparable with those of a whole walk",
)
# key in the reference, title, length in m
_PUBLISHED_WALKS: tuple[tuple[Literal["jao_straight_53m", "jao_loop_126m"], str, float], ...] = (
    ("jao_straight_53m", "straight, 53 m", 53.0),
    ("jao_loop_126m", "loop with ramp and stair, 126 m", 126.0),
)


def describe_distance(results: Sequence[Result]) -> str:
    """Text with the longest path of a foot, else of the camera."""
    on_feet = [r for r in results if part_of(r.estimate) in FOOT_NAMES]
    carrier = "a foot" if on_feet else "the camera"
    longest_m = max(r.scores["distance_m"] for r in on_feet or results)
    return f"{longest_m:.1f} m travelled by {carrier}"


def score_cards(results: Sequence[Result]) -> str:
    """The main scores of every path as cards with large numbers; "" without any."""
    partial = partial_outputs({result.estimate.name: result.scores for result in results})
    shown = (_COVERAGE_CARD, *_CARDS) if partial else _CARDS
    cards, colors = [], estimate_colors(results)
    for key, title, unit, scale, digits, note in shown:
        values = [  # one number per path that has the score
            {
                "number": number_text(r.scores[key] * scale, digits),
                "unit": unit,
                "color": colors[r.estimate.name],
                "label": label_of(r.estimate),
            }
            for r in results
            if key in r.scores
        ]
        if values:
            cards.append({"title": title, "values": values, "note": note})
    # what each estimator with a result is; a result has the name of its estimator, with a part such as `foot_ins_l`
    lead = [
        estimator_class.declaration.summary
        for name, estimator_class in registry.estimators(PATH).items()
        if any(r.estimate.name == name or r.estimate.name.startswith(f"{name}_") for r in results)
    ]
    lead += ["Scored against the ground truth."]
    body = render_template("score_cards", cards=cards)
    return section("Accuracy", " ".join(lead), body, "cards") if cards else ""


def path_figures(results: Sequence[Result], recording: Recording) -> str:
    """Section with plan view, and side view and error over time of each part."""
    footprints = recording.block(FOOTPRINTS).as_kind(Footprint) if FOOTPRINTS in recording.topics else None
    layout = terrain_layout(recording.metadata)
    parts = by_part(results).values()
    figures = (
        plan_view(layout, results, footprints),
        *(side_view(layout, of_part) for of_part in parts),
        *(error_over_time(of_part) for of_part in parts),
    )
    lead = (
        "Paths of the IMUs on feet and camera. Heights are stretched. Click an entry of a legend to hide a curve, "
        "drag to zoom, double-click to zoom out."
    )
    return section("Paths", lead, boxes(figures), "stack")


def consistency_section(results: Sequence[Result]) -> str:
    """Section with the NEES of each part over time, and which estimates have no covariance."""
    missing = [result.name for result in results if result.comparison.estimate.covariance is None]
    lead = (
        "The squared position error relative to the reported covariance: 3 on average, and below the dashed line 95 % "
        "of the time, if the covariance is right; far above, the estimator is overconfident."
    )
    if missing:
        lead += f" Without a covariance: {', '.join(missing)}."
    figures = boxes(nees_over_time(of_part) for of_part in by_part(results).values())
    return section("Consistency", lead, figures, "stack")


def scores_section(results: Sequence[Result]) -> str:
    """All scores of every path, and end errors that a paper reports."""
    lead = "Position and yaw agree at the start; the truth is taken at the estimate's own stamps."
    scores = score_table(SCORES, {result.name: result.scores for result in results})
    return section("Scores", lead, scores + _paper_figures())


def _paper_figures() -> Markup:
    """Table of the end errors with zero-velocity updates alone that Jao et al. 2020 report, in m and as shares."""
    jao = read_reference("jao2020")
    rows = []
    for key, title, length in _PUBLISHED_WALKS:
        errors = jao[key]["mean_end_error_m"]["zupt"]  # of the left and of the right foot, m
        rows.append((title, *(f"{e:.2f} m" for e in errors), *(f"{100 * e / length:.1f} %" for e in errors)))
    note = (
        "Jao, Wang and Shkel 2020, tables II and III: zero-velocity updates alone, an ADIS16485 in each shoe, other "
        "walks on real hardware. For orientation, not for ranking."
    )
    head = ("Published end errors", "left", "right", "left, share", "right, share")
    return table(head, rows, range(1, 5), note=note, css="more")
