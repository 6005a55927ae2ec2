"""HTML pages: text is escaped, HTML is not, and what is empty is left out."""

import pytest
from browser import CHROMIUM, Browser
from jinja2 import UndefinedError
from markupsafe import Markup

from stridetwin.pages.html import boxes, multiples, page, render_template, section, table
from stridetwin.pages.plot import PALETTE, Plot


def test_text_is_escaped_and_html_is_not():
    html = page("A & B", "<script>", ["1 < 2"], [section("T & U", "<b>", "<i></i>"), ""], "x > y")
    assert "<h1>A &amp; B</h1>" in html
    assert "<script>" not in html
    assert "<li>1 &lt; 2</li>" in html
    assert '<section><h2>T &amp; U</h2><p>&lt;b&gt;</p><div class="card"><i></i></div></section>' in html


def test_a_table_sets_numbers_to_the_right_and_escapes_its_cells():
    html = table(["a", "b"], [["<x>", 1], [Markup("<code>y</code>"), 2]], (1,), note="n & m", css="more")
    assert html.startswith('<div class="scroll more"><table><tr><th>a</th><th class="n">b</th></tr>')
    assert '<tr><td>&lt;x&gt;</td><td class="n" data-head="b">1</td></tr>' in html
    assert '<td><code>y</code></td><td class="n" data-head="b">2</td>' in html
    assert '<p class="note">n &amp; m</p>' in html
    assert "note" not in table(["a"], [], ())


def test_boxes_leave_out_what_is_empty():
    assert boxes(["<i></i>", ""]) == '<div class="card"><i></i></div>'
    assert multiples(["<i></i>"]) == '<div class="multiples"><i></i></div>'


def test_a_template_without_one_of_its_values_is_an_error():
    with pytest.raises(UndefinedError):
        render_template("film", source="", stills=[])


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_a_long_legend_leaves_a_strip_its_scale_on_a_telephone(tmp_path):
    strip = Plot(title="Strip", x=(0.0, 9.0), y=(-1.0, 1.0), x_label="along, m", y_label="left, m", to_scale=True)
    for name in ("level", "stairs up", "stairs down", "ramp up", "ramp down", "unknown class", "edge"):
        strip.key(f"mapped: {name}", PALETTE[0])
    strip.line([0.0, 9.0], [0.0, 0.0], PALETTE[1], label="true path of the camera")
    file = tmp_path / "page.html"
    file.write_text(page("Title", "Text", [], [strip.html()], ""), encoding="utf-8")
    with Browser() as browser:
        browser.open(file, 390)
        assert browser.wait(
            "(() => { const axes = document.querySelector('.nsewdrag')?.getBoundingClientRect();"
            " return axes && axes.width > 250 && Math.abs(axes.height / axes.width - 2 / 9) < 0.03; })()",
            30,
        )
