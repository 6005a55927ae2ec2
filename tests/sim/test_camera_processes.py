"""A walk's bytes do not depend on how many processes render its images."""

from stridetwin.sim.config import Gait, Level, Route, TwinConfig
from stridetwin.sim.faults.faults import LooseStrap
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.rendering import camera_processes
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording.reader import RecordingWriter

CONFIG = TwinConfig(
    name="short",
    route=Route(segments=(Level(length_m=0.6),)),
    gait=Gait(stand_s=0.5),
    sensors=("head_imu", "head_camera"),
    fittings={"head_camera": SensorConfig(rate_hz=10.0)},
    faults=(LooseStrap(topic="/head/color", at_s=0.5, duration_s=1.0),),
)


def test_one_or_two_processes_give_the_same_bytes(tmp_path, monkeypatch):
    recordings = []
    for processes in (1, 2):
        monkeypatch.setattr(camera_processes, "PROCESSES", processes)
        twin, path = Twin(CONFIG, 7), tmp_path / f"{processes}.mcap"
        with RecordingWriter(path, twin.rig) as writer:
            for items in twin.blocks():
                for item in items:
                    writer.write(item)
        recordings.append(path.read_bytes())
    assert recordings[0] == recordings[1]
