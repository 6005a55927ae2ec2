"""The random search for sure and wrong steps: its walks, and one of them to the end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import sure_and_wrong
from stridetwin.outputs.modes.scores import ScoredMode
from stridetwin.sim.config import Level, Stairs, Turn
from stridetwin.sim.faults.faults import FaultPlan
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.twin import Twin
from stridetwin.sim.world.route import lay_out
from stridetwin.streams.samples import Depth, Image, Insole


@pytest.mark.parametrize("family", sure_and_wrong.FAMILIES)
def test_walks_are_drawn_from_their_seed_and_have_a_way(family):
    for seed in range(12):
        walk = sure_and_wrong.draw_search_walk(family, seed)
        lay_out(walk.config.route)
        assert walk == sure_and_wrong.draw_search_walk(family, seed)
        assert walk.config.physics == "kinematic"
        begin_s, end_s = walk.dark_s
        assert (end_s > begin_s) == (family in ("dark", "blind")) or family == "mixed"
        assert walk.poses == "dvio" or begin_s == end_s


def test_families_have_what_they_are_named_after():
    turns = [sure_and_wrong.draw_search_walk("turn", seed).config.route.segments for seed in range(5)]
    assert all(any(isinstance(segment, Turn) for segment in way) for way in turns)
    assert sure_and_wrong.draw_search_walk("pause", 0).config.gait.pattern == "wander"
    part = sure_and_wrong.draw_search_walk("narrow", 0).config.fittings["head_camera"].part
    half_rad = np.arctan(np.array([part.imager.width, part.imager.height]) / 2.0 / part.imager.focal)
    np.testing.assert_allclose(np.degrees(2.0 * half_rad), [55.0, 43.0], atol=0.5)


def test_in_the_dark_images_are_dark_and_depth_stays_unless_the_walk_is_blind():
    walk = replace(sure_and_wrong.draw_search_walk("dark", 0), dark_s=(1.0, 2.0))
    mount = walk.config.rig_mount
    made = [
        sample
        for t_ns in (0, 15 * 10**8, 25 * 10**8)
        for sample in (
            Image(topic=f"/{mount}/color", t_ns=t_ns, pixels=np.full((2, 2), 90, np.uint8)),
            Depth(topic=f"/{mount}/depth", t_ns=t_ns, depth=np.ones((2, 2), np.float32)),
            Insole(topic="/foot_l/insole", t_ns=t_ns, force=np.ones(4)),
        )
    ]
    rig = Twin(walk.config, 0).rig
    for blind in (False, True):
        plan = FaultPlan.of(replace(walk, blind=blind).faults, rig, 0, 3.0)
        arrived = list(plan.samples(iter(made)))
        assert [bool((s.pixels > 20).any()) for s in arrived if isinstance(s, Image)] == [True, False, True]
        assert len([s for s in arrived if isinstance(s, Depth)]) == (2 if blind else 3)
        assert [s for s in arrived if isinstance(s, Insole)] == [s for s in made if isinstance(s, Insole)]
    assert not sure_and_wrong.draw_search_walk("turn", 0).faults


def step(mode, predicted, probability):
    return ScoredMode(
        t_s=1.0,
        mode=mode,
        before="LG",
        predicted=predicted,
        allowed=(mode,),
        lead_s=0.0,
        probabilities=(probability, 1.0 - probability, 0.0, 0.0, 0.0),
    )


def test_shares_are_those_of_all_steps_and_of_the_worst_walk():
    walks = [[step("LG", "LG", 0.99)] * 6, [step("LG", "LG", 0.99), step("SA", "LG", 0.95), step("SA", "LG", 0.6)]]
    rows = [{"steps": len(walk), "wrong": sure_and_wrong.list_wrong_steps(walk)} for walk in walks]
    figures = sure_and_wrong.summarise(rows)
    assert figures["right_pct"] == pytest.approx(100 * 7 / 9)
    assert figures["sure_and_wrong_pct"] == pytest.approx(100 / 9)
    assert figures["worst_walk_pct"] == pytest.approx(100 / 3)


def test_a_turn_on_the_spot_before_a_stair_makes_no_step_wrong(tmp_path):
    """Seed 0 of the walks on which the habit of joining the feet was learnt from a turn."""
    walk = sure_and_wrong.draw_search_walk("turn", 0)
    segments = (
        Level(length_m=1.5),
        Turn(angle_rad=1.2, radius_m=0.0),
        Level(length_m=0.6),
        Stairs(risers=3, riser_m=0.16, tread_m=0.29),
        Level(length_m=1.5),
    )
    config = replace(
        walk.config,
        name="spot",
        route=replace(walk.config.route, segments=segments, width_m=1.0),
        gait=replace(walk.config.gait, stand_s=0.5, speed_mps=0.9),
        fittings={"head_camera": SensorConfig(rate_hz=10.0)},
    )
    steps = sure_and_wrong.predict_walk(replace(walk, config=config, poses="given"), 0, tmp_path)
    assert len(steps) > 8
    assert not [wrong for wrong in sure_and_wrong.list_wrong_steps(steps) if wrong["probability"] > 0.9]
    assert sum(s.is_correct for s in steps) >= len(steps) - 1
