"""How many inserted bugs the tests find.

`python -m benchmarks.mutation [--count 200] [--seed 0] [-o FILE.jsonl] [--only PATH] [--json]` inserts one bug per run
into the estimators, the truth or the scores, and runs the tests that are nearest to the changed module (`NEAREST`)
until one fails. The bugs are a sample of all of `benchmarks.mutants`, which the seed determines: modules count by the
square root of their number of bugs, so that large ones do not crowd out the rest. The file gets one row per bug; a run
continues where an earlier one with the same seed was interrupted. `--show survived` lists the bugs that no test found.

Bugs are inserted into a copy of the repository's files with a cache of compiled functions of its own, never into the
repository itself.
"""

from __future__ import annotations

import argparse
import ast
import itertools
import json
import math
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.command import answer, command
from benchmarks.mutants import Mutant, is_change, mutants, statements_at
from stridetwin.streams.errors import StrideTwinError

ROOT = Path(__file__).parents[1]
SCOPES = (
    "streams/algebra",
    "estimators",
    "outputs",
    "gate",
    "sim/truth.py",
    "sim/gait/footsteps.py",
    "sim/sensors/exo_sensors.py",
)
"""Folders and files into which bugs are inserted."""
_SET = "tests/estimators/test_parameter_set.py"
NEAREST: dict[str, tuple[str, ...]] = {
    "estimators/foot_ins": (
        _SET,
        "tests/estimators/test_kalman.py",
        "tests/estimators/test_foot_kernels.py",
        "tests/estimators/test_strapdown.py",
        "tests/estimators/test_foot_ins.py",
        "tests/estimators/test_foot_clipping.py",
        "tests/estimators/test_foot_floor.py",
        "tests/estimators/test_foot_ins_faults.py",
        "tests/estimators/test_foot_ins_smoother.py",
        "tests/estimators/test_foot_pinned.py",
    ),
    "estimators/foot_to_foot": (
        _SET,
        "tests/estimators/test_foot_to_foot_kernels.py",
        "tests/estimators/test_foot_to_foot.py",
        "tests/estimators/test_foot_pinned.py",
        "tests/estimators/test_gyro_scale.py",
        "tests/estimators/test_left_right.py",
        "tests/estimators/test_board_tracking.py",
        "tests/outputs/test_feet_and_head.py",
    ),
    "estimators/checkerboard": (
        _SET,
        "tests/estimators/test_board_pattern.py",
        "tests/estimators/test_board_pose.py",
        "tests/estimators/test_board_tracking.py",
        "tests/estimators/test_board.py",
    ),
    "estimators/contact_terrain": (
        _SET,
        "tests/estimators/test_contact_terrain_parts.py",
        "tests/estimators/test_contact_terrain_leg.py",
        "tests/estimators/test_contact_terrain_filter.py",
        "tests/estimators/test_contact_terrain_published.py",
    ),
    "estimators/terrain_map": (_SET, "tests/estimators/terrain_map"),
    "estimators/locomotion_mode": (_SET, "tests/estimators/locomotion_mode"),
    "estimators/dvio": (_SET, "tests/estimators/dvio", "tests/outputs/test_odometry.py"),
    "estimators": (
        "tests/estimators/test_compiled.py",
        "tests/estimators/test_foot_ins.py",
        "tests/estimators/test_contact_terrain_filter.py",
        "tests/run/test_example_package.py",
    ),
    "streams/algebra": (
        "tests/streams/algebra",
        "tests/estimators/test_foot_ins.py",
        "tests/estimators/test_contact_terrain_filter.py",
    ),
    "gate": ("tests/gate",),
    "reference/norms.py": ("tests/report/test_report.py",),
    "outputs": (
        "tests/outputs/test_map_scores.py",
        "tests/outputs/test_scoring.py",
        "tests/outputs/test_steps.py",
        "tests/outputs/test_step_scores.py",
        "tests/outputs/test_mode_score.py",
        "tests/outputs/test_drift.py",
        "tests/outputs/test_footprints.py",
        "tests/outputs/test_ahead.py",
        "tests/outputs/test_score_needs.py",
        "tests/outputs/test_terrain_files.py",
        "tests/outputs/test_phase_scores.py",
        "tests/outputs/test_feet_and_head.py",
    ),
    "sim/truth.py": ("tests/sim/test_twin.py", "tests/sim/test_gait.py", "tests/sim/test_walk_pinned.py"),
    "sim/gait/footsteps.py": (
        "tests/sim/test_gait.py",
        "tests/sim/test_gait_style.py",
        "tests/sim/test_twin.py",
        "tests/sim/test_walk_pinned.py",
    ),
    "sim/sensors/exo_sensors.py": (
        "tests/sim/test_sensors.py",
        "tests/sim/test_twin.py",
        "tests/sim/test_walk_pinned.py",
    ),
}
"""Tests of a file or of a folder's files; the longest name that fits a module counts."""
EQUIVALENT = {
    (
        "outputs/alignment.py",
        "truth.p_frame_in_world - mean_t",
        "truth.p_frame_in_world",
    ): "the other factor has the mean 0, so a constant adds nothing to the sum of the products",
    ("streams/algebra/matrices.py", "s > 1e-7", "s >= 1e-7"): "both branches agree at their limit to the last digits",
    ("estimators/foot_ins/kalman.py", "n = P.shape[0]", "n = P.shape[1]"): "P is square",
    ("estimators/foot_ins/smoother.py", "llvm_level=1", "llvm_level=2"): "another speed of the same result",
    ("estimators/checkerboard/pose.py", ".max() < 1e-4", ".max() <= 1e-4"): "no two solutions differ by just that",
    (
        "estimators/checkerboard/pose.py",
        "points[:, :2] - points[:, :2].mean(axis=0)",
        "points[:, :2].mean(axis=0) - points[:, :2]",
    ): "singular values have no sign",
    ("estimators/dvio/landmarks.py", "> most * most", ">= most * most"): "no residual is just that",
    ("estimators/foot_to_foot/published.py", "total += value", "total -= value"): "only its square counts",
    (
        "estimators/foot_to_foot/rewind.py",
        "w = axpy(state.rate_of(memory, state.ring_row(memory, 0)), -1.0, gyro_bias)",
        "w = axpy(state.rate_of(memory, state.ring_row(memory, 1)), -1.0, gyro_bias)",
    ): "the loop replaces it where it is used",
    (
        "estimators/locomotion_mode/published.py",
        "zip(self._divisions, self._divisions[1:])",
        "zip(self._divisions[1:], self._divisions)",
    ): "a distance has no sign",
    (
        "estimators/terrain_map/tsdf_integration.py",
        "(descent > _ZERO)",
        "(descent >= _ZERO)",
    ): "the product with the descent is 0 as well",
    (
        "estimators/contact_terrain/offsets.py",
        "explained[i, j] + explained[j, i]",
        "explained[i, j] + explained[i, j]",
    ): "the matrix is symmetric but for rounding errors",
    (
        "estimators/locomotion_mode/rhythm.py",
        "elapsed < _BOUNCE_SHARE",
        "elapsed <= _BOUNCE_SHARE",
    ): "no step takes just that share",
    (
        "outputs/terrain/mapped_route.py",
        "self._s > place_m - _BEHIND_M",
        "self._s >= place_m - _BEHIND_M",
    ): "no cell's middle is just there",
    (
        "gate/metric_policy.py",
        "self.slack, 1e-12",
        "self.slack, 2e-12",
    ): "it keeps the logarithm of 0 finite; no score is as small",
}
"""Changes without an effect that `is_change` does not see, each with the reason. They are left out of the sample.
A key is a file, a text in it, and what that text is changed to."""
SHOWN = ("survived", "found", "timeout")
_WAITING = 10  # limit of the time that passes, in limits of CPU time


