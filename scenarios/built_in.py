"""The files that come with the project: scenarios, campaigns and placements, found without reading them."""

from __future__ import annotations

from importlib import resources
from pathlib import Path


def catalogue_of(package: str, folder_name: str = "catalogue") -> dict[str, Path]:
    """The YAML files in a folder of a package, name to file, sorted by name.

    Args:
        package: Dotted name of the package.
        folder_name: The folder inside it.
    """
    folder = Path(str(resources.files(package))) / folder_name
    return {p.stem: p for p in sorted(folder.glob("*.yaml"))}


def catalogue() -> dict[str, Path]:
    """The built-in scenarios, name to file, sorted by name."""
    return catalogue_of("stridetwin.scenarios")


def campaigns() -> dict[str, Path]:
    """The built-in campaigns, name to file, sorted by name."""
    return catalogue_of("stridetwin.scenarios.campaign")


def experiments() -> dict[str, Path]:
    """The experiments of papers, name to file, sorted by name."""
    return catalogue_of("stridetwin.studies", "experiments")


def problems() -> dict[str, Path]:
    """The built-in placements, name to file, sorted by name."""
    return catalogue_of("stridetwin.studies.placement")
