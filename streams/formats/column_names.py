"""What the name of a column says: the quantity, the axis, the sensor and the unit, as in `left_AccX (m/s^2)`."""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass

from stridetwin.streams.formats.imu_units import ACCEL, GYRO, TIME, unit_of

AXES = "xyz"
"""Axes of a sensor, as names of columns end."""


@dataclass(frozen=True, kw_only=True)
class ColumnName:
    """A column by its name.

    Attributes:
        name: Lower case, with `_` between its words, without the unit.
        unit: Unit as written; "" without one.
        quantity: `accel`, `gyro`, or "" for any other or an open one.
        axis: `x`, `y` or `z`; "" if the name has none.
        sensor: What else the name says, such as `left`.
        is_raw: Whether the name says that the numbers are raw, uncalibrated or filtered.
        is_by_unit: Whether the unit alone tells the quantity, as in other languages.
    """

    name: str
    unit: str
    quantity: str = ""
    axis: str = ""
    sensor: str = ""
    is_raw: bool = False
    is_by_unit: bool = False


_LAST_BRACKETS = re.compile(r"(.*?)\s*[(\[{<]([^()\[\]{}<>]*)[)\]}>]\s*")
"""A cell whose last brackets have none inside, as `Acc X (g)`: what stands before them, and their text."""
_OUTER_BRACKETS = re.compile(r"(.*?)\s*[(\[{<](.+)[)\]}>]\s*")
"""A cell with brackets inside of brackets, as `Acc X [m/(s^2)]`: what stands before them, and their text."""
_JOINT = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
"""Where a word begins in `AccX` or `elapsedRealtimeNanos`."""
_NUMBERED_AXIS = re.compile(r"(?<=[acgwyor_][xyz])(?=\d{1,2}$)|(?<=^[xyz])(?=\d{1,2}$)")
"""The number of a sensor behind an axis, as in `acc_x2` and `x2`."""
_NUMBERED_QUANTITY = re.compile(r"((?:^|_)(?:acc|accel|gyr|gyro))(?=\d$)")
"""The number of a sensor behind a quantity, as in `left_acc0`."""
_SIDE_LETTER = re.compile(r"^([lr])(?=[agw][xyz]$)")
"""The letter of a side before a short name, as in `lax`."""
_LONGEST = 120
"""Most characters of a name that are read."""
_UNIT_WORDS = 4
"""Most words of a unit at the end of a name, as the three of `ax_m/s/s`."""
_WORD_GAP = re.compile(r"[\s_,/:;|-]+")
"""What stands between the words of a name."""
_QUANTITY_WORDS = {
    ACCEL: r"accelerometers?|accelerations?|accel|accl|acce|acc|specific_force",
    GYRO: r"gyroscopes?|gyros?|gyr|angular_(?:velocity|velocities|rate|speed|vel)|ang_(?:vel|rate)|angvel|angrate"
    r"|rotation_?rates?|rot_?rate|turn_?rate|omega|alpha",
}
"""Words of each quantity, joined by `_`."""
_LETTERS = {ACCEL: "ac?", GYRO: "(?:gy?|w)"}
"""Letters that stand for each quantity."""
_LONG = {quantity: re.compile(rf"(?:^|_)(?:{text})(?=_|$|[xyz](?:_|$))") for quantity, text in _QUANTITY_WORDS.items()}
"""Names with a word of a quantity, as `left_acc_x` and `gyroscopez`, by quantity."""
_SHORT = {
    quantity: re.compile(rf"(?:^|_){letters}_?(?=[xyz](?:_|$)|rs_s_[xyz]$)") for quantity, letters in _LETTERS.items()
}
"""Names with a letter of a quantity, as `ax`, `w_x` and `w_RS_S_x`, by quantity."""
_G_FORCE = re.compile(r"(?:^|_)g_?f_?(?=[xyz]$)")
"""Physics Toolbox' name of the force in g."""
_AXIS = re.compile(r"(?:^|_)([xyz])(?:_?axis)?(?=_|$)|axis_?([xyz])(?=_|$)")
"""An axis in a name, as in `acc_x`, `x_axis` and `axis_x`."""
_OTHER_QUANTITY = re.compile(
    r"(?:^|_)(?:free|user|gravity|grav|mag\w*|quat\w*|euler|orient\w*|ori|pos\w*|bias\w*|std\w*|var\w*|cov\w*|delta\w*"
    r"|dv|dq|temp\w*|roll|pitch|yaw|bearing|rotation_vector|highg|high_g|norm|abs\w*|mag|sd|err\w*|jerk"
    r"|world|global|earth|velinc|oriinc|schwerkraft|erdbeschleunigung)(?:_|$)|free_?acc|^user|user_?acc|ang(?:ular)?_?acc"
)
"""What names of columns that are neither forces nor rates of a sensor contain, as `mag_x`, `roll` and `acc_norm`."""
_WITHOUT_GRAVITY = re.compile(r"(?:^|_)(?:linear\w*|lin)(?:_|$)|linear_?acc|lin_?acc")
"""Words of forces that are without gravity but in ROS, as `linear_acceleration_x`."""
_FREE = re.compile(r"free|user|linear|(?:^|_)lin(?:_|$)")
"""What names of forces without gravity contain, as `FreeAcc_X` and `userAcceleration.x`."""
_RAW = re.compile(r"(?:^|_)(?:raw|uncal[a-z]*|filtered|filt|filter|smooth[a-z]*)(?=_|$)")
"""Words of numbers that are raw or filtered, as in `acc_raw_x` and `gyro_uncalibrated_x`."""
_FILLERS = re.compile(
    r"(?:^|_)(?:axis|cal|calibrated|sensor|data|imu|values?|field|body|si|total|meas\w*|component|ln|wr|low_?noise"
    r"|wide_?range|lowg|low_g|incl_gravity|with_gravity|rs_s|3dof|g|x|y|z)(?=_|$)"
)
"""Words that tell no sensor apart."""


