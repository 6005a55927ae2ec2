"""The walks on which Zhao et al. 2023 test the prediction of modes.

**Generality** (Tables II and III): 540 walks. Five groups of height, six terrains, the camera on head or chest, three
patterns of walking: 180 conditions, three walks each, one by each member of the group. Every walk goes level, up,
level, down, level; `reference/zhao2023.yaml` states the terrain where the paper does not. Poses come from the
visual-inertial odometry, or are the true ones. The camera looks 25 degrees down, or 8, as in the paper's mean. Any
sixty consecutive walks are balanced over terrains, mounts and groups; the first sixty, the second sixty, ... also
over the patterns.

**Three trials** (letters of Fig. 3), in which each of the paper's fifteen subjects walks twice:

- `zhao_view` (a): up two flights between walls with an abrupt turn between them, to the left and then to the right. The
  head looks around all the time, up to a radian to either side, so that the route leaves the 80 degree image. A
  camera on the chest hardly rotates, so that it is on the head in both walks.
- `zhao_directions` (b): upwards outdoors, from stair to ramp to stair side by side, camera on head and chest. Sunlight
  overpowers the projector of the depth camera (part `D455-sunlight`).
- `zhao_disturbance` (c): a stair up and down while two people walk around the walker, camera on head and chest.

Unless a scenario states otherwise the gaze wanders. The paper reports no walking patterns of the trials; ours is
a plain walk.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import Gait, Gaze, Turn, TwinConfig
from stridetwin.sim.wearer.anthropometry import PEOPLE
from stridetwin.studies.case import Case
from stridetwin.studies.zhao2023.mode_walks import FORGETFUL, GROUPS, MOUNTS, PredictionSetup, predicted_walk

TERRAINS = {
    "stair_15cm": "zhao_stair_15cm",
    "stair_20cm": "zhao_stair_20cm",
    "stair_25cm": "zhao_stair_25cm",
    "ramp_11.8deg": "zhao_ramp_11_8",
    "ramp_15.8deg": "zhao_ramp_15_8",
    "ramp_17.8deg": "zhao_ramp_17_8",
}
"""The paper's terrains and their scenarios."""
PATTERNS = ("wander", "walk", "jog")
SEEDS = range(1000, 1000 + 9 * len(TERRAINS) * len(MOUNTS) * len(GROUPS))
_BLOCK = len(TERRAINS) * len(MOUNTS) * len(GROUPS)


@dataclass(frozen=True, kw_only=True)
class Condition:
    """Condition of a walk, as in the columns of Table II."""

    height_group: str
    pattern: str
    terrain: str
    mount: str
    member: int


def condition(seed: int) -> Condition:
    """The condition of a seed; seeds below the first cycle through them likewise."""
    i = (seed - SEEDS[0]) % len(SEEDS)
    turn, place = divmod(i, _BLOCK)
    terrain, mount, group = place % 6, place // 6 % 2, place // 12
    return Condition(
        height_group=GROUPS[group],
        pattern=PATTERNS[(terrain + group + mount + turn) % 3],
        terrain=list(TERRAINS)[terrain],
        mount=MOUNTS[mount],
        member=1 + (turn // 3 + group + terrain) % 3,
    )


SUBJECTS = tuple(f"zhao_{group.lower()}_{member}" for member in (1, 2, 3) for group in GROUPS)
TRIAL_SEEDS = range(1000, 1000 + 2 * len(SUBJECTS))
WANDERING = Gaze(kind="wandering")


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One of the tests.

    Attributes:
        scenario: Name in the catalogue.
        second: The change on a subject's second walk.
        paper: Its key in `reference/zhao2023.yaml`.
    """

    scenario: str
    second: Callable[[TwinConfig], TwinConfig]
    paper: str


def _on_chest(config: TwinConfig) -> TwinConfig:
    return replace(config, rig_mount=MOUNTS[1])


def _mirrored(config: TwinConfig) -> TwinConfig:
    """The configuration with turns to the other side."""
    segments = [replace(s, angle_rad=-s.angle_rad) if isinstance(s, Turn) else s for s in config.route.segments]
    return replace(config, route=replace(config.route, segments=tuple(segments)))


TRIALS = {
    "zhao_view": Trial(scenario="zhao_view", second=_mirrored, paper="unconventional_camera_view_pct"),
    "zhao_directions": Trial(scenario="zhao_parallel", second=_on_chest, paper="multi_direction_outdoor_pct"),
    "zhao_disturbance": Trial(scenario="bystanders", second=_on_chest, paper="external_disturbance_pct"),
}


def subject_and_turn(seed: int) -> tuple[str, int]:
    """Subject, and whether it is the first walk (0) or the second (1).

    The first, second and third ten walks contain every group twice, once per variant.
    """
    i = (seed - TRIAL_SEEDS[0]) % len(TRIAL_SEEDS)
    block, place = divmod(i, 2 * len(GROUPS))
    turn, group = divmod(place, len(GROUPS))
    return SUBJECTS[block * len(GROUPS) + group], (turn + group) % 2


def trial_config(name: str, seed: int) -> TwinConfig:
    """Walker, route and gait of a walk of a trial."""
    trial, (subject, turn) = TRIALS[name], subject_and_turn(seed)
    config = load_scenario(trial.scenario).config
    gait = config.gait if config.gait.gaze != Gaze() else replace(config.gait, gaze=WANDERING)
    config = replace(config, person=PEOPLE[subject], gait=gait)
    return trial.second(config) if turn else config


VARIANTS = {
    "zhao_generality": (SEEDS, ("", PredictionSetup())),
    "zhao_generality_given_poses": (SEEDS, ("", PredictionSetup(poses="given"))),
    "zhao_generality_shallow": (SEEDS, ("", PredictionSetup(pitch_down="shallow"))),
    "zhao_baselines": (SEEDS[:60], ("", PredictionSetup(methods=("proposed", "published", FORGETFUL)))),
    **{name: (TRIAL_SEEDS, (name, PredictionSetup())) for name in TRIALS},
}
"""By experiment: its seeds, and the first argument of `run_case`."""


def run_case(variant: tuple[str, PredictionSetup], case: Case) -> dict[str, Any]:
    """One walk of the generality test (""), or of the trial of this name, with the condition or the walker.

    Returns:
        What `predicted_walk` does, and the condition, or `subject`, `height_group` and `turn` of a trial.
    """
    name, setup = variant
    if name:
        subject, turn = subject_and_turn(case.seed)
        who = {"subject": subject, "height_group": subject.split("_")[1].upper(), "turn": turn}
        return {**predicted_walk(trial_config(name, case.seed), case, setup), **who}
    which = condition(case.seed)
    config = replace(
        load_scenario(TERRAINS[which.terrain]).config,
        person=PEOPLE[f"zhao_{which.height_group.lower()}_{which.member}"],
        rig_mount=which.mount,
        gait=Gait.of_pattern(which.pattern, gaze=WANDERING),
    )
    return {**predicted_walk(config, case, setup), **vars(which)}
