"""Recorded people: readers, inverse kinematics, feet on the ground, terrain, loops, and the twin that plays them."""

import gzip
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from stridetwin.scenarios.scenario_file import scenario_of
from stridetwin.sim.config import Level, Motion, Person, Ramp, Route, Stairs, TwinConfig
from stridetwin.sim.motion.feet import sole_points
from stridetwin.sim.motion.fit import FittedWalk, fit_markers, track_feet
from stridetwin.sim.motion.ik import PointSet, calibrate, solve_coordinates
from stridetwin.sim.motion.loop import loop_walk
from stridetwin.sim.motion.marker_sets import describe_site, place_markers
from stridetwin.sim.motion.parameters import MotionParameters
from stridetwin.sim.motion.read import read_markers, read_number_table, read_trc
from stridetwin.sim.motion.skeleton import LengthChanges, Skeleton, length_values, lengths_of, with_lengths, with_twist
from stridetwin.sim.twin import Twin
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.errors import ConfigError
from tests.mocap import MOCAP, needs_mocap
from tests.motion_files import PERSON, plan_walk, write_trc

_PERSON = Person(height_m=1.75)


@cache
def _fit(name: str) -> FittedWalk:
    return fit_markers(read_markers(MOCAP / f"{name}.trc.gz"), _PERSON)


def _trc(rows: int = 30, unit: str = "mm", cell: str = "10.0") -> str:
    head = "PathFileType\t4\t(X/Y/Z)\tx.trc\nDataRate\tNumFrames\tNumMarkers\tUnits\n100\t30\t2\t" + unit
    lines = [f"{i + 1}\t{i * 0.01:.2f}\t1000\t2000\t3000\t{cell}\t0\t0" for i in range(rows)]
    return head + "\nFrame#\tTime\tLASI\t\t\tRASI\t\t\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n" + "\n".join(lines) + "\n"


def test_trc_in_mm_with_gaps(tmp_path: Path) -> None:
    path = tmp_path / "walk.trc.gz"
    path.write_bytes(gzip.compress(_trc().replace("\t10.0\t0\t0", "\t0\t0\t0", 1).encode()))
    table = read_trc(path)
    assert table.names == ("LASI", "RASI")
    np.testing.assert_allclose(table.x[:, 0], np.tile([1.0, 2.0, 3.0], (30, 1)))
    assert np.isnan(table.x[0, 1]).all()
    np.testing.assert_allclose(table.x[1, 1], [0.01, 0.0, 0.0])


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("nothing", "line 1"),
        (_trc(unit="furlong"), "Units"),
        (_trc(cell="abc"), "line 6"),
        (_trc(rows=3), "frames"),
    ],
)
def test_bad_trc_is_one_line(tmp_path: Path, text: str, field: str) -> None:
    path = tmp_path / "walk.trc"
    path.write_text(text)
    with pytest.raises(ConfigError, match="expected") as caught:
        read_markers(path)
    assert field in str(caught.value)
    assert "\n" not in str(caught.value)


def test_angles_in_degrees(tmp_path: Path) -> None:
    path = tmp_path / "walk.mot"
    rows = "\n".join(f"{i * 0.01}\t90\t1.5" for i in range(25))
    path.write_text(f"Coordinates\nnRows=25\ninDegrees=yes\nendheader\ntime\tknee_angle_r\tpelvis_tx\n{rows}\n")
    table = read_number_table(path)
    np.testing.assert_allclose(table.column("knee_angle_r"), np.pi / 2)
    np.testing.assert_allclose(table.column("pelvis_tx"), 1.5)


def test_unknown_markers_are_refused() -> None:
    with pytest.raises(ConfigError, match="plug_in_gait"):
        place_markers("file", ["A", "B", "C"])


def test_left_and_right_sites_mirror() -> None:
    left, right = describe_site("knee_lateral", "l"), describe_site("knee_lateral", "r")
    assert (left.body, right.body) == ("thigh_l", "thigh_r")
    assert left.place_m[1] == -right.place_m[1] > 0


