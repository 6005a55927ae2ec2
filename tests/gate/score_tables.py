"""Score tables made up: an estimator with errors of its own spread from walk to walk."""

import numpy as np

from stridetwin.gate.score_table import document_of, mean_scores, table_of

SPREADS = {"ape_rmse_m": 0.4, "end_error_m": 0.9, "rpe_1m_pct": 0.2, "rpe_5m_pct": 0.3}


def walk(rng, factor=1.0, jitter=0.0):
    """Scores of one walk; errors grow by a factor, give or take the jitter (of logarithms)."""
    scores = {m: float(np.exp(rng.normal(0.0, s))) for m, s in SPREADS.items()}
    turn = np.random.default_rng(int(1e9 * scores["ape_rmse_m"]) % 2**32)
    changed = {m: v * factor * float(np.exp(turn.normal(0.0, jitter))) for m, v in scores.items()}
    return {**changed, "nees_position_within_95_pct": 95.0, "nis_standing": 1.0, "distance_m": 9.0}


def table(seed, count, factor=1.0, jitter=0.0, names=("mine",), first=0):
    """Walks of a seed: those of one seed are the same walks, from `first` on."""
    rows = []
    for i in range(first, first + count):
        rng = np.random.default_rng([seed, i])
        rows.append(
            {"name": f"w{i}", "sha256": f"{seed}-{i}", "estimators": {n: walk(rng, factor, jitter) for n in names}}
        )
    return of_rows(rows)


def of_rows(rows):
    return table_of(document_of(rows, mean_scores(row["estimators"] for row in rows)), "made up")
