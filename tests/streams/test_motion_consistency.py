"""Rates that contradict the forces of a sensor that never rests are noticed, with the cause; sound ones never are."""

import numpy as np
import pytest

from stridetwin.scenarios.check import check_recording
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.imu_table import write_imu_table
from stridetwin.streams.formats.opening import open_any
from stridetwin.streams.motion_consistency import find_motion_fault
from stridetwin.streams.plausible import find_implausible_values
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Imu
from tests.streams.rate_mistakes import DEGREE, RATE_MISTAKES
from tests.streams.worn_imu import simulate_worn


def to_stamps(t):
    return np.rint(t * 1e9).astype(np.int64)


def cause_of(factor, seed=0, tilt_rad=0.4):
    """The cause that is found for rates that are multiplied by a factor (3, 3); "" without a fault."""
    t, force, rate = simulate_worn(seed, tilt_rad=tilt_rad)
    fault = find_motion_fault(to_stamps(t), force, rate @ np.asarray(factor).T)
    return "" if fault is None else fault.cause


def findings_of(t, force, rate):
    columns = {"specific_force": force, "angular_rate": rate}
    block = Block(topic="/head/imu", kind=Imu, t_ns=to_stamps(t), columns=columns)
    return [str(finding) for finding in find_implausible_values(block)]


@pytest.mark.parametrize("tilt_rad", [0.0, 0.1, 0.4])
@pytest.mark.parametrize("seed", range(3))
def test_sound_rates_are_no_fault(seed, tilt_rad):
    t, force, rate = simulate_worn(seed, tilt_rad=tilt_rad)
    assert findings_of(t, force, rate) == []


def test_an_uncalibrated_sensor_is_no_fault():
    t, force, rate = simulate_worn(1)
    bias = np.array([3.0, -2.0, 2.0]) * DEGREE
    assert find_motion_fault(to_stamps(t), 1.02 * force, 0.97 * rate + bias) is None


@pytest.mark.parametrize(("factor", "cause"), RATE_MISTAKES)
def test_the_cause_is_named(factor, cause):
    assert cause_of(factor) == cause


def test_a_head_that_keeps_level_still_shows_degrees():
    assert cause_of(np.eye(3) / DEGREE, tilt_rad=0.0) == "the rates are in °/s"


def test_a_mistake_that_turns_no_gravity_is_not_claimed():
    # with its axis upright and a level walk, a mirrored or small rate about the vertical leaves the forces alone
    t, force, rate = simulate_worn(0, tilt_rad=0.0)
    for factor in (DEGREE, 0.5, 2.0, -1.0):
        assert find_motion_fault(to_stamps(t), force, factor * rate) is None


def test_a_walk_in_circles_is_no_fault():
    t = np.arange(0.0, 60.0, 0.01)
    rate = np.tile([0.0, 0.0, 0.8], (len(t), 1))
    force = np.tile([0.0, 1.3 * 0.8, 9.81], (len(t), 1)) + np.random.default_rng(0).normal(0, 0.05, (len(t), 3))
    assert find_motion_fault(to_stamps(t), force, rate) is None


def test_a_clock_of_its_own_is_named():
    t, force, rate = simulate_worn(2)
    late = np.column_stack([np.interp(t - 0.5, t, rate[:, k]) for k in range(3)])
    fault = find_motion_fault(to_stamps(t), force, late)
    assert fault is not None
    assert fault.cause == "the rates belong 500 ms earlier than they are stamped"


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda f: f / 9.80665, "is it in g?"),
        (lambda f: 1000 * f, "is it in mg or mm/s², and was taken for g or m/s²?"),
        (lambda f: 1.4 * f, "were the forces multiplied by 1.4"),
        (lambda f: f - np.array([0.0, 0.0, 9.81]), "has gravity been taken out?"),
    ],
)
def test_forces_of_another_unit_are_named(change, text):
    t, force, rate = simulate_worn(3, tilt_rad=0.0)
    upright = force @ _turn_to_z(force.mean(axis=0)).T
    findings = findings_of(t, change(upright), rate @ _turn_to_z(force.mean(axis=0)).T)
    assert len(findings) == 1
    assert findings[0].startswith("accel: ")
    assert text in findings[0]


def _turn_to_z(direction):
    """Rotation (3, 3) that turns a direction (3,) to z."""
    from scipy.spatial.transform import Rotation

    return Rotation.align_vectors([[0.0, 0.0, 1.0]], [direction])[0].as_matrix()


def test_import_and_check_both_report(tmp_path):
    t, force, rate = simulate_worn(0, 40.0)
    swapped = Block(
        topic="/head/imu",
        kind=Imu,
        t_ns=to_stamps(t),
        columns={"specific_force": force, "angular_rate": rate[:, [1, 0, 2]]},
    )
    cause = "the axes x, y, z of the forces are y, x, z of the rates"
    write_imu_table(tmp_path / "head.csv", swapped)
    with pytest.raises(StrideTwinError, match=cause):
        open_any(tmp_path / "head.csv")
    with RecordingWriter(tmp_path / "head.mcap", Rig()) as writer:
        writer.write(swapped)
    findings = check_recording(Recording(tmp_path / "head.mcap", lenient=True)).findings
    assert any(cause in finding.what and finding.is_error for finding in findings)


def test_lost_rows_are_a_warning_of_import_and_check(tmp_path):
    t, force, rate = simulate_worn(0, 40.0, 0.1)
    kept = np.random.default_rng(1).random(len(t)) > 0.1
    columns = {"specific_force": force[kept], "angular_rate": rate[kept]}
    write_imu_table(
        tmp_path / "head.csv", Block(topic="/head/imu", kind=Imu, t_ns=to_stamps(t[: kept.sum()]), columns=columns)
    )
    recording = open_any(tmp_path / "head.csv")
    assert sum("as if rows were missing" in warning for warning in recording.warnings) == 1
    findings = check_recording(recording).findings
    assert [f.is_error for f in findings if "as if rows were missing" in f.what] == [False]
