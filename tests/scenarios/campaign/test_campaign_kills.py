"""Campaigns that are killed; the full count is `python -m benchmarks.campaign_kills`."""

import sys

import pytest

pytest.importorskip("mujoco")


@pytest.mark.skipif(sys.platform == "win32", reason="needs fork")
def test_killed_campaigns_lose_no_walk_and_leave_no_half_file():
    from benchmarks.campaign_kills import measure_kills

    assert measure_kills(kills=2, walks=2, seed=1)["kills"] == 2  # asserts for every kill what it left
