"""Convex polygons in the plane: the part of one that others do not cover."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from stridetwin.streams.samples import Array

_TINY_M = 1e-6


def without(polygon: Array, holes: Iterable[Array]) -> list[Array]:
    """Convex parts of a polygon outside all holes.

    Args:
        polygon: (N, 2) corners, convex, anticlockwise.
        holes: Polygons of the same kind.

    Returns:
        Polygons that do not overlap.
    """
    pieces = [polygon]
    for hole in holes:
        low, high = hole.min(axis=0), hole.max(axis=0)
        left = []
        for piece in pieces:
            apart = np.any((piece.max(axis=0) < low) | (piece.min(axis=0) > high))
            left += [piece] if apart else _outside(piece, hole)
        pieces = left
    return pieces


def quads(polygon: Array) -> list[Array]:
    """Cuts a convex polygon (N, 2) into quadrilaterals (4, 2) whose diagonals have areas on both sides."""
    rest, found = polygon, []
    while len(rest) > 4:
        found.append(rest[:4])
        rest = np.concatenate([rest[:1], rest[3:]])
    if len(rest) == 3:
        rest = np.array([rest[0], rest[1], (rest[1] + rest[2]) / 2, rest[2]])
    return [*found, rest]


def _outside(piece: Array, hole: Array) -> list[Array]:
    """Cuts off the part beyond each side of the hole in sequence; the final rest is inside the hole."""
    found: list[Array] = []
    for a, b in zip(hole, np.roll(hole, -1, axis=0)):
        beyond = _clip(piece, a, b, -1.0)
        if beyond is not None:
            found.append(beyond)
        inside = _clip(piece, a, b, 1.0)
        if inside is None:
            return found
        piece = inside
    return found


def _clip(polygon: Array, a: Array, b: Array, side: float) -> Array | None:
    """The part of a polygon to the left (1) or right (-1) of the line from a to b; None if empty."""
    run = (b - a) / np.linalg.norm(b - a)
    away = side * (run[0] * (polygon[:, 1] - a[1]) - run[1] * (polygon[:, 0] - a[0]))
    if away.max() < _TINY_M:
        return None
    if away.min() > -_TINY_M:
        return polygon
    points = []
    for i, j in zip(range(len(polygon)), np.roll(np.arange(len(polygon)), -1)):
        if away[i] > -_TINY_M:
            points.append(polygon[i])
        if (away[i] > _TINY_M and away[j] < -_TINY_M) or (away[i] < -_TINY_M and away[j] > _TINY_M):
            points.append(polygon[i] + away[i] / (away[i] - away[j]) * (polygon[j] - polygon[i]))
    return np.array(points) if len(points) > 2 else None
