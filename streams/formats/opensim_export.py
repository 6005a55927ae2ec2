"""The true motion and loads as OpenSim files: joint angles and ground reactions as `.mot`, and what ties them together.

Coordinates have the names and signs of the Rajagopal full-body model (Rajagopal et al., IEEE TBME 63(10), 2016). The
ground frame of OpenSim is x forward, y up, z right.
"""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.streams.errors import RecordingError
from stridetwin.streams.recording import Recording
from stridetwin.streams.samples import Array

MOTION, LOADS, TIES = "motion.mot", "ground_reactions.mot", "external_loads.xml"
_R_OPENSIM_WORLD = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
_COORDINATES = {
    "lumbar_flexion": ("lumbar_extension", -1.0),
    "lumbar_bending": ("lumbar_bending", 1.0),
    "lumbar_rotation": ("lumbar_rotation", 1.0),
}
for _side in "lr":
    _COORDINATES |= {
        f"hip_flexion_{_side}": (f"hip_flexion_{_side}", 1.0),
        f"hip_adduction_{_side}": (f"hip_adduction_{_side}", 1.0),
        f"hip_rotation_{_side}": (f"hip_rotation_{_side}", 1.0),
        f"knee_flexion_{_side}": (f"knee_angle_{_side}", 1.0),
        f"ankle_dorsiflexion_{_side}": (f"ankle_angle_{_side}", 1.0),
        f"ankle_inversion_{_side}": (f"subtalar_angle_{_side}", 1.0),
        f"toe_extension_{_side}": (f"mtp_angle_{_side}", 1.0),
        f"shoulder_flexion_{_side}": (f"arm_flex_{_side}", 1.0),
        f"shoulder_abduction_{_side}": (f"arm_add_{_side}", -1.0),
        f"elbow_flexion_{_side}": (f"elbow_flex_{_side}", 1.0),
    }
_SIDES = {"r": "1", "l": "2"}


def write_opensim(recording: Recording, folder: Path) -> dict[str, int]:
    """Writes `motion.mot` (degrees, m), `ground_reactions.mot` (N, m, N m) and `external_loads.xml`.

    Joints without a counterpart in the model (neck, exoskeleton) keep their names. Ground reactions are forces
    at the centre of pressure with their free torque; without load they are 0.

    Args:
        recording: Needs the truth of the twin.
        folder: Where to write.

    Returns:
        Rows written, by file.

    Raises:
        RecordingError: The recording holds no true joint angles; real recordings do not.
    """
    for topic in ("/truth/joints", "/truth/pelvis/odometry"):
        if topic not in recording.topics:
            raise RecordingError(f"{recording.path}: no {topic}; valid: a recording of the twin, with its truth")
    counts = {MOTION: _write_motion(recording, folder / MOTION)}
    sides = [s for s in _SIDES if f"/truth/foot_{s}/wrench" in recording.topics]
    if sides:
        counts[LOADS] = _write_loads(recording, sides, folder / LOADS)
        (folder / TIES).write_text(_ties(sides), encoding="utf-8")
    return counts


def _write_motion(recording: Recording, path: Path) -> int:
    joints, pelvis = recording.block("/truth/joints"), recording.block("/truth/pelvis/odometry")
    at = np.clip(np.searchsorted(pelvis.t_ns, joints.t_ns), 0, len(pelvis) - 1)
    keep = pelvis.t_ns[at] == joints.t_ns
    at = at[keep]
    p = pelvis.columns["p_frame_in_world"][at] @ _R_OPENSIM_WORLD.T
    R = Rotation.from_quat(pelvis.columns["q_world_frame"][at], scalar_first=True).as_matrix()
    # the model's pelvis turns about its own z (tilt), then x (list), then y (rotation)
    turns = Rotation.from_matrix(_R_OPENSIM_WORLD @ R @ _R_OPENSIM_WORLD.T).as_euler("ZXY")
    names = ["pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz"]
    columns = [np.degrees(np.unwrap(turns, axis=0)), p]
    for i, name in enumerate(joints.constants["names"]):
        theirs, sign = _COORDINATES.get(name, (name, 1.0))
        names.append(theirs)
        columns.append(np.degrees(sign * joints.columns["position"][keep, i : i + 1]))
    return _write_mot(path, "motion", names, joints.t_ns[keep], np.column_stack(columns), in_degrees=True)


def _write_loads(recording: Recording, sides: list[str], path: Path) -> int:
    t_ns = recording.block(f"/truth/foot_{sides[0]}/wrench").t_ns
    names: list[str] = []
    columns: list[Array] = []
    for side in sides:
        names += [f"ground_force_{side}_{what}{axis}" for what in ("v", "p") for axis in "xyz"]
        names += [f"ground_torque_{side}_{axis}" for axis in "xyz"]
        columns += [part @ _R_OPENSIM_WORLD.T for part in _at_pressure_centre(recording, side, t_ns)]
    return _write_mot(path, "ground_reactions", names, t_ns, np.column_stack(columns), in_degrees=False)


def _at_pressure_centre(recording: Recording, side: str, t_ns: np.ndarray) -> tuple[Array, Array, Array]:
    """(N, 3) force, point and free torque, world axes, at the stamps; 0 where the foot bears nothing."""
    force, point, torque = (np.zeros((len(t_ns), 3)) for _ in range(3))
    if f"/truth/foot_{side}/cop" not in recording.topics:
        return force, point, torque
    wrench, foot = recording.block(f"/truth/foot_{side}/wrench"), recording.block(f"/truth/foot_{side}/odometry")
    cop = recording.block(f"/truth/foot_{side}/cop")
    common = np.intersect1d(np.intersect1d(t_ns, wrench.t_ns), np.intersect1d(foot.t_ns, cop.t_ns))
    rows, w, f, c = (np.searchsorted(t, common) for t in (t_ns, wrench.t_ns, foot.t_ns, cop.t_ns))
    force[rows] = wrench.columns["force_in_world"][w]
    point[rows] = cop.columns["p_in_world"][c]
    lever = foot.columns["p_frame_in_world"][f] - point[rows]
    torque[rows] = wrench.columns["torque_in_world"][w] + np.cross(lever, force[rows])
    return force, point, torque


def _write_mot(path: Path, name: str, columns: list[str], t_ns: np.ndarray, table: Array, *, in_degrees: bool) -> int:
    head = [name, "version=1", f"nRows={len(t_ns)}", f"nColumns={1 + len(columns)}"]
    head += [f"inDegrees={'yes' if in_degrees else 'no'}", "endheader", "\t".join(["time", *columns])]
    with path.open("w", encoding="ascii") as file:
        file.write("\n".join(head) + "\n")
        np.savetxt(file, np.column_stack((t_ns * 1e-9, table)), fmt="%.9g", delimiter="\t")
    return len(t_ns)


def _ties(sides: list[str]) -> str:
    forces = "".join(
        f"<ExternalForce name={quoteattr('ground_' + s)}><applied_to_body>calcn_{s}</applied_to_body>"
        "<force_expressed_in_body>ground</force_expressed_in_body>"
        "<point_expressed_in_body>ground</point_expressed_in_body>"
        f"<force_identifier>ground_force_{s}_v</force_identifier>"
        f"<point_identifier>ground_force_{s}_p</point_identifier>"
        f"<torque_identifier>ground_torque_{s}_</torque_identifier></ExternalForce>\n"
        for s in sides
    )
    return (
        '<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="40000"><ExternalLoads name="loads">'
        f"<objects>\n{forces}</objects><datafile>{LOADS}</datafile></ExternalLoads></OpenSimDocument>\n"
    )
