"""The page of `score --report`: what estimators made of one recording, with figures of errors and their bounds."""

from __future__ import annotations

from collections.abc import Sequence

from stridetwin.outputs.base import KindEvaluations, scores_by_output
from stridetwin.outputs.coverage import coverage_chips
from stridetwin.pages.html import page
from stridetwin.streams.recording.reader import Recording

_FOOTER = "The estimators never had access to the truth."


def score_page(recording: Recording, of_kinds: Sequence[KindEvaluations]) -> str:
    """The page as HTML text: use it for an estimator of your own, whose walk somebody else has recorded.

    Args:
        recording: What the estimators ran on.
        of_kinds: Their outputs beside the truth, of at least one kind.
    """
    parts = [of_kind.kind.report(of_kind.evaluations, recording) for of_kind in of_kinds]
    names = [evaluation.name for of_kind in of_kinds for evaluation in of_kind.evaluations]
    chips = [
        f"{recording.duration:.1f} s",
        *coverage_chips(scores_by_output(of_kinds)),
        *(chip for part in parts for chip in part.chips),
    ]
    sections = [
        *(part.summary for part in parts),
        *(part.figures for part in parts),
        *(part.details for part in parts),
        *(part.scores for part in parts),
    ]
    description = f"{', '.join(names)} beside the truth of {recording.path.name}."
    return page("Scores", description, chips, sections, _FOOTER)
