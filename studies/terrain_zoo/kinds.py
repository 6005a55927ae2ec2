"""The kinds of walks: what each changes in a walk that is otherwise drawn at random.

Every walk has its own person, speed, gaze, mount, surroundings, light, and calibration errors (`draw_base_walk`); a
kind then replaces what it is about. Parameters are never tuned on kinds with `tuned=False`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stridetwin.sim.config import (
    Gait,
    Gaze,
    Lanes,
    Level,
    Person,
    Ramp,
    Route,
    Segment,
    Stairs,
    Thing,
    Turn,
    TwinConfig,
)
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.nominal import CalibrationSd
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.studies.zhao2023.mode_walks import MOUNTS

Rng = np.random.Generator
MakeWalk = Callable[[TwinConfig, Rng], TwinConfig]
"""Makes a walk of a kind from a random one (`draw_base_walk`); further values are drawn from the generator."""

CALIBRATED = CalibrationSd(
    rotation_rad=math.radians(0.2), position_m=1e-3, intrinsics=1e-3, offset_s=1e-3, depth_scale=5e-3, readout=0.03
)
"""Errors of a careful calibration, as in the walks that test the odometry."""
_SENSORS = ("insole", "head_imu", "head_camera")
_BMI = (19.0, 30.0)  # lowest and highest body mass index, kg/m²
_STOP_M = 0.45  # distance at which the walker stops before an obstacle


def draw_base_walk(rng: Rng) -> TwinConfig:
    """Draws a walk on level ground: person, gait, camera with its calibration errors, and surroundings."""
    height_m = float(rng.uniform(1.52, 1.93))
    mass_kg = float(np.clip(rng.uniform(*_BMI) * height_m**2, 45.0, 110.0))  # body mass index · height²
    person = Person(height_m=height_m, mass_kg=mass_kg, sex=str(rng.choice(["male", "female"])))
    gaze = Gaze(kind=str(rng.choice(["ahead", "terrain", "wandering"])))
    gait = Gait(speed_mps=float(rng.uniform(0.7, 1.35)), step_sd=float(rng.uniform(0.01, 0.03)), gaze=gaze)
    camera = SensorConfig(pitch_down_rad=math.radians(rng.uniform(20.0, 30.0)), calibration_sd=CALIBRATED)
    route = Route(
        segments=(Level(length_m=15.0),),
        width_m=float(rng.uniform(1.2, 2.4)),
        scenery=str(rng.choice(["outdoor", "room", "corridor"])),
        texture=str(rng.choice(["rich", "rich", "plain"])),  # two of three walks are rich
        light=float(rng.uniform(0.75, 1.1)),
    )
    return TwinConfig(
        name="anyone",
        route=route,
        person=person,
        exo=None,
        gait=gait,
        sensors=_SENSORS,
        fittings={"head_camera": camera},
        rig_mount=str(rng.choice(MOUNTS)),
    )


def _with_terrain(config: TwinConfig, *middle: Segment, before_m: float = 3.0, after_m: float = 2.5) -> TwinConfig:
    """The walk over other segments, with level ground of some length before and after them."""
    segments = (Level(length_m=before_m), *middle, Level(length_m=after_m))
    return replace(config, route=replace(config.route, segments=segments))


def _with_camera(config: TwinConfig, **changes: Any) -> TwinConfig:
    """The walk with changed options of the head camera."""
    camera = replace(config.fittings["head_camera"], **changes)
    return replace(config, fittings={**config.fittings, "head_camera": camera})


def _ramp(rng: Rng, low_deg: float, high_deg: float, length_m: float = 4.0, *, down: bool) -> Ramp:
    """Draws the slope of a ramp of a given length, and makes it at least 60 mm high, if need be by more length.

    Args:
        rng: Draws the slope.
        low_deg: Lowest slope.
        high_deg: Highest slope.
        length_m: Horizontal length.
        down: Whether it leads down.
    """
    angle = math.radians(rng.uniform(low_deg, high_deg))
    return Ramp(angle_rad=angle, rise_m=max(0.06, length_m * math.tan(angle)), down=down)


def _ramps(low_deg: float, high_deg: float) -> MakeWalk:
    """Makes walks up a ramp, over a landing, and down another ramp, with slopes between two bounds."""

    def make(config: TwinConfig, rng: Rng) -> TwinConfig:
        """The walk with two ramps drawn between the bounds."""
        up, down = (_ramp(rng, low_deg, high_deg, down=is_down) for is_down in (False, True))
        return _with_terrain(config, up, Level(length_m=float(rng.uniform(1.2, 2.5))), down)

    return make


def _stair(rng: Rng, riser_mm: tuple[float, float], tread_mm: tuple[float, float], risers: tuple[int, int]) -> Stairs:
    """Draws a stair upward.

    Args:
        rng: Draws the values.
        riser_mm: Lowest and highest riser.
        tread_mm: Lowest and highest depth of a tread.
        risers: Fewest and most risers.
    """
    return Stairs(
        risers=int(rng.integers(risers[0], risers[1] + 1)),
        riser_m=1e-3 * float(rng.uniform(*riser_mm)),
        tread_m=1e-3 * float(rng.uniform(*tread_mm)),
    )


def _up_and_down(config: TwinConfig, rng: Rng, stair: Stairs) -> TwinConfig:
    """The walk up a stair, over a landing, and down the same stair."""
    return _with_terrain(config, stair, Level(length_m=float(rng.uniform(1.5, 2.5))), replace(stair, down=True))


def _stairs(riser_mm: tuple[float, float], tread_mm: tuple[float, float], risers: tuple[int, int]) -> MakeWalk:
    """Makes walks up a stair, over a landing, and down, with sizes between bounds."""
    return lambda config, rng: _up_and_down(config, rng, _stair(rng, riser_mm, tread_mm, risers))


def _usual_stair(rng: Rng) -> Stairs:
    """Draws a stair of usual size with three to five risers."""
    return _stair(rng, (140, 190), (260, 320), (3, 5))


def _stair_and_ramp(config: TwinConfig, rng: Rng, low_deg: float = 4.0, high_deg: float = 8.0) -> TwinConfig:
    """The walk up a usual stair, over a landing, and down a ramp whose slope is drawn between two bounds."""
    return _with_terrain(config, _usual_stair(rng), Level(length_m=2.0), _ramp(rng, low_deg, high_deg, down=True))


def _camera(**changes: Any) -> MakeWalk:
    """Makes walks over a stair and a ramp, seen by a changed camera."""
    return lambda config, rng: _stair_and_ramp(_with_camera(config, **changes), rng)


def _keep_walk(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The random walk itself, on level ground."""
    del rng
    return config


