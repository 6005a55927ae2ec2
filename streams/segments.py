"""The part of the body that the name of a sensor tells, as makers of sensors and authors of data sets spell it."""

from __future__ import annotations

import re

_SIDE = r"(?:left|right|[lr])"
"""A side in a name."""
_FOOT_WORDS = r"(?:foot|feet|shoe|boots?|insole|ankle|heel|toes?|midfoot|forefoot|hindfoot)"
"""Parts of a foot, and what it wears."""
_FOOT = re.compile(
    rf"(?<![a-z])[lr]f(?![a-z])|foot|shoe|fu(?:ss|ß)|ankle|heel|insole|"
    rf"(?<![a-z]){_SIDE}?(?:boots?|toes?){_SIDE}?(?![a-z])"
)
"""Names of a foot, as `lf`, `left_shoe`, `rfuss`, `toes_r` and `bootl`, in lower case."""
_LEFT = re.compile(
    rf"left|links|(?<![a-z])l[ft](?![a-z])|(?<![a-z])l(?:(?![a-z])|(?={_FOOT_WORDS}))|{_FOOT_WORDS}l(?![a-z])"
)
"""Names of the left side, as `left_foot`, `links`, `lf`, `l_ankle`, `lfoot` and `footl`, in lower case."""
_RIGHT = re.compile(
    rf"right|rechts|(?<![a-z])r[ft](?![a-z])|(?<![a-z])r(?:(?![a-z])|(?={_FOOT_WORDS}))|{_FOOT_WORDS}r(?![a-z])"
)
"""Names of the right side, likewise."""
_CHEST = re.compile(r"(?<![a-z])(?:chest|sternum|torso|thorax|trunk|upper_?body)(?![a-z])")
"""Names of the chest, in lower case."""
_HEAD = re.compile(r"(?<![a-z])(?:fore)?head(?![a-z])|helmet|glasses|goggles|headset|(?<![a-z])(?:hmd|ears?)(?![a-z])")
"""Names of the head and of what it wears, in lower case."""
_OTHER = re.compile(
    rf"(?<![a-z]){_SIDE}?_?(?:upper|lower|fore)?_?(?P<name>pelvis|pelvic|hips?|waist|belt|sacrum|sacral|lumbar|lumber"
    r"|lowerback|back|spine|neck|thighs?|femur|legs?|knees?|shanks?|shins?|tibia|cal(?:f|ves)|wrists?|hands?|arms?"
    rf"|elbows?|shoulders?|scapula|humerus|abdomen|belly|pocket|trousers?){_SIDE}?(?![a-z])"
    r"|(?<![a-z0-9])(?P<vertebra>l[345]|t8|t12)(?![a-z0-9])"
)
"""Parts of the body that carry none of our sensors; whole words, as `hip` is a part of `ship`."""


def side_of(name: str) -> str:
    """Side that a name in lower case contains, `l` or `r`; "" for none or both."""
    left, right = bool(_LEFT.search(name)), bool(_RIGHT.search(name))
    return "" if left == right else "l" if left else "r"


def segment_of(name: str) -> str:
    """Part of the body that the name of a sensor or topic tells.

    Args:
        name: Name in any case and spelling, such as `/xsens/lfoot/imu` or `LeftFoot`.

    Returns:
        `foot_l`, `foot_r`, `chest` or `head`, where our recordings have sensors; the word in the name for any other
        part, such as `pelvis` or `thigh`, with a side as `thigh_l`; `foot` for a foot without a side; "" if the name
        tells no part.
    """
    lower = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()  # LeftFoot becomes left_foot
    side = side_of(lower)
    if _FOOT.search(lower):
        return f"foot_{side}" if side else "foot"
    if (other := _OTHER.search(lower)) is not None:
        if other["vertebra"]:
            return other["vertebra"]
        return f"{other['name']}_{side}" if side else other["name"]
    if _CHEST.search(lower):
        return "chest"
    return "head" if _HEAD.search(lower) else ""
