"""Heel-strike vibration: motion of a shoe's upper relative to the foot, at impacts and during stance.

The foot of a planned walk does not vibrate when it lands and does not move in stance. A real shoe does: its upper,
which carries the sensors, vibrates relative to the foot after the heel strike and again when the ball slaps down. It
settles in the first quarter of a second of stance, leans by some degrees while the foot bears the load, and rocks; it
rolls over and gives way as the load passes from heel to ball, springs back at toe-off, and sways while the wearer
stands. Here this is a small motion of the upper relative to the foot, twice differentiable in time, so that
accelerometer, gyroscope and ground truth agree. What a strike causes decays before the foot leaves the ground. The
parameters are fitted to recorded walks by `tools/fit_heel_strike.py`; shoes and mounts differ from person to person
(`draw_shoes`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.kinematics import smooth
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.walk import Stance
from stridetwin.streams.algebra.arrays import cross
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(__file__, smooth.__file__)
ease, ease_rate = numba.njit(**INNER_KERNEL)(smooth.ease), numba.njit(**INNER_KERNEL)(smooth.ease_rate)


@dataclass(frozen=True, kw_only=True, eq=False)
class ShoeParameters:
    """Motion of a shoe's upper on its foot; axes of the foot: forward, left, up.

    Attributes:
        mode_hz: (K,) frequency of each mode that a strike excites.
        mode_decay_s: (K,) decay time of each mode to 1/e.
        mode_force: (K, 3) m/s², amplitude of the acceleration, at the reference speed of impact.
        mode_rate: (K, 3) rad/s, amplitude of the angular rate, at that speed.
        impact_mps: Reference speed of impact: speed of the foot `BEFORE_S` before touch-down.
        strike_sd: Standard deviation of the logarithm of a strike's strength.
        slap: Strength of the ball's slap relative to that of the heel strike.
        snap: Strength of the shoe that springs back at toe-off, relative to the strike.
        rock_hz: (M,) frequencies of the motion in stance.
        rock_rate: (M, 3) rad/s, amplitude of its angular rate.
        strength: Softest and hardest strike relative to the reference.
        blow_s: Time after the strike at which all modes accelerate upward together.
        jitter_rad: SD of a mode's phase from strike to strike: the strikes of a foot are similar.
        slap_rad: Pitch of the sole against the ground at which the ball slaps down.
        fade_s: Fade-in and fade-out of rocking.
        rock_s: A longer stance is still after this time.
        ground_m: (3,) pivot of rocking in the foot's frame.
        settle_rad: (3,) mean rotation that is left at the landing and settles.
        settle_sd_rad: (3,) its standard deviation from strike to strike.
        settle_s: Times in which it comes about, and in which it settles.
        lean_rad: (3,) rotation while the foot bears the load.
        lean_sd: Standard deviation of the lean from stance to stance, relative to the lean.
        roll_rad: (3,) rotation from the landing to the end of a walking stance, while the load passes to the ball.
        roll_sd: Standard deviation of the roll from stance to stance, relative to the roll.
        give_m: (3,) displacement in the same time: the sole gives way, and the foot moves forward in the shoe.
        give_sd_m: (3,) its standard deviation from stance to stance.
        roll_m: Where it pivots on the ground, forward in the foot's frame, at its beginning and at its end.
        sway_hz: (W,) frequencies of the motion while the wearer stands.
        sway_rate: (W, 3) rad/s, amplitude of its angular rate.
    """

    mode_hz: Array
    mode_decay_s: Array
    mode_force: Array
    mode_rate: Array
    impact_mps: float
    strike_sd: float
    slap: float
    rock_hz: Array
    rock_rate: Array
    snap: float = 0.0
    strength: tuple[float, float] = (0.15, 2.0)
    blow_s: float = 0.007
    jitter_rad: float = 0.5
    slap_rad: float = 0.02
    fade_s: float = 0.10
    rock_s: float = 0.9
    ground_m: tuple[float, float, float] = (0.060, 0.0, 0.0)
    settle_rad: Array = field(default_factory=lambda: np.zeros(3))
    settle_sd_rad: Array = field(default_factory=lambda: np.zeros(3))
    settle_s: tuple[float, float] = (0.05, 0.17)
    lean_rad: Array = field(default_factory=lambda: np.zeros(3))
    lean_sd: float = 0.1
    roll_rad: Array = field(default_factory=lambda: np.zeros(3))
    roll_sd: float = 0.3
    give_m: Array = field(default_factory=lambda: np.zeros(3))
    give_sd_m: Array = field(default_factory=lambda: np.zeros(3))
    roll_m: tuple[float, float] = (-0.03, 0.15)
    sway_hz: Array = field(default_factory=lambda: np.ones(1))
    sway_rate: Array = field(default_factory=lambda: np.zeros((1, 3)))


SHOE = ShoeParameters(
    mode_hz=np.array([17.0, 34.0, 68.0]),
    mode_decay_s=np.array([0.030, 0.008, 0.040]),
    mode_force=np.array([[0.0, 34.5, 52.8], [0.0, 0.0, 187.4], [15.9, 24.6, 25.1]]),
    mode_rate=np.array([[5.26, 0.0, 2.75], [14.40, 10.20, 5.28], [2.56, 0.79, 2.27]]),
    impact_mps=1.10,
    strike_sd=0.40,
    slap=0.60,
    snap=0.20,
    rock_hz=np.array([2.5, 5.0, 10.0]),
    rock_rate=np.array([[0.107, 0.097, 0.115], [0.060, 0.022, 0.036], [0.058, 0.021, 0.034]]),
    settle_rad=np.array([0.0, -0.075, 0.0]),
    settle_sd_rad=np.array([0.035, 0.020, 0.025]),
    give_sd_m=np.array([0.002, 0.002, 0.002]),
    sway_hz=np.array([0.4, 1.0, 2.3]),
    sway_rate=np.full((3, 3), 0.005),
)
"""A walking shoe with the sensor clipped to it, at 1.3 m/s: `dual_foot_walk` of gaitmap's example data (MIT), both
feet, 56 strikes of one person. The settling is chosen for the angular rate of these feet after 0.1 s of stance, the
slap, the slowest mode and the size of the others for `benchmarks.driven_feet`, `realism` and `people_feet` together,
the sway for the rates while this person stands at the end (0.01 rad/s). Of the fitted rocking
the slow part is 0.9 times as large, as shoes also roll over, and the fast part 1.25 times, for rates and forces in the
stillest 25, 50, 100 and 150 ms of the stances of `foot_imu_vicon`."""


# How shoes and mounts differ from person to person, relative to `SHOE`; chosen by hand, so that the strikes cover those
# of `dual_foot_walk` and of the softer shoes and filtered sensors of `foot_imu_vicon` (`benchmarks.people_feet`).
_STRENGTH, _STRENGTH_SD = 0.85, 0.35  # median, and SD of the logarithm
_STRENGTH_LIMITS = (0.25, 1.5)
_PITCH_SD, _DAMPING_SD, _ROCKING_SD = 0.15, 0.25, 0.25  # SD of the logarithms of frequency, decay time and rocking
# Largest exponent by which a padded mount passes less of the faster modes: 0 is the hard clip of `dual_foot_walk`; the
# spectra of `foot_imu_vicon` fall with about 1 between 20 and 70 Hz.
_PADDING = 0.8
# Sway of people who stand, and SD of its logarithm: the rates of `foot_imu_vicon` in 18 rests of 1.6 to 13 s have 0.005
# rad/s in each of three octaves about these frequencies in the median, and 0.01 in the mean, which two recordings of
# people who do not stand quietly raise: they are left out of the scatter.
_SWAY, _SWAY_SD = 0.9, 0.4
_LEAN_SD_RAD = (0.030, 0.025, 0.015)  # of the mount of one shoe about forward, left, up
# Roll of a left shoe, and its SD from shoe to shoe: rates in the middle of stance of 0.02 to 0.2 rad/s toward the toes,
# 0.05 outward (pronation) and 0.1 inward about the vertical, in the medians of 18 feet (`foot_imu_vicon`,
# `dual_foot_walk`, `foot_imu_other`; `benchmarks.people_beside_twin`). A right shoe rolls as its mirror image.
_ROLL_RAD, _ROLL_SD_RAD = (0.015, 0.030, -0.020), (0.015, 0.015, 0.015)
# Give of a shoe, and its SD from shoe to shoe: in the middle of stance the markers of `foot_imu_vicon` move forward at
# 10 mm/s and sink at 6, of which the roll explains half of the first and nothing of the second. Without their noise
# they scatter by some 7 mm/s from stance to stance.
_GIVE_M, _GIVE_SD_M = (0.002, 0.0, -0.003), 0.0015
_MIRRORED = np.array([-1.0, 1.0, -1.0])  # a rotation vector in a mirror whose normal points left


def draw_shoes(rng: np.random.Generator) -> tuple[ShoeParameters, ShoeParameters]:
    """Left and right shoe of a person, with the mounts of their sensors.

    The pair has a common strength of its strikes, and a common softness: soft mounts vibrate lower, for longer, and
    rock more. Each shoe leans and rolls under load in its own way.

    Args:
        rng: Draws the person's shoes.
    """
    mounts = rng.spawn(1)[0]
    strength = float(np.clip(_STRENGTH * np.exp(_STRENGTH_SD * rng.standard_normal()), *_STRENGTH_LIMITS))
    soft, damping, rocking = np.clip(rng.standard_normal(3), -2.0, 2.0).tolist()
    leans = np.array(_LEAN_SD_RAD) * np.clip(rng.standard_normal((2, 3)), -2.0, 2.0)
    rock = float(np.exp(_ROCKING_SD * (0.6 * soft + 0.8 * rocking)))
    padding, sway = float(_PADDING * mounts.uniform()), _SWAY * float(np.exp(_SWAY_SD * mounts.standard_normal()))
    passed = (SHOE.mode_hz[0] / SHOE.mode_hz)[:, None] ** padding  # of each mode
    pair = replace(
        SHOE,
        mode_hz=SHOE.mode_hz * np.exp(-_PITCH_SD * soft),
        mode_decay_s=SHOE.mode_decay_s * np.exp(_DAMPING_SD * (0.5 * soft + 0.87 * damping)),
        mode_force=strength * passed * SHOE.mode_force,
        mode_rate=strength * passed * SHOE.mode_rate,
        rock_rate=rock * SHOE.rock_rate,
        sway_rate=sway * SHOE.sway_rate,
        settle_rad=rock * SHOE.settle_rad,
        settle_sd_rad=rock * SHOE.settle_sd_rad,
    )
    rolling, giving = np.clip(rng.spawn(1)[0].standard_normal((2, 2, 3)), -2.0, 2.0)  # of each shoe
    rolls, gives = np.array(_ROLL_RAD) + np.array(_ROLL_SD_RAD) * rolling, np.array(_GIVE_M) + _GIVE_SD_M * giving
    left = replace(pair, lean_rad=leans[0], roll_rad=rolls[0], give_m=gives[0])
    right = replace(pair, lean_rad=leans[1], roll_rad=_MIRRORED * rolls[1], give_m=gives[1])
    return left, right


def case_parameters(strike: float) -> ShoeParameters:
    """Vibration of a sensor case on head or chest after the strikes of both heels: a mostly vertical, decaying impulse.

    `strike` is the largest acceleration up, m/s². Images do not show it: 10 m/s² at 12 Hz are 2 mm. A speed of impact
    of 1 m/s gives every strike this strength; the ball does not slap, and nothing rocks in stance.
    """
    return ShoeParameters(
        mode_hz=np.array([12.0, 25.0]),
        mode_decay_s=np.array([0.050, 0.020]),
        mode_force=strike * np.array([[0.30, 0.20, 0.80], [0.10, 0.10, 0.40]]),
        mode_rate=np.zeros((2, 3)),
        impact_mps=1.0,
        strike_sd=SHOE.strike_sd,
        slap=0.0,
        rock_hz=np.ones(1),
        rock_rate=np.zeros((1, 3)),
    )


_LOAD_BY_QUICKNESS = 0.7  # mean load on a foot, by the inverse of the time for which it bears it
_WALKING_STANCE_S = 0.61  # of a brisk walk; in a shorter stance the upper moves in less time
_SHORTEST_STANCE_S = 0.1  # a shorter stance counts as one of this length
_STANCE_OF_A_STEP_S = 1.5  # a longer stance is that of somebody who stands
_ROLL_AT_MOST_S = 1.0  # in which the upper rolls from heel to ball
_SWAY_FADE_S = 0.4  # in which sway begins and ends
_LONG_AGO_S = -1e6  # before and after any walk
BEFORE_S = 0.02  # time before touch-down at which the speed of impact is read
RISE_PERIODS = 0.4
"""A mode builds up within this share of its period."""
SUPPORT = 7.0
"""A mode is over after this many decay times; in the last `_FADE` of them it fades out."""
_FADE = 2.0
_UP = 2  # index of the displacement up among the six: displacement, then rotation, along and about forward, left, up


@_entry_kernel
def vibration(tau: Array, hz: float, decay_s: float, phase: float) -> tuple[Array, Array]:
    """Oscillation of one mode after a strike, of unit amplitude, and its time derivative.

    s(τ) exp(-τ/T) sin(2πfτ + φ), where s rises smoothly (zero first and second derivative at both ends) from 0 to 1
    within `RISE_PERIODS` periods, and falls to 0 in the last `_FADE` of `SUPPORT` decay times.

    Args:
        tau: (N,) s after the strike, τ.
        hz: Frequency f.
        decay_s: Decay time T.
        phase: Phase φ, rad.

    Returns:
        (N,) values, and (N,) 1/s.
    """
    value, rate, omega = np.empty(len(tau)), np.empty(len(tau)), 2 * np.pi * hz
    for i in range(len(tau)):
        size, changing = _envelope(tau[i], hz, decay_s)  # envelope, and its rate
        sine, cosine = np.sin(omega * tau[i] + phase), np.cos(omega * tau[i] + phase)
        value[i], rate[i] = size * sine, changing * sine + size * omega * cosine
    return value, rate


@numba.njit(**INNER_KERNEL)
def _envelope(tau: float, hz: float, decay_s: float) -> tuple[float, float]:
    """Envelope s(τ) exp(-τ/T) of a vibration at τ s after its strike, and its time derivative, 1/s.

    s is the minimum-jerk step from 0 to 1 within `RISE_PERIODS` periods of the mode, and T = `decay_s` its decay time.
    At the end of its support it fades out.
    """
    length, fade = RISE_PERIODS / hz, _FADE * decay_s
    left = (SUPPORT * decay_s - tau) / fade
    s, window, decay = ease(tau / length), ease(left), math.exp(-tau / decay_s)
    change = ease_rate(tau / length) / length * window - s * ease_rate(left) / fade - s * window / decay_s
    return s * window * decay, change * decay


class _Vibrations(NamedTuple):
    """E vibrations, each of one mode after one strike.

    Attributes:
        begin: (E,) s, the strike.
        end: (E,) s, when the vibration is over.
        hz: (E,) frequency.
        decay_s: (E,) decay time to 1/e.
        amplitude: (E, 6) displacement, m, and rotation, rad, along and about forward, left, up.
        phase: (E, 6) rad.
    """

    begin: Array
    end: Array
    hz: Array
    decay_s: Array
    amplitude: Array
    phase: Array


class _Rocks(NamedTuple):
    """S stances in which the upper rocks.

    Attributes:
        begin: (S,) s, touch-down.
        end: (S,) s, when the upper is still again.
        phase: (S, M, 3) rad, phases of the M sines about each axis.
        settle: (S, 3) rad, rotation that comes about at the landing and settles.
        lean: (S, 3) rad, rotation under load.
        quick: (S,) speed of all this relative to that of a walking stance.
    """

    begin: Array
    end: Array
    phase: Array
    settle: Array
    lean: Array
    quick: Array


class _Rolls(NamedTuple):
    """S stances in which the upper rolls from heel to ball.

    Attributes:
        begin: (S,) s, touch-down.
        end: (S,) s, toe-off.
        duration: (S,) s, in which the upper rolls over.
        roll: (S, 3) rad, rotation from begin to end.
        give: (S, 3) m, displacement from begin to end.
    """

    begin: Array
    end: Array
    duration: Array
    roll: Array
    give: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class UpperMotion:
    """Motion of one shoe's upper relative to its foot.

    Attributes:
        pivot: (3,) m in the foot's frame, pivot of the upper's rotation.
        _parameters: Modes and amplitudes.
        _vibrations: Vibrations after all strikes of the walk.
        _rocks: Rocking in all stances.
        _rolls: Rolling from heel to ball in all stances.
        _sways: Sway in long stances.
    """

    pivot: Array
    _parameters: ShoeParameters
    _vibrations: _Vibrations
    _rocks: _Rocks
    _rolls: _Rolls
    _sways: _Rocks

    @classmethod
    def of(
        cls,
        steps: Sequence[Stance],
        pitch: Callable[[Array], Array],
        speed: Callable[[Array], Array],
        pivot: Array,
        rng: np.random.Generator,
        parameters: ShoeParameters,
    ) -> Self:
        """Motion of the upper for a walk with the stances of one foot.

        Args:
            steps: Footsteps of the foot in order of time.
            pitch: Pitch of the sole relative to the ground, rad, at (N,) s.
            speed: Speed of the foot, m/s, at (N,) s; it sets the strength of each strike.
            pivot: (3,) m in the foot's frame, position of the sensors, where the parameters were recorded.
            rng: Draws the variation from strike to strike.
            parameters: Modes and amplitudes.
        """
        landings = [step for step in steps if np.isfinite(step.t_touch)]
        speeds = speed(np.array([step.t_touch for step in landings]) - BEFORE_S)  # (S,) m/s, speeds of impact
        # `shape` (K, 6): phases of the modes, common to all strikes of this foot; `unit` (K, 6): amplitudes of
        # displacement and rotation, which are those of acceleration over ω², and those of angular rate over ω
        shape = rng.uniform(0.0, 2 * np.pi, (len(parameters.mode_hz), 6))
        shape[:, _UP] = 1.5 * np.pi - 2 * np.pi * parameters.mode_hz * parameters.blow_s  # the ground first pushes up
        omega = 2 * np.pi * parameters.mode_hz[:, None]
        unit = np.concatenate([parameters.mode_force / omega**2, parameters.mode_rate / omega], axis=1)
        # (time, amplitudes, phases) of each strike and slap, with (K, 6) arrays; (M, 3) phases of rocking per stance
        strikes, rocks = [], []
        toe_offs, standing, loads = rng.spawn(3)  # streams of their own leave the strikes as they are
        for step, impact in zip(landings, speeds):
            strength = np.clip(impact / parameters.impact_mps, *parameters.strength) * np.exp(
                parameters.strike_sd * rng.standard_normal()
            )
            slap_time = _slap_time(step, pitch, parameters.slap_rad)
            # the heel strike, then the slap of the ball, with its strength relative to the strike's
            for t, relative in ((step.t_touch, 1.0), (slap_time, parameters.slap / _quickness(step))):
                phase = shape + parameters.jitter_rad * rng.standard_normal(shape.shape)
                strikes.append((t, strength * relative * unit, phase))
            if parameters.snap > 0.0 and np.isfinite(step.t_off):
                # the bent shoe springs back when its tip leaves the ground; not alike at all from step to step
                phase = toe_offs.uniform(0.0, 2 * np.pi, shape.shape)
                strikes.append((step.t_off, strength * parameters.snap * unit, phase))
            rocks.append(rng.uniform(0.0, 2 * np.pi, parameters.rock_rate.shape))
        settling, rolling = (source.standard_normal((len(landings), 6)) for source in (rng, loads))
        # while the wearer stands, the foot is never quite still
        stands = [step for step in steps if not step.t_off - step.t_touch < _STANCE_OF_A_STEP_S]
        nothing = np.zeros((len(stands), 3))
        begins, ends = np.array([s.t_touch for s in landings]), np.array([min(s.t_off, -_LONG_AGO_S) for s in landings])
        lasting = np.maximum(ends - begins, _SHORTEST_STANCE_S)  # (S,) s
        quick = np.array([_quickness(step) for step in landings])
        # one row for every mode after every strike
        begin = np.repeat([t for t, _, _ in strikes], len(parameters.mode_hz))
        hz, decay_s = (np.tile(x, len(strikes)) for x in (parameters.mode_hz, parameters.mode_decay_s))
        return cls(
            pivot=pivot,
            _parameters=parameters,
            _vibrations=_Vibrations(
                begin=begin,
                end=begin + SUPPORT * decay_s,
                hz=hz,
                decay_s=decay_s,
                amplitude=np.reshape([a for _, a, _ in strikes], (-1, 6)),
                phase=np.reshape([phase for _, _, phase in strikes], (-1, 6)),
            ),
            _rocks=_Rocks(
                begin=begins,
                end=np.minimum(ends, begins + parameters.rock_s),
                phase=np.reshape(rocks, (-1, *parameters.rock_rate.shape)),
                settle=(parameters.settle_rad + settling[:, :3] * parameters.settle_sd_rad) / quick[:, None],
                lean=parameters.lean_rad * (1.0 + parameters.lean_sd * settling[:, 3:]),
                quick=quick,
            ),
            _rolls=_Rolls(
                begin=begins,
                end=ends,
                duration=np.minimum(lasting, _ROLL_AT_MOST_S),
                roll=parameters.roll_rad * (1.0 + parameters.roll_sd * rolling[:, :3]),
                give=parameters.give_m + parameters.give_sd_m * rolling[:, 3:],
            ),
            _sways=_Rocks(
                begin=np.array([max(step.t_touch, _LONG_AGO_S) for step in stands]),
                end=np.array([min(step.t_off, -_LONG_AGO_S) for step in stands]),
                phase=standing.uniform(0.0, 2 * np.pi, (len(stands), *parameters.sway_rate.shape)),
                settle=nothing,
                lean=nothing,
                quick=np.ones(len(stands)),
            ),
        )

    def at(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Motion of the upper relative to its foot at (N,) increasing s, in the axes of the foot.

        Returns:
            (N, 3) m, displacement of the pivot; (N, 3) rad, rotation vector; (N, 3) m/s and (N, 3) rad/s, their rates.
        """
        value, rate = np.zeros((len(t), 6)), np.zeros((len(t), 6))  # displacement, then rotation
        shoe = self._parameters
        # (2, S) first row of each stance and one past its last; below, (2, E) of each vibration
        rows = np.searchsorted(t, [self._rocks.begin, self._rocks.end])
        _add_rocks(t, rows, self._rocks, shoe.rock_hz, shoe.rock_rate, shoe.fade_s, shoe.settle_s, value, rate)
        rows = np.searchsorted(t, [self._sways.begin, self._sways.end])
        _add_rocks(t, rows, self._sways, shoe.sway_hz, shoe.sway_rate, _SWAY_FADE_S, shoe.settle_s, value, rate)
        # rocking rotates about a point of the ground, so the pivot moves as well: rotation × arm
        arm = self.pivot - self._parameters.ground_m
        value[:, :3], rate[:, :3] = cross(value[:, 3:], arm), cross(rate[:, 3:], arm)
        rows = np.searchsorted(t, [self._rolls.begin, self._rolls.end])
        _add_rolls(t, rows, self._rolls, self.pivot, np.array(shoe.roll_m), shoe.fade_s, value, rate)
        rows = np.searchsorted(t, [self._vibrations.begin, self._vibrations.end])
        _add_vibrations(t, rows, self._vibrations, value, rate)
        return value[:, :3], value[:, 3:], rate[:, :3], rate[:, 3:]

    def upper_track(self, foot: Track) -> Track:
        """Track of the upper, given that of its foot; the two frames coincide at rest."""
        return foot.displace(self.pivot, *self.at(np.asarray(foot.t_ns * 1e-9, dtype=np.float64)))


