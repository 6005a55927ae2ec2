"""Sets of markers: which body of the wearer a marker is fixed to, and about where.

A place is in m in the frame of the body (x forward, y outward, z up) on a person of 1.741 m; it is only where the fit
begins, and its scatter says how far the fit may move it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stridetwin.streams.errors import ConfigError

_LANDMARK_SD_M = 0.025  # of a marker on a bone that can be felt
_SHOE_SD_M = 0.015  # on a shoe
_JOINT_SD_M = 0.012  # of a joint's centre that the laboratory has computed
_FREE_SD_M = 0.08  # of markers that are placed anywhere on a segment
_MIN_NAMED = 3  # markers of a set that a file needs at least


@dataclass(frozen=True, kw_only=True)
class MarkerPlace:
    """Where a marker is fixed.

    Attributes:
        body: Body of the wearer, with the side.
        place_m: About where, in the body's frame.
        sd_m: Scatter of that.
    """

    body: str
    place_m: tuple[float, float, float]
    sd_m: float


_Site = tuple[str, tuple[float, float, float], float]

# Sites without a side in the name of their body are central; y is outward for the others. Thigh -0.4222, shank -0.434.
_SITES: dict[str, _Site] = {
    "asis": ("pelvis", (0.06, 0.12, 0.085), _LANDMARK_SD_M),
    "psis": ("pelvis", (-0.115, 0.045, 0.11), _LANDMARK_SD_M),
    "iliac_crest": ("pelvis", (0.0, 0.14, 0.13), 0.04),
    "sacrum": ("pelvis", (-0.12, 0.0, 0.10), _LANDMARK_SD_M),
    "pelvis_free": ("pelvis", (-0.10, 0.0, 0.10), _FREE_SD_M),
    "c7": ("torso", (-0.065, 0.0, 0.43), _LANDMARK_SD_M),
    "t10": ("torso", (-0.11, 0.0, 0.20), 0.04),
    "clavicle": ("torso", (0.07, 0.0, 0.37), _LANDMARK_SD_M),
    "sternum": ("torso", (0.105, 0.0, 0.22), 0.04),
    "sternum_side": ("torso", (0.08, 0.03, 0.36), 0.04),
    "back": ("torso", (-0.11, 0.08, 0.32), _FREE_SD_M),
    "acromion": ("torso", (0.0, 0.185, 0.44), _LANDMARK_SD_M),
    "head_front": ("head", (0.09, 0.07, 0.14), 0.04),
    "head_back": ("head", (-0.08, 0.07, 0.14), 0.04),
    "head_top": ("head", (0.01, 0.0, 0.24), 0.04),
    "head_front_middle": ("head", (0.10, 0.0, 0.14), 0.04),
    "head_back_middle": ("head", (-0.09, 0.0, 0.14), 0.04),
    "upper_arm": ("upper_arm", (0.0, 0.05, -0.15), _FREE_SD_M),
    "elbow_lateral": ("upper_arm", (0.0, 0.04, -0.2817), _LANDMARK_SD_M),
    "elbow_medial": ("upper_arm", (0.0, -0.04, -0.2817), _LANDMARK_SD_M),
    "forearm": ("forearm", (0.0, 0.03, -0.12), _FREE_SD_M),
    "wrist_radius": ("forearm", (0.03, 0.0, -0.26), _LANDMARK_SD_M),
    "wrist_ulna": ("forearm", (-0.03, 0.0, -0.26), _LANDMARK_SD_M),
    "finger": ("forearm", (0.02, 0.0, -0.34), 0.04),
    "hip_centre": ("thigh", (0.0, 0.0, 0.0), _JOINT_SD_M),
    "thigh": ("thigh", (0.02, 0.08, -0.22), _FREE_SD_M),
    "knee_lateral": ("thigh", (0.0, 0.055, -0.4222), _LANDMARK_SD_M),
    "knee_medial": ("thigh", (0.0, -0.055, -0.4222), _LANDMARK_SD_M),
    "trochanter": ("thigh", (0.0, 0.09, -0.01), 0.04),
    "shank": ("shank", (0.02, 0.05, -0.2), _FREE_SD_M),
    "ankle_lateral": ("shank", (-0.005, 0.042, -0.434), _LANDMARK_SD_M),
    "ankle_medial": ("shank", (0.005, -0.040, -0.424), _LANDMARK_SD_M),
    "heel": ("foot", (-0.045, 0.0, 0.045), _SHOE_SD_M),
    "toe": ("foot", (0.145, 0.0, 0.065), 0.03),
    "metatarsal_5": ("foot", (0.125, 0.045, 0.035), _LANDMARK_SD_M),
    "metatarsal_1": ("foot", (0.145, -0.042, 0.040), _LANDMARK_SD_M),
    "toe_tip": ("toe", (0.06, 0.0, 0.015), 0.03),
    "foot_free": ("foot", (0.08, 0.0, 0.07), 0.05),
}
_CENTRAL = ("pelvis", "torso", "head")
_MIRRORED_CENTRAL = {"asis", "psis", "iliac_crest", "sternum_side", "back", "acromion", "head_front", "head_back"}

MARKED_BODIES = (
    *_CENTRAL,
    *(f"{body}_{side}" for body in ("upper_arm", "forearm", "thigh", "shank", "foot", "toe") for side in ("l", "r")),
)
"""Bodies to which markers are fixed."""

# Names without the side, in capitals and without points and dashes; `*` stands for any number.
MARKER_SETS: dict[str, dict[str, str]] = {
    "plug_in_gait": {
        "FHD": "head_front", "BHD": "head_back", "C7": "c7", "T10": "t10", "CLAV": "clavicle", "STRN": "sternum",
        "BAK": "back", "SHO": "acromion", "UPA": "upper_arm", "UA*": "upper_arm", "ELB": "elbow_lateral",
        "ELBM": "elbow_medial", "FRM": "forearm", "FRA": "forearm", "LA*": "forearm", "WRA": "wrist_radius",
        "WRB": "wrist_ulna", "FIN": "finger", "ASI": "asis", "PSI": "psis", "SACR": "sacrum", "THI": "thigh",
        "THI*": "thigh", "KNE": "knee_lateral", "KNM": "knee_medial", "TIB": "shank", "TIB*": "shank",
        "ANK": "ankle_lateral", "MED": "ankle_medial", "HEE": "heel", "TOE": "toe", "LATFOOT": "metatarsal_5",
        "MT5": "metatarsal_5", "MT1": "metatarsal_1", "PELVIS*": "pelvis_free",
    },
    "opencap": {
        "C7": "c7", "ASIS": "asis", "PSIS": "psis", "SHOULDER": "acromion", "STERNUM": "sternum_side",
        "ELBOWLAT": "elbow_lateral", "ELBOWMED": "elbow_medial", "ELBOW": "elbow_lateral", "MELBOW": "elbow_medial",
        "HUMERUS": "upper_arm", "FOREARM": "forearm", "WRISTRADIUS": "wrist_radius", "WRISTULNA": "wrist_ulna",
        "HJC": "hip_centre", "HJCREG": "hip_centre", "KNEE": "knee_lateral", "MKNEE": "knee_medial",
        "THIGH*": "thigh", "SH*": "shank", "SHANKANTSUP": "shank", "ANKLE": "ankle_lateral",
        "MANKLE": "ankle_medial", "CALC": "heel", "TOE": "toe", "5META": "metatarsal_5",
    },
    "helen_hayes": {
        "TOPHEAD": "head_top", "FRONTHEAD": "head_front_middle", "REARHEAD": "head_back_middle",
        "SHOULDER": "acromion", "OFFSET": "back", "ELBOW": "elbow_lateral", "ELBOWLAT": "elbow_lateral",
        "ELBOWMEDIAL": "elbow_medial", "WRIST": "wrist_radius", "WRISTMEDIAL": "wrist_ulna", "ASIS": "asis",
        "PSIS": "psis", "SACRAL": "sacrum", "VSACRAL": "sacrum", "VSACRUM": "sacrum", "THIGH": "thigh",
        "THIGHUPPER": "thigh", "THIGHFRONT": "thigh", "THIGHREAR": "thigh", "KNEE": "knee_lateral",
        "KNEELAT": "knee_lateral", "KNEEMEDIAL": "knee_medial", "KNEEMED": "knee_medial", "SHANK": "shank",
        "SHANKUPPER": "shank", "SHANKFRONT": "shank", "SHANKREAR": "shank", "ANKLE": "ankle_lateral",
        "ANKLELAT": "ankle_lateral", "ANKLEMEDIAL": "ankle_medial", "ANKLEMED": "ankle_medial", "HEEL": "heel",
        "TOE": "toe", "TOETIP": "toe_tip", "TOELAT": "metatarsal_5", "TOEMED": "metatarsal_1",
        "MIDFOOTSUP": "foot_free", "MIDFOOTLAT": "foot_free",
    },
    "camargo": {
        "ASIS": "asis", "PSIS": "psis", "THIGHUPPER": "thigh", "THIGHFRONT": "thigh", "THIGHREAR": "thigh",
        "KNEELAT": "knee_lateral", "SHANKUPPER": "shank", "SHANKFRONT": "shank", "SHANKREAR": "shank",
        "ANKLELAT": "ankle_lateral", "HEEL": "heel", "TOETIP": "toe_tip", "TOELAT": "metatarsal_5",
        "TOEMED": "metatarsal_1",
    },
}  # fmt: skip
"""Site of each marker by set; the side is the first letter, L or R, of the marker's name."""


