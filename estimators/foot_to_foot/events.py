"""Samples of both feet and their aids, in the order in which the compiled kernel takes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stridetwin.estimators.checkerboard.pose import BoardObservation, find_board_poses, select_poses
from stridetwin.estimators.foot_to_foot.state import FEET, IMU, OBSERVATION, RANGE, RELATIVE, Events
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array, Block, Imu, Range


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RelativePosition:
    """Relative position of the other foot, as the published system takes it from an image.

    Attributes:
        topic: Stream of the image.
        t_ns: Middle of the exposure, on the clock of the IMUs.
        p_other_in_imu: (3,) position of the other foot's IMU in this foot's, m.
        sd: Standard deviation on each axis, m.
    """

    topic: str
    t_ns: int
    p_other_in_imu: Array
    sd: float

    def __post_init__(self) -> None:
        """Raises ConfigError where the position is not three finite numbers, or `sd` is not one above 0."""
        if np.shape(self.p_other_in_imu) != (3,) or not np.all(np.isfinite(self.p_other_in_imu)):
            raise ConfigError("RelativePosition", "p_other_in_imu", self.p_other_in_imu, "three finite numbers")
        if not 0.0 < self.sd < np.inf:
            raise ConfigError("RelativePosition", "sd", self.sd, "a finite number > 0")

    @classmethod
    def of_observation(
        cls,
        observation: BoardObservation,
        *,
        T_imu_camera: ArrayLike,
        T_other_board: ArrayLike,
        R_camera_board: ArrayLike | None = None,
        rotation_sd: float = np.inf,
    ) -> RelativePosition | None:
        """From the pose of the other foot's board in the camera (Jao, Wang, Shkel 2020, Sec. II-D).

        p_a^b = p_a^C + C(q_a^C) [p_C^f - C(q_C^f) C(q_b^f)ᵀ p_b^f]

        Of a plane's two poses, the more likely one is used.

        Args:
            observation: Observation by foot a of the board f on foot b.
            T_imu_camera: (4, 4) pose of the camera C in a's IMU.
            T_other_board: (4, 4) pose of the board in b's IMU.
            R_camera_board: (3, 3) prior of the board's orientation in the camera.
            rotation_sd: Standard deviation of the prior about each axis, rad.

        Returns:
            None if the corners are collinear.
        """
        poses = select_poses(find_board_poses(observation), R_camera_board, rotation_sd)
        if not poses:
            return None
        T_camera_other = poses[0].T_camera_board @ np.linalg.inv(np.asarray(T_other_board, dtype=float))
        x, y, z = T_camera_other[:3, 3] - poses[0].T_camera_board[:3, 3]  # from the board to the other IMU, camera axes
        # (3, 6) derivative of the other IMU's position by the board's position and rotation
        J = np.hstack([np.eye(3), [[0, z, -y], [-z, 0, x], [y, -x, 0]]])
        sd = float(np.sqrt(np.trace(J @ poses[0].covariance @ J.T) / 3))  # mean of the three axes
        p = (np.asarray(T_imu_camera) @ T_camera_other)[:3, 3]
        return cls(topic=observation.topic, t_ns=observation.t_ns, p_other_in_imu=p, sd=sd)


Aid = tuple[int, BoardObservation | RelativePosition | Range]  # with the foot that carries the camera or the sonar


def merge_events(
    imus: Mapping[str, Block[Imu]], aids: Sequence[Aid], newest_ns: Sequence[int]
) -> tuple[Events, list[Aid]]:
    """All samples in time order, each aid right after the IMU sample by which both feet have reached its time.

    An echo waits until both feet are past its time: whichever of an echo and the IMUs' samples of that time comes
    first, it counts from one and the same sample on.

    Args:
        imus: Samples of each foot, by `l` and `r`.
        aids: Observations, relative positions and echoes, each with its foot.
        newest_ns: Time that each foot had reached before.

    Returns:
        The events; the aids whose time is still to come.
    """
    feet = [f for f in range(2) if FEET[f] in imus]  # indices of the feet with samples
    blocks = [imus[FEET[f]] for f in feet]
    # IMU samples: time and foot, one foot after the other; `place` is each one's position in time order
    t_ns = _concatenate([b.t_ns for b in blocks], np.int64, (0,))
    foot = np.repeat(np.array(feet, np.int8), [len(b) for b in blocks])
    sequence = np.lexsort((foot, t_ns))
    place = np.empty(len(t_ns), np.int64)
    place[sequence] = np.arange(len(t_ns))

    aid_t = np.array([a.t_ns for _, a in aids], np.int64)
    # ns that both feet must have reached: for an echo 1 ns more, so that a sample of the same time does not suffice
    due = aid_t + np.array([isinstance(a, Range) for _, a in aids], np.int64)
    # place of the IMU sample that each aid follows: -1 at once, the number of samples if its time is still to come
    ready = np.full(len(aids), -1)
    for f in range(2):
        foot_places = place[foot == f]
        at = np.searchsorted(t_ns[foot == f], due)  # the foot's first sample that is not earlier
        reached = np.append(foot_places, len(t_ns))[at]
        ready = np.maximum(ready, np.where(due <= newest_ns[f], -1, reached))
    is_pending = ready == len(t_ns)
    used = [a for a, pending in zip(aids, is_pending) if not pending]
    aid_t, ready = aid_t[~is_pending], ready[~is_pending]

    # all events, IMU samples first: kind, row in the arrays of the kind, and `final`, their order
    kind = np.array([IMU] * len(t_ns) + [_KIND[type(a)] for _, a in used], np.int8)
    row = np.empty(len(kind), np.int64)
    for k in range(len(_KIND) + 1):  # each kind of aid, and the IMU samples
        row[kind == k] = np.arange(np.count_nonzero(kind == k))
    event_t_ns = np.concatenate([t_ns, aid_t])
    # by place among the IMU samples; there the sample itself comes before its aids, and these are in order of time
    final = np.lexsort((event_t_ns, kind != IMU, np.concatenate([place, ready])))
    rate = _concatenate([b.columns["angular_rate"] for b in blocks], float, (0, 3))
    force = _concatenate([b.columns["specific_force"] for b in blocks], float, (0, 3))
    observations = [a for _, a in used if isinstance(a, BoardObservation)]
    points, rays, ray_sd, numbers = _pad_observations(observations)
    relative = [a for _, a in used if isinstance(a, RelativePosition)]
    events = Events(
        kind=kind[final],
        t_ns=event_t_ns[final],
        foot=np.concatenate([foot, np.array([f for f, _ in used], np.int8)])[final],
        row=row[final],
        rate=rate,
        force=force,
        points=points,
        rays=rays,
        ray_sd=ray_sd,
        numbers=numbers,
        relative=np.array([a.p_other_in_imu for a in relative], float).reshape(-1, 3),
        relative_sd=np.array([a.sd for a in relative], float),
        distance=np.array([a.distance for _, a in used if isinstance(a, Range)], float),
    )
    return events, [a for a, pending in zip(aids, is_pending) if pending]


_KIND = {BoardObservation: OBSERVATION, RelativePosition: RELATIVE, Range: RANGE}


def _concatenate(arrays: Sequence[NDArray[Any]], dtype: type, empty: tuple[int, ...]) -> NDArray[Any]:
    """Arrays of one kind after each other, contiguous; without any, an array of the shape `empty`."""
    return np.concatenate([np.zeros(empty, dtype), *arrays]).astype(dtype, copy=False)


def _pad_observations(seen: Sequence[BoardObservation]) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Arrays of S observations with up to M points each; the rows beyond an observation's points are padding.

    Returns:
        (S, M, 3) m, points in the board's frame; (S, M, 2) their normalised image coordinates; (S, M) standard
        deviation of each coordinate; (S,) number of points of each observation.
    """
    count = np.array([len(s.rays) for s in seen], np.int64)  # points of each observation
    m = max(count, default=0)
    points, rays, ray_sd = np.zeros((len(seen), m, 3)), np.zeros((len(seen), m, 2)), np.ones((len(seen), m))
    for i, s in enumerate(seen):
        points[i, : count[i]], rays[i, : count[i]], ray_sd[i, : count[i]] = s.points_in_board, s.rays, s.ray_sd
    return points, rays, ray_sd, count
