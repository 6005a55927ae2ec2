"""Digests of the sources that a figure comes from: what changes them, and what does not."""

from __future__ import annotations

from pathlib import Path

import pytest

from stridetwin.batch import versions
from stridetwin.batch.versions import digest

GENERALITY = "stridetwin.studies.zhao2023.mode_walks"


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A copy of the sources, which may be changed; a function that adds a line to one of them."""
    for package in (
        "streams",
        "sim",
        "assets",
        "estimators",
        "scenarios",
        "outputs",
        "run",
        "gate",
        "pages",
        "reference",
        "report",
        "studies",
        "cli",
    ):
        real = versions._package_folder(f"stridetwin.{package}")
        for file in real.rglob("*"):
            if file.is_file() and "__pycache__" not in file.parts:
                copy = tmp_path / package / file.relative_to(real)
                copy.parent.mkdir(parents=True, exist_ok=True)
                copy.write_bytes(file.read_bytes())
    monkeypatch.setattr(versions, "_package_folder", lambda package: tmp_path / package.split(".")[1])

    def touch(place: str) -> None:
        with (tmp_path / place).open("a", encoding="utf-8") as file:
            file.write("\n# changed\n")

    return touch


def test_what_makes_the_figure_changes_the_digest(copied) -> None:
    seen = {digest(GENERALITY)}
    for place in (
        "streams/samples.py",
        "sim/gait/posture.py",
        "sim/parts/D455.yaml",
        "scenarios/catalogue/zhao_stair_15cm.yaml",
        "estimators/dvio/optimiser.py",
        "estimators/locomotion_mode/rollout.py",
        "outputs/modes/scores.py",
        "outputs/modes/approaches.py",
        "scenarios/record.py",
        "studies/zhao2023/mode_walks.py",
        "studies/design.py",
    ):
        copied(place)
        seen.add(digest(GENERALITY))
    assert len(seen) == 12


def test_pages_tables_and_other_experiments_do_not(copied) -> None:
    before = digest(GENERALITY)
    for place in (
        "report/run_report.py",
        "cli/main.py",
        "studies/registry.py",
        "studies/zhao2023/mode_results.py",
        "studies/zhao2023/zhao_closed_loop.py",
        "studies/shim2019/shim_table5.py",
        "estimators/foot_to_foot/filter.py",
    ):
        copied(place)
    assert digest(GENERALITY) == before


def test_a_walk_is_as_it_was_whatever_the_estimators_do(copied) -> None:
    before = digest(GENERALITY, estimators=False)
    copied("estimators/dvio/optimiser.py")
    assert digest(GENERALITY, estimators=False) == before
    copied("sim/twin.py")
    assert digest(GENERALITY, estimators=False) != before


def test_another_version_of_a_library_is_another_version(monkeypatch) -> None:
    before = digest(GENERALITY)
    real = versions.metadata.version
    monkeypatch.setattr(versions.metadata, "version", lambda name: real(name) + ".1" if name == "scipy" else real(name))
    versions._library_versions.cache_clear()
    assert digest(GENERALITY) != before
    monkeypatch.undo()
    versions._library_versions.cache_clear()
    assert digest(GENERALITY) == before


def test_a_module_elsewhere_is_no_source() -> None:
    assert versions._find_imports("test_versions") == {}
    assert versions._find_imports("stridetwin.sim.twin") == {}  # counts as a whole, with all else there
    assert all(isinstance(file, Path) for file in versions._find_imports(GENERALITY).values())
