"""Joint angles as recordings: OpenSim, BVH and AMASS files of a planned walk give the walk back."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.real_walks import data_folder
from stridetwin.scenarios.scenario_file import scenario_of
from stridetwin.sim.config import Gait, Level, Motion, Person, Route, TwinConfig
from stridetwin.sim.motion.amass import JOINTS, read_amass
from stridetwin.sim.motion.bvh import read_bvh, read_hierarchy
from stridetwin.sim.motion.fit import FittedWalk, fit_markers, fit_segments, track_feet
from stridetwin.sim.motion.opensim import read_opensim
from stridetwin.sim.motion.read import NumberTable, read_markers, read_number_table
from stridetwin.sim.motion.skeleton import Skeleton, lengths_of
from stridetwin.sim.motion.source import apply_motion
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import ConfigError

_FOLDER = data_folder("mocap")
_DATA = (_FOLDER or Path()) / "mocap"
needs_data = pytest.mark.skipif(_FOLDER is None, reason="no recordings: set STRIDETWIN_DATA to their folder")
_PERSON = Person(height_m=1.70)
_LEG_M = 0.245 * 1.70 + 0.246 * 1.70
_HZ = 100.0
_FILE_AXES = np.array(
    [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
)  # x left, y up, z forward, of x forward, z up


@dataclass(frozen=True)
class _Planned:
    """A planned walk: the wearer without exoskeleton, coordinates (N, D), and orientations and places of bodies."""

    skeleton: Skeleton
    x: np.ndarray
    R: dict[str, np.ndarray]
    p: dict[str, np.ndarray]


@cache
def _planned() -> _Planned:
    config = TwinConfig(
        name="planned",
        route=Route(segments=(Level(length_m=5.0),)),
        person=_PERSON,
        exo=None,
        sensors=(),
        gait=Gait(speed_mps=1.2),
    )
    walk = Twin(config, 3).walk
    t = np.arange(0.0, walk.duration_s, 1.0 / _HZ)
    skeleton = Skeleton.of(lengths_of(_PERSON))
    names = walk.coordinates.names
    x = walk.splines(t)[:, [names.index(name) for name in skeleton.layout.names]]
    poses = skeleton.poses(x)
    return _Planned(
        skeleton=skeleton,
        x=x,
        R={body: poses.R[:, b] for b, body in enumerate(skeleton.bodies)},
        p={
            body: poses.p[:, b] + poses.R[:, b] @ skeleton.anchor[b] for b, body in enumerate(skeleton.bodies)
        },  # centres of the joints
    )


def _assert_same(fitted: FittedWalk, planned: _Planned, apart_mm: float, keeps_tilt: bool = True) -> None:
    """Leg joints within a degree before the feet are pinned, and the middle of the soles afterwards.

    The filter of 12 Hz rounds touch-downs, so that 2 % of the instants may be farther off, by less than two degrees.
    """
    for name in ("hip_flexion", "hip_adduction", "knee_flexion", "ankle_dorsiflexion"):
        for side in ("l", "r"):
            column = planned.skeleton.column(f"{name}_{side}")
            difference = np.degrees(fitted.x_unpinned - planned.x)[20:-20, column]
            if not keeps_tilt and name == "hip_flexion":
                difference -= difference.mean()
            assert np.percentile(np.abs(difference), 98) < 1.0, name
            assert np.abs(difference).max() < 2.0, name
    for mine, theirs in zip(track_feet(fitted.skeleton, fitted.x), track_feet(planned.skeleton, planned.x)):
        apart = (mine.point(0.05) - fitted.placement.shift) @ fitted.placement.matrix - theirs.point(0.05)
        apart[:, 2] -= np.median(apart[:, 2])  # files do not tell where the ground is
        assert 1e3 * np.sqrt(np.mean(np.sum(apart**2, axis=1))) < apart_mm


# --- BVH ---

_RIG_NAMES = {
    "motionbuilder": "mixamorig:{}UpLeg {}Leg {}Foot {}ToeBase {}Arm {}ForeArm {}Hand",
    "xsens": "{}Hip {}Knee {}Ankle {}Toe {}Shoulder {}Elbow {}Wrist",
    "rokoko": "{}Thigh {}Shin {}Foot {}Toe {}Arm {}ForeArm {}Hand",
}


def _write_bvh(path: Path, planned: _Planned, rig: str, unit_m: float, seed: int | None) -> None:
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
    path.write_text(f"{text}MOTION\nFrames: {len(table)}\nFrame Time: {1.0 / _HZ:.6f}\n{rows}\n")


@pytest.mark.parametrize(
    ("rig", "unit_m", "seed"),
    [("motionbuilder", 0.01, None), ("xsens", 1.0, None), ("rokoko", 0.0254, 7), ("motionbuilder", 0.056444, 8)],
)
def test_bvh_gives_the_walk_back(tmp_path: Path, rig: str, unit_m: float, seed: int | None) -> None:
    planned = _planned()
    _write_bvh(tmp_path / "walk.bvh", planned, rig, unit_m, seed)
    fitted = fit_segments(read_bvh(tmp_path / "walk.bvh", _LEG_M), _PERSON)
    _assert_same(fitted, planned, apart_mm=2.0, keeps_tilt=seed is None)
    assert fitted.person.segments is not None
    assert fitted.person.segments.thigh_m == pytest.approx(planned.skeleton.size.body.thigh_m, abs=1e-4)


_BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  End Site
  {
    OFFSET 0 1 0
  }
}
MOTION
Frames: 1
Frame Time: 0.01
0 0 0 0 0 0
"""


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("", "HIERARCHY"),
        ("nothing", "HIERARCHY"),
        (_BVH, "frames"),
        (_BVH.replace("Frames: 1", "Frames: 2"), "MOTION"),
        (_BVH.replace("Frames: 1", "Frames: 30").replace("0 0 0 0 0 0\n", "0 x 0 0 0 0\n" * 30), "MOTION"),
        (_BVH.replace("Frame Time: 0.01", "Frame Time: 0"), "Frame Time"),
        (_BVH.replace("OFFSET 0 1 0", "OFFSET 0 1"), "HIERARCHY"),
        (_BVH.replace("Zrotation", "Wrotation"), "CHANNELS"),
        (_BVH.replace("}\n}\nMOTION", "}\nMOTION"), "HIERARCHY"),
        (_BVH.replace("Frames: 1", "Frames: 30").replace("0 0 0 0 0 0\n", "0 0 0 0 0 0\n" * 30), "joints"),
        (_BVH.replace("Frames: 1", "Frames: 30").replace("0 0 0 0 0 0\n", "0 nan 0 0 0 0\n" * 30), "MOTION"),
    ],
)
def test_bad_bvh_is_one_line(tmp_path: Path, text: str, field: str) -> None:
    path = tmp_path / "walk.bvh"
    path.write_text(text)
    with pytest.raises(ConfigError, match="expected") as caught:
        read_bvh(path, _LEG_M)
    assert field in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bvh_of_another_size_is_refused(tmp_path: Path) -> None:
    _write_bvh(tmp_path / "walk.bvh", _planned(), "xsens", 1.0, None)
    text = (tmp_path / "walk.bvh").read_text()
    assert read_hierarchy(tmp_path / "walk.bvh").names[0] == "Hips"
    with pytest.raises(ConfigError, match="legs of"):
        read_bvh(tmp_path / "walk.bvh", 0.5 * _LEG_M)
    (tmp_path / "walk.bvh").write_text(text.replace("Knee", "Gnee"))
    with pytest.raises(ConfigError, match="known rig"):
        read_bvh(tmp_path / "walk.bvh", _LEG_M)


