"""Placements of IMUs on segments of the body: by place, by coordinates, over a limb's surface, and with estimators."""

import numpy as np
import pytest
import yaml

from stridetwin.sim.config import Person
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.sim.wearer.imu_places import default_position
from stridetwin.streams.errors import StrideTwinError
from stridetwin.studies.placement.problem_file import Place, check_ends, read_problem, scenario_at
from stridetwin.studies.placement.run import PlacementOptions, run_placement

STEPS = {"description": "steps", "terrain": [{"level": {"length_m": 4}}], "person": {"height_m": 1.6, "mass_kg": 55}}


def read(tmp_path, **node):
    (tmp_path / "steps.yaml").write_text(yaml.safe_dump(STEPS), encoding="utf-8")
    path = tmp_path / "problem.yaml"
    whole = {"placement": "An IMU on the body", "scenarios": ["steps.yaml"], "scores": ["weight_g"]} | node
    path.write_text(yaml.safe_dump(whole), encoding="utf-8")
    return read_problem(path)


def mount(problem, values, tmp_path, topic):
    config = scenario_at(problem, problem.bases[0], Place(values=values), tmp_path).config
    return sensor_rig(config).rig.imus[topic].mount


def test_one_coordinate_leaves_the_others_at_the_standard_place_of_the_person(tmp_path):
    key = "sensors.body_imu.shank_l.position_mm[2], sensors.body_imu.shank_r.position_mm[2]"
    short_forms = {"sensors.body_imu": {"fixed": {"shank_l": "ADIS16485", "shank_r": True}}}
    problem = read(tmp_path, free={key: {"between": [-300, -100], "step": 100}}, set=short_forms)
    check_ends(problem, tmp_path)
    standard = 1e3 * default_position("shank_l", Person(height_m=1.6, mass_kg=55))
    for side, out in (("l", 1.0), ("r", -1.0)):
        position = mount(problem, {problem.knobs[0].name: -200.0}, tmp_path, f"/body/shank_{side}/imu")
        expected = [standard[0], out * standard[1], -200.0]
        np.testing.assert_allclose(1e3 * position.T_body_sensor[:3, 3], expected, atol=1e-5)
    as_it_is = scenario_at(problem, problem.bases[0], Place(), tmp_path).config
    assert "ADIS16485" in sensor_rig(as_it_is).rig.imus["/body/shank_l/imu"].part


def test_a_switch_opens_into_all_places(tmp_path):
    free = {"sensors.body_imu.thigh_l.rate_hz": {"choice": [100, 400]}}
    problem = read(tmp_path, free=free, set={"sensors.body_imu": {"fixed": True}})
    config = scenario_at(problem, problem.bases[0], Place(values={problem.knobs[0].name: 400}), tmp_path).config
    rates = {topic: imu.rate_hz for topic, imu in sensor_rig(config).rig.imus.items() if "/body/" in topic}
    assert rates.pop("/body/thigh_l/imu") == 400
    assert len(rates) == 18
    assert set(rates.values()) == {200}


def test_a_point_on_a_limb_is_outside_of_it_by_what_is_asked(tmp_path):
    on = {"over": "thigh", "around_deg": {"between": [0, 90], "step": 90}, "up_mm": -250, "off_mm": 6}
    problem = read(tmp_path, free={"sensors.body_imu.thigh_r.position_mm": on})
    check_ends(problem, tmp_path)
    girth = np.sqrt((55 / 73) / (1.6 / 1.741))
    for angle, axis, sign in ((0.0, 0, 1.0), (90.0, 1, -1.0)):
        found = mount(problem, {problem.knobs[0].name: angle}, tmp_path, "/body/thigh_r/imu")
        position = 1e3 * found.T_body_sensor[:3, 3]
        assert sign * position[axis] == pytest.approx(78 * girth + 6, abs=5)
        assert position[2] == pytest.approx(-250)
    with pytest.raises(StrideTwinError, match="thigh has no surface at a height of 300 mm"):
        check_ends(read(tmp_path, free={"sensors.body_imu.thigh_r.position_mm": on | {"up_mm": 300}}), tmp_path)


