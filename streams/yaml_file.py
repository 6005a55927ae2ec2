"""The one reader of YAML files: safe, every key once, plain data alone, of a bounded size once aliases are written out.

Numbers such as 1e-3, which YAML 1.1 reads as text, are numbers; dates are text.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from stridetwin.streams.bounded import LARGEST_SETTING, read_text
from stridetwin.streams.errors import ConfigError, StrideTwinError

MOST_VALUES, DEEPEST = 20_000, 40
"""Most values of a file, with every alias written out, and most levels of lists and mappings inside each other."""
LARGEST_FILE_VALUES = 100_000
"""Values of a scenario, campaign or placement, which may list many."""
SafeLoader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the compiled one, where there is one
_EXPONENT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)[eE][-+]?[0-9]+$")
"""A number with an exponent, such as 1e-3, which YAML 1.1 reads as text."""
_TIMESTAMP = "tag:yaml.org,2002:timestamp"
"""YAML's tag of dates."""
_OPENCV_MARKS = re.compile(r"^%YAML[^\n]*|!!opencv-matrix", re.MULTILINE)
"""What OpenCV's writer adds to YAML: a directive and a tag."""
_TABS = re.compile(r"(?<=\S)[ \t]*\t[ \t]*")
"""Tabs after a word."""
_UNFIT = (ValueError, LookupError, AttributeError, TypeError, RecursionError)
"""Exceptions of PyYAML for malformed numbers, unsuitable tags, and recursive aliases."""


class _StrictLoader(SafeLoader):  # type: ignore[misc, valid-type]
    """Safe YAML with the numbers of YAML 1.2 and without dates."""


_StrictLoader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != _TIMESTAMP]
    for first, resolvers in SafeLoader.yaml_implicit_resolvers.items()
}
# tag, form and possible first characters of the numbers that YAML 1.1 lacks
_NUMBERS = ("tag:yaml.org,2002:float", _EXPONENT, list("-+.0123456789"))
_StrictLoader.add_implicit_resolver(*_NUMBERS)


class Dumper(yaml.SafeDumper):
    """Writes what `read_yaml` reads back: a text such as 1e3 is quoted, as it would be a number."""


class FastDumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """Writes what `read_yaml` reads back, in compiled code; it may break long lines at other places than `Dumper`."""


Dumper.add_implicit_resolver(*_NUMBERS)
FastDumper.add_implicit_resolver(*_NUMBERS)


def read_yaml(path: str | Path, *, most_values: int = MOST_VALUES) -> object:
    """The plain data of a YAML file; no object is shared.

    Raises:
        ConfigError: The file is too large, or contains other than plain data.
        StrideTwinError: The file cannot be read or is not such YAML; the message names the line.
    """
    return parse_yaml(read_text(Path(path), LARGEST_SETTING), str(path), most_values=most_values)


def parse_yaml(text: str, source: str, *, most_values: int = MOST_VALUES) -> object:
    """The plain data of a YAML text; no object is shared.

    Args:
        text: The text.
        source: Names it in errors.
        most_values: Most values, every alias written out.

    Raises:
        ConfigError: The text is too large, or contains other than plain data.
        StrideTwinError: It is not such YAML; the message names the line.
    """
    check_yaml(text, source, most_values=most_values)
    try:
        return _to_plain_data(yaml.load(text, _StrictLoader), source, "")
    except yaml.YAMLError as error:
        raise _yaml_error(source, error) from error
    except _UNFIT as error:
        raise StrideTwinError(f"{source}: not YAML: {' '.join(str(error).split())}") from error


def clear_opencv_marks(text: str) -> str:
    """The text of a YAML file without what OpenCV's writer adds to YAML, on the same lines.

    These are the directive `%YAML:1.0` of the first lines, the tag `!!opencv-matrix`, and tabs between words, as files
    for OpenVINS, VINS-Fusion and ORB-SLAM3 have them. JSON is indented by blanks instead of tabs.
    """
    text = _OPENCV_MARKS.sub("", text.removeprefix("\ufeff"))
    if "\t" not in text:
        return text
    return text.replace("\t", " ") if text.lstrip().startswith("{") else _TABS.sub(" ", text)