def _write_amass(path: Path, planned: _Planned) -> None:
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
        mocap_framerate=_HZ,
        betas=np.zeros(16),
        gender="neutral",
    )


def test_amass_gives_the_walk_back(tmp_path: Path) -> None:
    planned = _planned()
    _write_amass(tmp_path / "walk.npz", planned)
    fitted = fit_segments(read_amass(tmp_path / "walk.npz", _LEG_M), replace(_PERSON, height_m=1.80))
    _assert_same(fitted, planned, apart_mm=10.0)
    assert fitted.person.segments is not None  # found with the feet's rests, not from the height of the person
    assert fitted.person.segments.thigh_m == pytest.approx(planned.skeleton.size.body.thigh_m, abs=0.005)
    assert fitted.person.segments.shank_m == pytest.approx(planned.skeleton.size.body.shank_m, abs=0.005)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"poses": np.zeros((50, 100))}, "poses"),
        ({"poses": np.full((50, 72), np.nan)}, "poses"),
        ({"poses": np.full((50, 72), 90.0)}, "poses"),
        ({"poses": np.zeros((5, 72)), "trans": np.zeros((5, 3))}, "frames"),
        ({"trans": np.zeros((50, 2))}, "trans"),
        ({"mocap_framerate": 0.0}, "mocap_framerate"),
    ],
)
def test_bad_amass_is_one_line(tmp_path: Path, change: dict[str, object], field: str) -> None:
    arrays = {"poses": np.zeros((50, 72)), "trans": np.zeros((50, 3)), "mocap_framerate": 100.0} | change
    np.savez(tmp_path / "walk.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="expected") as caught:
        read_amass(tmp_path / "walk.npz", _LEG_M)
    assert field in str(caught.value)


def test_file_that_is_no_npz_is_refused(tmp_path: Path) -> None:
    (tmp_path / "walk.npz").write_text("nothing")
    with pytest.raises(ConfigError, match="npz"):
        read_amass(tmp_path / "walk.npz", _LEG_M)
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with pytest.raises(ConfigError, match="trans"):
        read_amass(tmp_path / "other.npz", _LEG_M)


_COORDINATES = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz") + tuple(
    f"{name}_{side}"
    for side in ("r", "l")
    for name in ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "ankle_angle", "subtalar_angle")
)


