"""Processes beside this one, of which one dies."""

import os

import pytest

from stridetwin.scenarios.processes import mapped
from stridetwin.streams.errors import StrideTwinError


def test_results_come_in_the_order_of_the_jobs():
    assert list(mapped(abs, [-3, 2, -1], 2)) == [3, 2, 1]


def test_a_worker_that_dies_is_an_error_in_one_line():
    with pytest.raises(StrideTwinError, match="a worker died before it was done; does memory suffice for 2 at a time"):
        list(mapped(os._exit, [7, 7], 2))
