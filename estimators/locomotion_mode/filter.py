"""Locomotion modes as an estimator: poses, insoles and depth in, coming steps out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from stridetwin.estimators.contact_terrain import StepEstimate
from stridetwin.estimators.locomotion_mode.body import Body
from stridetwin.estimators.locomotion_mode.changes import first_change, flight_at
from stridetwin.estimators.locomotion_mode.estimate import MODES, ModeEstimate, NextChange, StepPrediction
from stridetwin.estimators.locomotion_mode.felt import Felt, felt, going_on, suits
from stridetwin.estimators.locomotion_mode.footsteps import CLIMB, SIDE, StepFilter
from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters
from stridetwin.estimators.locomotion_mode.pieces import Piece, pieces, unseen, with_unseen
from stridetwin.estimators.locomotion_mode.published import Division, WalkingInformation, mode_between
from stridetwin.estimators.locomotion_mode.rollout import Chain, moments, roll_out
from stridetwin.estimators.locomotion_mode.touchdown import TouchDowns
from stridetwin.estimators.terrain_map import Profile, TerrainMap
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import CameraCalibration, Mount
from stridetwin.streams.samples import Array, Depth, Insole, Odometry, Sample

METHODS = ("stridetwin", "published")
_OTHER = {"l": "r", "r": "l", "": ""}
_SOON_S = 0.05
_MISSED = 1.4
"""Step times after which a foot that touches down again has left out a step of the other."""
_BOUNCE = 0.6
_STRIPS = 2.0
"""Treads down are seen as strips: their depth is known that much worse than the map tells."""
_STANDING_SD_M, _WALKING_SD_M = 0.08, 0.25
"""Of the first foot about the body, at the start and where all begins anew on the way."""
_USUAL_HEIGHT_M = 1.3
"""Of neck and waist, where the ground is not known."""
_TALLEST_M = 2.2


@dataclass(frozen=True, kw_only=True, eq=False)
class _Stance:
    """Where the foot on the ground stands: a density along a line in the world."""

    origin: Array
    forward: Array
    s: Array
    density: Array

    def along(self, origin: Array, forward: Array, s: Array) -> Array:
        """The density over the cells of another line."""
        old = (origin - self.origin + s[:, None] * forward) @ self.forward
        density = np.interp(old, self.s, self.density, left=0.0, right=0.0)
        total = density.sum()
        return density / total if total > 1e-9 else np.full(len(s), 1.0 / len(s))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Landing:
    """The last touch-down as camera and insoles know it: what the legs tell of it later is added to this.

    Attributes:
        stance: Where the foot stands.
        before: (S,) density of the foot behind over the same cells.
        ground: Pieces along the line.
        mode: Of the ground under both feet; "" where it is not the same.
        even: How likely no edge lay between them.
        length, ramps: Filters of step lengths before they learnt of this step.
    """

    stance: _Stance
    before: Array
    ground: Sequence[Piece]
    mode: str
    even: float
    length: StepFilter
    ramps: StepFilter


class LocomotionMode:
    """What the next steps are: mode, place and time of each, and where the ground changes.

    Causal, of bounded memory, deterministic, nothing learnt. Takes poses of the camera or of its IMU, depth and both
    insoles in time order; tells an estimate after the depth pictures in which the map looks for planes, and at each
    touch-down.
    Steps as an exoskeleton's legs felt them (`contact_terrain`) are welcome besides: they correct where on the map the
    feet stand and how long steps are, and are gone by where there is no map.

    Without insoles it tells nothing but where the body is on the way to the first step; a foot whose insole is dead is
    led along by the other's touch-downs. Where poses stay away it tells nothing; where they jump, or come again after
    long, it begins anew, as the map does. Ground that was not seen may be any: the probabilities say so.

    Args:
        ground: Map of the ground; it is fed here, with the same samples.
        camera: The depth camera; tells where it sits on head or chest.
        mount: Where the depth camera sits in the frame whose poses come, as the map was told; None: the poses are the
            camera's own.
        method: `stridetwin`, or `published`: Zhao et al. 2023, eqs. (16)-(18).
        parameters: One set serves everyone.

    Raises:
        StrideTwinError: There is no such method.
    """

    def __init__(
        self,
        ground: TerrainMap,
        camera: CameraCalibration,
        *,
        mount: Mount | None = None,
        method: str = "stridetwin",
        parameters: LocomotionModeParameters | None = None,
    ) -> None:
        if method not in METHODS:
            raise StrideTwinError(f"there is no method {method!r} of locomotion_mode; valid: {', '.join(METHODS)}")
        self.parameters = p = parameters or LocomotionModeParameters()
        self.ground, self.method = ground, method
        T_frame_camera = np.eye(4) if mount is None else np.asarray(mount.T_body_sensor, float)
        T_frame_body = T_frame_camera @ np.linalg.inv(camera.mount.T_body_sensor)
        followed = T_frame_body if method == "stridetwin" else T_frame_camera
        self._body = Body(followed[:3, 3], T_frame_camera[:3, :3], p.still_m)
        self._touch = TouchDowns(p)
        self._walking = WalkingInformation(p)
        self._s: Array = np.asarray(p.grid_m * (np.arange(round((p.behind_m + p.reach_m) / p.grid_m)) + 0.5), float)
        self._begin(_STANDING_SD_M)

    def _begin(self, stance_sd_m: float) -> None:
        p = self.parameters
        shares = p.step_sd, p.asymmetry_sd, p.step_drift, p.step_noise
        self._length, self._time = (StepFilter(m, *(share * m for share in shares)) for m in (p.step_m, p.step_s))
        self._ramps = StepFilter(p.ramp_step, p.ramp_step_sd, p.climb_sd, p.step_drift, p.step_noise)
        self._stance: _Stance | None = None
        self._stance_sd_m = stance_sd_m
        self._foot, self._down_ns, self._step = "", -1, 0
        self._silent = ""  # foot whose insole has told nothing of its last step
        self._guessed, self._heard_ns = False, -1  # whether no insole told of the last touch-down; when one last did
        self._alike = 0  # steps in a row on ground of one mode
        self._landing: _Landing | None = None
        self._felt: Felt | None = None
        self._told_of: list[StepEstimate] = []  # the last steps that the legs felt
        self._walking.clear()

    def update(self, sample: Sample | StepEstimate) -> ModeEstimate | None:
        """Takes one sample; returns what is now known of the coming steps, None where nothing new is."""
        if isinstance(sample, Odometry):
            self.ground.update(sample)
            if self._body.add(sample):
                self._begin(_WALKING_SD_M)
            return None
        if isinstance(sample, StepEstimate):
            new = self._feel(sample) and self._body.known(sample.t_ns)
            return self._told(sample.t_ns) if new else None
        if isinstance(sample, Insole):
            foot, known = self._touch.update(sample), self._body.known(sample.t_ns)
            heard = foot is not None
            if foot is None and self._overdue(sample.t_ns):
                foot = self._silent
            if foot is None:
                return None
            self._land(foot, sample.t_ns, known, heard)
            return self._told(sample.t_ns) if known else None
        if isinstance(sample, Depth) and self.ground.update(sample) is not None and self._body.known(sample.t_ns):
            return self._told(sample.t_ns)
        return None

    def _overdue(self, t_ns: int) -> bool:
        """Whether the foot of which nothing is heard must be down by now: the other one is about to be lifted."""
        waited = (t_ns - self._down_ns) * 1e-9
        return bool(self._silent) and self._foot == _OTHER[self._silent] and waited > self._time.mean

    def _told(self, t_ns: int) -> ModeEstimate:
        return self._published(t_ns) if self.method == "published" else self._predicted(t_ns)

    # ---- ours -------------------------------------------------------------------------------------------------------

    def _land(self, foot: str, t_ns: int, known: bool, heard: bool) -> None:
        """A foot touches down: where it stands, and what the step says of the next ones; or only when.

        Args:
            foot: `l` or `r`.
            t_ns: When.
            known: Whether it is known where the body is.
            heard: Whether its insole tells so.
        """
        p, elapsed = self.parameters, (t_ns - self._down_ns) * 1e-9
        missed = 0
        if heard and foot == self._silent:
            self._silent = ""
        if foot == self._foot:
            if elapsed < _BOUNCE * self._time.mean:
                return
            missed = int(elapsed > _MISSED * self._time.mean)
        first, paired = self._down_ns < 0, heard and not self._guessed
        if missed:
            self._silent = _OTHER[foot]
        if known:
            self._walking.add(Division(foot=foot, t_ns=t_ns, p=self._body.p.copy(), v=self._body.velocity()))
        if not known:
            self._stance, self._stance_sd_m = None, _WALKING_SD_M
        elif self.method == "stridetwin":
            line = self._line()
            ground, stance = self._pieces(*line), self._standing(*line)
            before, _ = moments(stance, self._s)
            feet = [_OTHER[foot], foot][1 - missed :]
            lengths = [self._length.of(SIDE[f]) for f in feet]
            ahead = self._s - p.behind_m  # of the body
            even = ahead + self._leaning(ground) - 0.5 * (self._s - before - sum(lengths[:-1]))
            suits = (
                np.asarray(np.exp(-0.5 * (even / p.body_sd_m) ** 2) / p.body_sd_m, float),
                np.asarray(
                    np.exp(-0.5 * ((ahead - p.edge_ahead_m) / p.edge_ahead_sd_m) ** 2) / p.edge_ahead_sd_m, float
                ),
            )
            chain = self._rolled(stance, ground, lengths, suits)
            self._stance = _Stance(origin=line[0], forward=line[1], s=self._s, density=chain.density[-1])
            self._landing = None
            if not missed and not first and paired:
                self._learn(foot, stance, chain, ground)
        if heard:
            since, steps = (self._heard_ns, 2) if self._guessed else (self._down_ns, 1 + missed)
            seconds = (t_ns - since) * 1e-9
            if not first and seconds < 3.0 * p.step_s:
                self._time.update(SIDE["" if self._guessed else foot], seconds / steps)
            self._heard_ns = t_ns
        self._guessed = not heard
        self._foot, self._down_ns, self._step = foot, t_ns, self._step + 1 + missed

    def _learn(self, foot: str, stance: Array, chain: Chain, ground: Sequence[Piece]) -> None:
        """What a step that was made says of the next ones: on the level of all, on a ramp of those on ramps."""
        before, before_sd = moments(stance, self._s)
        made, made_sd = moments(chain.density[0], self._s)
        sd, even = math.hypot(made_sd, before_sd), 1.0 - min(1.0, 2.0 * float(chain.modes[0, 1] + chain.modes[0, 2]))
        here, there = (ground[_under(ground, s, self.parameters)] for s in (before, made))
        mode = here.mode if here.mode == there.mode else ""
        assert self._stance is not None
        self._landing = _Landing(
            stance=self._stance, before=stance, ground=ground, mode=mode, even=even,
            length=copy(self._length), ramps=copy(self._ramps),
        )  # fmt: skip
        self._alike = self._alike + 1 if mode and even > 0.5 else 0
        if self._alike > 1:  # then the body goes as far as the feet, and is known better than they are
            last, now = self._walking.latest
            made, sd = before + float(np.linalg.norm((now.p - last.p)[:2])), 0.5 * self.parameters.body_sd_m
        self._lengthen(foot, mode, made - before, sd, even)

    def _lengthen(self, foot: str, mode: str, length: float, sd: float, even: float) -> None:
        """A step of a length, in m, on ground of a mode; none where that was not the same under both feet."""
        if mode == "LG":
            self._length.update(SIDE[foot], length, sd, even)
        elif mode:
            level = self._length.of(SIDE[foot])
            self._ramps.update(CLIMB[mode], length / level, sd / level, even)

    def _feel(self, told: StepEstimate) -> bool:
        """The legs tell of the step that ended with the last touch-down; returns whether for the first time."""
        if not self._told_of or self._told_of[-1].step != told.step:
            self._told_of = [*self._told_of[-2:], told]
        self._told_of[-1] = told
        step, landing = felt(self._told_of), self._landing
        if step is None or step.foot != self._foot or told.t_ns < self._down_ns:
            return False
        first, self._felt = self._felt is None or self._felt.step != step.step, step
        if landing is None or self.method != "stridetwin":
            return first
        stance = landing.stance
        density = stance.density * suits(step, self._s, landing.ground, landing.before, self.parameters)
        self._stance = replace(stance, density=density / density.sum())
        self._length, self._ramps = copy(landing.length), copy(landing.ramps)
        self._lengthen(step.foot, landing.mode, step.length, step.length_sd, landing.even)
        return first

    def _leaning(self, ground: Sequence[Piece]) -> Array:
        """(S,) m the body is ahead of the middle between the feet at touch-down, by where the foot lands."""
        p, lean = self.parameters, np.full(len(self._s), self.parameters.lean_rad)
        for piece in ground:
            if piece.mode == "RA":
                lean[(self._s >= piece.start) & (self._s < piece.end)] += p.climb_lean * piece.slope
        return np.asarray(self._body_height() * lean)

    def _body_height(self) -> float:
        """Of the body over the ground under it, m."""
        height = float(self._body.p[2]) - self._height(self._body.p[:2])
        return height if 0.0 < height < _TALLEST_M else _USUAL_HEIGHT_M

    def _line(self) -> tuple[Array, Array]:
        """Where the way begins, behind the body, and its direction."""
        heading = self._body.heading(2.0 * self._time.mean)
        forward = np.array([math.cos(heading), math.sin(heading)])
        return self._body.p[:2] - self.parameters.behind_m * forward, forward

    def _pieces(self, origin: Array, forward: Array) -> list[Piece]:
        return self._cut(self._profile(origin, forward), origin, forward)

    def _profile(self, origin: Array, forward: Array) -> Profile:
        p = self.parameters
        return self.ground.profile(origin, math.atan2(forward[1], forward[0]), p.behind_m + p.reach_m)

    def _cut(self, profile: Profile, origin: Array, forward: Array) -> list[Piece]:
        """The pieces of a profile; where nobody has seen the ground ahead, as the legs felt it last."""
        if self._felt is not None:
            foot, _ = moments(self._standing(origin, forward), self._s)
            seen = profile.s[profile.plane >= 0]
            if not len(seen) or seen[-1] < foot + self.parameters.toe_m:
                return going_on(self._felt, foot, self.parameters)
        return pieces(profile, self.ground.estimate, forward, self.parameters)

    def _standing(self, origin: Array, forward: Array) -> Array:
        if self._stance is None:
            density = np.exp(-0.5 * ((self._s - self.parameters.behind_m) / self._stance_sd_m) ** 2)
            return density / density.sum()
        return self._stance.along(origin, forward, self._s)

    def _rolled(
        self, stance: Array, ground: Sequence[Piece], lengths: list[float], landing: tuple[Array, Array] | None
    ) -> Chain:
        p, mean = self.parameters, self._length.mean
        shared = math.hypot(self._length.sd, p.adapt_sd * mean)
        ratios = {mode: (self._ramps.of(kind), self._ramps.sd_of(kind)) for mode, kind in CLIMB.items()}
        return roll_out(stance, self._s, ground, lengths, shared, ratios, p, landing)

    def _predicted(self, t_ns: int) -> ModeEstimate:
        p = self.parameters
        origin, forward = line = self._line()
        profile = self._profile(*line)
        ground = self._cut(profile, *line)
        stance = self._standing(*line)
        feet = [_OTHER[self._foot] if k % 2 == 0 else self._foot for k in range(p.steps)]
        lengths = [self._length.of(SIDE[f]) for f in feet]
        chain = self._rolled(stance, ground, lengths, None)
        modes = with_unseen(chain.modes, chain.density @ unseen(profile, self._s, moments(stance, self._s)[0], p))
        times = self._times(feet, t_ns)
        left = np.array([-forward[1], forward[0]])
        steps = []
        for k, foot in enumerate(feet):
            s, sd = moments(chain.density[k], self._s)
            xy = origin + s * forward + 0.5 * p.width_m * SIDE[foot] * left
            turn = np.column_stack([forward, left])
            steps.append(
                StepPrediction(
                    step=self._step + k + 1, foot=foot, mode=MODES[int(modes[k].argmax())],
                    probabilities=dict(zip(MODES, modes[k].tolist())), t_ns=times[k][0], t_sd_s=times[k][1],
                    p_foot_in_world=np.array([*xy, self._height(xy)]),
                    covariance=turn @ np.diag([sd**2, p.width_sd_m**2]) @ turn.T,
                )
            )  # fmt: skip
        return ModeEstimate(
            t_ns=t_ns, step=self._step, steps=tuple(steps),
            change=self._change(t_ns, origin, forward, ground, stance, chain, times),
            heading=math.atan2(forward[1], forward[0]), p_body_in_world=self._body.p.copy(),
            step_length=self._length.mean, step_length_sd=self._length.sd, step_time=self._time.mean,
        )  # fmt: skip

    def _times(self, feet: list[str], t_ns: int) -> list[tuple[int, float]]:
        """When each coming step lands, ns, and its deviation, s."""
        p, found = self.parameters, []
        at = float(self._down_ns if self._down_ns >= 0 else t_ns)
        variance = 0.0
        for foot in feet:
            at = max(at + 1e9 * self._time.of(SIDE[foot]), t_ns + 1e9 * _SOON_S)
            variance += (p.step_noise * self._time.mean) ** 2
            found.append((int(at), math.sqrt(variance + self._time.sd**2)))
        return found

    def _height(self, xy: Array) -> float:
        found = self.ground.ground(xy)
        return math.nan if found is None else float(found[0].height(xy))

    def _change(
        self, t_ns: int, origin: Array, forward: Array, ground: Sequence[Piece], stance: Array, chain: Chain,
        times: list[tuple[int, float]],
    ) -> NextChange | None:  # fmt: skip
        p, estimate = self.parameters, self.ground.estimate
        if estimate is None:
            return None
        s, _ = moments(stance, self._s)
        here = _under(ground, s, p)
        found = first_change(ground, here, self._mode_here(ground, here), p)
        if found is None:
            return None
        place = origin + found.at * forward
        beyond = chain.on[:, found.piece :].sum(axis=1)
        k = int((beyond > 0.5).argmax()) if (beyond > 0.5).any() else len(times)
        if k < len(times):
            at_ns, at_sd = times[k]
        else:
            more = math.ceil(max(0.0, found.at - moments(chain.density[-1], self._s)[0]) / self._length.mean)
            at_ns, at_sd = times[-1][0] + int(1e9 * more * self._time.mean), times[-1][1] * (1.0 + more / len(times))
        geometry = dict.fromkeys(("riser", "riser_sd", "tread", "tread_sd", "slope", "slope_sd"), math.nan)
        piece = ground[found.piece]
        if found.mode in ("SA", "SD"):
            geometry |= {"riser": piece.drop, "riser_sd": math.hypot(p.riser_sd_m, piece.drop_sd)}
            known = flight_at(estimate, place, forward, found.mode == "SA")
            if known is not None:
                sd = np.sqrt(np.diag(known.covariance))
                sign = 1.0 if found.mode == "SA" else -1.0
                geometry |= {"riser": sign * known.riser, "riser_sd": math.hypot(float(sd[0]), p.size_sd_m)}
                if known.steps > 1:
                    share = 1.0 if found.mode == "SA" else _STRIPS
                    geometry |= {"tread": known.tread, "tread_sd": share * math.hypot(float(sd[1]), p.size_sd_m)}
        elif found.mode in ("RA", "RD"):
            geometry |= {"slope": piece.slope, "slope_sd": piece.slope_sd}
        return NextChange(
            mode=found.mode, p_in_world=place, distance=found.at - p.behind_m, distance_sd=max(found.sd, p.place_sd_m),
            time_s=(at_ns - t_ns) * 1e-9, time_sd_s=at_sd, **geometry,
        )  # fmt: skip

    def _mode_here(self, ground: Sequence[Piece], here: int) -> str:
        """What steps on the ground under the foot are: of a tread those of its stairs."""
        p, piece = self.parameters, ground[here]
        if piece.mode != "LG":
            return piece.mode
        if here > 0 and here + 1 < len(ground):
            drops = piece.drop, ground[here + 1].drop
            if min(map(abs, drops)) > p.kerb_m and drops[0] * drops[1] > 0 and piece.length < p.tread_max_m:
                return "SA" if drops[0] > 0 else "SD"
        return "LG"

    # ---- Zhao et al. 2023 -------------------------------------------------------------------------------------------

    def _published(self, t_ns: int) -> ModeEstimate:
        p, walking = self.parameters, self._walking
        size, step_s = walking.next_size(), walking.step_time()
        step_s = self._time.mean if math.isnan(step_s) else step_s
        before = walking.stance()
        steps = []
        for k in range(p.steps):
            foot = _OTHER[self._foot] if k % 2 == 0 else self._foot
            told = walking.footprint(k + 1)
            at_ns = max(self._down_ns + int(1e9 * (k + 1) * step_s), t_ns + int(1e9 * _SOON_S * (k + 1)))
            place, height, mode = self._body.p[:2], math.nan, "LG"
            if told is not None:
                place, forward = told
                here = place - forward * size if before is None else before
                mode, height = mode_between(self.ground, here, place, forward, p)
                before = place
            steps.append(
                StepPrediction(
                    step=self._step + k + 1, foot=foot, mode=mode,
                    probabilities={m: float(m == mode) for m in MODES}, t_ns=at_ns, t_sd_s=math.nan,
                    p_foot_in_world=np.array([*place, height]), covariance=np.full((2, 2), math.nan),
                )
            )  # fmt: skip
        v = self._body.velocity()
        return ModeEstimate(
            t_ns=t_ns, step=self._step, steps=tuple(steps), change=None, heading=math.atan2(v[1], v[0]),
            p_body_in_world=self._body.p.copy(), step_length=size, step_length_sd=math.nan, step_time=step_s,
        )  # fmt: skip


def _under(ground: Sequence[Piece], s: float, p: LocomotionModeParameters) -> int:
    """Number of the piece under the middle of a sole."""
    middle = s + 0.5 * (p.toe_m - p.heel_m)
    return next(k for k, piece in enumerate(ground) if middle < piece.end)
