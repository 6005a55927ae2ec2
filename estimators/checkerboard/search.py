"""Candidate views of a board in an image; the fit of its corners accepts or rejects them."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.checkerboard.pattern import BoardPattern, DistortionModel, View
from stridetwin.streams.samples import Array

# The search for candidate views; hand-chosen.
_SAMPLES_PER_SQUARE = 3  # along an edge
_MAX_SQUARES = 6  # largest error of a guess, squares along either edge
_MIN_CORRELATION = 0.35  # of image and pattern
_CANDIDATES = 3  # largest number of views tried per correlation
_RIVAL_SHARE = 0.7  # candidates below this share of the best correlation are dropped
_SADDLE_SCALE_PX = 1.0  # blur before saddle points are searched
_SADDLES = 160  # number of strongest saddle points used
_OPPOSED_COSINE = -0.6  # of the doubled angle between the saddles of neighbouring corners: -1 when sharp
_NEIGHBOURS = 8  # nearest saddles from which the edges of a grid are chosen
_MIN_EDGE_SINE = 0.4  # of the angle between a grid's edges
_MAX_MISS = 0.3  # error of a point in a grid, as a share of the shorter edge
_MIN_CROSS = 6  # least number of points of a grid while it grows; in the first round of the nine around its origin
_MIN_GRID = 14  # points of a grid
_GRIDS = 4  # largest number of grids tried in one image

_QUARTERS = [np.array([[c, s], [-s, c]], dtype=float) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
"""Rotations by 90°: which of a grid's edges is the board's u."""


def view_from_guess(pattern: BoardPattern, lens: DistortionModel, corners_px: Array) -> View | None:
    """The view with predicted pixels (M, 2) of all corners; None if some are NaN or no view fits."""
    if not np.isfinite(corners_px).all():
        return None
    return View.from_points(lens, pattern.corners, lens.rays(corners_px))


def find_near(grey: NDArray[np.uint8], pattern: BoardPattern, guess: View, reach_px: float) -> list[View]:
    """Views within `reach_px` of a guess in which the image correlates with the board, the best first.

    They are the guess, shifted along the board's axes in steps of a square over `_SAMPLES_PER_SQUARE`, by at most
    `_MAX_SQUARES` squares. Empty if nothing correlates, or if the guess has no size in the image.
    """
    size_px = np.linalg.norm(guess.edges(np.zeros((1, 2)))[0], axis=1)  # (2,) edges of a square along u and v
    if not (size_px > 0).all():  # 0 or NaN
        return []
    reach_u, reach_v = np.minimum(np.ceil(reach_px / size_px), _MAX_SQUARES).astype(int)  # squares
    return [view for _, view in _correlate_shifts(grey, pattern, guess, reach_u, reach_v)]


def find_anywhere(grey: NDArray[np.uint8], pattern: BoardPattern, lens: DistortionModel) -> list[View]:
    """Views of the first grid of saddle points that correlates with the board, the best first; empty without one.

    A grid shows neither which of its points is which corner nor how it is rotated. So one of its points is taken as a
    corner in the middle of the board, in each of the four rotations, and the correlation finds the shift.
    """
    columns, rows = pattern.shape
    some_corner = pattern.corners[(rows // 2) * columns + columns // 2]  # in the middle of the board
    for steps, places in _find_grids(grey):
        rays = lens.rays(places)
        candidates: list[tuple[float, View]] = []  # correlation and view
        for quarter in _QUARTERS:
            guess = View.from_points(lens, some_corner + steps @ quarter, rays)
            if guess is not None:
                # along either edge: a grid found beside the middle is shifted by up to `rows` squares
                candidates += _correlate_shifts(grey, pattern, guess, rows, rows)
        if candidates:
            candidates.sort(key=lambda candidate: -candidate[0])
            return [view for _, view in candidates[:_CANDIDATES]]
    return []


def _correlate_shifts(
    grey: NDArray[np.uint8], pattern: BoardPattern, guess: View, reach_u: int, reach_v: int
) -> list[tuple[float, View]]:
    """Compares image and pattern at all shifts of a guess by up to some squares; returns the shifts that fit best.

    The image is rectified by the guess, so that the board is upright and of known size in it, and compared with the
    pattern at every shift (normalised cross-correlation): 1000 shifts in a fraction of a millisecond.

    Args:
        grey: (H, W) image.
        pattern: The board.
        guess: View of the board but for a shift.
        reach_u: Largest shift along u, squares.
        reach_v: Largest shift along v, squares.

    Returns:
        At most `_CANDIDATES` pairs of a correlation, -1 to 1, and the shifted view, the best first.
    """
    # columns x rows squares around the guess's centre are sampled: the board with the largest shifts on each side
    columns, rows = pattern.bright.shape[1] + 2 * reach_u, pattern.bright.shape[0] + 2 * reach_v
    u = (np.arange(columns * _SAMPLES_PER_SQUARE) + 0.5) / _SAMPLES_PER_SQUARE - columns / 2
    v = (np.arange(rows * _SAMPLES_PER_SQUARE) + 0.5) / _SAMPLES_PER_SQUARE - rows / 2
    squares = np.column_stack([np.tile(u, len(v)), np.repeat(v, len(u))])
    # (., ., 2) pixel that each sample is read from; far outside the image where the guess has none
    map_px = np.nan_to_num(guess.pixels(squares), nan=-1e4).astype(np.float32).reshape(len(v), len(u), 2)
    rectified = cv2.remap(
        grey, map_px[..., 0], map_px[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=128
    )
    # the board's colours at the same resolution, averaged over 3 x 3 samples
    squares_image = np.kron(pattern.bright, np.ones((_SAMPLES_PER_SQUARE, _SAMPLES_PER_SQUARE))).astype(np.float32)
    expected = cv2.blur(squares_image, (3, 3), borderType=cv2.BORDER_REPLICATE)
    # at (row, column): with the first sample of the board there in the rectified image
    correlation = cv2.matchTemplate(rectified.astype(np.float32), expected, cv2.TM_CCOEFF_NORMED)
    candidates: list[tuple[float, View]] = []
    for _ in range(_CANDIDATES):
        _, best, _, (column, row) = cv2.minMaxLoc(correlation)
        least = max(_MIN_CORRELATION, _RIVAL_SHARE * candidates[0][0]) if candidates else _MIN_CORRELATION
        if not best > least:  # also where it is NaN
            break
        shift_u, shift_v = column / _SAMPLES_PER_SQUARE - reach_u, row / _SAMPLES_PER_SQUARE - reach_v  # squares
        candidates.append((best, guess.shift(shift_u, shift_v)))
        # neighbouring shifts are no other candidates
        half = _SAMPLES_PER_SQUARE // 2
        correlation[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1] = -1.0
    return candidates


def _find_grids(grey: NDArray[np.uint8]) -> Iterator[tuple[Array, Array]]:
    """Finds regular grids of saddle points, of at least `_MIN_GRID` points; `_GRIDS` at most.

    From the strongest saddle point on, two edges of a grid are chosen among its neighbours, and the grid grows along
    them.

    Yields:
        (N, 2) whole steps along both edges from the first point, and (N, 2) pixels of each point.
    """
    places, directions = _find_saddle_points(grey)
    apart = places[None] - places[:, None]  # (N, N, 2) px, [i, j] from i to j
    distance = np.linalg.norm(apart, axis=2)
    # Neighbours on a board are rotated against each other; other pairs are no neighbours, at an infinite distance.
    distance[directions @ directions.T > _OPPOSED_COSINE] = np.inf
    tried = 0  # number of grids yielded
    for i, order in enumerate(np.argsort(distance, axis=1)[:, :_NEIGHBOURS]):
        near = apart[i, order[np.isfinite(distance[i, order])]]  # (K, 2) px, to the neighbours, the nearest first
        if len(near) < 2:
            continue
        # The nearest neighbour gives the first edge; the second is the nearest one at a large enough angle to it.
        across = near[0, 0] * near[:, 1] - near[0, 1] * near[:, 0]  # (K,) cross product of the first edge with each
        length = np.linalg.norm(near, axis=1)
        beside = np.flatnonzero(np.abs(across) > _MIN_EDGE_SINE * length[0] * length)
        if not len(beside):
            continue
        # the board faces the camera: v is rotated against u as y against x
        second = near[beside[0]] * -np.sign(across[beside[0]])
        edges = np.array([near[0], second])
        steps, points = _grow_grid(places, places[i], edges)
        if len(steps) >= _MIN_GRID:
            yield steps, points
            tried += 1
            if tried == _GRIDS:
                return


def _grow_grid(places: Array, origin: Array, edges: Array) -> tuple[Array, Array]:
    """Grows a regular grid from one saddle point along two edges, as far as there are saddle points for it.

    The grid grows in rounds, to more steps on each side; after each its origin and edges are fitted to its points.
    It has no points at all if fewer than `_MIN_CROSS` are hit in the first round.

    Args:
        places: (N, 2) pixels of all saddle points.
        origin: (2,) pixels of the first point.
        edges: (2, 2) one step along each edge, pixels.

    Returns:
        (K, 2) whole steps along both edges; (K, 2) pixels of each point.
    """
    steps, points = np.zeros((0, 2)), np.zeros((0, 2))
    for reach in (1, 2, 4, 8):  # steps to each side
        j, i = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        lattice = np.column_stack([i.ravel(), j.ravel()]).astype(float)
        expected = origin + lattice @ edges
        # px, distance from each expected point (row) to each saddle point (column); the nearest one of each row
        miss = np.linalg.norm(places[None] - expected[:, None], axis=2)
        nearest = miss.argmin(axis=1)
        hit = miss[np.arange(len(lattice)), nearest] < _MAX_MISS * np.linalg.norm(edges, axis=1).min()
        if hit.sum() < _MIN_CROSS:
            break
        steps, points = lattice[hit], places[nearest[hit]]
        # (3, 2) px: origin, and one step along each edge
        affine, *_ = np.linalg.lstsq(np.column_stack([np.ones(len(steps)), steps]), points, rcond=None)
        origin, edges = affine[0], affine[1:]
    return steps, points


def _find_saddle_points(grey: NDArray[np.uint8]) -> tuple[Array, Array]:
    """The strongest saddle points of the brightness, at most `_SADDLES`.

    Returns:
        (N, 2) pixels (x, y), the strongest first; (N, 2) unit vectors at twice the angle of the saddle's axis, which is
        the same for both ends of the axis. Neighbouring corners of a board have opposite ones.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SADDLE_SCALE_PX)
    xx, yy = cv2.Sobel(smooth, cv2.CV_32F, 2, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 2)
    xy = cv2.Sobel(smooth, cv2.CV_32F, 1, 1)
    saddle = xy * xy - xx * yy  # positive where the brightness curves up along one axis and down along the other
    peak = (saddle >= cv2.dilate(saddle, np.ones((5, 5)))) & (saddle > 1.0)
    rows, columns = np.nonzero(peak)
    strongest = np.argsort(-saddle[rows, columns], kind="stable")[:_SADDLES]
    rows, columns = rows[strongest], columns[strongest]
    direction = np.column_stack([xx[rows, columns] - yy[rows, columns], 2 * xy[rows, columns]]).astype(float)
    return np.column_stack([columns, rows]).astype(float), direction / np.linalg.norm(direction, axis=1, keepdims=True)