@_entry_kernel
def _add_vibrations(t: Array, rows: NDArray[np.int64], vibrations: _Vibrations, value: Array, rate: Array) -> None:
    """Adds the vibrations after all strikes to displacement and rotation, and to their rates.

    Each one is `amplitude` times s(τ) exp(−τ/T) sin(ω τ + φ) in every axis, τ after its strike.

    Args:
        t: (N,) increasing s.
        rows: (2, E) first row of each vibration, and one past its last.
        vibrations: The E vibrations.
        value: (N, 6) displacement, m, and rotation, rad, which are added to.
        rate: (N, 6) their rates, which are added to.
    """
    for e in range(len(vibrations.begin)):
        omega = 2 * np.pi * vibrations.hz[e]
        for i in range(rows[0, e], rows[1, e]):
            tau = t[i] - vibrations.begin[e]
            size, changing = _envelope(tau, vibrations.hz[e], vibrations.decay_s[e])  # envelope, and its rate
            for k in range(6):
                sine, cosine = (
                    math.sin(omega * tau + vibrations.phase[e, k]),
                    math.cos(omega * tau + vibrations.phase[e, k]),
                )
                value[i, k] += vibrations.amplitude[e, k] * size * sine
                rate[i, k] += vibrations.amplitude[e, k] * (changing * sine + size * omega * cosine)


