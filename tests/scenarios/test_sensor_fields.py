import numpy as np
import pytest

from stridetwin.scenarios.scenario_model import SensorsInFile
from stridetwin.sim.choices import BODY_PLACES
from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.sensor_config import KIND
from stridetwin.sim.sensors.model import Stamps
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.validation import validate

ROUTE = Route(segments=(Level(length_m=3.0),))
MINE = """kind: imu
description: An IMU of mine
rate_hz: 400
gyroscope: {noise_density_dps_per_rthz: 0.01, bias_instability_deg_per_h: 5, turn_on_bias_dps: 1, range_dps: 2000,
  bandwidth_hz: 200}
accelerometer: {noise_density_ug_per_rthz: 100, bias_instability_ug: 20, turn_on_bias_mg: 5, range_g: 16,
  bandwidth_hz: 200}
"""


def read(node, folder="."):
    return validate(SensorsInFile, node, f"{folder}/scenario.yaml", at="sensors", context={"folder": folder})


def fitted(node, folder="."):
    asked = read(node, folder)
    return sensor_rig(TwinConfig(name="x", route=ROUTE, sensors=asked.groups, fittings=asked.configs))


def test_a_list_names_what_is_on():
    asked = read(["foot_imu", "sonar"])
    assert asked.groups == ("foot_imu", "sonar")
    assert asked.paths == {"foot_imu": "sensors[0]", "sonar": "sensors[1]"}
    assert not asked.configs


def test_a_mapping_changes_what_it_names_and_leaves_the_rest_on():
    asked = read({"foot_imu": "MPU-9250", "head_camera": False, "sonar": True})
    assert set(asked.groups) == set(KIND) - {
        "head_camera",
        "exo_imu",
        "body_imu",
    }  # the last two are off unless asked for
    assert set(asked.configs) == {"foot_imu"}
    rig = fitted({"foot_imu": "MPU-9250"}).rig
    assert rig.imus["/foot_l/imu"].rate_hz == 200
    assert "MPU-9250" in rig.imus["/foot_r/imu"].part
    assert rig.imus["/head/imu"].part.startswith("Bosch")


def test_an_ideal_twin_is_calibrated_like_the_part_itself():
    worn, plain = fitted({"foot_imu": "ADIS16485-ideal"}), fitted({})
    assert worn.sensors["/foot_l/imu"].part.gyroscope.noise_density == 0
    assert worn.rig.imus["/foot_l/imu"].gyroscope_noise_density == plain.rig.imus["/foot_l/imu"].gyroscope_noise_density
    assert fitted({"foot_imu": {"ideal": True}}).sensors["/foot_l/imu"].part == worn.sensors["/foot_l/imu"].part


def test_the_camera_with_depth_looks_down_as_asked():
    axis = fitted({"head_camera": {"pitch_down_deg": 8}}).rig.cameras["/head/color"].mount.T_body_sensor[:3, 2]
    assert np.degrees(np.arcsin(-axis[2])) == pytest.approx(8.0)
    with pytest.raises(ConfigError, match=r"sensors\.head_camera\.pitch_down_deg: invalid 80: expected -30 to 75"):
        read({"head_camera": {"pitch_down_deg": 80}})
    with pytest.raises(ConfigError, match="pitch_down_deg"):
        read({"foot_camera": {"pitch_down_deg": 8}})


def test_a_part_of_ones_own_is_found_beside_the_scenario(tmp_path):
    (tmp_path / "mine.yaml").write_text(MINE, encoding="utf-8")
    worn = fitted({"foot_imu": {"part": "mine.yaml", "rate_hz": 100}}, tmp_path)
    assert worn.rig.imus["/foot_l/imu"].part == "An IMU of mine"
    assert worn.rig.imus["/foot_l/imu"].rate_hz == 100


