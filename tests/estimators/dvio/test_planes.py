"""Planes as states: what a depth image shows of them, their residual, and what they are worth."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.estimators.dvio import Dvio, DvioParameters, kernel, planes
from stridetwin.estimators.dvio.optimiser import blank_work, minimise
from stridetwin.estimators.dvio.plane_cells import sample_pixels
from stridetwin.estimators.dvio.planes import PlaneWorkspace, blank_plane_workspace, free_slot, marginalize_plane
from stridetwin.estimators.dvio.state import CALIBRATION, FRAME, PLANE, PLANES, PlaneParameters, Window
from stridetwin.streams.samples import Image
from tests.estimators.dvio.scenes import FACTORS, SHARED, moved, see_corner, see_plane, seen_window
from tests.estimators.dvio.wall import Wall, rig, swaying
from tests.estimators.from_python import from_python

SEEDS = st.integers(0, 10_000)
STEP = 1e-6
SHAPE, FOCAL = (480, 640), 384.0
residual_in = from_python(planes.plane_residual)
SD = 0.007  # of an inverse depth, 1/m


def plane_residual(w: Window, factors, k: int, j: int, measured: np.ndarray, workspace: PlaneWorkspace) -> bool:
    return bool(residual_in(w.frames, w.calibration, w.planes, factors, k, j, measured, workspace))


def corner_window(rng: np.random.Generator, frames: int = 3, slots: int = 4) -> Window:
    """Frames that see a floor and two walls, and no point."""
    w = seen_window(rng, frames, 4, slots)
    w.landmarks.host[:], w.landmarks.seen[:] = -1, 0
    w.frames.offset[:] = 0.0
    see_corner(w)
    return w


def rays() -> np.ndarray:
    return np.asarray((sample_pixels(SHAPE, PlaneParameters()) - [319.5, 239.5]) / FOCAL)


def depth_image(planes: list[np.ndarray], rng: np.random.Generator | None = None) -> np.ndarray:
    """(H, W) m, of the nearest of some planes; with noise where a generator is given."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    m = np.stack([(u - 319.5) / FOCAL, (v - 239.5) / FOCAL, np.ones(SHAPE)], axis=-1)
    xi = np.max([m @ p for p in planes], axis=0)
    if rng is not None:
        xi = xi + SD * rng.normal(size=SHAPE)
    return np.where(xi > 0.05, 1 / np.maximum(xi, 0.05), 0.0).astype(np.float32)


def measured_planes(depth: np.ndarray, plane_error: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    measured, weights = np.zeros((PLANES, 3)), np.zeros((PLANES, 3, 3))
    n = kernel.read_planes(depth, rays(), PlaneParameters(error=plane_error), 0.3, SD, measured, weights)
    return measured[:n], weights[:n]


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS)
def test_the_jacobian_of_a_plane_is_its_slope(seed):
    w = corner_window(np.random.default_rng(seed))
    w.calibration.focal[:], w.calibration.scale[0] = [0.01, -0.02], 1.03
    k, j, zero = 1, 2, np.zeros(3)
    workspace = blank_plane_workspace()
    assert plane_residual(w, FACTORS, k, j, zero, workspace)
    states = [
        *range(CALIBRATION),
        *(CALIBRATION + PLANE * k + i for i in range(PLANE)),
        *(SHARED + FRAME * j + i for i in range(6)),
    ]

    def measured(error: np.ndarray) -> np.ndarray:
        other, out = copy.deepcopy(w), blank_plane_workspace()
        moved(other, error)
        assert plane_residual(other, FACTORS, k, j, zero, out)
        return out.r

    for column, state in enumerate(states):
        e = np.zeros(SHARED + FRAME * 3)
        e[state] = STEP
        slope = (measured(e) - measured(-e)) / (2 * STEP)
        assert workspace.J[:, column] == pytest.approx(slope, abs=2e-6)


def test_a_plane_of_the_prior_keeps_its_first_jacobian():
    w = corner_window(np.random.default_rng(1))
    factors = FACTORS._replace(first_estimates=True)
    workspace, later = (blank_plane_workspace() for _ in range(2))
    plane_residual(w, factors, 0, 1, w.planes.measured[0, 1], workspace)
    w.planes.held[0], w.frames.held[1] = 1, 1
    w.planes.normal_first[0], w.planes.distance_first[0] = w.planes.normal[0], w.planes.distance[0]
    w.frames.R_first[1], w.frames.p_first[1] = w.frames.R[1], w.frames.p[1]
    moved(w, 0.02 * np.random.default_rng(2).normal(size=SHARED + FRAME * 3) * (np.arange(SHARED + 45) >= CALIBRATION))
    plane_residual(w, factors, 0, 1, w.planes.measured[0, 1], later)
    use = [i for i in range(later.J.shape[1]) if i != 6]  # the time offset's column has the frame's speed as it is
    assert later.J[:, use] == pytest.approx(workspace.J[:, use], abs=1e-12)
    assert np.abs(later.r).max() > 1e-3


