"""Writes the result of an experiment to docs/results: its table, and one line per case.

    python tools/results.py NAME DIR [--as STEM] [--options "OPTIONS OF THE RUN"] [--at COMMIT] [-o FOLDER]

DIR holds the rows of `stridetwin experiment NAME -o DIR`. Nothing is run. Rows of another version of the code are
rejected unless `--at` names the commit that made them.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from statistics import median
from typing import Any

from stridetwin.outputs.modes.scores import ModeScores
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.experiment import experiment
from stridetwin.studies.registry import key_of, read_row

RESULTS = Path(__file__).parent.parent / "docs" / "results"
EXPLAINED = {
    "assistance": "closed_loop.md#help-by-mode",
    "dvio": "dvio.md#how-accurate-it-is",
    "jao": "foot_to_foot.md#how-accurate-it-is",
    "shim": "contact_terrain.md#how-accurate-it-is",
    "stairs_16": "foot_to_foot.md#how-accurate-it-is",
    "terrain_zoo": "terrain_zoo.md#how-it-is-scored",
    "zhao_closed_loop": "dvio.md#how-accurate-it-is",
}
"""Pages that explain the lines of an experiment's table, by the prefix of its name."""
OF_MODES = "locomotion_mode.md#scores"
ALL_VALUES = "With `-o DIR`, the command writes all values of each case to a JSON file."


def main() -> None:
    """Writes `NAME.md` and `NAME.csv`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--as", dest="stem", default=None, help="name of the files, default NAME")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    parser.add_argument("--options", default="", help="of the run, shown beside its table")
    parser.add_argument("--at", default="", metavar="COMMIT", help="of the code that made the rows, if not this one")
    given = parser.parse_args()
    stem = given.stem or given.name
    files = sorted(given.folder.glob("seed_*.json"), key=lambda f: int(f.stem.split("_")[1]))
    cases = [read_row(f) for f in files]
    if not cases:
        parser.error(f"no rows (seed_*.json) in {given.folder}")
    other = [case["seed"] for case in cases if not given.at and case["key"] != _key(given.name, case, given.folder)]
    if other:
        parser.error(f"{len(other)} rows are of another version of the code, such as seed {other[0]}; give --at")
    given.output.mkdir(parents=True, exist_ok=True)
    text = page(given.name, stem, cases, given.options, given.at)
    (given.output / f"{stem}.md").write_text(text, encoding="utf-8")
    rows = [_row(case) for case in cases]
    with (given.output / f"{stem}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(k for row in rows for k in row)), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def page(name: str, stem: str, cases: list[dict[str, Any]], options: str, at: str) -> str:
    """The page of an experiment from its rows, with the options of its run and the commit that made the rows."""
    study = experiment(name)
    words, table = study.description, "\n".join(line.rstrip() for line in study.table(study.result(cases)))
    command = f"stridetwin experiment {name} {options}".strip()
    made = f"`{command}`{f', at commit {at}' if at else ''}"
    files = f"one line per case: [{stem}.csv]({stem}.csv). {ALL_VALUES}"
    count = f"\n\n{len(cases)} of {len(study.seeds)} cases." if len(cases) < len(study.seeds) else ""
    explained = next((page for begin, page in EXPLAINED.items() if name.startswith(begin)), OF_MODES)
    words = f"{words[0].upper()}{words[1:]}; [explanation of the lines](../{explained})."
    return f"# {stem}\n\n{words}\n\n{made}; {files}{count}\n\n```text\n{table}\n```\n"


def _key(name: str, case: dict[str, Any], folder: Path) -> str:
    return key_of(name, ExperimentCase(seed=case["seed"], folder=folder, physics=case.get("physics", "dynamic")))


def _row(case: dict[str, Any]) -> dict[str, Any]:
    """The values of a case, and for walks with predicted steps the number of correct ones."""
    stepped = {name: rows for name, rows in case.get("methods", {}).items() if "steps" in rows}
    row = _values(case if not stepped else {k: v for k, v in case.items() if not isinstance(v, dict)})
    for method, rows in stepped.items():
        steps = ModeScores.of(rows).steps
        turns = [s for s in steps if s.is_transition]
        row |= {
            f"{method}_steps": len(steps),
            f"{method}_right": sum(s.is_correct for s in steps),
            f"{method}_strictly_right": sum(s.is_strictly_correct for s in steps),
            f"{method}_transitions": len(turns),
            f"{method}_transitions_right": sum(s.is_correct for s in turns),
            f"{method}_lead_median_s": round(median(s.lead_s for s in steps), 3),
        }
    return row


def _values(case: dict[str, Any]) -> dict[str, Any]:
    """Scalars of a mapping, those of nested mappings under joined names; lists are left out."""
    row: dict[str, Any] = {}
    for name, value in case.items():
        if isinstance(value, dict):
            row |= {f"{name}.{inner}": v for inner, v in _values(value).items()}
        elif not isinstance(value, list):
            row[name] = float(f"{value:.6g}") if isinstance(value, float) else value
    return row


if __name__ == "__main__":
    main()
