"""Comparison with human gait: joint angles, moments, ground reaction and foot motion beside published bands.

Run as `python -m benchmarks.gait_norms [--json] [--plots FILE] [--speeds 0.8 1.1 1.3] [--terrain level stairs ramps]`.
On the level three bodies walk 20 m at each speed, as planned and as simulated, without exoskeleton and with it; the
mean of the strides in the middle is compared over the gait cycle with Schwartz, Rozumalski & Trost 2008 (the speed
group nearest by v / sqrt(g leg)). The other bands are in reference/gait_norms.yaml.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from markupsafe import Markup
from scipy.signal import butter, sosfiltfilt

from stridetwin.pages.html import multiples, page, section
from stridetwin.pages.plot import Plot, data_range
from stridetwin.reference.norms import level_norm, read_reference, speed_group
from stridetwin.sim.config import SIDES, Exo, Gait, Level, Person, Ramp, Route, Segment, Stairs, TwinConfig
from stridetwin.sim.gait.footsteps import Footstep
from stridetwin.sim.playback import FootLoad, Motion
from stridetwin.sim.twin import Twin
from stridetwin.streams.algebra.arrays import from_quaternion
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Array

SPEEDS_MPS = (0.8, 1.1, 1.3)
BODIES = {
    "1.60 m, 58 kg": Person(height_m=1.60, mass_kg=58.0),
    "1.75 m, 75 kg": Person(height_m=1.75, mass_kg=75.0),
    "1.90 m, 90 kg": Person(height_m=1.90, mass_kg=90.0),
}
ANGLES = {"hip": "hip_flexion", "knee": "knee_flexion", "ankle": "ankle_dorsiflexion"}
MOMENTS = {
    "hip": "hip_extension_moment_Nm_kg",
    "knee": "knee_extension_moment_Nm_kg",
    "ankle": "ankle_plantarflexion_moment_Nm_kg",
}
PELVIS = ("pelvis_anterior_tilt_deg", "pelvis_obliquity_deg", "pelvis_rotation_deg")
LEVEL_BANDS: dict[str, tuple[float, float]] = {
    **{f"{joint}_1sd_pct": (80, 100) for joint in ANGLES},
    **{f"{joint}_2sd_pct": (100, 100) for joint in ANGLES},
    "peak1_bw": (1.0, 1.25),
    "valley_bw": (0.65, 0.90),
    "peak2_bw": (1.0, 1.25),
    "double_support_pct": (15, 30),
    "clearance_mm": (10, 60),
    "foot_speed_mps": (4.0, 5.2),
    "foot_rate_degps": (600, 1000),
    "cop_inside_pct": (100, 100),
}
TERRAINS: dict[str, tuple[Segment, ...]] = {
    "stairs": (
        Level(length_m=3.0),
        Stairs(risers=7),
        Level(length_m=2.5),
        Stairs(risers=7, down=True),
        Level(length_m=3.0),
    ),
    "ramps": (
        Level(length_m=3.0),
        Ramp(angle_rad=np.radians(9.0), rise_m=0.8),
        Level(length_m=2.5),
        Ramp(angle_rad=np.radians(9.0), rise_m=0.8, down=True),
        Level(length_m=3.0),
    ),
}
_MODES = {"stairs": {"ascent": "SA", "descent": "SD"}, "ramps": {"ascent": "RA", "descent": "RD"}}
NORM_LEG = 0.967  # leg of the norms (pelvis to ankle) as a share of the model's (hip centre to sole)
# The norms were measured barefoot. The shoe's sole is 28 mm thick under the heel and 22 mm under the toes, 176 mm ahead
# (assets/mjcf/shoe_*.xml): the foot inside is pitched down by this slope relative to the sole, to which the ankle's
# angle refers.
SHOE_DROP_DEG = float(np.degrees(np.arctan2(0.028 - 0.022, 0.176)))
_CYCLE = np.linspace(0.0, 100.0, 51)
_RATE_HZ, _EDGE_STEPS = 200, 5
_LOADED_BW = 0.05
_BEYOND = 0.03  # of the shoe's length: tolerance of the centre of pressure beyond its ends, 8 mm
_IMU_IN_FOOT_M = (-0.045, 0.0, 0.05)
_LABORATORY_HZ = 10.0  # low pass of the moments that are compared as laboratories do, which filter at 6 to 10 Hz


@dataclass(frozen=True, kw_only=True)
class Case:
    """One walk: its label, its figures and its curves over the cycle, by quantity of the norms."""

    labels: dict[str, str | float]
    figures: dict[str, float]
    curves: dict[str, Array]
    group: str = ""


def walk(route: tuple[Segment, ...], person: Person, speed_mps: float, exo: bool, simulated: bool, seed: int) -> Twin:
    """A walk without sensors."""
    return Twin(
        TwinConfig(
            name="norms",
            route=Route(segments=route),
            person=person,
            gait=Gait(speed_mps=speed_mps),
            exo=Exo() if exo else None,
            physics="dynamic" if simulated else "kinematic",
            sensors=(),
        ),
        seed,
    )


def inside(curve: Array, group: str, quantity: str, limit: float) -> float:
    """Share of the cycle, %, in which a curve on `_CYCLE` is within the given number of standard deviations."""
    _, mean, sd = level_norm(group, quantity)
    return 100.0 * float((np.abs(curve - mean) <= limit * sd).mean())


class Strides:
    """Steady strides of one foot of a walk, and the mean of any signal over them."""

    def __init__(self, steps: list[Footstep], t: Array) -> None:
        walking = [s for s in steps if np.isfinite(s.t_touch)]
        inner = walking[_EDGE_STEPS // 2 : len(walking) - _EDGE_STEPS // 2]
        self.steps = list(pairwise(inner))
        self._t = t

    def mean(self, signal: Array) -> Array:
        """(51,) mean over the strides at `_CYCLE`."""
        each = [np.interp(a.t_touch + _CYCLE / 100.0 * (b.t_touch - a.t_touch), self._t, signal) for a, b in self.steps]
        return np.mean(each, axis=0)

    def speed(self) -> float:
        """Mean walking speed, m/s."""
        return float(
            np.mean(
                [np.linalg.norm(b.p_foot_in_world - a.p_foot_in_world) / (b.t_touch - a.t_touch) for a, b in self.steps]
            )
        )

    def stance(self) -> float:
        """Mean stance share of the cycle."""
        return float(np.mean([(a.t_off - a.t_touch) / (b.t_touch - a.t_touch) for a, b in self.steps]))


def level_case(twin: Twin, labels: dict[str, str | float]) -> Case:
    """Figures and curves of one level walk, means over both feet."""
    t_ns = np.arange(0, int(twin.duration_s * 1e9), int(1e9 / _RATE_HZ))
    player = twin.player()
    motion = player.motion(t_ns)
    loads = player.loads(t_ns, motion)
    body, mass = twin.size.body, float(twin.model.body_subtreemass[0])
    names = twin.walk.coordinates.names[6:]
    strides = {side: Strides(twin.walk.steps[side], t_ns * 1e-9) for side in SIDES}
    speed = float(np.mean([s.speed() for s in strides.values()]))
    group = speed_group(speed, NORM_LEG * (body.thigh_m + body.shank_m + body.ankle_height_m))
    curves, filtered = {}, {}
    for joint, name in ANGLES.items():
        curves[f"{name}_deg"] = _both(strides, {s: np.degrees(motion.angle[f"{name}_{s}"]) for s in SIDES})
        if joint == "ankle":
            curves[f"{name}_deg"] -= SHOE_DROP_DEG
        torque = {s: -loads.joint_torque[:, names.index(f"{name}_{s}")] / mass for s in SIDES}
        curves[MOMENTS[joint]] = _both(strides, torque)
        filtered[joint] = _both(strides, {s: _low_pass(x) for s, x in torque.items()})
    curves |= _pelvis(strides, from_quaternion(motion.tracks["pelvis"].q_world_body))
    curves["vertical_force_bw"] = _both(
        strides, {s: loads.feet[s].force[:, 2] / (mass * NOMINAL_GRAVITY_MPS2) for s in SIDES}
    )
    row = {"speed_mps": speed, "fell": float(twin.fell_at is not None)}
    for joint, name in ANGLES.items():
        for sd in (1.0, 2.0):
            row[f"{joint}_{sd:.0f}sd_pct"] = inside(curves[f"{name}_deg"], group, f"{name}_deg", sd)
        _, mean, _ = level_norm(group, f"{name}_deg")
        row[f"{joint}_rms_deg"] = float(np.sqrt(((curves[f"{name}_deg"] - mean) ** 2).mean()))
    row |= _ground_reaction(curves["vertical_force_bw"], float(np.mean([s.stance() for s in strides.values()])))
    feet = [
        _foot(twin, side, strides[side], motion) | _pressure(twin, side, strides[side], loads.feet[side], motion)
        for side in SIDES
    ]
    row |= {key: float(np.mean([foot[key] for foot in feet])) for key in feet[0]}
    row["knee_min_deg"] = float(curves["knee_flexion_deg"].min())
    for joint, quantity in MOMENTS.items():
        for sd in (2.0, 3.0):
            row[f"{joint}_moment_{sd:.0f}sd_pct"] = inside(curves[quantity], group, quantity, sd)
        row[f"{joint}_moment_max_Nm_kg"] = float(np.abs(curves[quantity]).max())
        row[f"{joint}_moment_filtered_max_Nm_kg"] = float(np.abs(filtered[joint]).max())
    for quantity in PELVIS:
        for sd in (2.0, 3.0):
            row[quantity.replace("_deg", f"_{sd:.0f}sd_pct")] = inside(curves[quantity], group, quantity, sd)
    return Case(labels=labels, figures=row, curves=curves, group=group)


def _low_pass(x: Array) -> Array:
    """(N,) values at `_RATE_HZ` without what is faster than `_LABORATORY_HZ`, without delay."""
    return np.asarray(sosfiltfilt(butter(2, _LABORATORY_HZ, fs=_RATE_HZ, output="sos"), x))


def _both(strides: Mapping[str, Strides], signals: Mapping[str, Array]) -> Array:
    return np.mean([strides[side].mean(signals[side]) for side in SIDES], axis=0)


def _pelvis(strides: Mapping[str, Strides], R: Array) -> dict[str, Array]:
    curves = {}
    for quantity, angle in zip(
        PELVIS,
        (
            np.arctan2(-R[:, 2, 0], np.hypot(R[:, 2, 1], R[:, 2, 2])),
            np.arctan2(R[:, 2, 1], R[:, 2, 2]),
            -np.arctan2(R[:, 1, 0], R[:, 0, 0]),
        ),
    ):
        signs = {"l": 1.0, "r": 1.0 if quantity == PELVIS[0] else -1.0}
        curves[quantity] = _both(strides, {side: signs[side] * np.degrees(angle) for side in SIDES})
    return curves


def _ground_reaction(curve: Array, stance: float) -> dict[str, float]:
    middle = round(25 * stance)  # of stance, on the cycle's 51 samples
    early, late = curve[:middle], curve[middle : int(50 * stance) + 1]
    first, second = int(early.argmax()), middle + int(late.argmax())
    return {
        "peak1_bw": float(early.max()),
        "valley_bw": float(curve[first : second + 1].min()),
        "peak2_bw": float(late.max()),
        "double_support_pct": 100.0 * (2.0 * stance - 1.0),
    }


def _pressure(twin: Twin, side: str, strides: Strides, load: FootLoad, motion: Motion) -> dict[str, float]:
    """Centre of pressure early and late in stance, shares of the shoe from the heel, and its share inside the sole."""
    shoe, t, weight = twin.size.shoe, motion.t_ns * 1e-9, float(twin.model.body_subtreemass[0]) * NOMINAL_GRAVITY_MPS2
    x, early, late = [], [], []
    for step, _ in strides.steps:
        on = (t >= step.t_touch) & (t <= step.t_off) & (load.force[:, 2] > _LOADED_BW * weight)
        local = (load.cop[on] - step.p_foot_in_world) @ step.R_world_sole
        share = (local[:, 0] - shoe.heel_back_x) / (shoe.toe_tip_x - shoe.heel_back_x)
        x += share.tolist()
        u = (t[on] - step.t_touch) / (step.t_off - step.t_touch)
        early.append(np.interp(0.1, u, share))
        late.append(np.interp(0.9, u, share))
    in_sole = (np.array(x) > -_BEYOND) & (np.array(x) < 1.0 + _BEYOND)
    return {
        "cop_at_10pct_stance": float(np.mean(early)),
        "cop_at_90pct_stance": float(np.mean(late)),
        "cop_inside_pct": 100.0 * float(in_sole.mean()),
    }


def _foot(twin: Twin, side: str, strides: Strides, motion: Motion) -> dict[str, float]:
    shoe, foot, toe = twin.size.shoe, motion.tracks[f"foot_{side}"], motion.tracks[f"toe_{side}"]
    R_foot, R_toe = from_quaternion(foot.q_world_body), from_quaternion(toe.q_world_body)
    sole = np.array([0.0, 0.0, -shoe.toe_hinge_z])
    tip = sole + [shoe.toe_tip_x - shoe.toe_hinge_x, 0.0, 0.0]
    points = [(foot, R_foot, np.array([shoe.heel_back_x, 0.0, 0.0])), (toe, R_toe, sole), (toe, R_toe, tip)]
    lowest = np.min([(track.p_body_in_world + R @ arm)[:, 2] for track, R, arm in points], axis=0)
    off = strides.stance()
    swing = (_CYCLE / 100.0 - off) / (1.0 - off)
    velocity = foot.v_body_in_world + np.einsum("nij,nj->ni", R_foot, np.cross(foot.w_body, _IMU_IN_FOOT_M))
    return {
        "clearance_mm": 1e3 * float(strides.mean(lowest)[(swing > 0.35) & (swing < 0.75)].min()),
        "foot_speed_mps": float(strides.mean(np.linalg.norm(velocity, axis=1)).max()),
        "foot_rate_degps": float(np.degrees(strides.mean(np.linalg.norm(foot.w_body, axis=1)).max())),
    }


def slope_case(twin: Twin, terrain: str, labels: dict[str, str | float]) -> Case:
    """Peak angles, degrees, and the range of the total vertical force, body weights, on a stair or ramp."""
    t = np.arange(0.0, twin.duration_s, 1.0 / _RATE_HZ)
    player = twin.player()
    t_ns = np.round(t * 1e9).astype(np.int64)
    motion = player.motion(t_ns)
    loads = player.loads(t_ns, motion)
    total = sum(loads.feet[s].force[:, 2] for s in SIDES) / (
        NOMINAL_GRAVITY_MPS2 * float(twin.model.body_subtreemass[0])
    )
    row = {"fell": float(twin.fell_at is not None)}
    for way, mode in _MODES[terrain].items():
        peaks: dict[str, list[float]] = {}
        on = np.zeros(len(t), dtype=bool)
        for side in SIDES:
            foot_steps = twin.walk.steps[side]
            for a, b in pairwise(foot_steps):
                if a.mode != mode or b.mode != mode:  # both footprints of the stride must be on the flight
                    continue
                rows = (t >= a.t_touch) & (t <= b.t_touch)
                on |= rows
                for name in ANGLES.values():
                    angle = np.degrees(motion.angle[f"{name}_{side}"][rows])
                    peaks.setdefault(name, []).append(angle.max())
                    if name == "ankle_dorsiflexion":
                        peaks.setdefault("ankle_plantarflexion", []).append(-angle.min())
        row |= {f"{way}_{name}_deg": float(np.mean(values)) for name, values in peaks.items()}
        if on.any():
            row |= {f"{way}_force_min_bw": float(total[on].min()), f"{way}_force_max_bw": float(total[on].max())}
    return Case(labels=labels, figures=row, curves={})


def slope_bands(terrain: str) -> dict[str, tuple[float, float]]:
    """Bands of `slope_case`'s figures; ramps have none."""
    bands: dict[str, tuple[float, float]] = {}
    if terrain == "stairs":
        norms = read_reference("gait_norms")["stairs"]
        for way in _MODES[terrain]:
            bands |= {f"{way}_{name}_deg": tuple(band) for name, band in norms[f"{way}_peak_deg"].items()}
            bands[f"{way}_force_max_bw"] = (1.0, 1.6)
    return bands


