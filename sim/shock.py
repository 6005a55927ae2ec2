"""What the upper of a shoe does beyond the foot in it: rings when the foot strikes, and rocks a little in stance.

The foot of a planned walk lands softly, and stands perfectly still. A real shoe does neither: its upper, on which the
sensors sit, swings against the foot after the heel's strike and again when the ball slaps down, and rolls and twists by
a degree while it carries. Here that is a small motion of the upper against the foot, twice differentiable in time, so
that accelerometer, gyroscope and truth agree and nothing is left of it once the foot is off the ground. The table is
fitted to recorded walks by `tools/fit_heel_strike.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.sim.gait.footsteps import Footstep
from stridetwin.sim.gait.smooth import ease, ease_rate
from stridetwin.sim.rotation import cross
from stridetwin.sim.track import Track
from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ShoeParameters:
    """How a shoe's upper moves on its foot; axes of the foot: forward, left, up.

    Attributes:
        ring_hz: (K,) frequency of each mode that a strike excites.
        ring_s: (K,) time in which it decays to 1/e.
        ring_force: (K, 3) m/s², amplitude of the acceleration, at the reference speed of impact.
        ring_rate: (K, 3) rad/s, amplitude of the angular rate, likewise.
        impact_mps: The reference: speed of the foot `BEFORE_S` before touch-down.
        strike_sd: Standard deviation of the logarithm of a strike's strength.
        slap: Strength of the ball's slap over that of the heel's strike.
        rock_hz: (M,) frequencies of the motion in stance.
        rock_rate: (M, 3) rad/s, amplitude of its angular rate.
    """

    ring_hz: Array
    ring_s: Array
    ring_force: Array
    ring_rate: Array
    impact_mps: float
    strike_sd: float
    slap: float
    rock_hz: Array
    rock_rate: Array


SHOE = ShoeParameters(
    ring_hz=np.array([17.0, 34.0, 68.0]),
    ring_s=np.array([0.040, 0.012, 0.027]),
    ring_force=np.array([[22.8, 24.4, 33.2], [0.0, 0.0, 138.1], [35.7, 32.7, 49.7]]),
    ring_rate=np.array([[5.32, 1.43, 2.82], [7.30, 6.43, 2.11], [4.22, 1.33, 3.25]]),
    impact_mps=0.384,
    strike_sd=0.27,
    slap=0.15,
    rock_hz=np.array([2.5, 5.0, 10.0]),
    rock_rate=np.array([[0.140, 0.128, 0.151], [0.070, 0.026, 0.042], [0.054, 0.020, 0.032]]),
)
"""A walking shoe with the sensor clipped to it, at 1.3 m/s: `dual_foot_walk` of gaitmap's example data (MIT), both
feet, 56 strikes of one person."""

BEFORE_S = 0.02
RISE_PERIODS = 0.4
"""A mode swings up within this share of its period."""
SUPPORT = 10.0
"""A mode is over after this many decay times."""
_STRENGTH = (0.15, 2.0)  # softest and hardest strike over the reference
_FADE_S = 0.10  # rocking begins and ends within this
_ROCK_S = 0.9  # who stands on stands still after this
_UP = 2  # of displacement (forward, left, up) and turn
_BLOW_S = 0.007  # after the strike all modes push up together
_JITTER_RAD = 0.5  # of a mode's phase from strike to strike: a foot strikes much like itself
_SLAP_RAD = 0.02  # pitch of the sole against the ground at which the ball slaps down
_GROUND = (0.060, 0.0, 0.0)  # m: what rocking turns about


def ring(tau: Array, hz: float, decay_s: float, phase: Array | float) -> tuple[Array, Array]:
    """A mode's oscillation after a strike, and its rate of change a second.

    s(τ) exp(-τ/T) sin(2πfτ + φ), where s rises smoothly (zero first and second derivative at both ends) from 0 to 1.

    Args:
        tau: (N,) s since the strike.
        hz: f.
        decay_s: T.
        phase: rad, φ; (..., 1) for several.
    """
    length = RISE_PERIODS / hz
    rise, rising = ease(tau / length), ease_rate(tau / length) / length
    omega = 2 * np.pi * hz
    decay, sine, cosine = np.exp(-tau / decay_s), np.sin(omega * tau + phase), np.cos(omega * tau + phase)
    return rise * decay * sine, decay * ((rising - rise / decay_s) * sine + rise * omega * cosine)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Event:
    """A piece of the motion: from when to when, and (N,) s -> value and rate, each (6, N): m and rad."""

    begin: float
    end: float
    motion: Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True, kw_only=True, eq=False)
class UpperMotion:
    """Motion of one shoe's upper against its foot.

    Attributes:
        pivot: (3,) m in the foot's frame, what the upper turns about.
    """

    pivot: Array
    _events: tuple[_Event, ...]

    @classmethod
    def of(
        cls, steps: Sequence[Footstep], pitch: Callable[[Array], Array], speed: Callable[[Array], Array],
        pivot: Array, rng: np.random.Generator, parameters: ShoeParameters,
    ) -> Self:  # fmt: skip
        """The motion that a walk makes.

        Args:
            steps: Footsteps of one foot.
            pitch: (N,) s -> (N,) rad, pitch of its sole against the ground.
            speed: (N,) s -> (N,) m/s, how fast it goes.
            pivot: (3,) m in the foot's frame: where the sensors sit. What they were recorded to do, they do there.
            rng: Source of what differs from strike to strike.
            parameters: Of the shoe.
        """
        landed = [step for step in steps if np.isfinite(step.t_touch)]
        speeds = speed(np.array([step.t_touch for step in landed]) - BEFORE_S)
        shape = rng.uniform(0.0, 2 * np.pi, (len(parameters.ring_hz), 6))
        shape[:, _UP] = 1.5 * np.pi - 2 * np.pi * parameters.ring_hz * _BLOW_S  # the ground pushes up at first
        events = []
        for step, impact in zip(landed, speeds):
            strength = np.clip(impact / parameters.impact_mps, *_STRENGTH) * np.exp(
                parameters.strike_sd * rng.standard_normal()
            )
            for t, share in ((step.t_touch, 1.0), (_slap(step, pitch), parameters.slap)):
                phase = shape + _JITTER_RAD * rng.standard_normal(shape.shape)
                events += _ringing(t, strength * share, phase, parameters)
            events.append(_rocking(step, rng, pivot, parameters))
        return cls(pivot=pivot, _events=tuple(sorted(events, key=lambda e: e.begin)))

    def at(self, t: NDArray[np.floating[Any]]) -> tuple[Array, Array, Array, Array]:
        """Displacement (N, 3) m and turn (N, 3) rad, as a rotation vector, at (N,) increasing s, and both a second."""
        value, rate = np.zeros((6, len(t))), np.zeros((6, len(t)))
        for event in self._events:
            a, b = np.searchsorted(t, [event.begin, event.end])
            if a < b:
                moved, moving = event.motion(np.asarray(t[a:b] - event.begin, dtype=np.float64))
                value[:, a:b] += moved
                rate[:, a:b] += moving
        return value[:3].T, value[3:].T, rate[:3].T, rate[3:].T

    def carried(self, foot: Track) -> Track:
        """Track of the upper, whose frame is the foot's own where nothing moves."""
        shift, turn, shifting, turning = self.at(foot.t_ns * 1e-9)
        R_foot_upper, R_world_foot = Rotation.from_rotvec(turn), foot.rotation
        lever = R_foot_upper.apply(self.pivot)
        # right Jacobian of SO(3), to second order: turns stay below some hundredths of a radian
        w_relative = turning - cross(turn, turning) / 2 + cross(turn, cross(turn, turning)) / 6
        origin = self.pivot + shift - lever
        moving = cross(foot.w_body, origin) + shifting - R_foot_upper.apply(cross(w_relative, self.pivot))
        return Track(
            t_ns=foot.t_ns,
            p_body_in_world=foot.p_body_in_world + R_world_foot.apply(origin),
            q_world_body=(R_world_foot * R_foot_upper).as_quat(scalar_first=True),
            v_body_in_world=foot.v_body_in_world + R_world_foot.apply(moving),
            w_body=R_foot_upper.inv().apply(foot.w_body) + w_relative,
        )


