"""Memory of a long walk: the largest resident size of `generate` and of its rendering processes.

`python -m benchmarks.memory [--minutes 10] [--cameras] [--json]` walks back and forth for this time and measures twice
per second. `planned_mib` is the largest size before the first sample is written, `first_mib` and `last_mib` those
while the first and the last tenth of the file are written, which reveals a leak. Linux only.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from stridetwin.streams.files import partial_path

LIMIT_MIB = 1536.0
_METRES_A_MINUTE = 70.0


def scenario(minutes: float) -> str:
    """A path back and forth that takes about this time."""
    half = minutes * _METRES_A_MINUTE / 2
    pieces = [f"  - level: {{length_m: {half:.1f}}}", "  - turn: {angle_deg: 180, radius_m: 5}"]
    return "\n".join(["description: there and back", "terrain:", *pieces, pieces[0]]) + "\n"


def resident_mib(pid: int) -> float:
    """Resident memory of a process and its children, MiB; mapped files (libraries) count once."""
    sizes = list(_sizes_mib(pid))
    return sum(own_mib for own_mib, _ in sizes) + max((mapped for _, mapped in sizes), default=0.0)


def _sizes_mib(pid: int) -> Iterator[tuple[float, float]]:
    """Private and mapped memory of each process of a family, MiB; ended processes are omitted."""
    try:
        rows = dict(line.split(":") for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:])
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        resident, own_mib = (int(rows[name].split()[0]) / 1024 for name in ("Rss", "Anonymous"))
    except (OSError, KeyError):
        return
    yield own_mib, resident - own_mib
    for child in children:
        yield from _sizes_mib(int(child))


def measure(minutes: float, cameras: bool) -> dict[str, float]:
    """Largest sizes, MiB, of one `generate` and its rendering processes."""
    with tempfile.TemporaryDirectory() as folder:
        path, target = Path(folder) / "long.yaml", Path(folder) / "long.mcap"
        path.write_text(scenario(minutes))
        call = "import sys; from stridetwin.cli.main import main; sys.exit(main(sys.argv[1:]))"
        options = [] if cameras else ["--no-cameras"]
        process = subprocess.Popen([sys.executable, "-c", call, "generate", str(path), "-o", str(target), *options])
        planned, writing = 0.0, list[tuple[int, float]]()
        while process.poll() is None:
            size, growing = resident_mib(process.pid), partial_path(target)
            if growing.exists():
                writing.append((growing.stat().st_size, size))
            else:
                planned = max(planned, size)
            time.sleep(0.5)
        if process.returncode:
            raise SystemExit(process.returncode)
        end = target.stat().st_size
    return {
        "planned_mib": planned,
        "first_mib": max(mib for size, mib in writing if size <= 0.1 * end),
        "last_mib": max(mib for size, mib in writing if size >= 0.9 * writing[-1][0]),
        "largest_mib": max(planned, *(mib for _, mib in writing)),
        "limit_mib": LIMIT_MIB,
        "file_mib": end / 2**20,
    }


def main() -> None:
    """Prints a line, or one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--cameras", action="store_true")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    row = measure(arguments.minutes, arguments.cameras)
    if arguments.json:
        print(json.dumps({"experiment": "memory", "summary": row, "paper": {}, "cases": []}))
        return
    print(
        f"{arguments.minutes:g} min: {row['planned_mib']:.0f} MiB while the walk was planned, {row['first_mib']:.0f} "
        f"at the start of the file, {row['last_mib']:.0f} at its end; largest {row['largest_mib']:.0f}, "
        f"limit {LIMIT_MIB:.0f}"
    )


if __name__ == "__main__":
    main()
