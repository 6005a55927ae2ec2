"""What is opened may come from anybody: YAML is loaded safely, nothing unpickled; servers listen on this host alone."""

import ast
from pathlib import Path

import pytest

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.imu_table import read_imu_table
from stridetwin.streams.live.wire import parse_address
from stridetwin.streams.yaml_file import parse_yaml

ROOT = Path(__file__).parents[2]
PARTS = (*sorted(part.name for part in (ROOT / "stridetwin").iterdir() if part.is_dir()), "examples")
SOURCES = [p for part in PARTS for p in (ROOT / part).rglob("*.py")]
PIPES = {
    "sim/rendering/rendering.py",
    "sim/rendering/camera_processes.py",
}  # between the twin and its own rendering processes, never a file
SAFE = {"_StrictLoader"}


def calls(path):
    """(name, node) of every call, such as `yaml.load`."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func), node


def test_there_are_sources():
    assert len(SOURCES) > 300


@pytest.mark.parametrize("part", ["streams", "sim", "estimators", "scenarios", "examples"])
def test_yaml_is_loaded_safely_and_nothing_that_is_opened_is_unpickled_or_run(part):
    for path in SOURCES:
        own = path.relative_to(ROOT).as_posix()
        if not own.startswith(f"{part}/"):
            continue
        for name, node in calls(path):
            where = f"{path}:{node.lineno}"
            assert name not in ("yaml.unsafe_load", "yaml.full_load", "yaml.load_all", "yaml.unsafe_load_all"), where
            if name == "yaml.load":
                loader = ast.unparse(node.args[1] if len(node.args) > 1 else node.keywords[0].value)
                assert loader in SAFE, where
            if name in ("YAML", "ruamel.yaml.YAML"):
                assert "safe" in ast.unparse(node), where
            assert name.split(".")[0] not in ("marshal", "shelve", "dill", "joblib"), where
            assert not (name.startswith(("pickle.load", "pickle.Unpickler")) and own not in PIPES), where
            assert name not in ("eval", "exec", "os.system", "__import__"), where
            if name in ("np.load", "numpy.load"):
                assert any(k.arg == "allow_pickle" and ast.unparse(k.value) == "False" for k in node.keywords), where
            assert not any(k.arg == "allow_pickle" and ast.unparse(k.value) != "False" for k in node.keywords), where
            assert not any(k.arg == "shell" and ast.unparse(k.value) != "False" for k in node.keywords), where


def test_servers_listen_on_this_machine_alone():
    assert parse_address("", "--listen")[0] == "127.0.0.1"
    assert parse_address(":7365", "--listen")[0] == "127.0.0.1"
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        assert "0.0.0.0" not in text.replace("10.0.0.0", ""), path
        assert "INADDR_ANY" not in text, path


def test_a_pickle_in_a_table_stays_one(tmp_path):
    import numpy as np

    class Evil:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "done",))

    np.savez(tmp_path / "a.npz", t=np.array([Evil()], object), accel=np.zeros((1, 3)), gyro=np.zeros((1, 3)))
    with pytest.raises(StrideTwinError, match="cannot be read"):
        read_imu_table(tmp_path / "a.npz")
    assert not (tmp_path / "done").exists()


ALIASES = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 6)
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (ALIASES, "values, 40 levels"),
        ("a: &a [*a]", "values, 40 levels"),
        ("[" * 1000, "levels"),
        ("x" * (2 << 20), "length in characters"),
        ("a: " + "9" * 5000, "not YAML"),
        ("a: !!python/object/apply:os.getcwd []", "not YAML"),
        ("a: [1, 2", "line [12]"),
        ("a: !!bool foo", "not YAML"),
        ("a: !!int ''", "not YAML"),
        ("a: !!timestamp foo", "not YAML"),
        ("a: 1\nb: {c: 2, c: 3}", "line 2: duplicate key 'c'"),
        ("a: {1: 2}", "a: invalid 1: .*keys that are text"),
        ("a: !!binary aGFsbG8=", "a: .*text, numbers"),
        ("[a]: 1", "a key must be text"),
        ('a: "b\\0.yaml"', "line 1: invalid 'b.*text without NUL"),
    ],
)
def test_yaml_that_grows_is_refused(text, said):
    with pytest.raises(StrideTwinError, match=said):
        parse_yaml(text, "file.yaml")


def test_yaml_with_aliases_that_share_a_little_is_read():
    """As PyYAML writes lists that are used twice."""
    assert parse_yaml("a: &x [1, 2]\nb: *x\n", "f") == {"a": [1, 2], "b": [1, 2]}


def test_numbers_with_an_exponent_are_numbers_and_dates_are_text():
    assert parse_yaml("[1e-3, 2.5E+2, .5e1, 2001-99-99, 2001-01-01]", "f") == [
        1e-3,
        250.0,
        5.0,
        "2001-99-99",
        "2001-01-01",
    ]


def test_data_that_aliases_name_are_copies():
    read = parse_yaml("a: &x [1, 2]\nb: *x\n", "f")
    assert read["a"] is not read["b"]
