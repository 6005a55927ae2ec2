"""Joint angles of OpenSim's common full-body models (gait2392 and its successors) as orientations of segments.

Coordinates and axes are those of gait2392 (Delp et al. 1990), of Rajagopal et al. 2016 and of the models of OpenCap,
which agree in them. They differ in the sign of the knee, which is that in which knees bend, and in the hips' place in
the pelvis. OpenSim's axes are x forward, y up, z to the right.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from scipy.interpolate import make_interp_spline

from stridetwin.sim.motion.read import NumberTable
from stridetwin.sim.motion.segments import SegmentMotion
from stridetwin.sim.people import Person
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.samples import Array

_AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # OpenSim's axes in those of the twin
_FORWARD, _UP, _RIGHT = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_ANKLE, _SUBTALAR = (-0.10501355, -0.17402245, 0.97912632), (0.78717961, 0.60474746, -0.12094949)
_MTP, _ELBOW = (-0.5809544, 0.0, 0.81393611), (0.226047, 0.022269, 0.973862)

# by segment: its carrier, and the coordinates of its joint in the order of their rotations, with their axes on the
# right; on the left axes are mirrored, as both sides have equal signs
_JOINTS: dict[str, tuple[str, tuple[tuple[str, tuple[float, float, float]], ...]]] = {
    "pelvis": ("", (("pelvis_tilt", _RIGHT), ("pelvis_list", _FORWARD), ("pelvis_rotation", _UP))),
    "torso": ("pelvis", (("lumbar_extension", _RIGHT), ("lumbar_bending", _FORWARD), ("lumbar_rotation", _UP))),
    "thigh": ("pelvis", (("hip_flexion", _RIGHT), ("hip_adduction", _FORWARD), ("hip_rotation", _UP))),
    "shank": ("thigh", (("knee_angle", _RIGHT),)),
    "foot": ("shank", (("ankle_angle", _ANKLE), ("subtalar_angle", _SUBTALAR))),
    "toe": ("foot", (("mtp_angle", _MTP),)),
    "upper_arm": ("torso", (("arm_flex", _RIGHT), ("arm_add", _FORWARD), ("arm_rot", _UP))),
    "forearm": ("upper_arm", (("elbow_flex", _ELBOW),)),
}
_NEEDED = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz", "hip_flexion_r",
           "hip_flexion_l", "knee_angle_r", "knee_angle_l", "ankle_angle_r", "ankle_angle_l")  # fmt: skip
# middle of the hips in the pelvis, and distance of the hips: gait2392, whose knees bend in the negative direction, and
# Rajagopal et al. 2016, whose knees bend in the positive one
_HIPS_M = {-1.0: (-0.0707, -0.0661, 0.0), 1.0: (-0.0563, -0.0785, 0.0)}
_HIP_WIDTH_M = {-1.0: 0.167, 1.0: 0.1545}
# by which the shank slides forward and up in the knee of gait2392 (Yamaguchi & Zajac 1989), m, by its angle, rad
_SLIDE_X = ((-2.0944, -1.7453, -1.3963, -1.0472, -0.6981, -0.3491, -0.1745, 0.0, 0.1973),
            (0.0013, 0.0065, 0.0088, 0.0088, 0.0068, 0.0036, 0.0014, 0.0, -0.0007))  # fmt: skip
_SLIDE_Z = ((-2.0944, -1.2217, -0.5236, -0.3491, -0.1745, 0.0, 0.1592),
            (-0.0275, -0.0127, -0.0033, -0.0018, -0.0008, 0.0, 0.0006))  # fmt: skip
_SOLE_OUTWARD_M = 0.008  # of the calcaneus' origin from the talus'
_MAX_RAD, _LEAST_KNEE_RAD = 4.0 * np.pi, 0.12
_FARTHEST_M = 20.0  # height of a pelvis; those in mm or cm are beyond it
_NO_MOTION_RAD = 1e-9


def read_opensim(table: NumberTable, person: Person) -> SegmentMotion:
    """Orientations of the segments from the coordinates of a model.

    Trunk, arms and toes whose angles are all zero were not measured.

    Args:
        table: Coordinates, rad and m.
        person: The person, whose hips' width gives the scale of the pelvis.

    Raises:
        ConfigError: Coordinates are missing or unknown, or in other units.
    """
    names = [_bare_name(name) for name in table.names]
    columns = {name: table.values[:, i] for i, name in enumerate(names) if name}
    missing = [name for name in _NEEDED if name not in columns]
    if missing:
        raise ConfigError(
            table.source, "columns", f"no {', '.join(missing)}", f"coordinates such as {', '.join(_NEEDED[:8])}"
        )
    used = {name: columns[name] for name in _all_coordinates() if name in columns}
    for name, values in used.items():
        if not np.isfinite(values).all():
            raise ConfigError(table.source, name, "NaN", "numbers in every row")
    _check_units(table.source, used)
    t, dt = table.t, float(table.t[-1] - table.t[0]) / (len(table.t) - 1)
    if np.ptp(np.diff(t)) > 1e-3 * dt:  # rows of a solver with a step of its own
        even = np.linspace(t[0], t[-1], len(t))
        used = {name: make_interp_spline(t, values, k=3)(even) for name, values in used.items()}
    knees = np.concatenate([used["knee_angle_l"], used["knee_angle_r"]])
    bends = float(np.sign(knees[np.argmax(np.abs(knees))]))
    for name in ("knee_angle_r", "knee_angle_l"):  # rotations of the shank about the axis to the right
        used[name] = -bends * used[name]
    R = _orientations(used, len(t))
    p = np.stack([used[f"pelvis_t{axis}"] for axis in "xyz"], axis=1)
    width = None if person.segments is None else person.segments.hip_width_m
    scale = 1.0 if width is None else width / _HIP_WIDTH_M[bends]
    hips = p + R["pelvis"] @ (scale * np.array(_HIPS_M[bends]))
    slides = {}
    for side in ("l", "r") if bends < 0.0 else ():
        slide_x, slide_z = (_interpolate(knots, used[f"knee_angle_{side}"]) for knots in (_SLIDE_X, _SLIDE_Z))
        slides[side] = np.stack([slide_x, np.zeros_like(slide_x), slide_z], axis=1)
    return SegmentMotion(
        source=table.source,
        dt=dt,
        hips=hips @ _AXES.T,
        R={body: _AXES @ R_body @ _AXES.T for body, R_body in R.items()},
        lengths={},
        sole_outward_m=_SOLE_OUTWARD_M,
        knee_slide=slides,
    )


def _interpolate(knots: tuple[tuple[float, ...], tuple[float, ...]], angle: Array) -> Array:
    """(N,) m at (N,) rad, smooth between the knots and constant beyond them."""
    at, values = knots
    return np.asarray(make_interp_spline(at, values, k=3)(np.clip(angle, at[0], at[-1])))


def _bare_name(name: str) -> str:
    """Name of a coordinate without its path, as in /jointset/knee_r/knee_angle_r/value; empty for speeds and others."""
    if "/" not in name:
        return name
    match = re.fullmatch(r"/?(?:.*/)?([^/]+)/value", name)
    return match.group(1) if match else ""


def _all_coordinates() -> list[str]:
    """Names of all coordinates that are used."""
    names = ["pelvis_tx", "pelvis_ty", "pelvis_tz"]
    for body, (_, coordinates) in _JOINTS.items():
        suffixes = ("",) if body in ("pelvis", "torso") else ("_l", "_r")
        names += [name + suffix for name, _ in coordinates for suffix in suffixes]
    return names


def _check_units(source: str, used: dict[str, Array]) -> None:
    """Rejects angles and lengths that cannot be in rad and m.

    Raises:
        ConfigError: They are in other units.
    """
    largest = max((float(np.abs(v).max()), name) for name, v in used.items() if not name.startswith("pelvis_"))
    if largest[0] > _MAX_RAD:
        raise ConfigError(source, largest[1], f"{largest[0]:.0f} rad", "radians, or inDegrees=yes in the head")
    bent = max(float(np.abs(used[f"knee_angle_{side}"]).max()) for side in "lr")
    if bent < _LEAST_KNEE_RAD:
        raise ConfigError(
            source, "knee_angle", f"at most {np.degrees(bent):.1f}°", "knees that bend, or inDegrees=no in the head"
        )
    farthest = float(np.abs(used["pelvis_ty"]).max())
    if farthest > _FARTHEST_M:
        raise ConfigError(source, "pelvis_ty", f"{farthest:.3g} m", f"m above the ground, within {_FARTHEST_M:g}")


def _orientations(used: dict[str, Array], frames: int) -> dict[str, Array]:
    """(N, 3, 3) by body, in OpenSim's axes."""
    R: dict[str, Array] = {}
    for body, (carrier, coordinates) in _JOINTS.items():
        for suffix in ("",) if body in ("pelvis", "torso") else ("_l", "_r"):
            angles = [used.get(name + suffix) for name, _ in coordinates]
            present = [a for a in angles if a is not None]
            is_zero = all(np.abs(a).max() < _NO_MOTION_RAD for a in present)
            if body not in ("pelvis", "thigh", "shank", "foot") and is_zero:
                continue  # not measured
            above = carrier if carrier in ("pelvis", "torso", "") else carrier + suffix
            turned = R[above] if above in R else R.get("pelvis", np.tile(np.eye(3), (frames, 1, 1)))
            for angle, (_, axis) in zip(angles, coordinates):
                if angle is not None:
                    turned = turned @ _rotate(_mirror(axis) if suffix == "_l" else axis, angle)
            R[body + suffix] = turned
    return R


def _mirror(axis: tuple[float, float, float]) -> tuple[float, float, float]:
    """Axis of a joint of the left side: z stays, as an axis is no vector."""
    return (-axis[0], -axis[1], axis[2])


def _rotate(axis: Sequence[float], angle: Array) -> Array:
    """(N, 3, 3) rotations by (N,) angles about an axis (Rodrigues)."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle)[:, None, None] * K + (1.0 - np.cos(angle))[:, None, None] * (K @ K)
