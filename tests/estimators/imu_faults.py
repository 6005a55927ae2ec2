"""Faults of a foot's IMU, as hypothesis draws them."""

from __future__ import annotations

from hypothesis import strategies as st

from stridetwin.sim.faults.sample_faults import ClockJump, Dropout, Freeze, Nan, OutOfOrder, Repeat, Saturation

TOPIC = "/foot_l/imu"

IMU_FAULTS = st.lists(
    st.sampled_from(
        [
            Dropout(topic=TOPIC, rate_per_min=30, duration_s=0.3),
            Dropout(topic=TOPIC, rate_per_min=6, duration_s=3.0, name="long"),
            Freeze(topic=TOPIC, rate_per_min=10, duration_s=0.5),
            Repeat(topic=TOPIC, rate_per_min=30, duration_s=0.2),
            Nan(topic=TOPIC, rate_per_min=30, duration_s=0.2),
            OutOfOrder(topic=TOPIC, rate_per_min=30, duration_s=0.2),
            ClockJump(topic=TOPIC, rate_per_min=10, duration_s=0.5, jump_s=2.0),
            ClockJump(topic=TOPIC, rate_per_min=10, duration_s=0.5, jump_s=-2.0, name="back"),
            ClockJump(topic=TOPIC, at_s=5.0, jump_s=3600.0, name="far"),
            Saturation(topic=TOPIC, at_s=0, fraction=0.05),
        ]
    ),
    unique=True,
    min_size=1,
)
"""One or more faults of the stream `TOPIC`, each at most once."""
