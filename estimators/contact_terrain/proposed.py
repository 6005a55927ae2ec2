"""The proposed method: fixed contact points, attitudes from gyros, and offsets estimated during the walk."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stridetwin.estimators.contact_terrain.estimate import (
    StepEstimate,
    height_beyond_slopes,
    mode_probabilities,
    most_likely,
    ramp_probability,
)
from stridetwin.estimators.contact_terrain.footfall import CellLoads, Footfall, contact_point
from stridetwin.estimators.contact_terrain.geometry import SIDES, Exoskeleton, Sole
from stridetwin.estimators.contact_terrain.leg import (
    FOOT,
    OFFSETS,
    SAG,
    at_stop,
    foot_position,
    leg_angles,
    links,
    rotation_jacobian,
)
from stridetwin.estimators.contact_terrain.offsets import Offsets, Posterior, StepFigures
from stridetwin.estimators.contact_terrain.parameters import DEFAULTS, ContactTerrainParameters
from stridetwin.estimators.contact_terrain.ticks import Attitudes, Tick
from stridetwin.streams.samples import Array

# Hand-chosen on simulated walks of S1-S3, seeds 0-16.
_BOUNCE_NS = 120_000_000  # a foot that touches down again sooner has not left the ground
_TOES_DOWN_RAD = math.radians(8.0)  # a foot pitched down by more at touch-down lands on the forefoot
_LOADED_N = 100.0  # load from which on a foot counts as carrying weight
_BOTH_N = 150.0  # load on both feet from which on a tick has full weight
_SINGLE_SUPPORT_N = 300.0  # the load in single support is above this
_SWING_RADPS = 3.0  # a foot on the ground seldom rotates faster
_CREPT_SHARE = 0.15  # share of the other foot's load that the cells of a foot in the air may report together
# Toes in push-off, by hand: people's bend by 25-30°, and then the shoe rolls over its tip.
_TOES_BEND_RAD = math.radians(15.0)  # pitch of the foot up to which the toes stay flat
_TOES_YIELD_RAD = math.radians(25.0)  # more pitch, in which they cease to bend, after half of it
_ROLLING_RAD = math.radians(6.0)  # pitch beyond that at which a foot that leaves has half its weight
_LANDING_RADPS = 0.7  # angular rate at which a foot that landed on its heel has half its weight


def risen_hinge(sole: Sole, pitch: float) -> Array:
    """(3,) m, by which the toe hinge has moved since the foot lay flat, in the axes of its footprint.

    The toes lift by the pitch less what they bend, φ, about their tip: d − R_y(φ) d with the way d from hinge to tip.

    Args:
        sole: The sole.
        pitch: Of the foot since it was flat, rad, toes down positive.
    """
    x = max(pitch - _TOES_BEND_RAD, 0.0)
    roll = 0.5 * x * x / _TOES_YIELD_RAD if x < _TOES_YIELD_RAD else x - 0.5 * _TOES_YIELD_RAD
    along, c, s = sole.tip_x - sole.hinge_x, math.cos(roll), math.sin(roll)
    return np.array([along * (1.0 - c) + sole.hinge_z * s, 0.0, along * s - sole.hinge_z * (1.0 - c)])


class DoubleSupport:
    """The vector from one foot's contact to the other's while both are down, a weighted mean over ticks.

    Attributes:
        weight: Sum of the weights of all ticks.
        strained: Sum of the weights of the ticks with an ankle at its stop.
    """

    def __init__(self) -> None:
        """Begins a step without ticks."""
        self.weight = self.strained = 0.0
        # weighted sums over the ticks: vectors, their derivatives by the offsets, squares of their coordinates
        self._vector, self._J = np.zeros(3), np.zeros((3, OFFSETS))
        self._squares = np.zeros(3)

    def add(self, weight: float, vector: Array, J: Array, free: bool) -> None:
        """Adds the vector between the contacts in one tick to the weighted mean.

        Args:
            weight: Weight of the tick.
            vector: (3,) m, from the old contact to the new one, in world axes.
            J: (3, OFFSETS) derivative of `vector` by the offsets.
            free: Whether both ankles are clear of their stops.
        """
        self.weight += weight
        self.strained += 0.0 if free else weight
        self._vector += weight * vector
        self._squares += weight * vector**2
        self._J += weight * J

    def mean(self) -> tuple[Array, Array]:
        """(3,) m, the mean vector, and its (3, OFFSETS) derivative."""
        return self._vector / self.weight, self._J / self.weight

    def spread(self) -> Array:
        """(3,) m, standard deviation of the vector over the ticks.

        Both horizontal axes have the root mean square of the two.
        """
        # mean of the squares minus square of the mean, which rounding may make negative
        variance = np.maximum(self._squares / self.weight - (self._vector / self.weight) ** 2, 0.0)
        variance[:2] = variance[:2].mean()
        return np.asarray(np.sqrt(variance))


class Proposed:
    """The proposed method.

    Args:
        exo: Geometry of the exoskeleton.
        parameters: Parameters of sensors, walkers and buildings.
    """

    def __init__(self, exo: Exoskeleton, parameters: ContactTerrainParameters = DEFAULTS) -> None:
        """Begins with both feet on the ground, at step 0."""
        self._parameters, self._compliance = parameters, exo.compliance
        self._soles = soles = [exo.legs[side].sole for side in SIDES]
        self._R_foot_sole = [sole.T_foot_sole[:3, :3] for sole in soles]
        # fixed contact points of each foot, (3,) m on the sole and in the last frame: [side][False] is the toe hinge,
        # [side][True] the heel's edge
        self._on_sole = [[contact_point(sole, on_heel) for on_heel in (False, True)] for sole in soles]
        self._on_foot = [
            [R @ point + sole.T_foot_sole[:3, 3] for point in points]
            for sole, R, points in zip(soles, self._R_foot_sole, self._on_sole)
        ]
        self._links = [links(exo.legs[side]) for side in SIDES]
        self._attitudes = Attitudes(parameters)
        self._offsets = Offsets(parameters, exo.compliance.sag_sd_m)
        self._cells = [CellLoads(), CellLoads()]
        self._contacts = [Footfall(0, True), Footfall(0, True)]  # newest landing of each foot
        self._down, self._left_ns = [True, True], [0, 0]  # whether each foot is down; when it left the ground last, ns
        self._newest, self._steps = 0, 0  # index of the foot that landed last; number of landings
        self._support = DoubleSupport()  # of the current step
        self._posterior: Posterior | None = None  # newest estimate of the current step
        self._p_before = np.zeros(3)  # previous footprint, m, world: the one that the current step's vector starts at

    def update(self, tick: Tick) -> StepEstimate | None:
        """Takes a tick; returns the new estimate of the last footprint, or None if nothing changed.

        In order: loads and attitudes; landings; the vector between the feet while both are down; lift-offs; the
        attitude of flat feet. There is an estimate in ticks in which the foot that landed last is flat, once it has
        been so for long enough.
        """
        if tick.dt == 0.0:  # the first tick, or one after a gap
            self._reset_contacts()
        self._attitudes.update(tick)
        rates = np.sqrt((tick.rate[3:] ** 2).sum(axis=1))  # (2,) angular rates of the feet, rad/s
        # (4,) N for each foot, load on its cells; (2,) N, load on each foot
        cells = [
            cell_loads.update(force, float(rate), tick.dt)
            for cell_loads, force, rate in zip(self._cells, tick.force, rates)
        ]
        loads = np.array([cell_load.sum() for cell_load in cells])
        R = self._attitudes.R  # (5, 3, 3) frame to world: back, thighs, feet
        R_world_sole = [R[3 + i] @ R_foot_sole for i, R_foot_sole in enumerate(self._R_foot_sole)]
        angles = [leg_angles(leg, R, i, tick.knee[i]) for i, leg in enumerate(self._links)]  # rad, all joints per leg
        free = [  # whether each ankle is clear of its stops
            not at_stop(leg.ankle_stops, q, self._compliance.stop_margin_rad) for leg, q in zip(self._links, angles)
        ]
        for side in range(2):
            self._detect_landing(side, tick.t_ns, loads, rates, cells[side], R_world_sole[side])
        if all(self._down):
            old = 1 - self._newest
            raised = self._contacts[old].pitch_down(R_world_sole[old])
            self._add_support(angles, loads, float(rates[self._newest]), raised, all(free))
        self._detect_lift_off(tick.t_ns, loads, rates, cells)
        flat = [False, False]  # whether each foot is flat in this tick
        for i in range(2):
            if self._down[i]:
                loaded, alone = bool(loads[i] > _LOADED_N), bool(loads[1 - i] < _LOADED_N)
                flat[i] = self._contacts[i].add(R_world_sole[i], float(rates[i]), loaded, alone, free[i])
        new = self._newest
        # without a tick in double support there is no vector between the feet
        if not flat[new] or not self._contacts[new].flat or self._support.weight == 0.0:
            return None
        return self._estimate(tick.t_ns)

    def _detect_landing(
        self, side: int, t_ns: int, loads: Array, rates: Array, cells: Array, R_world_sole: Array
    ) -> None:
        """Marks a foot as down once it has landed, and begins a step.

        A walker always has one foot down. If the only foot on the ground unloads and rotates faster than the other one,
        it is lifting off: the other foot has landed on cells that do not respond. A foot that lands within `_BOUNCE_NS`
        of leaving the ground has bounced: it is down, but begins no step.

        Args:
            side: Index of the foot in `SIDES`.
            t_ns: Time of the tick.
            loads: (2,) N, load on each foot.
            rates: (2,) rad/s, angular rate of each foot.
            cells: (4,) N, load on each cell of this foot, the heel's first.
            R_world_sole: (3, 3) attitude of this foot's sole.
        """
        other, parameters = 1 - side, self._parameters
        other_lifts_off = loads[other] < parameters.left_n and rates[other] > rates[side]
        if self._down[side] or not (loads[side] > parameters.landed_n or other_lifts_off):
            return
        self._down[side] = True
        if t_ns - self._left_ns[side] > _BOUNCE_NS:
            # whether the heel's cell works, and the cells have detected the landing
            reliable = loads[side] > parameters.landed_n and self._cells[side].alive[0]
            heel_bears_most = 2.0 * cells[0] > loads[side]
            toes_not_down = R_world_sole[2, 0] > -math.sin(_TOES_DOWN_RAD)  # by the sine of its pitch, toes up positive
            self._begin_step(side, bool(heel_bears_most if reliable else toes_not_down))

    def _detect_lift_off(self, t_ns: int, loads: Array, rates: Array, cells: Sequence[Array]) -> None:
        """Marks a foot as off the ground once it has no load, if the other one is down.

        One foot always stays down: of two unloaded feet the one that rotates less. A foot that swings beside a loaded
        one, with little load except on one cell, has left the ground, too: that cell is stuck, or all have crept.

        Args:
            t_ns: Time of the tick.
            loads: (2,) N, load on each foot.
            rates: (2,) rad/s, angular rate of each foot.
            cells: (4,) N of each foot, load on its cells.
        """
        for side in sorted(range(2), key=lambda side: -rates[side]):  # the foot that rotates faster first
            swings = rates[side] > _SWING_RADPS and loads[1 - side] > _SINGLE_SUPPORT_N
            # the foot is off the ground below `least_load`, N; of one that swings, the most loaded cell does not count
            if swings:
                load, least_load = loads[side] - cells[side].max(), _CREPT_SHARE * loads[1 - side]
            else:
                load, least_load = loads[side], self._parameters.left_n
            if all(self._down) and load < least_load:
                self._down[side], self._left_ns[side] = False, t_ns
                self._cells[side].empty()

    def _begin_step(self, side: int, on_heel: bool) -> None:
        """Begins a step with the landing of a foot; stores the result of the previous step.

        Args:
            side: Index in `SIDES` of the foot that has landed.
            on_heel: Whether it landed on the heel.
        """
        if self._posterior is not None:  # None: the previous step gave no estimate
            self._offsets.store(self._posterior)
            if side != self._newest:  # a foot that lands twice steps from the other foot both times
                self._p_before = self._p_before + self._posterior.values[:3]
        self._steps += 1
        self._contacts[side] = Footfall(self._steps, on_heel)
        self._newest, self._support, self._posterior = side, DoubleSupport(), None

    def _reset_contacts(self) -> None:
        """Forgets attitudes and vector measured in this step: after a gap the feet may have moved."""
        self._contacts = [Footfall(fall.step, fall.on_heel) for fall in self._contacts]
        self._support, self._posterior = DoubleSupport(), None

    def _add_support(self, angles: list[Array], loads: Array, rate: float, raised: float, free: bool) -> None:
        """Adds a tick with both feet down to the vector between their contacts (docs/contact_terrain.md (7)).

        The vector goes from the toe hinge of the old foot to the heel's edge of the new one or, if it landed on the
        forefoot, to its toe hinge. A tick weighs less while the load is still on one foot, or a heel still rotates, and
        the more the old foot is pitched beyond what toes bend: then it rolls over its tip, and its hinge has risen by
        `risen_hinge`, which differs from person to person.

        Args:
            angles: Joint angles of each leg, rad, from `leg_angles`.
            loads: (2,) N, load on each foot.
            rate: Angular rate of the foot that landed last, rad/s.
            raised: Pitch of the old foot since it was flat, rad, toes down positive.
            free: Whether both ankles are clear of their stops.
        """
        new, old = self._newest, 1 - self._newest
        fall = self._contacts[new]
        weight = min(1.0, max(float(loads.min()), 1.0) / _BOTH_N) ** 2  # at least that of 1 N, never 0
        if fall.on_heel:
            weight /= 1.0 + (rate / _LANDING_RADPS) ** 2
        weight /= 1.0 + (max(raised - _TOES_BEND_RAD, 0.0) / _ROLLING_RAD) ** 2
        vector, J = self._contact_position(new, fall.on_heel, angles[new])
        before, J_before = self._contact_position(old, False, angles[old])
        if raised > _TOES_BEND_RAD:
            before = before - self._contacts[old].R_world_sole() @ risen_hinge(self._soles[old], raised)
        J = J - J_before
        J[2, SAG] = 1.0 if fall.on_heel else 0.0  # the sag of a loaded heel acts on the height only
        self._support.add(weight, vector - before, J, free)

    def _contact_position(self, side: int, on_heel: bool, q: Array) -> tuple[Array, Array]:
        """A foot's fixed contact point relative to the back panel, in world axes, and its derivative.

        Args:
            side: Index of the foot in `SIDES`.
            on_heel: Whether the contact is the heel's edge rather than the toe hinge.
            q: Angles of all joints of the leg, rad.

        Returns:
            (3,) m; (3, OFFSETS) its derivative by the offsets.
        """
        R = self._attitudes.R
        p, J = foot_position(self._links[side], R, side, q)
        arm = R[3 + side] @ self._on_foot[side][on_heel]  # (3,) m, from the last frame to the contact, world axes
        # a rotation of the foot moves the contact point by the arm, too
        J[:, FOOT + 3 * side : FOOT + 3 * side + 3] += rotation_jacobian(arm, R[3 + side])
        return p + arm, J

    def _measure_step(self) -> StepFigures:
        """The measurements of the current step so far, with their derivatives by the offsets and their errors.

        The mean vector between the contact points is turned into one between the origins of the soles: the arm from
        sole to contact is subtracted for the new foot and added for the old one. The slope of a foot is the pitch of
        its mean flat attitude, toes up positive. The ground's tilt sideways is the weighted mean of both rolls. Of a
        foot that was not flat, the level stands in.
        """
        new, old = self._newest, 1 - self._newest
        vector, J = self._support.mean()
        slopes, J_slopes = np.zeros(2), np.zeros((2, OFFSETS))
        forwards, lefts = np.zeros((2, 3)), np.zeros((2, 3))  # axes of both soles in the world
        J_rolls = np.zeros((2, OFFSETS))
        # for each foot: its index, the sign of its arm, and whether its contact is the heel's edge
        feet = ((new, -1.0, self._contacts[new].on_heel), (old, 1.0, False))
        for k, (side, sign, on_heel) in enumerate(feet):
            fall = self._contacts[side]
            R_world_sole = fall.R_world_sole() if fall.weight else np.eye(3)
            R_world_foot = R_world_sole @ self._R_foot_sole[side].T
            arm = R_world_sole @ self._on_sole[side][on_heel]  # (3,) m, from the sole's origin to the contact
            columns = slice(FOOT + 3 * side, FOOT + 3 * side + 3)  # of the rotation of this foot's frame
            vector = vector + sign * arm
            J[:, columns] += sign * rotation_jacobian(arm, R_world_foot)
            forward = R_world_sole[:, 0].copy()  # forward axis of the sole in the world; its z is the sine of the slope
            slopes[k] = math.asin(max(-1.0, min(1.0, forward[2])))
            J_slopes[k, columns] = rotation_jacobian(forward, R_world_foot)[2] / math.cos(slopes[k])
            forwards[k], lefts[k] = forward, R_world_sole[:, 1]
            J_rolls[k, columns] = rotation_jacobian(lefts[k], R_world_foot)[2]
        strained = np.array([self._contacts[new].strained, self._contacts[old].strained])
        compliance = self._compliance
        # (2,) rad, of either foot: pitch in its holder, also by the slope, and more with the ankle at its stop
        slope_sd = np.sqrt(
            compliance.slope_sd_rad**2
            + (compliance.slope_share * slopes) ** 2
            + (compliance.strained_slope_sd_rad * strained) ** 2
        )
        # (3,) m: slack and soft soles; an ankle at its stop; of the height, holders that yield under a climb; motion of
        # the frame during double support
        place_sd = np.hypot(
            compliance.vector_sd_m, compliance.strained_sd_m * self._support.strained / self._support.weight
        )
        place_sd[2] = math.hypot(place_sd[2], compliance.climb_share * max(vector[2], 0.0))
        place_sd = np.hypot(
            place_sd, compliance.spread_gain * np.maximum(self._support.spread() - compliance.steady_m, 0.0)
        )
        # a sole rolls in its holder as it pitches, so that the mean of both rolls has the weights of the slopes
        weights = 1.0 / slope_sd**2
        tilt_sd = 1.0 / math.sqrt(weights.sum())
        weights *= tilt_sd**2
        left = lefts[:, :2].sum(axis=0)
        left /= max(math.hypot(left[0], left[1]), 1e-9)
        return StepFigures(
            vector=vector,
            J_vector=J,
            slopes=slopes,
            J_slopes=J_slopes,
            tilt=float(weights @ np.arcsin(np.clip(lefts[:, 2], -1.0, 1.0))),
            J_tilt=weights @ J_rolls,
            left=left,
            turned=forwards[:, :2] @ left,
            sd=np.array([*place_sd, *slope_sd, tilt_sd]),
        )

    def _estimate(self, t_ns: int) -> StepEstimate:
        """The estimate of the current step at time `t_ns`.

        The offsets are estimated with it. Both stay in `_posterior`, from which the next landing stores the offsets.
        """
        fall = self._contacts[self._newest]
        self._posterior = posterior = self._offsets.posterior(self._measure_step(), start=fall.step == 0)
        # vector from the previous sole, m, and slope under this and the previous foot, rad
        x, y, height, slope, slope_before = posterior.values[:5]
        covariance = posterior.covariance.copy()
        # on a slope the holders yield differently than on the level
        on_ramp = ramp_probability(slope, math.sqrt(covariance[3, 3]), self._parameters.ramp_rad)
        covariance[2, 2] += (self._compliance.sloping_sd_m * on_ramp) ** 2
        sd = np.sqrt(np.diag(covariance))  # of the same values
        beyond = height_beyond_slopes(height, math.hypot(x, y), slope, slope_before)  # m, that no slope explains
        mode, probability = most_likely(
            mode_probabilities(slope, sd[3], beyond, sd[2], self._parameters), self._parameters.probability_min
        )
        return StepEstimate(
            t_ns=t_ns,
            step=fall.step,
            foot=SIDES[self._newest],
            slope=float(slope),
            elevation=float(height),
            slope_sd=float(sd[3]),
            elevation_sd=float(sd[2]),
            normal=_normal(fall.R_world_sole(), slope),
            p_sole_in_world=self._p_before + posterior.values[:3],
            covariance=covariance[:3, :3],
            mode=mode,
            probability=float(probability),
        )


def _normal(R_world_sole: Array, slope: float) -> Array:
    """(3,) the sole's normal in world axes, rotated about the sole's y axis to the estimated slope (rad)."""
    x, y = R_world_sole[0, 0], R_world_sole[1, 0]  # horizontal part of the sole's forward axis
    scale = math.cos(slope) / math.hypot(x, y)
    forward = np.array([scale * x, scale * y, math.sin(slope)])  # unit vector that rises by the slope
    left = R_world_sole[:, 1]
    normal = np.cross(forward, left)
    return np.asarray(normal / np.linalg.norm(normal))
