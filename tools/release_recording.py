"""Writes the small recording of a release, which later releases must read and score alike.

Run `python tools/release_recording.py tests/streams/releases/0.1.mcap` once when a release is made, never again for it.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from stridetwin.scenarios.record import record
from stridetwin.scenarios.scenario_file import read_scenario
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.streams.rig import Rig

SCENARIO = """
description: A short walk.
terrain: [{level: {length_m: 1}}]
gait: {speed_mps: 1.1}
sensors: [foot_imu, insole, ahrs, encoder, interaction, actuator, sonar]
"""
EVERY = {"/foot_l/imu": 1, "/truth/foot_l/imu/odometry": 10, "/truth/footprints": 1}
FEW = 4  # samples of each other stream
UNTIL_NS = 5_400_000_000
LEFT_OUT = ("/foot_r/imu", "/truth/foot_r/imu/odometry")  # one foot is scored


def main() -> None:
    """Writes the recording."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("output", type=Path)
    output: Path = parser.parse_args().output
    with tempfile.TemporaryDirectory() as folder:
        file, whole = Path(folder) / "release.yaml", Path(folder) / "whole.mcap"
        file.write_text(SCENARIO)
        record(Twin(read_scenario(file).config, seed=1), whole, lambda what, share: None)
        recording = Recording(whole)
        output.parent.mkdir(parents=True, exist_ok=True)
        rig = Rig(imus={"/foot_l/imu": recording.rig.imus["/foot_l/imu"]})  # rates of the others are not kept
        with RecordingWriter(output, rig, recording.metadata) as writer:
            for topic in sorted(recording.topics):
                block = recording.block(topic)
                rows = np.arange(len(block))
                keep = rows % EVERY[topic] == 0 if topic in EVERY else rows < FEW
                if topic not in LEFT_OUT:
                    writer.write(block[keep & (block.t_ns <= UNTIL_NS)])
    print(f"{output}: {output.stat().st_size} bytes")


if __name__ == "__main__":
    main()