def plot_curves(case: Case) -> Markup:
    """One figure per quantity: the norm's bands of one and two standard deviations, and the walk's curve."""
    plots = []
    for quantity, curve in case.curves.items():
        bands = []
        if quantity != "vertical_force_bw":
            x, mean, sd = level_norm(case.group, quantity)
            bands = [(x, mean - k * sd, mean + k * sd, color) for k, color in ((2, "#e6ebf1"), (1, "#c9d5e3"))]
        low_high = [edge for _, low, high, _ in bands for edge in (low, high)]
        plot = Plot(
            title=quantity,
            x=(0.0, 100.0),
            y=data_range(curve, *low_high),
            x_label="share of the gait cycle, %",
            y_label=quantity,
            height=280,
        )
        for x, low, high, color in bands:
            plot.band(x, low, high, color)
        plot.line(_CYCLE, curve, "#b3261e")
        plots.append(plot.html())
    return multiples(plots)


def cases(terrain: str, speeds: list[float], bodies: list[str], manners: list[str], seed: int) -> list[Case]:
    """All walks on a terrain; manners are `planned`, `simulated`, and each with `_exo`."""
    rows = []
    for manner in manners:
        exo, simulated = manner.endswith("_exo"), manner.startswith("simulated")
        for body in bodies:
            for speed in speeds if terrain == "level" else [1.1]:
                route = TERRAINS.get(terrain, (Level(length_m=20.0),))
                twin = walk(route, BODIES[body], speed, exo, simulated, seed)
                labels: dict[str, str | float] = {"terrain": terrain, "manner": manner, "body": body, "asked": speed}
                rows.append(level_case(twin, labels) if terrain == "level" else slope_case(twin, terrain, labels))
    return rows


