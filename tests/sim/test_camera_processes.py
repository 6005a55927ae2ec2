"""A walk's bytes do not depend on how many processes render its images."""

from stridetwin.sim.config import Gait, Level, Route, TwinConfig
from stridetwin.sim.faults.faults import LooseStrap
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.rendering import camera_processes
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording.reader import Recording, RecordingWriter

CONFIG = TwinConfig(
    name="short",
    route=Route(segments=(Level(length_m=0.3),)),
    gait=Gait(stand_s=0.5),
    sensors=("head_imu", "foot_imu", "head_camera", "foot_camera"),
    fittings={"head_camera": SensorConfig(rate_hz=5.0), "foot_camera": SensorConfig(rate_hz=2.0)},
    faults=(LooseStrap(topic="/head/color", at_s=0.5, duration_s=1.0),),
)


def test_one_or_two_processes_give_the_same_bytes(tmp_path, monkeypatch):
    paths = []
    for processes in (1, 2):
        monkeypatch.setattr(camera_processes, "PROCESSES", processes)
        twin, path = Twin(CONFIG, 7), tmp_path / f"{processes}.mcap"
        with RecordingWriter(path, twin.rig) as writer:
            for items in twin.blocks():
                for item in items:
                    writer.write(item)
        paths.append(path)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    recording = Recording(paths[0])
    head, depth, shoe = (list(recording.samples([topic])) for topic in ("/head/color", "/head/depth", "/foot_l/camera"))
    assert (len(head), len(depth), len(shoe)) == (15, 15, 6)
    assert (head[0].pixels.shape, depth[0].depth.shape, shoe[0].pixels.shape) == ((480, 640, 3), (480, 640), (600, 800))
