"""An exoskeleton of the user's own, MJCF or URDF with a rig file: walks, load on the wearer, and errors."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from stridetwin.scenarios.scenario_file import read_scenario
from stridetwin.sim.config import Dynamics, Exo, Gait, Level, Route, TwinConfig
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.exo_body import add_own_exo
from stridetwin.sim.wearer.own_exo_model import files_of
from stridetwin.sim.wearer.own_exo_rig import read_own_exo
from stridetwin.streams.errors import ConfigError, StrideTwinError

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_exo"
MODEL, URDF, RIG = EXAMPLE / "my_exo.xml", EXAMPLE / "my_exo.urdf", EXAMPLE / "my_exo.yaml"
MASS_KG = 3.2 + 2 * (0.7 + 2.1 + 1.3 + 0.6)  # as both files say
GROUPS = ("ahrs", "exo_imu", "encoder", "interaction", "actuator", "insole")


def walked(model, physics, length_m):
    config = TwinConfig(
        name="own",
        route=Route(segments=(Level(length_m=length_m),)),
        physics=physics,
        sensors=GROUPS,
        gait=Gait(stand_s=0.5),
        exo=Exo(user_exo=read_own_exo(model, RIG)),
        dynamics=Dynamics() if physics == "dynamic" else None,
    )
    twin, columns = Twin(config, seed=1), {}
    for blocks in twin.blocks():
        for block in blocks:
            if hasattr(block, "columns"):
                for name, values in block.columns.items():
                    columns.setdefault((block.topic, name), []).append(values)
                if block.topic == "/truth/joints":
                    names = block.constants["names"]
    streams = {key: np.concatenate(values) for key, values in columns.items()}
    streams["joints"] = dict(zip(names, streams["/truth/joints", "position"].T))
    return twin, streams


@pytest.fixture(scope="module")
def kinematic():
    return walked(MODEL, "kinematic", 1.5)


@pytest.fixture(scope="module")
def dynamic():
    return walked(URDF, "dynamic", 1.0)


@pytest.fixture(params=["kinematic", "dynamic"])
def walk(request):
    return request.getfixturevalue(request.param)


def test_mjcf_and_urdf_say_the_same():
    a, b = (read_own_exo(path, RIG) for path in (MODEL, URDF))
    for one, other in zip([a.base, *a.legs["l"], *a.legs["r"]], [b.base, *b.legs["l"], *b.legs["r"]], strict=True):
        assert (one.name, one.joint, one.mass) == (other.name, other.joint, pytest.approx(other.mass))
        for field in ("offset", "axis", "stops", "com", "inertia", "damping", "friction"):
            np.testing.assert_allclose(getattr(one, field), getattr(other, field), atol=1e-6, err_msg=field)
        assert one.shapes
        assert other.shapes
    assert sum(link.mass for leg in a.legs.values() for link in leg) + a.base.mass == pytest.approx(MASS_KG)


def test_it_loads_the_person(walk):
    twin, streams = walk
    assert twin.fell_at is None
    assert twin.model.body_subtreemass[1] == pytest.approx(75.0 + MASS_KG, abs=0.01)
    vertical = sum(streams[f"/truth/foot_{side}/wrench", "force_in_world"][:, 2] for side in "lr")
    assert vertical.mean() / 9.81 == pytest.approx(75.0 + MASS_KG, rel=0.01)  # from rest to rest
    assert np.abs(streams["/truth/root_residual", "force_in_world"]).max() < 1e-6


def test_its_joints_follow_the_wearer(walk):
    """The knee's axis goes with the wearer's; the hip turns about two axes where the wearer has three."""
    _, streams = walk
    joints = streams["joints"]
    for side in "lr":
        for ours, theirs in (("exo_knee_flexion", "knee_flexion"), ("exo_ankle_flexion", "ankle_dorsiflexion")):
            apart = joints[f"{ours}_{side}"] - joints[f"{theirs}_{side}"]
            assert np.degrees(np.sqrt(np.mean(apart**2))) < 6.0, (ours, side)
            assert np.ptp(joints[f"{theirs}_{side}"]) > np.radians(20)
        assert np.all(np.abs(joints[f"exo_abduction_{side}"]) < np.radians(15))


def test_its_sensors_say_what_it_does(kinematic):
    twin, streams = kinematic
    for name in ("hip_l", "knee_r", "ankle_l"):
        joint, side = name.split("_")
        truth, sensed = streams["joints"][f"exo_{joint}_flexion_{side}"], streams[f"/exo/{name}/encoder", "angle"]
        assert (sensed.min(), sensed.max()) == pytest.approx((truth.min(), truth.max()), abs=0.02)
    assert {t for t in twin.rig.others if t.endswith("ahrs")} == {
        f"/exo/{p}/ahrs" for p in ("back", "thigh_l", "thigh_r", "foot_l", "foot_r")
    }
    imu = twin.rig.imus["/exo/shank_l/imu"]
    assert imu.part.startswith("MPU-9250") or "9250" in imu.part
    assert imu.mount.body == "exo_shank_bar_l"
    np.testing.assert_allclose(imu.mount.T_body_sensor[:3, 3], [0, 0.010, -0.300], atol=1e-9)
    np.testing.assert_allclose(imu.mount.T_body_sensor[:3, 0], [0, 1, 0], atol=1e-9)
    force = streams["/exo/thigh_l/interaction", "force"]
    assert 5.0 < force.max() < 400.0  # the straps pull
    limits = twin.rig.others["/exo/hip_l/actuator"].parameters
    assert (limits["torque_max_nm"], limits["speed_max_radps"]) == (40.0, 7.0)


def test_a_scenario_names_model_and_rig():
    config = read_scenario(EXAMPLE / "walk.yaml").config
    assert config.exo.user_exo.description == "Four joints a leg, motors at hips and knees"


def test_a_mesh_may_be_flat(tmp_path):
    flat = '<mesh name="flat" inertia="shell" vertex="0 0 0 .1 0 0 0 .1 0 .1 .1 0" face="0 1 2 1 3 2"/>'
    geom = '<geom type="mesh" mesh="flat" pos="0.1 0.2 0.3" euler="0.3 0 0" contype="0" conaffinity="0"/>'
    text = MODEL.read_text().replace("<asset>", "<asset>" + flat)
    (tmp_path / "my_exo.xml").write_text(text.replace('<body name="yoke_l"', geom + '<body name="yoke_l"'))
    own = read_own_exo(tmp_path / "my_exo.xml", RIG)
    spec = mujoco.MjSpec()
    add_own_exo(spec, spec.worldbody.add_body(name="pelvis"), own)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    g = next(g for g in range(model.ngeom) if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH)
    corners = data.geom_xpos[g] + model.mesh_vert @ data.geom_xmat[g].reshape(3, 3).T
    c, s = np.cos(0.3), np.sin(0.3)
    expected = [[0.1 + x, 0.2 + c * y, 0.3 + s * y] for x in (0, 0.1) for y in (0, 0.1)]
    np.testing.assert_allclose(sorted(np.round(corners, 6).tolist()), expected, atol=1e-6)


def test_an_axis_may_lie_aslant(tmp_path):
    text = MODEL.read_text().replace('name="ankle_l" axis="0 -1 0"', 'name="ankle_l" axis="0.4 -1 0.3"')
    (tmp_path / "my_exo.xml").write_text(text)
    assert read_own_exo(tmp_path / "my_exo.xml", RIG).legs["l"][-1].axis[0] == pytest.approx(0.4 / np.sqrt(1.25))


@pytest.mark.parametrize(
    ("mesh", "compiler", "file"),
    [
        ("<mesh filename='meshes/back.stl'/>", "", "meshes/back.stl"),
        ('<mesh scale="1 1 1" filename = "meshes/a&amp;b.stl"/>', "", "meshes/a&b.stl"),
        ('<!-- <mesh filename="old.stl"/> --><mesh filename="meshes/back.stl"/>', "", "meshes/back.stl"),
        ('<mesh filename="back.stl"/>', '<compiler meshdir="meshes" discardvisual="false"/>', "meshes/back.stl"),
    ],
)
def test_meshes_of_a_urdf_are_files_of_it(tmp_path, mesh, compiler, file):
    text = URDF.read_text().replace('<box size="0.06 0.20 0.26"/>', mesh)
    if compiler:
        text = text.replace("</robot>", f"<mujoco>{compiler}</mujoco></robot>")
    (tmp_path / "my_exo.urdf").write_text(text)
    assert files_of(tmp_path / "my_exo.urdf") == [file]


def test_entities_of_a_urdf_are_not_expanded(tmp_path):
    text = URDF.read_text().replace('<box size="0.06 0.20 0.26"/>', '<mesh filename="&x;.stl"/>')
    text = text.replace("<robot", '<!DOCTYPE robot [<!ENTITY x SYSTEM "my_exo.urdf">]><robot')
    (tmp_path / "my_exo.urdf").write_text(text)
    assert files_of(tmp_path / "my_exo.urdf") == ["&x;.stl"]


LEFT = '<joint name="knee_l" axis="0 1 0" range="-0.15 1.95" damping="0.5" frictionloss="0.7" armature="0.08"/>'
REFUSED = {
    "closed chain": (
        ("</worldbody>", '</worldbody><equality><connect body1="yoke_l" body2="yoke_r" anchor="0 0 0"/></equality>'),
        r"my_exo\.xml: equality: invalid 'unnamed': expected no closed chains",
    ),
    "slide": (
        ('joint name="knee_l"', 'joint type="slide" name="knee_l"'),
        "joint knee_l of shank_bar_l: invalid 'slide': expected hinge",
    ),
    "two joints": (
        (LEFT, LEFT + '<joint name="more" axis="1 0 0"/>'),
        "invalid '2 joints': expected one hinge a link",
    ),
    "negative mass": (('mass="1.3"', 'mass="-1.3"'), r"my_exo\.xml: MuJoCo cannot compile it: .*mass"),
    "spring": ((LEFT, LEFT[:-2] + ' stiffness="5"/>'), "stiffness: .* expected 0: no springs"),
    "range without 0": (
        ('range="-0.15 1.95"', 'range="0.15 1.95"'),
        "knee_l of shank_bar_l, range: .* expected a range with 0",
    ),
    "no joint": ((LEFT, ""), r"chains of hinges on the base, joints of each: invalid \[3, 4\]"),
    "free base": (
        ('<body name="backpack" pos="0 0 0.95">', '<body name="backpack" pos="0 0 0.95"><freejoint/>'),
        "invalid 'free': expected hinge",
    ),
    "missing mesh": (("<asset>", '<asset><mesh name="m" file="gone.stl"/>'), r"cannot compile it: .*gone\.stl"),
    "include": (("<asset>", '<include file="/etc/passwd"/><asset>'), "include: invalid '<include>'"),
    "heavy": (('mass="3.2"', 'mass="320"'), r"mass: invalid 329\.4: expected 0\.05-60 kg"),
    "mirrored axis": (
        ('name="hip_l" axis="0 -1 0"', 'name="hip_l" axis="0 1 0"'),
        r"my_exo\.xml: joint hip_l, axis: invalid \[0\.0, 1\.0, 0\.0\]: expected within 60 deg of \[0, -1, 0\]",
    ),
    "bent backwards": (
        ('name="knee_l" axis="0 1 0"', 'name="knee_l" axis="0 -1 0"'),
        r"joint knee_l, axis: .* within 60 deg of \[0, 1, 0\] .* joints\.knee_l of .*my_exo\.yaml",
    ),
    "across": (
        ('name="ankle_l" axis="0 -1 0"', 'name="ankle_l" axis="1 0 0"'),
        "joint ankle_l, axis: .* flexion positive",
    ),
    "link without a name": (
        ('<body name="yoke_l" ', "<body "),
        "link of joint abduction_l: invalid '': expected a name",
    ),
    "links alike": (
        ('<body name="yoke_l" ', '<body name="yoke-r" '),
        r"my_exo\.xml: link: invalid '\w+.r': expected another name: \w+.r is exo_yoke_r in the wearer's model, too",
    ),
    "joints alike": (
        ('joint name="abduction_l"', 'joint name="hip_flexion_l"'),
        "joint: invalid 'hip_l': expected another name: hip_flexion_l is exo_hip_flexion_l",
    ),
    "no XML": (("<mujoco", "<mojo"), r"my_exo\.xml: MuJoCo cannot compile it"),
}


@pytest.mark.parametrize("name", list(REFUSED))
def test_models_that_cannot_be_worn_are_refused(tmp_path, name):
    (old, new), said = REFUSED[name]
    text = MODEL.read_text()
    assert old in text
    (tmp_path / "my_exo.xml").write_text(text.replace(old, new, 1))
    with pytest.raises(StrideTwinError, match=said):
        read_own_exo(tmp_path / "my_exo.xml", RIG)


HEEL = "at_mm: [-20, 120, -65]"
RIG_REFUSED = [
    (
        "link: backpack, pos",
        "link: rucksack, pos",
        "base: invalid 'rucksack': expected a link of the model: backpack",
    ),
    ("l: {link: thigh_bar_l", "l: {link: thigh", r"cuffs\.thigh_l\.link: invalid 'thigh': expected a link"),
    (
        "thigh_l: {link: thigh_bar_l, at",
        "arm_l: {link: thigh_bar_l, at",
        r"cuffs: invalid 'arm_l': expected keys thigh_l",
    ),
    ("thigh_l: {link: thigh_bar_l, at", "thigh_l: {link: thigh_bar_r, at", "the wearer's"),
    (HEEL, "at_mm: [-20, 120]", r"at_mm: invalid \[-20, 120\]: expected a list of three items"),
    (HEEL, HEEL + ", stiffness_n_m: [1, 2, -3]", r"stiffness_n_m\[2\]: invalid -3: expected 0-100000"),
    ("hip_l: hip_l,", "hip_l: hip_x,", r"joints\.hip_l: invalid 'hip_x': expected a hinge of"),
    ("hip_l: hip_l,", "hip_l: hip_r,", "every joint once"),
    ("torque_max_nm: 40", "torque_max_nm: 0", r"motors\.hip_l\.torque_max_nm: invalid 0: expected a number above 0"),
    (
        "part: actuation-module",
        "part: MPU-9250",
        r"motors\.knee_l\.part: invalid 'MPU-9250': expected actuation-mod",
    ),
    ("encoders: [hip_l", "encoders: [hip", r"encoders\[0\]: invalid 'hip': expected one of the joints hip_l"),
    ("encoders: [hip_l", "encoders: [[hip_l]", r"encoders\[0\]: invalid \['hip_l'\]: expected text"),
    ("l: {link: thigh_bar_l", "l: {link: [thigh_bar_l]", r"cuffs\.thigh_l\.link: invalid \['thigh_bar_l'\]"),
    ("description:", "descripton:", r"invalid 'descripton': expected keys description"),
]


@pytest.mark.parametrize(("old", "new", "said"), RIG_REFUSED)
def test_rig_files_that_make_no_sense_are_refused(tmp_path, old, new, said):
    text = RIG.read_text()
    assert old in text
    (tmp_path / "rig.yaml").write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError, match=said) as refused:
        read_own_exo(MODEL, tmp_path / "rig.yaml")
    assert "rig.yaml" in str(refused.value) or "my_exo.xml" in str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            ["  foot_l: {link: stirrup_l, at_mm: [-20, -120, -65]}\n", ""],
            ["  foot_r: {link: stirrup_r, at_mm: [-20, 120, -65]}\n", ""],
            "none that hold exo_ankle_flexion_l",
        ),
        (
            ["-20, -120, -65]}", "-20, -120, -65], turn_stiffness_nm: [1.0e4, 1.0e4, 1.0e4]}"],
            ["x", "x"],
            "Hz on its cuffs",
        ),
        (["at_mm: [0, -120, -210]", "at_mm: [0, -1200, -210]"], ["x", "x"], "cuffs.thigh_l.at_mm: .* within 300 mm"),
    ],
)
def test_cuffs_that_do_not_hold_it_are_refused(tmp_path, old, new, said):
    text = RIG.read_text()
    (tmp_path / "rig.yaml").write_text(text.replace(*old).replace(*new))
    config = TwinConfig(
        name="own",
        route=Route(segments=(Level(length_m=1.0),)),
        sensors=(),
        exo=Exo(user_exo=read_own_exo(MODEL, tmp_path / "rig.yaml")),
    )
    with pytest.raises(ConfigError, match=said):
        Twin(config, 1)


def test_drive_needs_both_hips(tmp_path):
    text = RIG.read_text()
    (tmp_path / "rig.yaml").write_text(text.replace("  hip_l: {torque_max_nm: 40, speed_max_radps: 7}\n", ""))
    config = TwinConfig(
        name="own",
        route=Route(segments=(Level(length_m=1.0),)),
        physics="dynamic",
        exo=Exo(drive="assist", user_exo=read_own_exo(MODEL, tmp_path / "rig.yaml")),
    )
    with pytest.raises(ConfigError, match=r"motors\.hip_l"):
        Twin(config, 1)


def test_all_errors_of_a_rig_file_are_reported_at_once(tmp_path):
    text = RIG.read_text().replace("torque_max_nm: 40", "torque_max_nm: 0", 1).replace("part: MPU-9250", "part: MPU-1")
    (tmp_path / "rig.yaml").write_text(text.replace("encoders: [hip_l", "encoders: [hip") + "colour: red\n")
    with pytest.raises(ConfigError) as refused:
        read_own_exo(MODEL, tmp_path / "rig.yaml")
    lines = [line.removeprefix(f"{tmp_path / 'rig.yaml'}: ").split(": ")[0] for line in str(refused.value).splitlines()]
    assert sorted(lines) == ["encoders[0]", "imus.shank_l.part", "invalid 'colour'", "motors.hip_l.torque_max_nm"]
