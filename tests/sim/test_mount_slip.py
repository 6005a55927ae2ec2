"""Straps that slip: what slips moves as one rigid thing, and IMU, camera and truth agree on where it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.sim.config import Gait, Level, Route, TwinConfig
from stridetwin.sim.faults.faults import LooseStrap
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.sensors.mount_slip import MountSlips, Slip
from stridetwin.sim.twin import Twin
from stridetwin.streams.samples import Block

SLIP = Slip(
    from_ns=400_000_000,
    until_ns=1_600_000_000,
    rotation=np.array([0.3, -0.5, 0.4]),
    translation=np.array([0.02, 0.01, -0.03]),
    pivot=np.array([0.1, -0.2, 0.05]),
)
LATER = replace(SLIP, from_ns=1_000_000_000, until_ns=1_900_000_000, rotation=np.array([-0.2, 0.1, 0.6]))


def tumbling(t: np.ndarray) -> Track:
    """A body that turns and travels, in closed form."""
    w = np.array([0.7, -1.1, 0.4])
    p = np.column_stack([np.sin(2 * t), t**2, 0.3 * np.cos(3 * t)])
    v = np.column_stack([2 * np.cos(2 * t), 2 * t, -0.9 * np.sin(3 * t)])
    return Track(
        t_ns=np.round(t * 1e9).astype(np.int64),
        p_body_in_world=p,
        q_world_body=Rotation.from_rotvec(t[:, None] * w).as_quat(scalar_first=True),
        v_body_in_world=v,
        w_body=np.tile(w, (len(t), 1)),
    )


@pytest.mark.parametrize("slips", [(SLIP,), (SLIP, LATER)], ids=["one", "two"])
def test_velocities_are_those_of_the_poses(slips: tuple[Slip, ...]) -> None:
    mount_slips, t, h = MountSlips(slips={"/a": slips}), np.linspace(0.1, 2.0, 400), 1e-5
    before, now, after = (mount_slips.mount_track("/a", tumbling(t + d)) for d in (-h, 0.0, h))
    v = (after.p_body_in_world - before.p_body_in_world) / (2 * h)
    w = (before.rotation.inv() * after.rotation).as_rotvec() / (2 * h)
    np.testing.assert_allclose(now.v_body_in_world, v, atol=1e-6)
    np.testing.assert_allclose(now.w_body, w, atol=1e-6)


def test_cameras_and_inertial_sensors_slip_alike() -> None:
    mount_slips, t = MountSlips(slips={"/a": (SLIP, LATER)}), np.linspace(0.1, 2.0, 50)
    body = tumbling(t)
    T = np.array(
        [T_world @ mount_slips.T_body_frame("/a", t_ns) for T_world, t_ns in zip(body.poses(), body.t_ns.tolist())]
    )
    np.testing.assert_allclose(mount_slips.mount_track("/a", body).poses(), T, atol=1e-12)
    assert mount_slips.mount_track("/b", body) is body


def test_before_it_slips_all_holds_and_after_it_stays() -> None:
    np.testing.assert_allclose(SLIP.T_body_frame(SLIP.from_ns), np.eye(4), atol=1e-15)
    end = SLIP.T_body_frame(SLIP.until_ns)
    np.testing.assert_array_equal(SLIP.T_body_frame(10 * SLIP.until_ns), end)
    np.testing.assert_allclose(Rotation.from_matrix(end[:3, :3]).as_rotvec(), SLIP.rotation)
    np.testing.assert_allclose(end[:3, :3] @ SLIP.pivot + end[:3, 3], SLIP.pivot + SLIP.translation)


def test_a_slip_in_the_twin_moves_what_it_holds_and_nothing_else() -> None:
    strap = LooseStrap(topic="/foot_l/imu", at_s=1.0, duration_s=1.0, angle_rad=0.2, shift_m=0.02)
    config = TwinConfig(
        name="short",
        route=Route(segments=(Level(length_m=1.3),)),
        gait=Gait(stand_s=0.6),
        sensors=("foot_imu", "sonar", "head_imu"),
    )
    plain, slipped = (
        {b.topic: b for items in Twin(c, 5).blocks() for b in items if isinstance(b, Block) and b.t_ns[0] >= 2e9}
        for c in (config, replace(config, faults=(strap,)))
    )
    moved = {"/foot_l/imu", "/truth/foot_l/imu/odometry"}
    for topic, block in plain.items():
        same = all(np.array_equal(v, slipped[topic].columns[n]) for n, v in block.columns.items())
        assert same == (topic not in moved), topic
    a, b = (x["/truth/foot_l/imu/odometry"].columns for x in (plain, slipped))
    q_a, q_b = (Rotation.from_quat(c["q_world_frame"], scalar_first=True) for c in (a, b))
    np.testing.assert_allclose((q_a.inv() * q_b).magnitude(), 0.2, atol=1e-9)
    shift = q_a.inv().apply(b["p_frame_in_world"] - a["p_frame_in_world"])
    np.testing.assert_allclose(np.linalg.norm(shift, axis=1), 0.02, atol=1e-9)
    assert np.ptp(shift, axis=0).max() < 1e-9
