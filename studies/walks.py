"""Walks of an experiment, recorded once for all estimators.

Walks of the shoes are recorded twice: with the rig as it is, and with gyros without saturation. Rendering dominates the
cost of a recording, and both have the same images, so the second one holds only the foot IMUs.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from stridetwin.outputs.truth import TruePath
from stridetwin.scenarios.record import record
from stridetwin.sim.parts.kinds import ImuPart
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.sensor_config import STANDARD, SensorConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Image, Imu, Sample
from stridetwin.studies.case import CaseWalk, ExperimentCase

SHOES = ("foot_imu", "foot_camera", "sonar")
"""Groups of sensors of the shoes."""
IMUS = ("/foot_l/imu", "/foot_r/imu")
CAMERAS = ("/foot_l/camera", "/foot_r/camera")
SONARS = ("/foot_l/sonar", "/foot_r/sonar")


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedWalk:
    """Two recordings of one walk of the shoes, which share their images.

    Attributes:
        shoes: All sensors of both shoes.
        wide: The IMUs with gyros without saturation, and truth.
    """

    shoes: Recording
    wide: Recording

    def samples(self, *, wide: bool = False) -> Iterator[Sample]:
        """Yields the samples of both shoes in time order, images last at equal times.

        Args:
            wide: Takes the IMUs from the recording whose gyros do not saturate.
        """
        imus = (self.wide if wide else self.shoes).samples(IMUS)
        # False sorts before True
        return heapq.merge(imus, self.shoes.samples([*CAMERAS, *SONARS]), key=lambda s: (s.t_ns, isinstance(s, Image)))

    def rig(self, *, wide: bool = False) -> Rig:
        """The nominal rig for the estimators.

        Args:
            wide: Takes the calibration of the IMUs whose gyros do not saturate.
        """
        return replace(self.shoes.rig, imus=self.wide.rig.imus) if wide else self.shoes.rig

    def imus(self, *, wide: bool = False) -> dict[str, Block[Imu]]:
        """All samples of each foot's IMU, by `l` and `r`.

        Args:
            wide: Takes the recording whose gyros do not saturate.
        """
        return {foot: (self.wide if wide else self.shoes).block(f"/foot_{foot}/imu").as_kind(Imu) for foot in "lr"}

    @property
    def fell_at_s(self) -> float | None:
        """When the walker fell, s; None without a fall."""
        return fell_at_s(self.shoes)

    def truth(self) -> dict[str, TruePath]:
        """True path of each foot's IMU, by `l` and `r`."""
        return {foot: TruePath.of(self.shoes.block(f"/truth/foot_{foot}/imu/odometry")) for foot in "lr"}


def fell_at_s(recording: Recording) -> float | None:
    """When the walker of a recording fell, s; None without a fall."""
    text = recording.metadata.get("fell_at_s")
    return None if text is None else float(text)


@contextmanager
def record_walk(walk: CaseWalk, case: ExperimentCase) -> Iterator[Recording]:
    """Records a walk into the case's folder, or opens the file of an earlier run.

    The file is deleted at the end of the context unless recordings are kept; after an exception it stays.

    Args:
        walk: The walk.
        case: Its case: seed, folder, and whether recordings are reused and kept.
    """
    file = case.file(f"_{walk.name}.mcap")
    if not (case.resume and file.exists()):
        record(Twin(walk.config, case.seed), file)
    yield Recording(file)
    if not case.keep:
        file.unlink()


@contextmanager
def record_shoes(case: ExperimentCase) -> Iterator[RecordedWalk]:
    """Records the only walk of a case twice into its folder, or opens the files of an earlier run.

    The files are deleted at the end of the context unless recordings are kept; after an exception they stay.
    """
    shoes_file, wide_file = case.file(".mcap"), case.file("_wide.mcap")
    if not (case.resume and shoes_file.exists() and wide_file.exists()):
        twin = Twin(case.walks()[0].config, case.seed)
        record(twin, shoes_file)
        # the same walk with the foot IMUs alone, whose gyros do not saturate
        record(twin.with_sensors(("foot_imu",), {"foot_imu": endless_gyro()}), wide_file)
    yield RecordedWalk(shoes=Recording(shoes_file), wide=Recording(wide_file))
    if not case.keep:
        for file in (shoes_file, wide_file):
            file.unlink()


def endless_gyro() -> SensorConfig:
    """The standard foot IMU with a gyro that never saturates."""
    imu = load_part(STANDARD["foot_imu"])
    assert isinstance(imu, ImuPart)
    return SensorConfig(part=replace(imu, gyroscope=replace(imu.gyroscope, range=math.inf)))
