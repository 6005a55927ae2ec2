"""docs/gate.md shows what `score` prints: for the scores of 30 walks, and the same walks with a coarse gyroscope."""

import json
from pathlib import Path

from score_tables import of_rows

from stridetwin.cli.console import plain_text
from stridetwin.cli.score import format_scores
from stridetwin.gate import bootstrap
from stridetwin.gate.compare import Rules, compare_scores
from tools.tutorial import blocks

ALL_DRAWS = bootstrap.DRAWS
SCORES = json.loads(Path(__file__).with_name("coarse_gyro.json").read_text(encoding="utf-8"))
PAGE = Path(__file__).parents[2] / "docs" / "gate.md"


def rows(version):
    return [
        {"name": key, "sha256": key, "estimators": {n: dict(zip(SCORES["metrics"], own)) for n, own in named}}
        for key, walk in zip(SCORES["sha256"], SCORES[version])
        for named in [list(zip(SCORES["names"], walk))]
    ]


def test_the_page_shows_what_score_prints(monkeypatch):
    monkeypatch.setattr(bootstrap, "DRAWS", ALL_DRAWS)
    now, baseline = of_rows(rows("now")), of_rows(rows("baseline"))
    comparison = compare_scores(now, baseline, Rules())
    (shown,) = [block.text for block in blocks(PAGE.read_text(encoding="utf-8")) if block.language == "text"]
    assert shown.rstrip("\n") == plain_text(format_scores(now.means, len(now.walks), comparison, []))
