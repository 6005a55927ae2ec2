"""Faults of any stream, its values and its calibration: lost, late, exchanged, frozen, clipped and shifted samples.

An error of the nominal calibration is in the recording that estimators read; the sensors themselves are right.

A field with `DEGREES`, `MILLIMETRES` or another unit has that unit in scenario files, and so have its limits; its value
here is in SI units or radians.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Annotated

import numpy as np
from pydantic import Field, StrictBool, StrictInt

from stridetwin.sim.faults.faults import (
    NUMBERS,
    Calibration,
    Event,
    EventsOfTopic,
    Fault,
    Memory,
    SampleInTransit,
    SensorStream,
    TimedFault,
    active_event,
)
from stridetwin.sim.parts.library import full_scales
from stridetwin.streams.fields import DEG, DEGREES, MILLIMETRES, Number, OneOf, Unit
from stridetwin.streams.rig import CameraCalibration, ImuCalibration
from stridetwin.streams.samples import Actuator, Ahrs, Array, Encoder, Image, Imu, Insole, Interaction, Odometry, Range

_RateRange = Annotated[Number | None, Field(ge=0.1, le=10_000, alias="gyroscope_deg_s"), DEGREES]
_Length = Annotated[Number, Field(ge=-1000, le=1000)]
_Angle = Annotated[Number, Field(ge=-180, le=180), DEGREES]
_Shift = Annotated[Number, Field(ge=-1000, le=1000), MILLIMETRES]
_ForceRange = Annotated[Number | None, Field(ge=0.1, le=10_000)]
CELLS = ("heel", "lateral_ball", "medial_ball", "toe")  # of an insole, in the order of `Insole.force`


@dataclass(frozen=True, kw_only=True)
class Dropout(TimedFault):
    """Samples that never arrive; those of one housing and instant, such as colour and depth, are lost together.

    Attributes:
        share: Lost share of the samples, at random.
    """

    common_to = "housing"
    share: Annotated[Number, Field(ge=0.001, le=1)] = 1.0

    def corrupt(self, arrival: SampleInTransit, event: Event) -> Iterable[SampleInTransit]:
        """The arrival, or nothing if it is lost."""
        is_lost = self.share == 1.0 or event.rng(arrival.taken_ns).random() < self.share
        return () if is_lost else (arrival,)


@dataclass(frozen=True, kw_only=True)
class Exchange(Fault):
    """Samples that arrive under the topic of the other side for the whole walk: left and right are exchanged."""

    def applies_to(self, stream: SensorStream) -> bool:
        """Whether the stream belongs to a side."""
        return stream.kind in self.sample_types and _opposite_topic(stream.topic) != stream.topic

    def corrupt(self, arrival: SampleInTransit, event: Event) -> Iterable[SampleInTransit]:
        """The sample under the other topic."""
        return (arrival.with_values(topic=_opposite_topic(arrival.topic)),)


def _opposite_topic(topic: str) -> str:
    """Topic with `_l` and `_r` exchanged; a topic without a side stays."""
    return re.sub("_([lr])(?=/)", lambda side: "_r" if side[1] == "l" else "_l", topic)


@dataclass(frozen=True, kw_only=True)
class Freeze(TimedFault):
    """Repeats the last value before the event, with new stamps."""

    def process(
        self, stream: Iterable[SampleInTransit], events: EventsOfTopic, memory: Memory
    ) -> Iterator[SampleInTransit]:
        """Arrivals whose values stop changing during events, with their own stamps.

        A stream that begins during an event repeats its first value. `memory["last"]` is the value that is repeated.
        """
        for arrival in stream:
            if active_event(events, arrival) is None:
                memory["last"] = arrival.item
                yield arrival
            else:
                last = memory.setdefault("last", arrival.item)
                yield replace(arrival, item=replace(last, t_ns=arrival.item.t_ns))


@dataclass(frozen=True, kw_only=True)
class Repeat(TimedFault):
    """Each sample twice, with the same stamp."""

    def corrupt(self, arrival: SampleInTransit, event: Event) -> Iterable[SampleInTransit]:
        """The sample, twice."""
        return arrival, arrival


@dataclass(frozen=True, kw_only=True)
class Interpolated(TimedFault):
    """Lost packets that the driver fills by straight lines between their neighbours; counter and stamps show nothing.

    Filled samples arrive together with the one that ends the line. Those that nothing follows never arrive.

    Attributes:
        share: Lost share of the packets, at random.
        packet_samples: Samples in a packet.
        above_rad_s: Size of an IMU's rate above which packets are lost, in the first sample of the packet; 0: always.
    """

    sample_types = (Imu, Insole, Encoder, Interaction, Actuator)
    share: Annotated[Number, Field(ge=0.001, le=1)] = 0.1
    packet_samples: Annotated[StrictInt, Field(ge=1, le=100)] = 1
    above_rad_s: Annotated[Number, Field(ge=0, le=10_000, alias="above_deg_s"), DEGREES] = 0.0

    def applies_to(self, stream: SensorStream) -> bool:
        """Whether the samples hold numbers on which a line can be drawn, and rates where a level of them is given."""
        return stream.kind in self.sample_types and (not self.above_rad_s or stream.kind is Imu)

    def process(
        self, stream: Iterable[SampleInTransit], events: EventsOfTopic, memory: Memory
    ) -> Iterator[SampleInTransit]:
        """Arrivals of which lost ones wait for the next that is not, and then have values between their neighbours.

        `memory["last"]` is the last sample that was not lost, `memory["lost"]` are the lost ones since then, and
        `memory["packet"]` is the number of the packet with whether it is lost.
        """
        for arrival in stream:
            event = active_event(events, arrival)
            if event is not None and "last" in memory and self._is_lost(arrival, event, memory):
                memory.setdefault("lost", []).append(arrival)
                continue
            for lost in memory.pop("lost", ()):
                yield _fill_between(memory["last"], lost, arrival)
            memory["last"] = arrival
            yield arrival

    def _is_lost(self, arrival: SampleInTransit, event: Event, memory: Memory) -> bool:
        """Whether a sample is in a lost packet; the packet's first sample decides for all of them."""
        # packets by time, so that they are the same wherever the stream begins
        rate_hz = _find_rate(event)
        packet = event.key, round(arrival.taken_ns * 1e-9 * rate_hz) // self.packet_samples
        if memory.get("packet", (None,))[0] != packet:
            item = arrival.item
            is_fast = not isinstance(item, Imu) or float(np.linalg.norm(item.angular_rate)) >= self.above_rad_s
            memory["packet"] = packet, is_fast and event.rng(packet[1]).random() < self.share
        return bool(memory["packet"][1])


