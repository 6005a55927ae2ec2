"""Which corner is which: either the whole board is seen, or nothing else can be where it was expected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.foot_ins.board_pattern import BoardPattern, View, sample
from stridetwin.streams.samples import Array

_CLEAR = 0.15  # a cell this share of half a step from the middle is clearly bright or dark
_SPOILT = 3  # cells of a whole board that dirt may spoil: fewer dark ones than any shift would miss


def is_whole(picture: NDArray[np.uint8], pattern: BoardPattern, view: View, corners: Array, levels: Array) -> bool:
    """Whether all squares and the margin around them have their colours: then the board lies no other way.

    Args:
        picture: (H, W) grey.
        pattern: The board.
        view: Where it is thought to be.
        corners: (N, 2) squares, corners that were found.
        levels: (N, 2) middle and half step of the brightness at each; both change slowly over a board.
    """
    plane, *_ = np.linalg.lstsq(_plane(corners), levels, rcond=None)
    middle, step = (_plane(pattern.cells) @ plane).T
    contrast = (sample(picture, view.pixels(pattern.cells)) - middle) / np.maximum(step, 1.0)
    right = contrast * pattern.bright.ravel() > _CLEAR  # false outside the picture
    return int((~right).sum()) <= _SPOILT


def is_alone(pattern: BoardPattern, view: View, which: NDArray[np.intp], near: Array, reach_px: float) -> bool:
    """Whether the corners that were found can be no others of the same board, as far off as a guess may be.

    What hides a part of the board may be as white as its margin (the edge of a stair is), so the margin proves nothing:
    the squares around the corners may be any of the board's with the same colours.

    Args:
        pattern: The board.
        view: Where it is thought to be.
        which: (N,) numbers of the corners found.
        near: (2,) pixels where the board's centre was expected.
        reach_px: How far off that may be.
    """
    columns, rows = pattern.shape
    v, u = np.divmod(which, columns)
    j, i = np.mgrid[-v.min() : rows - v.max(), -u.min() : columns - u.max()]
    others = ((i + j) % 2 == 0) & ((i != 0) | (j != 0))  # the corners' numbers would be greater by (i, j)
    if not others.any():
        return True
    centres = view.pixels(-np.column_stack([i[others], j[others]]).astype(float))
    return not (np.linalg.norm(centres - near, axis=1) <= reach_px).any()


def _plane(squares: Array) -> Array:
    """(N, 3) design of a plane over (N, 2) points."""
    return np.column_stack([np.ones(len(squares)), squares])
