"""Takes the oldest frame out of the window and keeps what it told as the prior (6)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE
from stridetwin.estimators.dvio.factors import add_motion, add_prior, add_standing, errors
from stridetwin.estimators.dvio.landmarks import add_sightings
from stridetwin.estimators.dvio.memory import FRAME, NO_HOST, Window
from stridetwin.estimators.dvio.planes import add_planes, hold_planes
from stridetwin.estimators.dvio.solver import LEAST_INVERSE_DEPTH, Work
from stridetwin.estimators.dvio.terms import Terms
from stridetwin.estimators.dvio.views import ray, seen_at, view
from stridetwin.streams.samples import Array


@njit(error_model="numpy", **INSIDE)
def hold(window: Window, H: Array, last: int) -> None:
    """From now on the prior H speaks of frames up to `last`: their Jacobians stay where they are first taken."""
    f = window.frames
    for k in range(1, last + 1):
        o = window.shared + FRAME * k
        if not f.held[k] and H[o, o] > 0.0:
            f.held[k] = 1
            f.R_first[k], f.p_first[k], f.v_first[k], f.bias_first[k] = f.R[k], f.p[k], f.v[k], f.bias[k]
            f.moved[k] = 0.0


@njit(error_model="numpy", **INSIDE)
def without_oldest(H: Array, b: Array, shared: int, size: int) -> None:
    """Eliminates the oldest frame from H d = b, of which the lower triangle counts; its rows become free.

    See docs/dvio.md (11).

    Args:
        H: (N, N), symmetric on return.
        b: (N,).
        shared: How many states are of no frame.
        size: Of the states.
    """
    o, m = shared, shared + FRAME
    for i in range(size):
        for j in range(i):
            H[j, i] = H[i, j]
    own = H[o:m, o:m].copy()
    scale = np.empty(FRAME)
    for i in range(FRAME):
        scale[i] = 1.0 / np.sqrt(max(own[i, i], 1e-12))
    for i in range(FRAME):
        for j in range(FRAME):
            own[i, j] *= scale[i] * scale[j]
        own[i, i] += 1e-12
    inverse = np.linalg.inv(own)
    for i in range(FRAME):
        for j in range(FRAME):
            inverse[i, j] *= scale[i] * scale[j]
    share = np.zeros((size, FRAME))
    for i in range(size):
        if o <= i < m:
            continue
        for j in range(FRAME):
            s = 0.0
            for k in range(FRAME):
                s += H[i, o + k] * inverse[k, j]
            share[i, j] = s
    for i in range(size):
        if o <= i < m:
            continue
        for k in range(FRAME):
            b[i] -= share[i, k] * b[o + k]
        for j in range(i + 1):
            if o <= j < m:
                continue
            s = H[i, j]
            for k in range(FRAME):
                s -= share[i, k] * H[o + k, j]
            H[i, j] = s
            H[j, i] = s


@njit(error_model="numpy", **INSIDE)
def leave(window: Window, work: Work, alive: NDArray[np.uint8], newest: int) -> None:
    """Gives the landmarks of the oldest frame to the newest one, where that sees them, or lets them go.

    Args:
        window: Its landmarks are changed in place.
        work: Views of the frames.
        alive: (L,) 1 where the landmark is followed.
        newest: Slot of the newest frame, whose sightings of these landmarks have not been used for the prior.
    """
    marks, c = window.landmarks, window.calibration
    for l in range(len(marks.host)):
        if marks.host[l] == 0:
            if not (alive[l] and marks.seen[l, newest]):
                marks.host[l] = NO_HOST
                marks.seen[l] = 0
                continue
            x, y = ray(c, marks.at[l, 0])
            _, _, depth, before = seen_at(work.views, 0, newest, x, y, marks.inverse_depth[l])
            if marks.told[l, newest] > 0.0:
                marks.inverse_depth[l], marks.measured[l] = marks.told[l, newest] / c.scale[0], 1
            elif before:
                marks.inverse_depth[l] = max(depth, LEAST_INVERSE_DEPTH)
            marks.seen[l] = 0
            marks.seen[l, newest] = 1
            marks.host[l] = newest


@njit(error_model="numpy", **INSIDE)
def forget_oldest(window: Window, terms: Terms, work: Work, alive: NDArray[np.uint8]) -> None:
    """Marginalises the oldest frame with the landmarks that it hosts; `shift` then takes it out of the window.

    Each sighting is used once: those of these landmarks by the newest frame are left to it, which becomes their host.

    Args:
        window: Of three frames or more; changed in place.
        terms: What the factors believe.
        work: Room.
        alive: (L,) 1 where a landmark is followed.
    """
    n = window.frames.count[0]
    shared = window.shared
    size = shared + FRAME * n
    work.H[:size, :size] = 0.0
    work.b[:size] = 0.0
    view(window, terms, work.views)
    add_prior(window, size, work.H, work.b)
    add_standing(window, 0, work.H, work.b)
    add_motion(window, 0, terms, work.H, work.b)
    add_planes(window, terms, 0, work.H, work.b)
    host_depth = terms.host_depth and terms.host_depth_in_prior
    add_sightings(window, terms, work.views, work.sightings, 1, n - 2, host_depth, work.H, work.b)
    without_oldest(work.H, work.b, shared, size)
    hold(window, work.H, n - 2)
    hold_planes(window, work.H)
    d = errors(window, size)
    d[shared : shared + FRAME] = 0.0
    prior = window.prior
    prior.H[:] = 0.0
    prior.b[:] = 0.0
    for i in range(size - FRAME):
        a = i if i < shared else i + FRAME
        s = work.b[a]
        for j in range(size - FRAME):
            c = j if j < shared else j + FRAME
            prior.H[i, j] = work.H[a, c]
            s += work.H[a, c] * d[c]
        prior.b[i] = s
    leave(window, work, alive, n - 1)


def shift(window: Window) -> None:
    """Moves every slot one to the front, over the oldest frame."""
    frames, marks = window.frames, window.landmarks
    n = int(frames.count[0])
    for a in (*frames[1:], *window.increments):
        a[: n - 1] = a[1:n]
    planes = window.planes
    for a in (marks.seen, marks.at, marks.told, planes.seen, planes.told, planes.weight):
        a[:, : n - 1] = a[:, 1:n]
    marks.seen[:, n - 1] = 0
    planes.seen[:, n - 1] = 0
    marks.host[marks.host > 0] -= 1
    frames.held[n - 1] = 0
    frames.count[0] = n - 1
