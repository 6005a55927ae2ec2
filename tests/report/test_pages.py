"""HTML pages: text is escaped, HTML is not, and what is empty is left out."""

import pytest
from jinja2 import UndefinedError
from markupsafe import Markup

from stridetwin.pages.html import boxes, multiples, page, render_template, section, table


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
