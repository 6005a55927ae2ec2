"""How pelvis, chest and head turn and tilt with every stride, by speed and by ground.

Each angle is a sum of harmonics of the stride, Σ A_k cos(k ψ + φ_k); ψ is the phase of the stride, 0 at a touch-down of
the left foot and 2π at the next. Amplitudes and phases are those of the step: of its speed on the level, of its kind on
a stair, a mixture on a ramp. They change smoothly from step to step and vanish where the walker stands. A walker has
their own amplitudes and phases, and each step differs a little.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.gait.footsteps import SETTLE_S, WEIGHT_SHIFT_S, Footstep, Rhythm
from stridetwin.sim.kinematics.smooth import ease
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Array

ComplexArray = NDArray[np.complex128]

ANGLES = tuple(f"{body}_{angle}" for body in ("pelvis", "chest", "head") for angle in ("yaw", "pitch", "roll"))
"""Angles in the world, relative to the way: yaw to the left, pitch forward and down, roll with the left side up."""
HARMONICS = (1, 2, 3, 8)
"""Of the stride. The eighth, at 4 to 7 Hz, stands for the head's motion after each step of a stair."""

Polar = tuple[float, float]
"""Amplitude, degrees, and phase, degrees, of a harmonic: A cos(k ψ + φ)."""


def _pelvis_by_speed() -> Mapping[str, Mapping[int, tuple[Polar, ...]]]:
    """Harmonics of the mean curves of the pelvis in five groups of speed (reference/gait_norms_level.csv)."""
    return {
        "pelvis_yaw": {
            1: ((4.56, 116.0), (3.59, 134.0), (4.29, 151.0), (5.87, 159.0), (7.01, 172.0)),
            3: ((0.41, 141.0), (0.28, -168.0), (0.50, -132.0), (0.89, -140.0), (1.02, -148.0)),
        },
        "pelvis_pitch": {2: ((0.36, -103.0), (0.46, 31.0), (0.82, 60.0), (1.09, 83.0), (1.59, 94.0))},
        "pelvis_roll": {
            1: ((2.00, -17.0), (2.12, -40.0), (2.81, -49.0), (4.13, -52.0), (5.11, -58.0)),
            3: ((0.53, 177.0), (0.95, -170.0), (1.20, -169.0), (1.26, -178.0), (1.16, 160.0)),
        },
    }


def _upper_body_by_speed() -> Mapping[str, Mapping[int, tuple[Polar, ...]]]:
    """Harmonics of chest and head on the level at the same speeds."""
    return {
        "chest_yaw": {1: ((2.4, 80.0), (2.5, 50.0), (2.6, 25.0), (2.8, 20.0), (3.0, 15.0))},
        "chest_pitch": {2: ((0.7, 68.0), (1.1, 68.0), (1.6, 68.0), (1.9, 68.0), (2.3, 68.0))},
        "chest_roll": {
            1: ((0.9, 93.0), (0.95, 93.0), (1.0, 93.0), (1.1, 93.0), (1.2, 93.0)),
            3: ((0.3, 34.0), (0.4, 34.0), (0.55, 34.0), (0.6, 34.0), (0.6, 34.0)),
        },
        "head_yaw": {1: ((1.7, 70.0), (1.9, 70.0), (2.1, 70.0), (2.3, 70.0), (2.4, 70.0))},
        "head_roll": {
            1: ((0.8, 93.0), (0.85, 93.0), (0.9, 93.0), (1.0, 93.0), (1.1, 93.0)),
            3: ((0.15, 34.0), (0.2, 34.0), (0.3, 34.0), (0.35, 34.0), (0.4, 34.0)),
        },
    }


def _up_a_stair() -> Mapping[str, Mapping[int, Polar]]:
    """Harmonics of `stair_up`."""
    return {
        "pelvis_yaw": {1: (7.2, 28.0), 2: (0.6, -92.0)},
        "pelvis_pitch": {1: (0.9, -85.0), 2: (2.6, -174.0)},
        "pelvis_roll": {1: (5.4, -8.0), 3: (0.4, 125.0)},
        "chest_yaw": {1: (7.6, 16.0), 2: (0.8, -106.0)},
        "chest_pitch": {1: (1.0, -123.0), 2: (1.9, 153.0)},
        "chest_roll": {1: (3.7, 48.0)},
        "head_yaw": {1: (4.2, 5.0), 3: (0.4, 51.0), 8: (0.17, 0.0)},
        "head_pitch": {1: (1.2, -84.0), 2: (1.8, 119.0), 8: (0.22, 90.0)},
        "head_roll": {1: (2.4, 66.0), 8: (0.17, 180.0)},
    }


