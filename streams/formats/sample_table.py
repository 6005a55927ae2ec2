"""Tables of the samples of any stream without images: one row per sample, one column per number."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.files import atomic_file
from stridetwin.streams.formats.imu_table import TABLES, write_imu_table
from stridetwin.streams.samples import Block, Imu, Sample

TIME = "t_s"


def write_sample_table(path: Path, block: Block[Sample]) -> None:
    """Writes the samples of a stream, whole or not at all.

    An IMU is written as a table with the columns that imports of IMU tables read: `t`, `accel_x`, ... and `gyro_x`, ...
    (`write_imu_table`). Of another stream, the first column is the time `t_s` in s, and the others are the numbers of a
    sample in SI units, each named after its field and component (`Block.split_columns`): `position_hip_l`,
    `force_heel`.

    Args:
        path: A `.csv`, or a `.npz` with one array per column.
        block: The samples.

    Raises:
        ConfigError: Another suffix.
    """
    if path.suffix not in TABLES:
        raise ConfigError(path, "", path.suffix, f"a table {' or '.join(TABLES)}")
    if block.kind is Imu:
        write_imu_table(path, block.as_kind(Imu))
        return
    columns: dict[str, NDArray[np.generic]] = {TIME: block.t_ns * 1e-9, **block.split_columns()}
    with atomic_file(path) as temporary:
        if path.suffix == ".npz":
            with temporary.open("wb") as file:
                # Python's texts as NumPy's, since others would be pickled
                texts = {name: values.astype(str) for name, values in columns.items() if values.dtype.kind == "O"}
                np.savez_compressed(file, **columns | texts)
            return
        with temporary.open("w", newline="", encoding="utf-8") as text:
            writer = csv.writer(text, lineterminator="\n")
            writer.writerow(columns)
            cells = [_format_column(name, values) for name, values in columns.items()]
            writer.writerows(zip(*cells))


def _format_column(name: str, values: NDArray[np.generic]) -> list[str]:
    """The cells of a column: times to 1 ns, other numbers to nine digits, and text as it is."""
    if values.dtype.kind != "f":
        return [str(value) for value in values.tolist()]
    return [f"{value:.9f}" if name == TIME else f"{value:.9g}" for value in values.tolist()]
