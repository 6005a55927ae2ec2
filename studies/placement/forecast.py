"""Says how long a placement takes: its size before it starts, and the time left from its first walks."""

from __future__ import annotations

from stridetwin.batch.forecast import Forecast, warn
from stridetwin.studies.placement.free import grid_size
from stridetwin.studies.placement.problem_file import Problem

_MANY_RECORDED, _MANY_POSED = 500, 50_000  # walks that are announced beforehand: some seconds, some 15 ms each


def placement_forecast(problem: Problem, measured: int) -> Forecast:
    """The forecast of a placement, of which so many walks are measured; warns of a long one."""
    places = 1 + (grid_size(problem.knobs) if problem.search is None else problem.search.budget)
    walks = len(problem.bases) * len(problem.seeds)
    missing = max(places * walks - measured, 0)
    size = f"{places} places on {walks} walk{'s' if walks > 1 else ''}"
    is_posed = all(score.geometric for score in problem.scores)
    if missing > (_MANY_POSED if is_posed else _MANY_RECORDED):
        warn(f"{size}: {missing} walks to measure; a coarser step, fewer seeds or a search take less")
    return Forecast(size, missing, "--resume continues")
