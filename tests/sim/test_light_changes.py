"""Light that changes during a walk: its course, what image sensors make of it, and what it leaves alone."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stridetwin.scenarios.scenario_file import scenario_of
from stridetwin.sim.config import Gait, Level, LightChange, Route, TwinConfig
from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.rendering.imager import ImageSensor
from stridetwin.sim.twin import Twin
from stridetwin.sim.world.light import LightCourse, plan_light
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.samples import Depth, Image
from tests.small_camera import one_renderer, small_camera

LEVEL = (Level(length_m=5.0),)
DIM = LightChange(to=0.1, at_s=2.0, over_s=1.0)
times = st.floats(0.0, 20.0)
changes = st.lists(
    st.builds(LightChange, to=st.floats(0.002, 1.4), at_s=times, over_s=st.floats(0.0, 5.0)), min_size=1, max_size=4
)


def course(*light_changes: LightChange, light: float = 1.0) -> LightCourse:
    route = Route(segments=LEVEL, light=light, light_changes=light_changes)
    return plan_light(route, 10.0, lambda t: 0.5 * t)  # 5 m in 10 s


def at(lit: LightCourse, t_s: float) -> float:
    return lit.factor(round(t_s * 1e9))


def test_a_change_has_equal_ratios_in_equal_times() -> None:
    lit = course(DIM, light=0.8)
    assert at(lit, 1.9) == pytest.approx(1.0)
    assert at(lit, 3.1) == at(lit, 9.0) == pytest.approx(0.1 / 0.8)
    assert at(lit, 2.5) == pytest.approx(math.sqrt(0.1 / 0.8))


def test_a_change_at_a_place_begins_when_the_walker_gets_there_or_never() -> None:
    lit = course(LightChange(to=0.5, at_m=2.0, over_s=0.1))
    assert at(lit, 3.9) == pytest.approx(1.0)
    assert at(lit, 4.2) == pytest.approx(0.5)
    assert course(LightChange(to=0.5, at_m=6.0)).factor(10**10) == 1.0


def test_a_change_ends_the_one_before_it_where_the_light_is_then() -> None:
    lit = course(LightChange(to=0.01, at_s=1.0, over_s=4.0), LightChange(to=1.0, at_s=3.0, over_s=1.0))
    assert at(lit, 3.0) == pytest.approx(0.1)
    assert at(lit, 5.0) == pytest.approx(1.0)


@given(changes=changes, t_s=times)
def test_the_light_stays_between_its_levels_and_ends_at_that_of_the_last_change(
    changes: list[LightChange], t_s: float
) -> None:
    lit = course(*changes)
    levels = [1.0, *(change.to for change in changes)]
    assert min(levels) - 1e-9 <= at(lit, t_s) <= max(levels) + 1e-9
    last = max(range(len(changes)), key=lambda i: (changes[i].at_s, i))
    assert at(lit, 30.0) == pytest.approx(changes[last].to)
    assert list(lit.t_s) == sorted(lit.t_s)


@pytest.mark.parametrize("share", [0.02, 0.3, 1.2])
@pytest.mark.parametrize("part", ["acA800-200gc", "D455"])
def test_less_light_is_less_light_for_a_sensor_whatever_it_comes_from(part: str, share: float) -> None:
    imager = load_part(part).imager  # type: ignore[union-attr]
    clean = np.random.default_rng(0).integers(0, 256, (60, 80), dtype=np.uint8)
    changed = LightCourse(t_s=(0.0,), log_factor=(math.log(share),))
    measured = [
        ImageSensor(clean.shape, imager, light, Noise.of_topic(4, "/camera"), lit).expose(7, clean).astype(int)
        for light, lit in ((0.8, changed), (0.8 * share, LightCourse()))
    ]
    assert np.abs(measured[0] - measured[1]).max() <= 1  # rounding
    assert np.mean(measured[0] != measured[1]) < 0.01


def test_images_darken_and_depth_poses_and_other_sensors_stay(tmp_path: Path) -> None:
    config = TwinConfig(
        name="dim",
        route=Route(segments=(Level(length_m=0.5),), scenery="corridor"),
        gait=Gait(stand_s=0.5),
        sensors=("head_camera", "head_imu"),
        fittings={"head_camera": SensorConfig(part=small_camera(tmp_path))},
    )
    dimmed = replace(config, route=replace(config.route, light_changes=(LightChange(to=0.02, at_s=0.5),)))
    found = []
    with one_renderer():
        for each in (config, dimmed):
            items = [item for chunk in Twin(each, 7).blocks() for item in chunk]
            images = {item.t_ns: item.pixels for item in items if isinstance(item, Image)}
            depths = {item.t_ns: item.depth for item in items if isinstance(item, Depth)}
            others = [item for item in items if not isinstance(item, Image | Depth)]
            found.append((images, depths, others))
    (before, depths, others), (after, same_depths, same_others) = found
    for t_ns, pixels in before.items():
        if t_ns < 5e8:
            assert np.array_equal(pixels, after[t_ns])
    first = min(t for t in before if t > 5.1e8)
    assert after[first].mean() < 0.1 * before[first].mean()  # the exposure lags behind
    assert after[max(after)].mean() > 4 * after[first].mean()
    assert all(np.array_equal(depth, same_depths[t_ns]) for t_ns, depth in depths.items())
    for one, other in zip(others, same_others, strict=True):
        for name in getattr(one, "columns", {}):
            assert np.array_equal(one.columns[name], other.columns[name])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"to": 0.5}, "light_changes[0]: invalid []: expected either at_s or at_m"),
        ({"to": 0.5, "at_s": 1, "at_m": 2}, "expected either at_s or at_m"),
        ({"to": 0, "at_s": 1}, "light_changes[0].to: invalid 0: expected 0.002"),
        ({"at_s": 1}, "light_changes[0]"),
        ({"to": 0.5, "at_s": -1}, "light_changes[0].at_s: invalid -1"),
    ],
)
def test_a_change_that_says_too_little_or_too_much_is_refused(change: dict[str, float], words: str) -> None:
    node = {"description": "x", "terrain": [{"level": {"length_m": 3}}], "light_changes": [change]}
    with pytest.raises(StrideTwinError) as raised:
        scenario_of(node, Path("light.yaml"))
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)
