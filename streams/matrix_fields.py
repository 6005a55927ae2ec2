"""Matrices in configuration files: lists of rows that become checked NumPy arrays."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from stridetwin.streams.fields import Number, ReadAs, field_error
from stridetwin.streams.samples import Array


def _to_rotation(rows: Any) -> Array:
    """The (3, 3) array of three rows in a file.

    Raises:
        PydanticCustomError: It is no rotation.
    """
    R = np.array(rows)
    if not _is_rotation(R):
        raise field_error(R.tolist(), "a rotation matrix")
    return R


def _to_rigid_transform(rows: Any) -> Array:
    """The (4, 4) array of four rows in a file; a rotation whose numbers were rounded is replaced by the nearest one.

    Raises:
        PydanticCustomError: It is no rigid transform; the message says why.
    """
    T = np.array(rows, float)
    with np.errstate(all="ignore"):  # numbers of any size
        if _is_rotation(T[:3, :3]) and np.array_equal(T[3], (0, 0, 0, 1)):
            return T
        if np.allclose(T[3], (0, 0, 0, 1), rtol=0, atol=1e-6):
            T[3] = 0, 0, 0, 1
        cause = _explain_no_transform(T)
    if cause:
        valid = "a rigid transform: a rotation matrix, a translation, and a last row 0 0 0 1"
        raise field_error(T.tolist(), f"{valid}; {cause}")
    U, _, Vt = np.linalg.svd(T[:3, :3])
    T[:3, :3] = U @ Vt
    return T


def _explain_no_transform(T: Array) -> str:
    """Why a (4, 4) matrix is no rigid transform; "" if its rotation is only rounded."""
    R = T[:3, :3]
    if not np.array_equal(T[3], (0, 0, 0, 1)):
        is_transposed = np.array_equal(T[:, 3], (0, 0, 0, 1)) and _is_rotation(R)
        return "are its rows columns (transposed)?" if is_transposed else f"the last row is {T[3].tolist()}"
    product = R @ R.T
    scale = float(np.trace(product)) / 3
    if np.allclose(product, np.eye(3), atol=_ROUNDED):
        return "" if np.linalg.det(R) > 0 else "the axes are mirrored (left-handed)"
    if scale > 0 and np.allclose(product, scale * np.eye(3), atol=_ROUNDED * scale):
        return f"its rotation is scaled by {np.sqrt(scale):.4g}"
    return f"its axes are off unit length or right angles by up to {float(np.abs(product - np.eye(3)).max()):.2g}"


def to_matrix_rows(node: object) -> object:
    """The four rows of a transform in a file of another tool; anything else is returned for the validation to refuse.

    Read are rows, three or four of them; 12 or 16 numbers row by row, also as OpenCV's `data`; a position `px, py, pz`
    with a quaternion `qx, qy, qz, qw`, as Basalt writes it; a translation with a rotation, each under a name such as
    `translation` and `R`, where a quaternion has the keys `x, y, z, w`.
    """
    if isinstance(node, dict) and isinstance(node.get("data"), list):
        node = node["data"]
    elif isinstance(node, dict) and set(node) == set(_POSE_KEYS):
        return _pose_to_rows(node)
    elif isinstance(node, dict):
        return _parts_to_rows(node)
    if isinstance(node, list) and len(node) in (12, 16) and not any(isinstance(item, list) for item in node):
        node = [node[i : i + 4] for i in range(0, len(node), 4)]
    if isinstance(node, list) and len(node) == 3 and all(isinstance(row, list) and len(row) == 4 for row in node):
        return [*node, [0.0, 0.0, 0.0, 1.0]]
    return node


def _parts_to_rows(node: dict[str, object]) -> object:
    """The four rows of a mapping with a translation and a rotation; the mapping itself if it has other parts."""
    by_name = {key.lower(): value for key, value in node.items()}
    p = next((by_name[name] for name in _TRANSLATIONS if name in by_name), None)
    R = next((by_name[name] for name in _ROTATIONS if name in by_name), None)
    if isinstance(p, dict) and set(p) == set("xyz"):
        p = [p[axis] for axis in "xyz"]
    if not isinstance(p, list) or len(by_name) != 2:
        return node
    if isinstance(R, dict):
        q = {key.lower().removeprefix("q"): value for key, value in R.items()}
        if len(p) != 3 or set(q) != set("xyzw"):
            return node
        rows = _pose_to_rows(dict(zip(_POSE_KEYS, [*p, *(q[axis] for axis in "xyzw")])))
        return rows if isinstance(rows, list) else node
    return join_rows(R, p) or node


def join_rows(R: object, p: object) -> list[object] | None:
    """The four rows of a rotation, as three rows or nine numbers, and a translation; None if they are none."""
    if isinstance(R, dict):
        R = R.get("data")
    if isinstance(p, dict):
        p = p.get("data")
    if isinstance(R, list) and len(R) == 9 and not any(isinstance(item, list) for item in R):
        R = [R[i : i + 3] for i in (0, 3, 6)]
    if isinstance(p, list) and len(p) == 3 and all(isinstance(item, list) and len(item) == 1 for item in p):
        p = [item[0] for item in p]
    if not isinstance(R, list) or not isinstance(p, list) or len(R) != 3 or len(p) != 3:
        return None
    if not all(isinstance(row, list) and len(row) == 3 for row in R):
        return None
    return [*([*row, value] for row, value in zip(R, p, strict=True)), [0.0, 0.0, 0.0, 1.0]]


def _pose_to_rows(pose: dict[str, object]) -> object:
    """The four rows of a position and a quaternion; the mapping itself if these are no such numbers."""
    numbers = [pose[key] for key in _POSE_KEYS]
    if not all(isinstance(n, (int, float)) and not isinstance(n, bool) for n in numbers):
        return pose
    position, q = np.array(numbers[:3], float), np.array(numbers[3:], float)
    if not 0.99 < float(np.linalg.norm(q)) < 1.01:
        return pose
    x, y, z, w = q / np.linalg.norm(q)
    T = np.eye(4)
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, 3] = position
    return T.tolist()


def _is_rotation(R: Array) -> bool:
    """Whether a (3, 3) matrix is orthogonal, up to the rounding of a file, and no reflection."""
    return bool(np.allclose(R @ R.T, np.eye(3), atol=1e-4) and np.linalg.det(R) > 0)


_ROUNDED = 5e-3
"""Largest error of a rotation times its transpose that three decimals explain."""
_POSE_KEYS = ("px", "py", "pz", "qx", "qy", "qz", "qw")
"""Keys of a pose as Basalt writes it: position in m, and quaternion."""
_TRANSLATIONS = ("translation", "position", "trans", "t", "p")
"""Names of a translation beside a rotation, in lower case, the most telling first."""
_ROTATIONS = ("rotation", "orientation", "quaternion", "rot", "r", "q")
"""Names of a rotation beside a translation, likewise."""
_Row = tuple[Number, Number, Number, Number]
_Three = tuple[Number, Number, Number]
RotationMatrix = Annotated[Array, ReadAs(tuple[_Three, _Three, _Three], _to_rotation)]
"""(3, 3) rotation, as rows."""
RigidTransform = Annotated[Array, ReadAs(tuple[_Row, _Row, _Row, _Row], _to_rigid_transform)]
"""(4, 4) rigid transform, as rows."""
