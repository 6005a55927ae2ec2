"""Plans of walks, kept on disk: a walk that was planned once begins at once the next time, in any process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from joblib import Memory
from platformdirs import user_cache_path

from stridetwin.batch.versions import digest
from stridetwin.sim.config import Exo, TwinConfig
from stridetwin.sim.dynamics.plan import Plan, plan_control
from stridetwin.sim.exo_description import OwnExo
from stridetwin.sim.gait.reference import Reference, plan_reference
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.streams.notices import note

PlanT = TypeVar("PlanT")
Arguments = tuple[object, ...]
"""Positional arguments of a planner."""
MAX_BYTES = 1 << 30
"""Plans beyond this size are deleted, the longest unused first."""


def cache_plans(folder: Path | None = None) -> tuple[Callable[..., Reference], Callable[..., Plan]]:
    """Functions that plan motion and control of a walk, but look the plan up on disk first.

    They take the arguments of the twin's own planners. A plan is found if every argument (model, configuration, state
    of the random numbers) and the version of the code behind a walk are equal; files of the same content may lie
    anywhere. Otherwise it is made, with a note on stderr.

    Args:
        folder: Where the plans are kept; None for the user's cache.

    Returns:
        Functions that take the place of `plan_reference` and of `plan_control`.
    """
    memory = Memory(folder or user_cache_path("stridetwin") / "plans", verbose=0)
    memory.reduce_size(bytes_limit=MAX_BYTES)
    version = digest(Twin.__module__, estimators=False)
    return (
        _cache_function(memory, version, plan_reference, "the motion"),
        _cache_function(memory, version, plan_control, "the control of the simulation"),
    )


def _cache_function(memory: Memory, version: str, function: Callable[..., PlanT], what: str) -> Callable[..., PlanT]:
    """A function with a cache on disk, whose key are the arguments and the version of the code.

    Args:
        memory: The cache.
        version: Version of the code behind the result.
        function: The function.
        what: What it plans, for the note.
    """

    def plan(key: Arguments, version: str, arguments: Arguments) -> PlanT:
        """Plans with the arguments; `key` and `version` only identify the result in the cache."""
        note(f"planning {what}; kept in {memory.location} for the next time")
        return function(*arguments)

    plan.__qualname__ = function.__name__  # joblib names the folder of the results after it
    # results are found by `key` and `version`; `arguments`, with the paths in them, are not compared
    cached_plan: Callable[[Arguments, str, Arguments], PlanT] = memory.cache(plan, ignore=["arguments"])
    return lambda *arguments: cached_plan(tuple(map(_without_paths, arguments)), version, arguments)


def _without_paths(argument: Any) -> Any:
    """An argument of a planner without the paths of the user's files, of which only the content matters."""
    match argument:
        case OwnExo():
            return replace(argument, source="", rig="")
        case Exo():
            return replace(argument, user_exo=_without_paths(argument.user_exo))
        case Wearer():
            return replace(argument, exo=_without_paths(argument.exo))
        case TwinConfig():
            return replace(argument, exo=_without_paths(argument.exo))
        case Reference():
            return replace(argument, size=_without_paths(argument.size))
        case _:
            return argument
