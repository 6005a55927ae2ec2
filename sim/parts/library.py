"""The library of parts by name, custom parts from files, and full scales by a rig's description of a part."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from stridetwin.sim.choices import part_files
from stridetwin.sim.parts.figure import make_ideal
from stridetwin.sim.parts.kinds import PART_CLASSES, ForceCellPart, ImuPart, Part
from stridetwin.streams.errors import ConfigError

IDEAL = "-ideal"  # suffix of the name of a noise-free part


@cache
def load_part(name: str) -> Part:
    """A part of the library by its name; with the suffix `-ideal`, its noise-free version.

    Raises:
        ConfigError: Unknown part; the message lists the known ones.
    """
    known, plain = part_files(), name.removesuffix(IDEAL)  # paths by name, and the name without suffix
    if plain not in known:
        raise ConfigError("parts", "name", name, f"{', '.join(known)}, each with or without {IDEAL}")
    named_part = read_part(known[plain])
    return named_part if name == plain else make_ideal(named_part)


def read_part(path: Path) -> Part:
    """A part from its file, named after it.

    Raises:
        ConfigError: Unknown or missing keys, an unknown kind, or an invalid value; the message names file, key, value
            and what is valid.
        StrideTwinError: The file cannot be read or is not YAML.
    """
    from stridetwin.sim.parts.part_file import read_part_file  # the models of all kinds take a while to build

    return read_part_file(path)


def kind_of(of: Part) -> str:
    """The kind of a part as its file names it, such as `imu` for an `ImuPart`."""
    return next(name for name, part_class in PART_CLASSES.items() if type(of) is part_class)


@cache
def full_scales(text: str) -> Mapping[str, float]:
    """Largest magnitude by field of the samples (rad/s, m/s², N); empty for an unknown part or one without range.

    Args:
        text: Description of the part in the rig: that in the library, or any text that contains its name.
    """
    match _find_described_part(text):
        case ImuPart() as imu:
            return {"angular_rate": imu.gyroscope.range, "specific_force": imu.accelerometer.range}
        case ForceCellPart() as cell:
            return {"force": cell.range}
    return {}


def _find_described_part(text: str) -> Part | None:
    """Part of the library with this description, otherwise the one with the longest name in the text; None for none."""
    plain = text.replace("-", " ")  # descriptions may write a name with spaces
    parts = [load_part(name) for name in part_files()]
    named = [p for p in parts if p.name.replace("-", " ") in plain]
    described = [p for p in parts if p.description == text]
    longest_named = max(named, key=lambda p: len(p.name), default=None)
    return next(iter(described), longest_named)
