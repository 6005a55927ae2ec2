"""Section of the report about predicted modes."""

from __future__ import annotations

from stridetwin.estimators.locomotion_mode import ModeEstimate
from stridetwin.outputs.aligned_walk import AlignedWalk
from stridetwin.outputs.base import Scores
from stridetwin.outputs.modes.figures import lead_times, mode_ribbon, steps_from_above
from stridetwin.outputs.modes.scores import SCORES, ModeScores
from stridetwin.outputs.score_rows import score_rows
from stridetwin.pages.html import boxes, section, table
from stridetwin.reference.norms import reference

_LEAD = (
    "From depth camera, visual-inertial odometry and insoles: the mode of each coming step, and the footprints "
    "predicted one step before, with their 95 % ellipses. Drift of the odometry counts as an error of its path only."
)
_NOTE = (
    "Zhao et al. 2023, tables II and III: mean and standard deviation over 540 walks of real people; the paper "
    "reports none of the other scores. For orientation, not for ranking."
)


def mode_section(estimates: list[ModeEstimate], modes: ModeScores, walk: AlignedWalk, scores: Scores) -> str:
    """The steps from above, modes over time, lead times, and the scores of one estimator beside the paper's."""
    figures = [steps_from_above(estimates, modes, walk), mode_ribbon(estimates, modes, walk), lead_times(modes)]
    return section("Coming steps", _LEAD, boxes([*figures, _score_table(scores)]), "stack")


def _score_table(scores: Scores) -> str:
    paper = reference("zhao2023")["generality"]["accuracy_pct"]
    published = {"accuracy_pct": f"{paper['mean']:.2f} ± {paper['sd']:.2f}"}
    rows = [
        (*row, published.get(score.name, "\N{EN DASH}")) for score in SCORES for row in score_rows([score], [scores])
    ]
    return table(("Score", "this walk", "Zhao et al. 2023"), rows, (1, 2), note=_NOTE)