@_entry_kernel
def _add_rocks(
    t: Array,
    rows: NDArray[np.int64],
    rocks: _Rocks,
    rock_hz: Array,
    rock_rate: Array,
    fade_s: float,
    settle_s: tuple[float, float],
    value: Array,
    rate: Array,
) -> None:
    """Adds the motion of stance to the rotation: a rotation that settles, a lean under load, and rocking.

    The lean and the rocking, sines of random phase, are in a window that fades in and out.

    Args:
        t: (N,) increasing s.
        rows: (2, S) first row of each stance, and one past its last.
        rocks: The stances.
        rock_hz: (M,) frequencies.
        rock_rate: (M, 3) rad/s, amplitudes of the angular rate.
        fade_s: Duration of fade-in and fade-out.
        settle_s: Times in which the rotation that settles comes about, and in which it settles.
        value: (N, 6) displacement, m, and rotation, rad, which are added to.
        rate: (N, 6) their rates, which are added to.
    """
    for e in range(len(rocks.begin)):
        for i in range(rows[0, e], rows[1, e]):
            # in a short stance all this takes a shorter time, and the load that makes it lean and rock is larger
            quick = rocks.quick[e]
            size = quick**_LOAD_BY_QUICKNESS
            since, before_end = t[i] - rocks.begin[e], rocks.end[e] - t[i]
            tau = quick * since
            # window of the fades, and its rate `changing`, from the times since the begin and until the end, in fades
            begun, left = tau / fade_s, quick * before_end / fade_s
            window = ease(begun) * ease(left)
            changing = quick * (ease_rate(begun) * ease(left) - ease(begun) * ease_rate(left)) / fade_s
            # the rotation that settles, as a share, and its rate
            grown, settled, fading = tau / settle_s[0], (tau - settle_s[0]) / settle_s[1], quick * before_end / fade_s
            share = ease(grown) * (1.0 - ease(settled)) * ease(fading)
            sharing = quick * (
                ease_rate(grown) / settle_s[0] * (1.0 - ease(settled)) * ease(fading)
                - ease(grown) * ease_rate(settled) / settle_s[1] * ease(fading)
                - ease(grown) * (1.0 - ease(settled)) * ease_rate(fading) / fade_s
            )
            for k in range(3):
                value[i, 3 + k] += share * rocks.settle[e, k] + size * window * rocks.lean[e, k]
                rate[i, 3 + k] += sharing * rocks.settle[e, k] + size * changing * rocks.lean[e, k]
            for m in range(len(rock_hz)):
                omega = 2 * np.pi * rock_hz[m]
                for k in range(3):
                    amplitude, angle = size * rock_rate[m, k] / omega, omega * tau + rocks.phase[e, m, k]
                    wave = amplitude * math.sin(angle)
                    value[i, 3 + k] += window * wave
                    rate[i, 3 + k] += changing * wave + quick * window * amplitude * omega * math.cos(angle)


