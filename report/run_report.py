"""The report of a walk: one self-contained HTML file without network access."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from stridetwin.outputs.base import KindEvaluations, scores_by_output
from stridetwin.outputs.coverage import coverage_chips
from stridetwin.outputs.truth import FOOTPRINTS, true_footprints
from stridetwin.pages.html import boxes, code, data_uri, multiples, page, render_template, section, table
from stridetwin.report.figures_gait import ground_reaction_figure, joint_figures, level_strides, pressure_figure
from stridetwin.report.figures_streams import WINDOW_S, scalar_topics, stream_figures
from stridetwin.report.images import Film, camera_views, jpeg_uri
from stridetwin.scenarios.metadata import read_injected_faults
from stridetwin.scenarios.scenario_file import Scenario
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.streams.recording.reader import Recording

_RESIDUAL = "/truth/root_residual"  # topic of the external force at a simulated walker's pelvis


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportData:
    """What a report shows.

    Attributes:
        scenario: Scenario of the walk.
        seed: Seed of the walk.
        duration_s: Length of the walk.
        total_mass_kg: Mass of person and exoskeleton.
        command: The command that reproduces it.
        recording: Recording of the walk.
        of_kinds: The evaluated outputs of each kind.
        film: Third-person film, or None.
    """

    scenario: Scenario
    seed: int
    duration_s: float
    total_mass_kg: float
    command: str
    recording: Recording
    of_kinds: Sequence[KindEvaluations]
    film: Film | None


def render_report(data: ReportData) -> str:
    """The report as HTML text."""
    config = data.scenario.config
    parts = [of_kind.kind.report(of_kind.evaluations, data.recording) for of_kind in data.of_kinds]
    chips = [
        f"{data.duration_s:.1f} s of walking",
        *coverage_chips(scores_by_output(data.of_kinds)),
        *(chip for part in parts for chip in part.chips),
        f"seed {data.seed}",
        f"{config.physics} physics",
        f"{config.person.height_m:.2f} m, {config.person.mass_kg:.0f} kg",
        f"{config.gait.speed_mps:g} m/s on the level" if config.motion is None else "recorded motion",
        "ideal sensors" if config.ideal else "data-sheet sensors",
    ]
    if _RESIDUAL in data.recording.topics and config.physics == "dynamic":
        chips.append(_describe_root_help(data.recording, config.person.mass_kg * config.gravity_mps2))
    if "fell_at_s" in data.recording.metadata:
        chips.append(f"FELL after {data.recording.metadata['fell_at_s']} s")
    sections = [
        *(part.summary for part in parts),
        _film_section(data.film),
        _view_section(data),
        *(part.figures for part in parts),
        _gait_section(data),
        _stream_section(data),
        _fault_section(data),
        *(part.scores for part in parts),
        _sensor_section(data),
        _reproduce_section(data),
    ]
    name = config.name.replace("_", " ")
    footer = "Everything on this page comes from one recording; the estimators never had access to the truth."
    return page(name[:1].upper() + name[1:], data.scenario.description, chips, sections, footer)


def _describe_root_help(recording: Recording, body_weight_n: float) -> str:
    """Text on the external force at a simulated walker's pelvis, besides the ground's, in % of the body weight."""
    # (N,) size of the force as a share of the body weight
    force = np.linalg.norm(recording.block(_RESIDUAL).columns["force_in_world"], axis=1) / body_weight_n
    mean, p95, most = 100 * force.mean(), 100 * np.quantile(force, 0.95), 100 * force.max()
    return f"external force at the pelvis {mean:.2f} % of body weight (95th percentile {p95:.2f}, maximum {most:.2f})"


def _film_section(film: Film | None) -> str:
    """The section with the film and its stills; empty without a film."""
    if film is None:
        return ""
    stills = [(f"{t:.1f} s", jpeg_uri(rgb)) for t, rgb in film.stills]
    source = data_uri(film.webm, "video/webm")
    _, poster = stills[len(stills) // 3]  # the picture that is shown before the film plays
    body = render_template("film", source=source, poster=poster, stills=stills)
    return section("The walk", "In real time, seen from outside.", body, "card film")


def _view_section(data: ReportData) -> str:
    """The section with images of each camera; empty without cameras."""
    # whether shoe cameras render nothing but the other shoe's board; without options, as by default
    shoe_options = data.scenario.config.fittings.get("foot_camera", SensorConfig())
    renders_boards_only = shoe_options.frames == "board"
    partly = [t for t in data.recording.rig.cameras if renders_boards_only and t.startswith("/foot_")]
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
    return section("Camera views", lead, render_template("views", views=views)) if views else ""


def _gait_section(data: ReportData) -> str:
    """The section with joint angles, ground reaction and centre of pressure; empty without true footprints."""
    if FOOTPRINTS not in data.recording.topics:
        return ""
    footprints = true_footprints(data.recording)
    strides = level_strides(footprints)
    figures = [
        *joint_figures(data.recording, strides),
        ground_reaction_figure(data.recording, strides, data.total_mass_kg * data.scenario.config.gravity_mps2),
        pressure_figure(data.recording, footprints),
    ]
    body = boxes(figures)
    lead = (
        f"{len(strides)} level strides, one curve each. Bands: people at this speed, mean ± one and two SD "
        "(Schwartz, Rozumalski and Trost 2008). Loads are multiples of the carried weight, that of "
        f"{_describe_load(data)}: 1 is standing on one foot; boxes: people's peaks and valley at a comfortable speed."
    )
    return section("Gait", lead, body, "plots") if body else ""


def _describe_load(data: ReportData) -> str:
    """What the feet carry in a walk, with its mass, such as `person and exoskeleton, 75 + 10 kg`."""
    person_kg = data.scenario.config.person.mass_kg
    if data.scenario.config.exo is None:
        return f"the person, {person_kg:.1f} kg"
    return f"person and exoskeleton, {person_kg:.1f} + {data.total_mass_kg - person_kg:.1f} kg"


def _stream_section(data: ReportData) -> str:
    """The section with the middle seconds of every sensor stream; empty without any."""
    middle = data.duration_s / 2
    window = (middle - WINDOW_S / 2, middle + WINDOW_S / 2)
    figures = stream_figures(data.recording, scalar_topics(data.recording), window)
    if not figures:
        return ""
    lead = f"The same {WINDOW_S:g} seconds of every stream of the recording."
    return section("Sensor streams", lead, multiples(figures))


def _fault_section(data: ReportData) -> str:
    """The section with the times of the injected faults; empty without any."""
    times: dict[tuple[str, str], list[str]] = {}  # spans as text, by kind of fault and topic
    for fault in read_injected_faults(data.recording.metadata):
        times.setdefault((fault.kind, fault.topic), []).append(f"{fault.from_s:.2f}\N{EN DASH}{fault.until_s:.2f}")
    rows = []
    for (kind, topic), spans in times.items():
        # the first six spans are written out
        more = f" and {len(spans) - 6} more" if len(spans) > 6 else ""
        rows.append((kind, code(topic), f"{', '.join(spans[:6])}{more}"))
    lead = "Faults injected between sensor and recorder; shaded in the streams above."
    return section("Injected faults", lead, table(("Fault", "Stream", "Time, s"), rows, ())) if rows else ""


def _sensor_section(data: ReportData) -> str:
    """The section with the part, mount and rate of each sensor, and the number of its samples."""
    recording, rig = data.recording, data.recording.rig
    # part, rate in Hz, and body that carries it, of the sensor of each topic
    parts: Mapping[str, tuple[str, float, str]] = {
        **{t: (s.part, s.rate_hz, s.mount.body) for t, s in rig.imus.items()},
        **{t: (s.part, s.rate_hz, s.mount.body) for t, s in rig.cameras.items()},
        **{s.depth_topic: (s.part, s.rate_hz, s.mount.body) for s in rig.cameras.values() if s.depth_topic},
        **{t: (s.part, s.rate_hz, s.mount.body) for t, s in rig.others.items()},
    }
    rows = [
        (code(topic), part, body, f"{rate:g}", f"{recording.topics[topic].count:,}")
        for topic, (part, rate, body) in sorted(parts.items())
        if topic in recording.topics
    ]
    sensor_table = table(("Topic", "Part", "Mounted on", "Rate, Hz", "Samples"), rows, (3, 4))
    return section("Sensors", "The rig as the recording declares it.", sensor_table) if rows else ""


def _reproduce_section(data: ReportData) -> str:
    """The section with the command that makes the same run again."""
    lead = "The scenario and the seed fix every byte of the recording and of scores.json."
    return section("Reproduce", lead, Markup("<pre>{}</pre>").format(data.command), "")
