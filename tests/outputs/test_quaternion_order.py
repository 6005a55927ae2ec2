"""Quaternions in another order than w, x, y, z are noticed by the truth, and those in the right order never are."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import PathEstimate
from stridetwin.outputs.path.evaluate import evaluate
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Odometry
from stridetwin.streams.trajectory import Trajectory

T_S = np.arange(0, 6, 0.01)


def swinging_foot(pitch_rad, mount):
    """A path ahead of a foot that swings once per second and turns slowly; and its true odometry."""
    p = np.column_stack((T_S, 0.2 * np.sin(T_S), np.zeros_like(T_S)))
    v = np.column_stack((np.ones_like(T_S), 0.2 * np.cos(T_S), np.zeros_like(T_S)))
    angles = np.column_stack((0.2 * T_S, pitch_rad * np.sin(2 * np.pi * T_S) ** 2))
    R = Rotation.from_euler("zy", angles) * mount
    t_ns = np.rint(T_S * 1e9).astype(np.int64)
    q = R.as_quat(scalar_first=True)
    columns = {"p_frame_in_world": p, "v_frame_in_world": v, "q_world_frame": q, "angular_rate": np.zeros_like(p)}
    block = Block(topic="/truth/foot_l/imu/odometry", kind=Odometry, t_ns=t_ns, columns=columns)
    return Trajectory(t_ns=t_ns, p_frame_in_world=p, q_world_frame=q), block


def scores_of(folder, path, truth):
    file = folder / "walk.mcap"
    with RecordingWriter(file, Rig(), {}) as writer:
        writer.write(truth)
    return evaluate(Recording(file), [PathEstimate(name="mine", frame="foot_l/imu", path=path)])[0].scores


MOUNTS = [Rotation.identity(), Rotation.from_rotvec([0.3, 1.2, -0.4]), Rotation.from_rotvec([2.0, -1.0, 1.0])]


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize(
    ("steps", "cause"), [(-1, "the order x, y, z, w (SciPy's as_quat"), (1, "w first in a TUM file, which has w last")]
)
def test_another_order_is_refused_with_its_cause(tmp_path, mount, steps, cause):
    path, truth = swinging_foot(1.0, mount)
    swapped = replace(path, q_world_frame=np.roll(path.q_world_frame, steps, axis=1))
    with pytest.raises(ConfigError, match=re.escape(f"expected w, x, y, z; it seems to be {cause}")):
        scores_of(tmp_path, swapped, truth)


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("error_rad", [0.0, 0.1, 1.0, 3.0])
def test_the_right_order_is_scored_however_wrong_the_attitude_is(tmp_path, mount, error_rad):
    path, truth = swinging_foot(1.0, mount)
    drift = Rotation.from_rotvec(np.outer(error_rad * T_S / T_S[-1], (0.5, -0.5, 0.7)))
    q = (drift * Rotation.from_quat(path.q_world_frame, scalar_first=True)).as_quat(scalar_first=True)
    assert scores_of(tmp_path, replace(path, q_world_frame=q), truth)["ape_max_m"] < 1e-6
