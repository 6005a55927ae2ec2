"""Fits the styles of level walking, one speed after the other, and writes sim/gait/level_style.csv.

Run as `python -m tools.fit_gait_cycle` (about four minutes); the table in the repository is what this one call writes.
Least squares on one steady stride of a body whose pelvis sways as that of a mean walker (`sim/gait/body_sway.py`)
and is as high as the planner makes it: differences from the joint angles of Schwartz, Rozumalski & Trost 2008 in
standard deviations, from a smooth two-peaked ground reaction in body weights and from a rise of the pelvis, hinges on
clearance, foot speed, moments and the load of both feet, and weak priors that keep neighbouring speeds similar. Each
speed is drawn towards the line through its neighbours, in sweeps that begin with `START`. No existing table is read,
unless `--fields` names the fields to fit or `--paces` the speeds: then the others stay.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from benchmarks.gait_norms import NORM_LEG, SHOE_DROP_DEG
from stridetwin.reference.norms import level_norm
from stridetwin.sim.config import Person
from stridetwin.sim.gait.foot_placement import level_step_length
from stridetwin.sim.gait.style import LABELS, SIZES, Style, level_style
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Array
from tools.steady_cycle import SAMPLES, Cycle, Walker, steady_cycle

PACES = (0.23, 0.26, 0.29, 0.33, 0.38, 0.43, 0.48, 0.55)  # 0.65 m/s of small people to 1.7 m/s of tall ones
BODIES = (Person(),)  # lengths and speeds are relative to the leg: other bodies give nearly the same styles
_STEP_SIGMAS = 1.5  # largest step of the fit in any coordinate, in sigmas
_SETTLED = 5e-3  # share of the cost: a step that gains less ends the fit
# Rounded from earlier runs, by speed; the fit begins on the lines through them.
START = {
    0.23: Style(
        double_support=0.284,
        transfer=0.997,
        flat_after=0.112,
        heel_off_before=0.385,
        rise=np.array([0.0494, 0.18, 0.606]),
        pitch=np.array([0.758, 0.899, 0.864, 0.709, 0.42, 0.0827, -0.0784, -0.245, -0.17]),
        travel=np.array([-0.202, -0.27, 0.437, 0.329, 0.466, 1.28, 1.36, 1.36]),
        height=np.array([0.986, -0.0108, -0.00571, -0.00109, -0.000483, 0.000214, -7e-05]),
        forward=np.array([0.241, -0.165, -0.441, -0.0284, 0.801, -0.27, 0.412]),
        lift=np.array([0.024, 0.054, 0.0339, -0.2, 0.188]),
        tilt=0.156,
    ),
    0.29: Style(
        double_support=0.257,
        transfer=0.986,
        flat_after=0.111,
        heel_off_before=0.401,
        rise=np.array([0.0539, 0.198, 0.609]),
        pitch=np.array([0.807, 1.04, 0.974, 0.767, 0.43, 0.0629, -0.108, -0.294, -0.208]),
        travel=np.array([-0.265, 0.186, 0.824, 0.215, 0.668, 1.14, 1.36, 1.34]),
        height=np.array([0.984, -0.0122, -0.00667, -0.000792, -0.000353, 1e-05, 0.0001]),
        forward=np.array([0.283, -0.178, -0.39, -0.0956, 0.898, -0.267, 0.337]),
        lift=np.array([0.024, 0.0475, 0.0417, -0.231, 0.239]),
        tilt=0.144,
    ),
    0.38: Style(
        double_support=0.23,
        transfer=0.965,
        flat_after=0.111,
        heel_off_before=0.447,
        rise=np.array([0.0885, 0.203, 0.636]),
        pitch=np.array([0.875, 1.22, 1.13, 0.874, 0.486, 0.0978, -0.111, -0.326, -0.218]),
        travel=np.array([-0.27, 0.21, 0.679, 0.339, 1.07, 1.36, 1.36, 1.36]),
        height=np.array([0.979, -0.0147, -0.00813, 0.000614, 0.000419, -0.000161, -0.000508]),
        forward=np.array([0.315, -0.198, -0.322, -0.195, 0.827, -0.143, 0.345]),
        lift=np.array([0.024, 0.066, 0.0658, -0.263, 0.177]),
        tilt=0.159,
    ),
    0.43: Style(
        double_support=0.215,
        transfer=0.965,
        flat_after=0.102,
        heel_off_before=0.457,
        rise=np.array([0.086, 0.19, 0.623]),
        pitch=np.array([0.857, 1.23, 1.14, 0.857, 0.494, 0.0845, -0.132, -0.346, -0.239]),
        travel=np.array([-0.27, 0.0859, 0.379, 0.408, 1.33, 1.36, 1.36, 1.36]),
        height=np.array([0.975, -0.0171, -0.0101, 0.000909, -0.000616, -0.00029, -0.000175]),
        forward=np.array([0.318, -0.206, -0.297, -0.222, 0.758, -0.105, 0.33]),
        lift=np.array([0.024, 0.0294, 0.0559, -0.211, 0.254]),
        tilt=0.168,
    ),
    0.48: Style(
        double_support=0.203,
        transfer=0.974,
        flat_after=0.0991,
        heel_off_before=0.464,
        rise=np.array([0.0979, 0.241, 0.651]),
        pitch=np.array([0.871, 1.29, 1.18, 0.871, 0.469, 0.0811, -0.132, -0.386, -0.282]),
        travel=np.array([-0.27, 0.0237, 0.454, 0.681, 1.36, 1.36, 1.36, 1.34]),
        height=np.array([0.973, -0.0165, -0.0101, 0.00155, -0.000554, -0.000292, -0.000316]),
        forward=np.array([0.349, -0.22, -0.336, -0.228, 0.92, -0.115, 0.218]),
        lift=np.array([0.024, 0.0572, 0.0183, -0.203, 0.281]),
        tilt=0.185,
    ),
    0.55: Style(
        double_support=0.185,
        transfer=0.965,
        flat_after=0.0803,
        heel_off_before=0.497,
        rise=np.array([0.0833, 0.256, 0.639]),
        pitch=np.array([0.933, 1.35, 1.21, 0.906, 0.508, 0.104, -0.107, -0.393, -0.334]),
        travel=np.array([-0.27, -0.0648, 0.587, 1.11, 1.36, 1.36, 1.36, 1.31]),
        height=np.array([0.971, -0.0162, -0.00914, 0.00149, -0.000299, -0.000351, -0.000191]),
        forward=np.array([0.366, -0.212, -0.407, -0.235, 1.07, -0.162, 0.0826]),
        lift=np.array([0.024, 0.0641, 0.0199, -0.226, 0.259]),
        tilt=0.2,
    ),
}
_TABLE = Path(__file__).parents[1] / "sim" / "gait" / "level_style.csv"
_CLASS_CENTRES = {"VerySlow": 0.17, "Slow": 0.295, "Free": 0.43, "Fast": 0.57, "VeryFast": 0.70}  # of the groups
_PASSING = 2.0  # the norm changes from one group's to the next in the middle half between their centres
_PACE_OF_WHOLE_NORM = 0.2  # people who walk more slowly use part of the slowest group's range
# Feet: those of `dual_foot_walk` (`benchmarks.people_feet`). The quickest toe-off, the quickest turn in swing, the
# quickest lowering of the sole, the hardest braking in the air and the speed of the heel before it lands. All but the
# swing and the landing are a little below the recorded figures, as the limits are soft
_RECORDED_PACE, _RECORDED_LEG_M = 0.43, 0.93
_TOE_OFF_RADPS, _SWING_RATE_RADPS, _SLAP_RADPS, _BRAKING_MPS2 = 9.9, 6.7, 4.6, 25.0
_LANDING_MPS = 1.18  # of the heel, `_LANDING_S` before touch-down
_LANDING_S = 0.02
# Rise and fall of the pelvis by speed, leg lengths. `opencap_walking` rises by 47 mm with steps of 0.70 m; the twin's
# steps at its speed are shorter, 0.66 m, and quicker: 40 mm, with nearly the same ground reaction. Up to 0.43, about
# as the squared step; faster, less than people: more takes the load in the middle of stance below the norms
_RISE = (0.0, 0.24, 0.33, 0.38, 0.43, 0.48, 0.55), (0.004, 0.0260, 0.032, 0.0365, 0.0463, 0.0450, 0.041)
# Weights: of the rise relative to the wanted one, of an angle beyond `_INNER_SD` and `_OUTER_SD`, of a hip's moment
# beyond `_HIP_MOMENT_NM_KG`, and of braking beyond `_BRAKING_MPS2`
_RISE_WEIGHT, _ANGLE_WEIGHT, _HIP_WEIGHT = 900.0, 25.0, 45.0
_INNER_SD, _HIP_MOMENT_NM_KG = 0.5, 1.3
_OUTER_SD, _OUTER_WEIGHT, _BRAKING_WEIGHT = 0.95, 40.0, 160.0
# Least load of a foot in the middle of stance, body weights, by speed: about that of a sine with the wanted rise
_LEAST_VALLEY = (0.33, 0.43, 0.55), (0.78, 0.65, 0.57)
# Time from heel-off to toe-off, as a share of the step, that leaves a sole flat for as long as recorded ones, by speed
_EARLIEST_HEEL_OFF, _REST_WEIGHT = ((0.33, 0.43, 0.55), (0.44, 0.415, 0.46)), 1500.0
# Greatest load of both feet together, body weights, by speed; `opencap_walking` at 0.43: 1.32
_GREATEST_TOTAL = (0.23, 0.33, 0.43, 0.55), (1.10, 1.19, 1.28, 1.39)
_PEAK_WEIGHT = 250.0
_LOWERED_WEIGHT = 100.0  # 1/m, of what the legs' reach takes from the wanted height of the pelvis
# Centre of pressure behind which a motion that needs it a little farther back would leave the sole
_IN_LOADING = ("travel_2", "travel_3")
_MOST_TRAVEL = 1.36  # foremost centre of pressure, 9 mm behind where the flat part of the sole ends
_SIGMA = {
    "double_support": 0.006,
    "transfer": 0.06,
    "flat_after": 0.03,
    "heel_off_before": 0.08,
    "rise": 0.10,
    "pitch": 0.15,
    "travel": 0.08,
    "height": 0.003,
    "forward": 0.08,
    "lift": 0.08,
    "tilt": 0.08,
}


def double_support(pace: float) -> float:
    """Share of a step between the planned touch-down and toe-off.

    Toe-off is planned at 65.5, 63, 61, 59 and 57.5 % of the cycle in the five groups. The load begins and ends so
    gently that a force plate would see contact for 1-2 % less.
    """
    return float(np.interp(pace, [0.0, *_CLASS_CENTRES.values()], [0.40, 0.31, 0.255, 0.215, 0.18, 0.15]))


def ground_reaction(pace: float, share: float) -> Array:
    """(SAMPLES,) vertical reaction of one foot, body weights; with speed, its two peaks rise and its valley sinks."""
    peak1 = np.interp(pace, [0.1, 0.27, 0.43, 0.6], [1.0, 1.04, 1.12, 1.20])
    peak2 = np.interp(pace, [0.1, 0.27, 0.43, 0.6], [1.0, 1.04, 1.12, 1.16])
    valley = np.interp(pace, [0.1, 0.27, 0.37, 0.43, 0.6], [0.97, 0.88, 0.79, 0.75, 0.66])
    at = np.array([-0.15, 0.0, 0.10, 0.21, 0.34, 0.50, 0.66, 0.78, 0.90, 1.0, 1.15])
    middle = (peak1 + valley) / 2, (peak2 + valley) / 2
    load = np.array([0.0, 0.0, 0.66 * peak1, peak1, middle[0], valley, middle[1], peak2, 0.62 * peak2, 0.0, 0.0])
    stance = (1 + share) / 2
    return np.asarray(PchipInterpolator(at, load)(np.clip(np.arange(SAMPLES) / SAMPLES / stance, 0.0, 1.15)))


def norm(pace: float, quantity: str) -> tuple[Array, Array]:
    """(SAMPLES,) mean and SD of a level norm at the cycle's samples: the group's own, interpolated between groups."""
    own = pace / np.sqrt(NORM_LEG)
    at = np.arange(SAMPLES) * 100.0 / SAMPLES
    tables = [level_norm(group, quantity) for group in _CLASS_CENTRES]
    curves = [[np.interp(at, x, m), np.interp(at, x, s)] for x, m, s in tables]
    centres = np.array(list(_CLASS_CENTRES.values()))
    k = int(np.clip(np.searchsorted(centres, own) - 1, 0, len(centres) - 2))
    between = (own - centres[k]) / (centres[k + 1] - centres[k])
    share = np.clip(0.5 + _PASSING * (between - 0.5), 0.0, 1.0)
    mean, sd = (1 - share) * np.array(curves[k]) + share * np.array(curves[k + 1])
    return mean + (SHOE_DROP_DEG if quantity == _ANGLES["ankle"] else 0.0), sd


_ANGLES = {"hip": "hip_flexion_deg", "knee": "knee_flexion_deg", "ankle": "ankle_dorsiflexion_deg"}
_MOMENTS = {
    "hip": "hip_extension_moment_Nm_kg",
    "knee": "knee_extension_moment_Nm_kg",
    "ankle": "ankle_plantarflexion_moment_Nm_kg",
}


def residuals(cycle: Cycle, style: Style, pace: float) -> Array:
    """Residuals of a stride in approximate standard deviations per sample."""
    loose = max(1.0, _PACE_OF_WHOLE_NORM / pace) ** 1.5
    parts = []
    for joint, quantity in _ANGLES.items():
        mean, sd = norm(pace, quantity)
        away = (cycle.angles_deg[joint] - mean) / (sd * loose)
        beyond = [np.maximum(np.abs(away) - limit, 0.0) for limit in (_INNER_SD, _OUTER_SD)]
        parts += [0.6 * away, _ANGLE_WEIGHT * beyond[0], _OUTER_WEIGHT * beyond[1]]
    for joint, quantity in _MOMENTS.items():
        mean, sd = norm(pace, quantity)
        away = (cycle.moments[joint] - mean) / (sd * loose)
        parts += [0.05 * away, 0.3 * np.maximum(np.abs(away) - 2.5, 0.0)]
        parts.append(0.1 * np.diff(cycle.moments[joint], n=2, append=cycle.moments[joint][:2]) * SAMPLES**2 / 4e3)
    allowed = _HIP_MOMENT_NM_KG * min(pace / _RECORDED_PACE, 1.0)
    parts.append(_HIP_WEIGHT * np.maximum(np.abs(cycle.moments["hip"]) - allowed, 0.0))
    mean, sd = norm(pace, "pelvis_anterior_tilt_deg")
    parts.append(0.22 * (cycle.pelvis_tilt_deg - mean) / sd)
    parts.append(np.array([_RISE_WEIGHT * (cycle.rise / float(np.interp(pace, *_RISE)) - 1.0)]))
    wanted = ground_reaction(pace, float(style.double_support))
    away = (cycle.load - wanted) / 0.05
    parts += [0.6 * away, 1.5 * np.maximum(np.abs(away) - 1.2, 0.0)]
    stance = np.arange(SAMPLES) / SAMPLES / ((1 + float(style.double_support)) / 2)
    valley = (stance > 0.42) & (stance < 0.58)
    parts.append(150.0 * np.maximum(cycle.load - 1.16, 0.0))
    floor = float(np.interp(pace, *_LEAST_VALLEY))
    parts.append(60.0 * np.where(valley, np.maximum(cycle.load - 0.87, 0.0), 0.0))
    inner = (stance > 0.25) & (stance < 0.75)
    parts.append(200.0 * np.where(inner, np.maximum(floor - cycle.load, 0.0), 0.0))
    parts.append(_PEAK_WEIGHT * np.maximum(cycle.total - float(np.interp(pace, *_GREATEST_TOTAL)), 0.0))
    bend = np.diff(cycle.total, n=2, append=cycle.total[:2]) * SAMPLES**2 / 4e3
    parts.append(0.25 * bend)
    parts.append(_LOWERED_WEIGHT * cycle.lowered)
    swing = np.arange(SAMPLES) / SAMPLES
    off = (1 + float(style.double_support)) / 2
    share = (swing - off) / (1 - off)
    low = 0.014 * np.clip(np.minimum(share / 0.25, (1.0 - share) / 0.12), 0.0, 1.0)
    parts.append(600.0 * np.where(share > 0.0, np.maximum(low - cycle.sole, 0.0), 0.0))
    middle, early = (share > 0.35) & (share < 0.75), (share > 0.0) & (share < 0.35)
    parts.append(np.where(middle, 200.0 * np.maximum(cycle.sole - 0.035, 0.0), 0.0))
    parts.append(np.where(early, 100.0 * np.maximum(cycle.sole - 0.055, 0.0), 0.0))
    fastest = cycle.heel_speed.max() / (pace * np.sqrt(NOMINAL_GRAVITY_MPS2))
    # rates at an equal pace are in inverse proportion to the root of the leg's length
    rate = cycle.pitch_rate * np.sqrt(cycle.leg_m / _RECORDED_LEG_M)
    quick = rate.max() / (_TOE_OFF_RADPS * (pace / _RECORDED_PACE) ** 0.6)
    down = -rate.min() / (_SWING_RATE_RADPS * (pace / _RECORDED_PACE) ** 0.6)
    slap = rate[: SAMPLES // 10].max() / (_SLAP_RADPS * pace / _RECORDED_PACE)
    parts.append(
        np.array([4.0 * max(fastest - 3.6, 0.0), 500.0 * max(quick - 1.0, 0.0) + 150.0 * min(quick - 1.0, 0.0)])
    )
    parts.append(np.array([60.0 * max(down - 1.0, 0.0), 60.0 * max(slap - 1.0, 0.0)]))
    parts.append(_REST_WEIGHT * np.maximum([float(style.heel_off_before) - np.interp(pace, *_EARLIEST_HEEL_OFF)], 0.0))
    before = np.interp(
        1.0 - _LANDING_S / cycle.stride_s,
        np.arange(SAMPLES + 1) / SAMPLES,
        np.append(cycle.heel_speed, cycle.heel_speed[0]),
    )
    parts.append(
        np.array(
            [
                250.0
                * max(
                    before / (_LANDING_MPS * pace / _RECORDED_PACE * np.sqrt(cycle.leg_m / _RECORDED_LEG_M)) - 1.0, 0.0
                )
            ]
        )
    )
    # until the heel strikes
    hard = cycle.heel_acceleration / (_BRAKING_MPS2 * pace / _RECORDED_PACE)
    swinging = (share > 0.05) & (share < 0.93)
    parts += [
        np.where(swinging, gain * x, 0.0) for gain, x in ((5.0, hard), (_BRAKING_WEIGHT, np.maximum(hard - 1.0, 0.0)))
    ]
    return np.concatenate(parts)


def fit(pace: float, start: Array, prior: Array, bodies: list[Walker], rounds: int, fitted: NDArray[np.bool_]) -> Array:
    """Style at a dimensionless speed as a vector: damped Gauss-Newton from a start, drawn towards a prior.

    Only the entries that are `fitted`, (len(LABELS),), change.
    """
    sigma = np.concatenate([np.full(n, _SIGMA[name]) for name, n in SIZES.items()])
    x, prior = _bounded(start), prior.copy()
    if fitted[0]:
        prior[0] = x[0] = double_support(pace)

    def strides(y: Array, paths: list[Array | None], corrections: int) -> list[Cycle]:
        steps = [
            float(level_step_length(pace * np.sqrt(NOMINAL_GRAVITY_MPS2 * body.leg_m), body.size)) for body in bodies
        ]
        return [
            steady_cycle(
                body,
                Style.from_vector(y),
                m,
                m / (pace * np.sqrt(NOMINAL_GRAVITY_MPS2 * body.leg_m)),
                path,
                corrections,
            )
            for body, m, path in zip(bodies, steps, paths)
        ]

    def cost(y: Array, paths: list[Array | None], corrections: int) -> tuple[Array, list[Array | None]]:
        cycles = strides(y, paths, corrections)
        rows = [residuals(cycle, Style.from_vector(y), pace) for cycle in cycles]
        return np.concatenate([*rows, 0.9 * (y - prior) / sigma]), [cycle.over_ground for cycle in cycles]

    unknown: list[Array | None] = [None] * len(bodies)
    r, paths = cost(x, unknown, 4)
    damping = 20.0
    for _ in range(rounds):
        base, _ = cost(x, paths, 2)
        J = np.zeros((len(r), len(x)))
        for i in np.flatnonzero(fitted)[int(fitted[0]) :]:  # double support is fixed
            h = 0.02 * sigma[i]
            moved = x.copy()
            moved[i] += h
            there, _ = cost(moved, paths, 2)
            J[:, i] = (there - base) / h
        scale = J * sigma
        for _ in range(6):
            step = np.linalg.solve(scale.T @ scale + damping * np.eye(len(x)), -scale.T @ r)
            trial = _bounded(x + sigma * step / max(np.abs(step).max() / _STEP_SIGMAS, 1.0))
            held = (trial == x) & fitted  # at its bound: the other coordinates are solved without it
            scale[:, held] = 0.0
            r_trial, paths_trial = cost(trial, paths, 3)
            if r_trial @ r_trial < r @ r:
                break
            damping *= 6.0
        else:
            break
        better = 1.0 - (r_trial @ r_trial) / (r @ r)
        x, r, paths, damping = trial, r_trial, paths_trial, max(damping / 6.0, 0.1)
        print(f"  pace {pace:.2f} cost {r @ r:9.1f} damping {damping:.3g}", flush=True)
        if better < _SETTLED:
            break
    return x


def _bounded(x: Array) -> Array:
    """Style vector within the planner's limits: shares between 0 and 1, the centre of pressure under the sole."""
    style = Style.from_vector(x)
    low, high = np.full(len(x), -np.inf), np.full(len(x), np.inf)
    for label, (a, b) in {
        "transfer": (0.965, 1.0),
        "flat_after": (0.07, 0.112),
        "heel_off_before": (0.25, 0.65),
    }.items():
        low[LABELS.index(label)], high[LABELS.index(label)] = a, b
    for i, label in enumerate(LABELS):
        if label.startswith("travel"):
            low[i], high[i] = (-0.20 if label in _IN_LOADING else -0.27), _MOST_TRAVEL
        if label.startswith("rise"):
            low[i], high[i] = 0.0, 0.97
    assert len(style.to_vector()) == len(x)
    return np.clip(x, low, high)