def table(rows: list[Case], bands: Mapping[str, tuple[float, float]]) -> str:
    """Figures beside their bands; a star marks values outside."""
    lines = [f"{'':34}" + " ".join(f"{str(case.labels['body'])[:6]:>7}" for case in rows)]
    lines.append(f"{'asked, m/s':34}" + " ".join(f"{case.labels['asked']:7.2f}" for case in rows))
    for key in rows[0].figures:
        low, high = bands.get(key, (-np.inf, np.inf))
        cells = [
            f"{case.figures[key]:6.2f}{' ' if low <= round(case.figures[key], 3) <= high else '*'}" for case in rows
        ]
        lines.append(f"{key:34}" + " ".join(cells) + (f"   {low:g}-{high:g}" if key in bands else ""))
    return "\n".join(lines)


def main() -> None:
    """Prints the figures of every walk beside the bands, or one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--terrain", nargs="+", default=["level", *TERRAINS], choices=["level", *TERRAINS])
    parser.add_argument("--speeds", type=float, nargs="+", default=list(SPEEDS_MPS), metavar="MPS")
    parser.add_argument("--bodies", nargs="+", default=list(BODIES), choices=list(BODIES))
    manners = [f"{physics}{exo}" for exo in ("", "_exo") for physics in ("planned", "simulated")]
    parser.add_argument("--manners", nargs="+", default=manners, choices=manners)
    parser.add_argument("--plots", type=Path, metavar="FILE", help="HTML page with the curves over their bands")
    parser.add_argument("--seed", type=int, default=1000)
    args = parser.parse_args()
    bands = {terrain: LEVEL_BANDS if terrain == "level" else slope_bands(terrain) for terrain in args.terrain}
    everything = []
    for terrain in args.terrain:
        for manner in args.manners:
            case_rows = cases(terrain, args.speeds, args.bodies, [manner], args.seed)
            everything += case_rows
            if not args.json:
                print(f"{terrain}, {manner}\n{table(case_rows, bands[terrain])}\n", flush=True)
    if args.json:
        rows = [{**case.labels, **case.figures} for case in everything]
        print(json.dumps({"experiment": "gait_norms", "summary": {}, "paper": bands, "cases": rows}))
    if args.plots:
        sections = [section(", ".join(map(str, case.labels.values())), "", plot_curves(case)) for case in everything]
        args.plots.write_text(page("Gait and its norms", "", [], sections, ""), encoding="utf-8")


if __name__ == "__main__":
    main()
