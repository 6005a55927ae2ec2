"""Good recordings of all parts and of the catalogue's walks, and what `check` wrongly reports about them."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.implausible.corruptions import CORRUPTIONS
from benchmarks.implausible.files import FORMATS
from benchmarks.implausible.trials import list_reports
from benchmarks.implausible.walks import camera_parts, imu_parts, small_camera, take_walk
from stridetwin.scenarios.built_in import catalogue
from stridetwin.scenarios.check import Finding, check_recording
from stridetwin.scenarios.record import CAMERAS, make_twin, record
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import Exo, Gait, Gaze, Level, Ramp, Route, Segment, Stairs, Turn, TwinConfig
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.people import Person
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.recording.reader import Recording

CAMERA_EVERY = 15
"""One of so many clean walks has the camera."""
CATALOGUE_CAMERA_EVERY = 3
"""One of so many of the catalogue's walks has the camera."""
_MOST_DRAWS = 10
"""Walks that are drawn until one can be planned."""
_TRUE = re.compile(r"at the end of the range|could not be checked|were not checked|assumed|are joined|has no unit")
"""Of reports that are true of a good recording: clipping of a part's range, and what a format leaves open."""


@dataclass(frozen=True, kw_only=True)
class CleanTrial:
    """A good recording.

    Attributes:
        seed: Of the walk.
        part: Name of the part of interest, or of the catalogue's scenario.
        form: Format in which it was checked besides our own; "" for none.
        alarms: Reports that are false.
    """

    seed: int
    part: str
    form: str
    alarms: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class CleanCase:
    """A good recording to generate: number of the walk, and seed of the benchmark."""

    number: int
    seed: int

    @property
    def has_camera(self) -> bool:
        """Whether the head's camera is on."""
        return self.number % CAMERA_EVERY == CAMERA_EVERY - 1


def check_clean(case: CleanCase) -> CleanTrial:
    """Generates a walk, and checks it as it is and in another format; returns what was wrongly reported."""
    rng = np.random.default_rng([case.seed, case.number, 2])
    twin, part = _draw_twin(case, rng)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "walk.mcap"
        record(twin, path)
        recording = Recording(path, lenient=True)
        alarms = [f"mcap: {f.text}" for f in check_recording(recording).findings if is_alarm(f)]
        body = "head" if case.has_camera else "foot"
        form = str(rng.choice([name for name, f in FORMATS.items() if f.body == body]))
        topic = f"/{twin.config.rig_mount}/imu" if case.has_camera else f"/foot_{rng.choice(['l', 'r'])}/imu"
        source = FORMATS[form].write(Path(folder), take_walk(recording, topic))
        alarms += [f"{form}: {f.text}" for f in list_reports(source) if is_alarm(f)]
    return CleanTrial(seed=case.seed + case.number, part=part, form=form, alarms=tuple(alarms))


def check_catalogue_walk(case: CleanCase) -> CleanTrial:
    """Generates a walk of the catalogue, without faults, and checks it; returns what was wrongly reported.

    One of `CATALOGUE_CAMERA_EVERY` has the camera on the head, with smaller images; shoe cameras are off.
    """
    names = sorted(catalogue())
    name = names[case.number % len(names)]
    config = load_scenario(name).config
    has_camera = case.number % CATALOGUE_CAMERA_EVERY == 0 and "head_camera" in config.sensors
    kept = {"head_camera"} if has_camera else set()
    sensors = tuple(group for group in config.sensors if group not in CAMERAS or group in kept)
    fittings = dict(config.fittings)
    if has_camera and "head_camera" not in fittings:
        fittings["head_camera"] = SensorConfig(part=small_camera(camera_parts()[case.number % len(camera_parts())]))
    twin = make_twin(replace(config, sensors=sensors, fittings=fittings, faults=()), case.seed + case.number)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "walk.mcap"
        record(twin, path)
        findings = check_recording(Recording(path, lenient=True)).findings
    alarms = tuple(f.text for f in findings if is_alarm(f))
    return CleanTrial(seed=case.seed + case.number, part=name, form="", alarms=alarms)


