"""The commands that the pages show: of their fenced consoles, and those in running text."""

import re
import shlex
from pathlib import Path

from tools.site import parts

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
OURS = ("stridetwin ", "python -m benchmarks", "python tools/", "make ")

_SPAN = re.compile(r"(?<!`)(`+)(?!`)((?:.(?!\n\n))+?)(?<!`)\1(?!`)", re.S)
_SHELLS = ("", "console", "bash", "sh", "shell")


def name(page):
    return page.relative_to(ROOT).as_posix()


def fenced(page):
    """Lines of a page's consoles, without prompt, comment and `&`."""
    found = []
    for fence, text in parts(page.read_text(encoding="utf-8")):
        if not fence or text.split("\n")[0].strip("` ") not in _SHELLS:
            continue
        for line in text.split("\n")[1:-1]:
            command = re.split(r"\s+#(?=\s|$)", line.strip().removeprefix("$ "))[0].removesuffix("&").strip()
            if line.strip().startswith("$ ") or command.startswith(OURS):
                found.append(command)
    return found


def in_text(page):
    """Commands of ours in the running text of a page, on one line each."""
    found = []
    for fence, text in parts(page.read_text(encoding="utf-8")):
        spans = [] if fence else [" ".join(span.replace(r"\|", "|").split()) for _, span in _SPAN.findall(text)]
        found += [span for span in spans if span.startswith(OURS)]
    return found


def rows_of_the_command_line(commands):
    """Usage of each command, of the table of docs/command_line.md."""
    page = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([a-z]+[^`]*)` \|.*\|.*\|$", page, re.M)
    return ["stridetwin " + row.replace(r"\|", "|") for row in rows if row.split()[0] in commands]


def variants(usage):
    """Words of a usage with all that is optional (`[...]`), once for each alternative (`a|b`)."""
    whole = usage.removesuffix(" ...").replace(" ... ", " PATH ").replace("...", "")
    words = shlex.split(whole.replace("[", "").replace("]", ""))
    choices = [word.split("|") for word in words[: words.index(">") if ">" in words else None]]
    return [[c[min(i, len(c) - 1)] for c in choices] for i in range(max(map(len, choices)))]
