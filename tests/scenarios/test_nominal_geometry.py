"""A recording holds the exoskeleton's geometry as measured, not the true one."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.scenarios.exo_geometry import LINK_SD_M, MOUNT_SD_RAD, exo_from_recording, true_geometry
from stridetwin.scenarios.record import record
from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording.reader import Recording


def recorded(path, seed):
    """The true geometry of a short walk, and that in its recording."""
    twin = Twin(
        TwinConfig(name="level", route=Route(segments=(Level(length_m=2.0),)), sensors=("ahrs", "encoder", "insole")),
        seed,
    )
    record(twin, path)
    return true_geometry(twin.size, twin.rig), exo_from_recording(Recording(path))


def errors(true, nominal):
    """Errors of the mounts, rad, and of the segment lengths, m."""
    mounts = [(true.back, nominal.back)]
    for side, leg in true.legs.items():
        mounts += [(leg.thigh, nominal.legs[side].thigh), (leg.foot, nominal.legs[side].foot)]
    lengths = [n.a - t.a for side, leg in true.legs.items() for t, n in zip(leg.rows, nominal.legs[side].rows)]
    angles = [Rotation.from_matrix(n.R_frame_sensor @ t.R_frame_sensor.T).magnitude() for t, n in mounts]
    return np.array(angles), np.array(lengths)


def test_a_recording_holds_the_measured_geometry(tmp_path):
    true, nominal = recorded(tmp_path / "walk.mcap", 7)
    angles, lengths = errors(true, nominal)
    assert np.all((angles > 0.05 * MOUNT_SD_RAD) & (angles < 4.5 * MOUNT_SD_RAD))
    wrong = lengths[np.abs(lengths) > 1e-12]
    assert len(wrong) == 4  # thigh and shank of both legs
    assert np.abs(wrong).max() < 4.5 * LINK_SD_M
    _, again = recorded(tmp_path / "again.mcap", 7)
    assert errors(nominal, again)[0].max() < math.radians(1e-5)
    _, other = recorded(tmp_path / "other.mcap", 8)
    assert errors(nominal, other)[0].min() > 0.05 * MOUNT_SD_RAD