def _table(frames: int = 30, **values: float | np.ndarray) -> NumberTable:
    columns = {name: np.zeros(frames) for name in _COORDINATES} | {"pelvis_ty": np.full(frames, 0.95)}
    columns["knee_angle_r"] = np.linspace(0.0, 0.5, frames)
    columns |= {name: np.broadcast_to(value, frames) for name, value in values.items()}
    return NumberTable(
        source="walk.mot", names=tuple(columns), t=np.arange(frames) * 0.01, values=np.stack(list(columns.values()), 1)
    )


@pytest.mark.parametrize(
    ("coordinate", "body", "axis", "moves"),
    [
        # positive angle: where an axis of the body (x forward, y left, z up) goes
        ("hip_flexion_r", "thigh_r", -2, 0),  # the knee forward
        ("hip_flexion_l", "thigh_l", -2, 0),
        ("hip_adduction_r", "thigh_r", -2, 1),  # the right knee to the left
        ("hip_adduction_l", "thigh_l", -2, -1),
        ("hip_rotation_r", "thigh_r", 0, 1),  # the right thigh's front to the left
        ("hip_rotation_l", "thigh_l", 0, -1),
        ("ankle_angle_r", "foot_r", 0, 2),  # toes up
        ("ankle_angle_l", "foot_l", 0, 2),
        ("pelvis_tilt", "pelvis", 0, 2),
        ("pelvis_rotation", "pelvis", 0, 1),
        ("pelvis_list", "pelvis", 1, 2),
    ],
)
def test_signs_of_opensim(coordinate: str, body: str, axis: int, moves: int) -> None:
    R = read_opensim(_table(**{coordinate: 0.2}), _PERSON).R[body][0]
    vector = R[:, abs(axis)] * (-1.0 if axis < 0 else 1.0)
    target = abs(moves) if moves else 0
    sign = -1.0 if moves < 0 else 1.0
    assert sign * vector[target] == pytest.approx(np.sin(0.2), abs=0.02)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_knees_bend_backwards_in_every_model(sign: float) -> None:
    motion = read_opensim(_table(knee_angle_r=sign * np.linspace(0.05, 1.0, 30), knee_angle_l=sign * 0.1), _PERSON)
    assert motion.R["shank_r"][-1, 0, 2] == pytest.approx(np.sin(1.0))  # the shank's upper end is in front


def test_joints_that_are_zero_were_not_measured() -> None:
    motion = read_opensim(_table(lumbar_extension=0.0, arm_flex_r=0.0), _PERSON)
    assert "torso" not in motion.R
    assert "upper_arm_r" not in motion.R
    assert "torso" in read_opensim(_table(lumbar_extension=0.1), _PERSON).R


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ({"hip_flexion_r": 30.0}, "hip_flexion_r"),
        ({"knee_angle_r": 0.01}, "inDegrees=no"),
        ({"pelvis_ty": 950.0}, "pelvis_ty"),
        ({"hip_flexion_r": np.nan}, "NaN"),
    ],
)
def test_bad_angles_are_one_line(values: dict[str, float], field: str) -> None:
    with pytest.raises(ConfigError, match="expected") as caught:
        read_opensim(_table(**values), _PERSON)
    assert field in str(caught.value)


def test_unknown_coordinates_are_refused() -> None:
    table = _table()
    table = replace(table, names=tuple(name.replace("pelvis", "hip") for name in table.names))
    with pytest.raises(ConfigError, match="pelvis_tilt"):
        read_opensim(table, _PERSON)


def test_states_of_opensim_are_angles_too() -> None:
    table = _table(hip_flexion_r=0.3)
    paths = tuple(f"/jointset/joint/{name}/value" for name in table.names)
    motion = read_opensim(replace(table, names=paths), _PERSON)
    np.testing.assert_allclose(motion.R["thigh_r"], read_opensim(table, _PERSON).R["thigh_r"])


