"""`place`: where sensors pay."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

from stridetwin.scenarios.commands.outcome import Outcome, Progress


def place_command(arguments: Namespace, progress: Progress) -> Outcome:
    """`place`."""
    from stridetwin.scenarios.campaign.named_files import NamedFiles
    from stridetwin.scenarios.fields import Where
    from stridetwin.scenarios.placement.problem_file import find_problem, read_problem
    from stridetwin.scenarios.placement.run import Asked, run_placement

    path = find_problem(arguments.problem)
    problem = read_problem(path)
    if arguments.scenario is not None:
        where = Where(source="command line", path="--scenario")
        base = NamedFiles(Path.cwd() / "command line", "working").base(
            {"scenario": arguments.scenario, "short": True}, where
        )
        problem = replace(problem, bases=(base,))
    if arguments.budget is not None and problem.search is not None:
        problem = replace(problem, search=replace(problem.search, budget=arguments.budget))
    asked = Asked(
        folder=arguments.output or Path("runs") / path.stem,
        workers=arguments.workers,
        seed=arguments.seed,
        walks=arguments.walks,
        resume=arguments.resume,
    )
    result = run_placement(problem, asked, progress)
    return Outcome(
        data=result, lines=[*_lines(result), f"page  {(asked.folder / 'placement.html').absolute().as_uri()}"]
    )


def _lines(result: dict[str, Any]) -> list[str]:
    """The table, and what of it is more than chance."""
    from stridetwin.scenarios.placement.page import said, said_value

    scores = [score["name"] for score in result["scores"]]
    rows = [["place", *result["free"], *scores]]
    rows += [[str(row["rank"]), *(said_value(row["values"], name) for name in result["free"]),
              *(said(row["scores"].get(name)) for name in scores)] for row in result["table"]]  # fmt: skip
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ["  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths)) for row in rows]
    lines += [f"{row['rank']} failed: {row['failed']}" for row in result["table"] if "failed" in row]
    lines += ["", *result["words"], "", f"{result['tried']} places on {len(result['walks'])} walks"]
    return [*lines, *([f"{result['failed']} of them failed somewhere"] if result["failed"] else [])]
