"""A terrain map and a mode predictor of another package, for a walker on level ground with a steady stride."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from stridetwin.estimators.base import MODES, POSE_STREAM, TERRAIN, Declaration, Options, Stream
from stridetwin.estimators.locomotion_mode import MODES as WORDS
from stridetwin.estimators.locomotion_mode import ModeEstimate, StepPrediction
from stridetwin.estimators.terrain_map import Level, Plane, Profile, TerrainEstimate, TerrainMapParameters
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Depth, Insole, Odometry, Sample

EYES_M, REACH_M = 1.6, 3.0
STEP_M, STEP_S, LOADED_N = 0.6, 0.55, 50.0


def depth_stream(rig: Rig) -> Stream:
    """The first camera with depth."""
    topics = [c.depth_topic for c in rig.cameras.values() if c.depth_topic]
    if not topics:
        raise StrideTwinError("the rig has no depth camera")
    return Stream(role="depth", topic=topics[0], kind=Depth)


def finite_position(sample: Odometry) -> np.ndarray | None:
    """(3,) m, the pose's position; None if it is not finite."""
    p = sample.p_frame_in_world
    return p.copy() if np.isfinite(p).all() else None


class FlatGround:
    """Level ground, at a fixed height below the camera."""

    declaration: ClassVar[Declaration] = Declaration(
        name="flat_ground", kind=TERRAIN, description="level ground below the camera", needs="a depth camera"
    )

    def __init__(
        self, rig: Rig, *, options: Options | None = None, parameters: TerrainMapParameters | None = None
    ) -> None:
        depth_stream(rig)
        self.parameters = parameters or TerrainMapParameters()
        self.estimate: TerrainEstimate | None = None
        self._p: np.ndarray | None = None

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """Poses and depth."""
        return (POSE_STREAM, depth_stream(rig))

    def update(self, sample: Sample) -> TerrainEstimate | None:
        """The ground after a depth image."""
        if isinstance(sample, Odometry) and (p := finite_position(sample)) is not None:
            self._p = p
        if not isinstance(sample, Depth) or self._p is None:
            return None
        plane = Plane(
            id=0,
            centre=self._p - [0.0, 0.0, EYES_M],
            normal=np.array([0.0, 0.0, 1.0]),
            area_m2=4 * REACH_M**2,
            spread=REACH_M**2 / 3 * np.eye(2),
            votes=1.0,
            covariance=1e-4 * np.eye(3),
        )
        self.estimate = TerrainEstimate(
            t_ns=sample.t_ns, planes={0: plane}, terrains=(Level(id=0, plane=0),), p_camera_in_world=self._p
        )
        return self.estimate

    def heights(self, xy: np.ndarray) -> np.ndarray:
        """(N,) m."""
        return np.full(len(xy), self.estimate.planes[0].centre[2] if self.estimate else np.nan)

    def profile(self, origin: np.ndarray, heading: float, length_m: float = 4.0) -> Profile:
        """The ground along a line."""
        s = np.arange(0.0, length_m, 0.02)
        return Profile(s=s, height=self.heights(s), plane=np.zeros(len(s), np.int64), changes=())

    def ground(self, xy: np.ndarray) -> tuple[Plane, Level] | None:
        """Plane and terrain at a place."""
        return (self.estimate.planes[0], Level(id=0, plane=0)) if self.estimate else None

    def surface_points(self) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) m, and the plane of each."""
        if self.estimate is None:
            return np.zeros((0, 3)), np.zeros(0, np.int64)
        x, y = np.meshgrid(*[np.arange(-REACH_M, REACH_M, 0.05)] * 2)
        points = self.estimate.planes[0].centre + np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
        return points, np.zeros(len(points), np.int64)


class SteadySteps:
    """Every step is on level ground, and one stride length ahead."""

    declaration: ClassVar[Declaration] = Declaration(
        name="steady_steps", kind=MODES, description="level steps of one length", needs="a depth camera and insoles"
    )

    def __init__(self, rig: Rig, *, options: Options | None = None, parameters: None = None) -> None:
        depth_stream(rig)
        self._p: np.ndarray | None = None
        self._heading, self._step, self._foot = 0.0, 0, ""
        self._loaded: dict[str, bool] = {}

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """Poses, depth and insoles."""
        insoles = (Stream(role="insole", topic=f"/foot_{foot}/insole", kind=Insole) for foot in "lr")
        return (POSE_STREAM, depth_stream(rig), *insoles)

    def update(self, sample: Sample) -> ModeEstimate | None:
        """The next step, with each depth image."""
        if isinstance(sample, Odometry) and (p := finite_position(sample)) is not None:
            moved = np.zeros(3) if self._p is None else p - self._p
            self._p = p
            self._heading = float(np.arctan2(moved[1], moved[0])) if np.linalg.norm(moved[:2]) > 1e-3 else self._heading
        if isinstance(sample, Insole):
            loaded = bool(sample.force.sum() > LOADED_N)
            if loaded and not self._loaded.get(sample.topic, True):
                self._step, self._foot = self._step + 1, "r" if "foot_l" in sample.topic else "l"
            self._loaded[sample.topic] = loaded
        if not isinstance(sample, Depth) or self._p is None:
            return None
        ahead = STEP_M * np.array([np.cos(self._heading), np.sin(self._heading), 0.0])
        step = StepPrediction(
            step=self._step + 1,
            foot=self._foot,
            mode="LG",
            probabilities={mode: float(mode == "LG") for mode in WORDS},
            t_ns=sample.t_ns + int(STEP_S * 1e9),
            t_sd_s=0.2,
            p_foot_in_world=self._p + ahead - [0.0, 0.0, EYES_M],
            covariance=0.01 * np.eye(2),
        )
        return ModeEstimate(
            t_ns=sample.t_ns,
            step=self._step,
            steps=(step,),
            change=None,
            heading=self._heading,
            p_body_in_world=self._p,
            step_length=STEP_M,
            step_length_sd=0.1,
            step_time=STEP_S,
        )