def _to_opensim(planned: _Planned) -> NumberTable:
    """Coordinates of a model whose knees bend in the negative direction; ankles by Gauss-Newton steps."""
    M = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    R = {body: M.T @ value @ M for body, value in planned.R.items()}
    values: dict[str, np.ndarray] = {}

    def turn(name: str, between: np.ndarray, signs: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> None:
        angles = Rotation.from_matrix(between).as_euler("ZXY")
        for label, column, sign in zip(name.split(), angles.T, signs):
            values[label] = sign * np.unwrap(column)

    turn("pelvis_tilt pelvis_list pelvis_rotation", R["pelvis"])
    turn("lumbar_extension lumbar_bending lumbar_rotation", np.swapaxes(R["pelvis"], 1, 2) @ R["torso"])
    hips = (planned.p["pelvis"] @ M) - R["pelvis"] @ [-0.0707, -0.0661, 0.0]
    values |= {f"pelvis_t{axis}": hips[:, k] for k, axis in enumerate("xyz")}
    for side, out in (("r", 1.0), ("l", -1.0)):
        thigh, shank, foot = (R[f"{body}_{side}"] for body in ("thigh", "shank", "foot"))
        turn(
            f"hip_flexion_{side} hip_adduction_{side} hip_rotation_{side}",
            np.swapaxes(R["pelvis"], 1, 2) @ thigh,
            (1.0, out, out),
        )
        values[f"knee_angle_{side}"] = Rotation.from_matrix(np.swapaxes(thigh, 1, 2) @ shank).as_rotvec()[:, 2]
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
        t=np.arange(len(planned.x)) / _HZ,
        values=np.stack(list(values.values()), 1),
    )


def test_opensim_gives_the_walk_back() -> None:
    planned = _planned()
    fitted = fit_segments(
        read_opensim(_to_opensim(planned), replace(_PERSON, height_m=1.80)), replace(_PERSON, height_m=1.80)
    )
    for name in ("hip_flexion", "hip_adduction", "knee_flexion"):
        for side in ("l", "r"):
            column = planned.skeleton.column(f"{name}_{side}")
            difference = np.degrees(fitted.x_unpinned - planned.x)[20:-20, column]
            assert np.percentile(np.abs(difference), 98) < 1.5, name
    assert fitted.person.segments is not None
    legs = fitted.person.segments.thigh_m + fitted.person.segments.shank_m
    assert legs == pytest.approx(planned.skeleton.size.body.thigh_m + planned.skeleton.size.body.shank_m, abs=0.01)


def test_twin_plays_joint_angles(tmp_path: Path) -> None:
    _write_bvh(tmp_path / "walk.bvh", _planned(), "motionbuilder", 0.01, None)
    node = {
        "description": "x",
        "motion": {"file": "walk.bvh", "angles": "bvh"},
        "sensors": ["foot_imu", "insole", "encoder"],
    }
    config = scenario_of(node, tmp_path / "walk.yaml").config
    again, fitted = apply_motion(config)
    assert again.person == config.person  # a configuration that was fitted already gives the same walk
    assert config.motion is not None
    np.testing.assert_array_equal(apply_motion(replace(config, motion=replace(config.motion)))[1].x, fitted.x)
    blocks = [block for blocks in Twin(config, 1).blocks() for block in blocks]
    assert {"/foot_l/imu", "/foot_r/insole", "/truth/joints"} <= {block.topic for block in blocks}
    with pytest.raises(ConfigError, match="opensim"):
        scenario_of(node | {"motion": {"file": "walk.bvh", "angles": "opensim"}}, tmp_path / "walk.yaml")
    with pytest.raises(ConfigError, match="no markers"):
        scenario_of(node | {"motion": {"file": "walk.bvh", "markers": "opencap"}}, tmp_path / "walk.yaml")


def test_given_lengths_are_kept(tmp_path: Path) -> None:
    planned = _planned()
    _write_amass(tmp_path / "walk.npz", planned)
    person = lengths_of(replace(_PERSON, height_m=1.74))
    motion = Motion(file=str(tmp_path / "walk.npz"))
    config = TwinConfig(name="x", route=Route(segments=(Level(length_m=1.0),)), person=person, motion=motion)
    assert apply_motion(config)[0].person.segments == person.segments


@needs_data
def test_markers_and_angles_of_one_walk_agree() -> None:
    """The feet of a recording from its markers, and from the joint angles that its laboratory computed."""
    walks = (
        fit_markers(read_markers(_DATA / "level_turn.trc.gz"), Person(height_m=1.75)),
        fit_segments(
            read_opensim(read_number_table(_DATA / "level_turn_ik.mot.gz"), Person(height_m=1.75)),
            Person(height_m=1.75),
        ),
    )
    soles = []
    for walk in walks:
        at = [track.point(0.05) for track in track_feet(walk.skeleton, walk.x)]
        plane = [(p - walk.placement.shift) @ walk.placement.matrix for p in at]
        soles.append([np.column_stack([xy[:, :2], p[:, 2]]) for xy, p in zip(plane, at)])
    for by_markers, by_angles in zip(*soles):
        assert np.sqrt(np.mean(np.sum((by_markers - by_angles) ** 2, axis=1))) < 0.015
