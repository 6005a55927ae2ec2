"""Whether rates and forces of an IMU in motion leave a speed over that its wearer cannot have.

A head, a chest or a hand never rests, so that nothing is known of its speed but a bound: a person's changes by a few
m/s, however long the walk. The forces, turned by the integrated rates into the axes at the start and summed up, grow by
gravity in each second: a straight line, from which only the speed deviates. Rates of another unit, with swapped or
mirrored axes, or of another clock turn gravity along, and the sum leaves the line by more than any speed.

The walk is cut into spans, and the rates are corrected for each usual mistake in turn. A mistake is certain if, in
several spans, the speed is impossible as recorded and possible once it is corrected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stridetwin.streams.algebra.arrays import exp
from stridetwin.streams.even_steps import average_between, integrate
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.rate_corrections import Correction, list_corrections, shift_rates
from stridetwin.streams.samples import Array, Stamps

_STEP_S, _PIECE_STEPS = 0.02, 12
"""Length of a step over which rates and forces are averaged, s, and steps of a piece, which are summed up at once."""
_SMOOTH_PIECES = 4
"""Pieces over which the speed is averaged, 1 s: about a stride, in which a foot's own speed averages out."""
_SPAN_S, _SPANS = (3.0, 12.0), (4, 6, 16)
"""Shortest and longest span, s; and how many of them a judgement needs, how many a short recording is cut into if that
is possible, and most that are looked at, spread over the recording."""
_FEWEST_SHOW = 3
"""Spans that must show a mistake."""
_LONGEST_GAP_S = 0.1
"""Longest step between samples across which rates are integrated, s."""
_USUAL_MPS, _POSSIBLE_MPS = 0.7, 1.5
"""Deviation of a wearer's speed from a straight line in a span, root mean square, m/s: what is usual, and what is
possible. It is 0.7 of a walker who turns back, and 1.3 of one who walks in circles at 1.3 m/s: that looks like a tilted
sensor that does not turn, but only if the rates are made smaller."""
_EXPLAINED = 0.5
"""A correction explains a span if it leaves less than this share of the deviation."""
_MOST_UNEXPLAINED, _MOST_CONTRADICTED = 0.25, 0.25
"""Share of the impossible spans that a correction may leave unexplained, and spans that it may make impossible, as a
share of those that it explains."""
_SCALE_SHARE = 0.03
"""Share of gravity by which an uncalibrated accelerometer is off."""
_BIAS_SD_RADPS, _SPEED_SD_MPS = 0.05, 0.5
"""Usual bias of an uncalibrated gyroscope (3 °/s), and usual deviation of the speed, for the estimate of a bias."""
_BIAS_STEP_RADPS, _BIAS_ROUNDS = 1e-3, 2
"""Bias by which the deviation is differentiated, and rounds of its least squares."""
_REFINED = 6
"""Corrections for which a bias is estimated: those that leave the least without one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Spans:
    """K spans of a recording, each of P pieces of even steps of 20 ms.

    Attributes:
        rates: (steps of a piece, P, K, 3) rad/s, mean of each step.
        forces: (steps of a piece, P, K, 3) m/s², likewise.
    """

    rates: Array
    forces: Array


@dataclass(frozen=True, kw_only=True)
class MotionFault:
    """Rates that leave an impossible speed over.

    Attributes:
        speed_mps: Deviation of the speed in the spans that show the mistake, root mean square, m/s.
        corrected_mps: The same after the correction.
        spans: Number of these spans.
        cause: The likely mistake.
    """

    speed_mps: float
    corrected_mps: float
    spans: int
    cause: str


def find_motion_fault(t_ns: Stamps, specific_force: Array, angular_rate: Array) -> MotionFault | None:
    """Compares rates and forces of a sensor in motion.

    Args:
        t_ns: (N,) increasing stamps.
        specific_force: (N, 3) m/s².
        angular_rate: (N, 3) rad/s.

    Returns:
        The mistake; None if the speed is possible, or if no usual mistake explains it in several spans.
    """
    t = (t_ns - t_ns[0]) * 1e-9
    spans = cut_spans(t, specific_force, angular_rate)
    if spans is None:
        return None
    recorded = measure_speeds(spans, np.eye(3)[None])[0]
    if np.sum(recorded > _USUAL_MPS) < _FEWEST_SHOW:
        return None
    recorded = _measure_without_bias(spans, np.eye(3))
    if np.sum(recorded > _USUAL_MPS) < _FEWEST_SHOW:
        return None
    least, result = np.inf, None
    for correction, corrected in _correct(t, specific_force, angular_rate, spans):
        makes_smaller = float(np.linalg.det(correction.matrix)) ** 2 < 1 - 1e-6
        most = _POSSIBLE_MPS if makes_smaller else _USUAL_MPS
        fault, left_over = _explain(recorded, corrected, most, correction.cause), _root_mean_square(corrected)
        if fault is not None and left_over < least:
            least, result = left_over, fault
    return result


def _explain(recorded: Array, corrected: Array, most_mps: float, cause: str) -> MotionFault | None:
    """The mistake, if its correction explains most spans whose speed is too large, and makes few others too large.

    Args:
        recorded: (K,) deviation of the speed in each span as recorded, m/s.
        corrected: (K,) the same after the correction, m/s.
        most_mps: From where on a deviation is too large.
        cause: The mistake.
    """
    is_too_large = recorded > most_mps
    is_explained = is_too_large & (corrected < _EXPLAINED * recorded)
    is_contradicted = (corrected > most_mps) & (recorded < _EXPLAINED * corrected)
    count = int(is_explained.sum())
    if count < _FEWEST_SHOW or count < (1 - _MOST_UNEXPLAINED) * is_too_large.sum():
        return None
    if is_contradicted.sum() > _MOST_CONTRADICTED * count:
        return None
    before, after = _root_mean_square(recorded[is_explained]), _root_mean_square(corrected[is_explained])
    return MotionFault(speed_mps=before, corrected_mps=after, spans=count, cause=cause)


def measure_gravity(t_ns: Stamps, specific_force: Array, angular_rate: Array) -> float | None:
    """Gravity by the forces of a sensor in motion, m/s²: their mean, turned by the rates into the axes at the start.

    Accelerations average out, so that a wrong unit or factor of the forces shows without a rest.

    Args:
        t_ns: (N,) increasing stamps.
        specific_force: (N, 3) m/s².
        angular_rate: (N, 3) rad/s.

    Returns:
        The median over spans; far less than the forces' magnitude if the rates turn them in all directions. None if
        the recording is too short, or if the speed that is left over is impossible, so that the rates are in doubt.
    """
    spans = cut_spans((t_ns - t_ns[0]) * 1e-9, specific_force, angular_rate)
    if spans is None:
        return None
    deviations, slopes, _ = fit_lines(sum_forces(spans, np.eye(3)[None], np.zeros((1, 3))))
    speeds = np.sqrt((deviations**2).sum(axis=-1).mean(axis=-1))
    if np.median(speeds) > _POSSIBLE_MPS:
        return None
    return float(np.median(np.linalg.norm(slopes, axis=-1)))


def mean_force(t_ns: Stamps, specific_force: Array) -> float:
    """Magnitude of the mean force over 1 s, m/s², the median over the recording: about gravity minus what turns away.

    Args:
        t_ns: (N,) increasing stamps.
        specific_force: (N, 3) m/s².
    """
    t = (t_ns - t_ns[0]) * 1e-9
    count = max(1, int(t[-1]))
    windows = np.minimum(t.astype(np.int64), count - 1)
    sums = np.stack([np.bincount(windows, specific_force[:, axis], count) for axis in range(3)], axis=1)
    sizes = np.bincount(windows, minlength=count)
    return float(np.median(np.linalg.norm(sums[sizes > 0] / sizes[sizes > 0, None], axis=1)))


def _root_mean_square(values: Array) -> float:
    """Root mean square of (N,) values."""
    return float(np.sqrt(np.mean(values**2)))


def _correct(t: Array, force: Array, rate: Array, spans: Spans) -> list[tuple[Correction, Array]]:
    """The corrections that leave the least, and the deviations of the speed (K,) in each span after each, m/s.

    Args:
        t: (N,) s.
        force: (N, 3) m/s².
        rate: (N, 3) rad/s.
        spans: Those of the recording.
    """
    corrections = list_corrections()
    turned = [c for c in corrections if not c.shift_s]
    speeds = measure_speeds(spans, np.stack([c.matrix for c in turned]))
    results = [(_root_mean_square(s), c, spans) for c, s in zip(turned, speeds)]
    for correction in (c for c in corrections if c.shift_s):
        moved = cut_spans(t, force, shift_rates(t, rate, correction.shift_s))
        if moved is not None:  # always, as the stamps are the same
            speed = _root_mean_square(measure_speeds(moved, correction.matrix[None])[0])
            results.append((speed, correction, moved))
    results.sort(key=lambda result: result[0])  # those that leave the least come first
    return [(c, _measure_without_bias(cut, c.matrix)) for _, c, cut in results[:_REFINED]]


def cut_spans(t: Array, force: Array, rate: Array) -> Spans | None:
    """Cuts spans without a gap out of forces and rates (N, 3) at times (N,) s; None if they are too few to judge."""
    piece_s = _PIECE_STEPS * _STEP_S
    pieces = int((t[-1] - t[0]) / _STEP_S) // _PIECE_STEPS
    if pieces * piece_s < _SPANS[0] * _SPAN_S[0]:
        return None
    length = int(np.clip(pieces * piece_s / _SPANS[1], *_SPAN_S) / piece_s)  # pieces of a span
    starts = _place_spans(t, pieces, length)
    if len(starts) < _SPANS[0]:
        return None
    starts = [starts[k] for k in np.unique(np.linspace(0, len(starts) - 1, _SPANS[2]).round().astype(int))]
    integrals = [integrate(t, values) for values in (rate, force)]
    cut = []
    for start in starts:
        edges = t[0] + _STEP_S * np.arange(start * _PIECE_STEPS, (start + length) * _PIECE_STEPS + 1)
        cut.append([average_between(t, of_values, edges) for of_values in integrals])  # (2, steps, 3)
    rates, forces = np.reshape(cut, (len(starts), 2, length, _PIECE_STEPS, 3)).transpose(1, 3, 2, 0, 4)
    return Spans(rates=rates, forces=forces)


def _place_spans(t: Array, pieces: int, length: int) -> list[int]:
    """First pieces of spans of `length` pieces, one after the other, that leave out the pieces with a gap.

    Args:
        t: (N,) s.
        pieces: Pieces of the recording.
        length: Pieces of a span.
    """
    piece_s = _PIECE_STEPS * _STEP_S
    gaps = np.flatnonzero(np.diff(t) > _LONGEST_GAP_S)
    # the pieces between two gaps: after that of the row behind one, before that of the row ahead of the next
    firsts = [0, *(int((t[row + 1] - t[0]) / piece_s) + 1 for row in gaps)]
    ends = [*(int((t[row] - t[0]) / piece_s) for row in gaps), pieces]
    return [start for first, end in zip(firsts, ends, strict=True) for start in range(first, end - length + 1, length)]


def measure_speeds(spans: Spans, matrices: Array, biases: Array | None = None) -> Array:
    """Root mean square (H, K), m/s, by which the speed in each span deviates from a straight line.

    Args:
        spans: K spans.
        matrices: (H, 3, 3), each multiplies the rates.
        biases: (H, 3) rad/s, subtracted from the product; None: 0.
    """
    biases = np.zeros((len(matrices), 3)) if biases is None else biases
    deviations, slopes, spread = fit_lines(sum_forces(spans, matrices, biases))
    excess = np.abs(np.linalg.norm(slopes, axis=-1) - NOMINAL_GRAVITY_MPS2)  # of the sum over gravity, m/s²
    excess = np.maximum(excess - _SCALE_SHARE * NOMINAL_GRAVITY_MPS2, 0.0)
    return np.asarray(np.sqrt((deviations**2).sum(axis=-1).mean(axis=-1) + spread * excess**2))


def fit_lines(speeds: Array) -> tuple[Array, Array, float]:
    """Fits a straight line to sums of forces (..., M, 3), m/s, in even steps of a piece.

    Returns:
        Deviations (..., M, 3) m/s from the lines, their slopes (..., 3) m/s², and the variance of the times, s².
    """
    t = _PIECE_STEPS * _STEP_S * np.arange(speeds.shape[-2])
    t = t - t.mean()
    centred = speeds - speeds.mean(axis=-2, keepdims=True)
    slopes = np.einsum("m,...mi->...i", t, centred) / (t @ t)
    return centred - t[:, None] * slopes[..., None, :], slopes, float(t @ t) / len(t)


def sum_forces(spans: Spans, matrices: Array, biases: Array) -> Array:
    """Sums of the forces in the axes at the start of each span, averaged over 1 s: (H, K, M, 3) m/s.

    Args:
        spans: K spans.
        matrices: (H, 3, 3), each multiplies the rates.
        biases: (H, 3) rad/s, subtracted from the product.
    """
    _, pieces, count, _ = spans.rates.shape
    shape = (len(matrices), pieces, count, 3)
    turn = np.broadcast_to(np.eye(3), (*shape, 3))  # sensor to its axes at the start of the piece
    speed, way = np.zeros(shape), np.zeros(shape)  # sums of the forces, and of these, in each piece
    for rate, force in zip(spans.rates, spans.forces):
        half = exp(0.5 * _STEP_S * (np.einsum("hij,pkj->hpki", matrices, rate) - biases[:, None, None]))
        turn = turn @ half
        gain = _STEP_S * (turn @ force[..., None])[..., 0]
        way = way + _STEP_S * (speed + 0.5 * gain)
        speed = speed + gain
        turn = turn @ half
    whole_turn = np.broadcast_to(np.eye(3), (len(matrices), count, 3, 3))  # piece to the axes of the span
    whole_speed, whole_way = np.zeros((2, len(matrices), count, 3))
    ways = [whole_way]
    for piece in range(pieces):
        whole_way = whole_way + _PIECE_STEPS * _STEP_S * whole_speed + (whole_turn @ way[:, piece, ..., None])[..., 0]
        whole_speed = whole_speed + (whole_turn @ speed[:, piece, ..., None])[..., 0]
        whole_turn = whole_turn @ turn[:, piece]
        ways.append(whole_way)
    all_ways = np.stack(ways, axis=2)  # (H, K, P + 1, 3)
    means = all_ways[:, :, _SMOOTH_PIECES:] - all_ways[:, :, :-_SMOOTH_PIECES]
    return np.asarray(means / (_SMOOTH_PIECES * _PIECE_STEPS * _STEP_S))


def _measure_without_bias(spans: Spans, matrix: Array) -> Array:
    """Deviations of the speed (K,) in each span, m/s, with the bias that leaves the least.

    The bias is estimated by least squares with a usual bias as the prior; a span counts the less the more its speed
    deviates.

    Args:
        spans: K spans.
        matrix: (3, 3), multiplies the rates.

    Returns:
        The deviations; those without a bias if none leaves less.
    """
    bias, best = np.zeros(3), measure_speeds(spans, matrix[None])[0]
    for _ in range(_BIAS_ROUNDS):
        biases = bias + np.concatenate([np.zeros((1, 3)), _BIAS_STEP_RADPS * np.eye(3)])
        deviations, _, _ = fit_lines(sum_forces(spans, np.repeat(matrix[None], 4, axis=0), biases))
        base, changes = deviations[0], (deviations[1:] - deviations[0]) / _BIAS_STEP_RADPS
        # (K,); a span counts once, however many sums it has, as these depend on one another
        weights = 1.0 / (_SPEED_SD_MPS**2 + (base**2).sum(axis=-1).mean(axis=-1)) / base.shape[1]
        normal = np.einsum("k,akmi,bkmi->ab", weights, changes, changes) + np.eye(3) / _BIAS_SD_RADPS**2
        gradient = np.einsum("k,akmi,kmi->a", weights, changes, base) + bias / _BIAS_SD_RADPS**2
        bias = bias - np.linalg.solve(normal, gradient)
        speeds = measure_speeds(spans, matrix[None], bias[None])[0]
        if np.mean(speeds**2) < np.mean(best**2):
            best = speeds
    return best
