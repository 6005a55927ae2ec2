"""One case of an experiment: its seed, options and files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class Case:
    """One case.

    Attributes:
        seed: Seed of everything random in it.
        folder: Folder for its files.
        physics: How the body moves, if a body walks.
        resume: Reuses files of an earlier run.
        keep: Keeps the recordings.
    """

    seed: int
    folder: Path
    physics: str = "dynamic"
    resume: bool = False
    keep: bool = False

    def file(self, rest: str) -> Path:
        """A file of this case; `rest` ends its name."""
        return self.folder / f"seed_{self.seed}{rest}"

    @property
    def recordings(self) -> list[Path]:
        """Its existing recordings."""
        return [*self.folder.glob(self.file(".mcap").name), *self.folder.glob(self.file("_*.mcap").name)]
