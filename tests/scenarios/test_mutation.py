"""The benchmark of inserted bugs: what it inserts, in which order, and that tests find it."""

from __future__ import annotations

import ast
import itertools
import json
import re
import subprocess
from argparse import Namespace

import pytest

from benchmarks import mutation
from benchmarks.mutants import is_change, mutants
from stridetwin.streams.errors import StrideTwinError

SOURCE = '''"""Half the sum of three numbers: 1 + 2."""

from __future__ import annotations


def half(a: float, b: float, /, c: float = 1.0) -> float:
    """Half of a sum - no more."""
    if a < 0 and b < 0:
        raise ValueError(f"{a + 1}")
    total = a + b - c
    total *= 0.5
    return -total if total > 1e9 else min(total, 1e6)
'''
TEST = """
from half import half


def test_half():
    assert half(3.0, 2.0) == 2.0
"""


def test_a_bug_is_one_change_of_what_is_computed():
    found = [m for m in mutants(SOURCE) if is_change(SOURCE, m)]
    changes = {(m.before, m.after) for m in found}
    assert {
        ("a + b", "(a - b)"),
        ("a + b", "(a)"),
        ("a < 0", "(a <= 0)"),
        ("0.5", "1.0"),
        ("-total", "(total)"),
    } <= changes
    assert {("total *= 0.5", "total /= 0.5"), ("min(total, 1e6)", "(max(total, 1000000.0))")} <= changes
    assert {m.kind for m in found} >= {
        "operator",
        "dropped term",
        "comparison",
        "constant",
        "sign",
        "order",
        "condition",
    }
    for m in found:
        changed = m.applied(SOURCE)
        assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(SOURCE))
        assert ast.get_docstring(ast.parse(changed)) == ast.get_docstring(ast.parse(SOURCE))
        assert changed.splitlines()[m.line - 1] != SOURCE.splitlines()[m.line - 1]
        assert '    raise ValueError(f"{a + 1}")' in changed
    assert len(set(found)) == len(found) > 15


@pytest.mark.parametrize(
    ("line", "order_counts"),
    [
        ("abs(a - b)", False),
        ("(a - b) ** 2", False),
        ("np.linalg.norm(a - b, axis=1)", False),
        ("np.hypot(a, b)", False),
        ("dot(a, b)", False),
        ("a - b", True),
        ("(a - b) ** 3", True),
        ("np.cross(a, b)", True),
        ("np.dot(a, b)", True),
        ("abs(f(a - b))", True),
    ],
)
def test_an_order_without_effect_is_no_change(line, order_counts):
    orders = [m for m in mutants(f"x = {line}\n") if m.kind == "order" and "norm" not in m.before[:15]]
    assert [is_change(f"x = {line}\n", m) for m in orders] == [order_counts] * len(orders) != []


def test_every_equivalent_change_is_one_of_the_sources():
    for file, before, _ in mutation.EQUIVALENT:
        source = (mutation.ROOT / file).read_text(encoding="utf-8")
        lines = {source[: m.start()].count("\n") + 1 for m in re.finditer(re.escape(before), source)}
        changes = [m for m in mutants(source) if m.line in lines and is_change(source, m)]
        assert sum(mutation.is_equivalent(file, source, m) for m in changes) == len(lines) > 0, (file, before)


def test_text_beyond_ascii_moves_no_change():
    source = 'x = "°µ", 1 + 2\n'
    assert 'x = "°µ", (1 - 2)\n' in [m.applied(source) for m in mutants(source)]


def test_the_seed_determines_the_sample():
    scopes = ("estimators/foot_ins", "gate", "sim/truth.py")
    first, again, other = (list(itertools.islice(mutation.sample(seed, scopes), 30)) for seed in (1, 1, 2))
    assert first == again != other
    assert len({bug.key for bug in first}) == 30
    for bug in first:
        assert all((mutation.ROOT / test).exists() for test in mutation.nearest(bug.file))


def test_every_module_has_tests_and_others_have_none():
    for scope in mutation.SCOPES:
        assert mutation.nearest(scope)
    assert mutation.nearest("estimators/foot_ins/kernel.py") == mutation.NEAREST["estimators/foot_ins"]
    assert mutation.nearest("estimators/base.py") == mutation.NEAREST["estimators"]
    with pytest.raises(StrideTwinError, match=r"cli/main\.py: no tests are known"):
        mutation.nearest("cli/main.py")


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """A repository of one function and one test, as that of the benchmark."""
    root = tmp_path / "repository"
    root.mkdir()
    (root / "half.py").write_text(SOURCE)
    (root / "test_half.py").write_text(TEST)
    subprocess.run(["git", "init", "-q"], cwd=root, check=True)
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # they take longer to load than the test runs
    monkeypatch.setenv("PYTEST_PLUGINS", "xdist.plugin")
    for name, value in (("SCOPES", ("half.py",)), ("NEAREST", {"half.py": ("test_half.py",)}), ("ROOT", root)):
        monkeypatch.setattr(mutation, name, value)
    return root


def request(path, **changes):
    return Namespace(**{"count": 2, "seed": 4, "only": None, "timeout": 60.0, "output": path} | changes)


def test_bugs_are_found_recorded_and_continued(repository, tmp_path, capsys):
    path = tmp_path / "rows.jsonl"
    first = mutation.measure(request(path))
    assert first["bugs"] == 2 == first["found"] + first["survived"] + first["timeout"]
    with path.open("a") as file:
        file.write('{"file": "half.py", "sta')  # interrupted
    more = mutation.measure(request(path, count=3))
    assert more["rows"][:2] == first["rows"]
    assert [json.loads(line) for line in path.read_text().splitlines()] == more["rows"]
    assert capsys.readouterr().err.count("half.py:") == 3
    for row in more["rows"]:
        assert (row["outcome"] == "found") is (row["test"] == "test_half.py::test_half")
    assert (repository / "half.py").read_text() == SOURCE


def test_a_bug_that_matters_is_found_and_one_that_does_not_survives(repository, tmp_path):
    copy = mutation.Copy(tmp_path / "copy", repository)
    by_change = {(m.before, m.after): m for m in mutants(SOURCE)}
    for change, outcome in ((("a + b", "(a - b)"), "found"), (("a < 0", "(a <= 0)"), "survived")):
        row = copy.outcome(mutation.Bug(file="half.py", mutant=by_change[change]), 60.0)
        assert (row["outcome"], row["before"], row["after"]) == (outcome, *change)
    assert (copy.folder / "half.py").read_text() == SOURCE


def test_an_endless_loop_is_a_timeout(repository, tmp_path):
    copy = mutation.Copy(tmp_path / "copy", repository)
    (copy.folder / "test_half.py").write_text("def test_half():\n    while True:\n        pass\n")
    assert copy.failing(("test_half.py",), 2.0) == ("timeout", "")


def test_tests_that_fail_without_a_bug_are_refused(repository, tmp_path):
    (repository / "test_half.py").write_text(TEST.replace("2.0\n", "3.0\n"))
    with pytest.raises(StrideTwinError, match=r"test_half\.py::test_half: found without a bug"):
        mutation.measure(request(tmp_path / "rows.jsonl"))
