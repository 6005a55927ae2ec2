"""What the terrain looks like: textured surfaces, things beside the way, sky and sun.

All of it is for the eye only: nothing here collides. One mesh a material keeps drawing fast.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from stridetwin.sim.route import Strip
from stridetwin.sim.solids import Box, Solid, corners
from stridetwin.sim.textures import PERIOD_M, SIZE, TEXTURES, Pixels
from stridetwin.streams.samples import Array

_TOP = {"level": "concrete", "stair": "wood", "ramp": "brick"}
_SIDE = "stone"
_NOSING = "nosing"
_NOSING_M = 0.03
_CLEARANCE_M = 0.35
_SEED = 20260  # the look of the world is the same in every walk


@dataclass(frozen=True, kw_only=True)
class Landmark:
    """A box beside the way, of one material."""

    box: Box
    material: str


@dataclass(frozen=True, eq=False)
class Quad:
    """A textured rectangle.

    Attributes:
        corners: (4, 3) in the world, anticlockwise seen from outside.
        uv: (4, 2) texture coordinates, m.
        material: Name of its material.
    """

    corners: Array
    uv: Array
    material: str


def landmarks(profile: Sequence[Strip], width_m: float, ground_m: float) -> tuple[Landmark, ...]:
    """Planters and pillars along both sides of the way and a wall beyond its end, clear of the walker."""
    rng = np.random.default_rng(_SEED)
    along = np.array([x for s in profile for x in (s.x0, s.x1)])
    height = np.array([z for s in profile for z in (s.z0, s.z1)])
    first, last, end = profile[0].x0, profile[-1].x1, profile[-1].z1
    bottom = ground_m - 0.05
    inner = width_m / 2 + _CLEARANCE_M
    found: list[Landmark] = []
    for side in (-1.0, 1.0):
        for i, x in enumerate(np.arange(first + 0.5 + (side > 0), last, 2.2).tolist()):
            z = float(np.interp(x, along, height))
            if side < 0:  # the side that films are shot from: nothing that hides the walker
                found += _planter(rng, x, side, inner, z, bottom, hedge_m=(0.12, 0.30))
            elif i % 3 == 0:
                found += _pillar(rng, x, side, inner, z, bottom)
            else:
                found += _planter(rng, x, side, inner, z, bottom, hedge_m=(0.35, 0.80))
    wall = Box(x=last + 2.0, y=0.0, length=0.3, width=9.0 + width_m, bottom=bottom, top=end + 2.8)
    return (*found, Landmark(box=wall, material="brick"))


def _pillar(rng: np.random.Generator, x: float, side: float, inner: float, z: float, bottom: float) -> list[Landmark]:
    size = rng.uniform(0.3, 0.45)
    y = side * (inner + size / 2 + rng.uniform(0.0, 0.5))
    top = z + rng.uniform(1.7, 2.6)
    shaft = Box(x=x, y=y, length=size, width=size, bottom=bottom, top=top)
    cap = Box(x=x, y=y, length=size + 0.1, width=size + 0.1, bottom=top, top=top + 0.08)
    return [Landmark(box=shaft, material="plaster"), Landmark(box=cap, material="stone")]


def _planter(
    rng: np.random.Generator, x: float, side: float, inner: float, z: float, bottom: float,
    hedge_m: tuple[float, float],
) -> list[Landmark]:  # fmt: skip
    length, depth = rng.uniform(1.0, 1.7), rng.uniform(0.4, 0.55)
    y = side * (inner + depth / 2 + rng.uniform(0.0, 0.3))
    rim = z + rng.uniform(0.1, 0.2)
    top = rim + rng.uniform(*hedge_m)
    trough = Box(x=x, y=y, length=length, width=depth, bottom=bottom, top=rim)
    hedge = Box(x=x, y=y, length=length - 0.1, width=depth - 0.1, bottom=rim - 0.01, top=top)
    return [Landmark(box=trough, material="stone"), Landmark(box=hedge, material="leaves")]


def paint_way(profile: Sequence[Strip], solids: Sequence[Solid]) -> list[Quad]:
    """Textured faces of the way; treads and landings get a pale strip along the edge one could fall from."""
    ends_before = [math.inf, *(s.z1 for s in profile[:-1])]
    starts_after = [*(s.z0 for s in profile[1:]), math.inf]
    quads = []
    for strip, solid, before, after in zip(profile, solids, ends_before, starts_after):
        nose_low, nose_high = before < strip.z0, after < strip.z1
        low, high = _NOSING_M * nose_low, _NOSING_M * nose_high
        quads += _sides(solid, _SIDE)
        for start, end, material in (
            (0.0, low, _NOSING),
            (low, solid.length - high, _TOP[solid.terrain]),
            (solid.length - high, solid.length, _NOSING),
        ):
            if end > start:
                quads.append(_top(solid, start, end, material))
    return quads


def paint_landmarks(marks: Iterable[Landmark]) -> list[Quad]:
    """Textured faces of the landmarks."""
    quads = []
    for mark in marks:
        quads += [*_sides(mark.box, mark.material), _top(mark.box, 0.0, mark.box.length, mark.material)]
    return quads


def _top(solid: Solid, start: float, end: float, material: str) -> Quad:
    """Part of the top between two distances along the solid's length."""
    a, b, c, d = corners(solid)[4:]
    s, e = start / solid.length, end / solid.length
    piece = np.array([a + s * (b - a), a + e * (b - a), d + e * (c - d), d + s * (c - d)])
    along = np.array([start, end, end, start]) * math.hypot(solid.length, solid.end - solid.start) / solid.length
    across = np.array([0.0, 0.0, solid.width, solid.width])
    uv = np.column_stack([solid.x - solid.length / 2 + along, across])
    return Quad(piece, uv, material)


