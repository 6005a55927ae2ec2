"""Door frames on the way: their parts, who fits through, what a sonar and a depth camera see, and what is refused."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from stridetwin.scenarios.scenario_file import scenario_of
from stridetwin.sim.config import Level, Person, Route, Thing, TwinConfig
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.limbs import find_shapes
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.errors import StrideTwinError

DOOR = Thing(kind="door", at_m=2.0)
PARTS = 6  # two walls, two jambs, the head, and the wall above it


def corridor(*things: Thing, width_m: float = 1.8) -> Terrain:
    segments = (Level(length_m=4.0),)
    return Terrain.from_route(Route(segments=segments, width_m=width_m, scenery="corridor", things=things))


def read(**node: object) -> None:
    scenario = {"description": "doors", "terrain": [{"level": {"length_m": 4}}], "width_m": 1.8} | node
    scenario_of(scenario, Path("doors.yaml"))


def test_a_door_fills_a_corridor_but_for_its_opening() -> None:
    terrain = corridor(DOOR)
    assert len(terrain.landmarks) == len(corridor().landmarks) + PARTS
    y, z = np.meshgrid(np.arange(-0.895, 0.9, 0.01), np.arange(0.005, 2.7, 0.01))
    origins = np.stack([np.full(y.size, 1.9), y.ravel(), z.ravel()], axis=1)
    hits = terrain.ray_cast(origins, np.tile([1.0, 0.0, 0.0], (y.size, 1))) < 0.3
    open_area = 1e-4 * np.count_nonzero(~hits)
    assert open_area == pytest.approx(0.90 * 2.10, rel=0.01)
    assert np.abs(origins[~hits, 1]).max() < 0.45
    assert origins[~hits, 2].max() < 2.10


@pytest.mark.parametrize("person", [Person(), Person(height_m=1.95, mass_kg=110)], ids=lambda p: f"{p.height_m:g} m")
def test_people_with_their_exoskeleton_pass_without_touching_it(person: Person) -> None:
    terrain = corridor(DOOR)
    route = terrain.route
    twin = Twin(TwinConfig(name="door", route=route, person=person, sensors=("foot_imu",)), 1000)
    frame = [mark.box for mark in terrain.landmarks if mark.material == "wood"]
    model, data = twin.model, mujoco.MjData(twin.model)
    bodies = {b for b in range(1, model.nbody) if model.body(b).name.startswith(("hand", "forearm", "head", "exo_"))}
    shapes = [(b, shape) for b in bodies for shape in find_shapes(model, {b})]
    closest = np.inf
    for t in np.arange(0.0, twin.duration_s, 0.02):
        data.qpos = twin.walk.position_velocity(np.array([t]))[0][0]
        mujoco.mj_kinematics(model, data)
        for body, shape in shapes:
            R = data.xmat[body].reshape(3, 3)
            p = data.xpos[body] + R @ shape.p
            reach = np.abs(R @ shape.R) @ shape.size  # at least as large as the shape along each axis
            for box in frame:
                half = np.array([box.length, box.width, box.start - box.bottom]) / 2
                middle = np.array([box.x, box.y, (box.start + box.bottom) / 2])
                closest = min(closest, float((np.abs(p - middle) - half - reach).max()))
    assert 0.0 < closest < 0.2


def test_an_opening_may_be_wide_and_aside_within_the_way() -> None:
    terrain = corridor(Thing(kind="door", at_m=2.0, left_m=0.15, opening_m=1.3))
    jambs = [mark.box for mark in terrain.landmarks if mark.material == "wood" and mark.box.width < 0.1]
    assert sorted(jamb.y for jamb in jambs) == pytest.approx([0.15 - 0.675, 0.15 + 0.675])
    # beside a jamb at the border there is no wall
    edge = corridor(Thing(kind="door", at_m=2.0, left_m=0.15, opening_m=1.4))
    assert len(edge.landmarks) == len(corridor().landmarks) + PARTS - 1


@pytest.mark.parametrize(
    ("node", "words"),
    [
        ({"things": [{"door": {"at_m": 2, "opening_m": 1.8}}]}, "things[0].opening_m: invalid 1.8: expected 1.70 or"),
        ({"things": [{"door": {"at_m": 2, "opening_m": 0.5}}]}, "opening_m: invalid 0.5: expected 0.8"),
        (
            {"things": [{"door": {"at_m": 2, "left_m": 0.3}}]},
            "things[0]: invalid 'a door at 2 m': expected 0.4 m clear",
        ),
        ({"things": [{"door": {"at_m": 2}}], "bystanders": 1}, "bystanders: invalid 1: expected 0, as nobody"),
        ({"things": [{"table": {"at_m": 2, "left_m": 1.5, "opening_m": 1}}]}, "invalid 'opening_m'"),
        ({"things": [{"door": {"at_m": 40}}]}, "expected a place on one level of the way, 0.14 m long"),
    ],
)
def test_a_door_that_cannot_be_built_is_refused_in_one_line(node: dict[str, object], words: str) -> None:
    with pytest.raises(StrideTwinError) as raised:
        read(**node)
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)
