"""Sensors made of force-sensing resistors: pressure insoles, and force pairs in the cuffs."""

from __future__ import annotations

import math

import numpy as np

from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.figure import G
from stridetwin.sim.parts.kinds import ForceCellPart
from stridetwin.sim.sensors.model import Instants, SensorModel
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.rig import OtherSensor
from stridetwin.streams.samples import Array, Block, Insole, Interaction

_entry_kernel = entry_kernel(__file__)

_CREEP_S = (1.0, 10.0, 100.0)  # time constants; a constant load creeps by the same amount per decade
_PLAY = 0.1  # of the load: play of the hysteresis
_FULL_COUNT = 4095  # largest count of the converter


class ForceCells:
    """Several cells of one part: creep, hysteresis, noise, quantisation and filter, in this order.

    The hysteresis is a play whose width grows with the force F: its output is (1 − 0.1) F under rising load and
    (1 + 0.1) F under falling load. The difference from F is scaled to the hysteresis of the part. The converter rounds
    the counts x that follow from the calibration curve F = b₁ x + b₂ x² (kgf, x in thousands). The same curve converts
    them back to a force.

    Args:
        part: Parameters of the cells.
        count: Number of cells.
        rate_hz: Sample rate.
        noise: Source of their errors.
    """

    def __init__(self, part: ForceCellPart, count: int, rate_hz: float, noise: Noise) -> None:
        """Draws the gain errors and sets the state of `count` cells to unloaded; `rate_hz` is the sample rate."""
        from scipy.signal import butter  # takes long to import, so only when a sensor filters

        self._part, self._noise = part, noise
        self._gain = 1 + noise.normal(part.gain, count)  # (count,)
        # creep: a first-order low-pass for each time constant; `_keep` is the share of its value after one sample
        self._keep = [math.exp(-1 / (rate_hz * tau)) for tau in _CREEP_S]
        self._crept = np.zeros((len(_CREEP_S), 1, count))  # their states, as `lfilter` needs them
        self._play = np.zeros(count)  # N, last output of the hysteresis
        # low-pass behind the converter; None above half the sample rate, where it would not filter
        cut = part.filter_hz
        self._sos = butter(2, cut, fs=rate_hz, output="sos") if cut < 0.5 * rate_hz else None
        self._filter = np.zeros((1, 2, count))  # its state: one section with two values per cell

    def read(self, load: Array) -> Array:
        """(N, count) N, measured forces for the next true loads (N, count), N.

        The calls are consecutive: the states of creep (`_crept`), hysteresis (`_play`) and filter (`_filter`) are kept.
        """
        from scipy.signal import lfilter, sosfilt

        bare = self._gain * load  # with the error of each cell's sensitivity alone
        measured = bare.copy()
        # creep: the load, delayed by a low-pass of each time constant, adds a share of itself
        for i, keep in enumerate(self._keep):
            late, self._crept[i] = lfilter([1 - keep], [1.0, -keep], bare, axis=0, zi=self._crept[i])
            measured += self._part.drift * late
        if self._part.hysteresis:
            # the loop of the play has the width 2 * _PLAY times the load, that of the part `hysteresis` times the load
            played = _apply_play(self._play, measured)
            measured += self._part.hysteresis / (2 * _PLAY) * (played - measured)
        measured = np.clip(measured + self._noise.normal(self._part.noise, load.shape), 0.0, self._part.range)
        if any(self._part.curve):  # (b₁, b₂); both 0 for a part without a converter
            measured = _quantize(measured, *self._part.curve)
        if self._sos is not None:
            measured, self._filter = sosfilt(self._sos, measured, axis=0, zi=self._filter)
            measured = np.maximum(measured, 0.0)
        return measured


@_entry_kernel
def _apply_play(last: Array, load: Array) -> Array:
    """Output of the hysteresis for (N, count) loads: a play between 0.9 and 1.1 times the load.

    The output stays while it lies in this interval, and otherwise moves to its nearest end. `last` (count,) is the
    output before the first row; it is updated.
    """
    play = np.empty(load.shape)
    for k in range(len(load)):
        for i in range(len(last)):
            last[i] = play[k, i] = min(max(last[i], (1 - _PLAY) * load[k, i]), (1 + _PLAY) * load[k, i])
    return play


def _quantize(force: Array, b1: float, b2: float) -> Array:
    """Forces in N after the converter: whole counts by the inverse of the calibration curve, and the curve again.

    Args:
        force: (...) N, not negative.
        b1: Slope of the curve F = b₁ x + b₂ x², kgf per 1000 counts; x are thousands of counts.
        b2: Its quadratic coefficient; 0 for a straight line.
    """
    kgf = force / G
    x = (-b1 + np.sqrt(np.maximum(b1**2 + 4 * b2 * kgf, 0.0))) / (2 * b2) if b2 else kgf / b1
    counts = np.clip(np.round(1000 * x), 0, _FULL_COUNT) / 1000
    return G * (b1 * counts + b2 * counts**2)


_OUTLINE = (0, 1, 3, 2)  # heel, lateral ball, toe, medial ball: the cells' convex outline
_UNLOADED_N = 1e-3  # least load by which a moment is divided