@dataclass(frozen=True, kw_only=True)
class Bug:
    """One bug in one file of the repository."""

    file: str
    mutant: Mutant

    @property
    def key(self) -> tuple[str, int, str, str]:
        """What identifies it in a row of the results."""
        return self.file, self.mutant.start, self.mutant.before, self.mutant.after


def nearest(file: str) -> tuple[str, ...]:
    """The tests of a file, those of its own part before the rest.

    Raises:
        StrideTwinError: None is known.
    """
    fitting = [name for name in NEAREST if file == name or file.startswith(f"{name}/")]
    if not fitting:
        raise StrideTwinError(f"{file}: no tests are known: expected a file below {', '.join(NEAREST)}")
    return NEAREST[max(fitting, key=len)]


def sample(seed: int, scopes: tuple[str, ...] = SCOPES, root: Path = ROOT) -> Iterator[Bug]:
    """All bugs in the order that a seed determines.

    Args:
        seed: Of the order.
        scopes: Folders and files, relative to the root.
        root: Of the repository.
    """
    rng = random.Random(seed)
    paths = sorted(p for s in scopes for p in ([root / s] if s.endswith(".py") else (root / s).rglob("*.py")))
    sources = {path.relative_to(root).as_posix(): path.read_text(encoding="utf-8") for path in paths}
    left = {file: file_mutants for file, source in sources.items() if (file_mutants := mutants(source))}
    for file_mutants in left.values():
        rng.shuffle(file_mutants)
    weights = {file: math.sqrt(len(file_mutants)) for file, file_mutants in left.items()}
    while left:
        file = rng.choices(list(left), [weights[name] for name in left])[0]
        mutant = left[file].pop()
        if not left[file]:
            del left[file]
        if is_change(sources[file], mutant) and not is_equivalent(file, sources[file], mutant):
            yield Bug(file=file, mutant=mutant)


