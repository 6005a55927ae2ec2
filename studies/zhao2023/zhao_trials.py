"""Three further tests of Zhao et al. 2023: camera views, directions outdoors, people in the way.

Each of the paper's fifteen subjects walks twice; the letters refer to Fig. 3:

- `zhao_view` (a): up two flights between walls with an abrupt turn between them, to the left and then to the right. The
  head looks around all the time, up to a radian to either side, so that the route leaves the 80 degree image. A
  camera on the chest hardly rotates, so that it is on the head in both walks.
- `zhao_directions` (b): upwards outdoors, from stair to ramp to stair side by side, camera on head and chest. Sunlight
  overpowers the projector of the depth camera (part `D455-sunlight`).
- `zhao_disturbance` (c): a stair up and down while two people walk around the walker, camera on head and chest.

Unless a scenario states otherwise the gaze wanders, as in the generality test. The paper reports no walking patterns;
ours is a plain walk.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import Gaze, Turn, TwinConfig
from stridetwin.sim.wearer.anthropometry import PEOPLE
from stridetwin.studies.case import Case
from stridetwin.studies.zhao2023.mode_walks import GROUPS, MOUNTS, Telling, told_walk

SUBJECTS = tuple(f"zhao_{group.lower()}_{member}" for member in (1, 2, 3) for group in GROUPS)
SEEDS = range(1000, 1000 + 2 * len(SUBJECTS))
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
VARIANTS = {name: (SEEDS, name) for name in TRIALS}
"""By experiment: its seeds, and the first argument of `run_case`."""


def subject_and_turn(seed: int) -> tuple[str, int]:
    """Subject, and whether it is the first walk (0) or the second (1).

    The first, second and third ten walks contain every group twice, once per variant.
    """
    i = (seed - SEEDS[0]) % len(SEEDS)
    block, place = divmod(i, 2 * len(GROUPS))
    turn, group = divmod(place, len(GROUPS))
    return SUBJECTS[block * len(GROUPS) + group], (turn + group) % 2


def trial_config(name: str, seed: int) -> TwinConfig:
    """Walker, route and gait.

    Args:
        name: Of `TRIALS`.
        seed: Of the walk.
    """
    trial, (subject, turn) = TRIALS[name], subject_and_turn(seed)
    config = load_scenario(trial.scenario).config
    gait = config.gait if config.gait.gaze != Gaze() else replace(config.gait, gaze=WANDERING)
    config = replace(config, person=PEOPLE[subject], gait=gait)
    return trial.second(config) if turn else config


def run_case(name: str, case: Case) -> dict[str, Any]:
    """One walk, by both methods.

    Args:
        name: Of `TRIALS`.
        case: Seed and options.

    Returns:
        What `told_walk` does, `subject`, `height_group` and `turn`.
    """
    subject, turn = subject_and_turn(case.seed)
    return {
        **told_walk(trial_config(name, case.seed), case, Telling()),
        "subject": subject,
        "height_group": subject.split("_")[1].upper(),
        "turn": turn,
    }