def _find_rate(event: Event) -> float:
    """Nominal rate of the stream of an event, Hz."""
    calibrations: dict[str, Calibration] = {**event.rig.imus, **event.rig.others}
    return calibrations[event.topic].rate_hz


def _fill_between(before: SampleInTransit, lost: SampleInTransit, after: SampleInTransit) -> SampleInTransit:
    """A lost sample with the values of a straight line in time between two others; it arrives with the later one."""
    span_ns = after.taken_ns - before.taken_ns  # 0 where a fault before this one has repeated a sample
    share = (lost.taken_ns - before.taken_ns) / span_ns if span_ns else 0.0
    values = {}
    for f in fields(lost.item)[2:]:  # after topic and time
        start, end = (getattr(arrival.item, f.name) for arrival in (before, after))
        values[f.name] = start + share * (end - start)
    return replace(lost.with_values(**values), log_ns=after.log_ns)


@dataclass(frozen=True, kw_only=True)
class Nan(TimedFault):
    """NaN values."""

    sample_types = NUMBERS

    def corrupt(self, arrival: SampleInTransit, event: Event) -> Iterable[SampleInTransit]:
        """The sample with NaN for every value."""
        values = {f.name: getattr(arrival.item, f.name) for f in fields(arrival.item)[2:]}  # after topic and time
        # arrays of NaN; the index () makes a plain number of an array without axes
        return (arrival.with_values(**{k: np.full_like(v, np.nan, float)[()] for k, v in values.items()}),)


