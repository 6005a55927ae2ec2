"""Mapping of a bag's streams to our topics, by type and topic name."""

from __future__ import annotations

import re
from collections.abc import Mapping

from stridetwin.streams.samples import Accelerometer, Depth, Image, Imu, Odometry, Sample

OURS = re.compile(r"/(head|chest|foot_[lr]|exo|truth)/.+")
_FOOT = re.compile(r"foot|shoe|ankle|heel|insole")
_LEFT, _RIGHT = re.compile(r"left|(?<![a-z])l(?![a-z])"), re.compile(r"right|(?<![a-z])r(?![a-z])")
_TRUE = re.compile(r"ground_?truth|(?<![a-z])gt(?![a-z])|vicon|mocap|optitrack|qualisys|truth")
_COLOUR = (re.compile(r"color|colour|rgb"), re.compile(r"cam_?0|left"), re.compile(r""))
_DEPTH = (re.compile(r"aligned|registered"), re.compile(r""))
_INFRARED = re.compile(r"infra|(?<![a-z])ir(?![a-z])")


def bag_names(kinds: Mapping[str, type[Sample]]) -> dict[str, str]:
    """Our topic for each of a bag's topics that has one.

    Args:
        kinds: Kind of samples by topic, in the order of the bag.

    Returns:
        Foot IMUs and cameras by "left" or "right" together with "foot", "shoe" or "ankle"; the first other IMU, colour
        camera and depth camera become those of the head; a pose named as truth becomes the head's. Topics that already
        have our names, or have no counterpart, are omitted and keep their names.
    """
    taken = {t for t in kinds if OURS.fullmatch(t)}
    names: dict[str, str] = {}

    def give(topic: str, ours: str) -> None:
        if ours not in taken:
            names[topic] = ours
            taken.add(ours)

    rest = [t for t in kinds if t not in taken]
    for topic in rest:
        if _FOOT.search(topic.lower()) and (side := _side(topic.lower())):
            sort = {Imu: "imu", Image: "camera"}.get(kinds[topic])
            if sort:
                give(topic, f"/foot_{side}/{sort}")
    others = [t for t in rest if t not in names and not _FOOT.search(t.lower())]
    for kind, ours, patterns in (
        (Imu, "/head/imu", (re.compile(r""),)),
        (Accelerometer, "/head/accelerometer", (re.compile(r""),)),
        (Image, "/head/color", _COLOUR),
        (Depth, "/head/depth", _DEPTH),
    ):
        there = [t for t in others if kinds[t] is kind and not _INFRARED.search(t.lower())]
        first = next((t for p in patterns for t in there if p.search(t.lower())), None)
        if first is not None:
            give(first, ours)
    true = next((t for t in others if kinds[t] is Odometry and _TRUE.search(t.lower())), None)
    if true is not None:
        give(true, "/truth/head/odometry")
    return names


def _side(topic: str) -> str:
    left, right = bool(_LEFT.search(topic)), bool(_RIGHT.search(topic))
    return "" if left == right else "l" if left else "r"
