"""The generality test of Zhao et al. 2023 (Tables II and III): mode prediction on 540 walks.

Five groups of height, six terrains, the camera on head or chest, three patterns of walking: 180 conditions, three walks
each, one by each member of the group. Every walk goes level, up, level, down, level; `reference/zhao2023.yaml` states
the terrain where the paper does not. The gaze wanders. Poses come from the visual-inertial odometry, or are the true
ones. The camera looks 25 degrees down, or 8, as in the paper's mean.

Any sixty consecutive walks are balanced over terrains, mounts and groups; the first sixty, the second sixty, ... also
over the patterns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import Gait, Gaze
from stridetwin.sim.wearer.anthropometry import PEOPLE
from stridetwin.studies.case import Case
from stridetwin.studies.zhao2023.mode_walks import FORGETFUL, GROUPS, MOUNTS, Telling, told_walk

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
VARIANTS = {
    "zhao_generality": (SEEDS, Telling()),
    "zhao_generality_given_poses": (SEEDS, Telling(poses="given")),
    "zhao_generality_shallow": (SEEDS, Telling(pitch_down="shallow")),
    "zhao_baselines": (SEEDS[:60], Telling(methods=("proposed", "published", FORGETFUL))),
}
"""By experiment: its seeds, and the first argument of `run_case`."""
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


def run_case(telling: Telling, case: Case) -> dict[str, Any]:
    """One walk.

    Args:
        telling: How its steps are predicted.
        case: Seed and options.

    Returns:
        What `told_walk` does, and the condition.
    """
    which = condition(case.seed)
    config = replace(
        load_scenario(TERRAINS[which.terrain]).config,
        person=PEOPLE[f"zhao_{which.height_group.lower()}_{which.member}"],
        rig_mount=which.mount,
        gait=Gait.of_pattern(which.pattern, gaze=Gaze(kind="wandering")),
    )
    return {**told_walk(config, case, telling), **vars(which)}
