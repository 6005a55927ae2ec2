"""Checks which gaits are possible."""

from __future__ import annotations

import math

from stridetwin.sim.config import ASYMMETRY_MAX, GAZES, PATTERNS, SPEED_RANGE_MPS, STAIRS, SWAY_RANGE_HZ, Gait
from stridetwin.streams.errors import ConfigError

GAZE_PITCH_RANGE_RAD = (-0.6, 0.8)
GAZE_YAW_MAX_RAD = 0.7
SWAY_MAX_RAD, SWAY_MAX_RADPS = 0.7, 5.0


def check_gait(gait: Gait) -> None:
    """Rejects a gait that is impossible for the legs or the neck.

    Raises:
        ConfigError: The message names field, value and range.
    """
    slow, fast = SPEED_RANGE_MPS
    up, down = GAZE_PITCH_RANGE_RAD
    gaze, aside = gait.gaze, GAZE_YAW_MAX_RAD
    sways = {"yaw": gaze.sway_yaw_rad, "pitch": gaze.sway_pitch_rad}
    seldom, often = SWAY_RANGE_HZ
    fastest = 2 * math.pi * gaze.sway_hz * max(sways.values())
    for field, value, valid, range_in_words in (
        ("pattern", gait.pattern, gait.pattern in PATTERNS, ", ".join(PATTERNS)),
        ("speed_mps", gait.speed_mps, slow <= gait.speed_mps <= fast, f"{slow}-{fast} m/s"),
        ("stairs", gait.stairs, gait.stairs in STAIRS, ", ".join(STAIRS)),
        ("leading_foot", gait.leading_foot, gait.leading_foot in ("l", "r"), "l, r"),
        ("asymmetry", gait.asymmetry, abs(gait.asymmetry) <= ASYMMETRY_MAX, f"{-ASYMMETRY_MAX} to {ASYMMETRY_MAX}"),
        ("shuffle", gait.shuffle, 0.0 <= gait.shuffle <= 1.0, "0-1"),
        ("gaze.kind", gaze.kind, gaze.kind in GAZES, ", ".join(GAZES)),
        ("gaze.pitch_rad", gaze.pitch_rad, up <= gaze.pitch_rad <= down, f"{up} to {down} rad, down positive"),
        ("gaze.yaw_rad", gaze.yaw_rad, abs(gaze.yaw_rad) <= aside, f"{-aside} to {aside} rad, left positive"),
        *(
            (f"gaze.sway_{axis}_rad", sway, 0.0 <= sway <= SWAY_MAX_RAD, f"0-{SWAY_MAX_RAD} rad")
            for axis, sway in sways.items()
        ),
        ("gaze.sway_hz", gaze.sway_hz, seldom <= gaze.sway_hz <= often, f"{seldom}-{often} Hz"),
        (
            "gaze.sway_hz", gaze.sway_hz, fastest <= SWAY_MAX_RADPS,
            f"2 pi times rate and amplitude, the highest angular rate, of up to {SWAY_MAX_RADPS:g} rad/s",
        ),
    ):  # fmt: skip
        if not valid:
            raise ConfigError("gait", field, value, range_in_words)
