"""Solves the styles of level walking, speed by speed, and writes sim/gait/level_style.csv.

Run as `python -m tools.fit_gait_cycle [--rounds N]` (about ten minutes). Least squares on one steady
stride of two bodies: deviations from the joint angles of Schwartz, Rozumalski & Trost 2008 in standard deviations, from
a smooth two-peaked ground reaction in body weights, hinges on knee margin, clearance, foot speed and moments, and weak
priors that keep neighbouring speeds alike.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from benchmarks.gait_norms import NORM_LEG, SHOE_DROP_DEG
from stridetwin.scenarios.norms import level_norm
from stridetwin.sim.config import Person
from stridetwin.sim.gait.style import GRAVITY, LABELS, SIZES, Style, level_style
from stridetwin.sim.gait.tempo import preferred_step
from stridetwin.streams.samples import Array
from tools.steady_cycle import SAMPLES, Cycle, Walker, steady_cycle

PACES = (0.26, 0.32, 0.38, 0.44)
BODIES = (
    Person(height_m=1.55, mass_kg=50, sex="female"), Person(height_m=1.83, mass_kg=85),
)  # fmt: skip
_TABLE = Path(__file__).parents[1] / "sim" / "gait" / "level_style.csv"
_CLASS_CENTRES = {"VerySlow": 0.17, "Slow": 0.295, "Free": 0.43, "Fast": 0.57, "VeryFast": 0.70}  # of the groups
_PACE_OF_WHOLE_NORM = 0.2  # people who creep use a part of the slowest group's range
_SIGMA = {
    "double_support": 0.006, "transfer": 0.06, "flat_after": 0.03, "heel_off_before": 0.08, "rise": 0.10, "pitch": 0.15,
    "travel": 0.08, "height": 0.01, "forward": 0.08, "lift": 0.08, "tilt": 0.08, "turn": 0.03, "list_": 0.02,
}  # fmt: skip


def double_support(pace: float) -> float:
    """Share of a step, from toe-off at 66, 63, 60, 58.5 and 57 % of the cycle in the five groups."""
    return float(np.interp(pace, [0.0, *_CLASS_CENTRES.values()], [0.40, 0.32, 0.26, 0.20, 0.17, 0.14]))


def ground_reaction(pace: float, share: float) -> Array:
    """(SAMPLES,) vertical reaction of one foot, body weights: two peaks that grow, a valley that sinks with speed."""
    peak1 = np.interp(pace, [0.1, 0.27, 0.43, 0.6], [1.0, 1.04, 1.12, 1.20])
    peak2 = np.interp(pace, [0.1, 0.27, 0.43, 0.6], [1.0, 1.04, 1.12, 1.16])
    valley = np.interp(pace, [0.1, 0.27, 0.37, 0.43, 0.6], [0.97, 0.88, 0.79, 0.75, 0.66])
    at = np.array([-0.15, 0.0, 0.10, 0.21, 0.34, 0.50, 0.66, 0.78, 0.90, 1.0, 1.15])
    middle = (peak1 + valley) / 2, (peak2 + valley) / 2
    load = np.array([0.0, 0.0, 0.66 * peak1, peak1, middle[0], valley, middle[1], peak2, 0.62 * peak2, 0.0, 0.0])
    stance = (1 + share) / 2
    return np.asarray(PchipInterpolator(at, load)(np.clip(np.arange(SAMPLES) / SAMPLES / stance, 0.0, 1.15)))


def norm(pace: float, quantity: str) -> tuple[Array, Array]:
    """(SAMPLES,) mean and SD of a level norm between the groups' centres, at the cycle's samples."""
    own = pace / np.sqrt(NORM_LEG)
    at = np.arange(SAMPLES) * 100.0 / SAMPLES
    tables = [level_norm(group, quantity) for group in _CLASS_CENTRES]
    curves = [[np.interp(at, x, m), np.interp(at, x, s)] for x, m, s in tables]
    centres = np.array(list(_CLASS_CENTRES.values()))
    k = int(np.clip(np.searchsorted(centres, own) - 1, 0, len(centres) - 2))
    share = np.clip((own - centres[k]) / (centres[k + 1] - centres[k]), 0.0, 1.0)
    mean, sd = (1 - share) * np.array(curves[k]) + share * np.array(curves[k + 1])
    return mean + (SHOE_DROP_DEG if quantity == _ANGLES["ankle"] else 0.0), sd


_ANGLES = {"hip": "hip_flexion_deg", "knee": "knee_flexion_deg", "ankle": "ankle_dorsiflexion_deg"}
_MOMENTS = {
    "hip": "hip_extension_moment_Nm_kg", "knee": "knee_extension_moment_Nm_kg",
    "ankle": "ankle_plantarflexion_moment_Nm_kg",
}  # fmt: skip
_PELVIS = {
    "pelvis_anterior_tilt_deg": lambda angles: angles[:, 1],
    "pelvis_obliquity_deg": lambda angles: angles[:, 2],
    "pelvis_rotation_deg": lambda angles: -angles[:, 0],
}


def residuals(cycle: Cycle, style: Style, pace: float) -> Array:
    """What a stride costs, in about standard deviations a sample."""
    loose = max(1.0, _PACE_OF_WHOLE_NORM / pace) ** 1.5
    parts = []
    for joint, quantity in _ANGLES.items():
        mean, sd = norm(pace, quantity)
        away = (cycle.angles_deg[joint] - mean) / (sd * loose)
        parts += [0.6 * away, 5.0 * np.maximum(np.abs(away) - 0.75, 0.0), 10.0 * np.maximum(np.abs(away) - 1.5, 0.0)]
    for joint, quantity in _MOMENTS.items():
        mean, sd = norm(pace, quantity)
        away = (cycle.moments[joint] - mean) / (sd * loose)
        parts += [0.05 * away, 0.3 * np.maximum(np.abs(away) - 2.5, 0.0)]
        parts.append(0.1 * np.diff(cycle.moments[joint], n=2, append=cycle.moments[joint][:2]) * SAMPLES**2 / 4e3)
    parts.append(3.0 * np.maximum(np.abs(cycle.moments["hip"]) - 1.3, 0.0))
    for quantity, angle in _PELVIS.items():
        mean, sd = norm(pace, quantity)
        parts.append(0.15 * (angle(cycle.pelvis_deg) - mean) / sd)
    wanted = ground_reaction(pace, float(style.double_support))
    away = (cycle.load - wanted) / 0.05
    parts += [0.6 * away, 1.5 * np.maximum(np.abs(away) - 1.2, 0.0)]
    stance = np.arange(SAMPLES) / SAMPLES / ((1 + float(style.double_support)) / 2)
    valley = (stance > 0.42) & (stance < 0.58)
    parts.append(60.0 * np.maximum(cycle.load - 1.18, 0.0))
    parts.append(60.0 * np.where(valley, np.maximum(cycle.load - 0.87, 0.0), 0.0))
    bend = np.diff(cycle.total, n=2, append=cycle.total[:2]) * SAMPLES**2 / 4e3
    parts.append(0.25 * bend)
    # the reach is linear where the angle of a straight knee is not
    parts += [6000.0 * cycle.excess, 3e4 * np.maximum(cycle.excess - 4e-4, 0.0)]
    swing = np.arange(SAMPLES) / SAMPLES
    off = (1 + float(style.double_support)) / 2
    share = (swing - off) / (1 - off)
    low = 0.014 * np.clip(np.minimum(share / 0.25, (1.0 - share) / 0.12), 0.0, 1.0)
    parts.append(600.0 * np.where(share > 0.0, np.maximum(low - cycle.sole, 0.0), 0.0))
    middle = (share > 0.35) & (share < 0.75)
    parts.append(np.where(middle, 200.0 * np.maximum(cycle.sole - 0.045, 0.0), 0.0))
    fastest = cycle.heel_speed.max() / (pace * np.sqrt(GRAVITY))
    parts.append(np.array([4.0 * max(fastest - 3.6, 0.0), 0.01 * max(np.degrees(cycle.pitch_rate).max() - 600.0, 0.0)]))
    return np.concatenate(parts)


def fit(pace: float, prior: Array, bodies: list[Walker], rounds: int) -> Array:
    """Style at a dimensionless speed as a vector: damped Gauss-Newton from a prior."""
    sigma = np.concatenate([np.full(n, _SIGMA[name]) for name, n in SIZES.items()])
    x, prior = prior.copy(), prior.copy()
    prior[0] = x[0] = double_support(pace)
    paths: list[Array | None] = [None] * len(bodies)

    def cost(y: Array, starts: list[Array | None], corrections: int) -> tuple[Array, list[Array | None]]:
        style, rows, ends = Style.of_vector(y), [], []
        for body, start in zip(bodies, starts):
            step_m = preferred_step(pace * np.sqrt(GRAVITY * body.leg_m), body.size)
            step_s = step_m / (pace * np.sqrt(GRAVITY * body.leg_m))
            cycle = steady_cycle(body, style, step_m, step_s, start, corrections)
            rows.append(residuals(cycle, style, pace))
            ends.append(cycle.over_ground)
        return np.concatenate([*rows, 0.9 * (y - prior) / sigma]), ends

    r, paths = cost(x, paths, 4)
    damping = 20.0
    for _ in range(rounds):
        base, _ = cost(x, paths, 1)
        J = np.empty((len(r), len(x)))
        for i in range(len(x)):
            h = 0.02 * sigma[i]
            moved = x.copy()
            moved[i] += h
            there, _ = cost(moved, paths, 1)
            J[:, i] = (there - base) / h
        scale = J * sigma
        for _ in range(6):
            step = sigma * np.linalg.solve(scale.T @ scale + damping * np.eye(len(x)), -scale.T @ r)
            trial = _bounded(x + np.clip(step, -sigma, sigma))
            held = trial == x  # at its bound: the others step as if it were not there
            scale[:, held] = 0.0
            r_trial, paths_trial = cost(trial, paths, 3)
            if r_trial @ r_trial < r @ r:
                break
            damping *= 6.0
        else:
            break
        better = 1.0 - (r_trial @ r_trial) / (r @ r)
        x, r, paths, damping = trial, r_trial, paths_trial, max(damping / 4.0, 0.1)
        print(f"  pace {pace:.2f} cost {r @ r:9.1f} damping {damping:.3g}", flush=True)
        if better < 2e-3:
            break
    return x


def _bounded(x: Array) -> Array:
    """Style vector within what the planner takes: shares between 0 and 1, the centre of pressure under the sole."""
    style = Style.of_vector(x)
    low, high = np.full(len(x), -np.inf), np.full(len(x), np.inf)
    for label, (a, b) in {"transfer": (0.75, 1.0), "flat_after": (0.06, 0.3), "heel_off_before": (0.25, 0.65)}.items():
        low[LABELS.index(label)], high[LABELS.index(label)] = a, b
    for i, label in enumerate(LABELS):
        if label.startswith("travel"):
            low[i], high[i] = -0.27, 1.42
        if label.startswith("rise"):
            low[i], high[i] = 0.0, 0.97
    assert len(style.vector()) == len(x)
    return np.clip(x, low, high)


def table() -> tuple[Array, Array]:
    """Paces (K,) and style vectors (K, n) of the stored table."""
    rows = [line.split(",") for line in _TABLE.read_text().splitlines() if line and not line.startswith("#")]
    values = {row[0]: [float(v) for v in row[1:]] for row in rows}
    return np.array(values["pace"]), np.array([values[label] for label in LABELS]).T


def write(paces: Array, styles: Array) -> None:
    """Stores the table."""
    lines = ["# Styles of level walking by dimensionless speed, by `python -m tools.fit_gait_cycle`. Fields: style.py."]
    lines.append(",".join(["pace", *(f"{p:g}" for p in paces)]))
    lines += [",".join([label, *(f"{v:.5g}" for v in column)]) for label, column in zip(LABELS, styles.T)]
    _TABLE.write_text("\n".join(lines) + "\n")


def main() -> None:
    """Fits from the middle speed outwards, each from its neighbour's result."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--rounds", type=int, default=12, help="Gauss-Newton steps a speed; 3 times as many at the first"
    )
    args = parser.parse_args()
    bodies = [Walker(person) for person in BODIES]
    middle = PACES.index(0.38)
    found = {middle: fit(PACES[middle], level_style(PACES[middle]).vector(), bodies, 2 * args.rounds)}
    for order in (range(middle + 1, len(PACES)), range(middle - 1, -1, -1)):
        for k in order:
            nearest = min(found, key=lambda j: abs(j - k))
            found[k] = fit(PACES[k], found[nearest], bodies, args.rounds)
            done = sorted(found)
            write(np.array([PACES[j] for j in done]), np.array([found[j] for j in done]))


if __name__ == "__main__":
    main()
