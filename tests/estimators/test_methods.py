"""The former name of the proposed methods, as users give it."""

from __future__ import annotations

import pytest

from stridetwin.cli.estimate import options_of
from stridetwin.cli.main import parse
from stridetwin.estimators.base import current_name
from stridetwin.estimators.registry import estimator, estimators


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
