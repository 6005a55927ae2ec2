"""The table "Measured" of the README: each command is that of the page behind it, and its number of walks is right."""

import re
from pathlib import Path

import pytest

from stridetwin.cli.main import parse
from stridetwin.studies.experiment import experiment
from stridetwin.studies.registry import ExperimentBatchOptions

ROOT = Path(__file__).parents[2]
MEASURED = (ROOT / "README.md").read_text(encoding="utf-8").split("## Measured", 1)[1].split("## ", 1)[0]
ROWS = re.findall(r"\| \[`([^`]+)`\]\((docs/results/\w+\.md)\) \| (\d+) walks,", MEASURED)


def test_every_row_of_an_experiment_has_a_command_a_page_and_a_cost():
    assert len(ROWS) == len(re.findall(r"docs/results/", MEASURED)) == 6


@pytest.mark.parametrize(("command", "page", "walks"), ROWS)
def test_a_command_makes_the_row_shown(command, page, walks):
    (shown,) = re.findall(r"^`stridetwin experiment ([^`]+)`", (ROOT / page).read_text(encoding="utf-8"), re.M)
    assert command.split() == re.sub(r" --workers \d+", "", shown).split()
    options = parse(["experiment", *command.split()]).options
    study = experiment(options.experiment)
    batch = ExperimentBatchOptions(
        folder=Path("nowhere"), first=options.seed, subset=options.subset, physics=options.physics or "dynamic"
    )
    assert study.size(batch.cases(study)).walks == int(walks)


def test_every_figure_of_ours_is_on_its_page():
    for row in MEASURED.splitlines():
        link = re.search(r"docs/results/(\w+)\.md", row)
        if link is None:
            continue
        page = (ROOT / "docs" / "results" / f"{link[1]}.md").read_text(encoding="utf-8")
        for figure in re.findall(r"\d+(?:\.\d+)?", row.split("|")[3]):
            digits = len(figure.partition(".")[2])
            shown = {f"{float(number):.{digits}f}" for number in re.findall(r"\d+\.\d+", page)}
            assert figure in shown, f"{link[1]}: {figure}"