@_entry_kernel
def _add_rolls(
    t: Array,
    rows: NDArray[np.int64],
    rolls: _Rolls,
    pivot: Array,
    roll_m: Array,
    fade_s: float,
    value: Array,
    rate: Array,
) -> None:
    """Adds the motion while the load passes from heel to ball; the shoe is as it was at toe-off.

    It rolls without slip: with the share s of its rotation r, the point of the ground about which it turns moves
    forward from a to b, so that the displacement is r × (s (p - a) - s² (b - a) / 2) at p. To this s times the give is
    added.

    Args:
        t: (N,) increasing s.
        rows: (2, S) first row of each stance, and one past its last.
        rolls: The stances.
        pivot: (3,) m, p in the foot's frame.
        roll_m: (2,) m, a and b along the foot, on the ground.
        fade_s: Time before toe-off in which the shoe goes back, at most half of the stance.
        value: (N, 6) displacement, m, and rotation, rad, which are added to.
        rate: (N, 6) their rates, which are added to.
    """
    way = roll_m[1] - roll_m[0]
    for e in range(len(rolls.begin)):
        duration, roll, give = rolls.duration[e], rolls.roll[e], rolls.give[e]
        back_s = min(fade_s, duration / 2)
        for i in range(rows[0, e], rows[1, e]):
            grown, left = (t[i] - rolls.begin[e]) / duration, (rolls.end[e] - t[i]) / back_s
            share = ease(grown) * ease(left)
            sharing = ease_rate(grown) / duration * ease(left) - ease(grown) * ease_rate(left) / back_s
            arm = share * (pivot[0] - roll_m[0]) - share**2 * way / 2, share * pivot[1], share * pivot[2]
            moving = sharing * (pivot[0] - roll_m[0] - share * way), sharing * pivot[1], sharing * pivot[2]
            for k in range(3):
                after, last = (k + 1) % 3, (k + 2) % 3  # axes of the cross product
                value[i, k] += roll[after] * arm[last] - roll[last] * arm[after] + share * give[k]
                rate[i, k] += roll[after] * moving[last] - roll[last] * moving[after] + sharing * give[k]
                value[i, 3 + k] += share * roll[k]
                rate[i, 3 + k] += sharing * roll[k]


def _quickness(step: Stance) -> float:
    """Speed of what happens in a stance relative to a walking one, 1 or more.

    By as much a runner's slap and settling are weaker: runners land flatter, and in `foot_imu_vicon` the rates of those
    who jog fall from 7 to 0.7 rad/s within 0.1 s of the strike.
    """
    return max(_WALKING_STANCE_S / max(step.t_off - step.t_touch, _SHORTEST_STANCE_S), 1.0)


def _slap_time(step: Stance, pitch: Callable[[Array], Array], flat_rad: float) -> float:
    """Time at which the sole slaps down after touch-down, s: the first instant with a pitch below `flat_rad`.

    It is found in steps of 2 ms; it is the touch-down itself if the foot does not become flat within 0.4 s.

    Args:
        step: The footstep.
        pitch: Pitch of the sole relative to the ground, rad, at (N,) s.
        flat_rad: Magnitude of the pitch below which the sole counts as flat.
    """
    t = np.arange(step.t_touch, min(step.t_off, step.t_touch + 0.4), 0.002)
    down = np.abs(pitch(t)) < flat_rad
    return float(t[down.argmax()]) if down.any() else step.t_touch