class InsoleModel(SensorModel[OtherSensor, ForceCellPart]):
    """Forces on the cells heel, lateral ball, medial ball and toe, whose weighted mean is the centre of pressure."""

    def __init__(self, calibration: OtherSensor, part: ForceCellPart, noise: Noise) -> None:
        """Reads the places of the cells from the calibration; the arguments are those of `SensorModel`."""
        super().__init__(calibration, part, noise)
        self._places = np.asarray(calibration.parameters["cells_m"], dtype=float)  # (4, 2) m, x and y on the foot
        self._cells = ForceCells(part, len(self._places), calibration.rate_hz, noise)

    def read(self, foot: Track, force_in_world: Array, torque_in_world: Array) -> Block[Insole]:
        """The next samples, at the instants of the track.

        Args:
            foot: Track of the foot's frame, whose z = 0 is the sole.
            force_in_world: (N, 3) load of the ground on the foot, N.
            torque_in_world: (N, 3) its moment about the foot frame's origin, N m.
        """
        to_foot = foot.rotation.inv()
        force, torque = to_foot.apply(force_in_world), to_foot.apply(torque_in_world)
        # centre of pressure on the sole, x and y: the point about which the moment has no horizontal part
        load = np.maximum(force[:, 2], 0.0)  # N, normal to the sole
        cop = np.stack([-torque[:, 1], torque[:, 0]], axis=-1) / np.maximum(load, _UNLOADED_N)[:, None]
        return self._block(Insole, foot.t_ns, force=self._cells.read(load[:, None] * cell_shares(self._places, cop)))


class InteractionModel(SensorModel[OtherSensor, ForceCellPart]):
    """Two preloaded springs, each on a force cell: a force loads one and unloads the other, until that one is free.

    The difference of the two is the force, and its sign the direction (Shim et al. 2019, figure 8).
    """

    def __init__(self, calibration: OtherSensor, part: ForceCellPart, noise: Noise) -> None:
        """Prepares the two cells of the pair; the arguments are those of `SensorModel`."""
        super().__init__(calibration, part, noise)
        self._cells = ForceCells(part, 2, calibration.rate_hz, noise)

    def read(self, t_ns: Instants, force: Array) -> Block[Interaction]:
        """The next samples, from the cuff's force on the limb.

        Args:
            t_ns: (N,) instants.
            force: (N,) N, positive where the cuff presses on the limb's front.
        """
        by_cell = np.stack([force, -force], axis=-1)  # (N, 2) force in the direction that loads each cell
        # each cell bears half of the force on top of its preload, until the other one is free and it bears all
        load = np.maximum(self._part.preload + 0.5 * by_cell, np.maximum(by_cell, 0.0))
        return self._block(Interaction, t_ns, force=self._cells.read(load))


def cell_shares(cells: Array, cop: Array) -> Array:
    """Share of the load on each cell of an insole: Wachspress coordinates of the centre of pressure (Wachspress 1975).

    Args:
        cells: (4, 2) positions of heel, lateral ball, medial ball and toe, a convex outline, m.
        cop: (N, 2) centre of pressure, m; a point outside the outline is moved to its nearest point.

    Returns:
        (N, 4) shares, not negative, with sum 1, whose mean position is the centre of pressure.
    """
    corner = cells[list(_OUTLINE)]
    after, before = np.roll(corner, -1, axis=0), np.roll(corner, 1, axis=0)
    # 1 if the corners run anticlockwise; a right foot's outline is clockwise
    sense = float(np.sign(_cross(after[0] - corner[0], before[0] - corner[0])))
    inside = _clamp_to_outline(corner, after, sense, cop)
    # (N, 4) twice the area of the triangle of each side with the point. The weight of a corner is the area of its
    # triangle with both neighbours, times the areas of the two sides that do not touch it.
    area = np.maximum(sense * _cross(after - corner, inside[:, None] - corner), 0.0)
    weight = sense * _cross(after - corner, before - corner) * np.roll(area, -1, axis=-1) * np.roll(area, -2, axis=-1)
    shares = np.empty_like(weight)
    shares[:, _OUTLINE] = weight / weight.sum(axis=-1, keepdims=True)
    return shares


def _clamp_to_outline(corner: Array, after: Array, sense: float, point: Array) -> Array:
    """(N, 2) points, of which those outside a convex outline are moved to its nearest point.

    Args:
        corner: (K, 2) corners of the outline.
        after: (K, 2) next corner of each.
        sense: 1 if the corners run anticlockwise, -1 if clockwise.
        point: (N, 2) points.
    """
    side = after - corner  # (K, 2)
    to = point[:, None] - corner  # (N, K, 2)
    share = np.clip(np.sum(to * side, axis=-1) / np.sum(side * side, axis=-1), 0.0, 1.0)
    nearest = corner + share[..., None] * side  # (N, K, 2), on each side of the outline
    best = np.argmin(np.linalg.norm(point[:, None] - nearest, axis=-1), axis=-1)
    outside = np.any(sense * _cross(side, to) < 0, axis=-1)
    return np.where(outside[:, None], nearest[np.arange(len(point)), best], point)


def _cross(a: Array, b: Array) -> Array:
    """(...) cross product a_x b_y − a_y b_x of (..., 2) vectors: twice the signed area of their triangle."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
