"""The report of a walk: one self-contained HTML file without scripts or network access."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from stridetwin.estimators import registry
from stridetwin.estimators.base import FEET, MAP, MODES, PATH
from stridetwin.evaluation.evaluate import Result
from stridetwin.evaluation.norms import reference
from stridetwin.evaluation.step_scores import StepResult
from stridetwin.evaluation.terrain_ahead import Ahead
from stridetwin.evaluation.truth import FOOTPRINTS, true_footprints
from stridetwin.report.camera_views import camera_views
from stridetwin.report.figures_gait import ground_reaction_figure, joint_figures, level_strides, pressure_figure
from stridetwin.report.figures_path import error_over_time, label_of, part_of, plan_view, side_view
from stridetwin.report.figures_steps import steps_from_above, steps_from_aside
from stridetwin.report.figures_streams import WINDOW_S, scalar_topics, stream_figures
from stridetwin.report.figures_terrain import (
    ground_errors,
    ground_from_above,
    ground_from_aside,
    lead_times,
    mode_ribbon,
)
from stridetwin.report.film import Film, data_uri, jpeg_uri
from stridetwin.report.html import boxes, page, rendered, section, table
from stridetwin.scenarios.metadata import injected_faults, terrain_layout
from stridetwin.sim.config import TwinConfig
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.recording.reader import Recording

_CARDS = (
    ("end_error_pct", "End error", "%", 1.0, 2, "of the distance that foot or camera travelled"),
    ("end_error_m", "End error, absolute", "cm", 100.0, 1, "position and yaw agree at the start"),
    ("end_height_error_m", "Height error at the end", "cm", 100.0, 1, "positive: the estimate is too high"),
    ("ape_rmse_m", "Position error, RMS", "cm", 100.0, 1, "over the whole walk"),
    ("rpe_5m_pct", "Relative error over 5 m", "%", 1.0, 2, "how much is lost on any five metres"),
    ("nees_position_within_95_pct", "Within its own 95 % bound", "%", 1.0, 0, "an honest filter: 95"),
)
_ROWS = (
    ("ape_rmse_m", "Position error, RMS", "m", 4),
    ("ape_mean_m", "Position error, mean", "m", 4),
    ("ape_max_m", "Position error, largest", "m", 4),
    ("armse_2d_m", "2-D ARMSE (as the pyshoe benchmark defines it)", "m", 4),
    ("rpe_1m_pct", "Relative error over 1 m", "%", 2),
    ("rpe_5m_pct", "Relative error over 5 m", "%", 2),
    ("end_error_m", "End error", "m", 4),
    ("end_error_pct", "End error, share of the distance", "%", 3),
    ("end_height_error_m", "Height error at the end", "m", 4),
    ("nees_position_mean", "NEES of the position, mean (3 is honest)", "", 2),
    ("nees_position_within_95_pct", "Time within the own 95 % bound", "%", 1),
    ("nis_standing", "Innovations of the standing foot, NIS per degree of freedom (1 is honest)", "", 2),
    ("nis_sightings", "Innovations of the boards seen, NIS per degree of freedom", "", 2),
    ("nis_echoes", "Innovations of the sonars' echoes, NIS per degree of freedom", "", 2),
    ("distance_m", "Distance travelled by the frame", "m", 2),
)
_AHEAD_ROWS = (
    (MODES, "accuracy_pct", "Steps whose mode was told rightly", "%", 1),
    (MODES, "strict_accuracy_pct", "the same, soles across a ramp's edge in one mode alone", "%", 1),
    (MODES, "transition_accuracy_pct", "Steps that change the mode, told rightly", "%", 1),
    (MODES, "steps", "Steps", "", 0),
    (MODES, "transitions", "of which change the mode", "", 0),
    (MODES, "lead_median_s", "Known for good before touch-down, median", "s", 2),
    (MODES, "lead_p5_s", "the same, 5th percentile", "s", 2),
    (MODES, "footprint_forward_rmse_m", "Footprint one step ahead, forward, RMS", "m", 3),
    (MODES, "footprint_left_rmse_m", "the same, sideways", "m", 3),
    (MODES, "calibration_error", "Told probabilities, calibration error", "", 3),
    (MODES, "changes_found_pct", "Changes of the ground told 1.5 s before", "%", 1),
    (MODES, "riser_rmse_mm", "their risers, RMS", "mm", 1),
    (MODES, "tread_rmse_mm", "their treads, RMS", "mm", 1),
    (MODES, "slope_rmse_deg", "their slopes, RMS", "°", 2),
    (MAP, "accuracy_rmse_mm", "Mapped ground ahead to the true surface, RMS", "mm", 1),
    (MAP, "accuracy_p95_mm", "the same, 95th percentile", "mm", 1),
    (MAP, "completeness_pct", "Ground 0.5 to 2.5 m ahead known within 3 cm", "%", 1),
    (MAP, "edge_rmse_mm", "Edges along the way, RMS", "mm", 1),
)
_RESIDUAL = "/truth/root_residual"
_PUBLISHED = (
    ("jao_straight_53m", "straight, 53 m", 53.0),
    ("jao_loop_126m", "loop with ramp and stair, 126 m", 126.0),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Story:
    """Content of a report.

    Attributes:
        description: One line about the scenario.
        config: Configuration of the twin.
        seed: Seed of the walk.
        duration_s: Length of the walk.
        command: The command that reproduces it.
        recording: The walk.
        results: Scored estimates.
        steps: Steps estimated from an exoskeleton's legs, or None.
        ahead: Maps and predicted steps, or None.
        film: Third-person film, or None.
    """

    description: str
    config: TwinConfig
    seed: int
    duration_s: float
    command: str
    recording: Recording
    results: Sequence[Result]
    steps: StepResult | None
    film: Film | None
    ahead: Ahead | None = None


def render_report(story: Story) -> str:
    """The report as HTML text."""
    config = story.config
    chips = [
        f"{story.duration_s:.1f} s of walking",
        *travelled(story.results),
        f"seed {story.seed}",
        f"{config.physics} physics",
        f"{config.person.height_m:.2f} m, {config.person.mass_kg:.0f} kg",
        f"{config.gait.speed_mps:g} m/s on the level",
        "ideal sensors" if config.ideal else "data-sheet sensors",
    ]
    if _RESIDUAL in story.recording.topics and config.physics == "dynamic":
        chips.append(_root_help(story.recording, config.person.mass_kg))
    if "fell_at_s" in story.recording.metadata:
        chips.append(f"FELL after {story.recording.metadata['fell_at_s']} s")
    sections = [
        _score_cards(story.results),
        _film(story.film),
        _views(story),
        _paths(story),
        _steps(story),
        _ahead(story),
        _gait(story),
        _streams(story),
        _faults(story),
        _score_table(story.results),
        _sensors(story),
        _reproduce(story),
    ]
    name = config.name.replace("_", " ")
    footer = "Everything on this page comes from one recording; truth and estimates never met before the scores."
    return page(name[:1].upper() + name[1:], story.description, chips, sections, footer)


def travelled(results: Sequence[Result]) -> list[str]:
    """Text with the longest path of a foot, else of the camera; empty without paths."""
    on_feet = [r for r in results if part_of(r.estimate) in FEET]
    whose = "a foot" if on_feet else "the camera"
    ways = [r.scores["distance_m"] for r in on_feet or results]
    return [f"{max(ways):.1f} m travelled by {whose}"] if ways else []


def _root_help(recording: Recording, mass_kg: float) -> str:
    """Text on the external force at a simulated walker's pelvis, besides the ground's."""
    force = np.linalg.norm(recording.block(_RESIDUAL).columns["force_in_world"], axis=1) / (
        mass_kg * NOMINAL_GRAVITY_MPS2
    )
    mean, p95, most = 100 * force.mean(), 100 * np.quantile(force, 0.95), 100 * force.max()
    return f"help at the root {mean:.2f} % of body weight (95 %: {p95:.2f}, most {most:.2f})"


def _score_cards(results: Sequence[Result]) -> str:
    cards = []
    for key, title, unit, scale, digits, words in _CARDS:
        values = [
            {"number": _number(r.scores[key] * scale, digits), "unit": unit, "part": part_of(r.estimate),
             "label": label_of(r.estimate)} for r in results if key in r.scores
        ]  # fmt: skip
        if values:
            cards.append({"title": title, "values": values, "words": words})
    lead = [
        found.declaration.summary
        for name, found in registry.estimators(PATH).items()
        if any(r.estimate.name == name or r.estimate.name.startswith(f"{name}_") for r in results)
    ]
    lead += ["Scored against the twin's truth."]
    body = rendered("score_cards", cards=cards)
    return section("How well the estimate did", " ".join(lead), body, "cards") if cards else ""


def _film(film: Film | None) -> str:
    if film is None:
        return ""
    stills = [(f"{t:.0f} s", jpeg_uri(rgb)) for t, rgb in film.stills]
    source, poster = data_uri(film.webm, "video/webm"), stills[len(stills) // 3][1]
    body = rendered("film", source=source, poster=poster, stills=stills)
    return section("The walk", "In real time, seen from outside.", body, "card film")


def _views(story: Story) -> str:
    views = [
        {"title": view.title, "images": [(f"{t:.1f} s", jpeg_uri(pixels, 75)) for t, pixels in view.pictures]}
        for view in camera_views(story.recording)
    ]
    lead = "Six frames of each camera. In depth images near is yellow, far is violet, and black is no reading."
    return section("What the cameras saw", lead, rendered("views", views=views)) if views else ""


def _paths(story: Story) -> str:
    if not story.results:
        return ""
    footprints = story.recording.block(FOOTPRINTS) if FOOTPRINTS in story.recording.topics else None
    layout = terrain_layout(story.recording.metadata)
    feet = [r for r in story.results if part_of(r.estimate) in FEET]
    camera = [r for r in story.results if r not in feet]
    figures = (
        *(side_view(layout, results) for results in (feet, camera) if results),
        plan_view(layout, story.results, footprints),
        error_over_time(story.results),
    )
    lead = (
        "Paths of the IMUs on feet and camera: black is true, dashed is estimated. Heights are stretched, and so are "
        "sides where the way is straight."
    )
    return section("Where it went", lead, boxes(figures), "stack")


def _steps(story: Story) -> str:
    if story.steps is None:
        return ""
    layout, scores = terrain_layout(story.recording.metadata), story.steps.scores
    figures = (steps_from_aside(layout, story.steps.steps), steps_from_above(layout, story.steps.steps))
    lead = (
        "From the exoskeleton's AHRS, encoders and insoles alone: each footprint with the plane that it stands on, its "
        f"normal in red, over the true ground. Slope {_number(scores['slope_rmse_deg'], 2)}° and elevation "
        f"{_number(scores['elevation_rmse_mm'], 1)} mm RMS, {_number(scores['classification_accuracy_pct'], 1)} % of "
        f"{scores['steps']:.0f} classes right; {_number(scores['end_error_m'], 2)} m off at the end."
    )
    return section("What the legs told", lead, boxes(figures), "stack")


def _ahead(story: Story) -> str:
    ahead = story.ahead
    if ahead is None:
        return ""
    figures = [
        ground_from_above(ahead), ground_from_aside(ahead), ground_errors(ahead), mode_ribbon(ahead), lead_times(ahead)
    ]  # fmt: skip
    lead = (
        "Depth camera, its odometry's poses and insoles: the ground as it was mapped before the walker stood on it, "
        "the mode of each coming step, and the footprints as they were told when the foot before them had just landed, "
        "with the ellipses that should hold 95 % of them. The drift of the odometry is taken out; its scores have it."
    )
    return section("What lay ahead", lead, boxes([*figures, _ahead_table(ahead)]), "stack")


def _ahead_table(ahead: Ahead) -> str:
    paper = reference("zhao2023")["generality"]["accuracy_pct"]
    rows = []
    first = {MAP: next(iter(ahead.maps), ""), MODES: next(iter(ahead.predicted), "")}
    for kind, key, words, unit, digits in _AHEAD_ROWS:
        scores = ahead.scores.get(first[kind], {})
        if key in scores:
            theirs = f"{paper['mean']:.2f} ± {paper['sd']:.2f}" if key == "accuracy_pct" else "–"
            rows.append((words, _number(scores[key], digits), theirs, unit or "–"))
    note = (
        "Zhao et al. 2023, tables II and III: mean and standard deviation over 540 walks of real people; the paper "
        "gives no more of these figures. For scale, not for ranking."
    )
    return table(("Score", "this walk", "Zhao et al. 2023", "Unit"), rows, (1, 2), note=note)


def _gait(story: Story) -> str:
    if FOOTPRINTS not in story.recording.topics:
        return ""
    footprints = true_footprints(story.recording)
    strides = level_strides(footprints)
    figures = [
        *joint_figures(story.recording, strides),
        ground_reaction_figure(story.recording, strides, story.config.person.mass_kg),
        pressure_figure(story.recording, footprints),
    ]
    body = boxes(figures)
    lead = (
        f"{len(strides)} level strides, each a line (left blue, right orange). Bands: people at that "
        "speed, one and two SD (Schwartz, Rozumalski and Trost 2008)."
    )
    return section("How it walks", lead, body, "plots") if body else ""


def _streams(story: Story) -> str:
    middle = story.duration_s / 2
    window = (middle - WINDOW_S / 2, middle + WINDOW_S / 2)
    figures = stream_figures(story.recording, scalar_topics(story.recording), window)
    if not figures:
        return ""
    lead = f"The same {WINDOW_S:g} seconds of every stream, as the recording holds them; time in s."
    return section("Every stream", lead, Markup('<div class="multiples">{}</div>').format(Markup("".join(figures))))


def _faults(story: Story) -> str:
    times: dict[tuple[str, str], list[str]] = {}
    for fault in injected_faults(story.recording.metadata):
        times.setdefault((fault.kind, fault.topic), []).append(f"{fault.from_s:.2f}\N{EN DASH}{fault.until_s:.2f}")
    rows = []
    for (kind, topic), spans in times.items():
        more = f" and {len(spans) - 6} more" if len(spans) > 6 else ""
        rows.append((kind, _code(topic), f"{', '.join(spans[:6])}{more}"))
    lead = "Faults injected between sensor and recorder; shaded in the streams above."
    return section("Injected faults", lead, table(("Fault", "Stream", "Time, s"), rows, ())) if rows else ""


def _score_table(results: Sequence[Result]) -> str:
    if not results:
        return ""
    rows = [
        (words, *(_number(r.scores[key], digits) if key in r.scores else "–" for r in results), unit or "–")
        for key, words, unit, digits in _ROWS
        if any(key in r.scores for r in results)
    ]
    names = [r.estimate.name for r in results]
    scores = table(("Score", *names, "Unit"), rows, range(1, len(names) + 1))
    lead = "Position and yaw agree at the start; the truth is taken at the estimate's own stamps."
    return section("Scores", lead, scores + _paper_figures())


def _paper_figures() -> Markup:
    jao = reference("jao2020")
    rows = []
    for key, words, length in _PUBLISHED:
        errors = jao[key]["mean_end_error_m"]["zupt"]
        rows.append((words, *(f"{e:.2f} m" for e in errors), *(f"{100 * e / length:.1f} %" for e in errors)))
    note = (
        "Jao, Wang and Shkel 2020, tables II and III: zero-velocity updates alone, an ADIS16485 in each shoe, other "
        "walks on real hardware. For scale, not for ranking."
    )
    head = ("Published end errors", "left", "right", "left", "right")
    return table(head, rows, range(1, 5), note=note, css="more")


def _sensors(story: Story) -> str:
    recording, rig = story.recording, story.recording.rig
    parts: Mapping[str, tuple[str, float, str]] = {
        **{t: (s.part, s.rate_hz, s.mount.body) for t, s in rig.imus.items()},
        **{t: (s.part, s.rate_hz, s.mount.body) for t, s in rig.cameras.items()},
        **{s.depth_topic: (s.part, s.rate_hz, s.mount.body) for s in rig.cameras.values() if s.depth_topic},
        **{t: (s.part, s.rate_hz, s.mount.body) for t, s in rig.others.items()},
    }
    rows = [
        (_code(topic), part, body, f"{rate:g}", f"{recording.topics[topic].count:,}")
        for topic, (part, rate, body) in sorted(parts.items())
        if topic in recording.topics
    ]
    found = table(("Topic", "Part", "Sits on", "Rate, Hz", "Samples"), rows, (3, 4))
    return section("Sensors", "The rig as the recording declares it.", found) if rows else ""


def _reproduce(story: Story) -> str:
    lead = "The scenario and the seed fix every byte of the recording and of scores.json."
    return section("Make it again", lead, Markup("<pre>{}</pre>").format(story.command), "")


def _code(words: str) -> Markup:
    return Markup("<code>{}</code>").format(words)


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")
