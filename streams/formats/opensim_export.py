"""True motion and loads as OpenSim files: joint angles and ground reactions as `.mot`, and the external loads file.

Coordinates have the names and signs of the Rajagopal full-body model (Rajagopal et al., IEEE TBME 63(10), 2016) or of
gait2392 (Delp et al., IEEE TBME 37(8), 1990), whose knees bend to negative angles and which has no arms. The ground
frame of OpenSim is x forward, y up, z right.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.streams.errors import RecordingError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Array

MOTION, LOADS, TIES = "motion.mot", "ground_reactions.mot", "external_loads.xml"
"""Files that are written: motion, loads of the ground, and which columns of these act on which foot."""
_R_OPENSIM_WORLD = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""Rotation from our world (x forward, y left, z up) to OpenSim's ground frame (x forward, y up, z right)."""
# OpenSim's coordinate and its sign by the twin's joint, without the suffix of the side for limbs
_TRUNK = {
    "lumbar_flexion": ("lumbar_extension", -1.0),
    "lumbar_bending": ("lumbar_bending", 1.0),
    "lumbar_rotation": ("lumbar_rotation", 1.0),
}
_LEG = {
    "hip_flexion": ("hip_flexion", 1.0),
    "hip_adduction": ("hip_adduction", 1.0),
    "hip_rotation": ("hip_rotation", 1.0),
    "knee_flexion": ("knee_angle", 1.0),
    "ankle_dorsiflexion": ("ankle_angle", 1.0),
    "ankle_inversion": ("subtalar_angle", 1.0),
    "toe_extension": ("mtp_angle", 1.0),
}
_ARM = {
    "shoulder_flexion": ("arm_flex", 1.0),
    "shoulder_abduction": ("arm_add", -1.0),
    "elbow_flexion": ("elbow_flex", 1.0),
}
_SIDES = ("r", "l")


@dataclass(frozen=True, kw_only=True)
class Model:
    """Names and signs of an OpenSim model for the twin's motion.

    Attributes:
        coordinates: Coordinate name and sign, by the twin's joint.
        p_hips_in_pelvis: (3,) m, middle of the hip centres in its pelvis' frame, as the unscaled model has it.
        force: Prefix of the columns of force and point, by side.
        torque: Prefix of the columns of the free torque, by side.
    """

    coordinates: Mapping[str, tuple[str, float]]
    p_hips_in_pelvis: tuple[float, float, float]
    force: Mapping[str, str]
    torque: Mapping[str, str]


def _mirror_coordinates(limbs: Mapping[str, tuple[str, float]]) -> dict[str, tuple[str, float]]:
    """Coordinates of the trunk and of both sides' limbs, with the sides' suffixes on joint and coordinate.

    Args:
        limbs: Coordinate and sign by joint, of one side and without its suffix.
    """
    both = {f"{joint}_{s}": (f"{coordinate}_{s}", sign) for joint, (coordinate, sign) in limbs.items() for s in _SIDES}
    return _TRUNK | both


MODELS = {
    "rajagopal": Model(
        coordinates=_mirror_coordinates(_LEG | _ARM),
        p_hips_in_pelvis=(-0.056276, -0.07849, 0.0),
        force={s: f"ground_force_{s}_" for s in _SIDES},
        torque={s: f"ground_torque_{s}_" for s in _SIDES},
    ),
    "gait2392": Model(
        coordinates=_mirror_coordinates(_LEG | {"knee_flexion": ("knee_angle", -1.0)}),
        p_hips_in_pelvis=(-0.0707, -0.0661, 0.0),
        force={"r": "ground_force_", "l": "1_ground_force_"},
        torque={"r": "ground_torque_", "l": "1_ground_torque_"},
    ),
}


def write_opensim(recording: Recording, folder: Path, model: str = "rajagopal") -> dict[str, int]:
    """Writes `motion.mot` (degrees, m), `ground_reactions.mot` (N, m, N m) and `external_loads.xml`.

    Joints without a counterpart in the model (neck, exoskeleton) keep their names. Ground reactions are forces
    at the centre of pressure with their free torque; without load they are 0. The pelvis of OpenSim's models is in
    front of and above the hips, that of the twin between them; the offset is that of the unscaled model.

    Returns:
        Rows written, by file.

    Raises:
        RecordingError: The recording has no true joint angles, as real recordings.
    """
    for topic in ("/truth/joints", "/truth/pelvis/odometry"):
        if topic not in recording.topics:
            raise RecordingError(f"{recording.path}: no {topic}: expected a recording of the twin, with ground truth")
    counts = {MOTION: _write_motion(recording, MODELS[model], folder / MOTION)}
    sides = [s for s in _SIDES if f"/truth/foot_{s}/wrench" in recording.topics]
    if sides:
        counts[LOADS] = _write_loads(recording, MODELS[model], sides, folder / LOADS)
        (folder / TIES).write_text(_format_external_loads(MODELS[model], sides), encoding="utf-8")
    return counts


