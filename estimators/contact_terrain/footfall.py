"""Loads under a foot, when it lands, and its attitude while it is flat.

A cell's output with the foot in the air is not load. Each cell's minimum over the last strides, counted in time that
the foot spent rotating, is subtracted. This removes creep and drift; a stuck or dead cell then reports zero.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.contact_terrain.geometry import Sole
from stridetwin.streams.algebra.matrices import apply, dot, hat
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.samples import Array

# Hand-chosen on simulated walks of S1-S3, seeds 0-16.
_ROTATING_RADPS = 1.0  # a foot that rotates faster may be in the air
_ALIVE_N = 40.0  # a cell whose force changes less within strides is dead or stuck
_STRIDE_S = 0.6  # rotating time of somewhat more than one stride
_FLAT_RADPS = 0.6  # a foot that rotates faster is not flat
_HALF_WEIGHT_RADPS = 0.2  # at this rate the attitude of a flat foot has half its weight
_SHARED_WEIGHT = 0.05  # weight of a flat foot's attitude while the other foot carries load too
_STRAINED_WEIGHT = 0.02  # weight of a flat foot's attitude while its ankle is at a stop
_FREE_WEIGHT = 1.0  # sum of the other weights at which attitudes with the ankle at a stop are not needed
_HEEL_RISES_RAD = math.radians(1.5)  # a foot pitched down by this against its flat attitude is lifting its heel
_FLAT_TICKS = 6  # ticks for which a foot has to be flat before its slope is estimated


class CellLoads:
    """Loads on the four cells of one insole, with each cell's output in the air subtracted.

    A "stride" is here `_STRIDE_S` of time in which the foot rotates: whoever stands still makes no stride.
    """

    def __init__(self) -> None:
        """Begins with a foot of which no sample is known."""
        # (2, 4) N, least force of each cell while the foot rotated, in this stride and in the last
        self._least = np.full((2, 4), np.inf)
        # (3, 4) N, largest force of each cell in this stride and the last two: one long swing, as over two risers, may
        # last for two strides
        self._most = np.full((3, 4), -np.inf)
        self._rotating_s = 0.0  # rotating time in this stride
        self._force = np.zeros(4)  # N, the newest measured force of each cell, which `empty` takes as zero

    def update(self, force: Array, rate: float, dt: float) -> Array:
        """Takes one tick of an insole; returns the (4,) load on each cell, N.

        The load is the measured force minus the cell's least force in this stride and the last. Before the end of the
        first stride it is the measured force.

        Args:
            force: (4,) N as measured.
            rate: Angular rate of the foot, rad/s.
            dt: Time since the last tick, s.
        """
        self._force = force
        self._most[0] = np.maximum(self._most[0], force)
        if rate > _ROTATING_RADPS:
            self._least[0] = np.minimum(self._least[0], force)
            self._rotating_s += dt
        if self._rotating_s > _STRIDE_S:  # the stride ends: row 0 moves to row 1, and a new row 0 begins
            self._rotating_s = 0.0
            self._least[1] = self._least[0]
            self._least[0] = force
            self._most[1:] = self._most[:-1].copy()
            self._most[0] = force
        if not np.isfinite(self._least[1]).all():  # before the end of the first stride no unloaded output is known
            return force
        load: Array = force - self._least.min(axis=0)
        return load

    def empty(self) -> None:
        """Marks the foot as in the air: from now on the newest measured force of each cell counts as no load."""
        self._least = np.stack([self._force, self._force])

    @property
    def alive(self) -> NDArray[np.bool_]:
        """(4,) whether each cell works: its force has changed by more than `_ALIVE_N` in the last strides."""
        force_range = self._most.max(axis=0) - self._least.min(axis=0)  # (4,) N, largest minus least force
        has_changed: NDArray[np.bool_] = force_range > _ALIVE_N
        return has_changed


_HERE = Path(__file__).parent


class Footfall:
    """A foot from one landing to the next.

    Args:
        step: Number of the step that ended with this landing; 0 for feet that stand at the start.
        on_heel: Whether it landed on the heel rather than the forefoot.

    Attributes:
        step: Number of the step.
        on_heel: Whether it landed on the heel.
        forward, up: (3,) weighted sums of the sole's axes in the world over the ticks in which it was flat.
        weight: Sum of the weights of these ticks.
        ticks: Number of these ticks.
    """

    def __init__(self, step: int, on_heel: bool) -> None:
        """Begins with a landing: the number of the step that it ends, and whether it was on the heel."""
        self.step, self.on_heel = step, on_heel
        self.forward, self.up = np.zeros(3), np.zeros(3)
        self.weight, self.ticks = 0.0, 0
        self._highest = -math.inf  # largest pitch of the flat foot so far, rad, toes up positive
        self._free_weight = 0.0  # sum of the weights of the flat ticks with the ankle clear of its stops

    def add(self, R_world_sole: Array, rate: float, loaded: bool, alone: bool, free: bool) -> bool:
        """Takes one tick of a foot on the ground; if the foot is flat, its attitude enters a weighted mean.

        The foot is flat if it is loaded, rotates slowly, and has not begun to lift its heel: its toes have not gone
        down by more than `_HEEL_RISES_RAD` from their highest pitch while flat. The mean attitude follows from the
        sums `forward`, `up` and `weight`. A tick weighs less the faster the foot rotates, much less while the other
        foot carries load too, and least with the ankle at a stop.

        Args:
            R_world_sole: (3, 3) rotation, sole to world.
            rate: Angular rate of the foot, rad/s.
            loaded: Whether it is loaded.
            alone: Whether the other foot is unloaded: a foot that has just landed is still being pressed flat.
            free: Whether the ankle is clear of its stops: at a stop the leg rotates the exoskeleton's foot off the
                shoe.

        Returns:
            Whether the foot is flat in this tick. If not, nothing changes.
        """
        pitch = math.asin(max(-1.0, min(1.0, R_world_sole[2, 0])))  # of the sole's x axis, rad; toes up is positive
        if not loaded or rate > _FLAT_RADPS or pitch < self._highest - _HEEL_RISES_RAD:
            return False
        self._highest = max(self._highest, pitch)
        weight = (1.0 if alone else _SHARED_WEIGHT) / (1.0 + (rate / _HALF_WEIGHT_RADPS) ** 2)
        self._free_weight += weight if free else 0.0
        weight *= 1.0 if free else _STRAINED_WEIGHT
        self.forward += weight * R_world_sole[:, 0]
        self.up += weight * R_world_sole[:, 2]
        self.weight += weight
        self.ticks += 1
        return True

    @property
    def flat(self) -> bool:
        """Whether the foot has been flat long enough to estimate the ground's slope."""
        return self.ticks >= _FLAT_TICKS

    @property
    def strained(self) -> float:
        """How much the mean attitude depends on ticks with the ankle at a stop: 1 entirely, 0 not at all.

        It is 0 once the other ticks have a weight of `_FREE_WEIGHT`.
        """
        return max(0.0, 1.0 - self._free_weight / _FREE_WEIGHT)

    def pitch_down(self, R_world_sole: Array) -> float:
        """Pitch of the foot, rad, toes down positive, relative to its mean attitude while flat; 0 before that.

        `R_world_sole` is its attitude now, (3, 3), sole to world.
        """
        if self.weight == 0.0:
            return 0.0
        flat = math.atan2(self.forward[2], math.hypot(self.forward[0], self.forward[1]))
        return flat - math.asin(max(-1.0, min(1.0, R_world_sole[2, 0])))

    def R_world_sole(self) -> Array:
        """(3, 3) mean attitude of the flat sole, sole to world; the foot must have been flat in a tick."""
        return _rotation_from_axes(self.forward, self.up)


@entry_kernel(_HERE)
def _rotation_from_axes(forward: Array, up: Array) -> Array:
    """(3, 3) rotation whose z axis is along `up`, and whose x axis is as close to `forward` as possible.

    Both are (3,) of any length, and not parallel. The columns of the rotation are its axes x, y and z.
    """
    z, x, R = np.empty(3), np.empty(3), np.empty((3, 3))
    length = math.sqrt(dot(up, up))
    for i in range(3):
        z[i] = up[i] / length
    along = dot(forward, z)  # component of `forward` along z, which x must not have
    for i in range(3):
        x[i] = forward[i] - along * z[i]
    length = math.sqrt(dot(x, x))
    for i in range(3):
        x[i] /= length
    y = apply(hat(z), x)  # z × x
    for i in range(3):
        R[i, 0], R[i, 1], R[i, 2] = x[i], y[i], z[i]
    return R


def contact_point(sole: Sole, on_heel: bool) -> Array:
    """(3,) m on the sole, the point about which the foot rolls: the heel's edge if `on_heel`, else the toe hinge."""
    return np.array([sole.heel_x, 0.0, 0.0]) if on_heel else np.array([sole.hinge_x, 0.0, sole.hinge_z])
