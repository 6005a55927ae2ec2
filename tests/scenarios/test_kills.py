"""`generate` killed at random times; the full count is `python -m benchmarks.kills`."""

import sys

import pytest

pytest.importorskip("mujoco")


@pytest.mark.skipif(sys.platform == "win32", reason="needs fork")
def test_a_killed_walk_reads_up_to_its_last_chunk_and_a_rerun_completes():
    from benchmarks.kills import measure

    outcome = measure(kills=2, seed=3)  # asserts for every kill what it left
    assert outcome["kills"] == 2
    assert outcome["chunks"] > 2
