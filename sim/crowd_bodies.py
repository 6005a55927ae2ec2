"""Bystanders in the model: bodies placed along their paths, visible to every camera and without contacts."""

from __future__ import annotations

import mujoco
import numpy as np

from stridetwin.sim.bystanders import (
    ANKLE_M,
    HIP_M,
    PARTS,
    SHANK_M,
    SHOULDER_M,
    THIGH_M,
    UPPER_ARM_M,
    Crowd,
)  # fmt: skip
from stridetwin.sim.rotation import quat_from_matrix

_SHIRTS = ((0.72, 0.30, 0.22), (0.85, 0.70, 0.25), (0.35, 0.50, 0.28), (0.55, 0.40, 0.62))
_TROUSERS = ((0.25, 0.28, 0.38), (0.36, 0.30, 0.26), (0.20, 0.20, 0.22), (0.42, 0.44, 0.47))
_SKIN, _HAIR, _SHOE = (0.82, 0.62, 0.50), (0.22, 0.16, 0.11), (0.15, 0.15, 0.17)
_ELLIPSOID, _CAPSULE, _BOX = mujoco.mjtGeom.mjGEOM_ELLIPSOID, mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX
_Geom = tuple[mujoco.mjtGeom, tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


def add_bystanders(spec: mujoco.MjSpec, count: int) -> None:
    """Adds `count` bystanders; `pose` places them."""
    for i in range(count):
        for part in PARTS:
            body = spec.worldbody.add_body(name=f"bystander_{i}_{part}", mocap=True, pos=(0.0, 0.0, -50.0))
            for kind, pos, size, colour in _geoms(part.removesuffix("_l").removesuffix("_r"), _SHIRTS[i], _TROUSERS[i]):
                body.add_geom(
                    type=kind, pos=pos, size=size, rgba=(*colour, 1.0), contype=0, conaffinity=0, mass=0.0,
                )  # fmt: skip


def pose(model: mujoco.MjModel, data: mujoco.MjData, crowd: Crowd, t_s: float) -> None:
    """Places all bystanders at an instant."""
    for i, person in enumerate(crowd.people):
        p, R = person.parts(np.array([t_s]))
        first = int(model.body(f"bystander_{i}_{PARTS[0]}").mocapid[0])
        data.mocap_pos[first : first + len(PARTS)] = p[0]
        data.mocap_quat[first : first + len(PARTS)] = quat_from_matrix(R[0])


def _geoms(part: str, shirt: tuple[float, float, float], trousers: tuple[float, float, float]) -> list[_Geom]:
    def limb(length: float, radius: float, colour: tuple[float, float, float]) -> _Geom:
        return (_CAPSULE, (0.0, 0.0, -length / 2), (radius, length / 2, 0.0), colour)

    shoulder = SHOULDER_M[2]
    return {
        "trunk": [
            (_ELLIPSOID, (0.0, 0.0, 0.02), (0.10, HIP_M + 0.075, 0.11), trousers),
            (_ELLIPSOID, (0.0, 0.0, 0.20), (0.10, 0.14, 0.16), shirt),
            (_ELLIPSOID, (0.01, 0.0, shoulder - 0.13), (0.115, 0.18, 0.19), shirt),
            (_CAPSULE, (0.01, 0.0, shoulder + 0.06), (0.05, 0.04, 0.0), _SKIN),
            (_ELLIPSOID, (0.025, 0.0, shoulder + 0.21), (0.092, 0.074, 0.118), _SKIN),
            (_ELLIPSOID, (0.005, 0.0, shoulder + 0.235), (0.094, 0.080, 0.108), _HAIR),
        ],
        "thigh": [limb(THIGH_M, 0.075, trousers)],
        "shank": [limb(SHANK_M, 0.052, trousers)],
        "foot": [(_ELLIPSOID, (0.055, 0.0, -ANKLE_M / 2), (0.135, 0.046, ANKLE_M / 2), _SHOE)],
        "upper_arm": [limb(UPPER_ARM_M, 0.045, shirt)],
        "forearm": [limb(0.30, 0.036, _SKIN)],
    }[part]
