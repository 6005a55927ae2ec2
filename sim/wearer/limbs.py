"""Occlusion by a walker's own limbs: rays against the shapes of person, shoes and exoskeleton, in bulk, compiled.

A line of sight is a segment. Every shape is convex, so that the part of a line inside it is an interval: the shape
occludes where this interval and the segment overlap.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.kinematics import rigid_tree
from stridetwin.sim.kinematics.rigid_tree import Tree
from stridetwin.streams.algebra.arrays import from_quaternion
from stridetwin.streams.algebra.tuples import Vec3, dot, mat3, matvec, minus, plus, times, transposed, vec3
from stridetwin.streams.compiled import INNER_KERNEL, entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(__file__)

NEAR_M = SUNK_M = 0.02
"""Shapes nearer to an eye than this do not occlude it, and an eye may be this deep inside its carrier's crude shape."""
_SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX = 2, 3, 4, 5, 6  # mjtGeom
_NOTHING = (math.inf, -math.inf)  # an empty interval


@dataclass(frozen=True, kw_only=True, eq=False)
class Limbs:
    """Shapes of a walker at N instants.

    Attributes:
        kind: (G,) number of `mjtGeom`.
        size: (G, 3) m, as in MuJoCo.
        reach: (G,) m, radius of the bounding sphere.
        p: (N, G, 3) m, middles in the world.
        R: (N, G, 3, 3), shape to world.
    """

    kind: NDArray[np.int64]
    size: Array
    reach: Array
    p: Array
    R: Array

    @classmethod
    def of(cls, model: mujoco.MjModel, q: Array, v: Array) -> Limbs:
        """Shapes of person, shoes and exoskeleton at N instants.

        Args:
            model: Compiled model of the wearer.
            q: (N, nq) positions.
            v: (N, nv) velocities, which `body_motion` needs; the shapes do not depend on them.
        """
        tree = Tree.of(model)
        shapes_ = find_shapes(model, set(tree.ids.tolist()))
        p_body, quat, _, _ = rigid_tree.body_motion(tree, q, v)
        rows = np.searchsorted(tree.ids, [shape.body for shape in shapes_])  # body of each shape, by index in the tree
        R_body = from_quaternion(quat)[:, rows]
        return cls(
            kind=np.array([shape.kind for shape in shapes_], np.int64),
            size=np.array([shape.size for shape in shapes_]),
            reach=np.array([shape.reach for shape in shapes_]),
            p=p_body[:, rows] + np.einsum("ngij,gj->ngi", R_body, [shape.p for shape in shapes_]),
            R=np.einsum("ngij,gjk->ngik", R_body, [shape.R for shape in shapes_]),
        )

    def occludes(self, rows: NDArray[np.integer], origins: Array, targets: Array) -> NDArray[np.bool_]:
        """(M, K) whether a limb occludes each target from its origin.

        Args:
            rows: (M,) numbers of the instants, 0 to N − 1.
            origins: (M, 3) m in the world, one per instant; deeper than `SUNK_M` inside a limb everything is occluded.
            targets: (M, K, 3) m in the world.
        """
        return _find_occluded(
            self.kind,
            self.size,
            self.reach,
            self.p,
            self.R,
            np.asarray(rows, np.int64),
            np.ascontiguousarray(origins, float),
            np.ascontiguousarray(targets, float),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class LimbShape:
    """A convex shape on a body.

    Attributes:
        body: Number of the body.
        kind: Number of `mjtGeom`.
        size: (3,) m, as in MuJoCo.
        reach: m, radius of its bounding sphere.
        p: (3,) m, its centre in the body's frame.
        R: (3, 3) its rotation in that frame.
    """

    body: int
    kind: int
    size: Array
    reach: float
    p: Array
    R: Array

    def ray_distance(self, origin: Array, direction: Array) -> float:
        """Distance along a ray to the shape, in multiples of `direction`; inf for a miss, negative from inside.

        Args:
            origin: (3,) m, body's frame.
            direction: (3,), body's frame.
        """
        o, d = self.R.T @ (origin - self.p), self.R.T @ direction  # the ray in the shape's own frame
        enters, leaves = _inside_interval_for_python(
            self.kind,
            (float(self.size[0]), float(self.size[1]), float(self.size[2])),
            (float(o[0]), float(o[1]), float(o[2])),
            (float(d[0]), float(d[1]), float(d[2])),
        )
        return enters if enters <= leaves and leaves >= 0.0 else math.inf


def find_shapes(model: mujoco.MjModel, bodies: Collection[int]) -> list[LimbShape]:
    """Shapes on the given bodies and on bodies that are fixed to these without a joint.

    Args:
        model: Compiled model of the wearer.
        bodies: Numbers of the bodies.
    """
    shapes = []
    for geom in range(model.ngeom):
        body, p, R = int(model.geom_bodyid[geom]), model.geom_pos[geom], from_quaternion(model.geom_quat[geom])
        # from carrier to carrier, with the pose in each one's frame
        while body and body not in bodies and not model.body_jntnum[body]:
            R_carrier = from_quaternion(model.body_quat[body])
            p, R = model.body_pos[body] + R_carrier @ p, R_carrier @ R
            body = int(model.body_parentid[body])
        if body in bodies:
            size, reach = model.geom_size[geom].copy(), float(model.geom_rbound[geom])
            shapes.append(
                LimbShape(body=body, kind=int(model.geom_type[geom]), size=size, reach=reach, p=p.copy(), R=R)
            )
    return shapes


@_entry_kernel
def _find_occluded(
    kind: NDArray[np.int64],
    size: Array,
    reach: Array,
    p: Array,
    R: Array,
    rows: NDArray[np.int64],
    origins: Array,
    targets: Array,
) -> NDArray[np.bool_]:
    """(M, K) whether a shape occludes each line of sight.

    Shapes whose bounding sphere the segment misses are skipped.

    Args:
        kind: (G,) number of `mjtGeom`.
        size: (G, 3) m, as in MuJoCo.
        reach: (G,) m, radius of the bounding sphere.
        p: (N, G, 3) m, middles in the world.
        R: (N, G, 3, 3), shape to world.
        rows: (M,) instants.
        origins: (M, 3) m in the world, an eye for each instant.
        targets: (M, K, 3) m in the world.
    """
    occluded = np.zeros(targets.shape[:2], np.bool_)
    for m in range(len(rows)):
        n = rows[m]
        eye = vec3(origins[m])
        for k in range(targets.shape[1]):
            d = minus(vec3(targets[m, k]), eye)
            squared = dot(d, d)  # m², length of the segment
            for g in range(len(kind)):
                # point of the segment nearest to the middle of the shape, and from that middle
                to = minus(eye, vec3(p[n, g]))
                share = min(max(-dot(to, d) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
                near = plus(to, times(share, d))
                if dot(near, near) > reach[g] * reach[g]:
                    continue
                to_shape = transposed(mat3(R[n, g]))
                if _occludes(kind[g], vec3(size[g]), matvec(to_shape, to), matvec(to_shape, d)):
                    occluded[m, k] = True
                    break
    return occluded


@numba.njit(**INNER_KERNEL)
def _occludes(kind: int, size: Vec3, o: Vec3, d: Vec3) -> bool:
    """Whether a shape occludes the segment from o to o + d, in its own frame.

    It does not if it begins nearer than `NEAR_M`, or if o is less than `SUNK_M` inside it; images omit it, too.

    Args:
        kind: Number of `mjtGeom`.
        size: m, as in MuJoCo.
        o: The eye, m.
        d: From the eye to the target, m.
    """
    enters, leaves = _inside_interval(kind, size, o, d)  # in lengths of the segment
    if enters > leaves or enters >= 1.0 or leaves <= 0.0:
        return False  # the line misses the shape, or the shape is beyond an end of the segment
    if enters > 0.0:  # the eye is outside
        return enters * enters * dot(d, d) > NEAR_M * NEAR_M
    # the eye is inside: everything is occluded if it is deep inside, in the shape that is thinner by `SUNK_M`
    # a capsule keeps the length between its balls, which become thinner
    length = size[1] if kind == _CAPSULE else size[1] - SUNK_M
    core = (size[0] - SUNK_M, length, size[2] - SUNK_M)
    thin = core[0] <= 0.0 or (core[1] <= 0.0 and kind != _SPHERE) or (core[2] <= 0.0 and kind in (_ELLIPSOID, _BOX))
    if thin:  # nothing remains of it, so no eye is deep inside
        return False
    enters, leaves = _inside_interval(kind, core, o, d)
    return enters <= 0.0 <= leaves


@numba.njit(**INNER_KERNEL)
def _inside_interval(kind: int, size: Vec3, o: Vec3, d: Vec3) -> tuple[float, float]:
    """Interval of t in which the line o + t d is inside a shape, in the shape's own frame; (inf, -inf) for none.

    `kind` and `size` are as in MuJoCo: a box has three half edges, an ellipsoid three half axes, a sphere a radius, and
    a capsule or cylinder a radius and half its length along z. A shape of another kind is never hit.
    """
    if kind == _BOX:
        enters, leaves = -math.inf, math.inf
        for i in range(3):
            a, b = _slab(o[i], d[i], size[i])
            enters, leaves = max(enters, a), min(leaves, b)
        return enters, leaves
    if kind in (_CYLINDER, _CAPSULE):
        # within the radius about z, and within the length along z
        a, b = _quadric(d[0] ** 2 + d[1] ** 2, o[0] * d[0] + o[1] * d[1], o[0] ** 2 + o[1] ** 2 - size[0] ** 2)
        c, e = _slab(o[2], d[2], size[1])
        enters, leaves = max(a, c), min(b, e)
        if kind == _CYLINDER:
            return enters, leaves
        if enters > leaves:  # the line misses the cylinder, but it may still meet a ball
            enters, leaves = _NOTHING
        for end in (-size[1], size[1]):  # balls at the ends; the union is convex, so that the intervals make one
            z = o[2] - end
            a, b = _quadric(
                d[0] ** 2 + d[1] ** 2 + d[2] ** 2,
                o[0] * d[0] + o[1] * d[1] + z * d[2],
                o[0] ** 2 + o[1] ** 2 + z**2 - size[0] ** 2,
            )
            enters, leaves = min(enters, a), max(leaves, b)
        return enters, leaves
    sx, sy, sz = size[0], size[1], size[2]
    if kind == _SPHERE:
        sy, sz = sx, sx
    elif kind != _ELLIPSOID:
        return _NOTHING
    # scaled to a unit ball
    ox, oy, oz = o[0] / sx, o[1] / sy, o[2] / sz
    dx, dy, dz = d[0] / sx, d[1] / sy, d[2] / sz
    return _quadric(dx**2 + dy**2 + dz**2, ox * dx + oy * dy + oz * dz, ox**2 + oy**2 + oz**2 - 1.0)


_inside_interval_for_python = _entry_kernel(_inside_interval)  # for Python


@numba.njit(**INNER_KERNEL)
def _slab(o: float, d: float, half: float) -> tuple[float, float]:
    """Interval of t in which o + t d is between -half and half; (inf, -inf) for none."""
    if d == 0.0:  # the line is parallel to the borders: inside everywhere or nowhere
        return (-math.inf, math.inf) if abs(o) <= half else (math.inf, -math.inf)
    a, b = (-half - o) / d, (half - o) / d
    return (a, b) if a < b else (b, a)


@numba.njit(**INNER_KERNEL)
def _quadric(a: float, b: float, c: float) -> tuple[float, float]:
    """Interval of t in which a t² + 2 b t + c is at most 0, for a >= 0; (inf, -inf) for none."""
    if a == 0.0:  # the line does not leave its place in these axes: inside everywhere or nowhere
        return (-math.inf, math.inf) if c <= 0.0 else (math.inf, -math.inf)
    discriminant = b * b - a * c
    if discriminant < 0.0:
        return (math.inf, -math.inf)
    root = math.sqrt(discriminant)
    return (-b - root) / a, (-b + root) / a
