"""The command line `stridetwin`: prints one line per result, or one JSON object."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, fields
from importlib.metadata import version
from inspect import Parameter, Signature, get_annotations
from pkgutil import resolve_name
from typing import Annotated, Any, get_type_hints

import typer

from stridetwin.cli.commands import COMMANDS, Command
from stridetwin.cli.console import Console, show
from stridetwin.cli.options import Options, Outcome, Progress, check_outputs
from stridetwin.streams.errors import StrideTwinError, missing_library_error, to_line, was_interrupted
from stridetwin.streams.files import final_name

_PIPE_CLOSED = 128 + 13  # as a shell reports SIGPIPE
_NAME = "stridetwin"
_HELP = "A person in an exoskeleton walks; every sensor is recorded, every estimator scored."
_EXIT_CODES = "Exit codes: 0 done, 1 worse than the baseline or invalid, 2 usage error."


@dataclass(frozen=True)
class Call:
    """A parsed command line: the name of the command and its options."""

    command: str
    options: Options

    def run(self, progress: Progress) -> Outcome:
        """Runs the command.

        Raises:
            StrideTwinError: The command failed.
        """
        run: Callable[[Options, Progress], Outcome] = resolve_name(f"stridetwin.cli.{COMMANDS[self.command].function}")
        return run(self.options, progress)


def parse(argv: Sequence[str] | None = None) -> Call:
    """Parses a command line, by default that of this process.

    Raises:
        SystemExit: With code 0 after help or the version; with code 2 and one line on stderr after a usage error.
    """
    try:
        call = typer.main.get_command(_app())(argv, _NAME, standalone_mode=False)
    except typer.TyperException as error:
        context = getattr(error, "ctx", None)
        place = context.command_path if context else _NAME
        message = error.format_message().replace("Value error, ", "").rstrip(".")  # of Pydantic
        _say(f"{message} (see {place} --help)")
        raise SystemExit(2) from error
    if isinstance(call, Call):
        return call
    raise SystemExit(call)  # help or version have been printed: Typer gives the exit code


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a command; returns the exit code."""
    return _run(parse(argv), Console())


def _run(call: Call, console: Console) -> int:
    """Runs a parsed command, and prints its outcome on stdout, or one line per error on stderr.

    Args:
        call: The command with its options.
        console: Shows the progress.

    Returns:
        The exit code: that of the outcome, 2 after an error, 130 after Ctrl-C, and 141 if the reader of stdout has
        gone.
    """
    try:
        check_outputs(call.command, call.options)
        outcome = call.run(console)
    except StrideTwinError as error:
        return _print_error(console, str(error))
    except ModuleNotFoundError as error:
        missing = missing_library_error(error, f"{call.command} needs it")
        if missing is None:
            raise
        return _print_error(console, str(missing))
    except OSError as error:
        named = f"{final_name(str(error.filename))}: {error.strerror}" if error.filename else str(error)
        return _print_error(console, to_line(named))
    except (KeyboardInterrupt, SystemError) as error:
        if not was_interrupted(error):
            raise
        # a KeyboardInterrupt may say what is kept for a later `--resume`
        kept = str(error) if isinstance(error, KeyboardInterrupt) else ""
        return _print_error(console, f"stopped; {kept}" if kept else "stopped") + 128
    console.close()
    try:
        if call.options.json:
            print(json.dumps(outcome.data, indent=2, sort_keys=True, allow_nan=False), flush=True)
        else:
            show(outcome.lines)
    except BrokenPipeError:  # the reader, such as `head`, has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # otherwise the interpreter's own flush fails
        return _PIPE_CLOSED
    return outcome.code


def _app() -> typer.Typer:
    """Builds the Typer application: the option `--version`, and one command for each of `COMMANDS`."""
    app = typer.Typer(name=_NAME, help=_HELP, epilog=_EXIT_CODES)
    app.callback(help=_HELP)(_all_commands)
    for name, command in COMMANDS.items():
        app.command(name, help=command.options.__doc__)(_make_callback(name, command))
    return app


def _show_version(asked: bool) -> None:
    """Prints the version and ends, if `--version` is given."""
    if asked:
        print(f"{_NAME} {version(_NAME)}")
        raise typer.Exit


def _all_commands(
    version: Annotated[
        bool, typer.Option("--version", metavar="", help="Print the version.", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    """Options beside the commands."""


def _make_callback(name: str, command: Command) -> Callable[..., Call]:
    """Makes the function from which Typer builds the parser of a command.

    Its signature has one parameter per field of the command's options, and it returns the parsed `Call`.
    """

    def call(**given: Any) -> Call:
        """The call with the values of the command line, which Typer gives by the fields' names."""
        return Call(name, command.options(**given))

    setattr(call, "__signature__", Signature(_parameters(command.options)))  # noqa: B010 (no attribute of functions)
    return call


def _parameters(options: type[Options]) -> list[Parameter]:
    """One parameter per field: a command's own before the shared ones, as the order of arguments matters."""
    hints = get_type_hints(options, include_extras=True)
    # names of the fields, those of the class itself before those of its bases
    field_order = [name for base in options.__mro__ for name in get_annotations(base)]
    parameters = []
    for option in sorted(fields(options), key=lambda f: field_order.index(f.name)):
        default = Parameter.empty if option.default is MISSING else option.default
        if option.default_factory is not MISSING:
            default = option.default_factory()
        parameters.append(
            Parameter(option.name, Parameter.KEYWORD_ONLY, annotation=hints[option.name], default=default)
        )
    return parameters


def _print_error(console: Console, message: str) -> int:
    """Prints each line of an error on stderr after the progress is cleared; returns the exit code 2."""
    console.close()
    for line in message.splitlines():
        _say(" ".join(line.split()))
    return 2


def _say(message: str) -> None:
    """Prints an error on stderr with the name of the program."""
    print(f"{_NAME}: error: {message}", file=sys.stderr)
