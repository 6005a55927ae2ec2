"""Installs wheel and source distribution into environments of their own, outside the checkout, and uses them there.

    python -m tools.bare_environments

With each of them: `list`, `generate`, `run --no-cameras`, `score` and `place`. Only the packages that the installed
distribution asks for are there. Exits with 1 at the first command that fails, and prints it with its output.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tools.distribution import ROOT, build

EXTRAS = "twin,placement"
SCENARIO = """description: two steps of level ground
terrain:
  - level: {length_m: 1.5}
"""
CAMPAIGN = """campaign: Two short walks
walks: 2
scenarios: [short.yaml]
set:
  gait.speed_mps: {uniform: [0.9, 1.1]}
  sensors.head_camera: false
  sensors.foot_camera: false
"""
PLACEMENT = """placement: Where the shoe's IMU sits
scenarios: [short.yaml]
free:
  sensors.foot_imu.position_mm[0]: {between: [-20, 20], step: 40}
scores: [foot_ins.end_error_m]
"""
COMMANDS = (
    "stridetwin list",
    "stridetwin generate campaign.yaml -o walks",
    "stridetwin run short.yaml --no-cameras -o walk",
    "stridetwin score walk/recording.mcap",
    "stridetwin place placement.yaml -o places",
)


def try_commands(distribution: Path, folder: Path) -> Iterator[subprocess.CompletedProcess[str]]:
    """Installs a distribution into a new environment in a folder, and gives the result of each of `COMMANDS` there."""
    home, work = folder / "environment", folder / "work"
    work.mkdir(parents=True)
    for name, text in (("short.yaml", SCENARIO), ("campaign.yaml", CAMPAIGN), ("placement.yaml", PLACEMENT)):
        (work / name).write_text(text, encoding="utf-8")
    left = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}
    environment = left | {"PATH": os.pathsep.join([str(home / "bin"), os.environ["PATH"]])}
    uv = str(Path(sys.executable).with_name("uv"))
    install = [uv, "pip", "install", "--quiet", "--python", str(home), "-c", str(ROOT / "constraints.txt")]
    for command in (
        [uv, "venv", "--quiet", "--python", sys.executable, str(home)],
        [*install, f"{distribution}[{EXTRAS}]"],
        *map(shlex.split, COMMANDS),
    ):
        yield subprocess.run(command, cwd=work, env=environment, capture_output=True, text=True, timeout=1200)


def main() -> int:
    """Tries both distributions; 1 at the first failure."""
    with tempfile.TemporaryDirectory(prefix="distribution-") as name:
        for distribution in build(Path(name) / "build"):
            folder = Path(name) / distribution.suffix.lstrip(".")
            for done in try_commands(distribution, folder):
                print(f"$ {shlex.join(map(str, done.args))}  # exit code {done.returncode}", flush=True)
                if done.returncode:
                    print(done.stdout + done.stderr, file=sys.stderr)
                    return 1
            print(f"{distribution.name} works in an environment of its own\n", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
