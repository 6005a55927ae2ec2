"""Matrices in configuration files: lists of rows that become checked NumPy arrays."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from stridetwin.streams.fields import Number, ReadAs, field_error
from stridetwin.streams.samples import Array


def _to_rotation(rows: Any) -> Array:
    """The (3, 3) array of three rows in a file, or an error if it is no rotation."""
    R = np.array(rows)
    if not _is_rotation(R):
        raise field_error(R.tolist(), "a rotation matrix")
    return R


def _to_rigid_transform(rows: Any) -> Array:
    """The (4, 4) array of four rows in a file, or an error if it is no rigid transform."""
    T = np.array(rows)
    if not _is_rotation(T[:3, :3]) or not np.array_equal(T[3], (0, 0, 0, 1)):
        raise field_error(T.tolist(), "a rigid transform: a rotation matrix, a translation, and a last row 0 0 0 1")
    return T


def _is_rotation(R: Array) -> bool:
    """Whether a (3, 3) matrix is orthogonal, up to the rounding of a file, and no reflection."""
    return bool(np.allclose(R @ R.T, np.eye(3), atol=1e-4) and np.linalg.det(R) > 0)


_Row = tuple[Number, Number, Number, Number]
_Three = tuple[Number, Number, Number]
RotationMatrix = Annotated[Array, ReadAs(tuple[_Three, _Three, _Three], _to_rotation)]
"""(3, 3) rotation, as rows."""
RigidTransform = Annotated[Array, ReadAs(tuple[_Row, _Row, _Row, _Row], _to_rigid_transform)]
"""(4, 4) rigid transform, as rows."""