def place_markers(
    source: str, names: Sequence[str], marker_set: str | Mapping[str, MarkerPlace] | None = None
) -> dict[str, MarkerPlace]:
    """Place of each marker that a set knows; other markers are left out.

    Args:
        source: File, for messages.
        names: Markers of the file.
        marker_set: Name of a set, or the user's own table; None for the set that knows most of the markers.

    Raises:
        ConfigError: No set knows the markers, or the user's table names markers that the file lacks.
    """
    if isinstance(marker_set, Mapping):
        missing = [name for name in marker_set if name not in names]
        if missing:
            raise ConfigError(source, "markers", missing[0], f"a marker of the file: {', '.join(names)}")
        return dict(marker_set)
    if marker_set is not None and marker_set not in MARKER_SETS:
        raise ConfigError(source, "markers", marker_set, f"{', '.join(MARKER_SETS)}, or a table of places")
    candidates = {s: _places_of_set(names, s) for s in ([marker_set] if marker_set else MARKER_SETS)}
    best = max(candidates, key=lambda s: len(candidates[s]))
    places = candidates[best]
    for side in ("l", "r"):
        on_foot = [n for n, p in places.items() if p.body in (f"foot_{side}", f"toe_{side}")]
        if len(on_foot) < 2 or len(places) < _MIN_NAMED:
            raise ConfigError(
                source,
                "markers",
                ", ".join(names[:8]),
                f"two markers on each foot, of a known set ({', '.join(MARKER_SETS)}) or of a table of places",
            )
    return places


