"""What the command line of every benchmark does: measure, then print one JSON object or a summary to read."""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from typing import Any

from stridetwin.streams.errors import StrideTwinError


def command(doc: str | None) -> ArgumentParser:
    """A parser that is described by the first line of a module's docstring and takes `--json`."""
    parser = ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def answer(
    parser: ArgumentParser, measure: Callable[[Namespace], dict[str, Any]], show: Callable[[dict[str, Any]], None]
) -> int:
    """Measures as the command line says, and prints what is found.

    Args:
        parser: Of `command`, with the benchmark's own arguments.
        measure: From the arguments, all figures in the form of an experiment's JSON.
        show: Prints them for a reader.

    Returns:
        Exit code: 0, or 2 with the message on stderr where the measuring raises a StrideTwinError.
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
    """Prints the figures of each entry of `summary`, names padded to `width`, values formatted as `figure` says."""

    def show(result: dict[str, Any]) -> None:
        for name, figures in result["summary"].items():
            print(name)
            for key, value in figures.items():
                print(f"  {key:{width}s} {value:{figure}}")

    return show
