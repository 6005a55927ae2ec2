"""How much of a walk an output covers: a partial one would otherwise score better than a whole one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from stridetwin.outputs.base import SHARE, Score, Scores

COVERAGE = Score(
    name="coverage_pct", scale=SHARE, heading="covered %", label="Time that is covered", unit="%", digits=1
)
"""The score that every kind of output with times has; see `compute_covered_share`."""
ENOUGH_PCT = 95.0
"""Less is reported, as the other scores are then those of a part."""
_HOLE_PERIODS, _SHORTEST_HOLE_NS, _LONGEST_STEP_NS = 5.0, 100_000_000, 3_000_000_000
"""A longer gap than so many periods is a hole, unless it is shorter than the second; a gap beyond the third is one
whatever the period."""
_EARLY_NS = 200_000_000
"""An output that ends so long before the truth still reaches its end."""


def compute_covered_share(t_ns: NDArray[np.int64], begin_ns: int, end_ns: int) -> float:
    """Share of the time from `begin_ns` to `end_ns` between estimates at the stamps (N,), without holes, 0-1.

    It is 1 for a time of length 0.
    """
    if end_ns <= begin_ns:
        return 1.0
    t_ns = t_ns[(t_ns >= begin_ns) & (t_ns <= end_ns)]
    steps = np.diff(t_ns)
    return float(steps[steps <= _longest_step_ns(t_ns)].sum() / (end_ns - begin_ns))


def reaches_end(t_ns: NDArray[np.int64], end_ns: int) -> bool:
    """Whether estimates at the stamps (N,), N ≥ 1, last until `end_ns`: their last step before it would be no hole."""
    return bool(end_ns - t_ns[-1] <= max(_EARLY_NS, _longest_step_ns(t_ns)))


def _longest_step_ns(t_ns: NDArray[np.int64]) -> float:
    """The longest time between two of the stamps (N,) that is no hole."""
    period = float(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 0.0
    return min(max(_HOLE_PERIODS * period, _SHORTEST_HOLE_NS), _LONGEST_STEP_NS)


def partial_outputs(scores: Mapping[str, Scores]) -> dict[str, float]:
    """The outputs that cover less than `ENOUGH_PCT` of their walk, and how much they cover, %."""
    covered = {name: values[COVERAGE.name] for name, values in scores.items() if COVERAGE.name in values}
    return {name: pct for name, pct in covered.items() if pct < ENOUGH_PCT}


def coverage_chips(scores: Mapping[str, Scores]) -> list[str]:
    """A few words for the head of a report for each output that covers too little."""
    return [f"{name} COVERS ONLY {pct:.1f} %" for name, pct in partial_outputs(scores).items()]


def describe_partial(walks: Sequence[tuple[str, Mapping[str, Scores]]]) -> list[str]:
    """A warning for each output that covers too little of one or several walks.

    Args:
        walks: Name of each walk, and its scores by output.
    """
    by_output: dict[str, dict[str, float]] = {}
    for walk, scores in walks:
        for name, pct in partial_outputs(scores).items():
            by_output.setdefault(name, {})[walk] = pct
    warnings = []
    for name, of_walks in by_output.items():
        walk, least = min(of_walks.items(), key=lambda item: item[1])
        others = f", and less than {ENOUGH_PCT:g} % of {len(of_walks)} of {len(walks)} walks" if len(walks) > 1 else ""
        where = f"of {walk}{others}"
        warnings.append(f"{name} covers {least:.1f} % {where}: its scores are those of that part alone")
    return warnings
