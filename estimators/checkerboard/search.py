"""Candidate views of a board in an image; the fit of its corners accepts or rejects them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.checkerboard.pattern import BoardPattern, Lens, View
from stridetwin.streams.errors import check_numbers
from stridetwin.streams.samples import Array


@dataclass(frozen=True, kw_only=True)
class SearchParameters:
    """The search for candidate views; hand-chosen."""

    samples_per_square: int = 3
    """Samples along a square."""
    squares_max: int = 6
    """Largest error of a guess, squares."""
    correlation_min: float = 0.35
    """Least correlation of image and pattern."""
    candidates: int = 3
    """Largest number of views tried per correlation."""
    rival_share: float = 0.7
    """Candidates below this share of the best correlation are dropped."""
    saddle_scale_px: float = 1.0
    """Blur before saddle points are searched, pixels."""
    saddles: int = 160
    """Number of strongest saddle points used."""
    opposed_cosine: float = -0.6
    """Of the doubled angle between the saddles of neighbouring corners: -1 when sharp."""
    neighbours: int = 8
    """Nearest saddles from which the edges of a grid are chosen."""
    edge_sine_min: float = 0.4
    """Of the angle between a grid's edges."""
    miss_max: float = 0.3
    """Largest error of a point in a grid, as a share of the shorter edge."""
    cross_min: int = 6
    """Least number of grid points among the nine around a corner, itself included."""
    grid_min: int = 14
    """Least number of points of a grid."""
    grids: int = 4
    """Largest number of grids tried in one image."""

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number > 0; a cosine may be less."""
        check_numbers("SearchParameters", asdict(self) | {"opposed_cosine": 1.0 + self.opposed_cosine})


_QUARTERS = [np.array([[c, s], [-s, c]], dtype=float) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
"""Rotations by 90°: which of a grid's edges is the board's u."""


def guessed(pattern: BoardPattern, lens: Lens, corners_px: Array) -> View | None:
    """The view from predicted pixels (M, 2) of all corners; None if there is none."""
    if not np.isfinite(corners_px).all():
        return None
    return View.through(lens, pattern.corners, lens.rays(corners_px))


def around(
    grey: NDArray[np.uint8], pattern: BoardPattern, guess: View, reach_px: float, p: SearchParameters
) -> list[View]:
    """Views within `reach_px` of a guess in which the image correlates with the board, the best first."""
    size = np.linalg.norm(guess.edges(np.zeros((1, 2)))[0], axis=1)
    if not (size > 0).all():
        return []
    reach = np.minimum(np.ceil(reach_px / size), p.squares_max).astype(int)
    return [view for _, view in _correlated(grey, pattern, guess, reach[0], reach[1], p)]


def anywhere(grey: NDArray[np.uint8], pattern: BoardPattern, lens: Lens, p: SearchParameters) -> list[View]:
    """Views of the first grid of saddle points that correlates with the board, the best first."""
    columns, rows = pattern.shape
    some_corner = pattern.corners[(rows // 2) * columns + columns // 2]  # in the middle of the board
    for steps, places in _grids(grey, p):
        rays, found = lens.rays(places), []
        for quarter in _QUARTERS:
            guess = View.through(lens, some_corner + steps @ quarter, rays)
            if guess is not None:
                found += _correlated(grey, pattern, guess, rows, rows, p)
        if found:
            found.sort(key=lambda candidate: -candidate[0])
            return [view for _, view in found[: p.candidates]]
    return []


def _correlated(
    grey: NDArray[np.uint8], pattern: BoardPattern, guess: View, reach_u: int, reach_v: int, p: SearchParameters
) -> list[tuple[float, View]]:  # fmt: skip
    """Best correlations of image and pattern, with their views, shifted by up to some squares.

    The image is rectified by the guess, so that the board is upright and of known size in it, and compared with
    the pattern at every shift (normalised cross-correlation): 1000 shifts in a fraction of a millisecond.
    """
    columns, rows = pattern.bright.shape[1] + 2 * reach_u, pattern.bright.shape[0] + 2 * reach_v
    u = (np.arange(columns * p.samples_per_square) + 0.5) / p.samples_per_square - columns / 2
    v = (np.arange(rows * p.samples_per_square) + 0.5) / p.samples_per_square - rows / 2
    squares = np.column_stack([np.tile(u, len(v)), np.repeat(v, len(u))])
    at = np.nan_to_num(guess.pixels(squares), nan=-1e4).astype(np.float32).reshape(len(v), len(u), 2)
    seen = cv2.remap(grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=128)
    drawn = np.kron(pattern.bright, np.ones((p.samples_per_square, p.samples_per_square))).astype(np.float32)
    expected = cv2.blur(drawn, (3, 3), borderType=cv2.BORDER_REPLICATE)
    correlation = cv2.matchTemplate(seen.astype(np.float32), expected, cv2.TM_CCOEFF_NORMED)
    found: list[tuple[float, View]] = []
    for _ in range(p.candidates):
        _, best, _, (column, row) = cv2.minMaxLoc(correlation)
        if not best > (max(p.correlation_min, p.rival_share * found[0][0]) if found else p.correlation_min):
            break
        found.append(
            (best, guess.shifted(column / p.samples_per_square - reach_u, row / p.samples_per_square - reach_v))
        )
        half = p.samples_per_square // 2
        correlation[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1] = -1.0
    return found


def _grids(grey: NDArray[np.uint8], p: SearchParameters) -> Iterator[tuple[Array, Array]]:
    """Grids of saddle points: (N, 2) whole steps along both edges from one of them, and (N, 2) pixels of each."""
    places, directions = _saddle_points(grey, p)
    apart = places[None] - places[:, None]  # [i, j] from i to j
    distance = np.linalg.norm(apart, axis=2)
    # Neighbours on a board are rotated against each other.
    distance[directions @ directions.T > p.opposed_cosine] = np.inf
    tried = 0
    for i, order in enumerate(np.argsort(distance, axis=1)[:, : p.neighbours]):
        near = apart[i, order[np.isfinite(distance[i, order])]]
        if len(near) < 2:
            continue
        across = near[0, 0] * near[:, 1] - near[0, 1] * near[:, 0]
        length = np.linalg.norm(near, axis=1)
        beside = np.flatnonzero(np.abs(across) > p.edge_sine_min * length[0] * length)
        if not len(beside):
            continue
        # the board faces the camera: v is rotated against u as y against x
        second = near[beside[0]] * -np.sign(across[beside[0]])
        edges = np.array([near[0], second])
        grid = _grown(places, places[i], edges, p)
        if len(grid[0]) >= p.grid_min:
            yield grid
            tried += 1
            if tried == p.grids:
                return


def _grown(places: Array, origin: Array, edges: Array, p: SearchParameters) -> tuple[Array, Array]:
    """The grid (`_grids`) grown from one point (2,) with edges (2, 2), as far as there are points for it."""
    steps, found = np.zeros((0, 2)), np.zeros((0, 2))
    for reach in (1, 2, 4, 8):
        j, i = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        lattice = np.column_stack([i.ravel(), j.ravel()]).astype(float)
        expected = origin + lattice @ edges
        miss = np.linalg.norm(places[None] - expected[:, None], axis=2)
        nearest = miss.argmin(axis=1)
        hit = miss[np.arange(len(lattice)), nearest] < p.miss_max * np.linalg.norm(edges, axis=1).min()
        if hit.sum() < p.cross_min:
            break
        steps, found = lattice[hit], places[nearest[hit]]
        affine, *_ = np.linalg.lstsq(np.column_stack([np.ones(len(steps)), steps]), found, rcond=None)
        origin, edges = affine[0], affine[1:]
    return steps, found


def _saddle_points(grey: NDArray[np.uint8], p: SearchParameters) -> tuple[Array, Array]:
    """(N, 2) strongest saddle points of the brightness, pixels, and (N, 2) unit vectors at twice their angle."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), p.saddle_scale_px)
    xx, yy = cv2.Sobel(smooth, cv2.CV_32F, 2, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 2)
    xy = cv2.Sobel(smooth, cv2.CV_32F, 1, 1)
    saddle = xy * xy - xx * yy
    peak = (saddle >= cv2.dilate(saddle, np.ones((5, 5)))) & (saddle > 1.0)
    rows, columns = np.nonzero(peak)
    strongest = np.argsort(-saddle[rows, columns], kind="stable")[: p.saddles]
    rows, columns = rows[strongest], columns[strongest]
    direction = np.column_stack([xx[rows, columns] - yy[rows, columns], 2 * xy[rows, columns]]).astype(float)
    return np.column_stack([columns, rows]).astype(float), direction / np.linalg.norm(direction, axis=1, keepdims=True)