@dataclass(frozen=True, kw_only=True)
class Late(TimedFault):
    """Samples that arrive late but in order; those measured after the event wait for them.

    Attributes:
        delay_s: Delay.
    """

    delay_s: Annotated[Number, Field(ge=0.001, le=60)] = 0.25

    def process(
        self, stream: Iterable[SampleInTransit], events: EventsOfTopic, memory: Memory
    ) -> Iterator[SampleInTransit]:
        """Arrivals that are delayed during events: their stamps do not change, and they never overtake each other.

        `memory["free"]` is the arrival time of the last one, before which none may arrive.
        """
        for arrival in stream:
            late = 0 if active_event(events, arrival) is None else round(self.delay_s * 1e9)  # ns
            memory["free"] = log_ns = max(arrival.log_ns + late, memory.get("free", 0))
            yield arrival if log_ns == arrival.log_ns else replace(arrival, log_ns=log_ns)


@dataclass(frozen=True, kw_only=True)
class OutOfOrder(TimedFault):
    """Samples that arrive out of order: of every two, the later arrives first."""

    def process(
        self, stream: Iterable[SampleInTransit], events: EventsOfTopic, memory: Memory
    ) -> Iterator[SampleInTransit]:
        """Arrivals of which, during events, the second of every two overtakes the first; both then arrive together.

        `memory["held"]` is a first one that waits for its second.
        """
        for arrival in stream:
            overtaken = memory.pop("held", None)
            if overtaken is not None:  # this one is the second of two
                yield arrival
                yield replace(overtaken, log_ns=arrival.log_ns)
            elif active_event(events, arrival) is not None:  # the first of two: it waits
                memory["held"] = arrival
            else:
                yield arrival

    def flush(self, memory: Memory) -> Iterable[SampleInTransit]:
        """A held-back arrival that nothing overtook before the end."""
        return tuple(memory.values())


@dataclass(frozen=True, kw_only=True)
class ClockJump(TimedFault):
    """A sensor clock with an offset during the event; arrival times are unaffected.

    Attributes:
        jump_s: Offset of its stamps (negative: behind).
    """

    jump_s: Annotated[Number, Field(ge=-3600, le=3600)]

    def corrupt(self, arrival: SampleInTransit, event: Event) -> Iterable[SampleInTransit]:
        """The sample with an offset in its stamp."""
        return (arrival.with_values(t_ns=arrival.item.t_ns + round(self.jump_s * 1e9)),)


@dataclass(frozen=True, kw_only=True)
class Saturation(TimedFault):
    """A range that is smaller than the part's; `Miscalibration` lets the calibration say so.

    Attributes:
        fraction: Clipping level, as a share of the part's full scale, where no other level is given.
        gyroscope_rad_s: Clipping level of an IMU's rates; with it or the next one, only what they name is clipped.
        accelerometer_mps2: Clipping level of an IMU's specific force.
    """

    sample_types = (Imu, Insole, Interaction)
    fraction: Annotated[Number, Field(ge=0.001, le=1)] = 0.5
    gyroscope_rad_s: _RateRange = None
    accelerometer_mps2: _ForceRange = None

    def applies_to(self, stream: SensorStream) -> bool:
        """Whether the full scale of the part is known."""
        return stream.kind in self.sample_types and bool(full_scales(stream.part))

    def corrupt(self, arrival: SampleInTransit, event: Event) -> Iterable[SampleInTransit]:
        """The sample with clipped values: those of the levels that are set, or all at `fraction` of the full scale."""
        # by field of the sample: full scale of the part, levels that may be set, and the limits that apply
        scales = full_scales(event.part)
        levels = {"angular_rate": self.gyroscope_rad_s, "specific_force": self.accelerometer_mps2}
        limits = {name: level for name, level in levels.items() if name in scales and level is not None}
        limits = limits or {name: self.fraction * scale for name, scale in scales.items()}
        clipped = {name: np.clip(getattr(arrival.item, name), -limit, limit) for name, limit in limits.items()}
        return (arrival.with_values(**clipped),)


