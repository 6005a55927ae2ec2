"""A hook of mkdocs (see mkdocs.yml): pages of the site from files outside docs/, and equations as MathML.

Links in the pages are those of the tree, so that they also work on a code host. The site begins with the README, and
ends with the changelog; any other file or folder that a page links becomes a page under `source/`. Pages of
docs/results enter the navigation automatically.

Pages hold LaTeX between `$` and `$$`, which code hosts render by themselves. pymdownx.arithmatex marks it, and the hook
replaces it with MathML, which browsers render without a script or a network. A `tag` becomes the number at the right,
and the anchor `equation-n`.
"""

from __future__ import annotations

import ast
import html
import os.path
import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
TOP = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
"""Pages of the site whose files are at the top of the tree."""

_FENCE = re.compile(r"^( *)(`{3,})[^\n]*\n.*?^\1\2`* *$", re.M | re.S)
_CODE = re.compile(r"(?<!`)(`+)(?!`)(?:.(?!\n\n))+?(?<!`)\1(?!`)", re.S)
_LINK = re.compile(r"(!?\[(?:[^\[\]]|\[[^\[\]]*\])*\]\()([^()\s]+)(\))")
_INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.S)
_BLOCK = re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', re.S)
_TAG = re.compile(r"\\tag\{(\d+)\}")
_HTML_CODE = re.compile(r"<code>[^<]*</code>")
_OPTION = re.compile(r"(?<![\w-])(--?[a-z][\w-]*)")
_ROW = "display:flex;align-items:center;overflow-x:auto"
_LANGUAGES = {".py": "python", ".yml": "yaml", ".yaml": "yaml", ".cff": "yaml", ".sh": "bash", ".xml": "xml"}


def on_config(config: MkDocsConfig) -> None:
    """Adds the pages of docs/results to the navigation, and removes missing pages."""
    config.nav = navigation(config.nav or [])


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Adds the pages from outside docs/."""
    from mkdocs.structure.files import File

    for name, page in TOP.items():
        files.append(File.generated(config, page, content=(ROOT / name).read_text(encoding="utf-8")))
    for place in sorted(outside()):
        files.append(File.generated(config, page_of(place), content=source_page(ROOT / place)))


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Rewrites links for the site, and removes the backslashes that code hosts need before pipes in tables."""
    uri = page.file.src_uri
    at_top = {page: name for name, page in TOP.items()}
    place = at_top.get(uri, f"docs/{uri}")
    return "".join(text if fenced else _unescaped(relinked(text, place, uri)) for fenced, text in parts(markdown))


