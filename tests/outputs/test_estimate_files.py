"""`score --estimate` with trajectories of other tools, in another order of the quaternion, or of a part of the walk."""

import json

import numpy as np
import pytest
from foot_walk import foot_walk, tum_rows, write_rows, write_truth
from scipy.spatial.transform import Rotation

from stridetwin.cli.main import main
from stridetwin.outputs.coverage import compute_covered_share, describe_partial, reaches_end
from stridetwin.streams.trajectory import Trajectory

WALK = foot_walk()
ROWS = tum_rows(WALK)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_truth(tmp_path_factory.mktemp("walk") / "walk.mcap", WALK)


def score(recording, capsys, file, *options):
    """Exit code, scores and what was printed on stderr."""
    code = main(["score", str(recording), "--json", "--estimate", f"mine={file}", *map(str, options)])
    printed = capsys.readouterr()
    return code, json.loads(printed.out)["estimators"]["mine"] if code == 0 else {}, printed.err


def w_first(rows):
    return [[*row[:4], row[7], *row[4:7]] for row in rows]


def turned(rotation, path=WALK):
    """The path in a turned world."""
    q = (rotation * Rotation.from_quat(path.q_world_frame, scalar_first=True)).as_quat(scalar_first=True)
    return Trajectory(t_ns=path.t_ns, p_frame_in_world=rotation.apply(path.p_frame_in_world), q_world_frame=q)


def without_identity(path=WALK):
    """A path whose first attitude is not the identity, and which turns about the vertical as a whole."""
    return turned(Rotation.from_rotvec([0, 0, 0.7]), path)


def test_a_whole_path_is_covered_without_a_word(recording, tmp_path, capsys):
    code, scores, said = score(recording, capsys, write_rows(tmp_path / "a.txt", ROWS))
    assert (code, scores["coverage_pct"]) == (0, 100.0)
    assert scores["end_error_m"] < 1e-6
    assert "warning" not in said


@pytest.mark.parametrize(
    ("kept", "covered", "has_end"),
    [
        (slice(60), 2.7, False),
        (slice(1500), 68.8, False),
        (slice(500, None), 77.1, True),
        (np.r_[:500, 1500:2180], 54.1, True),
        (np.r_[0, 2179], 0.0, True),
        (slice(None, None, 50), 98.7, True),
    ],
)
def test_a_part_is_said_and_has_no_end_error(recording, tmp_path, capsys, kept, covered, has_end):
    file = write_rows(tmp_path / "a.txt", [ROWS[i] for i in np.arange(len(ROWS))[kept]])
    _, scores, said = score(recording, capsys, file)
    assert scores["coverage_pct"] == pytest.approx(covered, abs=0.1)
    assert ("end_error_m" in scores, "end_height_error_m" in scores) == (has_end, has_end)
    warning = f"warning: mine covers {covered:.1f} % of walk: its scores are those of that part alone"
    assert (warning in said) == (covered < 95)


def test_the_table_shows_the_share_and_the_page_marks_it(recording, tmp_path, capsys):
    file = write_rows(tmp_path / "a.txt", ROWS[:60])
    page = tmp_path / "page.html"
    assert main(["score", str(recording), "--estimate", f"mine={file}", "--report", str(page)]) == 0
    head, row = capsys.readouterr().out.splitlines()[:2]
    assert head.endswith("  covered %")
    assert row.split()[1:4] == ["-", "-", "-"]  # no end, and no percentage of a foot that stood
    assert row.split()[-1] == "2.708"
    assert "mine COVERS ONLY 2.7 %" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("path", [WALK, without_identity()])
def test_w_first_is_read_so_with_a_warning(recording, tmp_path, capsys, path):
    _, scores, said = score(recording, capsys, write_rows(tmp_path / "a.txt", w_first(tum_rows(path))))
    assert scores["end_error_m"] < 1e-6
    assert "w first" in said
    assert "--quaternion wxyz" in said
    _, scores, said = score(recording, capsys, tmp_path / "a.txt", "--quaternion", "wxyz")
    assert scores["end_error_m"] < 1e-6
    assert "warning" not in said
    code, _, said = score(recording, capsys, tmp_path / "a.txt", "--quaternion", "xyzw")
    assert code == 2
    assert "it seems to be w first in a TUM file" in said


def test_a_drifting_path_with_w_first_is_noticed_too(recording, tmp_path, capsys):
    drift = np.outer(np.linspace(0, 1, len(WALK)), [0.5, -0.8, 0.3])
    path = without_identity()
    path = Trajectory(t_ns=path.t_ns, p_frame_in_world=path.p_frame_in_world + drift, q_world_frame=path.q_world_frame)
    _, _, said = score(recording, capsys, write_rows(tmp_path / "a.txt", w_first(tum_rows(path))))
    assert "the truth says that its quaternions have w first" in said
    _, scores, said = score(recording, capsys, write_rows(tmp_path / "b.txt", tum_rows(path)))
    assert "warning" not in said
    assert scores["end_error_m"] == pytest.approx(np.linalg.norm(drift[-1]), abs=1e-3)


