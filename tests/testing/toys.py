"""A small sound estimator, and copies of it of which each breaks one rule."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from stridetwin.estimators.base import PATH, STEPS, Declaration, PathEstimate, Stream
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Depth, Imu
from stridetwin.streams.trajectory import Pose, trajectory_of

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """Pose, and a value that depends on all samples so far."""

    t_ns: int
    pose: Pose
    value: np.ndarray
    speed_sd: float = 0.1
    probability: float = 0.5
    probabilities: Mapping[str, float] = field(default_factory=lambda: {"stance": 0.5, "swing": 0.5})


class Sound:
    """Attitude of a foot that stays upright, and its mean specific force. It passes every check."""

    declaration: ClassVar[Declaration] = Declaration(name="toy", kind=PATH, needs="/foot_l/imu")

    def __init__(self, rig, *, options=None, parameters=None):
        rig.imu("/foot_l/imu")
        self.last_ns, self.force = -1, np.zeros(3)

    @classmethod
    def streams(cls, rig, options):
        return (Stream(role="imu", topic="/foot_l/imu", kind=Imu),)

    def update(self, sample):
        if sample.t_ns <= self.last_ns or not np.isfinite(sample.specific_force).all():
            return None
        self.last_ns = sample.t_ns
        self.force = 0.9 * self.force + 0.1 * sample.specific_force
        return self.estimate(sample)

    def estimate(self, sample):
        return Estimate(t_ns=sample.t_ns, pose=self.pose(sample), value=self.value(sample))

    def pose(self, sample):
        return Pose(
            t_ns=sample.t_ns, frame="foot_l/imu", p_frame_in_world=np.zeros(3), rotation=UPRIGHT, covariance=np.eye(6)
        )

    def value(self, sample):
        return self.force.copy()


class WithoutStreams(Sound):
    streams = None


class WrongTopic(Sound):
    @classmethod
    def streams(cls, rig, options):
        return (Stream(role="imu", topic="/foot_l/imux", kind=Imu),)


class WrongKind(Sound):
    declaration = Declaration(name="toy", kind="pathes")


class AcceptsAnyRig(Sound):
    def __init__(self, rig, *, options=None, parameters=None):
        self.last_ns, self.force = -1, np.zeros(3)


class KeyErrorWithoutSensor(Sound):
    def __init__(self, rig, *, options=None, parameters=None):
        super().__init__(rig) if rig.imus["/foot_l/imu"] else None


class VagueError(Sound):
    def __init__(self, rig, *, options=None, parameters=None):
        if "/foot_l/imu" not in rig.imus:
            raise StrideTwinError("bad calibration")
        super().__init__(rig)


class Raises(Sound):
    def update(self, sample):
        raise IndexError("no such state")


class Silent(Sound):
    def update(self, sample):
        return None


class WrongEstimate(Sound):
    declaration = Declaration(name="toy", kind=STEPS)


class Seconds(Sound):
    def estimate(self, sample):
        return replace(super().estimate(sample), t_ns=sample.t_ns * 1e-9)


class StampsRepeat(Sound):
    first_ns = None

    def pose(self, sample):
        self.first_ns = self.first_ns or sample.t_ns
        return replace(super().pose(sample), t_ns=self.first_ns)


class NanAtFirst(Sound):
    def value(self, sample):
        return np.full(3, np.nan) if sample.t_ns < 10**8 else super().value(sample)


def with_pose(name, **values):
    """The estimator with other values in its pose."""

    def pose(self, sample):
        return replace(Sound.pose(self, sample), **values)

    return type(name, (Sound,), {"pose": pose})


def with_fields(name, **values):
    """The estimator with other values in its estimate."""

    def estimate(self, sample):
        return replace(Sound.estimate(self, sample), **values)

    return type(name, (Sound,), {"estimate": estimate})


Asymmetric = with_pose("Asymmetric", covariance=np.eye(6) + 0.1 * np.eye(6, k=1))
Indefinite = with_pose("Indefinite", covariance=np.diag([1.0, 1, 1, 1, 1, -0.1]))
NanCovariance = with_pose("NanCovariance", covariance=np.full((6, 6), np.nan))
NegativeSd = with_fields("NegativeSd", speed_sd=-1.0)
HalfProbabilities = with_fields("HalfProbabilities", probabilities={"stance": 0.25, "swing": 0.25})
Percent = with_fields("Percent", probability=97.0)
UpsideDown = with_pose("UpsideDown", rotation=UPRIGHT[[1, 0, 2, 3]])
DoubleNorm = with_pose("DoubleNorm", rotation=2.0 * UPRIGHT)


class Millimetres(Sound):
    scale = 1e3

    def pose(self, sample):
        return replace(super().pose(sample), p_frame_in_world=self.scale * np.array([sample.t_ns * 0.5e-9, 0.0, 0.0]))


class Kilometres(Millimetres):
    scale = 1e-3


class ChangesSample(Sound):
    def update(self, sample):
        estimate = super().update(sample)
        np.multiply(sample.angular_rate, 57.3, out=sample.angular_rate)
        return estimate


class ReadsTheClock(Sound):
    def estimate(self, sample):
        return replace(super().estimate(sample), value=np.array([1e-9 * time.perf_counter_ns()]))


class SharesState(Sound):
    forces: ClassVar[list] = []

    def __init__(self, rig, *, options=None, parameters=None):
        super().__init__(rig)
        self.forces.clear()

    def estimate(self, sample):
        self.forces[:] = [*self.forces[-9:], sample.specific_force.copy()]
        return replace(super().estimate(sample), value=np.mean(self.forces, axis=0))


class ReturnsItsState(Sound):
    def __init__(self, rig, *, options=None, parameters=None):
        super().__init__(rig)
        self.sum = np.zeros(3)

    def value(self, sample):
        self.sum += sample.specific_force
        return self.sum


class KeepsSample(Sound):
    kept = None

    def value(self, sample):
        before, self.kept = self.kept or sample, sample
        return before.specific_force.copy()


class ReturnsSample(Sound):
    def value(self, sample):
        return sample.specific_force


class OtherEndInFollow(Sound):
    @classmethod
    def follow(cls, recording, options, progress=None):
        estimator = cls(recording.rig)
        poses = [estimator.update(sample).pose for sample in recording.samples(["/foot_l/imu"])]
        poses[-1] = replace(poses[-1], p_frame_in_world=np.full(3, 1e-9))
        return [PathEstimate(name="toy_l", frame="foot_l/imu", path=trajectory_of(poses))]


class RaisesAfter(Sound):
    """Fails where the time between two samples is within some limits, s."""

    limits = 0.0, 0.0
    newest_ns = None

    def update(self, sample):
        dt = (sample.t_ns - (sample.t_ns if self.newest_ns is None else self.newest_ns)) * 1e-9
        is_first, self.newest_ns = self.newest_ns is None, sample.t_ns
        if not is_first and self.limits[0] < dt < self.limits[1]:
            raise ZeroDivisionError("float division by zero")
        return super().update(sample)


class NoDropout(RaisesAfter):
    limits = 0.7, 0.98


class NoGap(RaisesAfter):
    limits = 1.8, 50.0


class NoRepeat(RaisesAfter):
    limits = -1e-9, 1e-9


class NoOutOfOrder(RaisesAfter):
    limits = -0.04, -1e-9


class NoClockForward(RaisesAfter):
    limits = 90.0, 110.0


class NoClockBack(RaisesAfter):
    limits = -1.1, -0.5


class KeepsNan(Sound):
    is_bad = staticmethod(np.isnan)

    def update(self, sample):
        estimate = super().update(sample)
        return self.estimate(sample) if self.is_bad(sample.specific_force).any() else estimate

    def value(self, sample):
        return sample.specific_force.copy()


class KeepsInfinity(KeepsNan):
    is_bad = staticmethod(np.isinf)


class SilentAfterNan(Sound):
    is_broken = False

    def update(self, sample):
        self.is_broken |= bool(np.isnan(sample.specific_force).any())
        return None if self.is_broken else super().update(sample)


class DividesByForce(Sound):
    def update(self, sample):
        if np.ptp(np.abs(sample.specific_force)) == 0.0:  # all three clipped alike
            raise ZeroDivisionError("float division by zero")
        return super().update(sample)


class DividesByChange(Sound):
    last = np.zeros(3)

    def update(self, sample):
        force, before, self.last = sample.specific_force, self.last, sample.specific_force.copy()
        is_clipped = np.ptp(np.abs(force)) == 0.0 if np.isfinite(force).all() else True
        if sample.t_ns > self.last_ns and np.array_equal(force, before) and not is_clipped:
            raise ZeroDivisionError("float division by zero")
        return super().update(sample)


class Camera(Sound):
    """The sound estimator on depth images."""

    def __init__(self, rig, *, options=None, parameters=None):
        rig.imu("/head/imu")
        self.last_ns, self.force = -1, np.zeros(3)

    @classmethod
    def streams(cls, rig, options):
        return (Stream(role="depth", topic="/head/depth", kind=Depth),)

    def update(self, sample):
        if sample.t_ns <= self.last_ns:
            return None
        self.last_ns = sample.t_ns
        return self.estimate(sample)

    def pose(self, sample):
        return replace(super().pose(sample), frame="")

    def value(self, sample):
        return np.array([float(np.nan_to_num(sample.depth, posinf=0.0, neginf=0.0).max())])


class NeedsTexture(Camera):
    def update(self, sample):
        if not sample.depth.any():
            raise ValueError("empty image")
        return super().update(sample)


class NeedsOrder(Sound):
    """Fails where a sample of one foot comes after a newer one of the other."""

    newest_ns, has_jumped = -1, False

    @classmethod
    def streams(cls, rig, options):
        return tuple(Stream(role=foot, topic=f"/{foot}/imu", kind=Imu) for foot in ("foot_l", "foot_r"))

    def update(self, sample):
        dt_s = (sample.t_ns - self.newest_ns) * 1e-9
        self.has_jumped |= abs(dt_s) > 0.5
        if -0.26 < dt_s < -0.2 and not self.has_jumped:
            raise ValueError("too late")
        self.newest_ns = max(self.newest_ns, sample.t_ns)
        return super().update(sample) if sample.topic == "/foot_l/imu" else None


class KeepsAll(Sound):
    def __init__(self, rig, *, options=None, parameters=None):
        super().__init__(rig)
        self.forces = []

    def value(self, sample):
        self.forces.append(sample.specific_force.copy())
        return super().value(sample)


BROKEN = {
    "declaration": (WithoutStreams, WrongTopic, WrongKind),
    "missing_sensors": (AcceptsAnyRig, KeyErrorWithoutSensor, VagueError),
    "estimates": (Raises, Silent, WrongEstimate),
    "stamps": (Seconds, StampsRepeat),
    "finite": (NanAtFirst,),
    "covariance": (Asymmetric, Indefinite, NanCovariance, NegativeSd, HalfProbabilities, Percent),
    "plausible": (Millimetres, Kilometres, UpsideDown, DoubleNorm),
    "leaves_sample": (ChangesSample,),
    "deterministic": (ReadsTheClock,),
    "independent": (SharesState,),
    "causal": (ReturnsItsState,),
    "keeps_no_reference": (KeepsSample, ReturnsSample),
    "follow": (OtherEndInFollow,),
    "fault_dropout": (NoDropout,),
    "fault_gap": (NoGap,),
    "fault_repeat": (NoRepeat,),
    "fault_out_of_order": (NoOutOfOrder,),
    "fault_late": (NeedsOrder,),
    "fault_nan": (KeepsNan, SilentAfterNan),
    "fault_inf": (KeepsInfinity,),
    "fault_saturation": (DividesByForce,),
    "fault_freeze": (DividesByChange,),
    "fault_clock_forward": (NoClockForward,),
    "fault_clock_back": (NoClockBack,),
    "fault_blank_images": (NeedsTexture,),
    "bounded_memory": (KeepsAll,),
}
"""Estimators by the one check that must catch them."""
