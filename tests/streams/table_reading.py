"""How tests read tables of IMUs: as a user opens them, against the samples that were put in, or for a refusal."""

import numpy as np
import pytest
from logger_files import FORCE, GYRO

from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.formats.imu_text import TableRequest
from stridetwin.streams.formats.opening import ImportOptions, open_any


def read(path, topic="/foot_l/imu", **request):
    """The recording of a table, and the samples of one topic; the request is that of `TableRequest`."""
    recording = open_any(path, options=ImportOptions(table=TableRequest(**request)))
    return recording, recording.block(topic)


def assert_samples(block, force=FORCE, gyro=GYRO, *, step_atol_ns=1000, atol=1e-6):
    """Asserts that a block has forces, m/s², and rates, rad/s, at 100 Hz."""
    np.testing.assert_allclose(np.diff(block.t_ns), 10_000_000, atol=step_atol_ns)
    np.testing.assert_allclose(block.columns["specific_force"], force, atol=atol)
    np.testing.assert_allclose(block.columns["angular_rate"], gyro, atol=atol)


def assert_refused(path, says, **request):
    """Asserts that a table is refused in one line that matches a pattern."""
    with pytest.raises(StrideTwinError, match=says) as caught:
        read(path, **request)
    assert "\n" not in str(caught.value)