def test_a_corner_of_bare_planes_fixes_the_pose():
    """Nothing but three planes: a frame finds its place among them, with errors that match its covariance."""
    sd, rng = 0.01, np.random.default_rng(5)
    errors, squares = [], []
    for _ in range(60):
        w = corner_window(rng, frames=2)
        true = copy.deepcopy(w)
        n = SHARED + FRAME * 2
        H = w.prior.H
        own = np.arange(SHARED, SHARED + FRAME)
        H[range(CALIBRATION), range(CALIBRATION)] = 1e10
        H[own, own] = 1e10
        rest = np.arange(SHARED + FRAME + 6, n)
        H[rest, rest] = 1e2  # speed and biases, of which planes measure nothing
        w.frames.held[:2] = 1
        for a, b in ((w.frames.R_first, w.frames.R), (w.frames.p_first, w.frames.p), (w.frames.v_first, w.frames.v)):
            a[:] = b
        w.preintegrations.dt[:] = 1.0  # no motion factor: it weighs nothing
        for k in range(3):
            for j in range(2):
                see_plane(w, k, j, sd)
                measured = w.planes.measured[k, j]
                measured += sd * np.linalg.norm(measured) * rng.normal(size=3)
        error = np.zeros(n)
        error[SHARED + FRAME : SHARED + FRAME + 6] = 0.05 * rng.normal(size=6)
        error[CALIBRATION:SHARED] = 0.03 * rng.normal(size=SHARED - CALIBRATION)
        moved(w, error)
        w.frames.R_first[:], w.frames.p_first[:] = w.frames.R, w.frames.p
        work = blank_work(w)
        factors = FACTORS._replace(planes=FACTORS.planes._replace(huber_sd=1e3), rate_walk=1e6, force_walk=1e6)
        minimise(w, factors, work, 15, 0.0)
        o = SHARED + FRAME
        L = np.tril(work.factor[:n, :n])
        P = np.linalg.inv(L @ L.T)[o : o + 6, o : o + 6]
        e = np.concatenate([
            true.frames.p[1] - w.frames.p[1],
            Rotation.from_matrix(w.frames.R[1].T @ true.frames.R[1]).as_rotvec(),
        ])  # fmt: skip
        errors.append(e)
        squares.append(e @ np.linalg.solve(P, e))
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < 0.08
    assert 4.5 < np.mean(squares) < 7.5  # 6 where the covariance is honest; its mean of 60 scatters by 0.45


def test_planes_of_a_corner_are_no_worse_than_their_covariance_says():
    """Cells across a crease bend them a little; the plane error covers that."""
    rng = np.random.default_rng(0)
    floor, left, right = np.array([0.02, 0.6, 0.25]), np.array([-0.35, 0.02, 0.2]), np.array([0.3, -0.05, 0.25])
    squares = []
    for _ in range(4):
        measured, weights = measured_planes(depth_image([floor, left, right], rng), 3e-3)
        assert len(measured) == 3
        for plane in (floor, left, right):
            i = int(np.argmin(np.linalg.norm(measured - plane, axis=1)))
            e = measured[i] - plane
            assert np.linalg.norm(e) < 0.02 * np.linalg.norm(plane)
            squares.append(e @ weights[i] @ e)
    assert np.mean(squares) < 3.0


def test_the_covariance_of_one_plane_is_that_of_its_noise():
    rng, plane, squares = np.random.default_rng(1), np.array([0.05, 0.5, 0.4]), []
    for _ in range(12):
        measured, weights = measured_planes(depth_image([plane], rng))
        squares.append((measured[0] - plane) @ weights[0] @ (measured[0] - plane))
    assert 1.6 < np.mean(squares) < 4.8  # 3; its mean of 12 scatters by 0.7


