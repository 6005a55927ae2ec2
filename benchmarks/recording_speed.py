"""How fast recordings are written and read: small messages a second through blocks, one core."""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from stridetwin.streams.recording import Recording, RecordingWriter
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Imu

TOPICS = 25
RATE_HZ = 200


def second_of_samples(second: int, rng: np.random.Generator) -> list[Block[Imu]]:
    """One simulated second of noisy IMUs, a block a topic."""
    t = second * 1_000_000_000 + np.arange(RATE_HZ) * (1_000_000_000 // RATE_HZ)
    shape = (RATE_HZ, 3)
    return [
        Block(
            topic=f"/imu_{i:02d}",
            kind=Imu,
            t_ns=t,
            columns={"angular_rate": rng.normal(size=shape), "specific_force": rng.normal(size=shape)},
        )
        for i in range(TOPICS)
    ]


def timed(action: Callable[[], Any]) -> float:
    """Seconds that a call takes."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def measure(seconds: int) -> dict[str, float]:
    """Messages a second for writing, opening (with every check) and streaming; bytes a message on disk."""
    rng = np.random.default_rng(0)
    blocks = [block for second in range(seconds) for block in second_of_samples(second, rng)]
    count = sum(map(len, blocks))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "speed.mcap"

        def write() -> None:
            with RecordingWriter(path, Rig()) as writer:
                for block in blocks:
                    writer.write(block)

        written = timed(write)
        opened = timed(lambda: Recording(path))
        recording = Recording(path)
        streamed = timed(lambda: sum(1 for _ in recording.samples()))
        return {
            "messages": count,
            "write_per_s": count / written,
            "open_and_check_per_s": count / opened,
            "samples_per_s": count / streamed,
            "bytes_per_message": path.stat().st_size / count,
        }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=60, help="simulated seconds of 5000 messages each")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    options = parser.parse_args()
    summary = measure(options.seconds)
    if options.json:
        print(json.dumps({"benchmark": "recording_speed", "summary": summary}))
    else:
        for name, value in summary.items():
            print(f"{name:22s} {value:14,.0f}")


if __name__ == "__main__":
    main()
