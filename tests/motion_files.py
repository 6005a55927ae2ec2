"""Files of joint angles, and of markers, that hold a planned walk, to be read again."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.sim.config import Gait, Level, Person, Route, Segment, TwinConfig
from stridetwin.sim.motion.amass import JOINTS
from stridetwin.sim.motion.marker_sets import MARKER_SETS, describe_site
from stridetwin.sim.motion.read import NumberTable
from stridetwin.sim.motion.skeleton import Skeleton, lengths_of
from stridetwin.sim.twin import Twin

PERSON = Person(height_m=1.70)
LEG_M = 0.245 * 1.70 + 0.246 * 1.70
HZ = 100.0
_FILE_AXES = np.array(
    [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
)  # x left, y up, z forward, of x forward, z up


@dataclass(frozen=True)
class PlannedWalk:
    """A planned walk: the wearer without exoskeleton, coordinates (N, D), and orientations and places of bodies."""

    skeleton: Skeleton
    x: np.ndarray
    R: dict[str, np.ndarray]
    p: dict[str, np.ndarray]


@cache
def plan_walk(segments: tuple[Segment, ...] = (Level(length_m=5.0),)) -> PlannedWalk:
    config = TwinConfig(
        name="planned",
        route=Route(segments=segments),
        person=PERSON,
        exo=None,
        sensors=(),
        gait=Gait(speed_mps=1.2),
    )
    walk = Twin(config, 3).walk
    t = np.arange(0.0, walk.duration_s, 1.0 / HZ)
    skeleton = Skeleton.of(lengths_of(PERSON))
    names = walk.coordinates.names
    x = walk.splines(t)[:, [names.index(name) for name in skeleton.layout.names]]
    poses = skeleton.poses(x)
    return PlannedWalk(
        skeleton=skeleton,
        x=x,
        R={body: poses.R[:, b] for b, body in enumerate(skeleton.bodies)},
        p={
            body: poses.p[:, b] + poses.R[:, b] @ skeleton.anchor[b] for b, body in enumerate(skeleton.bodies)
        },  # centres of the joints
    )


_RIG_NAMES = {
    "motionbuilder": "mixamorig:{}UpLeg {}Leg {}Foot {}ToeBase {}Arm {}ForeArm {}Hand",
    "xsens": "{}Hip {}Knee {}Ankle {}Toe {}Shoulder {}Elbow {}Wrist",
    "rokoko": "{}Thigh {}Shin {}Foot {}Toe {}Arm {}ForeArm {}Hand",
}


def write_bvh(path: Path, planned: PlannedWalk, rig: str, unit_m: float, seed: int | None) -> None:
    """A file of the walk; with a seed, each joint has axes of its own, so that zero angles are no posture."""
    rng = np.random.default_rng(seed)
    left, right = (_RIG_NAMES[rig].format(*[side] * 7).split() for side in ("Left", "Right"))
    shoe = planned.skeleton.size.shoe
    wrist = np.array([0.0, 0.0, -planned.skeleton.size.body.forearm_m])
    joints = [("Hips", None, "pelvis", planned.p["pelvis"])]
    for names, side in ((left, "l"), (right, "r")):
        bodies = ("thigh", "shank", "foot", "foot")
        toe = planned.p[f"foot_{side}"] + planned.R[f"foot_{side}"] @ [shoe.toe_hinge_x - 0.02, 0.0, -0.07]
        places = [*(planned.p[f"{body}_{side}"] for body in bodies[:3]), toe]
        for k in range(4):
            joints.append((names[k], "Hips" if k == 0 else names[k - 1], f"{bodies[k]}_{side}", places[k]))
    joints.append(("Spine", "Hips", "torso", planned.p["torso"]))
    for names, side in ((left, "l"), (right, "r")):
        hand = planned.p[f"forearm_{side}"] + planned.R[f"forearm_{side}"] @ wrist
        places = [planned.p[f"upper_arm_{side}"], planned.p[f"forearm_{side}"], hand]
        for k, body in enumerate(("upper_arm", "forearm", "forearm")):
            joints.append((names[4 + k], "Spine" if k == 0 else names[3 + k], f"{body}_{side}", places[k]))
    R = {}
    for name, _, body, _ in joints:
        own = np.eye(3) if seed is None else Rotation.random(random_state=rng).as_matrix()
        R[name] = _FILE_AXES @ planned.R[body] @ _FILE_AXES.T @ own
    p = {name: place @ _FILE_AXES.T / unit_m for name, _, _, place in joints}
    children = {name: [child for child, up, _, _ in joints if up == name] for name, *_ in joints}
    carrier = {name: up for name, up, *_ in joints}
    order: list[str] = []

    def head(name: str, indent: str) -> str:
        order.append(name)
        up = carrier[name]
        place = np.zeros(3) if up is None else np.einsum("nji,nj->ni", R[up], p[name] - p[up]).mean(0)
        channels = (
            "6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
            if up is None
            else "3 Zrotation Xrotation Yrotation"
        )
        text = f"{indent}{'ROOT' if up is None else 'JOINT'} {name}\n{indent}{{\n"
        text += f"{indent} OFFSET {place[0]:.6f} {place[1]:.6f} {place[2]:.6f}\n"
        text += f"{indent} CHANNELS {channels}\n" + "".join(head(child, indent + " ") for child in children[name])
        if not children[name]:
            text += f"{indent} End Site\n{indent} {{\n{indent}  OFFSET 0 0 0.1\n{indent} }}\n"
        return text + f"{indent}}}\n"

    text = "HIERARCHY\n" + head("Hips", "")
    columns = [p["Hips"]]
    for name in order:
        up = carrier[name]
        local = R[name] if up is None else np.swapaxes(R[up], 1, 2) @ R[name]
        columns.append(Rotation.from_matrix(local).as_euler("ZXY", degrees=True))
    table = np.hstack(columns)
    rows = "\n".join(" ".join(f"{v:.5f}" for v in row) for row in table)
    path.write_text(f"{text}MOTION\nFrames: {len(table)}\nFrame Time: {1.0 / HZ:.6f}\n{rows}\n")


def write_amass(path: Path, planned: PlannedWalk) -> None:
    names, bodies = [name for name, _, _ in JOINTS], {}
    for side, word in (("l", "Left"), ("r", "Right")):
        for joint, body in (
            ("Hip", "thigh"),
            ("Knee", "shank"),
            ("Ankle", "foot"),
            ("Shoulder", "upper_arm"),
            ("Elbow", "forearm"),
        ):
            bodies[word + joint] = f"{body}_{side}"
    places = {name: np.array(place) for name, _, place in JOINTS}
    next_joint = {"Hip": "Knee", "Knee": "Ankle", "Ankle": "Toe", "Shoulder": "Elbow", "Elbow": "Wrist"}
    n, Q, local = len(planned.x), {}, []
    for name, up, _ in JOINTS:
        body = bodies.get(name)
        if name == "Hips":
            Q[name] = planned.R["pelvis"] @ _FILE_AXES.T
        elif name == "Spine3":
            Q[name] = planned.R["torso"] @ _FILE_AXES.T
        elif body is None:
            Q[name] = Q[names[up]]
        else:
            side = "Left" if name.startswith("Left") else "Right"
            along = places[side + next_joint[name.removeprefix(side)]]
            if body.startswith("foot"):
                x, z = along * [1.0, 0.0, 1.0], np.array([0.0, 1.0, 0.0])
                x /= np.linalg.norm(x)
                A = np.column_stack([x, np.cross(z, x), z])
            else:
                z = -along / np.linalg.norm(along)
                y = np.array([1.0, 0.0, 0.0]) if "arm" not in body else np.array([0.0, 0.0, 1.0])
                y -= (y @ z) * z
                y /= np.linalg.norm(y)
                A = np.column_stack([np.cross(y, z), y, z])
            Q[name] = planned.R[body] @ A.T
        turned = Q[name] if up < 0 else np.swapaxes(Q[names[up]], 1, 2) @ Q[name]
        local.append(Rotation.from_matrix(turned).as_rotvec())
    hips = 0.5 * (places["LeftHip"] + places["RightHip"])
    poses = np.zeros((n, 156))
    poses[:, :66] = np.hstack(local)
    np.savez(
        path,
        poses=poses,
        trans=planned.p["pelvis"] - Q["Hips"] @ hips,
        mocap_framerate=HZ,
        betas=np.zeros(16),
        gender="neutral",
    )


_MARKERS = ("C7", "CLAV", "SHO", "ELB", "WRA", "WRB", "ASI", "PSI", "THI", "KNE", "KNM", "TIB", "ANK", "MED", "HEE",
            "TOE", "MT5", "MT1")  # fmt: skip


def write_trc(path: Path, planned: PlannedWalk, seed: int) -> None:
    """Markers of Plug-in-Gait, each beside its usual place, with noise of 0.5 mm."""
    rng = np.random.default_rng(seed)
    names, paths = [], []
    poses = planned.skeleton.poses(planned.x)
    for label in _MARKERS:
        for side in ("",) if label in ("C7", "CLAV") else ("l", "r"):
            marker = describe_site(MARKER_SETS["plug_in_gait"][label], side)
            place = marker.place_m + rng.normal(0.0, min(0.3 * marker.sd_m, 0.01), 3)
            names.append(side.upper() + label)
            body = np.array([planned.skeleton.index(marker.body)])
            paths.append(planned.skeleton.points(poses, body, place[None])[:, 0])
    x = np.stack(paths, axis=1) + rng.normal(0.0, 0.0005, (len(planned.x), len(paths), 3))
    head = ["PathFileType\t4\t(X/Y/Z)\twalk.trc", "DataRate\tNumFrames\tNumMarkers\tUnits"]
    head += [f"{HZ:g}\t{len(x)}\t{len(names)}\tm", "Frame#\tTime\t" + "\t\t\t".join(names), ""]
    rows = [f"{i + 1}\t{i / HZ:.3f}\t" + "\t".join(f"{v:.5f}" for v in row.ravel()) for i, row in enumerate(x)]
    path.write_text("\n".join(head + rows) + "\n")


def to_opensim(planned: PlannedWalk) -> NumberTable:
    """Coordinates of a model whose knees are hinges, and whose ankles are 8 mm inward of the middle of the sole.

    Ankles follow by Gauss-Newton steps.
    """
    M = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    R = {body: M.T @ value @ M for body, value in planned.R.items()}
    values: dict[str, np.ndarray] = {}

    def turn(name: str, between: np.ndarray, signs: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> None:
        angles = Rotation.from_matrix(between).as_euler("ZXY")
        for label, column, sign in zip(name.split(), angles.T, signs):
            values[label] = sign * np.unwrap(column)

    turn("pelvis_tilt pelvis_list pelvis_rotation", R["pelvis"])
    turn("lumbar_extension lumbar_bending lumbar_rotation", np.swapaxes(R["pelvis"], 1, 2) @ R["torso"])
    hips = (planned.p["pelvis"] @ M) - R["pelvis"] @ [-0.0563, -0.0785, 0.0]
    values |= {f"pelvis_t{axis}": hips[:, k] for k, axis in enumerate("xyz")}
    for side, out in (("r", 1.0), ("l", -1.0)):
        thigh, shank, foot = (R[f"{body}_{side}"] for body in ("thigh", "shank", "foot"))
        body = planned.skeleton.size.body
        inward = Rotation.from_rotvec([out * 0.008 / (body.thigh_m + body.shank_m), 0.0, 0.0]).as_matrix()
        shank, thigh = thigh @ inward @ np.swapaxes(thigh, 1, 2) @ shank, thigh @ inward
        turn(
            f"hip_flexion_{side} hip_adduction_{side} hip_rotation_{side}",
            np.swapaxes(R["pelvis"], 1, 2) @ thigh,
            (1.0, out, out),
        )
        values[f"knee_angle_{side}"] = -Rotation.from_matrix(np.swapaxes(thigh, 1, 2) @ shank).as_rotvec()[:, 2]
        axes = np.array([[-0.105 * out, -0.174 * out, 0.979], [0.787 * out, 0.605 * out, -0.121]])
        angles = np.zeros((len(foot), 2))
        for _ in range(5):
            now = Rotation.from_rotvec(angles[:, :1] * axes[0]) * Rotation.from_rotvec(angles[:, 1:] * axes[1])
            off = (Rotation.from_matrix(np.swapaxes(shank, 1, 2) @ foot) * now.inv()).as_rotvec()
            angles += off @ np.linalg.pinv(axes.T).T
        values[f"ankle_angle_{side}"], values[f"subtalar_angle_{side}"] = angles.T
    return NumberTable(
        source="walk.mot",
        names=tuple(values),
        t=np.arange(len(planned.x)) / HZ,
        values=np.stack(list(values.values()), 1),
    )