def test_shoe_cameras_and_boards_sit_where_the_file_says():
    sits = {"position_mm": [-60, 40, 50], "faces_deg": [20, 30], "roll_deg": 0}
    moved = fitted({"foot_camera": {"mount": sits, "board": {"position_mm": [-80, 0, 70], "faces_deg": [180, 0]}}}).rig
    for side, inward in (("l", -1.0), ("r", 1.0)):
        camera = moved.cameras[f"/foot_{side}/camera"].mount.T_body_sensor
        np.testing.assert_allclose(camera[:3, 3], [-0.06, 0.04 * inward, 0.05])
        ahead = [np.cos(np.pi / 6) * np.cos(np.pi / 9), np.cos(np.pi / 6) * np.sin(np.pi / 9) * inward, 0.5]
        np.testing.assert_allclose(camera[:3, 2], ahead)
        board = moved.boards[f"foot_{side}"].mount.T_body_sensor
        np.testing.assert_allclose(board[:3, 2], [-1.0, 0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(board[:3, 3], [-0.08, 0.0, 0.07])


@pytest.mark.parametrize("calibrated", [True, False])
def test_a_trigger_offset_is_in_the_calibration_if_the_clock_says_so(calibrated):
    clock = {"offset_s": 0.004, "latency_s": 0.001, "drift_ppm": 20, "jitter_s": 0.0001, "calibrated": calibrated}
    worn = fitted({"foot_camera": {"clock": clock}, "foot_imu": {"clock": {"offset_s": 0.01, "calibrated": True}}})
    camera = worn.rig.cameras["/foot_l/camera"]
    # t_imu = t_cam + shift
    assert camera.timeshift_cam_imu_s == pytest.approx(0.005 if calibrated else 0.010)
    assert worn.sensors["/foot_l/camera"].clock.shift_s == pytest.approx(0.005)


@pytest.mark.parametrize("offset_s", [-0.1, 0.02, 0.05, 0.1])
def test_a_camera_may_be_off_its_imu_by_a_tenth_of_a_second(offset_s):
    perfect = fitted({"head_camera": True, "head_imu": True}).rig.cameras["/head/color"].timeshift_cam_imu_s
    worn = fitted({"head_camera": {"clock": {"offset_s": offset_s}}})
    assert worn.rig.cameras["/head/color"].timeshift_cam_imu_s == perfect  # estimators are not told
    # stamps minus true times, ns
    t_ns = np.arange(10**9, 2 * 10**9, 10**8)
    stamps = Stamps(worn.sensors["/head/color"].clock, 30.0, Noise(None)).stamp(t_ns)
    np.testing.assert_array_equal(stamps - t_ns, round(offset_s * 1e9))


@pytest.mark.parametrize(
    ("node", "words"),
    [
        ({"foot_imv": True}, ["sensors: invalid 'foot_imv'", "did you mean 'foot_imu'?"]),
        ({"foot_imu": "ADIS1648"}, ["sensors.foot_imu: invalid 'ADIS1648'", "did you mean 'ADIS16485'?", "-ideal"]),
        ({"foot_imu": "SRF08"}, ["sensors.foot_imu: invalid 'SRF08'", "MPU-9250", "of kind imu"]),
        ({"foot_imu": 3}, ["sensors.foot_imu: invalid 3", "part, ideal, rate_hz, clock, position_mm"]),
        ({"foot_imu": {"part": "none.yaml"}}, ["none.yaml: cannot be read"]),
        ({"foot_imu": {"rate": 100}}, ["sensors.foot_imu: invalid 'rate'", "did you mean 'rate_hz'?"]),
        ({"foot_imu": {"rate_hz": 0}}, ["sensors.foot_imu.rate_hz: invalid 0", "1-2000"]),
        ({"foot_imu": {"clock": {"offset_s": 3}}}, ["sensors.foot_imu.clock.offset_s: invalid 3", "-1 to 1"]),
        ({"sonar": {"clock": {"calibrated": True}}}, ["sensors.sonar.clock: invalid 'calibrated'", "offset_s"]),
        ({"foot_imu": {"position_mm": [1, 2]}}, ["sensors.foot_imu.position_mm: invalid [1, 2]", "three items"]),
        (
            {"foot_imu": {"position_mm": [0, 60, 280]}},
            ["sensors.foot_imu.position_mm[2]: invalid 280", "up to 150", "sensors.body_imu.shank_l"],
        ),
        ({"foot_imu": {"light": 1}}, ["sensors.foot_imu: invalid 'light'"]),
        ({"body_imu": {"shnk_l": True}}, ["sensors.body_imu: invalid 'shnk_l'", "did you mean 'shank_l'?"]),
        ({"body_imu": {"shank": {}}}, ["sensors.body_imu: invalid 'shank'", "expected keys pelvis, chest, head"]),
        (
            {"body_imu": {"heel_l": {"strike_g": 1}}},
            ["sensors.body_imu.heel_l.strike_g: invalid 1", "0 on a shoe"],
        ),
        ({"body_imu": 3}, ["sensors.body_imu: invalid 3", "true, false, or keys pelvis"]),
        ({"body_imu": {"every": False, "head": True}}, ["sensors.body_imu.every: invalid False", "a part, or options"]),
        ({"body_imu": {"every": {"position_mm": [0, 0, 0]}}}, ["sensors.body_imu.every: invalid 'position_mm'"]),
        ({"body_imu": {"thigh_l": "SRF08"}}, ["sensors.body_imu.thigh_l: invalid 'SRF08'", "of kind imu"]),
        (
            {"body_imu": {"thigh_l": {"position_mm": [0, 0, -700]}}},
            ["sensors.body_imu.thigh_l.position_mm[2]: invalid -700", "-600 to 600"],
        ),
        ({"foot_camera": {"frames": "half"}}, ["sensors.foot_camera.frames: invalid 'half'", "board, full"]),
        ({"foot_camera": {"mount": {"faces_deg": [27, 24]}}}, ["sensors.foot_camera.mount", "position_mm"]),
        (
            {"foot_camera": {"board": {"position_mm": [0, 0, 0], "faces_deg": [27]}}},
            ["sensors.foot_camera.board.faces_deg: invalid [27]", "two items"],
        ),
        ({"foot_camera": {"board": {"roll_deg": 90}}}, ["sensors.foot_camera.board: invalid 'roll_deg'"]),
    ],
)
def test_what_is_wrong_is_refused_with_its_place_and_what_is_valid(node, words):
    with pytest.raises(StrideTwinError) as raised:
        read(node)
    assert all(word in str(raised.value) for word in words), str(raised.value)


def test_the_lists_of_the_command_line_are_refused_as_before():
    with pytest.raises(ConfigError, match="every name once"):
        read(["sonar", "sonar"])


def test_errors_of_calibration_exposure_and_strikes_are_read_in_the_units_of_files():
    camera = {"exposure_ms": 15, "calibration_sd": {"rotation_deg": 0.2, "position_mm": 1, "intrinsics_pct": 0.1}}
    asked = read({"head_camera": camera, "head_imu": {"strike_g": 1}})
    sd = asked.configs["head_camera"].calibration_sd
    assert (sd.rotation_rad, sd.position_m, sd.intrinsics) == pytest.approx((np.radians(0.2), 1e-3, 1e-3))
    assert (sd.offset_s, sd.depth_scale) == (0.0, 0.0)
    assert asked.configs["head_imu"].strike == pytest.approx(9.80665)
    worn = fitted({"head_camera": camera})
    assert worn.sensors["/head/color"].part.imager.exposure_s == pytest.approx(0.015)
    assert read({"head_camera": {"calibration_sd": {"offset_ms": 100}}}).configs[
        "head_camera"
    ].calibration_sd.offset_s == pytest.approx(0.1)
    with pytest.raises(ConfigError, match="calibration_sd"):
        read({"foot_imu": {"calibration_sd": {}}})
    with pytest.raises(ConfigError, match=r"head_camera\.calibration_sd\.rotation_deg: invalid 9: expected 0-5"):
        read({"head_camera": {"calibration_sd": {"rotation_deg": 9}}})


def test_camera_with_depth_sonar_and_imu_sit_and_face_where_the_file_says():
    sits = {"position_mm": [80, 30, 200], "faces_deg": [90, -30]}
    rig = fitted({"head_camera": {"mount": sits}, "sonar": {"mount": sits}}).rig
    camera = rig.cameras["/head/color"].mount.T_body_sensor
    np.testing.assert_allclose(camera[:3, 3], [0.08, 0.03, 0.2])
    np.testing.assert_allclose(camera[:3, 2], [0.0, np.cos(np.pi / 6), -0.5], atol=1e-12)
    np.testing.assert_allclose(camera[2, 0], 0.0, atol=1e-12)  # level
    for side, inward in (("l", -1.0), ("r", 1.0)):
        sonar = rig.others[f"/foot_{side}/sonar"].mount.T_body_sensor
        np.testing.assert_allclose(sonar[:3, 3], [0.08, 0.03 * inward, 0.2])
        np.testing.assert_allclose(sonar[:3, 0], [0.0, inward * np.cos(np.pi / 6), -0.5], atol=1e-12)
        np.testing.assert_allclose(sonar[:3, :3] @ sonar[:3, :3].T, np.eye(3), atol=1e-12)
    with pytest.raises(ConfigError, match=r"sensors\.head_camera\.pitch_down_deg: invalid 8.0: expected no pitch_down"):
        read({"head_camera": {"mount": sits, "pitch_down_deg": 8}})
    turned = fitted({"foot_imu": {"rotation_deg": [0, 0, 90]}}).rig.imus
    for side, out in (("l", 1.0), ("r", -1.0)):  # mirror images
        np.testing.assert_allclose(turned[f"/foot_{side}/imu"].mount.T_body_sensor[:3, 0], [0, out, 0], atol=1e-12)
    plain = fitted({}).rig.imus["/foot_l/imu"].mount.T_body_sensor[:3, :3]
    np.testing.assert_array_equal(plain, np.eye(3))


def test_imus_on_the_body_are_named_by_place_and_each_has_its_own_options():
    every = fitted({"body_imu": True}).rig.imus
    assert len([topic for topic in every if topic.startswith("/body/")]) == len(BODY_PLACES)
    mine = {"shank_l": {"position_mm": [10, 60, -300], "part": "ADIS16485"}, "wrist_r": {}, "head": "BMI055-ideal"}
    worn = fitted({"body_imu": mine | {"chest": False}})
    assert {topic for topic in worn.rig.imus if "/body/" in topic} == {
        f"/body/{place}/imu" for place in ("shank_l", "wrist_r", "head")
    }
    shank = worn.rig.imus["/body/shank_l/imu"]
    np.testing.assert_allclose(shank.mount.T_body_sensor[:3, 3], [0.01, 0.06, -0.3])
    assert shank.rate_hz == 120
    assert worn.sensors["/body/head/imu"].part.gyroscope.noise_density == 0
    assert "/foot_l/imu" in worn.rig.imus
    assert not [topic for topic in fitted({"body_imu": False}).rig.imus if "/body/" in topic]
    suit = fitted({"body_imu": {"every": {"part": "MTw-uncalibrated", "rate_hz": 60}, "head": True, "chest": "BMI055"}})
    rates = {topic: imu.rate_hz for topic, imu in suit.rig.imus.items() if "/body/" in topic}
    assert rates == {"/body/chest/imu": 60, "/body/head/imu": 60}
    assert "MTw" in suit.rig.imus["/body/head/imu"].part
    assert "BMI055" in suit.rig.imus["/body/chest/imu"].part
    all_of_one = fitted({"body_imu": {"every": {"population": "consumer"}}})
    assert [s.sensor_config.population for t, s in all_of_one.sensors.items() if "/body/" in t] == ["consumer"] * 19
    assert list(fitted(["body_imu"]).rig.imus) == [f"/body/{place}/imu" for place in BODY_PLACES]
