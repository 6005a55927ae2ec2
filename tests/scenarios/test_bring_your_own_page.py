"""The commands and files of docs/bring_your_own.md, as they stand there; and what OpenSim gets of the walk."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from stridetwin.cli.main import main
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.yaml_file import parse_yaml

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "bring_your_own.md").read_text()
WORLD = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # world axes (columns x, y, z of OpenSim)
MASS_KG = 75.0 + 12.6  # the person and examples/own_exo


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where every command of the page has been run."""
    folder = tmp_path_factory.mktemp("own")
    for file in (ROOT / "examples" / "own_exo").glob("my_exo.*"):
        shutil.copy(file, folder)
    for text in re.findall(r"```yaml\n(# (\w+\.yaml)\n.*?)```", PAGE, re.DOTALL):
        (folder / text[1]).write_text(text[0])
    blocks = [(-1.0, 2.0, 0.0), (2.0, 2.3, 0.15), (2.3, 6.0, 0.30)]
    boxes = [trimesh.creation.box(bounds=[(a, -1, -1), (b, 1, top)]) for a, b, top in blocks]
    mesh = trimesh.util.concatenate(boxes)
    mesh.apply_scale(1000.0)
    mesh.export(folder / "stairs.stl")
    return folder


@pytest.fixture(scope="module")
def outcomes(folder):
    commands = re.findall(r"^\$ stridetwin (.*)$", PAGE, re.MULTILINE)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return {c: main(c.split()) for c in commands}


def test_every_command_of_the_page_works(outcomes):
    assert len(outcomes) == 5
    assert set(outcomes.values()) == {0}


def test_files_of_the_page_are_those_of_the_example(folder):
    assert (folder / "walk.yaml").exists()
    rig = next(t for t in re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL) if "cuffs:" in t)
    shown, example = (parse_yaml(t, "rig") for t in (rig, (ROOT / "examples/own_exo/my_exo.yaml").read_text()))
    assert set(shown) == set(example)
    assert shown["motors"]["hip_l"]["torque_max_nm"] == example["motors"]["hip_l"]["torque_max_nm"]


def test_the_part_and_the_mesh_are_what_was_walked_with(folder, outcomes):
    recording = Recording(folder / "stairs.mcap")
    sonar = recording.rig.others["/foot_l/sonar"]
    assert (sonar.part, sonar.rate_hz) == ("My ranger", 20.0)
    assert sonar.parameters["range_max_m"] == 4.0
    terrain = recording.block("/truth/footprints").columns["terrain"].tolist()
    assert "stair" in terrain
    heights = recording.block("/truth/footprints").columns["p_foot_in_world"][:, 2]
    assert heights[-1] == pytest.approx(0.30, abs=0.002)


def mot(path):
    lines = path.read_text().splitlines()
    end = lines.index("endheader")
    table = np.array([line.split("\t") for line in lines[end + 2 :]], dtype=float)
    return dict(zip(lines[end + 1].split("\t"), table.T)), dict(line.split("=") for line in lines[1:end])


@pytest.mark.parametrize(
    ("made", "force", "torque"),
    [
        ("opensim", ("ground_force_r_", "ground_force_l_"), ("ground_torque_r_", "ground_torque_l_")),
        ("opensim_2392", ("ground_force_", "1_ground_force_"), ("ground_torque_", "1_ground_torque_")),
    ],
)
def test_opensim_gets_where_the_ground_bears_whom(folder, outcomes, made, force, torque):
    force, torque = (dict(zip("rl", names)) for names in (force, torque))
    loads, head = mot(folder / made / "ground_reactions.mot")
    assert (head["nRows"], head["nColumns"]) == (str(len(loads["time"])), str(len(loads)))
    step = np.diff(loads["time"])
    assert step == pytest.approx(np.full(len(step), 0.005), abs=1e-6)
    up = sum(loads[f"{force[s]}vy"] for s in "rl")
    assert up.mean() / 9.81 == pytest.approx(MASS_KG, rel=0.005)
    assert up[:50].mean() / 9.81 == pytest.approx(MASS_KG, rel=0.02)  # he stands
    fore = sum(loads[f"{force[s]}vx"] for s in "rl")
    assert abs(fore.mean()) < 0.01 * up.mean()
    recording = Recording(folder / "walk.mcap")
    for side in "rl":
        foot = recording.block(f"/truth/foot_{side}/odometry")
        rows = np.searchsorted(foot.t_ns, np.rint(loads["time"] * 1e9).astype(np.int64))
        R = Rotation.from_quat(foot.columns["q_world_frame"][rows], scalar_first=True).as_matrix()
        point = np.column_stack([loads[f"{force[side]}p{a}"] for a in "xyz"]) @ WORLD.T
        inside = np.einsum("nji,nj->ni", R, point - foot.columns["p_frame_in_world"][rows])
        on = loads[f"{force[side]}vy"] > 20.0
        assert on.mean() > 0.4
        sole = (inside[:, 0] > -0.047) & (inside[:, 0] < 0.228) & (np.abs(inside[:, 1]) < 0.040)
        assert sole[on].mean() > 0.99  # instants of the truth itself leave it, where straps take up a jolt
        free = np.column_stack([loads[f"{torque[side]}{a}"] for a in "xyz"])[on]
        assert np.abs(free[:, [0, 2]]).max() < 1.0  # about the level's axes there is none at the centre of pressure


def test_opensim_knees_bend_the_way_of_their_model(folder, outcomes):
    ours, head = mot(folder / "opensim" / "motion.mot")
    theirs, _ = mot(folder / "opensim_2392" / "motion.mot")
    assert head["inDegrees"] == "yes"
    names = (
        "pelvis_tilt",
        "pelvis_list",
        "pelvis_rotation",
        "pelvis_tx",
        "pelvis_ty",
        "pelvis_tz",
        "lumbar_extension",
        "lumbar_bending",
        "lumbar_rotation",
        *(
            f"{j}_{s}"
            for s in "rl"
            for j in (
                "hip_flexion",
                "hip_adduction",
                "hip_rotation",
                "knee_angle",
                "ankle_angle",
                "subtalar_angle",
                "mtp_angle",
            )
        ),
    )
    assert set(names) <= set(theirs)
    for side in "rl":
        assert ours[f"knee_angle_{side}"].max() > 50.0
        np.testing.assert_allclose(theirs[f"knee_angle_{side}"], -ours[f"knee_angle_{side}"], atol=1e-6)
        np.testing.assert_allclose(theirs[f"hip_flexion_{side}"], ours[f"hip_flexion_{side}"], atol=1e-6)
    assert ours["pelvis_tx"][-1] - ours["pelvis_tx"][0] == pytest.approx(1.5, abs=0.1)  # forward is x
    pelvis = Recording(folder / "walk.mcap").block("/truth/pelvis/odometry").columns["p_frame_in_world"][0]
    lift, ahead = ours["pelvis_ty"][0] - pelvis[2], ours["pelvis_tx"][0] - pelvis[0]
    assert np.hypot(lift, ahead) == pytest.approx(np.hypot(0.07849, 0.056276), abs=0.002)  # Rajagopal2015.osim
    assert min(lift, ahead) > 0.05  # above the hips and before them
