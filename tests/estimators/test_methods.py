"""The former name of the proposed methods, as users give it and as recorded rows hold it."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path

import pytest

from stridetwin.cli.estimate import options_of
from stridetwin.cli.main import parse
from stridetwin.estimators.base import current_name
from stridetwin.estimators.registry import estimator, estimators
from stridetwin.studies.registry import read_row

RESULTS = Path(__file__).parents[2] / "docs" / "results"


def test_the_former_name_warns_and_others_stay_as_they_are():
    with pytest.warns(DeprecationWarning, match="'stridetwin' is now 'proposed'"):
        assert current_name("stridetwin") == "proposed"
    assert [current_name(name) for name in ("proposed", "published", "vins_mono", "best")] == [
        "proposed", "published", "vins_mono", "best",
    ]  # fmt: skip


def test_one_foot_s_filter_alone_is_run_for_each_foot():
    assert [name for name, found in estimators().items() if found.declaration.per_foot] == ["foot_ins"]


@pytest.mark.parametrize("words", [("estimate", "dvio", "walk.mcap", "-o", "path.txt"), ("live", "dvio")])
def test_the_command_line_takes_the_former_name(words):
    with pytest.warns(DeprecationWarning, match="proposed"):
        assert parse([*words, "--method", "stridetwin"]).options.method == "proposed"
    assert options_of(parse(words).options, estimator("dvio").declaration).method == "proposed"


@pytest.mark.parametrize("stem", ["zhao_baselines", "jao_loop_126m", "zhao_closed_loop", "shim_table5", "mode_fusion"])
def test_rows_recorded_before_are_read_under_the_name_of_today(stem, tmp_path):
    with tarfile.open(RESULTS / f"{stem}.tar.xz") as packed:
        packed.extractall(tmp_path, filter="data")
    file = min(tmp_path.glob("seed_*.json"))
    current = json.dumps(read_row(file))
    former = current
    for name, before in (("proposed", "stridetwin"), ("single_image", "single_picture"), ("estimated_", "told_"),
                         ('predicted": {', 'told": {')):  # fmt: skip
        former = former.replace(f'"{name}', f'"{before}')
    file.write_text(former)
    assert ('"told":' if stem == "mode_fusion" else '"stridetwin":') in former
    assert read_row(file) == json.loads(current)
