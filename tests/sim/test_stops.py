"""Stops on the way: on the level, on a tread and on a ramp, planned and simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stridetwin.sim.config import Gait, Level, Ramp, Route, Stairs, Stop, TwinConfig
from stridetwin.sim.gait.load import load_shares, standing_time
from stridetwin.sim.twin import Twin
from stridetwin.sim.walk import Stance
from stridetwin.streams.errors import ConfigError

STOPS = (Stop(at_m=1.5, for_s=2.0), Stop(at_m=3.4, for_s=3.0), Stop(at_m=6.4, for_s=1.5))
WALK = TwinConfig(
    name="stops",
    route=Route(
        segments=(
            Level(length_m=3.0),
            Stairs(risers=3),
            Level(length_m=1.5),
            Ramp(angle_rad=0.1, rise_m=0.2),
            Level(length_m=2.0),
        )
    ),
    gait=Gait(stops=STOPS, step_sd=0.0),
    exo=None,
    sensors=(),
)


@pytest.fixture(scope="module")
def planned() -> Twin:
    return Twin(WALK, 0)


def _long_double_supports(twin: Twin) -> list[tuple[Stance, float]]:
    """Each stance that begins while the other foot stays for a second or more, with that time, s."""
    steps = [s for own in twin.reference.steps.values() for s in own]
    pauses = []
    for step in steps:
        offs = [s.t_off for s in steps if s.foot != step.foot and s.t_off > step.t_touch]
        if np.isfinite(step.t_touch) and offs and np.isfinite(min(offs)) and min(offs) - step.t_touch > 1.0:
            pauses.append((step, min(offs) - step.t_touch))
    return sorted(pauses, key=lambda pause: pause[0].t_touch)


def test_walker_stops_where_and_for_as_long_as_asked(planned: Twin) -> None:
    pauses = _long_double_supports(planned)
    assert [step.terrain for step, _ in pauses] == ["level", "stair", "ramp"]
    for (step, seconds), stop in zip(pauses, STOPS, strict=True):
        assert stop.at_m - 0.4 < step.p_foot_in_world[0] < stop.at_m + 0.4
        assert stop.for_s < seconds < stop.for_s + 0.8


def test_body_rests_on_both_feet(planned: Twin) -> None:
    for step, seconds in _long_double_supports(planned):
        middle = np.array([step.t_touch + seconds / 2])
        _, v = planned.walk.position_velocity(middle)
        shares = planned.given_walk.contact_shares(middle)[0, [0, 4]]
        # of 1.2 m/s; the body sways on while it stands for a short time
        assert np.linalg.norm(v[0, :3]) < (0.1 if seconds > 2.0 else 0.2)
        assert shares == pytest.approx([0.5, 0.5], abs=0.01)


def test_standing_counts_pauses_alone(planned: Twin) -> None:
    steps, t = planned.reference.steps, np.arange(0.0, planned.duration_s, 0.01)
    standing = standing_time(steps, t)
    assert np.all(np.diff(standing) > -1e-12)
    # a shift of the load before and after each stop belongs to walking
    assert 0.6 * sum(s.for_s for s in STOPS) < standing[-1] < sum(s.for_s for s in STOPS)
    shares = load_shares(steps, t)
    assert shares["l"] + shares["r"] == pytest.approx(np.ones(len(t)))


def test_stop_changes_no_step_before_it(planned: Twin) -> None:
    # the stop on the tread: the level before it is walked in the same way without it
    without = Twin(replace(WALK, gait=replace(WALK.gait, stops=STOPS[:1])), 0)
    for side in "lr":
        before = [s for s in planned.reference.steps[side] if s.s < 3.0]
        same = without.reference.steps[side][: len(before)]
        assert [s.s for s in same] == pytest.approx([s.s for s in before])


def test_simulated_walker_sets_off_again() -> None:
    twin = Twin(replace(WALK, physics="dynamic"), 0)
    assert twin.fell_at is None
    assert twin.duration_s == pytest.approx(twin.reference.duration_s, abs=2e-3)


def test_stop_beyond_the_way_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"stops.at_m: invalid 80.*less than .* m, the length of the way"):
        Twin(replace(WALK, gait=Gait(stops=(Stop(at_m=80.0, for_s=1.0),))), 0)
