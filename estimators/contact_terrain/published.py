"""The published method of Shim et al. 2019: a rigid foot touches the ground at its centre of pressure.

The insole's cells give the centre of pressure, Shim 2019 (11), and with the angular rate the phase of each foot
(section 2.2.2). The pivot about which the exoskeleton moves is propagated from foot to foot (section 2.2.3). A plane is
fitted to the markers of each footprint by least squares (sections 2.2.4 and 2.2.5).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from stridetwin.estimators.contact_terrain.estimate import UNKNOWN, StepEstimate, TerrainSvm
from stridetwin.estimators.contact_terrain.geometry import SIDES, Exoskeleton
from stridetwin.estimators.contact_terrain.leg import forward, leg_angles, links
from stridetwin.estimators.contact_terrain.parameters import DEFAULTS, PublishedParameters
from stridetwin.estimators.contact_terrain.ticks import Tick
from stridetwin.streams.samples import Array

# Values that the paper does not specify; hand-chosen. "Doubled" is as in `ContactTerrainParameters`.
# A foot that rotates faster is not flat, unless its centre of pressure is in the middle. Doubled: 1.14°, 7.7 mm.
_ROTATING_RADPS = 0.8
# Shares of the way from the heel's cell to the toe's at which the heel side ends and the front begins. Twice the first:
# 7.5 mm; half the distance of the second from 1: 1.77°, 7.5 mm.
_HEEL_SHARE, _FRONT_SHARE = 0.35, 0.65


def centre_of_pressure(cells: Array, force: Array, pressing_n: float) -> Array | None:
    """(2,) m on the sole, mean of the cells weighted by their forces; None below `pressing_n` on all together.

    Shim 2019 (11), docs/contact_terrain.md (3).

    Args:
        cells: (4, 2) m, places of the cells on the sole.
        force: (4,) N on each cell.
        pressing_n: Least force of a loaded foot, N.
    """
    total = float(force.sum())
    return None if total < pressing_n else force @ cells / total


class Phase(Enum):
    """Phase of one foot, in the order of a step: in the air, on its heel, flat, on its front."""

    FOOT_OFF = "FO"
    HEEL_CONTACT = "HC"
    FOOT_FLAT = "FF"
    HEEL_OFF = "HO"


def foot_phase(cells: Array, cop: Array | None, rate: float) -> Phase:
    """Phase of a foot, by the centre of pressure and the angular rate.

    An unloaded foot is off the ground. One that rotates with the pressure under its heel is in heel contact, one that
    rotates with the pressure under its front is in heel-off. Any other loaded foot is flat.

    Args:
        cells: (4, 2) m, places of the cells on the sole, heel first and toe last.
        cop: (2,) m, centre of pressure; None if the foot is unloaded.
        rate: Angular rate of the foot, rad/s.
    """
    if cop is None:
        return Phase.FOOT_OFF
    share = (cop[0] - cells[0, 0]) / (cells[3, 0] - cells[0, 0])  # 0 at the heel's cell, 1 at the toe's
    if rate > _ROTATING_RADPS and share < _HEEL_SHARE:
        return Phase.HEEL_CONTACT
    if rate > _ROTATING_RADPS and share > _FRONT_SHARE:
        return Phase.HEEL_OFF
    return Phase.FOOT_FLAT


def pivot_foot(phases: Sequence[Phase], load: Array, last: int) -> int:
    """Index in `SIDES` of the foot that holds the pivot.

    It is the loaded foot; of two, the flat one; if both or neither are flat, the one with more load. Without a loaded
    foot it is the last one.

    Args:
        phases: Phase of each foot.
        load: (2,) N on each foot.
        last: Index of the foot that held the pivot so far.
    """
    left_loaded, right_loaded = (phase is not Phase.FOOT_OFF for phase in phases)
    if left_loaded != right_loaded:
        return int(right_loaded)  # 0 left, 1 right
    if not left_loaded:
        return last
    left_flat, right_flat = (phase is Phase.FOOT_FLAT for phase in phases)
    return int(right_flat) if left_flat != right_flat else int(load[1] > load[0])


class Pivot:
    """The pivot in the world; its first position is the origin.

    Attributes:
        foot: Index in `SIDES` of the foot that holds it.
        p_in_world: (3,) m, its position.
    """

    def __init__(self) -> None:
        """Begins at the origin, under the left foot."""
        self.foot = 0
        self.p_in_world = np.zeros(3)
        # latest centre of pressure of each foot, (3,) m in its last frame; None before its first load
        self._cop: list[Array | None] = [None, None]

    def move(self, foot: int, cop_in_foot: Sequence[Array | None], R_world_base: Array, T_base_foot: Array) -> None:
        """Propagates the pivot by the motion in this tick, to the foot that holds it from now on: Shim 2019 (12)-(16).

        If the same foot keeps the pivot, it moves with that foot's centre of pressure. If the other foot takes it, it
        moves from one foot's centre of pressure to the other's. It stays where a foot has never been loaded. An
        unloaded foot keeps its latest centre of pressure.

        Args:
            foot: Index of that foot in `SIDES`.
            cop_in_foot: (3,) m of each foot's centre of pressure in its last frame, None if unloaded.
            R_world_base: (3, 3) rotation, frame 0 to world.
            T_base_foot: (2, 4, 4) poses of the last frames in frame 0.
        """
        latest = [last if cop is None else cop for cop, last in zip(cop_in_foot, self._cop)]
        # where the pivot goes and where it comes from: (3,) m in the last frame of `foot` and of `self.foot`
        to_contact, from_contact = latest[foot], self._cop[foot] if foot == self.foot else latest[self.foot]
        if to_contact is not None and from_contact is not None:
            p_to = T_base_foot[foot, :3, :3] @ to_contact + T_base_foot[foot, :3, 3]
            p_from = T_base_foot[self.foot, :3, :3] @ from_contact + T_base_foot[self.foot, :3, 3]
            self.p_in_world = self.p_in_world + R_world_base @ (p_to - p_from)
        self.foot, self._cop = foot, latest


@dataclass(frozen=True, kw_only=True, eq=False)
class _MarkerPlane:
    """A plane fitted to the markers of one step, Shim 2019 (18).

    Attributes:
        normal: (3,) unit vector, up.
        centre: (3,) m, mean of the markers.
    """

    normal: Array
    centre: Array


class Markers:
    """The markers of one step, stored as sums in constant memory.

    Args:
        parameters: Number of markers for a plane, and placement of virtual ones.

    Attributes:
        count: Number of markers, the virtual ones not counted.
    """

    def __init__(self, parameters: PublishedParameters = DEFAULTS.published) -> None:
        """Begins a footprint without markers."""
        self._parameters = parameters
        self.count = 0
        self._origin = np.zeros(3)  # the first marker, m; moments are about it, for accuracy
        self._sum = np.zeros(3)  # of the markers, m
        # sum of (x, y, 1)ᵀ (x, y, 1, z) over all markers, virtual ones too: both sides, (3, 3) and (3,), of the normal
        # equations of the plane z = a x + b y + d
        self._moments = np.zeros((3, 4))

    def add(self, p_in_world: Array, medial_in_world: Array) -> None:
        """Takes a marker, (3,) m, and makes its virtual one along the (3,) unit vector to the foot's inner side."""
        if self.count == 0:
            self._origin = p_in_world
        self.count += 1
        self._sum += p_in_world
        for point in (p_in_world, p_in_world + self._parameters.virtual_m * medial_in_world):  # marker, virtual one
            x, y, z = point - self._origin
            self._moments += np.outer((x, y, 1.0), (x, y, 1.0, z))

    @property
    def enough(self) -> bool:
        """Whether there are enough markers for a plane."""
        return self.count >= self._parameters.markers_min

    @property
    def centre(self) -> Array:
        """(3,) m, mean of the markers."""
        return self._sum / self.count

    def plane(self) -> _MarkerPlane | None:
        """Least-squares plane z = a x + b y + d; None while there are too few markers.

        Shim 2019 (18), docs/contact_terrain.md (4).
        """
        if not self.enough:
            return None
        # solved as least squares, because the normal equations of collinear markers are singular
        a, b, _ = np.linalg.lstsq(self._moments[:, :3], self._moments[:, 3], rcond=1e-12)[0]
        normal = np.array([-a, -b, 1.0])
        return _MarkerPlane(normal=normal / np.linalg.norm(normal), centre=self.centre)