def _write_motion(recording: Recording, model: Model, path: Path) -> int:
    """Writes pelvis and joint angles as `.mot` and returns the number of rows.

    The pelvis has OpenSim's Euler angles: tilt about z, then list about x, then rotation about y.
    """
    joints, pelvis = recording.block("/truth/joints"), recording.block("/truth/pelvis/odometry")
    at = np.clip(np.searchsorted(pelvis.t_ns, joints.t_ns), 0, len(pelvis) - 1)
    keep = pelvis.t_ns[at] == joints.t_ns  # stamps that both have
    at = at[keep]  # rows of the pelvis
    R = Rotation.from_quat(pelvis.columns["q_world_frame"][at], scalar_first=True).as_matrix()
    R = _R_OPENSIM_WORLD @ R @ _R_OPENSIM_WORLD.T  # OpenSim's axes of the pelvis in its ground frame
    # the twin's pelvis is between the hips; OpenSim's is moved from there by the model's offset
    p = pelvis.columns["p_frame_in_world"][at] @ _R_OPENSIM_WORLD.T - R @ np.array(model.p_hips_in_pelvis)
    # the model's pelvis rotates about its own z (tilt), then x (list), then y (rotation)
    angles = Rotation.from_matrix(R).as_euler("ZXY")
    names = ["pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz"]
    columns = [np.degrees(np.unwrap(angles, axis=0)), p]
    for i, name in enumerate(joints.constants["names"]):
        coordinate, sign = model.coordinates.get(name, (name, 1.0))
        names.append(coordinate)
        columns.append(np.degrees(sign * joints.columns["position"][keep, i : i + 1]))
    return _write_mot(path, "motion", names, joints.t_ns[keep], np.column_stack(columns), in_degrees=True)


def _write_loads(recording: Recording, model: Model, sides: list[str], path: Path) -> int:
    """Writes force, point and free torque of each foot as `.mot`, in OpenSim's axes; returns the number of rows."""
    t_ns = recording.block(f"/truth/foot_{sides[0]}/wrench").t_ns
    names: list[str] = []
    columns: list[Array] = []
    for side in sides:
        # `v` is the vector of the force, `p` its point
        names += [f"{model.force[side]}{what}{axis}" for what in ("v", "p") for axis in "xyz"]
        names += [f"{model.torque[side]}{axis}" for axis in "xyz"]
        columns += [vectors @ _R_OPENSIM_WORLD.T for vectors in _compute_loads(recording, side, t_ns)]
    return _write_mot(path, "ground_reactions", names, t_ns, np.column_stack(columns), in_degrees=False)


def _compute_loads(recording: Recording, side: str, t_ns: np.ndarray) -> tuple[Array, Array, Array]:
    """The loads of a foot at its centre of pressure, at the given stamps (N,) ns.

    With the true force F and torque T at the foot's origin p and the centre of pressure c, the free torque is T + (p -
    c) × F.

    Returns:
        (N, 3) force in N, point in m and free torque in N m, world axes; 0 for an unloaded foot.
    """
    force, point, torque = (np.zeros((len(t_ns), 3)) for _ in range(3))
    if f"/truth/foot_{side}/cop" not in recording.topics:
        return force, point, torque
    wrench, foot = recording.block(f"/truth/foot_{side}/wrench"), recording.block(f"/truth/foot_{side}/odometry")
    cop = recording.block(f"/truth/foot_{side}/cop")
    common = np.intersect1d(np.intersect1d(t_ns, wrench.t_ns), np.intersect1d(foot.t_ns, cop.t_ns))
    # where these stamps are in the result and in each stream
    rows, at_wrench, at_foot, at_cop = (np.searchsorted(t, common) for t in (t_ns, wrench.t_ns, foot.t_ns, cop.t_ns))
    force[rows] = wrench.columns["force_in_world"][at_wrench]
    point[rows] = cop.columns["p_in_world"][at_cop]
    lever = foot.columns["p_frame_in_world"][at_foot] - point[rows]  # p - c
    torque[rows] = wrench.columns["torque_in_world"][at_wrench] + np.cross(lever, force[rows])
    return force, point, torque


def _write_mot(path: Path, name: str, columns: list[str], t_ns: np.ndarray, table: Array, *, in_degrees: bool) -> int:
    """Writes a table with OpenSim's header and times in s; returns its number of rows.

    Args:
        path: The file.
        name: Name of the table in its header.
        columns: (K,) names of the columns after the time.
        t_ns: (N,) stamps.
        table: (N, K) numbers.
        in_degrees: Whether its angles are in degrees.
    """
    head = [name, "version=1", f"nRows={len(t_ns)}", f"nColumns={1 + len(columns)}"]
    head += [f"inDegrees={'yes' if in_degrees else 'no'}", "endheader", "\t".join(["time", *columns])]
    with path.open("w", encoding="ascii") as file:
        file.write("\n".join(head) + "\n")
        np.savetxt(file, np.column_stack((t_ns * 1e-9, table)), fmt="%.9g", delimiter="\t")
    return len(t_ns)


def _format_external_loads(model: Model, sides: list[str]) -> str:
    """The XML text that tells OpenSim which columns of `ground_reactions.mot` act on which foot.

    A foot is the model's body `calcn_r` or `calcn_l`. The columns are named by their common prefixes.

    Args:
        model: The model, which has the prefixes.
        sides: `r` and `l`, as far as there are loads.
    """
    forces = "".join(
        f"<ExternalForce name={quoteattr('ground_' + s)}><applied_to_body>calcn_{s}</applied_to_body>"
        "<force_expressed_in_body>ground</force_expressed_in_body>"
        "<point_expressed_in_body>ground</point_expressed_in_body>"
        f"<force_identifier>{model.force[s]}v</force_identifier>"
        f"<point_identifier>{model.force[s]}p</point_identifier>"
        f"<torque_identifier>{model.torque[s]}</torque_identifier></ExternalForce>\n"
        for s in sides
    )
    return (
        '<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="40000"><ExternalLoads name="loads">'
        f"<objects>\n{forces}</objects><datafile>{LOADS}</datafile></ExternalLoads></OpenSimDocument>\n"
    )
