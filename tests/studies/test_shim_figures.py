"""Figures 22 to 24 from the rows of a few trials."""

import re

import pytest

from stridetwin.estimators.contact_terrain import METHODS
from stridetwin.outputs.steps.scores import ScoredStep
from stridetwin.pages.plot import library
from stridetwin.studies.shim2019 import shim_figures, shim_table5
from tests.plots import figures

pytest.importorskip("mujoco")


def rows(mode, elevation, sd):
    return [
        ScoredStep(
            mode=mode,
            slope=0.0,
            elevation=elevation,
            place=(0.3 * i, 0, 0),
            estimated_mode=mode,
            estimated_slope=0.01 * i,
            estimated_elevation=elevation + 0.01,
            estimated_place=(0.3 * i, 0, 0),
            slope_sd=sd,
            elevation_sd=sd,
        ).row()
        for i in range(400)
    ]


@pytest.fixture(scope="module")
def html():
    walks = {walk: {m: rows("LG", 0.0, 0.02) for m in METHODS} for walk, _ in shim_table5.CASES.values()}
    walks["shim_stairs"] = {m: rows("SA", 0.165, 0.02) + rows("SD", -0.165, 0.02) for m in METHODS}
    of_all = {"physics": "dynamic", "fell": [], "walks": walks, "false_steps": dict.fromkeys(METHODS, 0)}
    cases = [{"seed": who, "subject": who, **of_all} for who in (1, 2)]
    return shim_figures.report({**shim_table5.collect(cases), "cases": cases})


def test_the_page_has_every_figure_and_stays_small(html):
    assert all(words in html for words in ("Figure 22", "Figure 23", "Figure 24", "Tables 5 to 7", "Huo et al."))
    assert len(html) - len(library()) < 2_000_000
    dots = [len(t["x"]) for t in figures(html)["Figure 24, proposed"].traces]
    assert 0 < sum(dots) <= shim_figures.DOTS * 5
    assert max(dots) <= shim_figures.DOTS


def test_the_page_asks_the_network_for_nothing(html):
    text = html.replace(library(), "")
    assert not re.search(r'<script [^>]*src|@import|url\(|(src|href)="(?!data:)|https?:', text)


def test_errors_are_listed_with_the_papers_and_huos(html):
    line = next(line for line in html.splitlines() if line.startswith("elevation mm, SD"))
    assert "10.00 ± 0.00" in line
    assert "25.90 ± 10.90" in line
    assert "1.00 ± 18.00" in line
