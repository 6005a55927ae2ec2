"""One case of an experiment: its seed, walks, options and files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from stridetwin.batch.jobs import Row
from stridetwin.outputs.parameters import ParameterValues
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.faults.faults import Fault
from stridetwin.studies.design import Design, make_scenario


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What the cases of an experiment walk.

    Attributes:
        design: The walks of each seed.
        sensors: Groups of sensors that are simulated; empty for those of the scenarios.
        faults: Faults by label, each injected into the same walk.
    """

    design: Design
    sensors: tuple[str, ...] = ()
    faults: Mapping[str, tuple[Fault, ...]] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class CaseWalk:
    """One walk of a case, with its name in files and the configuration of the twin.

    Attributes:
        name: Its name in files.
        labels: Levels of the factors that differ between the walks of a case.
        config: The twin.
    """

    name: str
    labels: Mapping[str, str]
    config: TwinConfig


@dataclass(frozen=True, kw_only=True)
class ExperimentCase:
    """One case of an experiment: everything of one seed that becomes one row.

    Attributes:
        seed: Seed of everything random in it.
        folder: Folder for its files.
        setup: What it walks; None for an experiment that makes its own walks.
        physics: How the body moves, if a body walks.
        resume: Reuses files of an earlier run.
        keep: Keeps the recordings.
        estimators: Installed estimators that are run besides those of the study.
        parameters: Values in place of the estimators' own, see `outputs.parameters`.
    """

    seed: int
    folder: Path
    setup: Setup | None = None
    physics: str = "dynamic"
    resume: bool = False
    keep: bool = False
    estimators: tuple[str, ...] = ()
    parameters: ParameterValues = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the case in files, such as `seed_1000`."""
        return f"seed_{self.seed}"

    def file(self, ending: str) -> Path:
        """Path of a file of this case, `seed_NUMBER` followed by `ending`."""
        return self.folder / f"{self.name}{ending}"

    @property
    def recordings(self) -> list[Path]:
        """Existing recordings of the case."""
        # `seed_NUMBER.mcap`, and `seed_NUMBER_NAME.mcap` of the walks with a name
        return [*self.folder.glob(self.file(".mcap").name), *self.folder.glob(self.file("_*.mcap").name)]

    def walks(self) -> list[CaseWalk]:
        """Walks of the case, in the order of the experiment's combinations; only for a case with `setup`."""
        assert self.setup is not None
        design = self.setup.design
        walks = []
        for i, combination in enumerate(design.walks(self.seed)):
            scenario_config = make_scenario(design, combination, self.folder).config
            sensors = self.setup.sensors or scenario_config.sensors  # of the experiment, else of the scenario
            config = replace(scenario_config, sensors=sensors, physics=self.physics)
            # levels that take turns are the same for all walks of the case, see `labels`
            labels = {name: level for name, level in combination.labels.items() if name not in design.turns}
            # the number keeps walks of the same scenario apart; the first one goes without
            name = f"{i}_{config.name}" if i else config.name
            walks.append(CaseWalk(name=name, labels=labels, config=config))
        return walks

    @property
    def labels(self) -> dict[str, str | int]:
        """The levels whose turn it is with the seed, by factor; names that are whole numbers become numbers."""
        levels = self.setup.design.levels(self.seed) if self.setup else {}
        return {name: int(level.name) if level.name.isdigit() else level.name for name, level in levels.items()}

    def row(self, **figures: object) -> Row:
        """Row of the case: `seed`, `physics`, the levels whose turn it is, and the given figures."""
        return {"seed": self.seed, "physics": self.physics, **self.labels, **figures}
