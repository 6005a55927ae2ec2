"""Predicts the density of the next footprints along the path, rolled out over several steps with respect to edges.

A walk is a chain of footprints, each one step beyond the previous one and where the sole has support. Whole chains are
weighted, because people see an edge several steps ahead and adapt the steps up to it; forward and backward sums over
the chain give each footprint's density. The common relative change of these steps is one more unknown, which is
marginalised. After a step over an edge the other foot may join this one, so the chain distinguishes whether the last
step crossed an edge.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stridetwin.estimators.locomotion_mode.habits import Habit, step_weights
from stridetwin.estimators.locomotion_mode.parameters import Settings
from stridetwin.estimators.locomotion_mode.segments import Segment, foothold_weights, mode_table, path_scale
from stridetwin.streams.algebra.matrices import copy, multiply
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_HERE = Path(__file__).parent

_LEAST = 1e-300
"""Smallest divisor."""
_EDGE_STEP, _EDGE_STEP_SD_M = 0.60, 0.15
"""Mean length of a step over an edge as a share of the level step, and σ_x, of docs/locomotion_mode.md (7)."""
_BESIDE_SD_M = 0.05
"""σ_b of docs/locomotion_mode.md (14): standard deviation of the distance between a foot and the one that joins it."""
_MAX_STEP_M = 1.35
"""Longest step."""
_WEIGHT_FLOOR = 1e-9
"""Lower limit of a foothold's weight: an unexpected step must not leave the density empty."""
_MIN_DENSITY = 1e-10
"""Smaller densities are not propagated."""
_TAIL_SD = 8.0
"""Standard deviations beyond which a density is taken as zero: it is far below `_MIN_DENSITY`."""
_NODES, _NODE_WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
"""(H,) nodes, in standard deviations, and weights of a Gaussian quadrature over the common change of all steps."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """Distribution of the coming K steps over S cells of the path and P terrain segments.

    Attributes:
        density: (K, S) of each step's footprint over the cells, each sums to 1.
        modes: (K, 5) probability of each mode, in the order of `MODES`.
        on: (K, P) probability of each terrain segment under the footprint.
        last: (2, S) density of the last footprint, by whether its step crossed an edge (no, yes); sums to 1.
        joined: (K,) probability that the foot joins the other one on its tread.
        evidence: Likelihood of the walk's last landing, up to a common factor.
    """

    density: Array
    modes: Array
    on: Array
    last: Array
    joined: Array
    evidence: float


def mix_chains(chains: Sequence[Chain], shares: Array) -> Chain:
    """The mixture of the chains of walkers with several habits, weighted by `shares`, which need not sum to 1."""
    shares = shares / shares.sum()
    mean_fields = {  # by name of the field: the weighted mean over the chains
        name: sum(share * getattr(chain, name) for share, chain in zip(shares.tolist(), chains))
        for name in ("density", "modes", "on", "last", "joined", "evidence")
    }
    return Chain(**mean_fields)


class Likelihoods(NamedTuple):
    """(S,) likelihood of each position of a step given the body's position, by the kind of the step.

    Attributes:
        even: After a step on even ground.
        over: After a step over an edge.
        beside: After a step that joins the other foot.
        step: Index of the step: that of the last one, which has just ended, or 0 for the one whose foot is in the air.
    """

    even: Array
    over: Array
    beside: Array
    step: int = -1


def roll_out(
    stance: Array,
    s: Array,
    ground: Sequence[Segment],
    lengths: Sequence[float],
    length_sd: float,
    ratios: Mapping[str, tuple[float, float]],
    settings: Settings,
    habit: Habit | None = None,
    landing: Likelihoods | None = None,
    first_noise: float | None = None,
) -> Chain:
    """Predicts the densities of the next footprints by the chain of docs/locomotion_mode.md (5).

    With the likelihoods of a landing, one of the steps is known better: the last one where it has just ended, and then
    the chain's `last` is the density of the foot that has landed; or the first one, whose foot is in the air.

    Args:
        stance: (2, S) density of the stance foot over the cells, by whether its step crossed an edge (no, yes).
        s: (S,) m along the path, evenly spaced.
        ground: Terrain segments.
        lengths: Expected length of each coming step on level ground, m.
        length_sd: Standard deviation common to all of them, m.
        ratios: Step length relative to level ground and its standard deviation, by mode of the ground (RA, RD).
        settings: Dimensions and standard deviations.
        habit: How the walker uses stairs; None: every step follows from its length.
        landing: Likelihoods of the position of one of the steps; None: unknown.
        first_noise: Standard deviation of the first step as a share of its length; None: that of any other.
    """
    habit = habit or Habit()
    weight = foothold_weights(ground, s, settings) + _WEIGHT_FLOOR  # (P, S)
    # (P, P) weights of steps between segments, on even ground and over edges: for any walker, and for this habit
    plain = step_weights(ground, Habit(), settings)
    even, over = plain if habit.is_usual else step_weights(ground, habit, settings)
    # (S,) path length in units of level ground, m, and its relative uncertainty
    level, unsure = path_scale(ground, s, ratios)
    shifts = length_sd * _NODES  # (H,) common changes of all steps, m: nodes of a Gaussian quadrature
    band = round(_MAX_STEP_M / (s[1] - s[0]))  # number of cells that a step may reach
    noises = [settings.mode.step_noise] * len(lengths)
    noises[0] = noises[0] if first_noise is None else first_noise
    # steps of equal length and noise are of one kind and share their kernels
    kinds = list(dict.fromkeys(zip(lengths, noises)))
    kind = np.array([kinds.index(both) for both in zip(lengths, noises)])  # (K,) index of each step's kind
    step_kernels = [_build_kernels(s, level, unsure, length, shifts, band, noise) for length, noise in kinds]
    # (L, P, S) sums over the landing cells, by kind of step, segment and cell: of ordinary steps of any walker, of
    # those of this habit, and of joining steps; their ratios are `step_factor` and `join_factor` of `_Steps`
    usual_sums = _sum_steps(weight, *plain, step_kernels)
    step_factor = np.ones_like(usual_sums)
    if not habit.is_usual:
        step_factor = usual_sums / np.maximum(_sum_steps(weight, even, over, step_kernels), _LEAST)
    beside_sums = [_sum_beside(kernels.beside, even @ weight) for kernels in step_kernels]
    join_factor = usual_sums / np.maximum(beside_sums, _LEAST)
    if landing is not None:  # that step has its own kind
        known = kind[landing.step]
        step_kernels.append(_apply_likelihoods(step_kernels[known], landing))
        join_factor, step_factor = (
            np.append(of_kind, of_kind[known, None], axis=0) for of_kind in (join_factor, step_factor)
        )
        kind[landing.step] = len(kinds)
    near = np.array([kernels.near for kernels in step_kernels])  # (L, H, S, B)
    far = np.array([kernels.far for kernels in step_kernels])  # (L, S, B)
    beside = np.array([kernels.beside for kernels in step_kernels])  # (L, S, W)
    first = stance[:, None, :] * weight  # (2, P, S) density of the stance foot by segment
    mass = float(first.sum())
    # (H, 2, P, S), sums to 1: each common change of all steps has the weight of its node
    first = _NODE_WEIGHTS[:, None, None, None] * first / (_NODE_WEIGHTS.sum() * max(mass, _LEAST))
    joins = np.array([habit.joins[min(k, 1)] for k in range(len(kind))])  # (K,) the next step, then all later ones
    steps = _Steps(
        kind=kind,
        near=near,
        far=far,
        beside=beside,
        step_factor=step_factor,
        join_factor=join_factor,
        joins=joins,
    )
    density, on, flow, ends, joined, evidence = _sum_chains(first, weight, even, over, steps)
    modes = np.einsum("kab,abm->km", flow, mode_table(ground, settings))
    last = ends.sum(axis=(0, 2))  # (2, S) without the common change and the segment
    return Chain(
        density=density,
        modes=modes,
        on=on,
        last=last / max(float(last.sum()), _LEAST),
        joined=joined,
        evidence=mass * evidence,
    )


class _Steps(NamedTuple):
    """Kernels of the coming steps from each cell, by kind of step l = 1..L; kernels as in `_Kernels`.

    Attributes:
        kind: (K,) kind of each step.
        near: (L, H, S, B) κ_even.
        far: (L, S, B) κ_edge.
        beside: (L, S, W) N(s_k − s_(k−1); 0, σ_b²) of docs/locomotion_mode.md (14).
        step_factor: (L, P, S) factor of `near` and `far` by segment and cell, docs/locomotion_mode.md (15): all steps
            from a cell together weigh the same for any habit, so a step is evidence only for habits that make it more
            often than other steps.
        join_factor: (L, P, S) ρ of docs/locomotion_mode.md (14), factor of `beside`: all joining steps from a cell
            weigh as much as all others from there, so their probability does not depend on how rarely an ordinary step
            finds a foothold.
        joins: (K,) q of docs/locomotion_mode.md (14): probability of a joining step where the previous one crossed an
            edge.
    """

    kind: NDArray[np.int64]
    near: Array
    far: Array
    beside: Array
    step_factor: Array
    join_factor: Array
    joins: Array


class _Kernels(NamedTuple):
    """Densities of a step of one kind from each of S cells to the cells around it.

    Attributes:
        near: (H, S, B) κ_even to the B cells from it on, for each of H common changes of the step length.
        far: (S, B) κ_edge to the B cells from it on.
        beside: (S, W) to the W cells about it, joining the other foot.
    """

    near: Array
    far: Array
    beside: Array


def _build_kernels(
    s: Array, level: Array, unsure: Array, length: float, shifts: Array, band: int, step_noise: float
) -> _Kernels:
    """Builds the kernels of one kind of step: docs/locomotion_mode.md (7) and (14).

    Args:
        s: (S,) m along the path.
        level: (S,) path length ℓ(s) in units of level ground, m.
        unsure: (S,) relative local uncertainty of ℓ.
        length: Length of a step on level ground, m.
        shifts: (H,) common changes η of all steps, m.
        band: Number of cells B that a step may reach.
        step_noise: Standard deviation of a single step as a share of its length.
    """
    lag = s[1] - s[0]  # m, one cell
    # a step over an edge, (B,), and a joining one, (W,): the same from every cell
    far = np.exp(-0.5 * ((lag * np.arange(band) - _EDGE_STEP * length) / _EDGE_STEP_SD_M) ** 2) / _EDGE_STEP_SD_M
    near = _even_steps(level, length * np.hypot(step_noise, unsure), length, shifts, band)
    beside = np.exp(-0.5 * (lag * _nearby_cells(lag) / _BESIDE_SD_M) ** 2) / _BESIDE_SD_M
    return _Kernels(near, np.broadcast_to(far, (len(s), band)), np.broadcast_to(beside, (len(s), len(beside))))


def _nearby_cells(lag: float) -> NDArray[np.int64]:
    """(W,) offsets, in cells of `lag` m, of the cells about a foot in which the other foot may join it."""
    reach = max(1, round(3.0 * _BESIDE_SD_M / lag))
    return np.arange(-reach, reach + 1)


def _apply_likelihoods(kernels: _Kernels, landing: Likelihoods) -> _Kernels:
    """Kernels of a step times the likelihoods of its landing positions, by kind of step.

    Row p of a kernel is about the cells from p on (`near`, `far`) or around p (`beside`): `onward` and `around` are the
    indices of these cells, limited to the path.
    """
    cells, half = len(landing.even), kernels.beside.shape[1] // 2  # half the cells about a foot
    here = np.arange(cells)[:, None]
    onward = np.minimum(here + np.arange(kernels.far.shape[1]), cells - 1)
    around = np.clip(here + np.arange(-half, half + 1), 0, cells - 1)
    return _Kernels(
        kernels.near * (landing.even[onward] + _WEIGHT_FLOOR),
        kernels.far * (landing.over[onward] + _WEIGHT_FLOOR),
        kernels.beside * (landing.beside[around] + _WEIGHT_FLOOR),
    )


def _sum_steps(weight: Array, even: Array, over: Array, step_kernels: Sequence[_Kernels]) -> Array:
    """(L, P, S) sum over the landing cells of all steps that do not join, for each kind, segment and cell of departure.

    It is ∫ (κ_even + κ_edge) u ds' of docs/locomotion_mode.md (14), at the middle node of the step length.

    Args:
        weight: (P, S) weight u of each foothold.
        even: (P, P) weights of steps between segments on even ground.
        over: (P, P) weights of steps over edges.
        step_kernels: Kernels of each kind of step.
    """
    # (P, S) weight of stepping from a segment onto a cell of any segment, on even ground and over edges
    onto_even, onto_over = even @ weight, over @ weight
    middle = len(_NODES) // 2  # the node of no common change
    return np.array([_sum_onward(kernels.near[middle], kernels.far, onto_even, onto_over) for kernels in step_kernels])


@entry_kernel(_HERE)
def _sum_onward(near: Array, far: Array, onto_even: Array, onto_over: Array) -> Array:
    """(P, S) sum of all steps from each cell of each segment, over the cells from it on.

    Args:
        near: (S, B) density of steps on even ground, to the B cells from each one on.
        far: (S, B) density of steps over edges.
        onto_even: (P, S) weight of stepping from a segment onto a cell, on even ground.
        onto_over: (P, S) weight of it over edges.
    """
    P, S = onto_even.shape
    sums = np.zeros((P, S))
    for a in range(P):
        for p in range(S):
            n = min(near.shape[1], S - p)
            sums[a, p] = _gather(near[p, :n], far[p, :n], onto_even[a, p : p + n], onto_over[a, p : p + n])
    return sums


@entry_kernel(_HERE)
def _sum_beside(beside: Array, onto_even: Array) -> Array:
    """(P, S) sum of all joining steps from each cell of each segment, over the cells about it.

    Args:
        beside: (S, W) density of joining steps, to the W cells about each one.
        onto_even: (P, S) weight of stepping from a segment onto a cell, on even ground.
    """
    P, S = onto_even.shape
    sums = np.zeros((P, S))
    for a in range(P):
        for p in range(S):
            sums[a, p] = _gather_beside(beside[p], onto_even[a], p)
    return sums


@entry_kernel(_HERE)
def _even_steps(level: Array, sd: Array, length: float, shifts: Array, band: int) -> Array:
    """(H, S, B) κ_even of docs/locomotion_mode.md (7): density of steps on even ground, up to a factor.

    Args:
        level: (S,) path length ℓ(s) in units of level ground, m.
        sd: (S,) standard deviation of a step by its landing cell, m.
        length: Expected length of the step, m.
        shifts: (H,) common changes η of all steps, m.
        band: B, number of cells that a step may reach.
    """
    density = np.zeros((len(shifts), len(level), band))
    for p in range(len(level)):
        for j in range(band):
            q = min(p + j, len(level) - 1)  # the landing cell
            off = level[q] - level[p] - length  # excess of the step over its expected length, m
            for h in range(len(shifts)):
                away = (off - shifts[h]) / sd[q]  # in standard deviations
                if abs(away) < _TAIL_SD:
                    density[h, p, j] = math.exp(-0.5 * away * away) / sd[q]
    return density


@entry_kernel(_HERE)
def _sum_chains(
    first: Array, weight: Array, even: Array, over: Array, steps: _Steps
) -> tuple[Array, Array, Array, Array, Array, float]:
    """Forward and backward sums over all chains of footprints: docs/locomotion_mode.md (8) and (14).

    H common changes of the step length, P segments, S cells, K steps; x tells whether a step crossed an edge.

    Args:
        first: (H, 2, P, S) density of the stance foot by change of step length, x, segment and cell.
        weight: (P, S) weight u of each foothold.
        even: (P, P) weights of steps between segments on even ground.
        over: (P, P) weights of steps over edges.
        steps: The coming steps.

    Returns:
        (K, S) density of each footprint, (K, P) of its segment, (K, P, P) of its transition, each sums to 1; (H, 2, P,
        S) density of the last footprint, as `first`; (K,) probability that a step joins; the sum over all chains.
    """
    kind, near, far, beside, step_factor, join_factor, joins = steps
    _, H, S, B = near.shape
    K, P = len(kind), len(weight)
    alpha = np.zeros((K + 1, H, 2, P, S))
    copy(first.ravel(), alpha[0].ravel())
    # (K, H, P, S) sums over all steps that arrive at a cell from a segment, on even ground and over edges
    reach_near, reach_far = np.zeros((K, H, P, S)), np.zeros((K, H, P, S))
    evidence = 1.0
    # Forward: α_k(s) = u(s) Σ κ(s | s') α_(k-1)(s'), normalised at each step; `reach` is the sum before u
    for k in range(K):
        for h in range(H):
            for a in range(P):
                for p in range(S):
                    crossed = alpha[k, h, 1, a, p]
                    # steps that do not join: α(x=0) + (1 - q) α(x=1)
                    v = (alpha[k, h, 0, a, p] + (1.0 - joins[k]) * crossed) * step_factor[kind[k], a, p]
                    if v >= _MIN_DENSITY:
                        n = min(B, S - p)  # cells from p on, up to the end of the path
                        _spread(
                            v,
                            near[kind[k], h, p, :n],
                            far[kind[k], p, :n],
                            reach_near[k, h, a, p : p + n],
                            reach_far[k, h, a, p : p + n],
                        )
                    v = joins[k] * join_factor[kind[k], a, p] * crossed  # q ρ α(x=1): the foot joins the other one
                    if v >= _MIN_DENSITY:
                        _spread_beside(v, beside[kind[k], p], reach_near[k, h, a], p)
            for a in range(P):  # from segment a, where the step begins, to segment b
                for b in range(a, P):
                    if even[a, b] == 0.0 and over[a, b] == 0.0:
                        continue
                    for q in range(S):
                        alpha[k + 1, h, 0, b, q] += even[a, b] * reach_near[k, h, a, q] * weight[b, q]
                        alpha[k + 1, h, 1, b, q] += over[a, b] * reach_far[k, h, a, q] * weight[b, q]
        total = _total(alpha[k + 1])
        _divide(alpha[k + 1], total)
        evidence *= total
    density, on, flow, joined = np.zeros((K, S)), np.zeros((K, P)), np.zeros((K, P, P)), np.zeros(K)
    # Backward: β_(k-1)(s') = Σ κ(s | s') u(s) β_k(s); the density of a footprint is α β
    beta, ends = np.ones((H, 2, P, S)), np.empty((2, P, S))
    for k in range(K - 1, -1, -1):
        back = np.zeros((H, 2, P, S))
        largest = beside_all = 0.0
        for h in range(H):
            for c in range(2):
                for b in range(P):
                    for q in range(S):
                        ends[c, b, q] = weight[b, q] * beta[h, c, b, q]  # u β
                        v = alpha[k + 1, h, c, b, q] * beta[h, c, b, q]
                        density[k, q] += v
                        on[k, b] += v
            for a in range(P):
                for b in range(a, P):
                    if even[a, b] == 0.0 and over[a, b] == 0.0:
                        continue
                    for q in range(S):
                        # probability of the step from segment a to segment b
                        flow[k, a, b] += even[a, b] * reach_near[k, h, a, q] * ends[0, b, q]
                        flow[k, a, b] += over[a, b] * reach_far[k, h, a, q] * ends[1, b, q]
            onto_even, onto_over = multiply(even, ends[0]), multiply(over, ends[1])
            for a in range(P):
                for p in range(S):
                    crossed = alpha[k, h, 1, a, p]
                    if max(alpha[k, h, 0, a, p], crossed) < _MIN_DENSITY:
                        continue
                    n = min(B, S - p)
                    v = _gather(
                        near[kind[k], h, p, :n], far[kind[k], p, :n], onto_even[a, p : p + n], onto_over[a, p : p + n]
                    )
                    v *= step_factor[kind[k], a, p]  # all steps from here that do not join
                    back[h, 0, a, p] = v
                    if crossed >= _MIN_DENSITY:
                        gathered = _gather_beside(beside[kind[k], p], onto_even[a], p)
                        w = joins[k] * join_factor[kind[k], a, p] * gathered  # those that join
                        back[h, 1, a, p] = (1.0 - joins[k]) * v + w  # after a step over an edge, the foot may join
                        beside_all += crossed * w
                    largest = max(largest, v, back[h, 1, a, p])
        joined[k] = beside_all / max(_total(flow[k]), 1e-300)
        beta = back
        _divide(beta, largest)
        _normalise(density[k])
        _normalise(on[k])
        _normalise(flow[k])
    return density, on, flow, alpha[K], joined, evidence


@njit(**INNER_KERNEL)
def _divide(values: Array, by: float) -> None:
    """Divides all values in place by a number; by 1e-300 if the number is smaller."""
    for i in np.ndindex(values.shape):
        values[i] /= max(by, 1e-300)


@njit(**INNER_KERNEL)
def _normalise(values: Array) -> None:
    """Scales all values in place so that they sum to 1."""
    _divide(values, _total(values))


@njit(**INNER_KERNEL)
def _total(values: Array) -> float:
    """Sum of all values of an array of any shape."""
    total = 0.0
    for i in np.ndindex(values.shape):
        total += float(values[i])
    return total


@njit(**INNER_KERNEL)
def _spread(v: float, near: Array, far: Array, onto_even: Array, onto_over: Array) -> None:
    """Forward sum: adds the steps from one cell of density v to the n cells from it on.

    `near` and `far` (n,) are densities of steps on even ground and over edges; `onto_even` and `onto_over` (n,) are the
    sums of both, changed in place.
    """
    for j in range(len(near)):
        onto_even[j] += v * near[j]
        onto_over[j] += v * far[j]


@njit(fastmath=True, **INNER_KERNEL)
def _gather(near: Array, far: Array, even: Array, over: Array) -> float:
    """Backward sum of one cell: Σ (near · even + far · over) over the n cells from it on, (n,) each; vectorised."""
    v = 0.0
    for j in range(len(near)):
        v += near[j] * even[j] + far[j] * over[j]
    return v


@njit(**INNER_KERNEL)
def _spread_beside(v: float, beside: Array, onto: Array, p: int) -> None:
    """Forward sum: adds the joining steps from cell p, of density v, to the cells about it.

    `beside` (W,) is the density of joining steps to the W cells about p; `onto` (S,) is the sum over all cells, changed
    in place. Cells before and beyond the path are left out.
    """
    half = len(beside) // 2
    for j in range(max(0, half - p), min(len(beside), len(onto) + half - p)):
        onto[p + j - half] += v * beside[j]


@njit(**INNER_KERNEL)
def _gather_beside(beside: Array, onto: Array, p: int) -> float:
    """Backward sum of cell p: Σ beside · onto over the W cells about it, those on the path; `onto` is (S,)."""
    half = len(beside) // 2
    v = 0.0
    for j in range(max(0, half - p), min(len(beside), len(onto) + half - p)):
        v += beside[j] * onto[p + j - half]
    return v


def moments(density: Array, s: Array) -> tuple[float, float]:
    """Mean and standard deviation, m, of a density over the cells of a path.

    The standard deviation is at least that of a uniform density over one cell.

    Args:
        density: (S,) sums to 1.
        s: (S,) m along the path, evenly spaced.
    """
    mean = float(density @ s)
    cell_variance = (s[1] - s[0]) ** 2 / 12.0
    return mean, float(np.sqrt(max(density @ (s - mean) ** 2, cell_variance)))