def write(styles: Array) -> None:
    """Stores (len(PACES), n) styles as the table."""
    lines = ["# Styles of level walking by dimensionless speed, by `python -m tools.fit_gait_cycle`. Fields: style.py."]
    lines.append(",".join(["pace", *(f"{p:g}" for p in PACES)]))
    lines += [",".join([label, *(f"{v:.5g}" for v in column)]) for label, column in zip(LABELS, styles.T)]
    _TABLE.write_text("\n".join(lines) + "\n")


def main() -> None:
    """Fits all speeds in turn, each drawn towards the line through its neighbours, in several sweeps."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=6, help="Gauss-Newton steps a speed and sweep")
    parser.add_argument("--sweeps", type=int, default=1)
    parser.add_argument("--fields", nargs="+", choices=list(SIZES), help="fits these alone, from the table as it is")
    parser.add_argument(
        "--paces", nargs="+", type=float, choices=PACES, help="fits these alone, from the table as it is"
    )
    args = parser.parse_args()
    bodies = [Walker(person) for person in BODIES]
    vectors = np.array([style.to_vector() for style in START.values()])
    styles = np.array([np.interp(PACES, list(START), values) for values in vectors.T]).T
    fitted = np.ones(len(LABELS), dtype=bool)
    if args.fields or args.paces:
        styles = np.array([level_style(pace).to_vector() for pace in PACES])
        fitted = np.concatenate([np.full(n, name in (args.fields or SIZES)) for name, n in SIZES.items()])
    for _ in range(args.sweeps):
        for pace in args.paces or PACES:
            k = PACES.index(pace)
            styles[k] = fit(pace, styles[k], between_neighbours(styles, k), bodies, args.rounds, fitted)
            write(styles)


def between_neighbours(styles: Array, k: int) -> Array:
    """Style on the line through the two nearest other speeds."""
    i, j = sorted(range(len(PACES)), key=lambda other: abs(other - k))[1:3]
    share = (PACES[k] - PACES[i]) / (PACES[j] - PACES[i])
    return np.asarray((1.0 - share) * styles[i] + share * styles[j])


if __name__ == "__main__":
    main()
