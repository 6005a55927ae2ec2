"""What to give in place of a folder or file that is none of the known layouts, for an error."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

from stridetwin.streams.formats.imu_columns import NUMBERED, OPTION
from stridetwin.streams.formats.imu_text import has_table_suffix

MOST_LISTED, _MOST_SEARCHED = 8, 200
"""Most entries of a folder that an error lists, and most folders inside it that are searched."""
_RECORDING_SUFFIXES = (".bag", ".mcap", ".db3", ".vrs")
"""Endings of files that are a recording alone."""
_PACKED_SUFFIXES = (".zstd", ".zst", ".zip", ".gz", ".tgz", ".tar", ".7z", ".bz2", ".r3d")
"""Endings of packed files."""
_WITH_PARTS = ("euroc", "tum", "7scenes", "openloris", "strayscanner", "record3d")
"""Layouts of several folders, of which a user may give one."""
_PARENTS = 3
"""Folders above that are looked at."""
VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv")
"""Endings of files of videos, in lower case."""
VIDEO = "write its frames as images with their stamps, as EuRoC's or TUM's layout has them"
"""What to do with a video."""
_AS_SEVEN_SCENES = (
    "name the files as 7-Scenes does: frame-000000.color.png, frame-000000.depth.png, frame-000000.pose.txt, with "
    "camera-intrinsics.txt"
)
"""How to give the images of other layouts as frames with poses."""
_AS_TUM = "write rgb.txt and depth.txt with a stamp and the name of an image in each row (TUM's layout)"
"""How to give images whose stamps are elsewhere."""
_OTHER_LAYOUTS: tuple[tuple[tuple[str, ...], str], ...] = (
    (("oxts",), "it is a drive of KITTI's raw data, on a car: no sensor that a person wears; kitti2bag makes a bag"),
    ((r"image_\d", r"times\.txt"), f"it is a sequence of KITTI's odometry, without an IMU: {_AS_TUM}"),
    (("color", "depth", "pose"), f"it looks like an export of ScanNet: {_AS_SEVEN_SCENES}"),
    (
        (r".*\.sens",),
        f"a .sens file of ScanNet is not read: unpack it with ScanNet's SensReader, then {_AS_SEVEN_SCENES}",
    ),
    (("results", r"traj\.txt"), f"it looks like a scene of Replica: {_AS_SEVEN_SCENES}; --depth-scale 6553.5"),
    ((r"rgb|colou?r|images?", r"depth"), f"its images have no list of stamps: {_AS_TUM}"),
    ((rf".*(?:{'|'.join(map(re.escape, VIDEO_SUFFIXES))})",), f"a video alone is not read: {VIDEO}"),
)
"""Names of entries, in lower case, that other layouts have, and what to do about each layout."""


def describe_unknown(path: Path, find_layout: Callable[[Path], str | None]) -> str:
    """What a folder of no known layout has, and what to give in its place.

    Args:
        path: The folder.
        find_layout: The kind whose layout a folder has; None for another layout.
    """
    entries = sorted(path.iterdir())
    recordings = [entry for entry in entries if entry.is_file() and entry.suffix in _RECORDING_SUFFIXES]
    recordings += _find_inside(entries, find_layout)
    if recordings:
        shown = [*map(str, recordings[:MOST_LISTED]), *(["..."] if len(recordings) > MOST_LISTED else [])]
        return f"it has recordings inside; give one of them: {', '.join(shown)}"
    if packed := [entry.name for entry in entries if entry.suffix in _PACKED_SUFFIXES]:
        return f"{packed[0]} is packed: unpack it first"
    names = [f"{entry.name}/" if entry.is_dir() else entry.name for entry in entries]
    more = [f"and {len(names) - MOST_LISTED} more"] if len(names) > MOST_LISTED else []
    has = f"it has {', '.join([*names[:MOST_LISTED], *more])}" if names else "it is empty"
    advice = next((text for patterns, text in _OTHER_LAYOUTS if _has_all(entries, patterns)), "")
    if not advice and any(map(has_table_suffix, entries)):
        advice = f"if they are tables of IMUs without names of columns: {OPTION} {NUMBERED}"
    return f"{has}; {advice}" if advice else has


def describe_parent(path: Path, find_layout: Callable[[Path], str | None]) -> str | None:
    """The folder above, if a path is a part of one with a known layout, as a text; None if it is none."""
    for folder in list(path.absolute().parents)[:_PARENTS]:
        try:
            kind = find_layout(folder)
        except OSError:  # a folder that may not be listed
            return None
        if kind in _WITH_PARTS:
            return f"it is a part of {folder} ({kind}): give that folder"
    return None


def _find_inside(entries: Iterable[Path], find_layout: Callable[[Path], str | None]) -> list[Path]:
    """The folders with recordings among the entries of a folder, else those one level below."""
    folders = [entry for entry in entries if entry.is_dir()][:_MOST_SEARCHED]
    for _ in range(2):
        try:
            if inside := [folder for folder in folders if find_layout(folder) is not None]:
                return inside
            folders = [entry for folder in folders for entry in sorted(folder.iterdir()) if entry.is_dir()]
        except OSError:
            return []
        folders = folders[:_MOST_SEARCHED]
    return []


def _has_all(entries: Iterable[Path], patterns: Iterable[str]) -> bool:
    """Whether the name of an entry, in lower case, matches each of some patterns."""
    names = [entry.name.lower() for entry in entries]
    return all(any(re.fullmatch(pattern, name) for name in names) for pattern in patterns)
