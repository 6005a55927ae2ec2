"""Rows that repeat the one before, that are zero, or that are missing are noticed; sound streams have none."""

import numpy as np
import pytest

from stridetwin.streams.plausible import find_implausible_values
from stridetwin.streams.row_patterns import count_jumps, find_frozen, find_lacking
from stridetwin.streams.samples import Block, Imu
from tests.streams.foot_imu import simulate_foot
from tests.streams.worn_imu import simulate_worn

SENSORS = {"foot": simulate_foot, "worn": lambda: simulate_worn(0, 40.0, 0.1)}


def to_stamps(t):
    return np.rint(t * 1e9).astype(np.int64)


def to_block(t, force, rate):
    return Block(topic="/imu", kind=Imu, t_ns=to_stamps(t), columns={"specific_force": force, "angular_rate": rate})


@pytest.fixture(params=SENSORS)
def samples(request):
    return SENSORS[request.param]()


def test_a_sound_stream_has_neither(samples):
    t, force, rate = samples
    assert not find_frozen(to_block(t, force, rate).columns).any()
    assert not find_lacking(to_block(t, force, rate).columns)
    assert count_jumps(to_stamps(t), force, rate) == 0


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_a_coarse_sensor_at_rest_has_neither(noise):
    t, force, rate = simulate_foot(noise=noise)
    assert not find_frozen(to_block(t, force, rate).columns).any()
    coarse = to_block(t, np.round(force / 0.2) * 0.2, np.round(rate / 0.02) * 0.02)
    assert not find_frozen(coarse.columns).any()
    assert not find_lacking(coarse.columns)


@pytest.mark.parametrize("quantity", ["angular_rate", "specific_force"])
def test_two_rows_of_three_equal_numbers_are_chance_even_in_a_table_of_one_quantity(quantity):
    _, force, rate = simulate_foot()
    values = {"angular_rate": rate, "specific_force": force}[quantity]
    moving = np.flatnonzero(np.abs(rate).max(axis=1) > 1.0)[[50, 200]]
    values[moving] = 0.0
    assert not find_lacking({quantity: values})
    values[np.flatnonzero(np.abs(rate).max(axis=1) > 1.0)[50:300:10]] = 0.0
    assert quantity in find_lacking({quantity: values})


@pytest.mark.parametrize("length", [1, 4, 30])
def test_repeated_rows_are_noticed(samples, length):
    t, force, rate = samples
    begins = np.flatnonzero(np.abs(rate).max(axis=1) > 0.3)[20::60]
    is_frozen = np.zeros(len(t), bool)
    for begin in begins:
        force[begin + 1 : begin + 1 + length], rate[begin + 1 : begin + 1 + length] = force[begin], rate[begin]
        is_frozen[begin + 1 : begin + 1 + length] = True
    noticed = find_frozen(to_block(t, force, rate).columns)
    assert not (noticed & ~is_frozen).any()
    assert noticed.sum() >= 0.5 * is_frozen.sum()


def test_zero_rows_of_a_packet_are_noticed_in_both_quantities(samples):
    t, force, rate = samples
    for begin in range(100, len(t) - 50, 100):
        force[begin : begin + 12] = rate[begin : begin + 12] = 0.0
    lacking = find_lacking(to_block(t, force, rate).columns)
    assert [int(flags.sum()) for flags in lacking.values()] == [12 * len(range(100, len(t) - 50, 100))] * 2


@pytest.mark.parametrize(("share", "burst"), [(0.05, 1), (0.05, 3)])
def test_lost_rows_on_even_stamps_are_noticed(share, burst):
    t, force, rate = simulate_worn(0, 60.0, 0.1)
    kept = np.ones(len(t), bool)
    for begin in np.flatnonzero(np.random.default_rng(1).random(len(t)) < share / burst):
        kept[begin : begin + burst] = False
    assert count_jumps(to_stamps(t[: kept.sum()]), force[kept], rate[kept]) >= 5
    assert count_jumps(to_stamps(t[kept]), force[kept], rate[kept]) == 0  # the stamps show them


def test_findings_say_whether_an_estimate_suffers():
    t, force, rate = simulate_worn(0, 40.0, 0.1)
    few = to_block(t, force.copy(), rate.copy())
    few.columns["angular_rate"][1000:1003] = 0.0
    (finding,) = find_implausible_values(few)
    assert not finding.is_error
    assert "3 of 4000 rows" in str(finding)
    many = to_block(t, force.copy(), rate.copy())
    many.columns["angular_rate"][::5] = 0.0
    assert any(finding.is_error for finding in find_implausible_values(many))
