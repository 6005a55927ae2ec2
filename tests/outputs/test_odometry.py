"""`estimate dvio` from the command line, on a walk with rendered images."""

from __future__ import annotations

import json

import numpy as np
import pytest

from stridetwin.cli.main import main
from stridetwin.outputs.path.figures import COLORS
from stridetwin.outputs.path.scores import compare
from stridetwin.outputs.truth import TruePath
from stridetwin.streams.formats.opening import open_with_warnings
from stridetwin.streams.formats.tum import read_tum
from stridetwin.streams.recording.reader import Recording
from tests.plots import figures
from tests.small_camera import one_renderer, write_small_camera

WALK = """\
description: a few steps in a room
terrain:
  - level: {length_m: 1.5}
scenery: room
sensors:
  head_camera: {part: small_camera.yaml, rate_hz: 10}
  foot_imu: false
  foot_camera: false
  sonar: false
  ahrs: false
  encoder: false
  interaction: false
  actuator: false
gait: {stand_s: 1.2}
"""


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    folder = tmp_path_factory.mktemp("odometry")
    (folder / "walk.yaml").write_text(WALK)
    write_small_camera(folder / "small_camera.yaml")
    with one_renderer():
        assert main(["run", str(folder / "walk.yaml"), "--seed", "3", "--no-film", "-o", str(folder / "walk")]) == 0
    return folder / "walk"


def over_truth(path, walked):
    truth = TruePath.of(Recording(walked / "recording.mcap").block("/truth/head/imu/odometry"))
    return compare(read_tum(path), truth, "yaw")


def test_a_walk_with_rendered_images_is_followed_to_its_end(walked, tmp_path, capsys):
    recording, path = walked / "recording.mcap", tmp_path / "path.txt"
    assert main(["estimate", "dvio", str(recording), "-o", str(path)]) == 0
    assert path.read_bytes() == (walked / "dvio.txt").read_bytes()
    fitted = over_truth(path, walked)
    assert fitted.distance_m[-1] > 1.2
    assert fitted.coverage > 0.8
    assert np.linalg.norm(fitted.error_m, axis=1).max() < 0.05
    capsys.readouterr()
    assert main(["score", str(recording), "--align", "yaw", "--json"]) == 0
    scores = json.loads(capsys.readouterr().out)["estimators"]
    reported = scores["dvio"]["ape_rmse_m"]
    assert reported == pytest.approx(np.sqrt((fitted.error_m**2).sum(axis=1).mean()), rel=1e-3)
    report = (walked / "report.html").read_text()
    assert f'class="dot" style="--dot: {COLORS["camera"]}"' in report
    assert "visual-inertial odometry" in report
    own = json.loads((walked / "scores.json").read_text())["estimators"]
    assert {k: scores[k] for k in ("terrain_map", "locomotion_mode")} == {
        k: own[k] for k in ("terrain_map", "locomotion_mode")
    }


def test_the_ground_and_the_steps_ahead_are_scored_and_shown(walked):
    scores = json.loads((walked / "scores.json").read_text())["estimators"]
    footprints = Recording(walked / "recording.mcap").topics["/truth/footprints"].count
    modes, ground = scores["locomotion_mode"], scores["terrain_map"]
    assert modes["steps"] == footprints - 2
    assert modes["accuracy_pct"] == 100.0
    assert modes["footprint_left_rmse_m"] < 0.1  # so that each foot lands on its own side
    assert ground["accuracy_rmse_mm"] < 15.0
    assert ground["completeness_pct"] > 80.0
    assert not {"edge_rmse_mm", "riser_rmse_mm", "slope_rmse_deg"} & (set(modes) | set(ground))
    assert len((walked / "locomotion_mode.csv").read_text().splitlines()) > modes["steps"] - 2
    assert (walked / "terrain_map.ply").read_bytes().startswith(b"ply")
    report = (walked / "report.html").read_text()
    part = report[report.index("Terrain ahead") :]
    rows = [shown for title, shown in figures(part).items() if title.startswith("The ground from above")]
    assert sum(len(row.shapes("true footprint")) for row in rows) == footprints
    assert "99.00 ± 0.95" in part
    live = (walked / "run.rrd").read_bytes()
    for entity in ("/world/ahead/ground", "/world/steps/predicted", "/modes/probability/SA", "/modes/predicted"):
        assert entity.encode() in live


def test_a_folder_of_two_cameras_leads_to_the_same_path(walked, tmp_path):
    folder, path = tmp_path / "euroc", tmp_path / "path.txt"
    words = ["export", str(walked / "recording.mcap"), "--format", "euroc", "--stereo-baseline", "0.095"]
    assert main([*words, "-o", str(folder)]) == 0
    assert main(["estimate", "dvio", str(folder), "-o", str(path)]) == 0
    fitted = over_truth(path, walked)
    assert fitted.coverage > 0.8
    assert np.linalg.norm(fitted.error_m, axis=1).max() < 0.05


@pytest.mark.parametrize(
    ("form", "depth_m"), [(["tum", "--camera", "/head/color"], 1.01e-4), (["rosbag2"], 0.0)], ids=["tum", "rosbag2"]
)
def test_folders_and_bags_of_others_bring_what_the_odometry_takes(walked, tmp_path, form, depth_m):
    """From equal samples and an equal rig comes an equal path; TUM's depth is in fifths of a millimetre."""
    recording, folder = Recording(walked / "recording.mcap"), tmp_path / form[0]
    assert main(["export", str(walked / "recording.mcap"), "--format", *form, "-o", str(folder)]) == 0
    back = open_with_warnings(folder, lenient=False)
    a, b = recording.block("/head/imu"), back.block("/head/imu")
    np.testing.assert_array_equal(a.t_ns, b.t_ns)
    for name in ("angular_rate", "specific_force"):
        np.testing.assert_array_equal(a.columns[name], b.columns[name])
    for image, other in zip(recording.images("/head/color"), back.images("/head/color"), strict=True):
        assert image.t_ns == other.t_ns
        np.testing.assert_array_equal(image.pixels, other.pixels)
    for depth, other in zip(recording.images("/head/depth"), back.images("/head/depth"), strict=True):
        assert depth.t_ns == other.t_ns
        np.testing.assert_allclose(depth.depth, other.depth, rtol=0, atol=depth_m)
    for sensor in ("imus", "cameras"):
        topic = {"imus": "/head/imu", "cameras": "/head/color"}[sensor]
        one, two = (dict(vars(getattr(r.rig, sensor)[topic])) for r in (recording, back))
        del one["mount"], two["mount"]
        assert one == two
    between = [
        np.linalg.inv(r.rig.imu("/head/imu").mount.T_body_sensor) @ r.rig.cameras["/head/color"].mount.T_body_sensor
        for r in (recording, back)
    ]
    np.testing.assert_allclose(*between, atol=1e-12)


def test_what_goes_with_one_foot_is_refused(tmp_path, capsys):
    recording = tmp_path / "none.mcap"
    recording.write_bytes(b"")
    assert main(["estimate", "dvio", str(recording), "--foot", "l", "-o", str(tmp_path / "path.txt")]) == 2
    assert "--foot" in capsys.readouterr().err
