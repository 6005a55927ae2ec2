"""The request that a placement's folder belongs to, so that places of two placements never mix."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stridetwin.batch.folder import REQUEST, differing_keys, read_request, write_request
from stridetwin.batch.run import ROWS
from stridetwin.streams.errors import StrideTwinError
from stridetwin.studies.placement.problem_file import Place, Problem, plain_of


def check_request(folder: Path, problem: Problem, resume: bool) -> None:
    """Checks that a folder is unused, or belongs to the same placement, which is to be continued.

    Args:
        folder: The output folder.
        problem: The placement.
        resume: Whether an earlier run is to be continued.

    Raises:
        StrideTwinError: It holds a placement that is not to be continued, another one, or results of another command.
    """
    previous = read_request(folder)
    if previous is not None and not (isinstance(previous, dict) and "placement" in previous):
        raise StrideTwinError(f"{folder}: holds results of another command: expected another folder")
    if not resume and any((folder / name).exists() for name in (ROWS, REQUEST)):
        raise StrideTwinError(f"{folder}: holds a placement: expected --resume to continue it, or another folder")
    if previous is not None and (keys := differing_keys(_request(problem), previous)):
        raise StrideTwinError(
            f"{folder}: holds another placement, {previous['placement']!r} (other {', '.join(keys)}): "
            "expected another folder"
        )


def keep_request(folder: Path, problem: Problem) -> None:
    """Binds a folder to a placement."""
    write_request(folder, _request(problem))


def _request(problem: Problem) -> dict[str, Any]:
    """What identifies a placement; another number of walks or a larger budget continues it."""
    return {
        "placement": problem.description,
        "scenarios": [plain_of(problem, base, Place()) for base in problem.bases],
        "free": [[k.name, k.low, k.high, k.step, list(k.values)] for k in problem.knobs],
        "surfaces": [[free.surface, dict(free.fixed)] for free in problem.free if free.surface is not None],
        "scores": [[score.name, score.weight] for score in problem.scores],
    }
