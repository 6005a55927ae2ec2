"""Speed benchmarks: latency of queued samples, and the command line."""

from __future__ import annotations

import json
import runpy
import sys

import numpy as np
import pytest

from benchmarks.speed.estimators import latency


def test_latency_is_processing_time_and_waiting_time():
    rng = np.random.default_rng(5)
    arrived, spent = np.cumsum(rng.exponential(1.0, 200)), rng.exponential(0.9, 200)
    free, late = 0.0, []
    for at, time in zip(arrived, spent):
        free = max(free, at) + time
        late.append(free - at)
    assert latency(arrived, spent) == pytest.approx(late)
    assert max(late) > 2.0 * spent.max()


def test_a_benchmark_prints_its_figures_as_json(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["speed", "recording", "--seconds", "2", "--json"])
    with pytest.raises(SystemExit) as end:
        runpy.run_module("benchmarks.speed", run_name="__main__")
    assert end.value.code == 0
    result = json.loads(capsys.readouterr().out)
    assert result["experiment"] == "recording_speed"
    (figures,) = result["summary"].values()
    assert figures["messages"] == 2 * 25 * 200
    assert min(figures.values()) > 0.0