def is_equivalent(file: str, source: str, mutant: Mutant) -> bool:
    """Whether a change of a file, relative to the root, is one of `EQUIVALENT`."""
    changed = [
        source[: match.start()] + after + source[match.end() :]
        for name, before, after in EQUIVALENT
        if name == file
        for match in re.finditer(re.escape(before), source)
        if source.count("\n", 0, match.start()) + 1 == mutant.line
    ]
    if not changed:
        return False
    trees = [
        [ast.dump(statement) for statement in statements_at(mutant.line, source, text)]
        for text in (mutant.applied(source), *changed)
    ]
    return trees[0] in trees[1:]


class Copy:
    """A copy of the repository's files, in which bugs are inserted and tests run.

    Args:
        folder: New folder for it.
        root: Of the repository.
    """

    def __init__(self, folder: Path, root: Path = ROOT) -> None:
        self.folder = folder / "tree"
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=root,
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for name in filter(None, listed.split("\0")):
            source, target = root / name, self.folder / name
            if source.is_file() or source.is_symlink():
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(source, target, follow_symlinks=False)
        data = os.environ.get("STRIDETWIN_DATA", str(root.parent / "shared" / "data"))
        self._environment = os.environ | {
            "NUMBA_CACHE_DIR": str(folder / "numba"),
            "PYTHONPATH": str(self.folder),
            "STRIDETWIN_DATA": data,
            "PYTHONDONTWRITEBYTECODE": "1",
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }

    def failing(self, tests: tuple[str, ...], timeout_s: float) -> tuple[str, str]:
        """Runs tests until one fails, or until they have used `timeout_s` of CPU time.

        Returns:
            `survived`, `found` or `timeout`; and the test that failed.
        """
        there = [test for test in tests if (self.folder / test).exists()]
        arguments = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--tb=no", *there]
        process = subprocess.Popen(
            arguments,
            cwd=self.folder,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            preexec_fn=lambda: _limit_cpu(timeout_s),
        )
        try:
            output, _ = process.communicate(timeout=_WAITING * timeout_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return "timeout", ""
        if process.returncode == -signal.SIGXCPU:
            return "timeout", ""
        failed = [line.split(" ")[1] for line in output.splitlines() if line.startswith(("FAILED ", "ERROR "))]
        return ("survived" if process.returncode == 0 else "found"), (failed or [""])[0]

    def outcome(self, bug: Bug, timeout_s: float) -> dict[str, Any]:
        """Row of the results for one bug."""
        path = self.folder / bug.file
        source = path.read_text(encoding="utf-8")
        began = time.monotonic()
        try:
            path.write_text(bug.mutant.applied(source), encoding="utf-8")
            outcome, test = self.failing(nearest(bug.file), timeout_s)
        finally:
            path.write_text(source, encoding="utf-8")
        seconds = round(time.monotonic() - began, 1)
        return {"file": bug.file, **asdict(bug.mutant), "outcome": outcome, "test": test, "seconds": seconds}


def _limit_cpu(seconds: float) -> None:
    """Ends this process after some CPU time: the time of a shared machine says nothing of an endless loop."""
    limit = math.ceil(seconds)
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 10))


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Inserts the bugs of the sample that have no row yet.

    Raises:
        StrideTwinError: The tests fail without a bug, or take longer than the limit.
    """
    scopes = (arguments.only,) if arguments.only else SCOPES
    bugs = list(itertools.islice(sample(arguments.seed, scopes, ROOT), arguments.count))
    rows = {_key(row): row for row in _rows(arguments.output)}
    missing = [bug for bug in bugs if bug.key not in rows]
    with tempfile.TemporaryDirectory() as name:
        copy = Copy(Path(name), ROOT) if missing else None
        sound: set[tuple[str, ...]] = set()
        for bug in missing:
            assert copy is not None
            if (tests := nearest(bug.file)) not in sound:
                outcome, test = copy.failing(tests, arguments.timeout)
                if outcome != "survived":
                    raise StrideTwinError(f"{test or tests[0]}: {outcome} without a bug: expected tests that pass")
                sound.add(tests)
            row = rows[bug.key] = copy.outcome(bug, arguments.timeout)
            if arguments.output is not None:
                with arguments.output.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
            print(_line(row), file=sys.stderr, flush=True)
    chosen = [rows[bug.key] for bug in bugs]
    counts = Counter(row["outcome"] for row in chosen)
    found_share = (len(chosen) - counts["survived"]) / len(chosen) if chosen else math.nan
    return {"bugs": len(chosen), **{name: counts[name] for name in SHOWN}, "share_found": found_share, "rows": chosen}


def _rows(path: Path | None) -> list[dict[str, Any]]:
    """Rows of an earlier run; a last line that was not written whole is left out."""
    if path is None or not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").split("\n")
    if lines[-1]:
        path.write_text("".join(f"{line}\n" for line in lines[:-1]), encoding="utf-8")
    return [json.loads(line) for line in lines[:-1]]


def _key(row: dict[str, Any]) -> tuple[str, int, str, str]:
    return row["file"], row["start"], row["before"], row["after"]


def _line(row: dict[str, Any]) -> str:
    before, after = (" ".join(str(row[name]).split())[:60] for name in ("before", "after"))
    return f"{row['outcome']:8s} {row['file']}:{row['line']} {row['kind']}: {before} -> {after} ({row['seconds']:g} s)"


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--count", type=int, default=200, metavar="N", help="bugs to insert (default 200)")
    parser.add_argument("--seed", type=int, default=0, help="of the sample (default 0)")
    parser.add_argument("--only", metavar="PATH", help="a folder or file of these: " + ", ".join(SCOPES))
    parser.add_argument(
        "--timeout", type=float, default=600.0, metavar="S", help="CPU time for the tests of one bug (default 600)"
    )
    parser.add_argument("--show", choices=SHOWN, default="survived", help="bugs to list (default survived)")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="rows, one JSON object per line; continued")
    show = parser.parse_known_args()[0].show

    def listed(result: dict[str, Any]) -> None:
        for row in result["rows"]:
            if row["outcome"] == show:
                print(_line(row))
        counts_text = ", ".join(f"{result[name]} {name}" for name in SHOWN)
        print(f"{result['bugs']} bugs: {counts_text}; {result['share_found']:.1%} noticed")

    return answer(parser, measure, listed)


if __name__ == "__main__":
    raise SystemExit(main())
