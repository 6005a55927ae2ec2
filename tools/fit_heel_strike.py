"""Fits the heel-strike vibration and rocking of a shoe's upper (`sim/gait/heel_strike.py`) to recorded walks.

`python -m tools.fit_heel_strike` prints the arrays of `heel_strike.SHOE`. Recordings: `dual_foot_walk` (gaitmap's
example data, MIT), both feet at 204.8 Hz with accelerometers of 16 g, found by `benchmarks.real_walks`. The other set,
`foot_imu_vicon`, is filtered in the sensor and holds no sharp strike.

Vibration: strikes are aligned at the onset of the force above 20 Hz. The mean power of force and angular rate in three
bands and bins of 20 ms is a sum of the power of unit modes with non-negative weights. Nothing above the recording's
102 Hz is known, and nothing is added there. The twin's own foot motion (its plan at the same speed) is subtracted
first. Rocking: cosine coefficients of the angular rate over the stationary part of each stance, likewise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.optimize import nnls
from scipy.signal import butter, sosfiltfilt

from benchmarks.real_walks import MarkerWalk, data_folder, load_markers
from benchmarks.shoe_imu import REAL_HZ, FootWalk, recorded, stances, twin_walks
from stridetwin.estimators.foot_ins import FootIns
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import SIDES, Gait
from stridetwin.sim.gait.heel_strike import BEFORE_S, SHOE, vibration
from stridetwin.sim.twin import Twin
from stridetwin.streams.algebra.arrays import from_quaternion
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Array

BANDS_HZ = ((12.0, 24.0), (24.0, 48.0), (48.0, 96.0))
DECAYS_S = (0.008, 0.012, 0.018, 0.027, 0.040, 0.060)
SLAPS = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4)
SLAP_DELAY_S = 0.11  # after the strike, as recorded
_BIN = 4  # samples
_SHOWN = np.arange(-4, 64)  # samples about a strike
_STRIDE_M = (0.9, 1.9)
_SPEED_MPS = 1.3  # of the recorded strides
_ROCK_BINS = ((0, 1), (2,), (3, 4, 5))  # cosines of a span of 0.2 s: up to 2.5, 5, 7.5 to 12.5 Hz
_SPAN_S = 0.2


@dataclass(frozen=True, kw_only=True, eq=False)
class Strikes:
    """A foot's IMU in the foot's axes.

    Attributes:
        signal: (N, 6) force, m/s², and angular rate, rad/s.
        at: (S,) sample at the onset of each strike.
        still: (S, 2) the stationary interval of each stance.
    """

    signal: Array
    at: NDArray[np.int64]
    still: NDArray[np.int64]


def band(signal: Array, low: float, high: float) -> Array:
    """The signal between two frequencies, without delay."""
    return np.asarray(sosfiltfilt(butter(2, [low, high], "band", fs=REAL_HZ, output="sos"), signal, axis=0))


def recorded_strikes(foot: MarkerWalk) -> Strikes:
    """Strikes of a recorded walk; forward is the foot's direction of travel, up that of the specific force at rest."""
    walk = recorded(foot.imu, foot.t, foot.heel)
    path = FootIns().run(foot.imu).trajectory
    R = from_quaternion(path.q_world_frame)
    spans = stances(walk)
    up = np.mean([walk.force[a:b].mean(0) for a, b in spans], axis=0)
    up /= np.linalg.norm(up)
    forward, at, still = [], [], []
    sharp = np.linalg.norm(band(walk.force, 20.0, 95.0), axis=1)
    for (_, off), (touch, end) in pairwise(spans):
        moved = path.p_frame_in_world[touch] - path.p_frame_in_world[off]
        if not _STRIDE_M[0] < np.linalg.norm(moved) < _STRIDE_M[1] or touch - off > REAL_HZ:
            continue
        forward.append(R[(touch + end) // 2].T @ moved)
        first = max(off, touch - round(0.3 * REAL_HZ))
        peak = first + int(sharp[first:touch].argmax())
        onset = peak - 10 + int((sharp[peak - 10 : peak + 1] > 0.3 * sharp[peak]).argmax())
        at.append(onset)
        still.append((touch, end))
    x = np.mean(forward, axis=0)
    x -= up * (up @ x)
    x /= np.linalg.norm(x)
    axes = np.column_stack([x, np.cross(up, x), up])
    return Strikes(signal=np.hstack([walk.force @ axes, walk.rate @ axes]), at=np.array(at), still=np.array(still))


def twin_strikes(walk: FootWalk, touch: Array) -> Strikes:
    """The same of a walk of the twin, whose sensor axes are the foot's."""
    spans = stances(walk)
    at = np.searchsorted(walk.t, touch)
    still = [spans[np.searchsorted(spans[:, 1], k)] for k in at]
    return Strikes(signal=np.hstack([walk.force, walk.rate]), at=at, still=np.array(still))


def power(strikes: Strikes) -> Array:
    """(6, B, T) mean power by signal, band and bin."""
    rows = strikes.at[(strikes.at > 20) & (strikes.at + _SHOWN[-1] < len(strikes.signal))][:, None] + _SHOWN
    squares = np.stack([(band(strikes.signal, *limits)[rows] ** 2).mean(0) for limits in BANDS_HZ], 1)
    return squares.reshape(-1, _BIN, len(BANDS_HZ), 6).mean(1).transpose(2, 1, 0)


def left_by_mode(hz: float, decay_s: float, delay_s: float = 0.0) -> tuple[Array, Array]:
    """(B, T) power of force and of rate of a mode of unit amplitude at random phase."""
    n, fine = 200, 40
    t = (np.arange(n * fine + 1) / fine - n / 2 + 0.5) / REAL_HZ
    tau, omega = np.maximum(t - delay_s, 0.0), 2 * np.pi * hz
    made = []
    for phase in (0.0, np.pi / 2):
        value, rate = vibration(tau, hz, decay_s, phase)
        made.append([np.diff(x[::fine]) * REAL_HZ for x in (rate / omega**2, value / omega)])
    rows = n // 2 + _SHOWN
    powers = []
    for k in (0, 1):
        squares = [sum(band(m[k], *limits)[rows] ** 2 for m in made) / 2 for limits in BANDS_HZ]
        powers.append(np.array(squares).reshape(len(BANDS_HZ), -1, _BIN).mean(2))
    return powers[0], powers[1]


def fit_ringing(target: Array) -> tuple[Array, Array, float, float]:
    """Decay times (K,), amplitudes (K, 6), the slap's share and the unexplained share of the power."""
    weight = 1.0 / np.sqrt(target * target.max((1, 2), keepdims=True) + (0.05 * target.max((1, 2), keepdims=True)) ** 2)
    best = None
    every = product(SHOE.mode_hz, DECAYS_S, (0.0, SLAP_DELAY_S))
    atoms = {(hz, decay, delay): left_by_mode(hz, decay, delay) for hz, decay, delay in every}
    for decays in product(DECAYS_S, repeat=len(SHOE.mode_hz)):
        for slap in SLAPS:
            amplitude, left = np.zeros((len(decays), 6)), 0.0
            for i in range(6):
                made = [
                    atoms[hz, d, 0.0][i // 3] + slap**2 * atoms[hz, d, SLAP_DELAY_S][i // 3]
                    for hz, d in zip(SHOE.mode_hz, decays)
                ]
                atoms_seen = np.array([(m * weight[i]).ravel() for m in made]).T
                squares, rest = nnls(atoms_seen, (target[i] * weight[i]).ravel())
                amplitude[:, i], left = np.sqrt(squares), left + rest**2
            if best is None or left < best[3]:
                best = np.array(decays), amplitude, slap, left
    assert best is not None
    return *best[:3], float(best[3] / ((weight * target) ** 2).sum())


def rocking(strikes: Strikes) -> Array:
    """(M, 3) mean square of the rate in each group of cosines, as the square of a sine's amplitude."""
    n, rows = round(_SPAN_S * REAL_HZ), []
    for a, b in strikes.still:
        if b - a >= n:
            first = (a + b - n) // 2
            rows.append(dct(strikes.signal[first : first + n, 3:], type=2, norm="ortho", axis=0) ** 2 / n)
    return np.array([np.mean([2 * row[list(group)].sum(0) for row in rows], axis=0) for group in _ROCK_BINS])


def spread_of_strikes(strikes: Sequence[Strikes]) -> float:
    """Standard deviation of the logarithm of a strike's strength above 20 Hz."""
    logs = []
    for s in strikes:
        sharp = band(s.signal[:, :3], 20.0, 95.0)
        strength = np.array([np.log(np.sqrt((sharp[k : k + 20] ** 2).sum(1).mean())) for k in s.at])
        logs.append(strength - strength.mean())
    return float(np.concatenate(logs).std())


def main() -> None:
    """Prints the values for `shock.SHOE`."""
    folder = data_folder()
    if folder is None:
        raise StrideTwinError("no recordings: set STRIDETWIN_DATA to the folder that holds dual_foot_walk")
    real = [recorded_strikes(foot) for foot in load_markers(folder)]
    level = replace(load_scenario("level_20m").config, sensors=("foot_imu",), ideal=True)
    twin = Twin(replace(level, gait=Gait(speed_mps=_SPEED_MPS)), 0)
    walks = twin_walks(twin, REAL_HZ)
    landed = {side: [s for s in twin.walk.steps[side] if np.isfinite(s.t_touch + s.t_off)][1:] for side in SIDES}
    plan = [twin_strikes(walks[side], np.array([s.t_touch for s in landed[side]])) for side in SIDES]
    own = np.mean([power(s) for s in plan], axis=0)
    target = np.maximum(np.mean([power(s) for s in real], axis=0) - own, 0.0)
    decays, amplitude, slap, left = fit_ringing(target)
    rock = np.maximum(np.mean([rocking(s) for s in real], axis=0) - np.mean([rocking(s) for s in plan], axis=0), 0.0)
    impact = []
    for side in SIDES:
        before = np.array([round((s.t_touch - BEFORE_S) * 1e9) for s in landed[side]])
        velocity = twin.player().motion(before).tracks[f"foot_{side}"].v_body_in_world
        impact += np.linalg.norm(velocity, axis=1).tolist()
    with np.printoptions(precision=3, suppress=True):
        print(f"# {[len(s.at) for s in real]} strikes; {100 * left:.0f} % of the (squared) power is left over")
        print(f"mode_hz={SHOE.mode_hz!r}\nmode_decay_s={decays!r}")
        print(f"mode_force={amplitude[:, :3]!r}\nmode_rate={amplitude[:, 3:]!r}")
        print(f"impact_mps={np.mean(impact):.3f}\nstrike_sd={spread_of_strikes(real):.3f}\nslap={slap}")
        print(f"rock_hz={SHOE.rock_hz!r}\nrock_rate={np.sqrt(rock)!r}")


if __name__ == "__main__":
    main()
