"""Pages and code use the field's words: none of those in FORBIDDEN, but for the uses in ALLOWED."""

import ast
import io
import re
import tokenize
from functools import cache
from pathlib import Path

import pytest

from tools.site import parts

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "api").glob("*.md")],
    key=lambda page: page.as_posix(),
)
"""All pages but the generated tables of docs/results."""

FORBIDDEN = {
    r"told|tells?|telling": "estimated, measured, reported, nominal",
    r"pictures?": "image, frame",
    r"sightings?": "observation",
    r"foresees?|foreseen|foretell|foretold": "predict",
    r"carr(?:y|ies|ied) on": "propagate",
    r"strangeness|surprised?|surprises": "Mahalanobis distance, normalised innovation",
    r"in doubt|doubts?|doubtful": "saturated, invalid",
    r"room for": "buffer, workspace",
    r"coasting": "dead reckoning, IMU-only propagation",
    r"pieces?": "terrain segment",
    r"brinks?": "occluding edge, drop-off",
    r"outlines?": "depth discontinuities",
    r"footings?|felt|feels?": "foothold, contact sensing, measured",
    r"laid over|laying": "alignment",
    r"spoil(?:s|t|ed|ing)?": "corrupted, fault injected, invalidates",
    r"outfits?|worn sensors?": "sensor rig",
    r"price of": "weight, cost",
    r"judge[sd]?|judging": "quality check, compare",
    r"deviations?": "standard deviation",
    r"serve[sd]? for no tuning": "held-out",
    r"as the machine has it": "depending on the machine",
    r"ms of a processor|of a processor": "CPU time",
    r"is not valid; valid": "invalid X: expected Y",
    r"something to put right": "usage error",
    r"fit for use": "valid",
    r"made again|made anew|as the code is|code as it is": "regenerated with the current version",
    r"stands (?:in|on|here|there|beside|as|of)|here stands": "is, is listed",
    r"look(?:s|ed)? for|looking for": "searched, detected",
    r"loaded down": "downloaded",
    r"reckon(?:s|ed|ing)?": "computed, estimated",
    r"left less right": "left minus right",
    r"he|his|him": "they, their",
    r"nobody's|of which none|that is none|is none of": "a plain sentence",
}
"""Patterns of words, any case, and what a page says instead.

Words of the vocabulary with an everyday sense that fits (a walker turns, a camera's lens, a knee, a push, a live
command, the touch-down of a foot) are not here: no pattern can tell the senses apart.
"""

ALLOWED = {
    r"\bstandard deviations?\b": "the term itself",
    r"\bAllan deviations?\b": "the term of IMU noise",
    r"\bdead[ -]reckoning\b": "the term itself",
}
"""Uses that are right, and why. Code, fenced or between backticks, is left out: it shows names as they are."""


def words_of(page):
    """A page's text without code, addresses of links, equations and allowed uses; line breaks as spaces."""
    text = "".join(part for fenced, part in parts(page.read_text(encoding="utf-8")) if not fenced)
    text = re.sub(r"^::: .*$|^    options: .*$", "", text, flags=re.M)  # references to code, of the API pages
    text = re.sub(r"\$\$.*?\$\$|(?<!`)(`+)(?!`).+?(?<!`)\1(?!`)|\]\([^)]*\)", " ", text, flags=re.S)
    text = " ".join(text.split())
    for pattern in ALLOWED:
        text = re.sub(pattern, " ", text, flags=re.I)
    return text


def found(text):
    """Forbidden words of a text, with some words around."""
    pattern = re.compile(r"\b(?:" + "|".join(FORBIDDEN) + r")\b", re.I)
    return [text[max(0, m.start() - 30) : m.end() + 20] for m in pattern.finditer(text)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_pages_use_the_field_s_words(page):
    assert found(words_of(page)) == []


def test_forbidden_words_are_found_and_code_is_not(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("It is *told*.\n`told: true` [a](told.md)\n```\nhis\n```\nStandard deviations, a Deviation.\n")
    assert len(found(words_of(page))) == 2
    assert found("The walker turns and touches down.") == []


PACKAGES = ("streams", "batch", "sim", "estimators", "scenarios", "pipeline", "evaluation", "report", "studies", "cli")
ONLY_ON_PAGES = (
    r"outlines?",  # of drawings
    r"room for",
    r"price of",
    r"carr(?:y|ies|ied) on",
    r"stands (?:in|on|here|there|beside|as|of)|here stands",  # a walker stands on the ground
    r"deviations?",  # from an estimate
)
"""Entries of FORBIDDEN that are ambiguous in code."""
CODE_WORDS = {pattern: words for pattern, words in FORBIDDEN.items() if pattern not in ONLY_ON_PAGES}
ALLOWED_IN_FILES = {
    "cli/bridge.py": r"skip.pictures",  # former names, which work and warn
    "estimators/foot_to_foot/__init__.py": r"Board Sighting",
    "estimators/foot_to_foot/filter.py": r"\bsightings\b",
    "report/runner.py": r"\bpictures\b",
    "scenarios/check.py": r"^spoils$",
    "scenarios/sensor_model.py": r"\btold\b",
    "report/run_report.py": r"^nis sightings$",  # keys of files that earlier versions have written
    "studies/jao2020/jao_walk.py": r"\bsightings\b",
    "studies/registry.py": r"^told$|^single picture$",
    "studies/zhao2023/mode_fusion.py": r"\btold\b",
    "studies/zhao2023/mode_not_fooled.py": r"\btold\b",
    "streams/formats/bag_files.py": r"^tell$",  # the method of a file or of an optimiser
    "streams/recording/mcap_scan.py": r"^tell$",
    "streams/recording/mcap_writer.py": r"^tell$",
    "studies/placement/search.py": r"^tell$",
}
"""Uses in single files that are right."""


def texts_of(source):
    """Identifiers, string literals and comments of a Python source; `snake_case` and `CamelCase` become words."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield _split(node.value)
        for name in ("id", "name", "attr", "arg", "asname", "module"):
            if isinstance(value := getattr(node, name, None), str):
                yield _split(value)
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield _split(token.string)


def _split(text):
    text = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", text)
    return " ".join(re.sub(r"[_\W]*_[_\W]*", " ", text).split())


def found_in_code(source, allowed_here=()):
    """Forbidden words of a Python source, with some words around."""
    pattern = re.compile(r"\b(?:" + "|".join(CODE_WORDS) + r")\b", re.I)
    hits = []
    for text in texts_of(source):
        for allowed in (*ALLOWED, *allowed_here):
            text = re.sub(allowed, " ", text, flags=re.I)
        hits += [text[max(0, m.start() - 30) : m.end() + 20] for m in pattern.finditer(text)]
    return hits


@cache
def _hits_of(package):
    hits = []
    for file in sorted((ROOT / package).rglob("*.py")):
        name = file.relative_to(ROOT).as_posix()
        allowed = [ALLOWED_IN_FILES[name]] if name in ALLOWED_IN_FILES else []
        hits += [f"{name}: {hit}" for hit in found_in_code(file.read_text(encoding="utf-8"), allowed)]
    return hits


@pytest.mark.parametrize("package", PACKAGES)
def test_code_uses_the_field_s_words(package):
    assert _hits_of(package) == []


def test_forbidden_words_of_code_are_found():
    source = 'def told_of(x):\n    """Tells it."""\n    return TellTale(x, y="his")  # a picture\n'
    assert len(found_in_code(source)) == 5
    assert len(found_in_code("footing_m = told = untold")) == 2
    assert found_in_code('teller = "standard deviation"\nclock.told', ["^told$"]) == []
