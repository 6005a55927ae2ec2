"""One case of an experiment: its seed, options and files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Case:
    """One case.

    Attributes:
        seed: Seed of everything random in it.
        folder: Folder for its files.
        physics: How the body moves, if a body walks.
        resume: Reuses files of an earlier run.
        keep: Keeps the recordings.
        estimators: Installed estimators that are run besides those of the study.
    """

    seed: int
    folder: Path
    physics: str = "dynamic"
    resume: bool = False
    keep: bool = False
    estimators: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of its files."""
        return f"seed_{self.seed}"

    def file(self, ending: str) -> Path:
        """A file of this case; its name ends with `ending`."""
        return self.folder / f"{self.name}{ending}"

    @property
    def recordings(self) -> list[Path]:
        """Its existing recordings."""
        return [*self.folder.glob(self.file(".mcap").name), *self.folder.glob(self.file("_*.mcap").name)]

    def row(self, **figures: Any) -> dict[str, Any]:
        """Its row: `seed`, `physics`, and the figures."""
        return {"seed": self.seed, "physics": self.physics, **figures}
