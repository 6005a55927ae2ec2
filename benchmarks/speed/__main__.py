"""Speed and memory: `python -m benchmarks.speed NAME [options] [--json]`; `--help` lists names and options.

Each benchmark replays or makes a walk and prints the figures of each measurement. Its docstring, which
`python -m benchmarks.speed NAME --help` prints, says what is timed.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from typing import Any

from benchmarks.command import add_json, answer, show_summary
from benchmarks.speed import estimators, twin
from benchmarks.speed.campaign import campaign
from benchmarks.speed.terrain_map import terrain_map
from benchmarks.speed.timing import Summary

Option = dict[str, Any]
"""Arguments of `ArgumentParser.add_argument`."""


def _option(default: float | str, help_text: str, **more: Any) -> Option:
    return {"type": type(default), "default": default, "help": f"{help_text} ({default})", **more}


_MINUTES = _option(5.0, "length of the replayed walk")
_SEED = _option(1000, "seed of the walk")
_MOUNT = _option("head", "where the camera sits", choices=("head", "chest"))
BENCHMARKS: dict[str, tuple[Callable[..., Summary], dict[str, Option]]] = {
    "foot_ins": (estimators.foot_ins, {"minutes": _option(60.0, "length of the walk")}),
    "foot_to_foot": (estimators.foot_to_foot, {"minutes": _MINUTES, "seed": _SEED}),
    "contact_terrain": (estimators.contact_terrain, {"minutes": _MINUTES, "seed": _SEED}),
    "dvio": (
        estimators.dvio,
        {
            "walks": _option(3, "repetitions of the walk, at least 2"),
            "seed": _SEED,
            "scenario": _option("zhao_loop", "a closed loop"),
        },
    ),
    "terrain_map": (
        terrain_map,
        {
            "walks": _option(2, "repetitions of the walk, at least 2"),
            "seed": _option(900, "seed of the walk"),
            "scenario": _option("zhao_stair_20cm", "a walk over stairs or ramps"),
            "mount": _MOUNT,
            "minutes": _option(0.0, "also memory on a way of this length through a building"),
        },
    ),
    "twin": (twin.twin, {}),
    "render": (twin.render, {}),
    "recording": (twin.recording, {"seconds": _option(60, "simulated seconds of 5000 messages each")}),
    "campaign": (
        campaign,
        {
            "walks": _option(20, "number of walks, more than there are workers"),
            "workers": {"type": int, "nargs": "+", "default": [1, 2], "help": "numbers of workers (1 2)"},
        },
    ),
}
"""By name: the measurement, and its options."""


def _parser() -> ArgumentParser:
    parser = ArgumentParser(prog="python -m benchmarks.speed", description="Speed and memory.")
    names = parser.add_subparsers(dest="name", required=True, metavar="NAME")
    for name, (measure, options) in BENCHMARKS.items():
        doc = str(measure.__doc__)
        benchmark = names.add_parser(name, help=doc.splitlines()[0], description=doc)
        add_json(benchmark)
        for option, arguments in options.items():
            benchmark.add_argument(f"--{option}", **arguments)
    return parser


def _measure(arguments: Namespace) -> dict[str, Any]:
    measure, options = BENCHMARKS[arguments.name]
    summary = measure(**{option: getattr(arguments, option) for option in options})
    return {"experiment": f"{arguments.name}_speed", "summary": summary}


if __name__ == "__main__":
    sys.exit(answer(_parser(), _measure, show_summary(26, "14,.2f")))
