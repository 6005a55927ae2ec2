"""Where two clocks may belong together: shifts at which the rotation seen by a camera resembles that of a gyro.

The whole range in which the two streams can overlap is searched by correlation, with fast Fourier transforms. The
magnitude of the rotation rate needs no mount; the three axes are compared as well, because they tell a left step from a
right one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.samples import Array
from stridetwin.streams.time_series import accumulate, interpolate

_CELL_S = 0.01
"""Step between the shifts, s: a third of the period of images at 30 Hz, whose rates change more slowly."""
_MOST_PEAKS = 6
"""Most shifts that each of the two correlations names."""
_APART_S = 0.2
"""Least distance of two of these shifts, s: less than half a step of a walk."""
_LEAST_SHARE = 0.6
"""Share of the pairs of images that the gyro has to cover at a shift."""
_LONGEST_SPAN_S = 6 * 3600.0
"""Longest range that is searched, s, which bounds time and memory."""


def find_shifts(spans: NDArray[np.int64], visual: Array, t_ns: NDArray[np.int64], rate: Array) -> Array:
    """Shifts t_imu - t_cam, s, at which the two rotation rates correlate most, of all at which the streams overlap.

    Args:
        spans: (N, 2) start and end of each pair of images by the camera's clock, ns.
        visual: (N, 3) rates from the images in the camera's optical axes, rad/s.
        t_ns: (M,) stamps of the gyro, ns.
        rate: (M, 3) rates of the gyro in the camera's nominal axes, rad/s.

    Returns:
        (K,) shifts, s, each to within `_CELL_S`; empty if the streams are too long or the gyro too short.
    """
    middle = (spans[:, 0] + spans[:, 1]) // 2
    start_ns = int(middle.min())
    cells = np.rint((middle - start_ns) * 1e-9 / _CELL_S).astype(int)  # (N,) cell of each pair, from 0
    duration_s = (int(t_ns[-1]) - int(t_ns[0])) * 1e-9
    if cells.max() * _CELL_S + duration_s > _LONGEST_SPAN_S or duration_s < 2 * _CELL_S:
        return np.zeros(0)
    gyro = _resample(t_ns, rate, float(np.median(spans[:, 1] - spans[:, 0])) * 1e-9)
    offset_s = (int(t_ns[0]) - start_ns) * 1e-9  # of the gyro's first cell from the camera's first one
    size = 1 << int(np.ceil(np.log2(len(gyro) + cells.max() + 1)))
    magnitudes = np.linalg.norm(visual, axis=1)[:, None], np.linalg.norm(gyro, axis=1)[:, None]
    shifts = list[float]()
    for seen, measured in (magnitudes, (visual, gyro)):
        correlation, lags = _correlate(cells, seen, measured, size)
        for shift in offset_s + lags[_find_peaks(correlation)] * _CELL_S:
            if all(abs(shift - other) > _APART_S / 2 for other in shifts):
                shifts.append(float(shift))
    return np.array(shifts)


def _resample(t_ns: NDArray[np.int64], rate: Array, duration_s: float) -> Array:
    """(G, 3) mean rates of the gyro over windows of `duration_s` around cells that begin at its first stamp, rad/s."""
    t = (t_ns - t_ns[0]) * 1e-9
    angle = accumulate(np.diff(t), rate[1:])  # (M, 3) rad
    at = np.arange(int(t[-1] / _CELL_S) + 1) * _CELL_S
    ends = [np.clip(at + side * duration_s / 2, 0.0, t[-1]) for side in (-1, 1)]
    change = interpolate(ends[1], t, angle) - interpolate(ends[0], t, angle)
    return np.asarray(change / (ends[1] - ends[0])[:, None])


def _correlate(cells: NDArray[np.int_], seen: Array, measured: Array, size: int) -> tuple[Array, NDArray[np.int_]]:
    """Pearson's correlation of rates at N cells with those of G cells, at every lag between them.

    Args:
        cells: (N,) cells of the camera's rates.
        seen: (N, D) these rates.
        measured: (G, D) rates of the gyro at all its cells.
        size: Length of the transforms, a power of two from the sum of both lengths on.

    Returns:
        (L,) correlations, -1 where the gyro covers too few of the N or one of both hardly varies; and (L,) lags,
        in increasing order: at lag l, cell n of the camera is compared with cell n + l of the gyro.
    """
    dimensions = seen.shape[1]
    count, sums = np.zeros(size), np.zeros((size, dimensions))
    np.add.at(count, cells, 1.0)
    np.add.at(sums, cells, seen)
    covered = np.zeros(size)
    covered[: len(measured)] = 1.0

    def slide(fixed: Array, moving: Array) -> Array:
        """Sum over the cells of `fixed` times `moving` at each lag of the latter."""
        return np.asarray(np.fft.irfft(np.conj(np.fft.rfft(fixed)) * np.fft.rfft(moving, size), size))

    n = np.maximum(slide(count, covered), 1e-9)
    product, seen_squared, measured_squared = np.zeros(size), np.zeros(size), np.zeros(size)
    for k in range(dimensions):
        squares = np.zeros(size)
        np.add.at(squares, cells, seen[:, k] ** 2)
        x, y = slide(sums[:, k], covered), slide(count, measured[:, k])
        product += slide(sums[:, k], measured[:, k]) - x * y / n
        seen_squared += slide(squares, covered) - x * x / n
        measured_squared += slide(count, measured[:, k] ** 2) - y * y / n
    least = 1e-6 * max(float(seen_squared.max()), 1e-30), 1e-6 * max(float(measured_squared.max()), 1e-30)
    is_defined = (n > _LEAST_SHARE * len(cells)) & (seen_squared > least[0]) & (measured_squared > least[1])
    scale = np.sqrt(np.where(is_defined, seen_squared * measured_squared, 1.0))
    correlation = np.where(is_defined, product / scale, -1.0)
    # lags beyond the gyro's length stand for negative ones
    lags = np.where(np.arange(size) < len(measured), np.arange(size), np.arange(size) - size)
    order = np.argsort(lags)
    return correlation[order], lags[order]


def _find_peaks(correlation: Array) -> NDArray[np.int_]:
    """Numbers of up to `_MOST_PEAKS` highest correlations that are maxima, `_APART_S` from one another."""
    apart = round(_APART_S / _CELL_S)
    remaining, peaks = correlation.copy(), list[int]()
    for _ in range(_MOST_PEAKS):
        at = int(np.argmax(remaining))
        if remaining[at] <= 0:
            break
        peaks.append(at)
        remaining[max(at - apart, 0) : at + apart + 1] = -1.0
    return np.array(peaks, int)
