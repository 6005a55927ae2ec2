"""Predicts the density of the next footprints along the path, rolled out over several steps with respect to edges.

A walk is a chain of footprints, each one step beyond the previous one and where the sole has support. Whole chains are
weighted, because people see an edge several steps ahead and adapt the steps up to it; forward and backward sums over
the chain give each footprint's density. The common relative change of these steps is one more unknown, which is
marginalised.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.compiled import INSIDE, cached
from stridetwin.estimators.locomotion_mode.parameters import LocomotionModeParameters
from stridetwin.estimators.locomotion_mode.segments import (
    Segment,
    edges_before,
    foothold_weights,
    mode_table,
    path_scale,
)
from stridetwin.estimators.matrices import mul
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

_NODES, _NODE_WEIGHTS = np.polynomial.hermite_e.hermegauss(5)


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """Distribution of the coming steps.

    Attributes:
        density: (K, S) of each step's footprint over the cells, sums 1.
        modes: (K, 5) probability of each mode.
        on: (K, P) probability of each terrain segment under the footprint.
    """

    density: Array
    modes: Array
    on: Array


def roll_out(
    stance: Array, s: Array, ground: Sequence[Segment], lengths: Sequence[float], length_sd: float,
    ratios: Mapping[str, tuple[float, float]], p: LocomotionModeParameters,
    landing: tuple[Array, Array] | None = None,
) -> Chain:  # fmt: skip
    """Density of the next footprints.

    See docs/locomotion_mode.md (5).

    Args:
        stance: (S,) density of the stance foot over the cells.
        s: (S,) m along the path, evenly spaced.
        ground: Terrain segments.
        lengths: Expected length of each coming step on level ground, m.
        length_sd: Standard deviation common to all of them, m.
        ratios: Step length relative to level ground and its standard deviation, by mode of the ground (RA, RD).
        p: Dimensions.
        landing: (S,) and (S,) likelihood of each position of the last step given the body's position, after a step on
            even ground and after one over an edge; None: unknown.
    """
    weight = foothold_weights(ground, s, p) + p.weight_floor
    edges = np.array(edges_before(ground))
    # Number of edges between (a, b); steps never go backward.
    between = edges[None, :] - edges[:, None]
    ahead = np.arange(len(ground))[None, :] >= np.arange(len(ground))[:, None]
    even = (ahead & (between == 0)).astype(float)
    over = np.where(ahead & (between > 0), p.skip ** np.maximum(between - 1, 0), 0.0)
    level, unsure = path_scale(ground, s, ratios)
    shifts = length_sd * _NODES
    band = round(p.longest_step_m / (s[1] - s[0]))
    kinds = list(dict.fromkeys(lengths))
    kind = np.array([kinds.index(length) for length in lengths])
    made = [_kernels(s, level, unsure, length, shifts, band, p) for length in kinds]
    if landing is not None:  # the last step has its own kind
        at = np.minimum(np.arange(len(s))[:, None] + np.arange(band), len(s) - 1)
        near, far = made[kind[-1]]
        made.append((near * (landing[0][at] + p.weight_floor), far * (landing[1][at] + p.weight_floor)))
        kind[-1] = len(kinds)
    near, far = (np.array([of_kind[i] for of_kind in made]) for i in (0, 1))
    first = stance * weight
    first = _NODE_WEIGHTS[:, None, None] * first / (_NODE_WEIGHTS.sum() * first.sum())
    density, on, flow = _chain(first, weight, even, over, near, far, kind, p.density_min)
    return Chain(density=density, modes=np.einsum("kab,abm->km", flow, mode_table(ground, p)), on=on)


def _kernels(
    s: Array, level: Array, unsure: Array, length: float, shifts: Array, band: int, p: LocomotionModeParameters
) -> tuple[Array, Array]:
    """(H, S, B) and (S, B) density of a step from each cell to the following cells: on even ground, and over an edge.

    See docs/locomotion_mode.md (7).
    """
    lag = s[1] - s[0]
    far = np.exp(-0.5 * ((lag * np.arange(band) - p.edge_step * length) / p.edge_step_sd_m) ** 2) / p.edge_step_sd_m
    near = _even_steps(level, length * np.hypot(p.step_noise, unsure), length, shifts, band, p.tail_sd)
    return near, np.broadcast_to(far, (len(s), band))


@cached(_HERE)
def _even_steps(level: Array, sd: Array, length: float, shifts: Array, band: int, tail_sd: float) -> Array:
    """(H, S, B) density of steps on even ground, from (S,) path length and its (S,) standard deviation."""
    found = np.zeros((len(shifts), len(level), band))
    for p in range(len(level)):
        for j in range(band):
            q = min(p + j, len(level) - 1)
            off = level[q] - level[p] - length
            for h in range(len(shifts)):
                away = (off - shifts[h]) / sd[q]
                if abs(away) < tail_sd:
                    found[h, p, j] = math.exp(-0.5 * away * away) / sd[q]
    return found


@cached(_HERE)
def _chain(
    first: Array, weight: Array, even: Array, over: Array, near: Array, far: Array, kind: NDArray[np.int64],
    density_min: float,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Forward and backward sums over a chain of footprints.

    See docs/locomotion_mode.md (8).

    Args:
        first: (H, P, S) density of the stance foot, by step length change, segment and cell.
        weight: (P, S) weight of each foothold.
        even: (P, P) 1 where a step between segments crosses no edge.
        over: (P, P) probability of a step that crosses edges.
        near: (L, H, S, B) density of each kind of step from a cell to the B cells from it on, on even ground.
        far: (L, S, B) the same over an edge.
        kind: (K,) kind of each step.
        density_min: Smaller densities are not propagated.

    Returns:
        (K, S) density of each footprint, (K, P) of its segment, (K, P, P) of its transition; each sums to 1.
    """
    _, H, S, B = near.shape
    K, P = len(kind), len(weight)
    alpha = np.zeros((K + 1, H, P, S))
    alpha[0] = first
    reach_near, reach_far = np.zeros((K, H, P, S)), np.zeros((K, H, P, S))
    for k in range(K):
        total = 0.0
        for h in range(H):
            for a in range(P):
                for p in range(S):
                    v = alpha[k, h, a, p]
                    if v < density_min:
                        continue
                    n = min(B, S - p)
                    _spread(
                        v, near[kind[k], h, p, :n], far[kind[k], p, :n], reach_near[k, h, a, p : p + n],
                        reach_far[k, h, a, p : p + n],
                    )  # fmt: skip
            for a in range(P):
                for b in range(a, P):
                    if even[a, b] == 0.0 and over[a, b] == 0.0:
                        continue
                    for q in range(S):
                        v = even[a, b] * reach_near[k, h, a, q] + over[a, b] * reach_far[k, h, a, q]
                        alpha[k + 1, h, b, q] += v * weight[b, q]
            for b in range(P):
                for q in range(S):
                    total += alpha[k + 1, h, b, q]
        _divide(alpha[k + 1], total)
    density, on, flow = np.zeros((K, S)), np.zeros((K, P)), np.zeros((K, P, P))
    beta, ends = np.ones((H, P, S)), np.empty((P, S))
    for k in range(K - 1, -1, -1):
        back = np.zeros((H, P, S))
        largest = 0.0
        for h in range(H):
            for b in range(P):
                for q in range(S):
                    ends[b, q] = weight[b, q] * beta[h, b, q]
                    v = alpha[k + 1, h, b, q] * beta[h, b, q]
                    density[k, q] += v
                    on[k, b] += v
            for a in range(P):
                for b in range(a, P):
                    if even[a, b] == 0.0 and over[a, b] == 0.0:
                        continue
                    for q in range(S):
                        v = even[a, b] * reach_near[k, h, a, q] + over[a, b] * reach_far[k, h, a, q]
                        flow[k, a, b] += v * ends[b, q]
            onto_even, onto_over = mul(even, ends), mul(over, ends)
            for a in range(P):
                for p in range(S):
                    if alpha[k, h, a, p] < density_min:
                        continue
                    n = min(B, S - p)
                    v = _gather(
                        near[kind[k], h, p, :n], far[kind[k], p, :n], onto_even[a, p : p + n], onto_over[a, p : p + n]
                    )
                    back[h, a, p] = v
                    largest = max(largest, v)
        beta = back
        _divide(beta, largest)
        _normalise(density[k])
        _normalise(on[k])
        _normalise(flow[k])
    return density, on, flow


