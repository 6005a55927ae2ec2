"""What an estimator is shown before the first true sample: enough that nothing is left to compile."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from stridetwin.run.live_chain import Chain, Request
from stridetwin.run.warm_up import synthetic_rig, synthetic_samples
from stridetwin.scenarios.record import record
from stridetwin.sim.config import Gait, Level, Route, TwinConfig
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.twin import Twin


def last_rows(estimator):
    """The last row of each estimator of a chain."""
    chain, rows = Chain(Request(estimator=estimator), synthetic_rig(), {}), {}
    for sample in synthetic_samples(chain.takes):
        rows |= {name: row for name, row in chain.update(sample) if row}
    return rows


def test_a_stationary_wearer_stays_in_place():
    for name in ("foot_ins", "dvio"):
        row = np.array(last_rows(name)[name].split(), float)
        assert row[0] == pytest.approx(6.0)
        assert np.abs(row[1:4]).max() < 1e-4


def test_the_shoes_see_each_other():
    foot, *row = last_rows("foot_to_foot")["foot_to_foot"].split()
    # Without a board in view the right shoe would stay where it is guessed, at (0, -0.1).
    assert foot == "r"
    assert 0.01 < float(row[1]) < 0.03


def test_the_stair_ahead_is_found():
    cells = last_rows("locomotion_mode")["locomotion_mode"].split(",")
    at = cells.index("SA")
    distance, riser, tread = (float(cells[at + i]) for i in (1, 4, 6))
    assert abs(distance - 1.5) < 0.02
    assert abs(riser - 0.17) < 0.003
    assert abs(tread - 0.3) < 0.005


LEFT_TO_COMPILE = """
import gc, json, sys
from numba.core.dispatcher import Dispatcher
from stridetwin.run.live_chain import Chain, Request
from stridetwin.run.warm_up import synthetic_rig, synthetic_samples
from stridetwin.streams.live.messages import MessageDecoder, to_messages
from stridetwin.streams.recording.reader import Recording

def compiled():
    found = [d for d in gc.get_objects() if isinstance(d, Dispatcher)]
    return {f"{d.py_func.__module__}.{d.py_func.__name__}": len(d.signatures) for d in found}

def show(chain, samples):
    for sample in samples:
        for _ in chain.update(sample):
            pass

def read(recording, topics):
    decoders = {}
    for message in to_messages(recording, topics):
        decoder = decoders.setdefault(message.topic, MessageDecoder(message.topic, message.typename))
        yield decoder.decode(message)

recording, asked = Recording(sys.argv[1]), Request(estimator=sys.argv[2])
chain = Chain(asked, synthetic_rig(), recording.metadata)
show(chain, synthetic_samples(chain.takes))
before = compiled()
chain = Chain(asked, recording.rig, recording.metadata)
show(chain, read(recording, list(chain.takes)))
after = compiled()
print(json.dumps([sum(after.values()), sorted(k for k, n in after.items() if n != before.get(k, 0))]))
"""


def left_to_compile(recording, estimator):
    command = [sys.executable, "-c", LEFT_TO_COMPILE, str(recording), estimator]
    kernels, left = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert kernels > 0
    return left


@pytest.mark.parametrize("estimator", ["foot_ins", "contact_terrain", "locomotion_mode"])
def test_nothing_is_left_to_compile(seen, estimator):
    assert left_to_compile(seen, estimator) == []


def test_nothing_is_left_to_compile_of_shoes_that_see_each_other(tmp_path):
    config = TwinConfig(
        name="shoes",
        route=Route(segments=(Level(length_m=0.5),)),
        gait=Gait(stand_s=0.5),
        sensors=("foot_imu", "foot_camera", "sonar"),
        fittings={"foot_camera": SensorConfig(rate_hz=15.0)},
    )
    record(Twin(config, 5), tmp_path / "walk.mcap", lambda *_: None)
    assert left_to_compile(tmp_path / "walk.mcap", "foot_to_foot") == []
