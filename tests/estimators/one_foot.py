"""Samples and parameters for one foot's filter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stridetwin.estimators.foot_ins import delay
from stridetwin.estimators.foot_ins.parameters import KernelParameters
from stridetwin.estimators.foot_ins.state import NOMINAL, FilterState
from stridetwin.streams.samples import Array


def with_values(parameters: KernelParameters, **values: float) -> KernelParameters:
    """A copy of a kernel's parameters with other values, also of those that only a calibration determines."""
    record = parameters.copy()
    for name, value in values.items():
        record[name] = value
    return record


def take(
    memory: FilterState, parameters: KernelParameters, t_ns: int | NDArray[np.int64], rate: Array, force: Array
) -> int:
    """Lets a filter take one sample or (N,) of them, (N, 3) rad/s and m/s²; returns the phase of the last."""
    stamps = np.atleast_1d(np.asarray(t_ns, np.int64))
    n = len(stamps)
    phase, speed, state, covariance = np.empty(n, np.int8), np.empty(n), np.empty((n, NOMINAL)), np.empty((n, 6, 6))
    delay.run(
        memory,
        delay.initial_bank(force_later_s=0.0),
        parameters,
        stamps,
        np.reshape(rate, (n, 3)),
        np.reshape(force, (n, 3)),
        phase,
        speed,
        state,
        covariance,
    )
    return int(phase[-1])
