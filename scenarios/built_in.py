"""The files that come with the project: scenarios, campaigns and placements, found without reading them."""

from __future__ import annotations

from importlib import resources
from pathlib import Path


def catalogue_of(package: str) -> dict[str, Path]:
    """The YAML files in the folder `catalogue` of a package, name to file, sorted by name."""
    return {p.stem: p for p in sorted((Path(str(resources.files(package))) / "catalogue").glob("*.yaml"))}


def catalogue() -> dict[str, Path]:
    """The built-in scenarios, name to file, sorted by name."""
    return catalogue_of("stridetwin.scenarios")


def campaigns() -> dict[str, Path]:
    """The built-in campaigns, name to file, sorted by name."""
    return catalogue_of("stridetwin.scenarios.campaign")


def problems() -> dict[str, Path]:
    """The built-in placements, name to file, sorted by name."""
    return catalogue_of("stridetwin.studies.placement")
