"""Output folders after errors and kills."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from stridetwin.scenarios.files import stage_files


def half_way(out: Path) -> None:
    with stage_files(out) as folder:
        (folder / "a.txt").write_text("b")
        raise RuntimeError("half way")


def test_files_appear_whole_or_not_at_all(tmp_path):
    with stage_files(tmp_path / "out") as folder:
        (folder / "a.txt").write_text("a")
        assert not (tmp_path / "out" / "a.txt").exists()
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["a.txt"]
    with pytest.raises(RuntimeError, match="half way"):
        half_way(tmp_path / "out")
    assert (tmp_path / "out" / "a.txt").read_text() == "a"


def test_what_a_killed_process_left_goes_and_what_a_living_one_works_on_stays(tmp_path):
    program = (
        "import sys, time\nfrom pathlib import Path\nfrom stridetwin.scenarios.files import stage_files\n"
        "with stage_files(Path(sys.argv[1])) as folder:\n"
        "    (folder / 'half').write_text('x')\n    print(folder, flush=True)\n    time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        other.stdout.readline()
        with stage_files(tmp_path):
            pass
        assert len(list(tmp_path.iterdir())) == 1
        other.send_signal(signal.SIGKILL)
        other.wait()
    assert len(list(tmp_path.iterdir())) == 1
    with stage_files(tmp_path):
        pass
    assert not list(tmp_path.iterdir())
