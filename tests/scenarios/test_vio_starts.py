"""The benchmark of the odometry's starts: its samples and its scale."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import vio_starts
from stridetwin.outputs.path.scores import OdometryPath
from stridetwin.outputs.truth import TruePath
from stridetwin.streams.samples import Depth
from stridetwin.streams.trajectory import Trajectory
from stridetwin.studies.zhao2023.odometry_walks import OdometryRun
from tests.estimators.dvio.wall import rig as wall_rig


@pytest.mark.parametrize("scale", [0.97, 1.0, 1.02])
def test_the_scale_is_that_of_the_true_path_over_the_estimated_one(scale):
    t_ns = np.arange(0, 10_000_000_000, 50_000_000)
    s = t_ns * 1e-9
    p, q = np.stack([s, np.sin(s), 0.1 * np.cos(s)], -1), np.tile([1.0, 0.0, 0.0, 0.0], (len(s), 1))
    truth = TruePath(t_ns=t_ns, p_frame_in_world=p, v_frame_in_world=np.gradient(p, s, axis=0), q_world_frame=q)
    estimated = (p / scale)[:, [1, 0, 2]] * [-1.0, 1.0, 1.0] + [3.0, -2.0, 1.0]  # another heading and origin
    turned = np.tile([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], (len(s), 1))
    path = Trajectory(t_ns=t_ns, p_frame_in_world=estimated, q_world_frame=turned)
    run = OdometryRun(odometry=OdometryPath(path=path, healthy=t_ns > 10**9), frame_ms=np.zeros(1))
    assert vio_starts.scale_of(run, truth) == pytest.approx(scale, abs=1e-9)


def test_a_recording_that_begins_later_has_no_earlier_samples(monkeypatch):
    samples = [SimpleNamespace(t_ns=round(t * 1e9)) for t in (0.0, 1.0, 1.5, 2.0)]
    monkeypatch.setattr(vio_starts, "odometry_samples", lambda recording, mount: iter(samples))
    assert list(vio_starts.samples_from(SimpleNamespace(), 1.5)) == samples[2:]


def test_the_method_without_depth_gets_none(monkeypatch):
    rig = wall_rig()
    samples = [Depth(t_ns=k, topic="/head/depth", depth=np.ones((2, 2), np.uint16)) for k in range(3)]
    made = []
    monkeypatch.setattr(vio_starts, "odometry_samples", lambda recording, mount: iter([*samples, "image"]))
    monkeypatch.setattr(vio_starts, "make_odometer", lambda method, rig, mount: made.append((method, rig)))
    monkeypatch.setattr(vio_starts, "run_odometry", lambda odometry, samples: list(samples))
    assert rig.cameras["/head/color"].depth_topic
    recording = SimpleNamespace(rig=rig)
    monkeypatch.setattr(vio_starts, "dropwhile", lambda before, samples: samples)
    assert vio_starts.run_of("proposed", recording, 0.0) == [*samples, "image"]
    assert vio_starts.run_of(vio_starts.WITHOUT_DEPTH, recording, 0.0) == ["image"]
    assert [method for method, _ in made] == ["proposed", "proposed"]
    assert made[0][1] == rig
    assert not made[1][1].cameras["/head/color"].depth_topic
