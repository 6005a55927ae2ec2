"""The command line of every benchmark: measure, then print one JSON object or a summary."""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from typing import Any

from stridetwin.streams.errors import StrideTwinError


def command(doc: str | None) -> ArgumentParser:
    """A parser with `--json`, described by the first line of a module's docstring."""
    parser = ArgumentParser(description=(doc or "").splitlines()[0])
    add_json(parser)
    return parser


def add_json(parser: ArgumentParser) -> None:
    """Adds `--json`, which `answer` reads."""
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def answer(
    parser: ArgumentParser, measure: Callable[[Namespace], dict[str, Any]], show: Callable[[dict[str, Any]], None]
) -> int:
    """Measures with the arguments of the command line, and prints the result.

    Args:
        parser: Of `command`, with the benchmark's own arguments.
        measure: From the arguments to all figures, in the form of an experiment's JSON.
        show: Prints them as text.

    Returns:
        Exit code: 0, or 2 with the message on stderr where the measurement raises a StrideTwinError.
    """
    arguments = parser.parse_args()
    try:
        result = measure(arguments)
    except StrideTwinError as error:
        print(error, file=sys.stderr)
        return 2
    if arguments.json:
        print(json.dumps(result))
    else:
        show(result)
    return 0


def show_summary(width: int, figure: str) -> Callable[[dict[str, Any]], None]:
    """Prints the figures of each entry of `summary`, names padded to `width`, values in the format `figure`."""

    def show(result: dict[str, Any]) -> None:
        for name, figures in result["summary"].items():
            print(name)
            for key, value in figures.items():
                print(f"  {key:{width}s} {value:{figure}}")

    return show
