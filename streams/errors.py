"""The errors of the project: one root class, and messages that name the invalid value and what is valid."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

_LONGEST_SHOWN = 400
"""Most characters of an invalid value in a message."""
_MOST_LINES = 30
"""Most errors of one file in a message."""
_MARKS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")
"""Characters that break a line, that a terminal obeys, or that cannot be printed; tabs and line feeds stay."""
_LONGEST_LINE, _KEPT_END = 3000, 800
"""Most characters of a line of a message, and how many of its end are kept where it is longer: what is expected."""


def to_lines(text: str) -> str:
    """A message that may contain text of a file, as lines of a usual length that can be printed.

    Characters that a terminal obeys or cannot print become escapes of their numbers, and the middle of long lines is
    left out. Line feeds stay, as a message may have a line for each error.
    """
    readable = _MARKS.sub(lambda mark: ascii(mark.group())[1:-1], text)
    return "\n".join(map(_shorten_line, readable.split("\n"))) if len(readable) > _LONGEST_LINE else readable


def to_line(text: str) -> str:
    """A message as `to_lines` gives it, on one line: line feeds become escapes, too."""
    return to_lines(text.replace("\n", "\\n"))


def _shorten_line(line: str) -> str:
    """A line without its middle, if it is longer than `_LONGEST_LINE`."""
    if len(line) <= _LONGEST_LINE:
        return line
    return f"{line[: _LONGEST_LINE - _KEPT_END]} ... {line[-_KEPT_END:]}"


class StrideTwinError(Exception):
    """Root of every error that a user can cause; the command line prints it as one line and exits with 2."""

    def __init__(self, *args: object) -> None:
        """Takes the message, parts of which may come from a file or be its name; line feeds in it become escapes."""
        super().__init__(*(to_line(arg) if isinstance(arg, str) else arg for arg in args))


@contextmanager
def explain_import_error(need: str, extra: str) -> Iterator[None]:
    """Context manager: a failed import of an optional library inside it becomes one line that says how to install it.

    Args:
        need: What needs it, such as `scenes need the simulator`.
        extra: Extra of the project that brings it.

    Raises:
        StrideTwinError: The library is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] == "stridetwin":
            raise  # a module of the project itself: a defect, not a missing library
        raise StrideTwinError(f"{error.name} is not installed; {need}: {install_hint(extra)}") from error


def install_hint(extra: str) -> str:
    """The command that installs an extra of the project, which is on no package index."""
    return f"pip install '.[{extra}]' in the checkout, or pip install 'FILE.whl[{extra}]'"


def was_interrupted(error: BaseException) -> bool:
    """Whether an exception, or one that caused it, is a Ctrl-C: compiled functions report it as a SystemError."""
    cause: BaseException | None = error
    # back along the chain of causes, to a Ctrl-C or to the first exception
    while cause is not None and not isinstance(cause, KeyboardInterrupt):
        cause = cause.__cause__ or cause.__context__
    return cause is not None


def read_error(path: Path, error: OSError) -> StrideTwinError:
    """The error to raise about a file that cannot be opened or read, with the reason of the operating system."""
    return StrideTwinError(f"{path}: cannot be read: {error.strerror or error}")


EXTRA_OF = {
    "mujoco": "twin",
    "glfw": "twin",
    "trimesh": "twin",
    "jinja2": "report",
    "markupsafe": "report",
    "plotly": "report",
    "dm_control": "closed-loop",
    "dm_env": "closed-loop",
    "joblib": "closed-loop",
    "platformdirs": "closed-loop",
    "cma": "placement",
    "rerun": "view",
    "rerun_sdk": "view",
    "zenoh": "live",
    "dask": "cluster",
    "distributed": "cluster",
    "pandas": "frames",
    "sklearn": "learn",
    "open3d": "open3d",
    "ezc3d": "mocap",
    "lzfse": "record3d",
    "projectaria_tools": "aria",
}
"""The extra that brings each optional library, by the library's import name."""


def missing_library_error(error: ModuleNotFoundError, need: str = "this needs it") -> StrideTwinError | None:
    """The one line to print in place of a failed import; None if no extra brings the library.

    Args:
        error: The failed import.
        need: What needs the library, such as `experiments need the simulator`.
    """
    extra = EXTRA_OF.get((error.name or "").partition(".")[0])  # by the first part of a name such as `mujoco.viewer`
    return None if extra is None else StrideTwinError(f"{error.name} is not installed; {need}: {install_hint(extra)}")


class Missing:
    """Type of `ConfigError.value` for a required key that a file lacks; the message then says `missing`."""