def test_jacobians_are_the_differences() -> None:
    person = with_twist(lengths_of(_PERSON), 0.2)
    skeleton, rng = Skeleton.of(person), np.random.default_rng(1)
    x = 0.4 * rng.normal(size=(3, len(skeleton.layout.names)))
    bodies = np.array([skeleton.index(name) for name in ("toe_l", "head", "hand_r")])
    places = 0.1 * rng.normal(size=(3, 3))
    poses = skeleton.poses(x)
    at, step = skeleton.points(poses, bodies, places), 1e-6
    J = skeleton.jacobian(poses, bodies, at)
    for k in range(x.shape[1]):
        moved = x.copy()
        moved[:, k] += step
        np.testing.assert_allclose(
            (skeleton.points(skeleton.poses(moved), bodies, places) - at) / step, J[..., k], atol=1e-5
        )
    turned = skeleton.with_twist(0.2 + step)
    np.testing.assert_allclose(
        (turned.points(turned.poses(x), bodies, places) - at) / step,
        skeleton.twist_jacobian(poses, bodies, at),
        atol=1e-5,
    )
    by_length = LengthChanges.of(person).jacobian(skeleton, poses, bodies)
    for k, value in enumerate(length_values(person)):
        lengths = length_values(person)
        lengths[k] = value + 0.004
        other = Skeleton.of(with_lengths(person, lengths))
        np.testing.assert_allclose(
            (other.points(other.poses(x), bodies, places) - at) / 0.004, by_length[..., k], atol=1e-6
        )


def test_normal_equations_are_those_of_the_jacobian() -> None:
    """Sums over composite bodies, and places that are linear in the lengths, are exact."""
    rng = np.random.default_rng(1)
    person = lengths_of(_PERSON)
    lengths = length_values(person) + rng.uniform(-0.02, 0.02, len(length_values(person)))
    changes = LengthChanges.of(person)
    skeleton = changes.apply(Skeleton.of(person), lengths - length_values(person))
    other = Skeleton.of(with_lengths(person, lengths))
    np.testing.assert_allclose(skeleton.offset, other.offset, atol=1e-9)
    np.testing.assert_allclose(skeleton.anchor, other.anchor, atol=1e-9)
    bodies = rng.integers(0, len(skeleton.bodies), 40)
    poses = skeleton.poses(rng.normal(0.0, 0.5, (3, len(skeleton.layout.names))))
    at = skeleton.points(poses, bodies, rng.normal(0.0, 0.2, (40, 3)))
    weights, errors = rng.uniform(0.0, 2.0, (3, 40)), rng.normal(size=(3, 40, 3))
    J = skeleton.jacobian(poses, bodies, at)
    H, g = skeleton.gather(poses, bodies, at, weights, errors)
    np.testing.assert_allclose(H, np.einsum("npid,npie,np->nde", J, J, weights), atol=1e-9)
    np.testing.assert_allclose(g, np.einsum("npid,npi,np->nd", J, errors, weights), atol=1e-9)


def test_fit_finds_lengths_and_motion_again() -> None:
    """Markers made from a person with long thighs and twisted shanks give these and the motion back."""
    start = lengths_of(_PERSON)
    lengths = length_values(start)
    lengths[0] += 0.03  # thigh
    twist = np.radians(25.0)
    truth = Skeleton.of(with_twist(with_lengths(start, lengths), twist))
    t = np.linspace(0.0, 3.0, 150)
    x = np.zeros((len(t), len(truth.layout.names)))
    x[:, 2] = 0.9
    for side, phase in (("l", 0.0), ("r", np.pi)):
        x[:, truth.column(f"hip_flexion_{side}")] = 0.3 + 0.4 * np.sin(2 * t + phase)
        x[:, truth.column(f"knee_flexion_{side}")] = 0.8 + 0.6 * np.cos(2 * t + phase)
        x[:, truth.column(f"hip_adduction_{side}")] = 0.1 * np.sin(3 * t + phase)
        x[:, truth.column(f"ankle_dorsiflexion_{side}")] = 0.2 * np.sin(4 * t)
    sites = ("asis", "psis", "thigh", "knee_lateral", "knee_medial", "hip_centre", "shank", "ankle_lateral",
             "ankle_medial", "heel", "toe", "metatarsal_5", "acromion")  # fmt: skip
    marks = [describe_site(site, side) for site in sites for side in ("l", "r")]
    bodies, places = np.array([truth.index(m.body) for m in marks]), np.array([m.place_m for m in marks])
    paths = truth.points(truth.poses(x), bodies, places)
    points = PointSet(
        names=tuple(map(str, range(len(marks)))),
        bodies=bodies,
        places=places,
        sd_m=np.array([m.sd_m for m in marks]),
        paths=paths,
        weights=np.full(paths.shape[:2], 1.0 / 0.006),
    )
    parameters = MotionParameters()
    begin = x + 0.05
    fitted, points = calibrate(start, points, begin, parameters)
    assert fitted.segments is not None
    assert fitted.segments.thigh_m == pytest.approx(lengths[0], abs=0.006)
    assert fitted.segments.shank_twist_rad == pytest.approx(twist, abs=np.radians(4.0))  # the usual twist pulls
    skeleton = Skeleton.of(fitted)
    solved = solve_coordinates(skeleton, points, begin, t[1] - t[0], parameters)
    at = skeleton.points(skeleton.poses(solved), bodies, points.places)
    assert np.sqrt(np.mean(np.sum((at - paths) ** 2, axis=2))) < 0.002


