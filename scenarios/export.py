"""A recording in another tool's format: a file, or a folder that appears whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from stridetwin.scenarios.evaluate import true_path
from stridetwin.scenarios.files import staged
from stridetwin.scenarios.imu_table import write_imu_table
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.formats.euroc_export import write_euroc
from stridetwin.streams.formats.opensim_export import write_opensim
from stridetwin.streams.formats.ros2_export import write_rosbag2
from stridetwin.streams.formats.tum_export import write_tum_rgbd
from stridetwin.streams.recording import Recording
from stridetwin.streams.tum import write_tum

DEFAULT_FRAME = "foot_l/imu"
TRAJECTORY_SUFFIXES = (".txt", ".tum")


def export(
    recording: Recording,
    form: str,
    output: Path,
    *,
    frame: str | None = None,
    camera: str | None = None,
    storage: str = "mcap",
    stereo_baseline_m: float | None = None,
    model: str = "rajagopal",
) -> dict[str, int]:
    """Writes a recording in another format.

    Args:
        recording: Any recording.
        form: euroc, tum, rosbag2, opensim or table.
        output: File (a trajectory, a table) or folder to make; a folder must be new or empty.
        frame: For `tum`, the frame whose true path to write; for `table`, the IMU. With `tum`, a frame or a file
            name that ends in .txt or .tum asks for a trajectory, anything else for an RGB-D folder.
        camera: For `euroc` and `tum`, the topic of the camera; the first with depth by default.
        storage: For `rosbag2`, `mcap` or `sqlite3`.
        stereo_baseline_m: For `euroc`, makes a right camera at this distance from depth.
        model: For `opensim`, `rajagopal` or `gait2392`.

    Returns:
        Rows written, by what they are.

    Raises:
        StrideTwinError: The recording lacks what the format needs, or the place is taken.
    """
    if form == "table":
        return _table(recording, output, frame or DEFAULT_FRAME)
    if form == "tum" and (frame is not None or output.suffix in TRAJECTORY_SUFFIXES):
        frame = frame or DEFAULT_FRAME
        truth = true_path(recording, frame).poses
        write_tum(truth, output)
        return {frame: len(truth)}
    writers: dict[str, Callable[[Path], dict[str, int]]] = {
        "euroc": lambda folder: write_euroc(recording, folder, camera, stereo_baseline_m),
        "tum": lambda folder: write_tum_rgbd(recording, folder, camera),
        "rosbag2": lambda folder: write_rosbag2(recording, folder, output.name, storage),
        "opensim": lambda folder: write_opensim(recording, folder, model),
    }
    if output.exists() and not (output.is_dir() and not any(output.iterdir())):
        raise ConfigError("export", "-o", str(output), "a folder that is new or empty")
    with staged(output) as folder:
        return writers[form](folder)


def _table(recording: Recording, output: Path, frame: str) -> dict[str, int]:
    imus = sorted(t.strip("/") for t in recording.rig.imus if t in recording.topics)
    if frame not in imus:
        raise StrideTwinError(f"{recording.path}: no IMU {frame!r}; it has {', '.join(imus) or 'none'}")
    block = recording.block(f"/{frame}")
    write_imu_table(output, block)
    return {frame: len(block)}
