"""How pelvis, chest and head of planned walks move, beside recorded people and published ranges.

`python -m benchmarks.people_body [--speeds 0.8 1.1 1.3 1.6] [--grounds level ramp_up ramp_down stair_up stair_down]
[--people 10] [--seed 1000] [--json]`. Ten bodies, each with its own seed, walk 14 m on the level at each speed, and at
1.1 m/s up and down a stair of 163 mm risers and a ramp of 8°. Motion is filtered at 8 Hz as the recordings are. A
figure is the median over strides of a difference between the highest and the lowest value in a stride, without its
trend. The table shows the median over people and their range.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from benchmarks.command import answer, command
from benchmarks.people_feet import PEOPLE, SPEEDS_MPS
from stridetwin.sim.config import SIDES, Gait, Level, Person, Ramp, Route, Segment, Stairs, TwinConfig
from stridetwin.sim.gait.footsteps import Footstep
from stridetwin.sim.playback import Motion, Playback
from stridetwin.sim.twin import Twin
from stridetwin.streams.algebra.arrays import from_quaternion
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Array

_UP = (Level(length_m=2.5), Stairs(risers=8, riser_m=0.163, tread_m=0.295), Level(length_m=2.5))
_RAMP = Ramp(angle_rad=np.radians(8.0), rise_m=0.8)
GROUNDS: dict[str, tuple[Segment, ...]] = {
    "level": (Level(length_m=14.0),),
    "ramp_up": (Level(length_m=2.5), _RAMP, Level(length_m=2.5)),
    "ramp_down": (Level(length_m=2.5), Ramp(angle_rad=_RAMP.angle_rad, rise_m=0.8, down=True), Level(length_m=2.5)),
    "stair_up": _UP,
    "stair_down": (_UP[0], Stairs(risers=8, riser_m=0.163, tread_m=0.295, down=True), _UP[2]),
}
_MODES = {"level": "LG", "ramp_up": "RA", "ramp_down": "RD", "stair_up": "SA", "stair_down": "SD"}
_SLOPE_SPEED_MPS = 1.1  # on stairs and ramps
RECORDED: Mapping[str, Mapping[str, float]] = {
    "level 1.3": {
        "pelvis_up_mm": 47.0,
        "pelvis_forward_mm": 34.0,
        "pelvis_aside_mm": 36.0,
        "pelvis_yaw_deg": 13.7,
        "pelvis_roll_deg": 8.8,
        "pelvis_pitch_deg": 1.6,
        "pelvis_roll_1_deg": 2.2,
        "pelvis_roll_2_deg": 0.7,
        "pelvis_roll_3_deg": 1.7,
        "chest_yaw_deg": 5.3,
        "chest_roll_deg": 2.5,
        "chest_pitch_deg": 4.0,
        "force_min_bw": 0.70,
        "force_max_bw": 1.32,
    },
    "stair_up 1.1": {
        "head_pitch_deg": 7.7,
        "head_roll_deg": 5.0,
        "head_yaw_deg": 9.8,
        "head_aside_mm": 151.0,
        "head_rate_slow_radps": 0.24,
        "head_rate_fast_radps": 0.12,
        "head_acceleration_mps2": 2.0,
        "chest_yaw_deg": 16.9,
        "pelvis_roll_deg": 11.2,
        "pelvis_pitch_deg": 7.2,
        "pelvis_yaw_deg": 14.2,
    },
}
"""One person on the level (`opencap_walking`) and one up a stair (`stair_up`), whose strides took 1.7 s."""
ASKED: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "level 1.3": {
        "pelvis_up_mm": (40.0, 50.0),
        "pelvis_yaw_deg": (8.0, 16.0),
        "pelvis_roll_deg": (6.0, 11.0),
        "pelvis_pitch_deg": (1.0, 5.0),
        "chest_yaw_deg": (4.0, 9.0),
        "chest_pitch_deg": (2.0, 5.0),
        "head_pitch_deg": (2.0, 6.0),
        "head_yaw_deg": (2.0, 8.0),
        "head_roll_deg": (1.0, 4.0),
    },
    "stair_up 1.1": {key: (0.6 * value, 1.5 * value) for key, value in RECORDED["stair_up 1.1"].items()},
}
RATE_HZ = 100.0
_FILTER_HZ = 8.0
_SLOW_HZ = 3.5  # border between slow and fast rates of the head
_BODIES = {"pelvis": "pelvis", "chest": "torso", "head": "head"}
_STEPS_LEFT_OUT = 3  # on the level, at each end of a walk


def walk(ground: str, speed_mps: float, person: Person, seed: int) -> Twin:
    """A planned walk without sensors and exoskeleton."""
    route = Route(segments=GROUNDS[ground])
    return Twin(TwinConfig(name="body", route=route, person=person, gait=Gait(speed_mps=speed_mps), sensors=()), seed)


def strides(twin: Twin, ground: str) -> list[tuple[Footstep, Footstep]]:
    """Both footprints of each steady stride on the ground asked for."""
    mode = _MODES[ground]
    pairs = []
    for side in SIDES:
        walking = [step for step in twin.walk.steps[side] if np.isfinite(step.t_touch)]
        if ground == "level":
            walking = walking[_STEPS_LEFT_OUT // 2 + 1 : -(_STEPS_LEFT_OUT // 2 + 1)]
        pairs += [(a, b) for a, b in pairwise(walking) if a.mode == mode and b.mode == mode]
    return pairs


def _excursion(x: Array) -> float:
    """Highest minus lowest of (N,) values without the line through their ends."""
    return float(np.ptp(x - np.linspace(x[0], x[-1], len(x))))


def _low_pass(x: Array, hz: float = _FILTER_HZ) -> Array:
    return np.asarray(sosfiltfilt(butter(2, hz, fs=RATE_HZ, output="sos"), x, axis=0))


def _angles(motion: Motion, body: str) -> Array:
    """(N, 3) rad, yaw, pitch and roll of a body, filtered."""
    R = from_quaternion(motion.tracks[body].q_world_body)
    return _low_pass(
        np.column_stack(
            [
                np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0])),
                np.arctan2(-R[:, 2, 0], np.hypot(R[:, 2, 1], R[:, 2, 2])),
                np.arctan2(R[:, 2, 1], R[:, 2, 2]),
            ]
        )
    )


def figures(twin: Twin, ground: str) -> dict[str, float]:
    """All figures of one walk; empty if it has no stride on the ground asked for."""
    t = np.arange(0.0, twin.duration_s, 1.0 / RATE_HZ)
    t_ns = np.round(t * 1e9).astype(np.int64)
    playback = Playback(twin.model, twin.reference)
    motion = playback.motion(t_ns)
    loads = playback.loads(t_ns, motion)
    weight = NOMINAL_GRAVITY_MPS2 * float(twin.model.body_subtreemass[0])
    force = _low_pass(np.sum([loads.feet[side].force[:, 2] for side in SIDES], axis=0) / weight, 20.0)
    angles = {name: np.degrees(_angles(motion, body)) for name, body in _BODIES.items()}
    places = {name: 1e3 * _low_pass(motion.tracks[body].p_body_in_world) for name, body in _BODIES.items()}
    rate = motion.tracks["head"].w_body
    slow = _low_pass(rate, _SLOW_HZ)
    fast = _low_pass(rate) - slow
    acceleration = np.gradient(np.gradient(places["head"] * 1e-3, t, axis=0), t, axis=0)
    each: dict[str, list[float]] = {}
    for a, b in strides(twin, ground):
        rows = slice(round(a.t_touch * RATE_HZ), round(b.t_touch * RATE_HZ) + 1)
        values = {"stride_s": b.t_touch - a.t_touch, "speed_mps": (b.s - a.s) / (b.t_touch - a.t_touch)}
        for name in _BODIES:
            for i, angle in enumerate(("yaw", "pitch", "roll")):
                values[f"{name}_{angle}_deg"] = _excursion(angles[name][rows, i])
            for i, axis in enumerate(("forward", "aside", "up")):  # the way leads along x
                values[f"{name}_{axis}_mm"] = _excursion(places[name][rows, i])
        # harmonics 1 to 3 of the stride, from one period without its last row
        spectrum = np.fft.rfft(angles["pelvis"][rows, 2][:-1]) * 2.0 / (rows.stop - rows.start - 1)
        values |= {f"pelvis_roll_{k}_deg": float(np.abs(spectrum[k])) for k in (1, 2, 3)}
        values["force_min_bw"], values["force_max_bw"] = float(force[rows].min()), float(force[rows].max())
        values["head_rate_slow_radps"] = float(np.sqrt((slow[rows] ** 2).sum(1).mean()))
        values["head_rate_fast_radps"] = float(np.sqrt((fast[rows] ** 2).sum(1).mean()))
        values["head_acceleration_mps2"] = float(np.sqrt((acceleration[rows] ** 2).sum(1).mean()))
        for key, value in values.items():
            each.setdefault(key, []).append(value)
    return {key: float(np.median(values)) for key, values in each.items()}


def measure(arguments: Namespace) -> dict[str, Any]:
    """Figures of all walks: by ground and speed, and then by figure, the values of all people."""
    cases = [("level", speed) for speed in arguments.speeds if "level" in arguments.grounds]
    cases += [(ground, _SLOPE_SPEED_MPS) for ground in arguments.grounds if ground != "level"]
    summary: dict[str, dict[str, list[float]]] = {}
    for ground, speed in cases:
        rows = summary.setdefault(f"{ground} {speed:g}", {})
        for i, person in enumerate(PEOPLE[: arguments.people]):
            for key, value in figures(walk(ground, speed, person, arguments.seed + i), ground).items():
                rows.setdefault(key, []).append(value)
    return {"experiment": "people_body", "summary": summary}


def show(result: dict[str, Any]) -> None:
    """Prints median and range over people beside what was recorded and is asked for."""
    for case, rows in result["summary"].items():
        print(case)
        for key, values in rows.items():
            show_row(key, values, RECORDED.get(case, {}).get(key), ASKED.get(case, {}).get(key))


def show_row(key: str, values: Sequence[float], recorded: float | None, asked: tuple[float, float] | None) -> None:
    """Prints one figure: median and range over people, the recorded value, and the range asked for and who is in it."""
    text = f"  {key:24s} {np.median(values):8.3g} ({min(values):.3g}-{max(values):.3g})"
    if recorded is not None:
        text += f"; recorded {recorded:g}"
    if asked is not None:
        inside = sum(asked[0] <= value <= asked[1] for value in values)
        text += f"; asked {asked[0]:.3g}-{asked[1]:.3g}, {inside} of {len(values)} people"
    print(text)


def main() -> int:
    """Measures and prints all walks asked for."""
    parser = command(__doc__)
    parser.add_argument("--speeds", type=float, nargs="+", default=list(SPEEDS_MPS), help="on the level, m/s")
    parser.add_argument("--grounds", nargs="+", choices=list(GROUNDS), default=list(GROUNDS))
    parser.add_argument("--people", type=int, default=len(PEOPLE))
    parser.add_argument("--seed", type=int, default=1000, help="of the first person; each has the next one")
    return answer(parser, measure, show)


if __name__ == "__main__":
    sys.exit(main())