@needs_mocap
@pytest.mark.parametrize(("name", "most_rms_mm"), [("stair_up", 9.0), ("opencap_walking", 9.0), ("level_turn", 11.0)])
def test_soles_rest_on_the_ground(name: str, most_rms_mm: float) -> None:
    walk = _fit(name)
    rms = 1e3 * np.sqrt(np.mean(np.square(list(walk.residuals_m.values()))))
    assert rms < most_rms_mm
    terrain, shoe = Terrain.from_route(walk.ground.route), walk.skeleton.size.shoe
    for track in track_feet(walk.skeleton, walk.x):
        corners = sole_points(track, shoe)
        depth = np.max(terrain.height(corners[..., :2]) - corners[..., 2], axis=1)
        assert np.percentile(depth, 99.5) < 0.005
        assert depth.max() < 0.010
        for rest in walk.rests:
            if rest.side == track.side and rest.flat is not None:
                for point in (track.point(shoe.heel_back_x), track.ball(shoe)):
                    assert np.ptp(point[slice(*rest.flat), :2], axis=0).max() < 0.002


@needs_mocap
def test_stairs_are_found() -> None:
    walk = _fit("stair_up")
    np.testing.assert_allclose(walk.ground.riser_mm, [168, 166, 163, 161], atol=5)
    np.testing.assert_allclose(walk.ground.tread_mm, [295], atol=25)


@pytest.mark.parametrize(("slope_deg", "down"), [(3.0, False), (5.0, True), (8.0, False)])
def test_ramps_are_found(tmp_path: Path, slope_deg: float, down: bool) -> None:
    """Markers of a planned walk over a ramp between two levels give the ramp back, and soles lie on it."""
    ramp = Ramp(angle_rad=np.radians(slope_deg), rise_m=0.3, down=down)
    write_trc(tmp_path / "walk.trc", plan_walk((Level(length_m=1.5), ramp, Level(length_m=1.5))), 1)
    walk = fit_markers(read_trc(tmp_path / "walk.trc"), PERSON)
    assert [type(segment) for segment in walk.ground.route.segments] == [Level, Ramp, Level]
    found = walk.ground.route.segments[1]
    assert isinstance(found, Ramp)
    assert np.degrees(found.angle_rad) == pytest.approx(slope_deg, abs=0.5)
    assert found.rise_m == pytest.approx(0.3, abs=0.01)
    assert found.down == down
    terrain, shoe = Terrain.from_route(walk.ground.route), walk.skeleton.size.shoe
    for track in track_feet(walk.skeleton, walk.x):
        corners = sole_points(track, shoe)
        depth = np.max(terrain.height(corners[..., :2]) - corners[..., 2], axis=1)
        assert depth.max() < 0.005
    given = fit_markers(read_trc(tmp_path / "walk.trc"), PERSON, route=walk.ground.route)
    np.testing.assert_allclose(given.ground.slopes, walk.ground.slopes, atol=1e-3)
    np.testing.assert_allclose(given.x, walk.x, atol=0.01)


def test_ramp_is_found_from_its_middle(tmp_path: Path) -> None:
    """A recording that never leaves the ramp has its slope from the heights of its rests."""
    ramp = Ramp(angle_rad=np.radians(5.0), rise_m=0.45)
    write_trc(tmp_path / "walk.trc", plan_walk((Level(length_m=1.5), ramp, Level(length_m=1.5))), 1)
    table = read_trc(tmp_path / "walk.trc")
    rows = np.flatnonzero((table.x[:, 0, 0] > 2.2) & (table.x[:, 0, 0] < 6.0))
    walk = fit_markers(replace(table, t=table.t[rows], x=table.x[rows] + [0.0, 0.0, 0.4]), PERSON)
    assert walk.ground.ramp_deg == pytest.approx(5.0, abs=0.5)


