"""Checks the output files of a command: none may be one of its inputs or be used twice."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from stridetwin.cli.options import Options
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.files import partial_path

_OPTIONS = {
    "output": "-o", "record": "--record", "junit": "--junit", "markdown": "--markdown", "history": "--history",
}  # fmt: skip
_FOLDERS = ("run", "generate", "export", "experiment", "place")
"""Commands whose `-o` may be a folder."""
_MAKE_FOLDERS = (("import", "output"), ("score", "history"))


def check_outputs(command: str, arguments: Options) -> None:
    """Rejects outputs that would overwrite an input or fail at the end of a long run.

    Raises:
        ConfigError: An output is also an input, is given twice, or cannot be a file.
    """
    given = dict(vars(arguments))
    if command == "history":
        given["file"] = given.pop("history")  # an input
    outputs = {name: given.pop(name) for name in _OPTIONS if isinstance(given.get(name), Path)}
    taken = list(_files(given.values()))
    for name, path in outputs.items():
        option = f"{command} {_OPTIONS[name]}"
        if any(_same(path, other) for other in taken):
            raise ConfigError(option, "", str(path), "a file that is neither read nor written for something else")
        if name != "output" or command not in _FOLDERS:
            partial_path(path)
            if not path.parent.is_dir() and (command, name) not in _MAKE_FOLDERS:
                raise ConfigError(option, "", str(path), f"a file in a folder that is there; there is no {path.parent}")
        taken.append(path)


def _files(values: Iterable[object]) -> Iterator[Path]:
    """All names in a value: paths, lists of them, file names, `NAME=FILE`."""
    for value in values:
        if isinstance(value, list):
            yield from _files(value)
        elif isinstance(value, Path):
            yield value
        elif isinstance(value, str):
            yield from (path for path in map(Path, {value, value.rpartition("=")[2]}) if _is_file(path))


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # not a valid file name
        return False


def _same(one: Path, other: Path) -> bool:
    return one.absolute() == other.absolute() or (one.exists() and other.exists() and one.samefile(other))