def on_page_content(page_html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Replaces the equations of a page by MathML."""
    from latex2mathml.converter import convert

    inlined = _INLINE.sub(lambda match: convert(html.unescape(match.group(1))), unbroken_options(page_html))
    return _BLOCK.sub(_numbered, inlined)


def unbroken_options(page_html: str) -> str:
    """The HTML of a page in which no line breaks inside an option, such as after the `--` of `--baseline`.

    Browsers break after hyphens. Only code within text and tables wraps; blocks of code do not.
    """
    whole = r'<span style="white-space:nowrap">\1</span>'
    texts = re.split(r"(<pre.*?</pre>)", page_html, flags=re.S)
    texts[::2] = (_HTML_CODE.sub(lambda match: _OPTION.sub(whole, match.group()), text) for text in texts[::2])
    return "".join(texts)


def numbers(markdown: str) -> list[int]:
    """The numbers of the equations of a page, in order."""
    return [int(number) for number in _TAG.findall(markdown)]


def _numbered(match: re.Match[str]) -> str:
    """An equation on a line of its own, with its number at the right."""
    from latex2mathml.converter import convert

    latex = html.unescape(match.group(1))
    formula = convert(_TAG.sub("", latex).strip(), display="block")
    number = _TAG.search(latex)
    if number is None:
        return f'<div style="{_ROW}">{formula}</div>'
    return f'<div id="equation-{number[1]}" style="{_ROW}">{formula}<span>({number[1]})</span></div>'


def navigation(nav: Any) -> Any:
    """A navigation of mkdocs.yml with the pages of docs/results in the section `Results`, and without missing pages."""
    if isinstance(nav, str):
        return nav if nav in TOP.values() or (DOCS / nav).is_file() else None
    if isinstance(nav, list):
        return [entry for entry in map(navigation, nav) if entry] or None
    there = {title: results() if title == "Results" else navigation(entry) for title, entry in nav.items()}
    return {title: entry for title, entry in there.items() if entry}


def results() -> list[str]:
    """Pages of docs/results, relative to the docs folder."""
    return sorted(f"results/{file.name}" for file in (DOCS / "results").glob("*.md"))


def parts(markdown: str) -> Iterator[tuple[bool, str]]:
    """A page split into fenced code (True) and other text."""
    end = 0
    for fence in _FENCE.finditer(markdown):
        yield False, markdown[end : fence.start()]
        yield True, fence.group()
        end = fence.end()
    yield False, markdown[end:]


def links(markdown: str) -> list[str]:
    """Targets of all links and images of a page, in order."""
    found: list[str] = []
    for fenced, text in parts(markdown):
        if not fenced:
            found += [target for _, target, _ in _LINK.findall(_without_code(text))]
    return found


def relinked(text: str, place: str, uri: str) -> str:
    """A page's text without fenced code, with the links of the site; `place` is in the tree, `uri` on the site."""

    def link(match: re.Match[str]) -> str:
        before, target, after = match.groups()
        if _elsewhere(target):
            return match.group()
        name, hash_, anchor = target.partition("#")
        to = page_of(_resolved(place, name))
        return before + os.path.relpath(to, PurePosixPath(uri).parent) + hash_ + anchor + after

    return _LINK.sub(link, text)


def outside() -> set[str]:
    """Files and folders of the tree, outside docs/, that a page links."""
    pages = [ROOT / name for name in TOP] + sorted(DOCS.rglob("*.md"))
    found = set()
    for page in pages:
        place = page.relative_to(ROOT).as_posix()
        for target in links(page.read_text(encoding="utf-8")):
            if not _elsewhere(target):
                found.add(_resolved(place, target.partition("#")[0]))
    return {place for place in found if place not in TOP and not place.startswith("docs/")}


def page_of(place: str) -> str:
    """Path of a file of the tree on the site, from its top."""
    if place.startswith("docs/"):
        return place.removeprefix("docs/")
    return TOP.get(place) or f"source/{place}.md"


def source_page(path: Path) -> str:
    """A page that shows a file, or the contents of a folder."""
    name = path.relative_to(ROOT).as_posix()
    if not path.is_dir():
        language = _LANGUAGES.get(path.suffix, "text")
        return f"# {name}\n\n``````{language}\n{path.read_text(encoding='utf-8')}\n``````\n"
    lines = [f"# {name}/", "", "| file | what |", "|---|---|"]
    for file in sorted(path.rglob("*")):
        if file.is_file() and file.suffix in (".py", ".yaml", ".xml") and file.stat().st_size:
            lines.append(f"| `{file.relative_to(path).as_posix()}` | {_first_line(file)} |")
    return "\n".join(lines) + "\n"


def _elsewhere(target: str) -> bool:
    return target.startswith("#") or ":" in target


def _resolved(place: str, target: str) -> str:
    """A link's target in the tree."""
    return os.path.normpath(PurePosixPath(place).parent / target)


def _without_code(text: str) -> str:
    return _CODE.sub(lambda code: code.group(1) + code.group(1), text)


def _unescaped(text: str) -> str:
    rows = (
        _CODE.sub(lambda code: code.group().replace(r"\|", "|"), line) if line.lstrip().startswith("|") else line
        for line in text.split("\n")
    )
    return "\n".join(rows)


def _first_line(file: Path) -> str:
    if file.suffix != ".py":
        return ""
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return text.split("\n")[0].replace("|", r"\|").replace("<", "&lt;")
