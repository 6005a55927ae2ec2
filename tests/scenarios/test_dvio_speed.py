"""Who keeps up: samples that wait for those before them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.dvio_speed import lag


def test_answers_are_late_by_their_own_time_and_by_what_they_waited():
    rng = np.random.default_rng(5)
    arrived, spent = np.cumsum(rng.exponential(1.0, 200)), rng.exponential(0.9, 200)
    free, late = 0.0, []
    for at, time in zip(arrived, spent):
        free = max(free, at) + time
        late.append(free - at)
    assert lag(arrived, spent) == pytest.approx(late)
    assert max(late) > 2.0 * spent.max()
