"""Angular rates that contradict the forces are noticed, with the cause; sound ones never are."""

import numpy as np
import pytest

from benchmarks.real_walks import data_folder, load_loop, load_markers, load_stairs, load_vicon
from stridetwin.streams.rate_consistency import find_rate_fault
from tests.streams.foot_imu import simulate_foot
from tests.streams.rate_mistakes import RATE_MISTAKES


def to_stamps(t):
    """Stamps (N,) ns of times (N,) s."""
    return np.rint(t * 1e9).astype(np.int64)


def fault_of(factor: np.ndarray, seed: int = 0) -> str:
    """The cause that is found for rates that are multiplied by a factor (3, 3); "" without a fault."""
    t, force, rate = simulate_foot(seed)
    fault = find_rate_fault(to_stamps(t), force, rate @ np.asarray(factor).T)
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


@pytest.mark.parametrize("delay_s", [-1.5, -0.3, -0.15, -0.1, 0.1, 0.2, 0.275, 0.7])
def test_a_clock_of_its_own_is_named(delay_s):
    t, force, rate = simulate_foot()
    late = np.column_stack([np.interp(t - delay_s, t, rate[:, k]) for k in range(3)])
    fault = find_rate_fault(to_stamps(t), force, late)
    assert fault is not None
    when = "earlier" if delay_s > 0 else "later"
    assert fault.cause == f"the rates belong {1000 * abs(delay_s):.0f} ms {when} than they are stamped"


@pytest.mark.parametrize(
    ("factor", "axes"),
    [
        (np.eye(3)[[2, 1, 0]], "z, y, x"),
        (np.diag([-1.0, 1.0, 1.0]), "-x, y, z"),
        (np.diag([1.0, 1.0, -1.0]), "x, y, -z"),
    ],
)
def test_axes_that_turn_in_few_strides_are_named(factor, axes):
    t, force, rate = simulate_foot(turning=(5, 6))
    sound = find_rate_fault(to_stamps(t), force, rate)
    assert sound is None
    fault = find_rate_fault(to_stamps(t), force, rate @ factor.T)
    assert fault is not None
    assert fault.cause == f"the axes x, y, z of the forces are {axes} of the rates"


def test_a_single_stride_is_no_proof():
    t, force, rate = simulate_foot(turning=(5,))
    assert find_rate_fault(to_stamps(t), force, rate @ np.diag([1.0, 1.0, -1.0])) is None


def test_clipped_forces_are_no_doubt_about_the_rates():
    t, force, rate = simulate_foot()
    clipped = np.clip(force, -14.0, 14.0)
    assert np.abs(force).max() > 20.0
    assert find_rate_fault(to_stamps(t), clipped, rate) is None


def test_a_sensor_that_never_rests_is_not_judged():
    t = np.arange(0.0, 20.0, 0.01)
    force = np.column_stack([np.sin(9 * t), 2 * np.cos(7 * t), 9.8 + 2 * np.sin(11 * t)])
    rate = np.column_stack([np.cos(9 * t), np.sin(5 * t), np.cos(3 * t)])
    assert find_rate_fault(to_stamps(t), force, 57.3 * rate) is None


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