def test_steps_are_no_plane_and_neither_is_nothing():
    v = np.arange(SHAPE[0])[:, None] * np.ones((1, SHAPE[1]))
    steps = 1.5 + 0.25 * (v // 16 % 2)
    assert not len(measured_planes(steps.astype(np.float32))[0])
    assert not len(measured_planes(np.zeros(SHAPE, np.float32))[0])
    assert not len(measured_planes(np.full(SHAPE, np.nan, np.float32))[0])


def test_the_plane_error_bounds_the_information_of_an_image():
    (_, sure), (_, bounded) = (measured_planes(depth_image([np.array([0.0, 0.0, 0.5])]), d) for d in (0.0, 0.01))
    assert np.linalg.eigvalsh(sure[0]).max() > 1e7
    assert np.linalg.eigvalsh(bounded[0]).max() == pytest.approx((0.01 * 0.5) ** -2, rel=0.01)


def matched(w: Window, measured: np.ndarray, sd: float = 0.005) -> tuple[int, np.ndarray]:
    """Lets the newest frame see planes, after the states are known to 1 mm and 1 mrad."""
    L = np.eye(w.prior.H.shape[0]) * 1e3
    weights = np.array([np.eye(3) / (sd**2 * (t @ t)) for t in measured])
    new = np.zeros(PLANES, np.int64)
    unmatched = kernel.match_planes(
        w.frames, w.calibration, w.planes, FACTORS, blank_plane_workspace(), L, measured, weights, len(measured), new
    )
    return unmatched, new


def test_a_plane_is_known_again_and_its_neighbour_is_not():
    w = corner_window(np.random.default_rng(3))
    measured = w.planes.measured[:3, 2].copy()
    shelf = measured[1] / (1 - 0.1 * np.linalg.norm(measured[1]))  # 0.1 m before the wall
    unmatched, new = matched(w, np.array([measured[2], shelf, measured[0]]))
    assert unmatched == 1
    assert new[0] == 1
    assert w.planes.seen[:, 2].tolist()[:3] == [1, 0, 1]
    kernel.add_plane(w.frames, w.calibration, w.planes, 4, shelf, np.eye(3))
    assert w.planes.normal[4] == pytest.approx(w.planes.normal[1], abs=1e-9)
    assert w.planes.distance[4] == pytest.approx(w.planes.distance[1] - 0.1, abs=1e-9)


def test_a_forgotten_plane_leaves_what_the_prior_knew_of_the_rest():
    rng = np.random.default_rng(6)
    w = corner_window(rng)
    n = len(w.prior.b)
    A = rng.normal(size=(n, n))
    w.prior.H[:], w.prior.b[:] = A @ A.T + np.eye(n), rng.normal(size=n)
    w.planes.held[1] = 1
    own = np.arange(CALIBRATION + PLANE, CALIBRATION + 2 * PLANE)
    rest = np.setdiff1d(np.arange(n), own)
    best, cover = np.linalg.solve(w.prior.H, w.prior.b), np.linalg.inv(w.prior.H)
    marginalize_plane(w, 1)
    assert np.linalg.solve(w.prior.H[np.ix_(rest, rest)], w.prior.b[rest]) == pytest.approx(best[rest])
    assert np.linalg.inv(w.prior.H[np.ix_(rest, rest)]) == pytest.approx(cover[np.ix_(rest, rest)])
    assert not w.prior.H[own].any()
    assert not w.planes.used[1]


def test_the_plane_unseen_for_longest_frees_its_slot_and_an_observed_one_does_not():
    w = corner_window(np.random.default_rng(7))
    w.planes.used[:], w.planes.held[:] = 1, 1
    w.prior.H[:] = np.eye(len(w.prior.b))
    w.planes.seen[:, :3] = 1
    assert free_slot(w) is None
    w.planes.seen[[2, 4]] = 0
    w.planes.seen_ns[:] = [9, 9, 5, 9, 3, 9]
    assert free_slot(w) == 4
    assert free_slot(w) == 4  # it is free now


def test_a_bare_wall_holds_distance_and_attitude():
    """From a time on nothing is painted on the wall: its depth alone holds what it measures."""
    wall = Wall(swaying, 12.0, seed=9)
    both, lasts = [Dvio(rig(), parameters=DvioParameters(planes=on)) for on in (False, True)], [None, None]
    for s in wall.samples():
        if isinstance(s, Image) and s.t_ns > 5e9:
            s = replace(s, pixels=np.full_like(s.pixels, 128))
        lasts = [odometry.update(s) or last for odometry, last in zip(both, lasts)]
    ends = []
    for last in lasts:
        R, p = wall.pose(last.t_ns * 1e-9)
        turned_by = Rotation.from_matrix(last.T_world_imu[:3, :3] @ R.T).as_rotvec()
        ends.append((abs(last.T_world_imu[0, 3] - p[0]), np.abs(turned_by[1:]).max()))
    (far, askew), (near, straight) = ends
    assert near < 0.03 < far
    assert straight < min(0.01, askew)
