"""The benchmark of neighbouring stairs and ramps."""

from __future__ import annotations

import json
import sys

from benchmarks import neighbours


def test_a_pair_is_planned_or_refused_in_one_line(monkeypatch, capsys) -> None:
    some = [pair for pair in neighbours.neighbours() if pair[0] in ("stair 120 mm up", "ramp 8 deg down")]
    monkeypatch.setattr(neighbours, "neighbours", lambda: iter(some))
    monkeypatch.setattr(sys, "argv", ["neighbours", "--json", "--landings", "0"])
    assert neighbours.main() == 0
    result = json.loads(capsys.readouterr().out)
    assert result["counts"] == {"ok": 3, "refused": 1}
    (refused,) = result["not_planned"]
    assert (refused["first"], refused["second"]) == ("stair 120 mm up", "stair 120 mm up")
    assert "\n" not in refused["why"]
