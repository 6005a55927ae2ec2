"""docs/placement.md shows what `place foot_imus` prints, from the placement.json of that run."""

import json
from pathlib import Path

from stridetwin.cli.console import plain_text
from stridetwin.cli.studies import placement_lines
from stridetwin.studies.significance import interval_text
from tools.tutorial import blocks

PAGE = Path(__file__).parents[3] / "docs" / "placement.md"
RESULT = json.loads(Path(__file__).with_name("foot_imus.json").read_text(encoding="utf-8"))


def test_the_page_shows_what_place_prints():
    (shown,) = [block.text for block in blocks(PAGE.read_text(encoding="utf-8")) if block.language == "text"]
    assert shown.rstrip("\n") == plain_text(placement_lines(RESULT))


def test_an_interval_is_printed_where_walks_differ():
    assert interval_text({"mean": 48.0, "low": 48.0, "high": 48.0}) == "48"
    assert interval_text({"mean": 48.0, "low": 47.0, "high": 49.5}) == "48 (47 to 49.5)"
    assert interval_text({"mean": 48.0, "low": None, "high": None}) == "48"
    assert interval_text(None) == "-"
