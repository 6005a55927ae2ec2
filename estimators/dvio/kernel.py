"""The compiled functions that Python calls, cached under the digest of all that is compiled into them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from stridetwin.estimators.digest import digest_of_sources
from stridetwin.estimators.dvio import live, marginal, patches, pixels, planes, preintegration, sights, solver, surfaces


def _compiled(sources: int) -> tuple[Callable[..., Any], ...]:
    """What Python calls; only these outermost functions are cached.

    Args:
        sources: Digest, ≥ 0.
    """

    @njit(cache=True, error_model="numpy")
    def integrate(z, t_ns, samples, doubt, count, start_ns, end_ns, bias, noise):  # type: ignore[no-untyped-def]
        assert sources >= 0
        preintegration.integrate(z, t_ns, samples, doubt, count, start_ns, end_ns, bias, noise)

    @njit(cache=True, error_model="numpy")
    def integrate_into(zs, k, t_ns, samples, doubt, count, start_ns, end_ns, bias, noise):  # type: ignore[no-untyped-def]
        assert sources >= 0
        z = preintegration.increment_at(zs, k)
        preintegration.integrate(z, t_ns, samples, doubt, count, start_ns, end_ns, bias, noise)
        z.weight[:] = np.linalg.inv(z.covariance)

    @njit(cache=True, error_model="numpy")
    def carry(state, z, t_ns, samples, doubt, count, end_ns, noise, gravity):  # type: ignore[no-untyped-def]
        assert sources >= 0
        live.carry(state, z, t_ns, samples, doubt, count, end_ns, noise, gravity)

    @njit(cache=True, error_model="numpy")
    def sound(state):  # type: ignore[no-untyped-def]
        assert sources >= 0
        return live.sound(state)

    @njit(cache=True, error_model="numpy")
    def told(state):  # type: ignore[no-untyped-def]
        assert sources >= 0
        return live.told(state)

    @njit(cache=True, error_model="numpy")
    def minimise(window, terms, work, steps, enough):  # type: ignore[no-untyped-def]
        assert sources >= 0
        return solver.minimise(window, terms, work, steps, enough)

    @njit(cache=True, error_model="numpy")
    def forget_oldest(window, terms, work, alive):  # type: ignore[no-untyped-def]
        assert sources >= 0
        marginal.forget_oldest(window, terms, work, alive)

    @njit(cache=True, error_model="numpy")
    def foresee(window, R, p, before, expected, start, warp, known):  # type: ignore[no-untyped-def]
        assert sources >= 0
        sights.foresee(window, R, p, before, expected, start, warp, known)

    @njit(cache=True, error_model="numpy")
    def cull(window, terms, work, most, alive):  # type: ignore[no-untyped-def]
        assert sources >= 0
        return sights.cull(window, terms, work, most, alive)

    @njit(cache=True, error_model="numpy")
    def parallax(window, newest, since):  # type: ignore[no-untyped-def]
        assert sources >= 0
        return sights.parallax(window, newest, since)

    @njit(cache=True, error_model="numpy")
    def pick(grey, candidates, taken, columns, rows, apart, margin, least, wanted, out):  # type: ignore[no-untyped-def]
        assert sources >= 0
        return pixels.pick(grey, candidates, taken, columns, rows, apart, margin, least, wanted, out)

    @njit(cache=True, error_model="numpy")
    def read_depth(depth, points, least, most, spread, told):  # type: ignore[no-untyped-def]
        assert sources >= 0
        pixels.read_depth(depth, points, least, most, spread, told)

    @njit(cache=True, error_model="numpy")
    def cut(grey, ids, points, kept):  # type: ignore[no-untyped-def]
        assert sources >= 0
        patches.cut(grey, ids, points, kept)

    @njit(cache=True, error_model="numpy")
    def align(grey, kept, ids, warps, far, alike, settled, points, good):  # type: ignore[no-untyped-def]
        assert sources >= 0
        patches.align(grey, kept, ids, warps, far, alike, settled, points, good)

    @njit(cache=True, error_model="numpy")
    def read_slope(depth, points, least, most, rough, slope):  # type: ignore[no-untyped-def]
        assert sources >= 0
        patches.read_slope(depth, points, least, most, rough, slope)

    @njit(cache=True, error_model="numpy")
    def read_planes(depth, rays, least, most, sd, doubt, told, weights):  # type: ignore[no-untyped-def]
        assert sources >= 0
        return surfaces.read_planes(depth, rays, least, most, sd, doubt, told, weights)

    @njit(cache=True, error_model="numpy")
    def match_planes(window, terms, L, told, weights, count, new):  # type: ignore[no-untyped-def]
        assert sources >= 0
        return planes.match_planes(window, terms, L, told, weights, count, new)

    @njit(cache=True, error_model="numpy")
    def found_plane(window, k, told, weight):  # type: ignore[no-untyped-def]
        assert sources >= 0
        planes.found_plane(window, k, told, weight)

    return (
        integrate, integrate_into, carry, minimise, forget_oldest, foresee, cull, parallax, pick, read_depth,
        cut, align, read_slope, sound, told, read_planes, match_planes, found_plane,
    )  # fmt: skip


(
    integrate, integrate_into, carry, minimise, forget_oldest, foresee, cull, parallax, pick, read_depth,
    cut, align, read_slope, sound, told, read_planes, match_planes, found_plane,
) = _compiled(digest_of_sources(Path(__file__).parent))  # fmt: skip
