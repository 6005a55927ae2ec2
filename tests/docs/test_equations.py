"""Equations of the pages: numbered in order, cited by what computes them, and rendered."""

import re
from pathlib import Path

import pytest

pytest.importorskip("latex2mathml", reason="stridetwin[docs]")

from tools import site
from tools.site import numbers

ROOT = Path(__file__).parents[2]
PAGES = {page.name: page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs").glob("*.md"))}
ESTIMATORS = ["foot_ins", "foot_to_foot", "contact_terrain", "dvio", "terrain_map", "locomotion_mode", "gait_phase"]
SECTIONS = ["What it is for", "How to use it", "How it works", "How accurate it is"]
_CITED = re.compile(r"docs/(\w+\.md) ((?:\(\d+\)(?:, | and |-)?)+)")


def citations():
    """Page and number of each equation that code cites, with the file."""
    return [
        (file.relative_to(ROOT).as_posix(), page, int(number))
        for folder in ("estimators", "scenarios", "sim", "streams")
        for file in sorted((ROOT / folder).rglob("*.py"))
        for page, cited in _CITED.findall(file.read_text(encoding="utf-8"))
        for number in re.findall(r"\d+", cited)
    ]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_an_estimator_s_page_has_its_sections_and_numbers_in_order(name):
    page = PAGES[f"{name}.md"]
    headings = re.findall(r"^## (.+)$", page, re.M)
    assert [heading for heading in headings if heading in SECTIONS] == SECTIONS
    assert numbers(page) == list(range(1, len(numbers(page)) + 1))
    assert len(numbers(page)) >= 9
    assert page.count("$$") == 2 * len(numbers(page))


def test_equations_that_code_cites_exist():
    found = citations()
    assert {page for _, page, _ in found} == {f"{name}.md" for name in ESTIMATORS}
    for file, page, number in found:
        assert number in numbers(PAGES[page]), (file, page, number)


def test_equations_become_mathml_with_their_number_and_an_anchor():
    inline = '<p>a <span class="arithmatex">\\(x &lt; y\\)</span></p>'
    block = '<div class="arithmatex">\\[\n\\frac{a}{b} \\tag{3}\n\\]</div>'
    made = site.on_page_content(inline + block, None, None, None)
    assert "arithmatex" not in made
    assert "\\" not in made
    assert made.count("<math") == 2
    assert 'id="equation-3"' in made
    assert "<mfrac>" in made
    assert "(3)" in made
