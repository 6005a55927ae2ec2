"""The public names: each is importable and on its page, and the page's code runs."""

import re
from pathlib import Path

import stridetwin

PAGE = Path(__file__).parents[2] / "docs" / "api" / "public.md"


def test_every_public_name_is_importable_and_on_the_page():
    words = set(re.findall(r"\w+", PAGE.read_text(encoding="utf-8")))
    assert len(stridetwin.__all__) >= 30
    assert [name for name in stridetwin.__all__ if getattr(stridetwin, name, None) is None] == []
    assert set(stridetwin.__all__) - words == set()


def test_the_code_of_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S):
        exec(compile(block, str(PAGE), "exec"), names)
    table, block = names["table"], names["block"]
    assert list(table.columns[:3]) == [f"{next(iter(block.columns))}_{axis}" for axis in "xyz"]
    assert table.shape == (len(block), sum(c.reshape(len(block), -1).shape[1] for c in block.columns.values()))
    assert names["estimate"].pose.p_frame_in_world.shape == (3,)
    assert {p.name for p in names["paths"]} >= {"foot_ins_l", "foot_ins_r"}
    assert 0 < names["end_error_m"] < 1
    assert Path("path.txt").read_text().count("\n") == len(names["paths"][0].path)
