"""Geometry and kinematics of a leg: the table of the paper, any other table, and the files that hold them."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stridetwin.estimators.contact_terrain import leg as compiled
from stridetwin.estimators.contact_terrain.geometry import DhRow, parse_exoskeleton, to_text
from stridetwin.estimators.contact_terrain.leg import at_stop, forward, leg_angles, links
from stridetwin.scenarios.exo_geometry import true_geometry
from stridetwin.sim.config import Level, Person, Route, TwinConfig
from stridetwin.sim.sensors.standard_rig import standard_rig
from stridetwin.sim.wearer.body import fit_wearer
from stridetwin.streams.errors import ConfigError
from tests.estimators.from_python import from_python
from tests.sim.dh_kinematics import forward_kinematics

ANGLES = st.lists(st.floats(-1.2, 1.2), min_size=6, max_size=6).map(np.array)
SIDES = st.sampled_from("lr")

joint_angles = from_python(compiled.joint_angles)


def exoskeleton():
    rig = standard_rig(TwinConfig(name="x", route=Route(segments=(Level(length_m=5.0),))))
    return true_geometry(fit_wearer(Person()), rig)


EXO = exoskeleton()
# hip with abduction and flexion alone, knee of the other sign, ankle with one joint
OTHER = (
    DhRow(alpha=0.0, a=0.1, d=0.05, theta=0.3, turns=True),
    DhRow(alpha=1.4, a=0.02, d=-0.08, theta=-0.2, turns=True),
    DhRow(alpha=3.0, a=0.40, d=0.01, theta=0.0, turns=True),
    DhRow(alpha=0.1, a=0.38, d=0.0, theta=0.1, turns=True),
)


@given(q=ANGLES, side=SIDES)
@settings(max_examples=40, deadline=None)
def test_forward_kinematics_are_the_product_of_the_table(q, side):
    leg = links(EXO.legs[side])
    poses = forward(leg.table, leg.turns, q)
    assert poses == pytest.approx(forward_kinematics(fit_wearer(Person()).exo, side, q), abs=1e-12)
    T, angles = np.eye(4), iter(q)
    for row, pose in zip(EXO.legs[side].rows, poses):
        turn, shift = np.eye(4), np.eye(4)
        theta = row.theta + (next(angles) if row.turns else 0.0)
        turn[:3, :3] = (Rotation.from_euler("x", row.alpha) * Rotation.from_euler("z", theta)).as_matrix()
        shift[:3, 3] = [0, 0, row.d]
        before = np.eye(4)
        before[0, 3] = row.a
        T = T @ before @ turn @ shift
        assert pose == pytest.approx(T, abs=1e-12)


@given(q=ANGLES, side=SIDES, seed=st.integers(0, 9))
@settings(max_examples=40, deadline=None)
def test_angles_come_back_from_attitudes(q, side, seed):
    leg = links(EXO.legs[side])
    poses = forward(leg.table, leg.turns, q)
    R = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    thigh, foot = R @ poses[leg.thigh - 1, :3, :3], R @ poses[-1, :3, :3]
    found = leg_angles(leg, np.array([R, thigh, np.eye(3), foot, np.eye(3)]), 0, q[3])
    assert found == pytest.approx(q, abs=1e-8)


@given(n=st.integers(1, 3), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_angles_of_up_to_three_joints_come_back_whatever_the_parts_between_them(n, seed):
    rng = np.random.default_rng(seed)
    parts = Rotation.random(n + 1, rng=rng).as_matrix()

    def product(q):
        R = parts[0]
        for angle, part in zip(q, parts[1:]):
            R = R @ Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix() @ part
        return R

    q = rng.uniform(-np.pi, np.pi, n)
    found = joint_angles(parts, product(q))
    np.testing.assert_allclose(product(found), product(q), atol=1e-6)
    assert n < 3 or abs(found[1]) < abs(q[1]) + 1e-6


@given(side=SIDES, seed=st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_for_the_table_of_the_paper_the_angles_are_its_equations(side, seed):
    leg = links(EXO.legs[side])
    rng = np.random.default_rng(seed)
    r = (
        Rotation.from_rotvec(0.6 * rng.standard_normal(3)).as_matrix()
        @ forward(leg.table, leg.turns, np.zeros(6))[4, :3, :3]
    )
    q3 = np.arctan2(-r[2, 2], np.hypot(r[2, 0], r[2, 1]))
    q5 = np.arctan2(-r[2, 0] / np.cos(q3), -r[2, 1] / np.cos(q3))
    q1 = np.arctan2(r[1, 2] / np.cos(q3), r[0, 2] / np.cos(q3))
    assert joint_angles(leg.hip_parts, r) == pytest.approx([q1, q3, q5], abs=1e-7)  # (7)
    q = Rotation.from_rotvec(0.3 * rng.standard_normal(3)).as_matrix() @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    expected = [np.arctan2(q[0, 2], -q[1, 2]), np.arctan2(q[2, 0], q[2, 1])]
    assert joint_angles(leg.ankle_parts, q) == pytest.approx(expected, abs=1e-9)  # (10)


@given(q=st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).map(np.array))
@settings(max_examples=40, deadline=None)
def test_another_leg_needs_another_table_alone(q):
    of = EXO.legs["l"]
    leg = links(replace(of, rows=OTHER, thigh=replace(of.thigh, frame=2), knee=replace(of.knee, frame=3)))
    poses = forward(leg.table, leg.turns, q)
    R = np.array([np.eye(3), np.eye(3), poses[1, :3, :3], np.eye(3), poses[3, :3, :3]])
    assert leg_angles(leg, R, 1, q[2]) == pytest.approx(q, abs=1e-8)


def test_a_file_gives_back_what_was_written():
    back = parse_exoskeleton(to_text(EXO), "exo.yaml")
    for side in "lr":
        one, other = EXO.legs[side], back.legs[side]
        assert links(one).table == pytest.approx(links(other).table, abs=1e-15)
        assert one.sole.T_foot_sole == pytest.approx(other.sole.T_foot_sole)
        assert (one.knee, one.thigh.topic, one.sole.hinge_z) == (other.knee, other.thigh.topic, other.sole.hinge_z)
        assert np.array([row.stops for row in one.rows]) == pytest.approx(np.array([row.stops for row in other.rows]))
    assert back.topics == EXO.topics


def test_an_ankle_is_at_its_stop_within_the_margin():
    leg = links(EXO.legs["l"])
    q, margin = np.zeros(6), np.radians(2.0)
    assert not at_stop(leg.ankle_stops, q, margin)
    for joint, stops in ((4, (-45.0, 50.0)), (5, (-10.0, 10.0))):
        for sign, stop in zip((-1, 1), stops):
            bent = q.copy()
            bent[joint] = np.radians(stop - 2.5 * sign)
            assert not at_stop(leg.ankle_stops, bent, margin)
            bent[joint] = np.radians(stop - 1.5 * sign)
            assert at_stop(leg.ankle_stops, bent, margin)


@pytest.mark.parametrize(
    ("keys", "value", "words"),
    [
        (("legs", "l", "knee", "frame"), 2, "legs.l.knee.frame: invalid 2: expected a frame beyond the thigh's"),
        (("legs", "l", "thigh", "frame"), 8, "expected 1-7, a frame before the foot's"),
        (("legs", "r", "knee", "sign"), 2.0, "expected 1 or -1"),
        (("legs", "r", "sole", "hinge_x_m"), 0.5, "between heel_x_m and tip_x_m"),
        (("legs", "r", "foot", "R_frame_sensor"), [[1, 0, 0], [0, 2, 0], [0, 0, 1]], "a rotation matrix"),
        (("legs", "l", "frames", 0, "turns"), "yes", "true, false"),
        (("legs", "l", "frames", 0, "beta"), 1.0, "invalid 'beta': expected keys alpha_deg"),
        (("legs", "l", "frames", 0, "range_deg"), [10, -10], "the least and the greatest angle"),
        (("back", "topic"), None, "text"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused_by_key(keys, value, words):
    node = document = yaml.safe_load(to_text(EXO))
    for key in keys[:-1]:
        node = node[key]
    node[keys[-1]] = value
    with pytest.raises(ConfigError, match=r"exo\.yaml: ") as error:
        parse_exoskeleton(yaml.safe_dump(document), "exo.yaml")
    assert words in str(error.value)


def test_all_errors_of_a_file_are_reported_at_once():
    document = yaml.safe_load(to_text(EXO))
    document["legs"]["l"]["knee"]["frame"] = 2
    document["legs"]["r"]["sole"]["cells_m"] = [[0, 0]]
    del document["back"]["topic"]
    with pytest.raises(ConfigError) as error:
        parse_exoskeleton(yaml.safe_dump(document), "exo.yaml")
    places = [line.split(": ")[1] for line in str(error.value).splitlines()]
    assert set(places) == {"legs.l.knee.frame", "legs.r.sole.cells_m", "back.topic"}
