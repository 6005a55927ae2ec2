"""The site: built without a warning, all of it in one folder, nothing from elsewhere."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
import yaml

from tools import site

ROOT = Path(__file__).parents[2]


class Config(yaml.SafeLoader):
    """Of mkdocs.yml, whose names of Python's objects are no matter here."""


Config.add_multi_constructor("!!python/", lambda *_: None)
Config.add_multi_constructor("tag:yaml.org,2002:python/", lambda *_: None)


def pages_of(nav):
    """All pages of a navigation."""
    if isinstance(nav, str):
        return [nav]
    entries = nav.values() if isinstance(nav, dict) else nav
    return [page for entry in entries for page in pages_of(entry)]


def test_every_page_is_in_the_navigation_once():
    nav = yaml.load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"), Config)["nav"]
    listed = pages_of(site.navigation(nav))
    there = {page.relative_to(site.DOCS).as_posix() for page in site.DOCS.rglob("*.md")} | set(site.TOP.values())
    assert len(listed) == len(set(listed))
    assert set(listed) == there


def test_results_come_into_the_navigation_by_themselves(tmp_path, monkeypatch):
    nav = [{"Start": "index.md"}, {"More": [{"A": "a.md"}, {"B": "b.md"}]}, {"Results": []}]
    monkeypatch.setattr(site, "DOCS", tmp_path)
    assert site.navigation(nav) == [{"Start": "index.md"}]
    (tmp_path / "results").mkdir()
    for page in ("b.md", "results/b.md", "results/a.md", "results/a.csv"):
        (tmp_path / page).touch()
    results = {"Results": ["results/a.md", "results/b.md"]}
    assert site.navigation(nav) == [{"Start": "index.md"}, {"More": [{"B": "b.md"}]}, results]


def test_every_image_is_in_the_gallery():
    shown = set(site.links((site.DOCS / "gallery.md").read_text(encoding="utf-8")))
    images = {f.relative_to(site.DOCS).as_posix() for f in (site.DOCS / "images").rglob("*") if f.is_file()}
    assert images <= shown


@pytest.mark.parametrize(
    ("target", "place", "uri", "made"),
    [
        ("docs/gate.md#x", "README.md", "index.md", "gate.md#x"),
        ("../README.md", "docs/hardware.md", "hardware.md", "index.md"),
        ("../../CHANGELOG.md", "docs/results/a.md", "results/a.md", "../changelog.md"),
        ("../examples/imu.py", "docs/hardware.md", "hardware.md", "source/examples/imu.py.md"),
        ("streams", "README.md", "index.md", "source/streams.md"),
        ("https://a.org/b", "README.md", "index.md", "https://a.org/b"),
        ("#x", "docs/gate.md", "gate.md", "#x"),
    ],
)
def test_links_are_those_of_the_site(target, place, uri, made):
    assert site.relinked(f"[a]({target})", place, uri) == f"[a]({made})"


class Resources(HTMLParser):
    """What a page loads by itself."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        if tag in ("script", "img", "iframe", "source", "video"):
            self.found.append(given.get("src") or "")
        if tag == "link" and given.get("rel") not in ("canonical", "prev", "next"):
            self.found.append(given.get("href") or "")


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    pytest.importorskip("mkdocs", reason="stridetwin[docs]")
    folder = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder]
    done = subprocess.run(
        words, cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr + done.stdout
    return folder


def test_the_site_has_every_page_and_links_between_them_hold(built):
    for page in site.DOCS.rglob("*.md"):
        assert (built / page.relative_to(site.DOCS).with_suffix(".html")).is_file()
    count = 0
    for page in set(built.rglob("*.html")) - {built / "404.html"}:
        for target in re.findall(r'<(?:a|img)\s[^>]*?(?:href|src)="([^"#?]+)[^"]*"', page.read_text(encoding="utf-8")):
            if ":" not in target:
                assert (page.parent / target).exists(), (page.name, target)
                count += 1
    assert count > 1000


def test_nothing_is_loaded_from_elsewhere(built):
    for page in built.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        resources = Resources()
        resources.feed(text)
        assert not [r for r in resources.found if r.startswith(("http:", "https:", "//"))], page
        assert 'class="mermaid"' not in text  # the one thing that the theme would fetch
    for sheet in built.rglob("*.css"):
        assert not re.search(r"@import|url\(['\"]?(https?:)?//", sheet.read_text(encoding="utf-8"))


def test_every_package_has_its_place_in_the_reference():
    pages = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs" / "api").glob("*.md"))
    packages = {link.name for link in (ROOT / "stridetwin").iterdir() if link.is_symlink()}
    with_modules = {name for name in packages if any((ROOT / name).glob("*.py"))}
    without_python_interface = {"assets", "cli"}
    assert set(re.findall(r"^::: stridetwin\.(\w+)", pages, re.M)) == with_modules - without_python_interface


def test_the_reference_lists_the_public_classes(built):
    for page, names in {
        "streams": ["Imu", "Rig", "Recording.samples", "StrideTwinError"],
        "estimators": ["FootIns.update", "FootToFoot", "ContactTerrain", "Dvio", "TerrainMap", "LocomotionMode"],
        "twin": ["Twin", "TwinConfig", "Stairs", "LiveTwin"],
        "scenarios": ["read_scenario", "Campaign"],
        "gate": ["compare_scores", "stridetwin_scenario"],
        "studies": ["environment", "Study", "run_placement"],
        "outputs": ["OutputKind", "Instance", "evaluate"],
        "run": ["run_recording", "run_live"],
    }.items():
        ids = set(re.findall(r'id="(stridetwin\.[\w.]+)"', (built / "api" / f"{page}.html").read_text("utf-8")))
        for name in names:
            assert any(i.endswith(f".{name}") for i in ids), name


def test_no_line_breaks_inside_an_option():
    page = "<p><code>score --baseline FILE -o x-y</code></p><pre><code>a --b</code></pre><p>a --c</p>"
    whole = '<span style="white-space:nowrap">{}</span>'.format
    expected = f"<code>score {whole('--baseline')} FILE {whole('-o')} x-y</code>"
    assert site.unbroken_options(page) == f"<p>{expected}</p><pre><code>a --b</code></pre><p>a --c</p>"


def test_tables_show_the_pipes_of_their_code(built):
    text = (built / "command_line.html").read_text(encoding="utf-8")
    assert "kinematic|dynamic" in text
    assert r"\|" not in text
