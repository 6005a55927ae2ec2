"""Renders the equations of the pages as MathML, as a hook of mkdocs (see mkdocs.yml).

Pages hold LaTeX between `$` and `$$`, which code hosts render by themselves. pymdownx.arithmatex marks it, and this
hook replaces it with MathML, which browsers render without a script or a network. A `tag` becomes the number at the
right, and the anchor `equation-n`.
"""

from __future__ import annotations

import html
import re
from typing import TYPE_CHECKING

from latex2mathml.converter import convert

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

_INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.S)
_BLOCK = re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', re.S)
_TAG = re.compile(r"\\tag\{(\d+)\}")
_ROW = "display:flex;align-items:center;overflow-x:auto"


def on_page_content(page_html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Replaces the equations of a page by MathML."""
    inlined = _INLINE.sub(lambda match: convert(html.unescape(match.group(1))), page_html)
    return _BLOCK.sub(_numbered, inlined)


def numbers(markdown: str) -> list[int]:
    """The numbers of the equations of a page, in order."""
    return [int(number) for number in _TAG.findall(markdown)]


def _numbered(match: re.Match[str]) -> str:
    """An equation on a line of its own, with its number at the right."""
    latex = html.unescape(match.group(1))
    formula = convert(_TAG.sub("", latex).strip(), display="block")
    number = _TAG.search(latex)
    if number is None:
        return f'<div style="{_ROW}">{formula}</div>'
    return f'<div id="equation-{number[1]}" style="{_ROW}">{formula}<span>({number[1]})</span></div>'