def slope(normal: Array, heading: Array) -> float:
    """Slope, rad: the angle between the normal and the vertical, positive uphill (docs/contact_terrain.md (5)).

    Shim 2019 (19) as printed is zero for every normal; this follows the paper's text.

    Args:
        normal: (3,) unit vector, up.
        heading: (2,) horizontal direction of the foot.
    """
    angle = math.atan2(math.hypot(normal[0], normal[1]), normal[2])  # from the vertical, rad, ≥ 0
    downhill = float(normal[:2] @ heading)  # > 0 where the normal leans forward: the ground falls in that direction
    return math.copysign(angle, -downhill)


@dataclass(kw_only=True, eq=False)
class _Footprint:
    """The data of one foot since its last touch-down.

    Attributes:
        markers: Markers of its plane.
        step: Number of the step.
        soles: (3,) m, sum of the sole's origins at the markers.
        below: Height of the previous footprint, m; None while that one is still updated.
        over: Whether the heel has lifted after foot-flat: a later flat phase is a pause on the toes, without markers.
    """

    markers: Markers
    step: int = 0
    soles: Array = field(default_factory=lambda: np.zeros(3))
    below: float | None = None
    over: bool = False


class Published:
    """The published method.

    Args:
        exo: Geometry of the exoskeleton.
        svm: Classifies modes by slope and elevation; None leaves every mode unknown.
        parameters: Values that the paper does not specify.
    """

    def __init__(
        self, exo: Exoskeleton, svm: TerrainSvm | None = None, parameters: PublishedParameters = DEFAULTS.published
    ) -> None:
        """Begins with both feet on the ground, at step 0; without `svm`, modes stay unknown."""
        self._svm, self._parameters = svm, parameters
        self._soles = [exo.legs[side].sole for side in SIDES]
        self._links = [links(exo.legs[side]) for side in SIDES]
        self._pivot = Pivot()
        self._prints = [_Footprint(markers=Markers(parameters)), _Footprint(markers=Markers(parameters))]
        self._down = [True, True]  # whether each foot is loaded
        self._steps = 0  # number of touch-downs

    def update(self, tick: Tick) -> StepEstimate | None:
        """Takes a tick; returns the new estimate of the last footprint, or None if nothing changed.

        Only a tick in which the foot with the pivot is flat adds a marker. After its heel has lifted, a footprint is
        over and takes no more.
        """
        T_base_foot = np.empty((2, 4, 4))  # pose of each foot's last frame in the back panel's
        for i, leg in enumerate(self._links):
            q = leg_angles(leg, tick.R, i, tick.knee[i])
            T_base_foot[i] = forward(leg.table, leg.turns, q)[-1]
        pressing_n = self._parameters.pressing_n
        # (2,) m, centre of pressure on the sole of each foot; None if the foot is unloaded
        cops = [centre_of_pressure(sole.cells, force, pressing_n) for sole, force in zip(self._soles, tick.force)]
        phases = [
            foot_phase(sole.cells, cop, float(np.linalg.norm(rate)))
            for sole, cop, rate in zip(self._soles, cops, tick.rate[3:])
        ]
        contacts = [  # (3,) m, centre of pressure in the foot's last frame; None if the foot is unloaded
            None if cop is None else sole.T_foot_sole[:3, :2] @ cop + sole.T_foot_sole[:3, 3]
            for sole, cop in zip(self._soles, cops)
        ]
        foot = pivot_foot(phases, tick.force.sum(axis=1), self._pivot.foot)
        self._pivot.move(foot, contacts, tick.R[0], T_base_foot)
        self._start_footprints(phases)
        contact, footprint = contacts[foot], self._prints[foot]  # of the foot with the pivot
        if phases[foot] is not Phase.FOOT_FLAT or contact is None or footprint.over:
            return None
        return self._add_marker(tick, foot, contact, tick.R[0] @ T_base_foot[foot, :3, :3])

    def _start_footprints(self, phases: list[Phase]) -> None:
        """Begins a new footprint where a foot touches down, and marks those as over whose heel has lifted.

        The other foot's footprint gets the final height of the finished one in `below`, if that is not set yet.

        Args:
            phases: Phase of each foot in this tick.
        """
        for i, phase in enumerate(phases):
            down = phase is not Phase.FOOT_OFF
            if down and not self._down[i]:
                finished, other = self._prints[i], self._prints[1 - i]
                if finished.markers.count and other.below is None:
                    other.below = float(finished.markers.centre[2])
                self._steps += 1
                self._prints[i] = _Footprint(markers=Markers(self._parameters), step=self._steps)
            self._down[i] = down
            footprint = self._prints[i]
            footprint.over |= footprint.step > 0 and footprint.markers.enough and phase is Phase.HEEL_OFF

    def _add_marker(self, tick: Tick, foot: int, contact: Array, R_world_foot: Array) -> StepEstimate | None:
        """Adds the pivot to its foot's markers; returns the step's estimate, None without a plane or a step before.

        Args:
            tick: The current tick.
            foot: Index in `SIDES` of the foot that holds the pivot, flat on the ground.
            contact: (3,) m, centre of pressure in the foot's last frame.
            R_world_foot: (3, 3) rotation, last frame to world.
        """
        sole, footprint, previous = self._soles[foot], self._prints[foot], self._prints[1 - foot]
        R_world_sole = R_world_foot @ sole.T_foot_sole[:3, :3]
        medial = R_world_sole[:, 1] if SIDES[foot] == "r" else -R_world_sole[:, 1]  # inner side; the y axis is left
        footprint.markers.add(self._pivot.p_in_world, medial)
        # the sole's origin in the world: from the centre of pressure, which is at the pivot, to it
        footprint.soles += self._pivot.p_in_world + R_world_foot @ (sole.T_foot_sole[:3, 3] - contact)
        plane = footprint.markers.plane()
        below = footprint.below  # final height of the previous footprint, m
        if below is None and previous.markers.count:  # it is still updated: its mean so far
            below = previous.markers.centre[2]
        if plane is None or below is None:
            return None
        angle, elevation = slope(plane.normal, R_world_sole[:2, 0]), float(plane.centre[2] - below)
        mode, probability = (UNKNOWN, 0.0) if self._svm is None else (self._svm.classify(angle, elevation), 1.0)
        return StepEstimate(
            t_ns=tick.t_ns,
            step=footprint.step,
            foot=SIDES[foot],
            slope=angle,
            elevation=elevation,
            slope_sd=np.inf,
            elevation_sd=np.inf,
            normal=plane.normal,
            p_sole_in_world=footprint.soles / footprint.markers.count,
            covariance=np.diag(np.full(3, np.inf)),
            mode=mode,
            probability=probability,
        )