def _sides(solid: Solid, material: str) -> list[Quad]:
    c = corners(solid)
    quads = []
    for i, j in ((0, 1), (1, 2), (2, 3), (3, 0)):
        face = np.array([c[i], c[j], c[4 + j], c[4 + i]])
        run = math.dist(c[i, :2], c[j, :2]) * np.array([0.0, 1.0, 1.0, 0.0])
        start = c[i, 0] if i % 2 == 0 else c[i, 1]
        quads.append(Quad(face, np.column_stack([start + run, -face[:, 2]]), material))
    return quads


def add_quads(spec: mujoco.MjSpec, quads: Iterable[Quad]) -> None:
    """Adds rectangles to the model's world, one mesh and geom a material."""
    by_material = defaultdict(list)
    for quad in quads:
        by_material[quad.material].append(quad)
    for material, group in by_material.items():
        vertices = np.array([q.corners for q in group])
        normal = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        face = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(len(group))[:, None, None]
        name = f"scenery_{material}"
        spec.add_mesh(
            name=name,
            uservert=vertices.ravel(),
            usernormal=np.repeat(normal, 4, axis=0).ravel(),
            usertexcoord=np.array([q.uv for q in group]).ravel() / PERIOD_M,
            userface=face.ravel(),
            userfacenormal=face.ravel(),
            userfacetexcoord=face.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        spec.worldbody.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name,
            material=_add_material(spec, material).name,
            contype=0, conaffinity=0,
        )  # fmt: skip


def _add_material(spec: mujoco.MjSpec, name: str) -> mujoco.MjsMaterial:
    full = f"scenery_{name}"
    material = spec.add_material(name=full, specular=0.0, shininess=0.0)
    if name == _NOSING:
        material.rgba = (0.93, 0.87, 0.68, 1.0)
        return material
    texture = spec.add_texture(name=full, type=mujoco.mjtTexture.mjTEXTURE_2D, width=SIZE, height=SIZE, nchannel=3)
    texture.data = _texture(name).tobytes()
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = full
    return material


@cache
def _texture(name: str) -> Pixels:
    return TEXTURES[name](np.random.default_rng([_SEED, *name.encode()]))


def add_ground(spec: mujoco.MjSpec, height: float) -> None:
    """Adds the plane all around, `ground`, which collides."""
    lawn = _add_material(spec, "grass")
    lawn.texuniform, lawn.texrepeat = True, (1 / PERIOD_M, 1 / PERIOD_M)  # a plane has no texture coordinates
    spec.worldbody.add_geom(
        name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, pos=(0.0, 0.0, height), size=(0.0, 0.0, 1.0),
        material=lawn.name,
    )  # fmt: skip


def add_sky(spec: mujoco.MjSpec) -> None:
    """Adds a sky gradient, a sun and soft light from all around."""
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.42, 0.62, 0.86), rgb2=(0.90, 0.93, 0.95), width=32, height=192,
    )  # fmt: skip
    for name, direction, colour, shadow in (
        ("sun", (0.35, 0.45, -0.82), (0.62, 0.60, 0.55), True),
        ("fill", (-0.6, -0.5, -0.3), (0.16, 0.17, 0.19), False),
    ):
        spec.worldbody.add_light(
            name=name, type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=(0.0, 0.0, 12.0), dir=direction,
            diffuse=colour, specular=(0.1 * shadow,) * 3, ambient=(0.0, 0.0, 0.0), castshadow=shadow,
        )  # fmt: skip
    # The headlight only gives light from all around: if it came from the camera, the brightness of a surface
    # would depend on who looks at it.
    spec.visual.headlight.ambient = (0.46, 0.47, 0.50)
    spec.visual.headlight.diffuse = spec.visual.headlight.specular = (0.0, 0.0, 0.0)
