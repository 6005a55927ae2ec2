"""Robustness to damaged files: every import format, mutated in many ways, read strictly and leniently.

A mutated source must be rejected in one line per error, be read in part with a warning, or be read unchanged if nothing
relevant was changed. A traceback or a hang is a fault. Different numbers without a warning count as unnoticed: formats
without a checksum allow only plausibility checks.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import signal
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.foreign_files import FORMATS, Walk
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.opening import open_any
from stridetwin.streams.samples import Sample

PER_FORMAT = 200
HANG_S = 20
OUTCOMES = ("refused", "reported", "harmless", "unnoticed", "traceback", "hang")


@dataclass(frozen=True)
class Trial:
    """One mutated source: the mutation, the outcome and the messages."""

    mutation: str
    outcome: str
    said: str


class _HangError(BaseException):
    """Reading took longer than HANG_S."""


def mutated(source: Path, rng: np.random.Generator) -> str:
    """Damages one file of a source in place; returns a description of the mutation."""
    files = sorted(p for p in ([source] if source.is_file() else source.rglob("*")) if p.is_file())
    file = files[int(rng.integers(len(files)))]
    is_text = file.suffix in (".csv", ".txt", ".yaml")
    ways: list[Callable[[Path, np.random.Generator], str]] = [_cut, _flip, _flip, _empty]
    ways += [_drop_column, _swap_columns, _scale_column, _swap_rows, _spoil_word, _drop_rows] * is_text
    ways += [_change_table] * 4 * (file.suffix == ".npz")
    ways += [_remove] * (len(files) > 1)
    way = ways[int(rng.integers(len(ways)))]
    return f"{file.name}: {way(file, rng)}"


def _cut(file: Path, rng: np.random.Generator) -> str:
    data = file.read_bytes()
    length = int(rng.integers(len(data) + 1))
    file.write_bytes(data[:length])
    return f"cut at byte {length} of {len(data)}"


def _flip(file: Path, rng: np.random.Generator) -> str:
    data = bytearray(file.read_bytes())
    at = rng.integers(len(data), size=int(rng.integers(1, 5)))
    for i in at:
        data[i] ^= int(rng.integers(1, 256))
    file.write_bytes(bytes(data))
    return f"bytes {sorted(at.tolist())} flipped"


def _empty(file: Path, rng: np.random.Generator) -> str:
    file.write_bytes(b"")
    return "emptied"


def _remove(file: Path, rng: np.random.Generator) -> str:
    file.unlink()
    return "removed"


def _rows(file: Path) -> tuple[list[list[str]], str]:
    text = file.read_text()
    separator = "," if file.suffix == ".csv" else " "
    return [line.split(separator) for line in text.splitlines()], separator


def _write_rows(file: Path, rows: list[list[str]], separator: str) -> None:
    file.write_text("".join(separator.join(row) + "\n" for row in rows))


def _drop_column(file: Path, rng: np.random.Generator) -> str:
    rows, separator = _rows(file)
    at = int(rng.integers(max(map(len, rows), default=1)))
    _write_rows(file, [row[:at] + row[at + 1 :] for row in rows], separator)
    return f"column {at} dropped"


def _swap_columns(file: Path, rng: np.random.Generator) -> str:
    rows, separator = _rows(file)
    a, b = rng.integers(max(map(len, rows), default=1), size=2).tolist()
    for row in rows:
        if max(a, b) < len(row) and not row[0].startswith("#"):
            row[a], row[b] = row[b], row[a]
    _write_rows(file, rows, separator)
    return f"columns {a} and {b} swapped"


def _scale_column(file: Path, rng: np.random.Generator) -> str:
    rows, separator = _rows(file)
    at, by = int(rng.integers(max(map(len, rows), default=1))), float(rng.choice([1e3, 1e-3, 1e-6, 57.3, 0.102]))
    for row in rows:
        with contextlib.suppress(ValueError, IndexError):
            row[at] = repr(float(row[at]) * by)
    _write_rows(file, rows, separator)
    return f"column {at} times {by:g}"


def _swap_rows(file: Path, rng: np.random.Generator) -> str:
    rows, separator = _rows(file)
    a, b = rng.integers(len(rows), size=2).tolist() if rows else (0, 0)
    if rows:
        rows[a], rows[b] = rows[b], rows[a]
    _write_rows(file, rows, separator)
    return f"rows {a} and {b} swapped"


def _spoil_word(file: Path, rng: np.random.Generator) -> str:
    rows, separator = _rows(file)
    word = str(rng.choice(["nan", "inf", "-1", "", "zero", "1e999", "²", "0x10", "\0"]))
    if rows:
        row = rows[int(rng.integers(len(rows)))]
        row[int(rng.integers(len(row)))] = word
    _write_rows(file, rows, separator)
    return f"a word became {word!r}"


def _drop_rows(file: Path, rng: np.random.Generator) -> str:
    rows, separator = _rows(file)
    keep = int(rng.integers(len(rows) + 1))
    _write_rows(file, rows[:keep], separator)
    return f"only {keep} of {len(rows)} rows kept"


def _change_table(file: Path, rng: np.random.Generator) -> str:
    with np.load(file) as table:
        arrays: dict[str, Any] = dict(table)
    name = str(rng.choice(list(arrays)))
    change = str(rng.choice(["missing", "scaled", "turned", "text", "nan", "backwards", "short"]))
    if change == "missing":
        del arrays[name]
    elif change == "scaled":
        arrays[name] = arrays[name] * float(rng.choice([1e3, 1e-3, 57.3, 0.102]))
    elif change == "turned":
        arrays[name] = arrays[name].T
    elif change == "text":
        arrays[name] = arrays[name].astype(str)
    elif change == "nan":
        arrays[name].flat[int(rng.integers(arrays[name].size))] = np.nan
    elif change == "backwards":
        arrays[name] = arrays[name][::-1]
    else:
        arrays[name] = arrays[name][: int(rng.integers(len(arrays[name])))]
    np.savez(file, **arrays)
    return f"{name} {change}"


def contents(path: Path, lenient: bool) -> tuple[dict[str, Any], list[str]]:
    """The contents of a source in a comparable form, and the reported problems."""
    recording = open_any(path, lenient)
    read: dict[str, list[Any]] = {}
    for sample in recording.samples():
        read.setdefault(sample.topic, []).append(_numbers(sample))
    said = [*recording.warnings, *map(str, recording.problems), *(f"not read: {t}" for t in recording.unread)]
    calibration = repr((recording.rig.cameras, recording.rig.imus)) if recording.has_rig else ""
    return {**read, "": [np.frombuffer(_without_addresses(calibration).encode(), np.uint8)]}, said


def _without_addresses(text: str) -> str:
    return " ".join(text.split())


def _numbers(sample: Sample) -> Any:
    values = [getattr(sample, name) for name in sample.__dataclass_fields__ if name not in ("topic",)]
    return np.concatenate([np.ravel(np.asarray(v, float)) for v in values if not isinstance(v, (str, tuple))])


def same(a: dict[str, Any], b: dict[str, Any]) -> bool:
    """Whether two sources have equal contents to 1e-12."""
    if a.keys() != b.keys() or any(len(a[k]) != len(b[k]) for k in a):
        return False
    pairs = ((x, y) for k in a for x, y in zip(a[k], b[k]))
    return all(x.shape == y.shape and np.allclose(x, y, rtol=1e-12, atol=1e-12) for x, y in pairs)


@contextlib.contextmanager
def _alarm(seconds: int) -> Iterator[None]:
    def ring(*_: object) -> None:
        raise _HangError

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def tried(path: Path, whole: dict[str, Any], said_before: list[str]) -> tuple[str, str]:
    """Outcome of reading a damaged source, strictly and then leniently, and the messages."""
    outcome, said = "", ""
    for lenient in (False, True):
        try:
            with _alarm(HANG_S), warnings.catch_warnings():
                warnings.simplefilter("error")
                read, texts = contents(path, lenient)
        except StrideTwinError as error:
            message = str(error)
            if not all(str(path) in line for line in message.split("\n")):  # a settings file has a line for each error
                return "traceback", f"an error that does not name the file in every line: {message!r}"
            outcome, said = outcome or "refused", said or message
            continue
        except _HangError:
            return "hang", f"longer than {HANG_S} s"
        except Exception as error:
            return "traceback", f"{type(error).__name__}: {error}"
        new = [w for w in texts if w not in said_before]
        if not outcome:
            outcome = "harmless" if same(read, whole) else "reported" if new else "unnoticed"
            said = "; ".join(new)
    return outcome, said


def trials(name: str, count: int, seed: int = 0, write: Callable[[Path, Walk], Path] | None = None) -> list[Trial]:
    """Damages a format's file `count` times; `write` writes that of a format that is not among `FORMATS`."""
    rng = np.random.default_rng([seed, *name.encode()])
    trial_list = []
    with tempfile.TemporaryDirectory() as folder:
        original = (write or FORMATS[name])(Path(folder), Walk())
        broken = Path(folder) / "broken" / original.name
        broken.parent.mkdir()
        shutil.copytree(original, broken) if original.is_dir() else shutil.copy(original, broken)
        whole, said = contents(broken, False)
        for _ in range(count):
            shutil.rmtree(broken.parent)
            broken.parent.mkdir()
            shutil.copytree(original, broken) if original.is_dir() else shutil.copy(original, broken)
            what = mutated(broken, rng)
            trial_list.append(Trial(what, *tried(broken, whole, said)))
    return trial_list


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=PER_FORMAT, help="mutations of every format")
    parser.add_argument("--formats", nargs="+", choices=list(FORMATS), default=list(FORMATS))
    parser.add_argument("--show", choices=OUTCOMES, nargs="+", default=["traceback", "hang"], help="trials to list")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    options = parser.parse_args()
    summary: dict[str, dict[str, float]] = {}
    for name in options.formats:
        start = time.perf_counter()
        trial_list = trials(name, options.count)
        counts = Counter(t.outcome for t in trial_list)
        summary[name] = {o: counts[o] for o in OUTCOMES} | {"time_s": round(time.perf_counter() - start, 1)}
        if not options.json:
            print(f"{name:<16}" + "".join(f"{o} {summary[name][o]:<6}" for o in (*OUTCOMES, "time_s")), flush=True)
            for trial in trial_list:
                if trial.outcome in options.show:
                    print(f"  {trial.outcome}: {trial.mutation}: {trial.said}"[:400])
    if options.json:
        print(json.dumps({"benchmark": "broken_files", "summary": summary}))


if __name__ == "__main__":
    main()
