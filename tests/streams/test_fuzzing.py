"""The fuzzer of the readers: what is a finding, how inputs are changed, and a few changed inputs of each kind."""

import random
import time
import warnings
from argparse import Namespace

import numpy as np
import pytest

from benchmarks.fuzz_judge import (
    LEAST_BYTES,
    LEAST_S,
    Cost,
    Limits,
    can_measure_growth,
    judge,
    measure_limits,
    minimise,
)
from benchmarks.fuzz_mutators import cross, mutate, pack, unpack, write_members
from benchmarks.fuzz_targets import TARGETS, Target, list_words
from benchmarks.fuzzing import fuzz_targets
from stridetwin.streams.errors import StrideTwinError

INPUTS = 12
"""Changed inputs of each kind that a test opens."""


def arguments(tmp_path, **options):
    values = {"only": None, "seconds": 6.0, "corpus": None, "replay": None, "findings": tmp_path / "findings"}
    return Namespace(**{**values, **options})


def flip(rng):
    """Changes one byte, as the library's mutators may."""

    def change(data):
        i = rng.randrange(len(data) + 1)
        return data[:i] + bytes([rng.randrange(256)]) + data[i + 1 :]

    return change


@pytest.mark.parametrize("name", list(TARGETS))
def test_changed_inputs_of_each_kind_are_no_surprise(tmp_path, name):
    target, rng, words = TARGETS[name], random.Random(4), list_words()
    (tmp_path / "seeds").mkdir()
    seeds = [members for _, members in target.list_seeds(tmp_path / "seeds")]
    assert len(seeds) > 5
    for members in [rng.choice(seeds) for _ in range(INPUTS)]:
        changed = mutate(cross(members, rng.choice(seeds), rng), rng, words, flip(rng))
        assert unpack(pack(changed)) == changed
        finding, _ = judge(target, changed, tmp_path, Limits())
        assert finding is None


def refuse(source, members):
    raise StrideTwinError(f"{source}: is refused")


def allocate(source, members):
    return [str(np.ones(240 << 17).sum())]  # 240 MiB: garbage that is collected meanwhile does not hide it


def wait(source, members):
    while True:
        time.process_time()


def warn(source, members):
    warnings.warn("of numpy", RuntimeWarning, stacklevel=1)
    return []


@pytest.mark.parametrize(
    ("open_input", "kind"),
    [
        (refuse, None),
        (lambda source, members: ["a warning"], None),
        (lambda source, members: members["absent"], "traceback"),
        (warn, "traceback"),
        (lambda source, members: ["two\nlines"], "text"),
        (lambda source, members: ["a lone \ud800"], "text"),
        (lambda source, members: ["x" * 5000], "text"),
        (wait, "slow"),
        pytest.param(
            allocate,
            "memory",
            marks=pytest.mark.skipif(not can_measure_growth(), reason="the peak of memory cannot be reset here"),
        ),
    ],
)
def test_what_is_a_finding(tmp_path, open_input, kind):
    target = Target("kind", lambda folder: iter(()), open_input)
    # Memory is slow to come on a busy machine: only the input that never ends is cut short.
    limits = Limits(cpu_s=0.5 if kind == "slow" else 30.0, growth_bytes=20 << 20)
    finding, _ = judge(target, {"a.txt": b"1"}, tmp_path, limits)
    assert (finding.kind if finding else None) == kind
    assert not any(tmp_path.iterdir())


def test_limits_follow_the_seeds():
    assert measure_limits([Cost(0.01, 1000)]) == Limits(LEAST_S, LEAST_BYTES)
    assert measure_limits([Cost(0.01, 0), Cost(0.5, 100 << 20)]) == Limits(5.0, 400 << 20)


def test_a_finding_is_made_small():
    members = {"a.txt": b"\n".join(b"%d" % i for i in range(100)), "b.txt": b"not needed"}
    small = minimise(members, lambda less: b"57" in less.get("a.txt", b""))
    assert small == {"a.txt": b"57"}


def test_names_stay_in_the_folder(tmp_path):
    assert unpack(b'{"../a": 1}\nx') is None
    assert unpack(b'{"a": 2}\nx') is None
    assert unpack(b"[1]\n") is None
    members = {"a": b"1", "a/b": b"2", "--rate": b"100"}  # one of the first two has no place
    assert write_members(tmp_path, members) == tmp_path
    assert [file.name for file in tmp_path.iterdir()] == ["a"]


def test_without_the_library_one_line_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.fuzzing.importlib.util.find_spec", lambda name: None)
    with pytest.raises(StrideTwinError, match=r"^atheris is not installed; fuzzing needs it: pip install atheris==3"):
        fuzz_targets(arguments(tmp_path))


def test_a_short_run_covers_the_reader(tmp_path):
    pytest.importorskip("atheris", reason="the fuzzer's library is no dependency of the project")
    result = fuzz_targets(arguments(tmp_path, only=["trajectory"], corpus=tmp_path / "corpus"))
    figures = result["summary"]["trajectory"]
    assert figures["executions"] > 50
    assert figures["edges"] > 100
    assert result["findings"]["trajectory"] == {}
    assert any((tmp_path / "corpus" / "trajectory").iterdir())


def test_a_saved_input_is_opened_again(tmp_path):
    (place := tmp_path / "trajectory-text-001").mkdir()
    (place / "packed").write_bytes(pack({"path.txt": b"1 2 3\n"}))
    assert fuzz_targets(arguments(tmp_path, replay=place))["replay"].startswith("nothing")
    with pytest.raises(StrideTwinError, match=r"fuzzing: --replay: invalid"):
        fuzz_targets(arguments(tmp_path, replay=tmp_path))