@functools.lru_cache(maxsize=4096)
def parse_column(cell: str, unit: str = "", *, with_linear: bool = False) -> ColumnName:
    """What a cell of the header says.

    Args:
        cell: Name of the column, with its unit in brackets or at its end, as `Acc X (g)` or `ax_m/s/s`, or without.
        unit: Unit from another row; counts before one in the cell.
        with_linear: Whether `linear_acceleration` includes gravity, as in ROS.
    """
    text, bracket_unit = split_unit(cell[:_LONGEST])
    joined = _join_words(text)
    if not (unit or bracket_unit):
        joined, bracket_unit = _split_unit_at_end(text, joined, with_linear)
    quantity, axis, sensor = _classify(joined, with_linear)
    known = unit_of(unit) or unit_of(bracket_unit)
    is_by_unit = not quantity and known is not None and known[0] in (ACCEL, GYRO) and not _is_other(joined, with_linear)
    if is_by_unit and known is not None and (axis := _axis_of(joined)):
        quantity = known[0]
    plain = re.sub(r"[^a-z0-9]+", "_", joined.lower()).strip("_")
    return ColumnName(
        name=plain,
        unit=unit.strip() or bracket_unit,
        quantity=quantity,
        axis=axis,
        sensor=sensor,
        is_raw=bool(_RAW.search(plain)),
        is_by_unit=is_by_unit,
    )


def split_unit(cell: str) -> tuple[str, str]:
    """Name and unit of a cell with a unit in brackets of any form; the unit is "" without one, and in a long cell."""
    if len(cell) > _LONGEST:  # the patterns take the square of its length
        return cell.strip(), ""
    for pattern in (_LAST_BRACKETS, _OUTER_BRACKETS):
        matched = pattern.fullmatch(cell)
        if matched and unit_of(matched[2]) is not None:
            return matched[1].strip(), matched[2].strip()
    matched = _LAST_BRACKETS.fullmatch(cell)
    if matched and matched[2].strip().isdigit():  # the index of a value, as `values[0]`
        return f"{matched[1].strip()}_{matched[2].strip()}", ""
    return (matched[1].strip(), matched[2].strip()) if matched else (cell.strip(), "")


def sensor_of_text(text: str) -> str:
    """What a text such as `left_acc_x` says beside quantity, axis and unit: `left`."""
    return parse_column(text).sensor


def is_without_gravity(cell: str) -> bool:
    """Whether a name is that of a force from which gravity was taken out, as `FreeAcc_X` or `Linear Acceleration x`."""
    joined = _join_words(split_unit(cell)[0])
    return bool(_FREE.search(joined) and _LONG[ACCEL].search(joined))


def _join_words(text: str) -> str:
    """Lower-case words of a name, joined by `_`; the number of a sensor behind an axis, as in `ax2`, is a word."""
    joined = re.sub(r"[^a-z0-9]+", "_", _JOINT.sub("_", text.strip()).lower()).strip("_")
    return _SIDE_LETTER.sub(r"\1_", _NUMBERED_QUANTITY.sub(r"\1_", _NUMBERED_AXIS.sub("_", joined)))


