"""The scenario file of one walk, beside the recordings: `generate` reproduces the walk from it."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from stridetwin.scenarios.campaign.named_files import FILES
from stridetwin.scenarios.scenario_file import Scenario, read_scenario
from stridetwin.streams.files import whole_file
from stridetwin.streams.yaml_file import Dumper

FOLDER = "scenarios"


def scenario_text(scenario: dict[str, Any]) -> str:
    """A scenario's plain data as YAML."""
    return yaml.dump(scenario, Dumper=Dumper, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)


def lay_files(folder: Path, own: Mapping[str, Path]) -> None:
    """Copies the user's files to the paths that the walks' scenarios name."""
    for name, source in own.items():
        place = folder / FILES / name
        place.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(place) as file:
            shutil.copyfile(source, file)


def tried(folder: Path, scenario: dict[str, Any]) -> Scenario:
    """Parses and validates a scenario.

    Args:
        folder: Contains `FOLDER` and the user's files; a file is written there.
        scenario: Plain data.

    Raises:
        StrideTwinError: It is invalid.
    """
    path = folder / FOLDER / "tried.yaml"
    path.write_text(scenario_text(scenario), encoding="utf-8")
    return read_scenario(path)
