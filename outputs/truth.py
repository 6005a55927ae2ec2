"""True paths, footprints and stairs of a recording, as scores and figures need them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from stridetwin.streams.errors import RecordingError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Mount, Rig
from stridetwin.streams.samples import QUATERNION_NORM_ERROR, Array, Block, Footprint, Sample
from stridetwin.streams.terrain_truth import Layout, Strip
from stridetwin.streams.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True, eq=False)
class TruePath:
    """True motion of one frame.

    Attributes:
        t_ns: (N,) int64, strictly increasing, N ≥ 2.
        p_frame_in_world: (N, 3) m.
        v_frame_in_world: (N, 3) m/s.
        q_world_frame: (N, 4) unit quaternions (w, x, y, z).
    """

    t_ns: NDArray[np.int64]
    p_frame_in_world: Array
    v_frame_in_world: Array
    q_world_frame: Array

    @classmethod
    def of(cls, block: Block[Sample]) -> TruePath:
        """The path in a `/truth/.../odometry` topic.

        Raises:
            RecordingError: Fewer than two samples, a value that is not finite, or an attitude that is no rotation.
        """
        if len(block) < 2:
            raise RecordingError(f"{block.topic}: {len(block)} samples are no path; at least 2 are needed")
        # (N, 3) m, (N, 3) m/s and (N, 4): the arrays of `TruePath`
        p, v, q = (block.columns[name] for name in ("p_frame_in_world", "v_frame_in_world", "q_world_frame"))
        is_invalid = ~(np.isfinite(p).all(axis=1) & np.isfinite(v).all(axis=1) & np.isfinite(q).all(axis=1))
        if is_invalid.any():
            first_s = block.t_ns[is_invalid.argmax()] / 1e9  # argmax of booleans: the first that is True
            raise RecordingError(f"{block.topic}: not finite at {first_s:.3f} s; truth must be finite")
        norm = np.linalg.norm(q, axis=1)
        row = int(np.argmax(np.abs(norm - 1.0)))
        if abs(norm[row] - 1.0) > QUATERNION_NORM_ERROR:
            at = f"the quaternion at {block.t_ns[row] / 1e9:.3f} s has the norm {norm[row]:.3g}"
            raise RecordingError(f"{block.topic}: {at}: expected the attitude as a unit quaternion")
        return cls(t_ns=block.t_ns, p_frame_in_world=p, v_frame_in_world=v, q_world_frame=q)

    @property
    def poses(self) -> Trajectory:
        """The poses at the stamps of the path."""
        return Trajectory(t_ns=self.t_ns, p_frame_in_world=self.p_frame_in_world, q_world_frame=self.q_world_frame)

    def since(self, t_ns: int) -> TruePath:
        """The path from a time (ns) on; at least its last two samples stay."""
        first = min(int(np.searchsorted(self.t_ns, t_ns)), len(self.t_ns) - 2)
        return TruePath(
            t_ns=self.t_ns[first:],
            p_frame_in_world=self.p_frame_in_world[first:],
            v_frame_in_world=self.v_frame_in_world[first:],
            q_world_frame=self.q_world_frame[first:],
        )

    @property
    def distance_m(self) -> Array:
        """(N,) m travelled by the frame's origin up to each sample."""
        steps = np.linalg.norm(np.diff(self.p_frame_in_world, axis=0), axis=1)
        return np.concatenate(([0.0], np.cumsum(steps)))

    def at(self, t_ns: NDArray[np.int64]) -> Trajectory:
        """Poses at the stamps: cubic Hermite for positions (uses velocities), slerp for attitudes.

        Args:
            t_ns: (M,) int64 within the span of the path.

        Raises:
            ValueError: A stamp outside the span.
        """
        if len(t_ns) and (t_ns.min() < self.t_ns[0] or t_ns.max() > self.t_ns[-1]):
            raise ValueError("stamps outside the span of the truth")
        i = np.clip(np.searchsorted(self.t_ns, t_ns, side="right") - 1, 0, len(self.t_ns) - 2)
        # interval i, its length h in s, and the share s of it that has passed at each stamp
        h = (self.t_ns[i + 1] - self.t_ns[i]) * 1e-9
        s = ((t_ns - self.t_ns[i]) * 1e-9 / h)[:, None]
        h = h[:, None]
        # cubic Hermite polynomials weigh position and velocity at the begin (i) and at the end (i + 1) of the interval
        p = (
            (1 + 2 * s) * (1 - s) ** 2 * self.p_frame_in_world[i]
            + s * (1 - s) ** 2 * h * self.v_frame_in_world[i]
            + s**2 * (3 - 2 * s) * self.p_frame_in_world[i + 1]
            + s**2 * (s - 1) * h * self.v_frame_in_world[i + 1]
        )
        attitudes = Slerp((self.t_ns - self.t_ns[0]) * 1e-9, Rotation.from_quat(self.q_world_frame, scalar_first=True))
        q = attitudes((t_ns - self.t_ns[0]) * 1e-9).as_quat(scalar_first=True)
        return Trajectory(t_ns=t_ns, p_frame_in_world=p, q_world_frame=q)


