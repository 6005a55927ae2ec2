"""Hostile files are refused within 2 s of the processor and 500 MiB, by every command that reads recordings.

Each file is given to `check` and to one of the others, in turn; they open recordings by the same readers.
"""

import json
import subprocess
import sys

import pytest
from hostile_files import hostile

COMMANDS = {
    "check": lambda path: ["check", path],
    "import": lambda path: ["import", path, "-o", "out.mcap"],
    "estimate": lambda path: ["estimate", "foot_ins", path, "-o", "out.txt"],
    "score": lambda path: ["score", path],
}
OTHERS = [command for command in COMMANDS if command != "check"]
MOST_S, MOST_MIB = 2.0, 500.0
# One process loads the packages; each command runs in a fork of it, whose time and memory the system counts.
ZYGOTE = """
import gc, json, os, resource, sys, traceback
import stridetwin.scenarios.check, stridetwin.outputs.path.evaluate
import stridetwin.outputs.registry
stridetwin.outputs.registry.estimators()
import stridetwin.cli.estimate, stridetwin.cli.recording, stridetwin.cli.score
import rich.console, rich.table
from stridetwin.cli.main import main, parse
from stridetwin.streams.recording.ros_types import typestore
typestore()
parse(["check", "x"])
gc.freeze()  # a collection in a fork would copy every page
for line in sys.stdin:
    words = json.loads(line)
    said = os.open("said.txt", os.O_CREAT | os.O_TRUNC | os.O_RDWR)
    child = os.fork()
    if not child:
        os.dup2(said, 1), os.dup2(said, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (20, 20))
        here = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (here + (4 << 30),) * 2)  # for the machine's sake
        try:
            code = main(words)
        except SystemExit as error:
            code = error.code
        except BaseException:
            traceback.print_exc()
            code = 70
        sys.stdout.flush(), sys.stderr.flush()
        os._exit(code)
    _, status, usage = os.wait4(child, 0)
    text = os.pread(said, 20000, 0).decode(errors="replace")
    os.close(said)
    print(json.dumps({
        "code": os.waitstatus_to_exitcode(status), "cpu_s": usage.ru_utime + usage.ru_stime,
        "mib": usage.ru_maxrss / 1024, "said": text,
    }), flush=True)
"""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """What each command made of each file: exit code, time, memory and words."""
    folder = tmp_path_factory.mktemp("hostile")
    files = hostile(folder)
    (folder / "out").mkdir()
    zygote = subprocess.Popen(
        [sys.executable, "-c", ZYGOTE], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=folder / "out"
    )
    found = {}
    with zygote:
        for i, (name, path) in enumerate(files.items()):
            for command in ("check", OTHERS[i % len(OTHERS)]):
                zygote.stdin.write(json.dumps(COMMANDS[command](str(path))) + "\n")
                zygote.stdin.flush()
                found[name, command] = json.loads(zygote.stdout.readline())
        zygote.stdin.close()
    return found


@pytest.mark.parametrize("command", list(COMMANDS))
def test_hostile_files_are_refused_in_one_line(outcomes, command):
    """`check` may say invalid instead."""
    wrong = {}
    for (name, by), o in outcomes.items():
        lines = o["said"].strip().splitlines()
        refused = o["code"] == 2 and lines[-1].startswith("stridetwin: error: ") and len(lines[-1]) < 1000
        if by == command and not (refused or (command == "check" and o["code"] == 1)):
            wrong[name] = (o["code"], o["said"][-400:])
    assert not wrong


def test_hostile_files_cost_little(outcomes):
    dear = {k: (o["cpu_s"], o["mib"]) for k, o in outcomes.items() if o["cpu_s"] > MOST_S or o["mib"] > MOST_MIB}
    assert not dear
