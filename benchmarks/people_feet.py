"""How the feet of planned walks move, beside recorded feet: landing, swing, stance, and differences between strides.

`python -m benchmarks.people_feet [--speeds 0.8 1.1 1.3 1.6] [--people 10] [--seed 1000] [--json]`. Ten bodies walk 20 m
on the level at each speed, each with its own seed. The recorded feet are both of `dual_foot_walk` (204.8 Hz, markers),
found by `benchmarks.real_walks`. The twin's IMU, without errors, sits where the recorded one was, beside the ankle, and
has its rate. Strikes and toe-offs are found in the IMU of both in the same way. Figures are medians over strides, of a
foot and then over feet; SD and CV are those of a foot's strides, without a trend, and medians over feet.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, savgol_filter, sosfiltfilt

from benchmarks.command import answer, command
from benchmarks.real_walks import data_folder, load_markers
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import SIDES, Gait, Person
from stridetwin.sim.gait.footsteps import Footstep
from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.library import make_ideal
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.sensors.imu import ImuModel
from stridetwin.sim.sensors.model import instants
from stridetwin.sim.twin import Twin
from stridetwin.streams.algebra.arrays import from_quaternion
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Array

SPEEDS_MPS = (0.8, 1.1, 1.3, 1.6)
PEOPLE = tuple(
    Person(height_m=height, mass_kg=mass, sex=sex)
    for height, mass, sex in (
        (1.75, 75.0, "male"),
        (1.60, 55.0, "female"),
        (1.68, 64.0, "female"),
        (1.83, 84.0, "male"),
        (1.72, 80.0, "male"),
        (1.64, 70.0, "female"),
        (1.90, 92.0, "male"),
        (1.78, 68.0, "male"),
        (1.70, 58.0, "female"),
        (1.80, 95.0, "male"),
    )
)
ASKED: dict[str, tuple[float, float]] = {
    "heel_speed_20ms_mps": (0.8, 1.4),
    "swing_force_rms_mps2": (9.9, 17.2),
    "braking_force_mps2": (25.0, 33.0),
    "toe_off_rate_radps": (9.6, 10.1),
    "strike_rms_mps2": (24.0, 36.0),
    "strike_peak_mps2": (58.0, 160.0),
    "stance_rate_rms_radps": (0.4, 0.9),
    "stance_force_sd_mps2": (1.7, 3.4),
    "stillest_rate_radps": (0.08, 0.17),
    "stillest_force_sd_mps2": (0.17, 0.4),
    "stance_tilt_deg": (0.6, 7.7),
    "clearance_sd_mm": (2.0, 5.0),
    "heel_top_sd_mm": (3.4, 4.5),
    "toe_off_rate_cv_pct": (3.0, 7.0),
    "swing_rate_cv_pct": (3.6, 4.5),
}
"""What is wanted at 1.3 m/s, most of it from the recorded feet."""
BESIDE_ANKLE_M = (0.032, 0.040, 0.045)  # place of the recorded sensors: forward, outward, up in the foot's frame
HEEL_MARKER_M = 0.05  # height of the recorded marker on the heel above the sole
RATE_HZ = 204.8
_STEPS_LEFT_OUT = 2  # at each end of a walk
_SHARP_HZ = (20.0, 95.0)
_STRIDE_S = (0.75, 1.7)
_STRIDE_M = (0.7, 2.1)
_SAME_LENGTH = 0.10  # largest difference from the median length of the strides, of steady ones
_SWING_BEFORE_S = (0.65, 0.22)  # before a strike, where the toe-off is sought
_MARKER_WINDOW_S = 0.055
_TOE_OFF_HZ = 40.0  # of the low-pass filter on rates whose peaks are read


@dataclass(frozen=True, kw_only=True, eq=False)
class FootSignals:
    """One foot's IMU, and two points of its shoe.

    Attributes:
        t: (N,) s, uniform.
        rate: (N, 3) rad/s.
        force: (N, 3) m/s².
        heel: (N, 3) m, back of the heel.
        toe: (N, 3) m, tip of the toes.
        planned_touch: (K,) s, planned touch-downs; empty for a recording.
    """

    t: Array
    rate: Array
    force: Array
    heel: Array
    toe: Array
    planned_touch: Array


def _low_pass(x: Array, hz: float, rate_hz: float) -> Array:
    return np.asarray(sosfiltfilt(butter(2, hz, fs=rate_hz, output="sos"), x, axis=0))


def _speeds(p: Array, dt: float) -> Array:
    """(N,) m/s, speed of a point, over the window of the markers."""
    window = max(5, round(_MARKER_WINDOW_S / dt) | 1)
    return np.linalg.norm(savgol_filter(p, window, 2, deriv=1, delta=dt, axis=0), axis=1)


def sagittal_rate(foot: FootSignals) -> Array:
    """(N,) rad/s about the axis about which the foot turns most; positive for toes that go down, as at toe-off."""
    axis = np.linalg.svd(foot.rate - foot.rate.mean(0), full_matrices=False)[2][0]
    rate = _low_pass(foot.rate @ axis, _TOE_OFF_HZ, 1.0 / (foot.t[1] - foot.t[0]))
    # the push-off lasts a shorter time than the swing, and is therefore the faster of the two
    return rate if rate.max() > -rate.min() else -rate


def find_strides(foot: FootSignals) -> NDArray[np.int64]:
    """(K, 3) samples of a strike, of the toe-off after it, and of the next strike of steady strides.

    A toe-off is the largest sagittal rate in a stride. A strike is the onset of the force above 20 Hz at the end of the
    swing, where that first exceeds 0.3 of its largest value.
    """
    hz = 1.0 / (foot.t[1] - foot.t[0])
    rate = sagittal_rate(foot)
    sharp = np.linalg.norm(sosfiltfilt(butter(2, _SHARP_HZ, "band", fs=hz, output="sos"), foot.force, axis=0), axis=1)
    level = 0.55 * np.percentile(rate, 99.5)
    peaks: list[int] = []
    for k in np.flatnonzero((rate[1:-1] > level) & (rate[1:-1] >= rate[:-2]) & (rate[1:-1] > rate[2:])) + 1:
        if peaks and k - peaks[-1] < 0.5 * hz:
            if rate[k] > rate[peaks[-1]]:
                peaks[-1] = int(k)
        else:
            peaks.append(int(k))
    strikes = []
    for off in peaks:
        a, b = off + round(0.25 * hz), min(off + round(0.75 * hz), len(rate) - 1)
        if b - a < 0.2 * hz:
            strikes.append(-1)
            continue
        peak = a + int(sharp[a:b].argmax())
        first = max(peak - round(0.06 * hz), a)
        strikes.append(first + int((sharp[first : peak + 1] > 0.3 * sharp[peak]).argmax()))
    rows = []
    for i in range(1, len(peaks)):
        strike, off, after = strikes[i - 1], peaks[i], strikes[i]
        if strike < 0 or after < 0 or not _STRIDE_S[0] < (after - strike) / hz < _STRIDE_S[1]:
            continue
        if not _STRIDE_M[0] < np.linalg.norm(foot.heel[after] - foot.heel[strike]) < _STRIDE_M[1]:
            continue
        if off - strike < 0.35 * hz or after - off > 0.7 * hz:
            continue
        rows.append((strike, off, after))
    return np.array(rows[_STEPS_LEFT_OUT:-_STEPS_LEFT_OUT], dtype=np.int64).reshape(-1, 3)


def _spread(values: Array) -> float:
    """Standard deviation about a straight line through all strides."""
    if len(values) < 4:
        return float("nan")
    k = np.arange(len(values))
    return float(np.std(values - np.polyval(np.polyfit(k, values, 1), k), ddof=2))


def figures(foot: FootSignals) -> dict[str, float]:
    """All figures of one foot."""
    dt = foot.t[1] - foot.t[0]
    hz, rows = 1.0 / dt, find_strides(foot)
    lengths = np.linalg.norm(foot.heel[rows[:, 2]] - foot.heel[rows[:, 0]], axis=1)
    rows = rows[np.abs(lengths / np.median(lengths) - 1.0) < _SAME_LENGTH]
    if len(rows) < 4:
        return {}
    rate, push = np.linalg.norm(foot.rate, axis=1), np.linalg.norm(foot.force, axis=1)
    excess, turning, speed = push - NOMINAL_GRAVITY_MPS2, sagittal_rate(foot), _speeds(foot.heel, dt)
    lasting = round(0.1 * hz)
    each: dict[str, list[float]] = {}

    def add(name: str, value: float) -> None:
        each.setdefault(name, []).append(float(value))

    def at(k: int, s: float) -> int:
        return int(k + round(s * hz))

    for strike, off, after in rows:
        swing = slice(at(off, 0.05), at(after, -0.03))
        add("speed_mps", np.linalg.norm(foot.heel[after] - foot.heel[strike]) / ((after - strike) * dt))
        add("heel_speed_40ms_mps", speed[at(after, -0.04)])
        add("heel_speed_20ms_mps", speed[at(after, -0.02)])
        add("heel_speed_max_mps", speed[off:after].max())
        add("swing_force_rms_mps2", np.sqrt((excess[swing] ** 2).mean()))
        add("braking_force_mps2", np.median(push[at(after, -0.12) : at(after, -0.07)]))
        add("toe_off_rate_radps", turning[off])
        add("swing_rate_radps", -turning[off:after].min())
        add("strike_rms_mps2", np.sqrt((excess[at(after, -0.02) : at(after, 0.1)] ** 2).mean()))
        add("strike_peak_mps2", push[at(after, -0.04) : at(after, 0.1)].max())
        stance = slice(at(strike, 0.1), at(off, -0.2))
        spans = range(stance.start, stance.stop - lasting)
        if len(spans) < 5:
            continue
        add("stance_rate_rms_radps", np.sqrt((rate[stance] ** 2).mean()))
        add("stance_force_sd_mps2", np.sqrt(foot.force[stance].var(0).sum()))
        still = min(spans, key=lambda k: (rate[k : k + lasting] ** 2).mean())
        add("stillest_rate_radps", np.sqrt((rate[still : still + lasting] ** 2).mean()))
        add("stillest_force_sd_mps2", np.sqrt(foot.force[still : still + lasting].var(0).sum()))
        up = foot.force[still : still + lasting].mean(0)
        add("stillest_after_strike_s", (still + lasting / 2 - strike) * dt)
        up_at_rest = foot.force[: round(0.2 * hz)].mean(0)
        cosine = up @ up_at_rest / np.linalg.norm(up) / np.linalg.norm(up_at_rest)
        add("stance_tilt_deg", np.degrees(np.arccos(min(cosine, 1.0))))
        passing = slice(off + (after - off) // 6, after - (after - off) // 4)
        add("clearance_mm", 1e3 * (foot.toe[passing, 2].min() - foot.toe[stance, 2].mean()))
        add("heel_top_mm", 1e3 * (foot.heel[off - round(0.1 * hz) : after, 2].max() - foot.heel[stance, 2].mean()))
    result = {name: float(np.median(values)) for name, values in each.items()}
    for name in ("clearance", "heel_top"):
        result[f"{name}_sd_mm"] = _spread(np.array(each[f"{name}_mm"]))
    for name in ("toe_off_rate", "swing_rate"):
        values = np.array(each[f"{name}_radps"])
        result[f"{name}_cv_pct"] = 100.0 * _spread(values) / float(values.mean())
    values = np.array(each["strike_rms_mps2"])
    result["strike_cv_pct"] = 100.0 * _spread(values) / float(values.mean())
    if len(foot.planned_touch):
        k = np.searchsorted(foot.t, foot.planned_touch[_STEPS_LEFT_OUT:-_STEPS_LEFT_OUT])
        fine = np.linalg.norm(np.gradient(foot.heel, dt, axis=0), axis=1)
        result["heel_speed_20ms_before_planned_touch_mps"] = float(np.median(fine[k - round(0.02 * hz)]))
    result["strides"] = float(len(rows))
    return result


def read_recorded_feet() -> list[FootSignals]:
    """Both feet of `dual_foot_walk`, on the times of their IMUs; empty without the recordings."""
    folder = data_folder("dual_foot_walk")
    feet = []
    for walk in load_markers(folder) if folder is not None else ():
        t = walk.imu.t_ns * 1e-9
        grid = np.arange(t[0], t[-1], 1.0 / RATE_HZ)
        rate, force = (
            np.column_stack([np.interp(grid, t, x) for x in walk.imu.columns[name].T])
            for name in ("angular_rate", "specific_force")
        )
        seen = np.isfinite(walk.heel).all(1) & np.isfinite(walk.toe).all(1)
        heel, toe = (
            np.column_stack([np.interp(grid, walk.t[seen], p[seen, k]) for k in range(3)])
            for p in (walk.heel, walk.toe)
        )
        feet.append(FootSignals(t=grid, rate=rate, force=force, heel=heel, toe=toe, planned_touch=np.empty(0)))
    return feet


def twin_feet(twin: Twin) -> list[FootSignals]:
    """Both feet of a walk of the twin with foot IMUs."""
    t_ns = instants(RATE_HZ, -1, int(twin.duration_s * 1e9))
    motion = twin.player().motion(t_ns)
    shoe, feet = twin.size.shoe, []
    tip = np.array([shoe.toe_tip_x - shoe.toe_hinge_x, 0.0, -shoe.toe_hinge_z])
    for side in SIDES:
        worn = twin.sensor_rig.sensors[f"/foot_{side}/imu"]
        imu, part = twin.sensor_rig.rig.imu(worn.calibration.topic), replace(make_ideal(worn.part), rate_hz=RATE_HZ)
        block = ImuModel(imu, part, Noise(None)).read(motion.carrier(imu.mount.body), t_ns)
        foot, toe = motion.tracks[f"foot_{side}"], motion.tracks[f"toe_{side}"]
        R_foot, R_toe = from_quaternion(foot.q_world_body), from_quaternion(toe.q_world_body)
        steps: Sequence[Footstep] = twin.walk.steps[side]
        feet.append(
            FootSignals(
                t=t_ns * 1e-9,
                rate=block.columns["angular_rate"],
                force=block.columns["specific_force"],
                heel=foot.p_body_in_world + R_foot @ np.array([shoe.heel_back_x, 0.0, HEEL_MARKER_M]),
                toe=toe.p_body_in_world + R_toe @ tip,
                planned_touch=np.array([s.t_touch for s in steps if np.isfinite(s.t_touch)]),
            )
        )
    return feet


def median_of(feet: Sequence[FootSignals]) -> dict[str, float]:
    """Medians of the figures over feet; of the peaks of strikes and the tilts, the smallest and the largest, too."""
    rows = [row for foot in feet if (row := figures(foot))]
    if not rows:
        return {}
    medians = {name: float(np.nanmedian([row[name] for row in rows])) for name in rows[0]}
    for name in ("strike_peak_mps2", "stance_tilt_deg", "stance_rate_rms_radps"):
        values = [row[name] for row in rows]
        medians |= {f"{name}_least": min(values), f"{name}_most": max(values)}
    return medians


def measure(arguments: Namespace) -> dict[str, Any]:
    """Figures of the recorded feet, and of the twin's at each speed."""
    level = replace(
        load_scenario("level_20m").config,
        sensors=("foot_imu",),
        fittings={"foot_imu": SensorConfig(position_m=BESIDE_ANKLE_M)},
    )
    summary: dict[str, dict[str, float]] = {}
    recordings = read_recorded_feet()
    if recordings:
        summary["recorded"] = median_of(recordings)
    for speed in arguments.speeds:
        feet = []
        for i, person in enumerate(PEOPLE[: arguments.people]):
            feet += twin_feet(Twin(replace(level, person=person, gait=Gait(speed_mps=speed)), arguments.seed + i))
        summary[f"{speed:g} m/s"] = median_of(feet)
    return {"experiment": "people_feet", "summary": summary, "band": ASKED, "paper": {}, "cases": []}


def show(result: dict[str, Any]) -> None:
    """Prints one line per figure; a star marks a value at 1.3 m/s beyond what is asked."""
    summary = result["summary"]
    names = dict.fromkeys(name for row in summary.values() for name in row)
    print(f"{'':42}" + "".join(f"{column:>10}" for column in summary) + f"{'asked, 1.3 m/s':>16}")
    for name in names:
        cells = "".join(f"{row[name]:10.2f}" if name in row else f"{'-':>10}" for row in summary.values())
        low, high = ASKED.get(name, (-np.inf, np.inf))
        missed = not low <= summary.get("1.3 m/s", {}).get(name, low) <= high
        print(f"{name:42}{cells}" + (f"{f'{low:g}-{high:g}':>15}{'*' if missed else ''}" if name in ASKED else ""))


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--speeds", type=float, nargs="+", default=list(SPEEDS_MPS), metavar="MPS")
    parser.add_argument("--people", type=int, default=len(PEOPLE), help="how many of the ten people walk")
    parser.add_argument("--seed", type=int, default=1000, help="of the first person's walk")
    return answer(parser, measure, show)


if __name__ == "__main__":
    sys.exit(main())