def read_entries(path: Path, *keys: str) -> dict[str, str]:
    """Texts at the top level of a YAML file, by key, read no further than to the last of them.

    It serves lists of the project's own files, as of scenarios: to read each file as a whole would take most of the
    time of such a list. The file is not checked.

    Raises:
        StrideTwinError: The file cannot be read, or lacks one of the keys.
    """
    entries: dict[str, str] = {}
    depth = 0  # number of collections around the next value; 1 at the top level of a mapping
    key = ""  # the top-level key whose value comes next; "" if a key comes next
    for event in yaml.parse(read_text(path, LARGEST_SETTING), Loader=SafeLoader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
            key = ""  # the collection was the value of a key
        elif isinstance(event, yaml.ScalarEvent) and depth == 1:
            if key in keys:
                entries[key] = event.value
                if len(entries) == len(keys):
                    return entries
            key = "" if key else event.value  # after a value comes a key, and after a key its value
    raise ConfigError(path, "", list(entries), f"the keys {', '.join(keys)}")


@dataclass
class _OpenCollection:
    """A list or mapping that is being scanned.

    Attributes:
        anchor: Name by which aliases refer to it; None without one.
        count_at_start: Number of values in the text up to its beginning, itself included, with aliases written out.
        keys: Keys so far; None for a list.
        key_next: Whether the next value inside is a key.
    """

    anchor: str | None
    count_at_start: int
    keys: set[str] | None
    key_next: bool = field(init=False)

    def __post_init__(self) -> None:
        """A mapping begins with a key; a list has none."""
        self.key_next = self.keys is not None


def check_yaml(text: str, source: str, *, most_values: int = MOST_VALUES, most_aliases: int | None = None) -> None:
    """Refuses YAML that grows when it is read, or repeats a key, before anything is made of it.

    Args:
        text: The text.
        source: Names it in errors.
        most_values: Most values, every alias written out.
        most_aliases: Most aliases; None: as many as values.

    Raises:
        StrideTwinError: Too long, too deep, too many values once every alias is written out, a key twice, or no YAML.
    """
    if len(text) > LARGEST_SETTING:
        raise ConfigError(source, "length in characters", len(text), f"up to {LARGEST_SETTING}")
    most_aliases = most_values if most_aliases is None else most_aliases
    sizes: dict[str | None, int] = {}  # number of values by anchor, aliases inside written out
    open_: list[_OpenCollection] = []  # the collections around the next value
    count = aliases = 0  # values with all aliases written out; aliases
    try:
        for event in yaml.parse(text, Loader=SafeLoader):
            if isinstance(event, yaml.CollectionEndEvent):
                closed = open_.pop()
                if closed.anchor is not None:
                    sizes[closed.anchor] = count - closed.count_at_start + 1  # what is inside, and itself
            elif isinstance(event, yaml.NodeEvent):
                _check_key(event, open_[-1] if open_ else None, source)
                count += 1
                if isinstance(event, yaml.AliasEvent):
                    aliases += 1
                    # an alias counts as what it stands for. One inside of what it stands for, whose size is not known
                    # yet, would have no end: it exceeds the limit at once
                    count += sizes.get(event.anchor, most_values + 1) - 1
                elif isinstance(event, yaml.CollectionStartEvent):
                    keys: set[str] | None = set() if isinstance(event, yaml.MappingStartEvent) else None
                    open_.append(_OpenCollection(event.anchor, count, keys))
                elif event.anchor is not None:
                    sizes[event.anchor] = 1
            if count > most_values or len(open_) > DEEPEST or aliases > most_aliases:
                valid = f"up to {most_values} values, {DEEPEST} levels, {most_aliases} aliases"
                raise ConfigError(source, _line_of(event), "...", valid)
    except yaml.YAMLError as error:
        raise _yaml_error(source, error) from error


def _check_key(event: yaml.NodeEvent, inside: _OpenCollection | None, source: str) -> None:
    """Refuses a key that is repeated or no scalar, and text with a NUL, which no file name can hold.

    Keys and values alternate in a mapping: `inside.key_next` says which one comes next, and is switched here.

    Args:
        event: The next value of the text, as PyYAML's parser gives it.
        inside: The collection around it; None at the top.
        source: Names the text in errors.

    Raises:
        StrideTwinError: The value is refused.
    """
    if isinstance(event, yaml.ScalarEvent) and "\0" in event.value:
        raise ConfigError(source, _line_of(event), event.value, "text without NUL")
    if inside is None or inside.keys is None:
        return
    if inside.key_next:
        if not isinstance(event, yaml.ScalarEvent):
            raise StrideTwinError(f"{source}: {_line_of(event)}: not YAML of plain data: a key must be text")
        if event.value in inside.keys:
            raise StrideTwinError(f"{source}: {_line_of(event)}: duplicate key {event.value!r}")
        inside.keys.add(event.value)
    inside.key_next = not inside.key_next


def _to_plain_data(node: object, source: str, path: str) -> object:
    """A copy of the data of a YAML text in which no object occurs twice; `check_yaml` has bounded its size.

    Args:
        node: What PyYAML has made of the text or of a value in it.
        source: Names the text in errors.
        path: Dotted path of the value in the text; "" for the whole.

    Raises:
        ConfigError: A key is no text, or a value is something else than text, number, true, false, null, list, mapping.
    """
    if isinstance(node, dict):
        for key in node:
            if not isinstance(key, str):
                raise ConfigError(source, path, key, "keys that are text")
        return {k: _to_plain_data(v, source, f"{path}.{k}" if path else k) for k, v in node.items()}
    if isinstance(node, list):
        return [_to_plain_data(v, source, f"{path}[{i}]") for i, v in enumerate(node)]
    if node is None or isinstance(node, (str, bool, int, float)):
        return node
    raise ConfigError(source, path, str(node), "text, numbers, true, false, lists and keys with values")


def _line_of(event: yaml.Event) -> str:
    """Where an event is in the text, for messages; lines count from 1."""
    return f"line {event.start_mark.line + 1}" if event.start_mark else ""


def _yaml_error(source: str, error: yaml.YAMLError) -> StrideTwinError:
    """The error to raise about text that is not YAML, with the line where PyYAML stopped, if it says so."""
    mark = getattr(error, "problem_mark", None)
    where = f" line {mark.line + 1}:" if mark else ""
    what = " ".join(str(getattr(error, "problem", error)).split())
    return StrideTwinError(f"{source}:{where} not YAML: {what}")
