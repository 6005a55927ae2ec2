"""Paths of keys into a scenario, such as `terrain[1].stairs.riser_mm`, and the assignment of values to them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from stridetwin.sim.config import TwinConfig
from stridetwin.sim.parts.sensor_config import KIND
from stridetwin.streams.errors import FieldLocation

_STEP = re.compile(r"([a-z][a-z0-9_]*)((?:\[\d{1,4}\])*)")
_FORM = "keys with dots between and numbers of items in brackets, such as terrain[1].stairs.riser_mm"


@dataclass(frozen=True, kw_only=True)
class FieldPath:
    """A field of a scenario: its text in the file, and the keys of mappings and indices of lists from the root."""

    text: str
    keys: tuple[str | int, ...]


def field_path(text: str, where: FieldLocation) -> FieldPath:
    """Parses a path.

    Raises:
        ConfigError: The text is not a path.
    """
    keys: list[str | int] = []
    for step in text.split("."):
        match = _STEP.fullmatch(step)
        if match is None:
            raise where.error(text, _FORM)
        keys += [match[1], *(int(number) for number in re.findall(r"\d+", match[2]))]
    return FieldPath(text=text, keys=tuple(keys))


def put(scenario: dict[str, Any], path: FieldPath, value: Any, where: FieldLocation) -> None:
    """Sets a value in a scenario and creates missing keys on the way.

    Below `sensors`, a list of groups and the short forms of a group become keys first.

    Raises:
        ConfigError: A node on the way has no such place.
    """
    node: Any = scenario
    for depth, key in enumerate(path.keys[:-1]):
        _check(node, path, depth, where)
        if isinstance(key, str):
            node.setdefault(key, {})
        if path.keys[0] == "sensors" and depth < 2:
            node[key] = _opened(node[key], of_group=depth == 1)
        node = node[key]
    _check(node, path, len(path.keys) - 1, where)
    node[path.keys[-1]] = value


def _check(node: Any, path: FieldPath, depth: int, where: FieldLocation) -> None:
    """Whether a node has a place for the key at this depth."""
    key, there = path.keys[depth], _text(path.keys[:depth])
    if not isinstance(node, list if isinstance(key, int) else dict):
        raise where.error(path.text, f"a field of the scenario, where {there} is {_short(node)}")
    if isinstance(key, int) and key >= len(node):
        raise where.error(path.text, f"{there}[0] to {there}[{len(node) - 1}]")


def _opened(node: Any, *, of_group: bool) -> Any:
    """`sensors` with groups as keys, and a group with options as keys, if they have a short form."""
    if of_group:
        return {"part": node} if isinstance(node, str) else {} if isinstance(node, bool) else node
    if isinstance(node, list):
        return {group: group in node for group in KIND if (group in node) != (group in TwinConfig.sensors)}
    return node


def _text(keys: tuple[str | int, ...]) -> str:
    return "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in keys).removeprefix(".") or "the scenario"


def _short(node: Any) -> str:
    text = repr(node)
    return text if len(text) < 60 else f"{text[:56]} ..."