def _ramp_with_landing(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over two equal ramps of one direction with a landing between them."""
    down = bool(rng.integers(2))
    ramp = _ramp(rng, 4.0, 8.0, 3.0, down=down)
    return _with_terrain(config, ramp, Level(length_m=float(rng.uniform(1.3, 2.0))), ramp)


def _camber(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a path that is level along and tilted across, in its middle."""
    cross = math.radians(float(rng.choice([-1, 1]) * rng.uniform(1.0, 4.0)))
    segments = (Level(length_m=3.0), Level(length_m=5.0, cross_slope_rad=cross), Level(length_m=3.0))
    return replace(config, route=replace(config.route, segments=segments))


def _ramp_at_stair(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a stair and a ramp without a landing between them, in either order and direction."""
    stair = replace(_usual_stair(rng), down=bool(rng.integers(2)))
    ramp = _ramp(rng, 4.0, 9.0, 3.0, down=bool(rng.integers(2)))
    return _with_terrain(config, *((ramp, stair) if rng.integers(2) else (stair, ramp)))


def _crest(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a crest or a dip: a ramp up directly before or after one down."""
    up, down = (_ramp(rng, 4.0, 9.0, 3.5, down=is_down) for is_down in (False, True))
    return _with_terrain(config, *((up, down) if rng.integers(2) else (down, up)))


def _uneven_stair(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a stair whose risers differ by up to 20 mm from a usual height."""
    even = _usual_stair(rng)
    risers_m = tuple(float(h) for h in even.heights_m[0] + rng.uniform(-0.02, 0.02, even.risers))
    return _up_and_down(config, rng, replace(even, riser_m=risers_m))


def _street(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a kerb, a gentle ramp, and three steps down within a few metres."""
    step = _stair(rng, (90, 140), (300, 300), (1, 1))
    steps = replace(_stair(rng, (130, 180), (280, 330), (3, 3)), down=True)
    landing = Level(length_m=float(rng.uniform(1.5, 2.2)))
    return _with_terrain(config, step, landing, _ramp(rng, 3.5, 6.0, 3.0, down=False), landing, steps)


def _step_by_step(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a stair with both feet on each tread."""
    gait = replace(
        config.gait,
        stairs="step_by_step",
        leading_foot=str(rng.choice(["l", "r"])),
        speed_mps=float(rng.uniform(0.5, 0.9)),
    )
    return _up_and_down(replace(config, gait=gait), rng, _stair(rng, (130, 190), (260, 330), (4, 6)))


def _two_at_a_time(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a stair that takes every second tread on the way up and each one on the way down.

    The walker is tall, with legs that are long enough for these stairs.
    """
    gait = replace(config.gait, stairs="two_at_a_time", speed_mps=float(rng.uniform(0.9, 1.5)))
    person = replace(config.person, height_m=float(rng.uniform(1.75, 1.95)))
    return _up_and_down(replace(config, gait=gait, person=person), rng, _stair(rng, (130, 165), (250, 290), (4, 8)))


def _limp(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a stair and a ramp with steps of unequal length."""
    gait = replace(config.gait, asymmetry=float(rng.choice([-1, 1]) * rng.uniform(0.1, 0.25)))
    return _stair_and_ramp(replace(config, gait=gait), rng, 4.0, 9.0)


def _shuffle(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a ramp and down a stair with short flat steps."""
    gait = replace(config.gait, shuffle=float(rng.uniform(0.3, 0.8)), speed_mps=float(rng.uniform(0.5, 0.9)))
    ramp = _ramp(rng, 4.0, 7.0, 3.0, down=False)
    return _with_terrain(replace(config, gait=gait), ramp, Level(length_m=1.5), replace(_usual_stair(rng), down=True))


def _stroll(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a stair and a ramp with changing speed, and pauses anywhere."""
    gait = Gait.of_pattern("wander", gaze=config.gait.gaze)
    return _stair_and_ramp(replace(config, gait=gait), rng, 4.0, 9.0)


def _fast(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a stair at 1.5 to 1.9 m/s."""
    gait = Gait.of_pattern("jog", gaze=config.gait.gaze, speed_mps=float(rng.uniform(1.5, 1.9)))
    return _up_and_down(replace(config, gait=gait), rng, _usual_stair(rng))


def _turn_at_stair(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk with a turn shortly before a stair, which comes into view late."""
    turn = Turn(angle_rad=math.radians(float(rng.choice([-1, 1]) * rng.uniform(60, 100))), radius_m=1.2)
    return _with_terrain(config, turn, Level(length_m=float(rng.uniform(1.0, 2.0))), _usual_stair(rng))


def _lanes(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over one of three lanes side by side: a stair, a ramp, and level ground."""
    stair, ramp = _usual_stair(rng), _ramp(rng, 5.0, 10.0, 3.0, down=False)
    lanes = ((stair,), (ramp,), (Level(length_m=3.0),))  # segments of each lane
    order = rng.permutation(3)  # from left to right
    side_by_side = Lanes(lanes=tuple(lanes[i] for i in order), walk=int(rng.integers(3)))  # `walk`: the walked lane
    return _with_terrain(replace(config, route=replace(config.route, scenery="outdoor", width_m=1.2)), side_by_side)


def _mount_off(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk with a camera whose nominal pose is wrong by 2° about each axis and by 10 mm (standard deviations)."""
    wrong = _with_camera(config, calibration_sd=replace(CALIBRATED, rotation_rad=math.radians(2.0), position_m=0.01))
    return _stair_and_ramp(wrong, rng)


def _dim(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a stair between white walls in dim light, with few points to track."""
    route = replace(config.route, texture="white", scenery="room", light=float(rng.uniform(0.5, 0.7)))
    return _up_and_down(replace(config, route=route), rng, _usual_stair(rng))


def _sunlight(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a stair and a ramp outdoors, with noisy depth and shadows."""
    route = replace(config.route, scenery="outdoor", light=float(rng.uniform(1.1, 1.3)))
    sunlit = _with_camera(replace(config, route=route), part=load_part("D455-sunlight"), shadows=True)
    return _stair_and_ramp(sunlit, rng, 3.5, 8.0)


def _crowd(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over a stair with two to four other people around."""
    route = replace(config.route, bystanders=int(rng.integers(2, 5)), width_m=2.4, scenery="outdoor")
    return _up_and_down(replace(config, route=route), rng, _usual_stair(rng))


def _scatter_things(rng: Rng, from_m: float, to_m: float) -> tuple[Thing, ...]:
    """Draws places for a table beside the way, and for a stripe and a shadow on it.

    Args:
        rng: Draws the places.
        from_m: Begin of the part of the route with the things.
        to_m: Its end.
    """
    places = np.sort(rng.uniform(from_m, to_m - 1.2, 3))  # m along the route; 1.2 m before the end stay free
    side = float(rng.choice([-1, 1]))  # 1: left
    return (
        Thing(kind="table", at_m=float(places[0]), left_m=side * float(rng.uniform(1.1, 1.3))),
        Thing(kind="stripe", at_m=float(places[1])),
        Thing(kind="shadow", at_m=float(places[2])),
    )


def _clutter(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over level ground with things that resemble steps, and a wall at its end."""
    width_m = float(rng.uniform(2.0, 2.4))
    length_m = 9.0
    wall = Thing(kind="wall", at_m=length_m + _STOP_M)  # the walker stops just before it
    things = (*_scatter_things(rng, 1.5, length_m - 1.0), wall)
    route = replace(config.route, segments=(Level(length_m=length_m),), things=things, width_m=width_m)
    return replace(config, route=replace(route, scenery="outdoor"))


def _clutter_before_stair(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk to a real stair among things that resemble one."""
    width_m = float(rng.uniform(2.0, 2.4))
    route = replace(config.route, things=_scatter_things(rng, 1.0, 5.0), width_m=width_m, bystanders=2)
    config = replace(config, route=replace(route, scenery="outdoor"))
    return _with_terrain(config, replace(_usual_stair(rng), down=bool(rng.integers(2))), before_m=6.0)


def _furniture(config: TwinConfig, rng: Rng) -> TwinConfig:
    """The walk over level ground between furniture, over a mat that has no depth."""
    width_m = float(rng.uniform(2.0, 2.4))
    # of five pieces of furniture: m along the route, 1 for left or -1 for right, and kind
    places = np.arange(1.5, 8.0, 1.3) + rng.uniform(0.0, 0.5, 5)
    sides = rng.permutation([-1.0, -1.0, 1.0, 1.0, float(rng.choice([-1, 1]))])
    kinds = rng.permutation(["chair", "chair", "crate", "crate", "crate"])
    beside = zip(kinds.tolist(), places.tolist(), sides.tolist())
    things = [Thing(kind=kind, at_m=at_m, left_m=side * float(rng.uniform(0.85, 1.1))) for kind, at_m, side in beside]
    things.append(Thing(kind="mat", at_m=float(rng.uniform(2.5, 6.0))))
    segments = (Level(length_m=10.0),)
    return replace(
        config, route=replace(config.route, segments=segments, things=tuple(things), width_m=width_m, scenery="room")
    )


@dataclass(frozen=True)
class WalkKind:
    """A kind of walks in the catalogue.

    Attributes:
        description: What is special about it, for tables.
        make: Makes a walk of this kind from a random one.
        tuned: Whether parameters may be tuned on walks of this kind.
    """

    description: str
    make: MakeWalk
    tuned: bool = True


WALK_KINDS = {
    "level": WalkKind("level, 15 m straight", _keep_walk),
    "ramp_2_3": WalkKind("ramps of 2-3.5°", _ramps(2.0, 3.5)),
    "ramp_3_6": WalkKind("ramps of 3.5-6°", _ramps(3.5, 6.0)),
    "ramp_6_16": WalkKind("ramps of 6-16°", _ramps(6.0, 16.0)),
    "ramp_with_landing": WalkKind("a ramp of 4-8° with a landing", _ramp_with_landing),
    "cambered": WalkKind("a path with a cross slope of 1-4°", _camber),
    "ramp_at_stair": WalkKind("a ramp directly before or after a stair", _ramp_at_stair),
    "crest": WalkKind("a ramp up directly followed by one down", _crest, tuned=False),
    "stair": WalkKind("stairs of 100-220 mm", _stairs((100, 220), (250, 350), (3, 6))),
    "low_stair": WalkKind("stairs of 60-120 mm", _stairs((60, 120), (300, 450), (3, 6))),
    "deep_stair": WalkKind("stairs with treads of 400-600 mm", _stairs((90, 160), (400, 600), (3, 4))),
    "uneven_stair": WalkKind("uneven stairs", _uneven_stair),
    "kerb": WalkKind("a kerb of 80-150 mm", _stairs((80, 150), (300, 300), (1, 1))),
    "threshold": WalkKind("thresholds of 20-45 mm", _stairs((20, 45), (300, 300), (1, 1))),
    "street": WalkKind("a kerb, a gentle ramp, three steps down", _street, tuned=False),
    "step_by_step": WalkKind("stairs step by step", _step_by_step),
    "two_at_a_time": WalkKind("stairs two at a time", _two_at_a_time),
    "limp": WalkKind("a limp on stairs and a ramp", _limp),
    "shuffle": WalkKind("shuffling over a ramp and a stair", _shuffle),
    "stroll": WalkKind("a stroll with pauses", _stroll),
    "fast": WalkKind("fast over stairs", _fast),
    "turn_at_stair": WalkKind("a turn just before a stair", _turn_at_stair),
    "lanes": WalkKind("stair, ramp and level side by side", _lanes, tuned=False),
    "mount_off": WalkKind("a mount 2° off", _mount_off),
    "d435": WalkKind("camera D435", _camera(part=load_part("D435"))),
    "d435i": WalkKind("camera D435i, infrared", _camera(part=load_part("D435i")), tuned=False),
    "oak_d": WalkKind("camera OAK-D", _camera(part=load_part("OAK-D")), tuned=False),
    "azure_kinect": WalkKind("camera Azure Kinect", _camera(part=load_part("Azure-Kinect")), tuned=False),
    "slow_camera": WalkKind("15 images per second", _camera(rate_hz=15.0), tuned=False),
    "dim": WalkKind("white walls in dim light", _dim),
    "sunlight": WalkKind("sunlight", _sunlight),
    "crowd": WalkKind("people walking about", _crowd),
    "clutter": WalkKind("a table, paint, a shadow, a wall at the end", _clutter),
    "cluttered_stair": WalkKind("clutter before a stair, bystanders", _clutter_before_stair, tuned=False),
    "furniture": WalkKind("chairs, crates, a black mat", _furniture, tuned=False),
}
"""Kinds by name; consecutive seeds draw walks of consecutive kinds."""


def draw_walk(name: str, seed: int) -> TwinConfig:
    """Draws the walk of a kind and a seed; equal ones give equal walks.

    Args:
        name: Key of `WALK_KINDS`.
        seed: Seed of the walk.
    """
    # the sum of the name's bytes lets kinds draw different numbers from one seed
    rng = np.random.default_rng([seed, sum(name.encode())])
    return replace(WALK_KINDS[name].make(draw_base_walk(rng), rng), name=name)
