"""One case of an experiment: what is asked for, and where its files lie."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class Case:
    """One case.

    Attributes:
        seed: Of everything random in it.
        folder: For its files.
        physics: How the body moves, where a body walks.
        resume: Files of an earlier run are used, not made again.
        keep: Recordings stay.
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
        """The recordings of it that there are."""
        return [*self.folder.glob(self.file(".mcap").name), *self.folder.glob(self.file("_*.mcap").name)]