def true_path(recording: Recording, frame: str) -> TruePath:
    """The true path of a frame: recorded, or derived from another sensor on the same body by their mounts.

    Args:
        recording: The recording.
        frame: Such as `foot_r/imu`; a leading slash, as topics have, is left out.

    Raises:
        RecordingError: The recording has no truth for the frame; the message lists the available frames.
    """
    frame, frames = frame.lstrip("/"), true_frames(recording.topics)
    if frame in frames:
        return TruePath.of(recording.block(f"/truth/{frame}/odometry"))
    # not recorded: take the first frame on the same body whose path is
    mounts = _mounts_by_frame(recording.rig) if recording.has_rig else {}
    for recorded_frame in mounts if frame in mounts else ():  # without a mount of the frame nothing can be derived
        if recorded_frame in frames and mounts[recorded_frame].body == mounts[frame].body:
            # pose of the frame in the recorded one, (4, 4), over the body that carries both
            T_recorded_frame = np.linalg.inv(mounts[recorded_frame].T_body_sensor) @ mounts[frame].T_body_sensor
            return _derive_path(recording.block(f"/truth/{recorded_frame}/odometry"), T_recorded_frame)
    raise RecordingError(f"{recording.path}: no truth of frame {frame!r}; it has {', '.join(frames) or 'none'}")


def _mounts_by_frame(rig: Rig) -> dict[str, Mount]:
    """Mounts of all IMUs and cameras, by their frames, such as `foot_r/imu`: topics without the leading slash."""
    mounts = {topic: imu.mount for topic, imu in rig.imus.items()}
    mounts |= {topic: camera.mount for topic, camera in rig.cameras.items()}
    return {topic.removeprefix("/"): mount for topic, mount in mounts.items()}


def _derive_path(recorded: Block[Sample], T_recorded_frame: Array) -> TruePath:
    """The path of a frame that is rigidly mounted in the recorded one.

    p = p_r + R_r a and v = v_r + R_r (ω × a). Here p_r, v_r and R_r are position, velocity and attitude of the recorded
    frame, ω is its angular rate, and a is the arm, the position of the derived frame in the recorded one.

    Args:
        recorded: True path of the recorded frame.
        T_recorded_frame: (4, 4) pose of the frame in the recorded one, m.
    """
    path, arm = TruePath.of(recorded), T_recorded_frame[:3, 3]
    attitude = Rotation.from_quat(path.q_world_frame, scalar_first=True)
    relative = np.cross(recorded.columns["angular_rate"], arm)  # ω × a: (N, 3) m/s in the axes of the recorded frame
    return TruePath(
        t_ns=path.t_ns,
        p_frame_in_world=path.p_frame_in_world + attitude.apply(arm),
        v_frame_in_world=path.v_frame_in_world + attitude.apply(relative),
        q_world_frame=(attitude * Rotation.from_matrix(T_recorded_frame[:3, :3])).as_quat(scalar_first=True),
    )