def describe_site(site: str, side: str) -> MarkerPlace:
    """Place of a site by name, on one side (`l` or `r`) or centrally ("").

    Raises:
        KeyError: There is no such site.
    """
    body, (x, y, z), sd = _SITES[site]
    outward = {"l": 1.0, "r": -1.0, "": 0.0}[side]
    is_mirrored = body not in _CENTRAL or site in _MIRRORED_CENTRAL
    return MarkerPlace(
        body=body if body in _CENTRAL else f"{body}_{side}",
        place_m=(x, y * outward if is_mirrored else y, z),
        sd_m=sd,
    )


def _places_of_set(names: Sequence[str], marker_set: str) -> dict[str, MarkerPlace]:
    """Place of each marker that one set knows."""
    table = MARKER_SETS[marker_set]
    places = {}
    for name in names:
        bare = re.sub(r"[^A-Z0-9]", "", name.rsplit(":", 1)[-1].upper())
        for side, key in (("", bare), (bare[:1].lower(), bare[1:])):
            site = table.get(key) or table.get(re.sub(r"\d+$", "*", key))
            if site is None or (side and side not in "lr"):
                continue
            needs_side = _SITES[site][0] not in _CENTRAL or site in _MIRRORED_CENTRAL
            if needs_side == bool(side):
                places[name] = describe_site(site, side)
                break
    return places