def _draw_twin(case: CleanCase, rng: np.random.Generator) -> tuple[Twin, str]:
    """The twin of a walk that can be planned, and the part of interest; ways that nobody can walk are drawn again.

    Raises:
        StrideTwinError: None of many can be planned.
    """
    for _ in range(_MOST_DRAWS - 1):
        config, part = draw_config(case, rng)
        with suppress(StrideTwinError):
            return make_twin(config, case.seed + case.number), part
    config, part = draw_config(case, rng)
    return make_twin(config, case.seed + case.number), part


def is_alarm(report: Finding) -> bool:
    """Whether a report on a good recording is false: an error, or a warning of a cause that this does not have."""
    names_cause = any(corruption.is_named_by(report.text) for corruption in CORRUPTIONS.values())
    return (report.is_error or names_cause) and not _TRUE.search(report.text)


def draw_config(case: CleanCase, rng: np.random.Generator) -> tuple[TwinConfig, str]:
    """A short walk of any person, gait, way and parts, with all sensors or the head's camera; and the part in turn."""
    imus, cameras = imu_parts(), camera_parts()
    fittings = {
        "foot_imu": SensorConfig(part=load_part(imus[case.number % len(imus)])),
        "head_imu": SensorConfig(part=load_part(str(rng.choice(imus)))),
    }
    part = imus[case.number % len(imus)]
    sensors: tuple[str, ...] = ("foot_imu", "insole", "ahrs", "exo_imu", "encoder", "interaction", "head_imu")
    if case.has_camera:
        part = cameras[case.number // CAMERA_EVERY % len(cameras)]
        fittings["head_camera"] = SensorConfig(part=small_camera(part))
        sensors = ("foot_imu", "head_imu", "head_camera")
    pattern = str(rng.choice(["walk", "walk", "wander", "jog"]))
    gait = Gait.of_pattern(
        pattern,
        stand_s=float(rng.uniform(0.8, 2.5)),
        asymmetry=float(rng.choice([0.0, 0.0, 0.2])),
        shuffle=float(rng.choice([0.0, 0.0, 0.5])),
        gaze=Gaze(kind=str(rng.choice(["ahead", "terrain", "wandering"]))),
    )
    config = TwinConfig(
        name=f"clean_{case.number}",
        route=Route(segments=tuple(_draw_way(rng)), scenery=str(rng.choice(["room", "outdoor", "corridor"]))),
        person=Person(height_m=float(rng.uniform(1.52, 1.93)), mass_kg=float(rng.uniform(50, 105))),
        exo=None if case.has_camera else Exo(),
        gait=gait,
        sensors=sensors,
        fittings=fittings,
        rig_mount=str(rng.choice(["head", "chest"])),
    )
    return config, part


def _draw_way(rng: np.random.Generator) -> Iterator[Segment]:
    """Yields a level, a stair, ramp or nothing, a turn, and a level: 5 to 9 m."""
    yield Level(length_m=float(rng.uniform(1.5, 3.0)))
    what = str(rng.choice(["none", "none", "stairs", "ramp"]))
    down = bool(rng.random() < 0.5)
    if what == "stairs":
        yield Stairs(risers=int(rng.integers(2, 5)), riser_m=float(rng.uniform(0.12, 0.19)), down=down)
        yield Level(length_m=1.5)
    elif what == "ramp":
        yield Ramp(angle_rad=float(rng.uniform(0.04, 0.15)), rise_m=0.15, down=down)
        yield Level(length_m=1.0)
    yield Turn(angle_rad=float(rng.uniform(-1.6, 1.6)), radius_m=float(rng.uniform(1.0, 2.0)))
    yield Level(length_m=float(rng.uniform(1.5, 3.0)))
