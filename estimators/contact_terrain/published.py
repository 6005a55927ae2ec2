"""The method of Shim et al. 2019 as it is published: a rigid foot that touches the ground in its centre of pressure."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from stridetwin.estimators.contact_terrain.classes import TerrainSvm
from stridetwin.estimators.contact_terrain.cop import centre_of_pressure, on_sole
from stridetwin.estimators.contact_terrain.estimate import UNKNOWN, StepEstimate
from stridetwin.estimators.contact_terrain.geometry import SIDES, Exoskeleton
from stridetwin.estimators.contact_terrain.leg import forward, leg_angles, links
from stridetwin.estimators.contact_terrain.parameters import DEFAULTS, PublishedParameters
from stridetwin.estimators.contact_terrain.phases import Phase, foot_phase
from stridetwin.estimators.contact_terrain.pivot import Pivot, pivot_foot
from stridetwin.estimators.contact_terrain.plane import Markers, slope
from stridetwin.estimators.contact_terrain.ticks import Tick
from stridetwin.streams.samples import Array


@dataclass(kw_only=True, eq=False)
class _Footprint:
    """What one foot has collected since it last touched down.

    Attributes:
        markers: Of its plane.
        step: Number of the step.
        soles: (3,) m, sum of where the sole's origin was at each marker.
        below: Height of the footprint before, m; None while that one is still updated.
        over: The heel has come off after the foot was flat: what looks flat from here on is a pause on the toes.
    """

    markers: Markers
    step: int = 0
    soles: Array = field(default_factory=lambda: np.zeros(3))
    below: float | None = None
    over: bool = False


class Published:
    """The published method.

    Args:
        exo: Geometry.
        svm: Tells modes from slope and elevation; None leaves every mode unknown.
        parameters: What the paper leaves open.
    """

    def __init__(
        self, exo: Exoskeleton, svm: TerrainSvm | None = None, parameters: PublishedParameters = DEFAULTS.published
    ) -> None:
        self._svm, self._parameters = svm, parameters
        self._soles = [exo.legs[side].sole for side in SIDES]
        self._links = [links(exo.legs[side]) for side in SIDES]
        self._pivot = Pivot()
        self._prints = [_Footprint(markers=Markers(parameters)), _Footprint(markers=Markers(parameters))]
        self._down = [True, True]
        self._steps = 0

    def update(self, tick: Tick) -> StepEstimate | None:
        """Takes a tick; returns what it tells of the last footprint, None where it tells nothing new."""
        T_base_foot = np.empty((2, 4, 4))
        for i, leg in enumerate(self._links):
            q = leg_angles(leg, tick.R_world_base, tick.R_world_thigh[i], tick.R_world_foot[i], tick.knee[i])
            T_base_foot[i] = forward(leg.table, leg.turns, q)[-1]
        pressing_n = self._parameters.pressing_n
        cops = [centre_of_pressure(sole.cells, force, pressing_n) for sole, force in zip(self._soles, tick.force)]
        phases = [
            foot_phase(sole.cells, cop, float(np.linalg.norm(rate)), self._parameters)
            for sole, cop, rate in zip(self._soles, cops, tick.rate[3:])
        ]
        contacts = [
            None if cop is None else on_sole(sole.T_foot_sole, cop) for sole, cop in zip(self._soles, cops)
        ]  # fmt: skip
        foot = pivot_foot(phases, tick.force.sum(axis=1), self._pivot.foot)
        self._pivot.move(foot, contacts, tick.R_world_base, T_base_foot)
        self._touch(phases)
        contact, own = contacts[foot], self._prints[foot]
        if phases[foot] is not Phase.FOOT_FLAT or contact is None or own.over:
            return None
        return self._mark(tick, foot, contact, tick.R_world_base @ T_base_foot[foot, :3, :3])

    def _touch(self, phases: list[Phase]) -> None:
        """Begins a new footprint where a foot touches down."""
        for i, phase in enumerate(phases):
            down = phase is not Phase.FOOT_OFF
            if down and not self._down[i]:
                other = self._prints[1 - i]
                if self._prints[i].markers.count and other.below is None:
                    other.below = float(self._prints[i].markers.centre[2])
                self._steps += 1
                self._prints[i] = _Footprint(markers=Markers(self._parameters), step=self._steps)
            self._down[i] = down
            own = self._prints[i]
            own.over |= own.step > 0 and own.markers.enough and phase is Phase.HEEL_OFF

    def _mark(self, tick: Tick, foot: int, contact: Array, R_world_foot: Array) -> StepEstimate | None:
        """Adds the pivot to its foot's markers and tells what they say."""
        sole, own, other = self._soles[foot], self._prints[foot], self._prints[1 - foot]
        R_world_sole = R_world_foot @ sole.T_foot_sole[:3, :3]
        medial = R_world_sole[:, 1] if SIDES[foot] == "r" else -R_world_sole[:, 1]
        own.markers.add(self._pivot.p_in_world, medial)
        own.soles += self._pivot.p_in_world + R_world_foot @ (sole.T_foot_sole[:3, 3] - contact)
        plane = own.markers.plane()
        below = own.below if own.below is not None else other.markers.centre[2] if other.markers.count else None
        if plane is None or below is None:
            return None
        angle, elevation = slope(plane.normal, R_world_sole[:2, 0]), float(plane.centre[2] - below)
        told = (UNKNOWN, 0.0) if self._svm is None else (self._svm.classify(angle, elevation), 1.0)
        return StepEstimate(
            t_ns=tick.t_ns, step=own.step, foot=SIDES[foot], slope=angle, elevation=elevation, slope_sd=np.inf,
            elevation_sd=np.inf, normal=plane.normal, p_sole_in_world=own.soles / own.markers.count,
            covariance=np.diag(np.full(3, np.inf)), mode=told[0], probability=told[1],
        )  # fmt: skip
