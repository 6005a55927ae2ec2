"""An IMU topic as the table that other tools read: `t` (s), `accel` (m/s²), `gyro` (rad/s)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.files import whole_file
from stridetwin.streams.samples import Block, Imu

TABLES = (".npz", ".csv")
_HEADER = "t,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z"


def write_imu_table(path: Path, block: Block[Imu]) -> None:
    """Writes a table that `streams.imu_table.read_imu_table` reads back, whole or not at all.

    Args:
        path: `.npz` or `.csv`.
        block: N samples; N rows are written.

    Raises:
        ConfigError: Another suffix.
    """
    t, accel, gyro = block.t_ns * 1e-9, block.columns["specific_force"], block.columns["angular_rate"]
    if path.suffix not in TABLES:
        raise ConfigError(path, "", path.suffix, f"a table {' or '.join(TABLES)}")
    with whole_file(path) as temporary, temporary.open("wb") as file:
        if path.suffix == ".npz":
            np.savez_compressed(file, t=t, accel=accel, gyro=gyro)
        else:
            rows = np.column_stack([t, accel, gyro])
            np.savetxt(file, rows, fmt=["%.9f"] + ["%.9g"] * 6, delimiter=",", header=_HEADER, comments="")
