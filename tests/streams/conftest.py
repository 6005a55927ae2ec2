import numpy as np
import pytest
from rigs import every_small_block, small_rig

from stridetwin.streams.recording.reader import RecordingWriter
from stridetwin.streams.samples import Depth, Image


def image_at(t_ns):
    u, v = np.meshgrid(np.arange(32), np.arange(24))
    shade = 4 * u + 3 * v + t_ns // 100_000_000
    return np.stack([np.full_like(shade, 200), shade // 2, np.full_like(shade, 30)], axis=2).astype(np.uint8)


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """A whole recording with every kind of sample, 2 s of images in it."""
    path = tmp_path_factory.mktemp("whole") / "walk.mcap"
    with RecordingWriter(path, small_rig(), {"seed": "7"}) as writer:
        for block in every_small_block():
            writer.write(block)
        for i in range(60):
            t = 1_200_000_000 + i * 33_333_333
            depth = np.linspace(0, 3, 32 * 24, dtype=np.float32).reshape(24, 32)
            writer.write(Image(topic="/head/color", t_ns=t, pixels=image_at(t)))
            writer.write(Depth(topic="/head/depth", t_ns=t, depth=depth))
            writer.write(Image(topic="/foot_l/camera", t_ns=t, pixels=image_at(t)[..., 1]))
    return path
