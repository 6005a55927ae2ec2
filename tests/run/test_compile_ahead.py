"""A second process compiles what estimators will need on a recording, and starts only where something is missing."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import pytest

from stridetwin.run import compile_ahead as module
from stridetwin.run.compile_ahead import compile_ahead
from stridetwin.streams.recording.reader import Recording


@pytest.fixture
def compiled_names(seen, monkeypatch):
    """Function of a rig and a selection: names of the estimators that are compiled where the cache is empty."""

    def compile_and_list(rig, only=None):
        names = []

        def run_beside(function, uncompiled, metadata):
            names.extend(uncompiled)
            return nullcontext()

        monkeypatch.setattr(module, "run_beside", run_beside)
        monkeypatch.setattr(module, "is_uncompiled", lambda package: True)
        with compile_ahead(rig, Recording(seen).metadata, only):
            pass
        return set(names)

    return compile_and_list


def test_only_what_the_sensors_feed_and_the_user_asks_for_is_compiled(seen, compiled_names):
    rig = Recording(seen).rig
    of_cameras = {"dvio", "terrain_map", "locomotion_mode"}
    assert {"foot_ins", *of_cameras} <= compiled_names(rig)
    assert "foot_ins" in compiled_names(replace(rig, cameras={}))
    assert not of_cameras & compiled_names(replace(rig, cameras={}))
    assert compiled_names(rig, {"foot_ins"}) == {"foot_ins"}
    assert compiled_names(rig, {"foot_ins_l"}) == set()


def test_no_process_starts_where_everything_is_cached(seen, monkeypatch):
    recording = Recording(seen)
    monkeypatch.setattr(module, "is_uncompiled", lambda package: False)
    monkeypatch.setattr(module, "run_beside", lambda *_: pytest.fail("a process started"))
    with compile_ahead(recording.rig, recording.metadata):
        pass
