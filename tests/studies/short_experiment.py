"""An experiment of the catalogue on another, short walk."""

from pathlib import Path

import yaml

from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.experiment import Experiment, read_experiment


def shorten(name: str, folder: Path, walk: str, **changes) -> Experiment:
    """The experiment on a scenario with this text; `changes` replace keys of its file."""
    (folder / "short.yaml").write_text(walk, encoding="utf-8")
    path = folder / f"{name}.yaml"
    data = {"like": name, "scenarios": ["short.yaml"], **changes}
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return read_experiment(path)


def make_case(experiment: Experiment, folder: Path, seed: int = 1000, **options) -> ExperimentCase:
    """A case of it."""
    return ExperimentCase(seed=seed, folder=folder, setup=experiment.setup, **({"physics": "kinematic"} | options))