@njit(**INSIDE)
def _divide(values: Array, by: float) -> None:
    """Divides values by a number that is 0 where they all are."""
    for i in np.ndindex(values.shape):
        values[i] /= max(by, 1e-300)


@njit(**INSIDE)
def _normalise(values: Array) -> None:
    """Scales values to the sum 1."""
    total = 0.0
    for i in np.ndindex(values.shape):
        total += float(values[i])
    _divide(values, total)


@njit(**INSIDE)
def _spread(v: float, near: Array, far: Array, onto_even: Array, onto_over: Array) -> None:
    """Adds the contribution of one cell to the cells from it on."""
    for j in range(len(near)):
        onto_even[j] += v * near[j]
        onto_over[j] += v * far[j]


@njit(fastmath=True, **INSIDE)
def _gather(near: Array, far: Array, even: Array, over: Array) -> float:
    """Backward sum of one cell over the cells from it on; vectorised."""
    v = 0.0
    for j in range(len(near)):
        v += near[j] * even[j] + far[j] * over[j]
    return v


def moments(density: Array, s: Array) -> tuple[float, float]:
    """Mean and standard deviation of a density over cells, m."""
    mean = float(density @ s)
    return mean, float(np.sqrt(max(density @ (s - mean) ** 2, (s[1] - s[0]) ** 2 / 12.0)))
