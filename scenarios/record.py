"""Records the walk of a scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from stridetwin.scenarios import exo_geometry
from stridetwin.scenarios.metadata import fault_metadata
from stridetwin.scenarios.scenario_file import CAMERAS, Scenario, to_scenario
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.faults.faults import FaultPlan, check_times
from stridetwin.sim.wearer.anthropometry import anthropometry
from stridetwin.streams.errors import ConfigError, explain_import_error
from stridetwin.streams.recording.reader import RecordingWriter
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Sample
from stridetwin.streams.terrain_truth import terrain_metadata

if TYPE_CHECKING:
    from stridetwin.sim.twin import Twin

Progress = Callable[[str, float], None]


def make_twin(scenario: Scenario | TwinConfig | str | Path, seed: int = 0) -> Twin:
    """Builds the twin, which simulates the walk of a scenario with all its sensors.

    Args:
        scenario: A scenario, the configuration of a walk, a name in the catalogue, or the path of a file.
        seed: Determines every sample.

    Raises:
        StrideTwinError: There is no such scenario, it cannot be walked, or the simulator is not installed.
    """
    return twin_class()(to_scenario(scenario).config, seed)


def twin_class() -> type[Twin]:
    """Imports the class of the twin.

    Raises:
        StrideTwinError: The simulator is not installed.
    """
    with explain_import_error("walks need the simulator", "twin"):
        from stridetwin.sim.twin import Twin
    return Twin


def without_cameras(scenario: Scenario | TwinConfig | str | Path) -> Scenario:
    """A scenario with the groups of sensors `CAMERAS` off and all others as they were.

    Args:
        scenario: A scenario, the configuration of a walk, a name in the catalogue, or the path of a file.
    """
    scenario = to_scenario(scenario)
    sensors = tuple(s for s in scenario.config.sensors if s not in CAMERAS)
    return replace(scenario, config=replace(scenario.config, sensors=sensors))


def record(twin: Twin, path: str | Path, progress: Progress = lambda stage, share: None) -> None:
    """Runs the twin and writes the truth and the sensor samples that arrive as one recording.

    Args:
        twin: The twin, with the faults of its scenario in its configuration.
        path: The recording to write.
        progress: Receives the stage and its progress (0-1).

    Raises:
        ConfigError: A fault begins after the walk's end, or the first argument is no twin.
    """
    if isinstance(twin, str | Path | Scenario | TwinConfig):
        raise ConfigError("record", "twin", type(twin).__name__, "a Twin, such as make_twin(SCENARIO)")
    config = twin.config
    # the faults: which samples they drop, change or delay, and the calibration that they falsify
    plan = FaultPlan.of(config.faults, twin.rig, twin.seed, twin.duration_s)
    metadata = _walk_metadata(twin, plan.rig)
    if twin.fell_at is None:  # a fall may end the walk before a fault begins
        check_times(config.name, config.faults, twin.duration_s)
    else:
        metadata["fell_at_s"] = f"{twin.fell_at:g}"
    if plan.planned:
        metadata |= fault_metadata(plan.planned)
    with RecordingWriter(path, plan.rig, metadata) as writer:
        # blocks and samples in the order in which they reach the recorder, each with its time of arrival
        for arrival in plan.arrivals(_with_progress(twin, progress)):
            writer.write(arrival.item, arrival.log_ns)


def nominal_sensors(config: TwinConfig, seed: int) -> tuple[Rig, dict[str, str]]:
    """The nominal rig of a walk, and the geometry of its exoskeleton as metadata, before the walk is planned.

    Raises:
        StrideTwinError: The simulator is not installed.
    """
    twin_class()  # says how to install the simulator
    from stridetwin.sim.sensors.standard_rig import sensor_rig
    from stridetwin.sim.wearer.body import fit_wearer

    rig = sensor_rig(config).nominal(seed)
    has_links = config.exo is not None and config.exo.user_exo is None
    return rig, exo_geometry.geometry_metadata(fit_wearer(config.person, has_links), rig, seed)


def _walk_metadata(twin: Twin, rig: Rig) -> dict[str, str]:
    """What a recording says of the walk beside its samples: scenario, person, terrain and geometry of the exoskeleton.

    Args:
        twin: The twin before or after its walk.
        rig: Calibration as the recording has it, with the faults of the scenario.
    """
    config = twin.config
    return {
        "scenario": config.name,
        "seed": str(twin.seed),
        "physics": config.physics,
        "person_height_m": f"{config.person.height_m:g}",
        "person_mass_kg": f"{config.person.mass_kg:g}",
        "shoe_length_m": f"{anthropometry(config.person).shoe_length_m:g}",
        **terrain_metadata(twin.terrain.layout),
        **exo_geometry.geometry_metadata(twin.size, rig, twin.seed, config.faults),
    }


def _with_progress(twin: Twin, progress: Progress) -> Iterator[Block[Sample] | Sample]:
    """Blocks and samples of the twin in the order in which it gives them, with the progress of the walk (0-1)."""
    t_ns = 0  # latest stamp so far
    for blocks in twin.blocks():
        for item in blocks:
            # a block has an array of stamps, which may be empty; a sample has one
            last = item.t_ns if isinstance(item.t_ns, int) else item.t_ns[-1:].max(initial=0)
            t_ns = max(t_ns, int(last))
            yield item
        progress("walk", t_ns / 1e9 / twin.duration_s)
