"""Samples of both feet and their aids, in the order in which the compiled kernel takes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.foot_ins.board_sighting import BoardSighting
from stridetwin.estimators.foot_to_foot.memory import FEET, IMU, RANGE, RELATIVE, SIGHTING, Events
from stridetwin.estimators.foot_to_foot.samples import RelativePosition
from stridetwin.streams.samples import Block, Imu, Range

Aid = tuple[int, BoardSighting | RelativePosition | Range]  # with the foot that carries the camera or the sonar


def in_order(imus: Mapping[str, Block[Imu]], aids: Sequence[Aid], newest_ns: Sequence[int]) -> tuple[Events, list[Aid]]:
    """All samples in time order, each aid right after the IMU sample by which both feet have reached its time.

    Args:
        imus: Samples of each foot, by `l` and `r`.
        aids: In any order.
        newest_ns: Time that each foot has reached before.

    Returns:
        Events, and the aids whose time is still to come.
    """
    feet = [f for f in range(2) if FEET[f] in imus]
    blocks = [imus[FEET[f]] for f in feet]
    t_ns = _joined([b.t_ns for b in blocks], np.int64, (0,))
    foot = np.repeat(np.array(feet, np.int8), [len(b) for b in blocks])
    sequence = np.lexsort((foot, t_ns))
    place = np.empty(len(t_ns), np.int64)
    place[sequence] = np.arange(len(t_ns))

    aid_t = np.array([a.t_ns for _, a in aids], np.int64)
    ready = np.full(len(aids), -1)
    for f in range(2):
        own = place[foot == f]
        at = np.searchsorted(t_ns[foot == f], aid_t)
        reached = np.append(own, len(t_ns))[at]
        ready = np.maximum(ready, np.where(aid_t <= newest_ns[f], -1, reached))
    coming = ready == len(t_ns)
    used = [a for a, later in zip(aids, coming) if not later]
    aid_t, ready = aid_t[~coming], ready[~coming]

    kind = np.array([IMU] * len(t_ns) + [_KIND[type(a)] for _, a in used], np.int8)
    row = np.empty(len(kind), np.int64)
    for k in range(len(_KIND) + 1):
        row[kind == k] = np.arange(np.count_nonzero(kind == k))
    final = np.lexsort((np.r_[t_ns, aid_t], kind != IMU, np.r_[place, ready]))
    rate = _joined([b.columns["angular_rate"] for b in blocks], float, (0, 3))
    force = _joined([b.columns["specific_force"] for b in blocks], float, (0, 3))
    seen = [a for _, a in used if isinstance(a, BoardSighting)]
    points, rays, ray_sd, numbers = _padded(seen)
    relative = [a for _, a in used if isinstance(a, RelativePosition)]
    events = Events(
        kind=kind[final],
        t_ns=np.r_[t_ns, aid_t][final],
        foot=np.r_[foot, np.array([f for f, _ in used], np.int8)][final],
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
    return events, [a for a, later in zip(aids, coming) if later]


_KIND = {BoardSighting: SIGHTING, RelativePosition: RELATIVE, Range: RANGE}


def _joined(arrays: Sequence[NDArray], dtype: type, empty: tuple[int, ...]) -> NDArray:
    """Arrays of one kind after each other, contiguous."""
    return np.concatenate([np.zeros(empty, dtype), *arrays]).astype(dtype, copy=False)


def _padded(seen: Sequence[BoardSighting]) -> tuple[NDArray, NDArray, NDArray, NDArray[np.int64]]:
    """Points (S, M, 3), rays (S, M, 2) and their sd (S, M), M the largest number of points, and (S,) numbers."""
    count = np.array([len(s.rays) for s in seen], np.int64)
    m = max(count, default=0)
    points, rays, ray_sd = np.zeros((len(seen), m, 3)), np.zeros((len(seen), m, 2)), np.ones((len(seen), m))
    for i, s in enumerate(seen):
        points[i, : count[i]], rays[i, : count[i]], ray_sd[i, : count[i]] = s.points_in_board, s.rays, s.ray_sd
    return points, rays, ray_sd, count