def _down_a_stair() -> Mapping[str, Mapping[int, Polar]]:
    """Harmonics down a stair, chosen by hand."""
    return {
        "pelvis_yaw": {1: (5.0, 180.0)},
        "pelvis_pitch": {1: (0.6, 90.0), 2: (1.8, 0.0)},
        "pelvis_roll": {1: (4.0, 172.0), 3: (0.5, 0.0)},
        "chest_yaw": {1: (5.0, 25.0)},
        "chest_pitch": {2: (1.6, 153.0)},
        "chest_roll": {1: (2.6, 60.0)},
        "head_yaw": {1: (3.2, 30.0), 8: (0.17, 0.0)},
        "head_pitch": {1: (0.9, -84.0), 2: (1.7, 119.0), 8: (0.22, 90.0)},
        "head_roll": {1: (1.9, 66.0), 8: (0.17, 180.0)},
    }


@dataclass(frozen=True, kw_only=True)
class SwayParameters:
    """Harmonics of the stride by speed and ground, and how people and steps differ.

    Recordings are of one person each: `opencap_walking` on the level at 1.3 m/s, `stair_up` on risers of 163 mm;
    harmonics by least squares, of markers below 8 Hz.
    """

    paces: tuple[float, ...] = (0.167, 0.290, 0.423, 0.561, 0.688)
    """Speeds as v / sqrt(g leg) at which `pelvis` and `upper_body` hold: the centres of the groups of Schwartz,
    Rozumalski & Trost 2008 (J Biomech 41:1639-1650)."""
    pelvis: Mapping[str, Mapping[int, tuple[Polar, ...]]] = field(default_factory=_pelvis_by_speed)
    """Amplitudes and phases of the pelvis by angle and harmonic: the mean curves of Schwartz et al. 2008."""
    pelvis_gain: float = 1.15
    """Factor on these: a mean curve over people whose phases differ is flatter than any of theirs. By hand; the pelvis
    of `opencap_walking` turns by 13.7° (mean curve 8.9°) and tilts sideways by 8.8° (8.2°)."""
    upper_body: Mapping[str, Mapping[int, tuple[Polar, ...]]] = field(default_factory=_upper_body_by_speed)
    """The same of chest and head. The chest is that of `opencap_walking` at 0.44. Over speed, it turns with the pelvis
    when walking slowly and against it from 1.2 m/s on, hardly farther (Lamoth et al. 2002, Eur Spine J 11:13-19;
    Bruijn et al. 2008, J Exp Biol 211:3467-3473), and pitches more (Thorstensson et al. 1984, Acta Physiol Scand
    121:9-22). The head turns against its sway to the side (Imai et al. 2001, Exp Brain Res 136:1-18) and rolls with
    the chest, by as much as 0.65 of it on `stair_up` and 0.9 on the level; by hand."""
    stair_up: Mapping[str, Mapping[int, Polar]] = field(default_factory=_up_a_stair)
    """Up a stair: `stair_up`. Its pitches, which have no clear period, are 1.3 times their harmonics; the eighth
    harmonics have the recorded angular rate of 3.5-8 Hz, and phases by hand."""
    stair_down: Mapping[str, Mapping[int, Polar]] = field(default_factory=_down_a_stair)
    """Down a stair, by hand: the pelvis turns and drops with the foot that reaches down."""
    stair_slope_rad: float = 0.5
    """Slope at which a ramp is walked like a stair; in between, both mix linearly. That of `stair_up`."""
    fixation_m: float = 0.9
    """Distance ahead of the head to which it points while it rises and falls, m (Hirasaki et al. 1999, Exp Brain Res
    127:117-130: about 1 m)."""
    person_log_sd: float = 0.12
    """SD of the logarithm of a walker's amplitudes. By hand."""
    rise_log_sd: float = 0.05
    """SD of the logarithm of a walker's rise: it is bound to the length of leg and step. By hand."""
    person_phase_deg: float = 8.0
    """SD of the phase of each of a walker's angles, degrees of the stride. By hand."""
    unevenness: float = 0.12
    """SD of the harmonics that exist because left and right steps differ, relative to the largest of the angle.
    `opencap_walking`: 0.1-0.3."""
    step_sd: float = 0.07
    """SD of a step's amplitudes relative to the walker's, and of its phases in rad. By hand."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sway:
    """The sway of one walk: values of each step.

    Attributes:
        harmonics: (K, 9, 4) complex amplitudes of `ANGLES` and `HARMONICS`, rad.
        rise: (K,) rise and fall of the pelvis relative to the style's.
        fixation_m: Distance ahead of the head to which it points while it rises and falls.
    """

    harmonics: ComplexArray
    rise: Array
    fixation_m: float

    def angles(self, rhythm: Rhythm, t: Array) -> dict[str, Array]:
        """(N,) rad by name of `ANGLES`, at (N,) uniform s: 0 while the walker stands at either end."""
        # a stride is two steps; the left foot touches down at phase 1 if it makes the first step, otherwise at 2
        psi = np.pi * (rhythm.phase(t) - float(rhythm.steps[0].foot == "l"))
        waves = np.exp(1j * np.outer(psi, HARMONICS))
        # values hold in the middle of their steps; in quiet stance before and after, 0
        knots = np.concatenate(
            [[rhythm.begin[0] - WEIGHT_SHIFT_S / 2], (rhythm.begin + rhythm.end) / 2, [rhythm.end[-1] + SETTLE_S / 2]]
        )
        still = np.zeros((1, *self.harmonics.shape[1:]))
        values = np.concatenate([still, self.harmonics, still])
        row = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 2)
        share = ease((t - knots[row]) / (knots[row + 1] - knots[row]))
        angles = {}
        for i, name in enumerate(ANGLES):
            angle = np.zeros(len(t))
            for k in np.flatnonzero(values[:, i].any(axis=0)):
                value = values[:, i, k]
                angle += ((value[row] + share * (value[row + 1] - value[row])) * waves[:, k]).real
            angles[name] = angle
        return angles


def plan_sway(rhythm: Rhythm, leg_m: float, rng: np.random.Generator, parameters: SwayParameters | None = None) -> Sway:
    """Sway of a walker who makes these steps.

    Args:
        rhythm: Steps.
        leg_m: Hip centre to sole, m.
        rng: Draws the walker's own amplitudes and phases, and the differences between steps.
        parameters: Harmonics, and how people and steps differ; None for the usual ones.
    """
    known = parameters or SwayParameters()
    person = np.exp(known.person_log_sd * rng.standard_normal(len(ANGLES)))
    # a later angle: its harmonics turn by the phase times their number
    late = np.radians(known.person_phase_deg) * rng.standard_normal(len(ANGLES))
    own = person[:, None] * np.exp(1j * np.outer(late, HARMONICS))
    uneven = known.unevenness * (rng.standard_normal(len(ANGLES)) + 1j * rng.standard_normal(len(ANGLES)))
    rise_of_person, fixation_of_person = np.exp([known.rise_log_sd, known.person_log_sd] * rng.standard_normal(2))
    drawn = rng.standard_normal((len(rhythm.steps), len(ANGLES) + 1, 2))
    differ = 1.0 + known.step_sd * (drawn[..., 0] + 1j * drawn[..., 1])
    paces = _paces(rhythm, leg_m)
    harmonics = _mean_harmonics(rhythm.steps, paces, known)
    harmonics = harmonics * own + _uneven_harmonics(harmonics) * uneven[:, None]
    return Sway(
        harmonics=harmonics * differ[:, :-1, None],
        rise=rise_of_person * differ[:, -1].real,
        fixation_m=known.fixation_m * float(fixation_of_person),
    )


def _paces(rhythm: Rhythm, leg_m: float) -> Array:
    """(K,) speed of each step as v / sqrt(g leg), shared with its neighbours; low for a step with a pause."""
    speeds = np.abs(np.diff([0.0, *(step.s for step in rhythm.steps)])) / (rhythm.end - rhythm.begin)
    shared = np.convolve(np.pad(speeds, 1, mode="edge"), (0.25, 0.5, 0.25), mode="valid")
    return np.minimum(speeds, shared) / np.sqrt(NOMINAL_GRAVITY_MPS2 * leg_m)


def _mean_harmonics(steps: Sequence[Footstep], paces: Array, known: SwayParameters) -> ComplexArray:
    """(K, 9, 4) complex amplitudes of the mean walker in each step, rad.

    Args:
        steps: (K) steps.
        paces: (K,) their speeds as v / sqrt(g leg).
        known: Harmonics by speed and ground.
    """
    stair = {1.0: _of_polar(known.stair_up), -1.0: _of_polar(known.stair_down)}
    # in proportion to speed below the first group's
    by_speed = np.stack(
        [np.zeros_like(stair[1.0])]
        + [
            known.pelvis_gain * _of_polar(_at_group(known.pelvis, i)) + _of_polar(_at_group(known.upper_body, i))
            for i in range(len(known.paces))
        ]
    )
    speeds = np.array([0.0, *known.paces])
    row = np.clip(np.searchsorted(speeds, paces) - 1, 0, len(speeds) - 2)
    share = np.minimum((paces - speeds[row]) / (speeds[row + 1] - speeds[row]), 1.0)[:, None, None]
    level = by_speed[row] + share * (by_speed[row + 1] - by_speed[row])
    # a runner's pelvis tilts at other times than a walker's, and hardly (Schache et al. 1999, Hum Mov Sci 18:725-761);
    # so does that of a walker about to run
    is_run = np.array([step.is_run for step in steps])
    level[is_run | np.append(is_run[1:], False), ANGLES.index("pelvis_pitch")] = 0.0
    # 1 up a stair, −1 down a stair, between on ramps
    climbs = np.array([_climb(step, known.stair_slope_rad) for step in steps])
    # the foot that closes up to a landing leaves a tread: it rises or falls by one riser instead of two
    stairs = np.append(0.0, [np.trunc(climb) for climb in climbs[:-1]])
    climbs = np.where(climbs == 0.0, stairs / 2.0, climbs)
    on_stair = np.stack([stair[1.0 if climb >= 0.0 else -1.0] for climb in climbs])
    return level + np.abs(climbs)[:, None, None] * (on_stair - level)


def _climb(step: Footstep, stair_slope_rad: float) -> float:
    """Share of a step that is walked like one up a stair; negative for one down a stair."""
    on_stair = {"SA": 1.0, "SD": -1.0}
    return on_stair.get(step.mode, float(np.clip(step.slope / stair_slope_rad, -1.0, 1.0)))


def _at_group(table: Mapping[str, Mapping[int, tuple[Polar, ...]]], i: int) -> Mapping[str, Mapping[int, Polar]]:
    """Amplitudes and phases of the i-th group of speed of a table by angle and harmonic."""
    return {name: {k: polar[i] for k, polar in rows.items()} for name, rows in table.items()}


def _of_polar(table: Mapping[str, Mapping[int, Polar]]) -> ComplexArray:
    """(9, 4) complex amplitudes, rad, of amplitudes and phases in degrees by angle and harmonic."""
    values = np.zeros((len(ANGLES), len(HARMONICS)), dtype=complex)
    for name, harmonics in table.items():
        for k, (amplitude, phase) in harmonics.items():
            values[ANGLES.index(name), HARMONICS.index(k)] = np.radians(amplitude) * np.exp(1j * np.radians(phase))
    return values


def _uneven_harmonics(harmonics: ComplexArray) -> ComplexArray:
    """(K, 9, 4) largest amplitude of each angle, in the harmonic that even left and right steps would not have.

    Pitch has even harmonics alone, and gets the first; yaw and roll have odd ones, and get the second.
    """
    largest = np.abs(harmonics).max(axis=2)
    values = np.zeros_like(harmonics)
    for i, name in enumerate(ANGLES):
        values[:, i, HARMONICS.index(1 if name.endswith("pitch") else 2)] = largest[:, i]
    return values