@dataclass(frozen=True, kw_only=True)
class Offset(TimedFault):
    """Values that are off, by more and more if they drift: insoles, angles of encoders, and headings of AHRSs.

    Attributes:
        offset_n: Offset of each cell of an insole when the event begins.
        drift_n_per_s: Change of that offset.
        offset_rad: Offset of an encoder's angle (flexion positive) or of an AHRS's heading (left positive).
        drift_rad_s: Change of that offset.
        drift_s: Time for which the offset drifts; it then stays.
    """

    sample_types = (Insole, Encoder, Ahrs)
    offset_n: Annotated[Number, Field(ge=-1000, le=1000)] = 0.0
    drift_n_per_s: Annotated[Number, Field(ge=-1000, le=1000)] = 0.0
    offset_rad: Annotated[Number, Field(ge=-180, le=180, alias="offset_deg"), DEGREES] = 0.0
    drift_rad_s: Annotated[Number, Field(ge=-3600, le=3600, alias="drift_deg_per_min"), Unit(DEG / 60)] = 0.0
    drift_s: Annotated[Number, Field(ge=0, le=36_000)] = 36_000.0

    def applies_to(self, stream: SensorStream) -> bool:
        """Whether the stream has values in the unit of the given offsets: N for insoles, rad for encoders and AHRSs."""
        wrong_offsets = (
            (self.offset_rad, self.drift_rad_s) if stream.kind is Insole else (self.offset_n, self.drift_n_per_s)
        )
        return stream.kind in self.sample_types and not any(wrong_offsets)

    def corrupt(self, arrival: SampleInTransit, event: Event) -> Iterable[SampleInTransit]:
        """The sample with the offset."""
        item = arrival.item
        drift_time_s = min(1e-9 * (arrival.taken_ns - event.from_ns), self.drift_s)  # so far
        if isinstance(item, Insole):
            return (arrival.with_values(force=item.force + self.offset_n + self.drift_n_per_s * drift_time_s),)
        angle = self.offset_rad + self.drift_rad_s * drift_time_s
        if isinstance(item, Ahrs):
            from scipy.spatial.transform import Rotation  # slow to import, seldom used

            # rotate the attitude about the vertical of the world
            q = Rotation.from_rotvec([0.0, 0.0, angle]) * Rotation.from_quat(item.q_world_sensor, scalar_first=True)
            return (arrival.with_values(q_world_sensor=q.as_quat(scalar_first=True)),)
        return (arrival.with_values(angle=item.angle + angle),) if isinstance(item, Encoder) else (arrival,)


@dataclass(frozen=True, kw_only=True)
class Restart(TimedFault):
    """An odometry that is lost during the event, and then starts again in another frame, permanently.

    It acts when a recording is replayed (`streams.pose_restart`); a twin has no estimated poses.

    Attributes:
        yaw_rad: Rotation about the vertical from the old frame to the new one.
        translation_m: Translation from the old frame to the new one, after the rotation.
    """

    sample_types = (Odometry,)
    on_samples = False
    yaw_rad: Annotated[Number, Field(ge=-180, le=180, alias="yaw_deg"), DEGREES] = 0.0
    translation_m: tuple[_Length, _Length, _Length] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class DeadCell(TimedFault):
    """One cell of an insole that no longer measures its load, or all cells.

    Attributes:
        cell: One of `CELLS`, or `all`.
        stuck: Whether it keeps its value from the start of the event; otherwise it reads 0.
    """

    sample_types = (Insole,)
    cell: Annotated[str, OneOf((*CELLS, "all"))] = "heel"
    stuck: StrictBool = False

    def process(
        self, stream: Iterable[SampleInTransit], events: EventsOfTopic, memory: Memory
    ) -> Iterator[SampleInTransit]:
        """Arrivals in which, during events, the cell reads 0 or its value at the start of the event.

        `memory` holds that value by event.
        """
        cells = [*range(len(CELLS))] if self.cell == "all" else [CELLS.index(self.cell)]  # entries of `force`
        for arrival in stream:
            event = active_event(events, arrival)
            if event is not None and isinstance(arrival.item, Insole):
                force: Array = arrival.item.force.copy()
                force[cells] = memory.setdefault(event, force[cells]) if self.stuck else 0.0
                arrival = arrival.with_values(force=force)
            yield arrival


