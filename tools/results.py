"""Lays the result of an experiment down under docs/results: its table, and a line a case.

    python tools/results.py NAME DIR [--as STEM] [--options "OPTIONS OF THE RUN"] [-o FOLDER]

DIR is where `stridetwin experiment NAME -o DIR` left its rows. What lies there is taken as it is: nothing is run.
"""

from __future__ import annotations

import argparse
import csv
import json
from pathlib import Path
from statistics import median
from typing import Any

from stridetwin.scenarios.experiments.registry import named
from stridetwin.scenarios.mode_score import ModeScores

RESULTS = Path(__file__).parent.parent / "docs" / "results"


def main() -> None:
    """Writes `NAME.md` and `NAME.csv`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--as", dest="stem", default=None, help="name of the files, default NAME")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    parser.add_argument("--options", default="", help="of the run, to be told beside its table")
    asked = parser.parse_args()
    experiment, stem = named(asked.name), asked.stem or asked.name
    files = sorted(asked.folder.glob("seed_*.json"), key=lambda f: int(f.stem.split("_")[1]))
    cases = [json.loads(f.read_text(encoding="utf-8")) for f in files]
    if not cases:
        parser.error(f"no rows (seed_*.json) in {asked.folder}")
    result = {"experiment": asked.name, **experiment.collect(cases), "cases": cases}
    asked.output.mkdir(parents=True, exist_ok=True)
    command = f"stridetwin experiment {asked.name} {asked.options}".strip()
    table = "\n".join(line.rstrip() for line in experiment.table(result))
    (asked.output / f"{stem}.md").write_text(
        f"# {stem}\n\n`{command}`; a line a case: [{stem}.csv]({stem}.csv)\n\n```text\n{table}\n```\n", encoding="utf-8"
    )
    rows = [_row(case) for case in cases]
    with (asked.output / f"{stem}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(k for row in rows for k in row)), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def _row(case: dict[str, Any]) -> dict[str, Any]:
    """A case's own values, and of walks with told steps how many were right."""
    row = {k: v for k, v in case.items() if not isinstance(v, dict | list)}
    for method, told in case.get("methods", {}).items():
        if "steps" not in told:
            continue
        steps = ModeScores.of(told).steps
        turns = [s for s in steps if s.transition]
        row |= {
            f"{method}_steps": len(steps),
            f"{method}_right": sum(s.right for s in steps),
            f"{method}_strictly_right": sum(s.strictly_right for s in steps),
            f"{method}_transitions": len(turns),
            f"{method}_transitions_right": sum(s.right for s in turns),
            f"{method}_lead_median_s": round(median(s.lead_s for s in steps), 3),
        }
    return row


if __name__ == "__main__":
    main()
