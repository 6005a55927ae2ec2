"""Processes beside this one, of which one dies."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_no_worker_outlives_the_one_who_started_it(end, tmp_path):
    """Each worker writes its number, and would go on for a minute."""
    code = (
        "import os, sys, time, pathlib\n"
        "from stridetwin.batch.processes import open_pool\n"
        "def act(name):\n"
        "    pathlib.Path(name).write_text(str(os.getpid()))\n"
        "    time.sleep(60)\n"
        "if __name__ == '__main__':\n"
        "    with open_pool(2) as pool:\n"
        "        list(pool.map(act, sys.argv[1:]))\n"
    )
    script, pid_files = tmp_path / "starts.py", [tmp_path / "one", tmp_path / "other"]
    script.write_text(code)
    started = subprocess.Popen([sys.executable, script, *pid_files])
    until = time.monotonic() + 60
    while not all(file.exists() and file.read_text() for file in pid_files) and time.monotonic() < until:
        time.sleep(0.05)
    workers = [int(file.read_text()) for file in pid_files]
    started.send_signal(end)
    started.wait(30)
    until = time.monotonic() + 10
    while any(_lives(pid) for pid in workers) and time.monotonic() < until:
        time.sleep(0.05)
    assert not any(_lives(pid) for pid in workers)


def _lives(pid):
    """Whether a process computes; one that nobody has asked how it ended does not."""
    with suppress(ProcessLookupError, FileNotFoundError):
        os.kill(pid, 0)
        state = Path(f"/proc/{pid}/stat")
        return not Path("/proc/self").exists() or state.read_text().rpartition(")")[2].split()[0] != "Z"
    return False
