"""Section of the report about a terrain map."""

from __future__ import annotations

from stridetwin.outputs.base import Scores
from stridetwin.outputs.score_rows import score_rows
from stridetwin.outputs.terrain.figures import ground_errors, ground_from_above, ground_from_aside
from stridetwin.outputs.terrain.run import SampledMap
from stridetwin.outputs.terrain.scores import SCORES
from stridetwin.pages.html import boxes, section, table

_LEAD = (
    "From depth camera and visual-inertial odometry: the ground, mapped before the walker reached it. Drift of the "
    "odometry counts as an error of its path only."
)


def terrain_section(sampled: SampledMap, scores: Scores) -> str:
    """The ground from above and from the side, errors of heights and edges, and the scores of one map."""
    route, walk = sampled.route, sampled.walk
    figures = [ground_from_above(route, walk), ground_from_aside(route, walk), ground_errors(route, walk)]
    scores_table = table(("Score", "this walk"), score_rows(SCORES, [scores]), (1,))
    return section("Terrain ahead", _LEAD, boxes([*figures, scores_table]), "stack")