def _split_unit_at_end(text: str, joined: str, with_linear: bool) -> tuple[str, str]:
    """Words and unit of a name that ends with a unit of its quantity, as `ax_m/s/s`; the words and "" otherwise."""
    spaced = _JOINT.sub("_", text.strip())
    for gap in list(_WORD_GAP.finditer(spaced))[-_UNIT_WORDS:]:
        head, tail = _join_words(spaced[: gap.start()]), spaced[gap.end() :]
        known = unit_of(tail) or unit_of(tail.replace("_", "/")) or unit_of(tail.replace("_", ""))
        if known is None or not head:
            continue
        quantity, axis, _ = _classify(head, with_linear)
        if (known[0] == quantity and axis) or (known[0] == TIME and is_time_name(head)):
            return head, known[1]
    return joined, ""


def _classify(joined: str, with_linear: bool) -> tuple[str, str, str]:
    """Quantity, axis and sensor of a name, as `_join_words` gives it; "" for what it does not say."""
    if _is_other(joined, with_linear):
        return "", "", ""
    if (matched := _G_FORCE.search(joined)) is not None:
        return ACCEL, joined[-1], joined[: matched.start()]
    for patterns in (_LONG, _SHORT):
        for quantity, pattern in patterns.items():
            if (matched := pattern.search(joined)) is None:
                continue
            remainder = f"{joined[: matched.start()]}_{joined[matched.end() :]}".strip("_")
            axis = _axis_of(remainder)
            label = _RAW.sub("", re.sub(r"(?:^|_)linear(?=_|$)", "", remainder))
            # twice, as a filler takes the `_` with which the next one begins
            return quantity, axis, re.sub(r"_+", "_", _FILLERS.sub("", _FILLERS.sub("", label))).strip("_")
    return "", _axis_of(joined) if len(joined) <= len("x_axis") else "", ""


def _is_other(joined: str, with_linear: bool) -> bool:
    """Whether a name, as `_join_words` gives it, is that of a quantity which is neither a force nor a rate."""
    return bool(_OTHER_QUANTITY.search(joined) or (_WITHOUT_GRAVITY.search(joined) and not with_linear))


def _axis_of(joined: str) -> str:
    """The last axis that words joined by `_` name; "" for none."""
    axes = [matched[1] or matched[2] for matched in _AXIS.finditer(joined)]
    return axes[-1] if axes else ""


TIME_NAMES = ("t", "seconds_elapsed", "elapsed", "time", "timestamp", "time_stamp", "timestamps", "ts", "epoc", "epoch")
"""Names of columns of time, the first of which counts."""
_TIME_NAME = re.compile(
    r"(?:^|_)(?:time|timestamps?|stamps?|elapsed|clock|seconds|secs?|millis|micros|nanos|msecs?|usecs?|epoch|datetime"
    r"|realtime|timestampms|timestampus|timestampns|zeit\w*|temps|tiempo|tempo|datenum|date_?time|elapsed_?time)(?:_|$)"
    r"|timestamp"
)
"""Words of columns of time, as in `host_timestamp`, `elapsed_s` and `Zeit`."""
_NO_TIME = re.compile(r"(?:^|_)(?:zone|fine|diff|delta|dt|gps|status|step|year|month|day|hour|minute|utc_nano)(?:_|$)")
"""Words of columns that are named after time and have no stamps, as `time_zone` and `time_step`."""
_LATER_TIME = re.compile(
    r"(?:^|_)(?:host|app|raw|arrival|backend|received?|system|sync|logging|start|unix|wall|exposure|offset|duration|delay)(?:_|$)"
)
"""Words of the stamps that another column of time replaces, such as times of arrival."""


_COUNTER = re.compile(
    r"(?:pkt|packet|sample|frame|msg|message|seq|sequence)_?(?:counter|count|number|num|no|nr|id|index|idx)"
    r"|(?:\w+_)?packet_?counter|counter|count|seq|sequence|(?:field_)?header_seq|sample|frame|packet|pkt"
)
"""Names of counters, as `packet_counter`, `sample_number` and `header_seq`."""


def is_counter_name(name: str) -> bool:
    """Whether a name, in lower case and joined by `_`, is that of a counter of packets or samples."""
    return bool(_COUNTER.fullmatch(name) or _COUNTER.fullmatch(name.replace("_", "")))


def is_time_name(name: str) -> bool:
    """Whether a name, in lower case and joined by `_`, is that of a column of time."""
    return name in TIME_NAMES or bool(_TIME_NAME.search(name) and not _NO_TIME.search(name))


def time_rank(name: str) -> int:
    """Where a column of time stands among others, by its name: the least is the best."""
    if name in TIME_NAMES:
        return TIME_NAMES.index(name)
    return len(TIME_NAMES) + (1 if _LATER_TIME.search(name) else 0)