def true_frames(topics: Iterable[str]) -> list[str]:
    """Frames, such as `foot_r/imu`, whose true path `/truth/FRAME/odometry` is among the topics; sorted."""
    prefix, suffix = "/truth/", "/odometry"
    return sorted(t[len(prefix) : -len(suffix)] for t in topics if t.startswith(prefix) and t.endswith(suffix))


FOOTPRINTS = "/truth/footprints"
"""Topic of the true footprints."""
SCORED_AHEAD_S = 1.5
"""How long before a foot lands beyond a terrain change its estimate is scored."""
_REACH_M = 1.5  # longest step; joggers reach 1.4 m


def true_footprints(recording: Recording) -> list[Footprint]:
    """The true footprints, in order; the two initial ones come first."""
    return list(recording.block(FOOTPRINTS).as_kind(Footprint))


def walking_span_ns(footprints: Sequence[Footprint]) -> tuple[int, int]:
    """Times of the first and of the last footprint of a walk, ns, without those of the standing feet."""
    landed = footprints[2:] or footprints
    return landed[0].t_ns, landed[-1].t_ns


def project_on_way(p_feet_in_world: ArrayLike, layout: Layout) -> Array:
    """Places of all footprints of a walk along its route.

    Each footprint is searched only within the longest step of the previous one (`_REACH_M`), so that the right place
    comes out where a route passes a point twice.

    Args:
        p_feet_in_world: (F, 3) m, positions of the footprints in order of time.
        layout: The true terrain with the route.

    Returns:
        (F,) m along the route.
    """
    return layout.way.project(np.asarray(p_feet_in_world, float).reshape(-1, 3)[:, :2], _REACH_M)


def scoring_time_ns(s: float, t_ns: Array, places: Array) -> float:
    """When a terrain change is scored: `SCORED_AHEAD_S` before the first foot lands beyond it.

    Args:
        s: Arc length of the change along the route, m.
        t_ns: (F,) touch-downs of the footprints, ns, in order.
        places: (F,) m along the route, of the same footprints.

    Returns:
        ns; infinite if no foot lands beyond it.
    """
    beyond = np.flatnonzero(places > s)
    return float(t_ns[beyond[0]]) - SCORED_AHEAD_S * 1e9 if len(beyond) else math.inf


@dataclass(frozen=True, kw_only=True)
class Flight:
    """A flight of stairs: risers with treads between them.

    Attributes:
        s: Arc length of its first edge, m.
        end: Of its last one, m.
        riser: Mean height of its risers, m, down negative.
        tread: Mean depth of its treads, m; 0 for a single riser.
        risers: Number of risers.
    """

    s: float
    end: float
    riser: float
    tread: float
    risers: int


def edges(profile: Sequence[Strip], min_m: float = 1e-6) -> list[tuple[float, float, Strip]]:
    """Height steps of the ground, in order along the route.

    Args:
        profile: Strips of the route.
        min_m: Least size of a step, m.

    Returns:
        For each its place, m along the route; its height, m, down negative; and the strip that begins there.
    """
    jumps = [(after.s0, after.z0 - before.z1, after) for before, after in pairwise(profile)]
    return [jump for jump in jumps if abs(jump[1]) >= min_m]


def flights(profile: Sequence[Strip], min_m: float = 1e-6) -> list[Flight]:
    """The flights of a route, in order.

    A flight begins with the first edge after other terrain, and ends with the edge onto a strip that is no stair. A
    flight that the route does not leave again is left out.

    Args:
        profile: Strips of the route.
        min_m: Height steps below this are ignored, m.
    """
    route_flights: list[Flight] = []
    s, heights = [], []  # places and heights of the edges of the present flight
    for place, height, onto in edges(profile, min_m):
        s.append(place)
        heights.append(height)
        if onto.terrain == "stair":  # a tread follows: the flight goes on
            continue
        tread = (s[-1] - s[0]) / (len(s) - 1) if len(s) > 1 else 0.0
        route_flights.append(Flight(s=s[0], end=s[-1], riser=float(np.mean(heights)), tread=tread, risers=len(s)))
        s, heights = [], []
    return route_flights
