"""The report of a walk: one self-contained HTML file without network access."""

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
from stridetwin.report.figures_gait import ground_reaction_figure, joint_figures, level_strides, pressure_figure
from stridetwin.report.figures_path import (
    by_part,
    error_over_time,
    label_of,
    part_of,
    plan_view,
    side_view,
    steps_from_above,
    steps_from_aside,
)
from stridetwin.report.figures_streams import WINDOW_S, scalar_topics, stream_figures
from stridetwin.report.figures_terrain import (
    ground_errors,
    ground_from_above,
    ground_from_aside,
    lead_times,
    mode_ribbon,
)
from stridetwin.report.html import boxes, multiples, page, rendered, section, table
from stridetwin.report.images import Film, camera_views, data_uri, jpeg_uri
from stridetwin.scenarios.metadata import injected_faults
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.terrain_truth import terrain_layout

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
    ("nees_position_mean", "NEES of the position, mean (3 if consistent)", "", 2),
    ("nees_position_within_95_pct", "Time within its own 95 % bound", "%", 1),
    ("nis_standing", "Zero-velocity updates, NIS per degree of freedom (1 if consistent)", "", 2),
    ("nis_sightings", "Checkerboard observations, NIS per degree of freedom", "", 2),
    ("nis_echoes", "Sonar ranges, NIS per degree of freedom", "", 2),
    ("distance_m", "Distance travelled by the frame", "m", 2),
)
_AHEAD_ROWS = (
    (MODES, "accuracy_pct", "Steps whose mode was predicted correctly", "%", 1),
    (MODES, "strict_accuracy_pct", "the same, with one correct mode for soles across a ramp's edge", "%", 1),
    (MODES, "transition_accuracy_pct", "Steps that change the mode, predicted correctly", "%", 1),
    (MODES, "steps", "Steps", "", 0),
    (MODES, "transitions", "steps that change the mode", "", 0),
    (MODES, "lead_median_s", "Lead time of the final correct prediction, median", "s", 2),
    (MODES, "lead_p5_s", "the same, 5th percentile", "s", 2),
    (MODES, "footprint_forward_rmse_m", "Footprint one step ahead, forward, RMS error", "m", 3),
    (MODES, "footprint_left_rmse_m", "the same, sideways", "m", 3),
    (MODES, "calibration_error", "Predicted probabilities, calibration error", "", 3),
    (MODES, "changes_found_pct", "Terrain changes detected 1.5 s ahead", "%", 1),
    (MODES, "riser_rmse_mm", "their risers, RMS error", "mm", 1),
    (MODES, "tread_rmse_mm", "their treads, RMS error", "mm", 1),
    (MODES, "slope_rmse_deg", "their slopes, RMS error", "°", 2),
    (MAP, "accuracy_rmse_mm", "Distance of the mapped ground to the true surface, RMS", "mm", 1),
    (MAP, "accuracy_p95_mm", "the same, 95th percentile", "mm", 1),
    (MAP, "completeness_pct", "Ground 0.5 to 2.5 m ahead mapped within 3 cm", "%", 1),
    (MAP, "edge_rmse_mm", "Edge position along the route, RMS error", "mm", 1),
)
_RESIDUAL = "/truth/root_residual"
_PUBLISHED = (
    ("jao_straight_53m", "straight, 53 m", 53.0),
    ("jao_loop_126m", "loop with ramp and stair, 126 m", 126.0),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportData:
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


def render_report(data: ReportData) -> str:
    """The report as HTML text."""
    config = data.config
    chips = [
        f"{data.duration_s:.1f} s of walking",
        *travelled(data.results),
        f"seed {data.seed}",
        f"{config.physics} physics",
        f"{config.person.height_m:.2f} m, {config.person.mass_kg:.0f} kg",
        f"{config.gait.speed_mps:g} m/s on the level",
        "ideal sensors" if config.ideal else "data-sheet sensors",
    ]
    if _RESIDUAL in data.recording.topics and config.physics == "dynamic":
        chips.append(_root_help(data.recording, config.person.mass_kg))
    if "fell_at_s" in data.recording.metadata:
        chips.append(f"FELL after {data.recording.metadata['fell_at_s']} s")
    sections = [
        _score_cards(data.results),
        _film(data.film),
        _views(data),
        _paths(data),
        _steps(data),
        _ahead(data),
        _gait(data),
        _streams(data),
        _faults(data),
        _score_table(data.results),
        _sensors(data),
        _reproduce(data),
    ]
    name = config.name.replace("_", " ")
    footer = "Everything on this page comes from one recording; the estimators never had access to the truth."
    return page(name[:1].upper() + name[1:], data.description, chips, sections, footer)


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
    return f"external force at the pelvis {mean:.2f} % of body weight (95th percentile {p95:.2f}, maximum {most:.2f})"


def _score_cards(results: Sequence[Result]) -> str:
    cards = []
    for key, title, unit, scale, digits, note in _CARDS:
        values = [
            {"number": _number(r.scores[key] * scale, digits), "unit": unit, "part": part_of(r.estimate),
             "label": label_of(r.estimate)} for r in results if key in r.scores
        ]  # fmt: skip
        if values:
            cards.append({"title": title, "values": values, "note": note})
    lead = [
        found.declaration.summary
        for name, found in registry.estimators(PATH).items()
        if any(r.estimate.name == name or r.estimate.name.startswith(f"{name}_") for r in results)
    ]
    lead += ["Scored against the ground truth."]
    body = rendered("score_cards", cards=cards)
    return section("Accuracy", " ".join(lead), body, "cards") if cards else ""


def _film(film: Film | None) -> str:
    if film is None:
        return ""
    stills = [(f"{t:.0f} s", jpeg_uri(rgb)) for t, rgb in film.stills]
    source, poster = data_uri(film.webm, "video/webm"), stills[len(stills) // 3][1]
    body = rendered("film", source=source, poster=poster, stills=stills)
    return section("The walk", "In real time, seen from outside.", body, "card film")


def _views(data: ReportData) -> str:
    boards = data.config.fittings.get("foot_camera", SensorConfig()).frames == "board"
    partly = [t for t in data.recording.rig.cameras if boards and t.startswith("/foot_")]
    views = [
        {"title": view.title, "images": [(f"{t:.1f} s", jpeg_uri(pixels, 75)) for t, pixels in view.images]}
        for view in camera_views(data.recording, partly)
    ]
    lead = "Six frames of each camera. In depth images near is yellow, far is violet, and black is no reading."
    if partly:
        lead += (
            " Of a shoe camera, only the other shoe's checkerboard and its surroundings are rendered (frames: full in "
            "the scenario renders everything); each frame is the next one with the board in view, cropped to it."
        )
    return section("Camera views", lead, rendered("views", views=views)) if views else ""


def _paths(data: ReportData) -> str:
    if not data.results:
        return ""
    footprints = data.recording.block(FOOTPRINTS) if FOOTPRINTS in data.recording.topics else None
    layout = terrain_layout(data.recording.metadata)
    parts = by_part(data.results).values()
    figures = (
        plan_view(layout, data.results, footprints),
        *(side_view(layout, own) for own in parts),
        *(error_over_time(own) for own in parts),
    )
    lead = (
        "Paths of the IMUs on feet and camera. Heights are stretched. Click an entry of a legend to hide a curve, "
        "drag to zoom, double-click to zoom out."
    )
    return section("Paths", lead, boxes(figures), "stack")


def _steps(data: ReportData) -> str:
    if data.steps is None:
        return ""
    layout, scores = terrain_layout(data.recording.metadata), data.steps.scores
    figures = (steps_from_aside(layout, data.steps.steps), steps_from_above(layout, data.steps.steps))
    lead = (
        "Only from the exoskeleton's AHRS, encoders and insoles: the plane under each footprint and its normal, over "
        f"the true ground. RMS errors: slope {_number(scores['slope_rmse_deg'], 2)}°, elevation "
        f"{_number(scores['elevation_rmse_mm'], 1)} mm; {_number(scores['classification_accuracy_pct'], 1)} % of "
        f"{scores['steps']:.0f} steps classified correctly; end error {_number(scores['end_error_m'], 2)} m."
    )
    return section("Terrain estimated from the legs", lead, boxes(figures), "stack")


def _ahead(data: ReportData) -> str:
    ahead = data.ahead
    if ahead is None:
        return ""
    figures = [
        ground_from_above(ahead), ground_from_aside(ahead), ground_errors(ahead), mode_ribbon(ahead), lead_times(ahead)
    ]  # fmt: skip
    lead = (
        "From depth camera, visual-inertial odometry and insoles: the ground, mapped before the walker reached it; the "
        "mode of each coming step; and the footprints predicted one step before, with their 95 % ellipses. The figures "
        "exclude the drift of the odometry; the scores include it."
    )
    return section("Terrain ahead", lead, boxes([*figures, _ahead_table(ahead)]), "stack")


def _ahead_table(ahead: Ahead) -> str:
    paper = reference("zhao2023")["generality"]["accuracy_pct"]
    rows = []
    first = {MAP: next(iter(ahead.maps), ""), MODES: next(iter(ahead.predicted), "")}
    for kind, key, words, unit, digits in _AHEAD_ROWS:
        scores = ahead.scores.get(first[kind], {})
        if key in scores:
            theirs = f"{paper['mean']:.2f} ± {paper['sd']:.2f}" if key == "accuracy_pct" else "–"
            rows.append((_with_unit(words, unit), _number(scores[key], digits), theirs))
    note = (
        "Zhao et al. 2023, tables II and III: mean and standard deviation over 540 walks of real people; the paper "
        "reports none of the other scores. For orientation, not for ranking."
    )
    return table(("Score", "this walk", "Zhao et al. 2023"), rows, (1, 2), note=note)


def _gait(data: ReportData) -> str:
    if FOOTPRINTS not in data.recording.topics:
        return ""
    footprints = true_footprints(data.recording)
    strides = level_strides(footprints)
    figures = [
        *joint_figures(data.recording, strides),
        ground_reaction_figure(data.recording, strides, data.config.person.mass_kg),
        pressure_figure(data.recording, footprints),
    ]
    body = boxes(figures)
    lead = (
        f"{len(strides)} level strides, one curve each. Bands: people at this speed, mean ± one and two SD "
        "(Schwartz, Rozumalski and Trost 2008)."
    )
    return section("Gait", lead, body, "plots") if body else ""


def _streams(data: ReportData) -> str:
    middle = data.duration_s / 2
    window = (middle - WINDOW_S / 2, middle + WINDOW_S / 2)
    figures = stream_figures(data.recording, scalar_topics(data.recording), window)
    if not figures:
        return ""
    lead = f"The same {WINDOW_S:g} seconds of every stream of the recording."
    return section("Sensor streams", lead, multiples(figures))


def _faults(data: ReportData) -> str:
    times: dict[tuple[str, str], list[str]] = {}
    for fault in injected_faults(data.recording.metadata):
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
        (_with_unit(words, unit), *(_number(r.scores[key], digits) if key in r.scores else "–" for r in results))
        for key, words, unit, digits in _ROWS
        if any(key in r.scores for r in results)
    ]
    names = [r.estimate.name for r in results]
    scores = table(("Score", *names), rows, range(1, len(names) + 1))
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
        "walks on real hardware. For orientation, not for ranking."
    )
    head = ("Published end errors", "left", "right", "left, share", "right, share")
    return table(head, rows, range(1, 5), note=note, css="more")


def _sensors(data: ReportData) -> str:
    recording, rig = data.recording, data.recording.rig
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
    found = table(("Topic", "Part", "Mounted on", "Rate, Hz", "Samples"), rows, (3, 4))
    return section("Sensors", "The rig as the recording declares it.", found) if rows else ""


def _reproduce(data: ReportData) -> str:
    lead = "The scenario and the seed fix every byte of the recording and of scores.json."
    return section("Reproduce", lead, Markup("<pre>{}</pre>").format(data.command), "")


def _with_unit(words: str, unit: str) -> str:
    return f"{words}, {unit}" if unit else words


def _code(words: str) -> Markup:
    return Markup("<code>{}</code>").format(words)


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")
