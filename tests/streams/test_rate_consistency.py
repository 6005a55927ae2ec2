"""Angular rates that contradict the forces are noticed, with the cause; sound ones never are."""

import numpy as np
import pytest

from benchmarks.real_walks import data_folder, load_loop, load_markers, load_stairs, load_vicon
from stridetwin.streams.rate_consistency import find_rate_fault
from tests.streams.foot_imu import simulate_foot
from tests.streams.rate_mistakes import RATE_MISTAKES


def fault_of(factor: np.ndarray, seed: int = 0) -> str:
    """The cause that is found for rates that are multiplied by a factor (3, 3); "" without a fault."""
    t, force, rate = simulate_foot(seed)
    fault = find_rate_fault(np.rint(t * 1e9).astype(np.int64), force, rate @ np.asarray(factor).T)
    return "" if fault is None else fault.cause


@pytest.mark.parametrize("seed", range(5))
def test_sound_rates_are_no_fault(seed):
    assert fault_of(np.eye(3), seed) == ""


@pytest.mark.parametrize("scale", [0.97, 1.03])
def test_an_uncalibrated_scale_is_no_fault(scale):
    assert fault_of(scale * np.eye(3)) == ""


@pytest.mark.parametrize(("factor", "cause"), RATE_MISTAKES)
def test_the_cause_is_named(factor, cause):
    assert fault_of(factor) == cause


def test_a_clock_of_its_own_is_named():
    t, force, rate = simulate_foot()
    late = np.column_stack([np.interp(t - 0.1, t, rate[:, k]) for k in range(3)])
    fault = find_rate_fault(np.rint(t * 1e9).astype(np.int64), force, late)
    assert fault is not None
    assert fault.cause == "the rates belong 100 ms earlier than they are stamped"


def test_a_sensor_that_never_rests_is_not_judged():
    t = np.arange(0.0, 20.0, 0.01)
    force = np.column_stack([np.sin(9 * t), 2 * np.cos(7 * t), 9.8 + 2 * np.sin(11 * t)])
    rate = np.column_stack([np.cos(9 * t), np.sin(5 * t), np.cos(3 * t)])
    assert find_rate_fault(np.rint(t * 1e9).astype(np.int64), force, 57.3 * rate) is None


@pytest.mark.skipif(data_folder() is None, reason="needs recordings in STRIDETWIN_DATA or ../shared/data")
def test_real_feet_are_sound_and_their_faults_are_noticed():
    folder = data_folder()
    assert folder is not None
    blocks = [walk.imu for walk in [*load_vicon(folder), *load_markers(folder)]]
    blocks += [load_loop(folder), *load_stairs(folder).values()]
    noticed = 0
    for block in blocks:
        force, rate = block.columns["specific_force"], block.columns["angular_rate"]
        assert find_rate_fault(block.t_ns, force, rate) is None
        fault = find_rate_fault(block.t_ns, force, rate[:, [1, 0, 2]])
        noticed += fault is not None and fault.cause == "the axes x, y, z of the forces are y, x, z of the rates"
    assert noticed >= 0.6 * len(blocks)  # the others hardly turn, or run: their rests are too short to judge