def test_estimators_of_a_foot_score_at_every_place_on_the_shoe(tmp_path):
    free = {"sensors.body_imu": {"choice": [{"heel_l": True, "heel_r": True}, {"ankle_l": True, "ankle_r": True}]}}
    sensors = {"sensors.foot_imu": {"fixed": False}, "sensors.body_imu": {"fixed": {"instep_l": {}, "instep_r": {}}}}
    problem = read(tmp_path, free=free, set=sensors, scores=["foot_ins.end_error_m", "gait_phase.rmse_pct"])
    result = run_placement(problem, PlacementOptions(folder=tmp_path / "out"), lambda *_: None)
    assert len(result["table"]) == 3
    for row in result["table"]:
        assert 0.0 < row["scores"]["foot_ins.end_error_m"]["mean"] < 0.3, row
        assert row["scores"]["gait_phase.rmse_pct"]["mean"] < 25.0, row
    assert "body.png" in result["files"]  # with a dot at each place


STRAPDOWN = '''"""Path of one shank by inertial navigation alone."""

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import PATH, Declaration, Stream
from stridetwin.streams.samples import Imu
from stridetwin.streams.trajectory import Pose


class Shank:
    """Starts at rest, where the force is vertical."""

    declaration = Declaration(name="shank_path", kind=PATH, needs="/body/shank_l/imu", label="shank")

    def __init__(self, rig, *, options=None, parameters=None):
        self.last = None
        self.p, self.v = np.zeros(3), np.zeros(3)

    @classmethod
    def streams(cls, rig, options):
        return (Stream(role="imu", topic="/body/shank_l/imu", kind=Imu),)

    def update(self, sample):
        if self.last is None:
            self.R = Rotation.align_vectors([[0.0, 0.0, 1.0]], [sample.specific_force])[0]
        else:
            dt = 1e-9 * (sample.t_ns - self.last)
            turn = Rotation.from_rotvec(sample.angular_rate * dt / 2)
            v = self.v + dt * ((self.R * turn).apply(sample.specific_force) - [0.0, 0.0, 9.81])
            self.p, self.v, self.R = self.p + dt * (self.v + v) / 2, v, self.R * turn * turn
        self.last = sample.t_ns
        q = self.R.as_quat(scalar_first=True)
        return Pose(t_ns=sample.t_ns, frame="body/shank_l/imu", p_frame_in_world=self.p.copy(), rotation=q)
'''


def test_an_installed_estimator_of_ones_own_scores_on_any_segment(tmp_path, monkeypatch):
    site = tmp_path / "site"
    info = site / "shank_path-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "shank_path_estimator.py").write_text(STRAPDOWN, encoding="utf-8")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: shank-path\nVersion: 1.0\n", encoding="utf-8")
    points = "[stridetwin.estimators]\nshank_path = shank_path_estimator:Shank\n"
    (info / "entry_points.txt").write_text(points, encoding="utf-8")
    monkeypatch.syspath_prepend(str(site))
    free = {"sensors.body_imu.shank_l.part": {"choice": ["ADIS16485-ideal", "MPU-9250-wearable"]}}
    shank = {"sensors.body_imu": {"fixed": {"shank_l": "ADIS16485"}}}
    problem = read(tmp_path, free=free, set=shank, scores=["shank_path.end_error_m"])
    result = run_placement(problem, PlacementOptions(folder=tmp_path / "out"), lambda *_: None)
    errors = {row["label"]: row["scores"]["shank_path.end_error_m"]["mean"] for row in result["table"]}
    part = "body_imu.shank_l.part"
    assert errors[f"{part} ADIS16485-ideal"] < 0.05
    assert errors[f"{part} MPU-9250-wearable"] > 5 * errors[f"{part} ADIS16485-ideal"]