@dataclass(frozen=True, kw_only=True)
class Miscalibration(Fault):
    """An error of the nominal calibration of some sensors, for the whole walk.

    Attributes:
        rotation_rad: Rotation vector from the true to the nominal mount, in the sensor's frame.
        translation_m: Translation from the true to the nominal mount, in the sensor's frame.
        clock_offset_s: Error of the time that the calibration adds to a camera's stamps (`timeshift_cam_imu`).
        gyroscope_rad_s: Range of an IMU's gyroscopes, other than the part's.
        accelerometer_mps2: Range of an IMU's accelerometers, other than the part's.
        thigh_m: Error of the exoskeleton's link above the knee with this encoder; the geometry is not in the rig, so
            `scenarios.exo_geometry` adds it.
        shank_m: Error of the link below that knee.
    """

    on_samples = False
    sample_types = (Imu, Image, Range, Insole, Ahrs, Encoder)
    rotation_rad: Annotated[tuple[_Angle, _Angle, _Angle], Field(alias="rotation_deg")] = (0.0, 0.0, 0.0)
    translation_m: Annotated[tuple[_Shift, _Shift, _Shift], Field(alias="translation_mm")] = (0.0, 0.0, 0.0)
    clock_offset_s: Annotated[Number, Field(ge=-1, le=1)] = 0.0
    gyroscope_rad_s: _RateRange = None
    accelerometer_mps2: _ForceRange = None
    thigh_m: Annotated[Number, Field(ge=-200, le=200, alias="thigh_mm"), MILLIMETRES] = 0.0
    shank_m: Annotated[Number, Field(ge=-200, le=200, alias="shank_mm"), MILLIMETRES] = 0.0

    def applies_to(self, stream: SensorStream) -> bool:
        """Whether the sensor has every quantity with an error: a clock offset, ranges or links."""
        error_by_kind = {  # errors by the kind of stream that alone has them; 0 or None for no error
            Image: self.clock_offset_s,
            Imu: self.gyroscope_rad_s or self.accelerometer_mps2,
            Encoder: self.thigh_m or self.shank_m,
        }
        kinds_with_error = [kind for kind, error in error_by_kind.items() if error]
        return stream.kind in self.sample_types and all(stream.kind is kind for kind in kinds_with_error)

    def calibrate(self, sensor: Calibration) -> Calibration:
        """The nominal calibration with the errors of mount, clock and ranges, as far as the sensor has them."""
        from scipy.spatial.transform import Rotation  # slow to import, seldom used

        T = np.eye(4)  # from the true to the nominal mount, in the sensor's frame
        T[:3, :3], T[:3, 3] = Rotation.from_rotvec(self.rotation_rad).as_matrix(), self.translation_m
        nominal = replace(sensor, mount=replace(sensor.mount, T_body_sensor=sensor.mount.T_body_sensor @ T))
        if isinstance(nominal, CameraCalibration):
            return replace(nominal, timeshift_cam_imu_s=nominal.timeshift_cam_imu_s + self.clock_offset_s)
        if isinstance(nominal, ImuCalibration):
            return replace(
                nominal,
                gyroscope_range=self.gyroscope_rad_s or nominal.gyroscope_range,
                accelerometer_range=self.accelerometer_mps2 or nominal.accelerometer_range,
            )
        return nominal