@pytest.mark.parametrize(("risers", "riser_m"), [(1, 0.12), (3, 0.10)])
def test_low_steps_are_no_ramp(tmp_path: Path, risers: int, riser_m: float) -> None:
    steps = Stairs(risers=risers, riser_m=riser_m, tread_m=0.4)
    write_trc(tmp_path / "walk.trc", plan_walk((Level(length_m=1.5), steps, Level(length_m=1.5))), 2)
    walk = fit_markers(read_trc(tmp_path / "walk.trc"), PERSON)
    assert walk.ground.ramp_deg is None
    np.testing.assert_allclose(walk.ground.riser_mm, 1e3 * riser_m, atol=3.0)


@needs_mocap
@pytest.mark.parametrize("name", ["stair_up", "opencap_walking"])
def test_loop_has_no_jump(name: str) -> None:
    walk = _fit(name)
    looped = loop_walk(walk, 20.0, name)
    assert looped.duration_s == pytest.approx(20.0, abs=looped.dt)
    own, acceleration = (np.abs(np.diff(w.x, 2, axis=0)).max(0) / w.dt**2 for w in (walk, looped))
    assert (acceleration < 3.0 * own + 5.0).all()
    assert np.ptp(looped.x[:, 0]) > 5.0
    np.testing.assert_allclose(looped.ground.tread_mm, walk.ground.tread_mm, atol=10.0)
    for side in ("l", "r"):  # no stance is cut in two where the cycles meet
        rests = [rest.ground for rest in looped.rests if rest.side == side]
        assert min(later[0] - before[1] for before, later in pairwise(rests)) * looped.dt > 0.25


@needs_mocap
def test_twin_plays_a_recording() -> None:
    config = TwinConfig(
        name="recorded",
        route=Route(segments=(Level(length_m=1.0),)),
        person=_PERSON,
        motion=Motion(file=str(MOCAP / "opencap_walking.trc.gz")),
        sensors=("foot_imu", "insole", "encoder"),
    )
    twin = Twin(config, 1)
    blocks = [block for blocks in twin.blocks() for block in blocks]
    assert {"/foot_l/imu", "/foot_r/insole", "/truth/joints"} <= {block.topic for block in blocks}
    with pytest.raises(ConfigError, match="kinematic"):
        Twin(replace(config, physics="dynamic"), 1)


def test_scenario_refuses_what_a_recording_cannot_have(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="existing file"):
        scenario_of({"description": "x", "motion": {"file": "missing.trc"}}, tmp_path / "walk.yaml")
    with pytest.raises(ConfigError, match="terrain: missing"):
        scenario_of({"description": "x"}, tmp_path / "walk.yaml")
    (tmp_path / "walk.trc").write_text(_trc())
    node = {"description": "x", "motion": {"file": "walk.trc"}}
    with pytest.raises(ConfigError, match="no gait"):
        scenario_of(node | {"gait": {"speed_mps": 1.0}}, tmp_path / "walk.yaml")
    with pytest.raises(ConfigError, match="kinematic"):
        scenario_of(node | {"physics": "dynamic"}, tmp_path / "walk.yaml")
    with pytest.raises(ConfigError, match=r"unevenness_mm.*pinned"):
        scenario_of(node | {"unevenness_mm": 8}, tmp_path / "walk.yaml")


def test_c3d_gives_back_the_markers_that_were_written(tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    x = np.random.default_rng(0).normal(size=(25, 2, 3)).cumsum(axis=0)  # m
    content = ezc3d.c3d()
    content["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    content["parameters"]["POINT"]["LABELS"]["value"] = ["LASI", "RASI"]
    content["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    content["data"]["points"] = np.concatenate([1e3 * x.transpose(2, 1, 0), np.ones((1, 2, 25))])
    content.write(str(tmp_path / "two.c3d"))
    table = read_markers(tmp_path / "two.c3d")
    assert table.names == ("LASI", "RASI")
    assert table.t == pytest.approx(0.01 * np.arange(25))
    apart = np.linalg.norm(table.x[:, 0] - table.x[:, 1], axis=1)  # whatever the axes
    assert apart == pytest.approx(np.linalg.norm(x[:, 0] - x[:, 1], axis=1), abs=1e-6)
