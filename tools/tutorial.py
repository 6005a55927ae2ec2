"""Runs docs/tutorial.md literally in a folder of its own, and reports the results.

    python -m tools.tutorial [--wheel] [--folder DIR]

The folder also holds packages named `sim` and `estimators`, as a user's may: they must do no harm. With `--wheel` the
package is built and installed as for users, in its own environment, and each command is a process; dependencies come
from the current environment, so that nothing is downloaded. Without it, the working tree runs in this process.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import io
import os
import re
import shlex
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "tutorial.md"
_BLOCK = re.compile(r"^```(\w+)(?: title=\"([^\"]+)\")?\n(.*?)^```$", re.M | re.S)
_HARM = 'raise ImportError("this package is not part of the project")\n'


@dataclass(frozen=True, kw_only=True)
class Block:
    """A block of code of the page.

    Attributes:
        language: Language on the page.
        file: File name on the page; None for a block that is not a file.
        text: Its lines.
    """

    language: str
    file: str | None
    text: str

    @property
    def commands(self) -> list[str]:
        """Console lines after `$ `, without their comments."""
        return [line[2:].split("  #")[0].strip() for line in self.text.splitlines() if line.startswith("$ ")]


@dataclass(frozen=True, kw_only=True)
class Said:
    """A command of the page, and its result."""

    command: str
    code: int
    output: str


def blocks(page: str) -> list[Block]:
    """The blocks of code of a page, in order."""
    return [Block(language=kind, file=file or None, text=text) for kind, file, text in _BLOCK.findall(page)]


def follow(page: str, folder: Path, do: Callable[[str], Said]) -> Iterator[Said]:
    """Writes the page's files and runs its commands, except the installation, up to the first failure."""
    strangers(folder)
    for block in blocks(page):
        if block.file:
            (folder / block.file).write_text(block.text, encoding="utf-8")
        for command in block.commands if block.language == "console" else []:
            if not command.startswith("pip install"):
                said = do(command)
                yield said
                if said.code:
                    return


def here(command: str) -> Said:
    """Runs a command in this process."""
    from stridetwin.cli.main import main as stridetwin

    words, _, file = command.partition(" > ")
    program, *arguments = shlex.split(words)
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output if not file else io.StringIO()):
        try:
            if program == "pytest":
                import pytest

                plugin = [] if _installed() else ["-p", "stridetwin.gate.pytest_plugin"]
                code = int(pytest.main([*arguments, "-p", "no:dash", "-p", "no:cacheprovider", *plugin]))
            else:
                code = stridetwin(arguments)
        except SystemExit as end:  # after --help
            code = int(end.code or 0)
    if file:
        Path(file).write_text(output.getvalue(), encoding="utf-8")
    return Said(command=command, code=code, output="" if file else output.getvalue())


def in_a_shell(command: str, environment: dict[str, str]) -> Said:
    """Runs a command in a separate process."""
    done = subprocess.run(["bash", "-c", command], env=environment, capture_output=True, text=True, timeout=1800)
    return Said(command=command, code=done.returncode, output=done.stdout + done.stderr)


def strangers(folder: Path) -> None:
    """Writes packages with the project's package names into a folder; they raise an error when they are imported."""
    for name in (
        "batch",
        "sim",
        "estimators",
        "streams",
        "scenarios",
        "outputs",
        "run",
        "gate",
        "pages",
        "reference",
        "report",
        "studies",
        "testing",
        "cli",
    ):
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text(_HARM, encoding="utf-8")


def of_the_wheel(folder: Path) -> dict[str, str]:
    """An environment with the wheel that is built from the source distribution, as `pip install` makes it."""
    from tools.distribution import build  # the tests run this file from a folder without the module

    home = folder / "venv"
    _, wheel = build(folder / "build")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", home], check=True)
    (packages,) = home.glob("lib/python*/site-packages")
    into = [sys.executable, "-m", "pip", "--python", home / "bin" / "python", "install", "--quiet", "--no-deps"]
    subprocess.run([*into, "--no-index", "--no-compile", wheel], check=True)
    # Searched after its own packages. Its .pth files are not read, so an editable installation there has no effect.
    (packages / "others.pth").write_text(sysconfig.get_paths()["purelib"] + "\n", encoding="utf-8")
    script = home / "bin" / "pytest"
    script.write_text(f"#!{home}/bin/python\nimport sys, pytest\nsys.exit(pytest.main())\n", encoding="utf-8")
    script.chmod(0o755)
    left = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "PYTEST", "VIRTUAL_ENV"))}
    path = os.pathsep.join([str(home / "bin"), os.environ["PATH"]])
    return left | {"PATH": path, "PYTEST_ADDOPTS": "-p no:dash -p no:cacheprovider"}


def main() -> int:
    """Runs the tutorial; 1 if one of its commands fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wheel", action="store_true", help="with the wheel, as users get it")
    parser.add_argument("--folder", type=Path, help="where, a new folder (default: one that goes afterwards)")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="tutorial-") as spare:
        folder = (asked.folder or Path(spare)).absolute()
        do: Callable[[str], Said] = here
        if asked.wheel:
            environment = of_the_wheel(folder / "environment")
            do = functools.partial(in_a_shell, environment=environment)
            said = do(f"python '{ROOT / 'tools' / 'without_extras.py'}'")
            print(said.output, flush=True)
            if said.code:
                return 1
        place = folder / "work"
        place.mkdir(parents=True)
        os.chdir(place)
        sys.path.insert(0, str(place))  # as with `python` on the command line
        for said in follow(PAGE.read_text(encoding="utf-8"), place, do):
            print(f"$ {said.command}\n{said.output}", flush=True)
            if said.code:
                print(f"exit code {said.code}", file=sys.stderr)
                return 1
        os.chdir(ROOT)
    return 0


def _installed() -> bool:
    """Whether pytest finds the plugin by itself."""
    from importlib.metadata import entry_points

    return any(point.name == "stridetwin" for point in entry_points(group="pytest11"))


if __name__ == "__main__":
    sys.exit(main())
