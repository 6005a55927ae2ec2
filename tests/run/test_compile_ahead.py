"""A second process compiles what estimators will need on a recording, and starts only where something is missing."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import nullcontext
from dataclasses import replace

import pytest

from stridetwin.run import compile_ahead as module
from stridetwin.run.compile_ahead import compile_ahead
from stridetwin.streams.recording.reader import Recording

LEFT_TO_COMPILE = """
import gc, json, sys
from numba.core.dispatcher import Dispatcher
from stridetwin.outputs.feeding import runnable_instances
from stridetwin.estimators import registry
from stridetwin.outputs.registry import kind_of
from stridetwin.run.compile_ahead import compile_estimator
from stridetwin.streams.recording.reader import Recording

def count_signatures():
    kernels = [d for d in gc.get_objects() if isinstance(d, Dispatcher)]
    return {f"{d.py_func.__module__}.{d.py_func.__name__}": len(d.signatures) for d in kernels}

recording, name = Recording(sys.argv[1]), sys.argv[2]
compile_estimator(name, recording.metadata)
before = count_signatures()
estimator_class = registry.estimator(name)
for instance in runnable_instances(estimator_class, recording):
    kind_of(estimator_class.declaration).run(instance, recording)
after = count_signatures()
print(json.dumps([sum(after.values()), sorted(k for k, n in after.items() if n != before.get(k, 0))]))
"""


@pytest.mark.parametrize("estimator", ["foot_ins", "dvio"])
def test_nothing_is_left_to_compile_on_a_recording(seen, estimator):
    command = [sys.executable, "-c", LEFT_TO_COMPILE, str(seen), estimator]
    kernels, left = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert kernels > 0
    assert left == []


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