class ConfigError(StrideTwinError):
    """A value in a file or a call that is not allowed.

    Args:
        source: File (or object) that holds the value.
        field: Dotted path of the field inside it, or "" for the whole.
        value: The offending value.
        valid: Description of valid values.
    """

    def __init__(self, source: object, field: str, value: object, valid: str) -> None:
        """Builds the message `SOURCE: FIELD: invalid VALUE: expected VALID`."""
        self.source, self.field, self.value, self.valid = str(source), field, value, valid
        where = f"{source}: {field}" if field else str(source)
        super().__init__(f"{where}: {self.problem}")

    @property
    def problem(self) -> str:
        """What is wrong with the value, without its place."""
        state = "missing" if isinstance(self.value, Missing) else f"invalid {_shorten_repr(self.value)}"
        return f"{state}: expected {self.valid}"

    def __reduce__(self) -> tuple[type[ConfigError], tuple[str, str, object, str]]:
        """Pickles the constructor's arguments; by default an exception pickles its message alone."""
        return type(self), (self.source, self.field, self.value, self.valid)


def check_type(source: object, field: str, value: object, types: type | tuple[type, ...], valid: str) -> None:
    """Refuses an argument of another type, such as a path where an opened recording is expected.

    Args:
        source: Function or class that was called.
        field: Name of its parameter.
        value: The argument.
        types: The accepted types.
        valid: What to pass instead, and where it comes from.

    Raises:
        ConfigError: It is of another type, which the message names.
    """
    if not isinstance(value, types):
        raise ConfigError(source, field, type(value).__name__, valid)


@dataclass(frozen=True, kw_only=True)
class FieldLocation:
    """Position in a file, for errors that are found after reading: the file as the user named it, and the keys."""

    source: str
    path: str = ""

    def key(self, name: str) -> FieldLocation:
        """The location of the key `name` in the mapping at this location: `path.name`."""
        return FieldLocation(source=self.source, path=f"{self.path}.{name}" if self.path else name)

    def item(self, index: int) -> FieldLocation:
        """The location of item `index` of the list at this location: `path[index]`."""
        return FieldLocation(source=self.source, path=f"{self.path}[{index}]")

    def error(self, value: object, valid: str) -> ConfigError:
        """The error to raise about the invalid `value` at this location; `valid` describes valid values."""
        return ConfigError(self.source, self.path, value, valid)


class ConfigFileError(ConfigError):
    """Several invalid values of one file, one per line. As a ConfigError it is the first of them.

    Args:
        errors: The errors, in the order of the file.
    """

    def __init__(self, errors: Sequence[StrideTwinError]) -> None:
        """Takes the fields of the first ConfigError, and joins the messages of the first errors, one per line.

        The fields are absent if there is no ConfigError. The constructors of its bases are skipped, as they make a
        message of one line.
        """
        first = next((e for e in errors if isinstance(e, ConfigError)), None)
        if first is not None:
            self.source, self.field, self.value, self.valid = first.source, first.field, first.value, first.valid
        more = [f"... and {len(errors) - _MOST_LINES} more errors"] if len(errors) > _MOST_LINES else []
        self.errors = tuple(errors)
        Exception.__init__(self, "\n".join([*map(str, errors[:_MOST_LINES]), *more]))

    def __reduce__(self) -> tuple[type[ConfigFileError], tuple[tuple[StrideTwinError, ...]]]:  # type: ignore[override]
        """Pickles the list of errors, so that a worker process can raise all of them."""
        return type(self), (self.errors,)


def _shorten_repr(value: object) -> str:
    """The value as text for a message, cut off where it is long."""
    try:
        text = repr(value)
    except ValueError:  # an integer with more digits than Python prints
        return "an integer of thousands of digits"
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."


def check_numbers(source: object, values: Mapping[str, float], may_be_zero: Collection[str] = ()) -> None:
    """Raises ConfigError for the first value that is not a finite number > 0 (≥ 0 for names in `may_be_zero`)."""
    for name, value in values.items():
        zero_is_valid = name in may_be_zero
        is_large_enough = value > 0.0 or (zero_is_valid and value == 0.0)
        if not (math.isfinite(value) and is_large_enough):
            raise ConfigError(source, name, value, "a finite number ≥ 0" if zero_is_valid else "a finite number > 0")


class RecordingError(StrideTwinError):
    """A recording that cannot be read, or that would silently corrupt an estimate."""


def metadata_error(key: str, expected: str, error: Exception) -> RecordingError:
    """The error to raise about an invalid entry of a recording's metadata.

    Args:
        key: Name of the entry.
        expected: What is valid.
        error: The exception that reading the entry has raised; its text becomes a part of the message, on one line.
    """
    reason = " ".join(str(error).split())[:120]
    return RecordingError(f"invalid metadata {key}: expected {expected}: {reason}")
