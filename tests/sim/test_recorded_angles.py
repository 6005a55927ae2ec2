"""Joint angles as recordings: OpenSim, BVH and AMASS files of a planned walk give the walk back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stridetwin.scenarios.scenario_file import scenario_of
from stridetwin.sim.config import Level, Motion, Person, Route, TwinConfig
from stridetwin.sim.motion.amass import read_amass
from stridetwin.sim.motion.bvh import read_bvh, read_hierarchy
from stridetwin.sim.motion.fit import FittedWalk, fit_markers, fit_segments, track_feet
from stridetwin.sim.motion.opensim import read_opensim
from stridetwin.sim.motion.read import NumberTable, read_markers, read_number_table
from stridetwin.sim.motion.skeleton import lengths_of
from stridetwin.sim.motion.source import apply_motion
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import ConfigError
from tests.mocap import MOCAP, needs_mocap
from tests.motion_files import LEG_M, PERSON, PlannedWalk, plan_walk, to_opensim, write_amass, write_bvh


def _assert_same(fitted: FittedWalk, planned: PlannedWalk, apart_mm: float, keeps_tilt: bool = True) -> None:
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


@pytest.mark.parametrize(
    ("rig", "unit_m", "seed"),
    [("motionbuilder", 0.01, None), ("xsens", 1.0, None), ("rokoko", 0.0254, 7), ("motionbuilder", 0.056444, 8)],
)
def test_bvh_gives_the_walk_back(tmp_path: Path, rig: str, unit_m: float, seed: int | None) -> None:
    planned = plan_walk()
    write_bvh(tmp_path / "walk.bvh", planned, rig, unit_m, seed)
    fitted = fit_segments(read_bvh(tmp_path / "walk.bvh", LEG_M), PERSON)
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
        read_bvh(path, LEG_M)
    assert field in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bvh_of_another_size_is_refused(tmp_path: Path) -> None:
    write_bvh(tmp_path / "walk.bvh", plan_walk(), "xsens", 1.0, None)
    text = (tmp_path / "walk.bvh").read_text()
    assert read_hierarchy(tmp_path / "walk.bvh").names[0] == "Hips"
    with pytest.raises(ConfigError, match="legs of"):
        read_bvh(tmp_path / "walk.bvh", 0.5 * LEG_M)
    (tmp_path / "walk.bvh").write_text(text.replace("Knee", "Gnee"))
    with pytest.raises(ConfigError, match="known rig"):
        read_bvh(tmp_path / "walk.bvh", LEG_M)


def test_amass_gives_the_walk_back(tmp_path: Path) -> None:
    planned = plan_walk()
    write_amass(tmp_path / "walk.npz", planned)
    fitted = fit_segments(read_amass(tmp_path / "walk.npz", LEG_M), replace(PERSON, height_m=1.80))
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
        read_amass(tmp_path / "walk.npz", LEG_M)
    assert field in str(caught.value)


def test_file_that_is_no_npz_is_refused(tmp_path: Path) -> None:
    (tmp_path / "walk.npz").write_text("nothing")
    with pytest.raises(ConfigError, match="npz"):
        read_amass(tmp_path / "walk.npz", LEG_M)
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with pytest.raises(ConfigError, match="trans"):
        read_amass(tmp_path / "other.npz", LEG_M)


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
    R = read_opensim(_table(**{coordinate: 0.2}), PERSON).R[body][0]
    vector = R[:, abs(axis)] * (-1.0 if axis < 0 else 1.0)
    target = abs(moves) if moves else 0
    sign = -1.0 if moves < 0 else 1.0
    assert sign * vector[target] == pytest.approx(np.sin(0.2), abs=0.02)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_knees_bend_backwards_in_every_model(sign: float) -> None:
    motion = read_opensim(_table(knee_angle_r=sign * np.linspace(0.05, 1.0, 30), knee_angle_l=sign * 0.1), PERSON)
    assert motion.R["shank_r"][-1, 0, 2] == pytest.approx(np.sin(1.0))  # the shank's upper end is in front


def test_joints_that_are_zero_were_not_measured() -> None:
    motion = read_opensim(_table(lumbar_extension=0.0, arm_flex_r=0.0), PERSON)
    assert "torso" not in motion.R
    assert "upper_arm_r" not in motion.R
    assert "torso" in read_opensim(_table(lumbar_extension=0.1), PERSON).R


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
        read_opensim(_table(**values), PERSON)
    assert field in str(caught.value)


def test_unknown_coordinates_are_refused() -> None:
    table = _table()
    table = replace(table, names=tuple(name.replace("pelvis", "hip") for name in table.names))
    with pytest.raises(ConfigError, match="pelvis_tilt"):
        read_opensim(table, PERSON)


def test_states_of_opensim_are_angles_too() -> None:
    table = _table(hip_flexion_r=0.3)
    paths = tuple(f"/jointset/joint/{name}/value" for name in table.names)
    motion = read_opensim(replace(table, names=paths), PERSON)
    np.testing.assert_allclose(motion.R["thigh_r"], read_opensim(table, PERSON).R["thigh_r"])


def test_opensim_gives_the_walk_back() -> None:
    planned = plan_walk()
    fitted = fit_segments(
        read_opensim(to_opensim(planned), replace(PERSON, height_m=1.80)), replace(PERSON, height_m=1.80)
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
    write_bvh(tmp_path / "walk.bvh", plan_walk(), "motionbuilder", 0.01, None)
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
    planned = plan_walk()
    write_amass(tmp_path / "walk.npz", planned)
    person = lengths_of(replace(PERSON, height_m=1.74))
    motion = Motion(file=str(tmp_path / "walk.npz"))
    config = TwinConfig(name="x", route=Route(segments=(Level(length_m=1.0),)), person=person, motion=motion)
    assert apply_motion(config)[0].person.segments == person.segments


@needs_mocap
def test_markers_and_angles_of_one_walk_agree() -> None:
    """The feet of a recording from its markers, and from the joint angles that its laboratory computed."""
    walks = (
        fit_markers(read_markers(MOCAP / "level_turn.trc.gz"), Person(height_m=1.75)),
        fit_segments(
            read_opensim(read_number_table(MOCAP / "level_turn_ik.mot.gz"), Person(height_m=1.75)),
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
