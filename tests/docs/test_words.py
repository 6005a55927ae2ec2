"""The pages use the field's words: none of those in FORBIDDEN, but for the uses in ALLOWED."""

import re
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
    r"\bdead reckoning\b": "the term itself",
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
