"""Links of all Markdown files: files and headings are there; addresses are looked at, not visited."""

import re
from pathlib import Path
from urllib.parse import urlparse

import pytest

from tools.site import links, parts

ROOT = Path(__file__).parents[2]
LEFT_OUT = {"site", "runs", "build", "dist"}
PAGES = [
    page
    for page in sorted(ROOT.rglob("*.md"))
    if not any(part.startswith(".") or part in LEFT_OUT for part in page.relative_to(ROOT).parts[:-1])
]


def anchors(page):
    """Anchors of a page's headings, as code hosts and the site make them."""
    text = "".join(part for fenced, part in parts(page.read_text(encoding="utf-8")) if not fenced)
    made, seen = set(), {}
    for heading in re.findall(r"^#{1,6} +(.+?)\s*$", text, re.M):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").lower()
        anchor = re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")
        count = seen[anchor] = seen.get(anchor, -1) + 1
        made.add(f"{anchor}-{count}" if count else anchor)
    return made


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page):
    for target in links(page.read_text(encoding="utf-8")):
        if "://" in target or target.startswith("mailto:"):
            address = urlparse(target)
            assert address.scheme in ("https", "http", "mailto"), target
            assert "." in address.netloc, target
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.is_relative_to(ROOT), target
        assert file.exists(), target
        if anchor:
            assert anchor in anchors(file), target


def test_links_are_found(tmp_path):
    text = "[`a`](x.md#y) and ![b [c]](d/e.svg)\n`[no](none)`\n```\n[nor](here)\n```\n[over\nlines](f.md)\n"
    assert links(text) == ["x.md#y", "d/e.svg", "f.md"]
    assert len([link for page in PAGES for link in links(page.read_text(encoding="utf-8"))]) > 100


def test_anchors_are_a_code_host_s(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# One, two: `three`\n## A b\n## A b\n```\n# none\n```\n")
    assert anchors(page) == {"one-two-three", "a-b", "a-b-1"}