def _ringing(t: float, strength: float, phase: Array, p: ShoeParameters) -> list[_Event]:
    """One event a mode; `phase` (K, 6) rad."""
    omega = 2 * np.pi * p.ring_hz[:, None]
    amplitude = strength * np.concatenate([p.ring_force / omega**2, p.ring_rate / omega], axis=1)[:, :, None]

    def mode(k: int) -> Callable[[Array], tuple[Array, Array]]:
        def motion(tau: Array) -> tuple[Array, Array]:
            value, rate = ring(tau, p.ring_hz[k], p.ring_s[k], phase[k, :, None])
            return amplitude[k] * value, amplitude[k] * rate

        return motion

    return [_Event(begin=t, end=t + SUPPORT * p.ring_s[k], motion=mode(k)) for k in range(len(p.ring_hz))]


def _rocking(step: Footstep, rng: np.random.Generator, pivot: Array, p: ShoeParameters) -> _Event:
    """Sines of random phase under a smooth window; the upper turns about the ground, so it shifts as well."""
    end = min(step.t_off, step.t_touch + _ROCK_S)
    length, omega = end - step.t_touch, 2 * np.pi * p.rock_hz[:, None, None]
    amplitude = p.rock_rate[:, :, None] / omega
    phase = rng.uniform(0.0, 2 * np.pi, p.rock_rate.shape)[:, :, None]
    arm = pivot - _GROUND

    def motion(tau: Array) -> tuple[Array, Array]:
        begun, left = tau / _FADE_S, (length - tau) / _FADE_S
        up, rising, down, falling = ease(begun), ease_rate(begun), ease(left), ease_rate(left)
        window, changing = up * down, (rising * down - up * falling) / _FADE_S
        wave = (amplitude * np.sin(omega * tau + phase)).sum(0)
        waving = (amplitude * omega * np.cos(omega * tau + phase)).sum(0)
        turn, turning = window * wave, changing * wave + window * waving
        shift = [cross(x.T, arm).T for x in (turn, turning)]
        return np.vstack([shift[0], turn]), np.vstack([shift[1], turning])

    return _Event(begin=step.t_touch, end=end, motion=motion)


def _slap(step: Footstep, pitch: Callable[[Array], Array]) -> float:
    """When the sole has come down on the ground, s."""
    t = np.arange(step.t_touch, min(step.t_off, step.t_touch + 0.4), 0.002)
    down = np.abs(pitch(t)) < _SLAP_RAD
    return float(t[down.argmax()]) if down.any() else step.t_touch
