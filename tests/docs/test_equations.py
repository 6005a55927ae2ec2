"""Equations of the pages: numbered in order, cited by what computes them, and rendered."""

import ast
import io
import re
import tokenize
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
_SOURCED = re.compile(r"(?:docs/\w+\.md|[A-Z]\w+ \d{4}) (?:\(\d+\)(?:, | and |-)?)+")
_NUMBER = re.compile(r"(?<![\w\])])\(\d{1,2}\)")
PAPERS = {"Zhao 2023": 23, "Shim 2019": 20, "Qin 2018": 19}
"""Papers that number their equations, and the last number; of Qin 2018, the last that is cited."""


def citations():
    """Page and number of each equation that code cites, with the file."""
    return [
        (file.relative_to(ROOT).as_posix(), page, int(number))
        for folder in ("estimators", "scenarios", "sim", "streams")
        for file in sorted((ROOT / folder).rglob("*.py"))
        for page, cited in _CITED.findall(file.read_text(encoding="utf-8"))
        for number in re.findall(r"\d+", cited)
    ]


def prose_of(source):
    """Comments and docstrings of a module, those below constants included, each on one line."""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.string
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))):
                yield " ".join(text.split())


def bare_numbers(source):
    """Numbers of equations in comments and docstrings of a module that name neither a page nor a paper.

    A number in parentheses counts, except after a word, such as "v(3)" or "(n,) (3)" of a shape.
    """
    return [number for text in prose_of(source) for number in _NUMBER.findall(_SOURCED.sub("", text))]


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


@pytest.mark.parametrize("folder", sorted(f.name for f in (ROOT / "estimators").iterdir() if any(f.glob("*.py"))))
def test_an_equation_s_number_names_its_page_or_paper(folder):
    for file in (ROOT / "estimators" / folder).rglob("*.py"):
        assert bare_numbers(file.read_text(encoding="utf-8")) == [], file


def test_equations_of_papers_that_code_cites_exist():
    cited = re.compile(r"([A-Z]\w+ \d{4}) ((?:\(\d+\)(?:, | and |-)?)+)")
    for file in sorted((ROOT / "estimators").rglob("*.py")):
        for text in prose_of(file.read_text(encoding="utf-8")):
            for paper, numbers_cited in cited.findall(text):
                assert paper in PAPERS, (file, paper)
                assert all(1 <= int(n) <= PAPERS[paper] for n in re.findall(r"\d+", numbers_cited)), (
                    file,
                    numbers_cited,
                )


def test_bare_numbers_are_found():
    source = '"""By (3); docs/dvio.md (4), (5)-(7) and Zhao 2023 (8), but (9); (3,) and v(1)."""\nx = (3)  # of (12)\n'
    assert bare_numbers(source) == ["(12)", "(3)", "(9)"]


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