@pytest.mark.parametrize("rotation", [[np.pi, 0, 0], [-np.pi / 2, 0, 0], [0.5, 1.2, -0.4]])
def test_a_world_whose_z_axis_is_not_up_is_said_and_aligned_on_request(recording, tmp_path, capsys, rotation):
    file = write_rows(tmp_path / "a.txt", tum_rows(turned(Rotation.from_rotvec(rotation))))
    _, _, said = score(recording, capsys, file)
    assert "off the vertical" in said
    assert "--align se3" in said
    _, scores, said = score(recording, capsys, file, "--align", "se3")
    assert scores["ape_rmse_m"] < 1e-6
    assert "off the vertical" not in said


def test_attitudes_of_the_world_in_the_frame_are_said(recording, tmp_path, capsys):
    turning = Rotation.from_rotvec(np.outer(np.linspace(0, 3, len(WALK)), [0.2, 0.4, 1.0]))
    q = turning.as_quat(scalar_first=True)
    walk = Trajectory(t_ns=WALK.t_ns, p_frame_in_world=WALK.p_frame_in_world, q_world_frame=q)
    inverse = Trajectory(t_ns=WALK.t_ns, p_frame_in_world=WALK.p_frame_in_world, q_world_frame=q * [1, -1, -1, -1])
    truth = write_truth(tmp_path / "walk.mcap", walk)
    assert "the inverse" in score(truth, capsys, write_rows(tmp_path / "a.txt", tum_rows(inverse)))[2]
    assert "warning" not in score(truth, capsys, write_rows(tmp_path / "b.txt", tum_rows(walk)))[2]


def curve():
    """A way that bends, with a frame that turns about all axes."""
    s = WALK.t_ns / 1e9
    p = np.column_stack([1.2 * s * np.cos(0.05 * s), 1.2 * s * np.sin(0.05 * s), np.full(len(s), 1.6)])
    return p, Rotation.from_euler(
        "zyx", np.column_stack([0.1 * s + 0.3 * np.sin(s), 0.1 * np.sin(s), 0.1 * np.sin(0.7 * s)])
    )


def rows_of(p, R):
    return tum_rows(Trajectory(t_ns=WALK.t_ns, p_frame_in_world=p, q_world_frame=R.as_quat(scalar_first=True)))


def test_another_frame_unit_or_handedness_is_named(tmp_path, capsys):
    p, R = curve()
    truth = Trajectory(t_ns=WALK.t_ns, p_frame_in_world=p, q_world_frame=R.as_quat(scalar_first=True))
    recording = write_truth(tmp_path / "walk.mcap", truth)
    camera = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    for rows, says in (
        (rows_of(p, R), ""),
        (rows_of(p, R * camera), "its frame is turned by 120° from foot_l/imu all the way"),
        (rows_of(p * [1, -1, 1], R), "left and right exchanged: expected a right-handed world"),
        (rows_of(1000 * p, R), "1000 times as far apart as the true ones': expected metres; --length-unit mm"),
        (rows_of(100 * p, R), "--length-unit cm"),
    ):
        code, _, said = score(recording, capsys, write_rows(tmp_path / "a.txt", rows))
        assert says in said
        assert ("warning" in said or "error" in said) == bool(says)
        assert code == (2 if "apart" in says or "--length" in says else 0)
    file = write_rows(tmp_path / "b.txt", rows_of(1000 * p, R))
    _, scores, _ = score(recording, capsys, file, "--length-unit", "mm")
    assert scores["ape_rmse_m"] < 1e-3


def test_stamps_in_nanoseconds_are_read_and_another_clock_is_named(recording, tmp_path, capsys):
    file = write_rows(tmp_path / "orb.txt", [[f"{float(row[0]) * 1e9 + 1.4e18:.6f}", *row[1:]] for row in ROWS])
    code, _, said = score(recording, capsys, file)
    assert code == 2
    assert "in ns: is it another clock? --time-offset -1400000000.000" in said
    _, scores, said = score(recording, capsys, file, "--time-offset", -1_400_000_000)
    assert scores["end_error_m"] < 1e-3
    assert scores["coverage_pct"] > 99.9


def test_options_of_files_need_a_file(recording, capsys):
    assert main(["score", str(recording), "--quaternion", "wxyz"]) == 2
    assert "expected --estimate or --program" in capsys.readouterr().err
    assert main(["estimate", "terrain_map", str(recording), "--time-unit", "ns", "-o", "map.json"]) == 2
    assert "expected --poses FILE" in capsys.readouterr().err


def test_holes_are_gaps_of_much_more_than_the_period():
    second = 1_000_000_000
    t_ns = np.arange(0, 20 * second + 1, second // 10)
    assert compute_covered_share(t_ns, 0, 20 * second) == 1.0
    assert compute_covered_share(t_ns[::20], 0, 20 * second) == 1.0
    assert compute_covered_share(np.delete(t_ns, slice(51, 54)), 0, 20 * second) == 1.0  # three poses are no hole
    assert compute_covered_share(np.delete(t_ns, slice(50, 100)), 0, 20 * second) == pytest.approx(0.745)
    assert compute_covered_share(t_ns[:1], 0, 20 * second) == 0.0
    assert compute_covered_share(np.empty(0, np.int64), 0, 20 * second) == 0.0
    assert reaches_end(t_ns, 20 * second + second // 10)
    assert not reaches_end(t_ns, 21 * second)


def test_one_warning_for_many_walks():
    walks = [("a", {"mine": {"coverage_pct": 99.0}}), ("b", {"mine": {"coverage_pct": 40.0}, "other": {}})]
    (warning,) = describe_partial(walks)
    assert warning.startswith("mine covers 40.0 % of b, and less than 95 % of 1 of 2 walks: ")
