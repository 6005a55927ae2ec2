"""Processes beside this one, of which one dies."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from stridetwin.scenarios.processes import as_done, mapped
from stridetwin.streams.errors import StrideTwinError


def test_results_come_in_the_order_of_the_jobs():
    assert list(mapped(abs, [-3, 2, -1], 2)) == [3, 2, 1]


def test_results_come_as_they_are_done():
    assert set(as_done(abs, [-3, 2, -1], 2)) == {(-3, 3), (2, 2), (-1, 1)}
    assert [job for job, _ in as_done(time.sleep, [3.0, 0.01], 2)] == [0.01, 3.0]


@pytest.mark.parametrize("together", [mapped, as_done])
def test_a_worker_that_dies_is_an_error_in_one_line(together):
    with pytest.raises(StrideTwinError, match="a worker process died; memory may be too small for 2 at a time"):
        list(together(os._exit, [7, 7], 2))


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_no_worker_outlives_the_one_who_started_it(end, tmp_path):
    """Each worker writes its number, and would go on for a minute."""
    code = (
        "import os, sys, time, pathlib\n"
        "from stridetwin.scenarios.processes import as_done\n"
        "def act(name):\n"
        "    pathlib.Path(name).write_text(str(os.getpid()))\n"
        "    time.sleep(60)\n"
        "if __name__ == '__main__':\n"
        "    list(as_done(act, sys.argv[1:], 2))\n"
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
