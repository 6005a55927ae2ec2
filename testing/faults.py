"""Faulty versions of a walk: the faults of scenarios, and a few more, at known times on all streams and on each one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from stridetwin.sim.faults.faults import Event, SampleInTransit, TimedFault
from stridetwin.sim.faults.sample_faults import ClockJump, Dropout, Freeze, Late, OutOfOrder, Repeat, Saturation
from stridetwin.sim.parts.library import full_scales
from stridetwin.streams.live.messages import rank_of
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Depth, Image, Odometry, Sample

FaultWindow = tuple[float, float]
"""Begin and end of a fault, as shares of the walk's duration."""
_ALL = (0.30, 0.34)  # a fault of all streams at once
_EACH = (0.36, 0.54)  # shared by the streams one after another, each alone
_LAST = (0.54, 0.56)  # one more fault of all streams after these
_LONG = (0.30, 0.56)  # one fault over the time of the three
_GAP = (0.30, 0.72)  # a long gap in all streams
_FROM_THERE, _FOR_GOOD = (0.30, 2.0), (0.60, 2.0)  # faults that last beyond the end of the walk, 1.0
_LATE_S = 0.25  # delay of samples
_JUMP_S, _SHORT_JUMP_S, _FAR_JUMP_S = 1.0, 0.4, 100.0  # jumps of stamps
_SHARE_OF_RANGE = 0.02  # of a part's range, at which saturated values clip
_IMAGES = (Image, Depth)


@dataclass(frozen=True, kw_only=True)
class Constant(TimedFault):
    """One number in place of every value.

    Attributes:
        value: The number; the type of each array stays.
    """

    kind = "constant"
    value: float

    def corrupt(self, arrival: SampleInTransit, event: Event) -> Iterable[SampleInTransit]:
        """The sample with the number for every value; topic and stamp stay."""
        names = (f.name for f in fields(arrival.item) if f.name not in ("topic", "t_ns"))
        values = {name: getattr(arrival.item, name) for name in names}
        # `[()]` turns an array without dimensions into a number, and leaves other arrays
        constant = {name: np.full_like(old, self.value)[()] for name, old in values.items()}
        return (arrival.with_values(**constant),)


@dataclass(frozen=True, kw_only=True)
class Injection:
    """A fault in some windows of the walk.

    Attributes:
        create: Creates the fault for a topic.
        windows: Windows in which it acts on all streams.
        each: Window that the streams share one after another, each alone; None if it acts on all at once only.
        kinds: Types of samples that it acts on, with those derived from them.
    """

    create: Callable[[str], TimedFault]
    windows: tuple[FaultWindow, ...] = (_ALL,)
    each: FaultWindow | None = _EACH
    kinds: tuple[type[Sample], ...] = (Sample,)


@dataclass(frozen=True, kw_only=True)
class FaultCase:
    """A check of an estimator under one kind of fault.

    Attributes:
        name: Name of the check, such as `fault_nan`.
        summary: What arrives, in words.
        injections: The faults.
    """

    name: str
    summary: str
    injections: tuple[Injection, ...]


@dataclass(frozen=True, eq=False)
class FaultySamples:
    """Samples as they arrive under a fault.

    Attributes:
        samples: In the order of arrival.
        over_at: Number of the first sample that arrives after the last begin or end of a fault.
    """

    samples: list[Sample]
    over_at: int


_FLOATS: tuple[type[Sample], ...] = tuple(kind for kind in Sample.__subclasses__() if kind is not Image)
"""Types of samples whose values can be NaN or infinite; pixels of images are whole numbers."""

FAULT_CASES = (
    FaultCase(
        name="fault_dropout",
        summary="samples are lost",
        injections=(Injection(create=lambda topic: Dropout(topic=topic)),),
    ),
    FaultCase(
        name="fault_gap",
        summary="all samples of some seconds are lost",
        injections=(Injection(create=lambda topic: Dropout(topic=topic), windows=(_GAP,), each=None),),
    ),
    FaultCase(
        name="fault_repeat",
        summary="samples come twice",
        injections=(Injection(create=lambda topic: Repeat(topic=topic)),),
    ),
    FaultCase(
        name="fault_out_of_order",
        summary="of two samples the later comes first",
        injections=(Injection(create=lambda topic: OutOfOrder(topic=topic)),),
    ),
    FaultCase(
        name="fault_late",
        summary="samples of one stream come after newer ones of others",
        injections=(Injection(create=lambda topic: Late(topic=topic, delay_s=_LATE_S), windows=()),),
    ),
    FaultCase(
        name="fault_nan",
        summary="values are NaN",
        injections=(Injection(create=lambda topic: Constant(topic=topic, value=np.nan), kinds=_FLOATS),),
    ),
    FaultCase(
        name="fault_inf",
        summary="values are infinite",
        injections=(
            Injection(create=lambda topic: Constant(topic=topic, value=np.inf), kinds=_FLOATS),
            Injection(
                create=lambda topic: Constant(topic=topic, value=-np.inf), windows=(_LAST,), each=None, kinds=_FLOATS
            ),
        ),
    ),
    FaultCase(
        name="fault_saturation",
        summary="values clip far below the range of the part",
        injections=(
            Injection(
                create=lambda topic: Saturation(topic=topic, fraction=_SHARE_OF_RANGE),
                windows=(_LONG,),
                each=None,
                kinds=Saturation.sample_types,
            ),
        ),
    ),
    FaultCase(
        name="fault_freeze",
        summary="the last values repeat with new stamps",
        injections=(Injection(create=lambda topic: Freeze(topic=topic)),),
    ),
    FaultCase(
        name="fault_clock_forward",
        summary="stamps jump forward for good",
        injections=(
            Injection(create=lambda topic: ClockJump(topic=topic, jump_s=_JUMP_S), windows=(_FROM_THERE,), each=None),
            Injection(create=lambda topic: ClockJump(topic=topic, jump_s=_FAR_JUMP_S), windows=(_FOR_GOOD,), each=None),
        ),
    ),
    FaultCase(
        name="fault_clock_back",
        summary="stamps jump back for a moment, or forward and back",
        injections=(
            Injection(create=lambda topic: ClockJump(topic=topic, jump_s=-_JUMP_S)),
            Injection(create=lambda topic: ClockJump(topic=topic, jump_s=_SHORT_JUMP_S), windows=(_LAST,), each=None),
        ),
    ),
    FaultCase(
        name="fault_blank_images",
        summary="images are all zeros",
        injections=(Injection(create=lambda topic: Constant(topic=topic, value=0), kinds=_IMAGES),),
    ),
)


def inject(case: FaultCase, samples: Sequence[Sample], rig: Rig) -> FaultySamples | None:
    """The samples of a walk as they arrive under a fault; None if one of its injections concerns no stream.

    Args:
        case: The fault, with at least one injection.
        samples: Samples in time order.
        rig: Names the parts, whose ranges saturate.
    """
    streams: dict[str, list[SampleInTransit]] = {}  # by topic; each sample arrives at its stamp, without the fault
    for sample in samples:
        streams.setdefault(sample.topic, []).append(
            SampleInTransit(item=sample, taken_ns=sample.t_ns, log_ns=sample.t_ns)
        )
    last_ns = 0  # when the last fault begins or ends
    for injection in case.injections:
        topics = [topic for topic, stream in streams.items() if _concerns(injection, stream, rig)]
        for number, topic in enumerate(topics):
            fault = injection.create(topic)
            events = _events(injection, fault, topic, number, len(topics), samples, _part(rig, topic))
            if events:
                memory: dict[object, object] = {}  # what the fault keeps between samples; `flush` gives the rest
                streams[topic] = [*fault.process(streams[topic], events, memory), *fault.flush(memory)]
                # a fault that lasts beyond the walk has no end in it: the estimator has to go on with it
                begins_ns = [event.from_ns for event in events]
                ends_ns = [event.until_ns for event in events if event.until_ns <= samples[-1].t_ns]
                last_ns = max(last_ns, *begins_ns, *ends_ns)
        if not topics:
            return None
    arrivals = sorted((arrival for stream in streams.values() for arrival in stream), key=_order)
    over_at = next((i for i, arrival in enumerate(arrivals) if arrival.log_ns > last_ns), len(arrivals))
    # all of these arrivals are samples; in a scenario they may also be blocks
    return FaultySamples([arrival.item for arrival in arrivals if isinstance(arrival.item, Sample)], over_at)


def _concerns(injection: Injection, stream: Sequence[SampleInTransit], rig: Rig) -> bool:
    """Whether a fault acts on a stream: on samples of its kind and, for a saturation, on parts with a known range.

    Args:
        injection: The fault.
        stream: Samples of the stream, at least one.
        rig: Names the sensors' parts.
    """
    first = stream[0].item
    if not isinstance(first, injection.kinds):
        return False
    is_saturation = isinstance(injection.create(first.topic), Saturation)
    return not is_saturation or bool(full_scales(_part(rig, first.topic)))


def _events(
    injection: Injection, fault: TimedFault, topic: str, number: int, count: int, samples: Sequence[Sample], part: str
) -> tuple[Event, ...]:
    """Events of a fault on one topic: in the common windows, then in the topic's share of the window `each`.

    Args:
        injection: The windows.
        fault: The fault.
        topic: Topic that it acts on.
        number: Number of the topic among those of the injection, from 0.
        count: How many topics these are.
        samples: All samples of the walk, which give its begin and duration.
        part: Name of the sensor's part.
    """
    begin_ns, duration_ns = samples[0].t_ns, samples[-1].t_ns - samples[0].t_ns
    windows = list(injection.windows)  # as shares of the duration
    if injection.each is not None:
        begin, width = injection.each[0], injection.each[1] - injection.each[0]
        first = number / count  # where the topic's share of this window begins, 0-1
        windows.append((begin + width * first, begin + width * (first + 1.0 / count)))
    return tuple(
        Event(
            kind=fault.kind,
            topic=topic,
            part=part,
            from_ns=begin_ns + round(begin * duration_ns),
            until_ns=begin_ns + round(end * duration_ns),
        )
        for begin, end in windows
    )


def _part(rig: Rig, topic: str) -> str:
    """Name of the part behind a topic; "" if unknown."""
    for sensors in (rig.imus, rig.others):
        if topic in sensors:
            return sensors[topic].part
    return ""


def _order(arrival: SampleInTransit) -> tuple[int, int]:
    """Sort key of arrivals: by the time of arrival, then poses first, then by kind as a recorder orders them."""
    kind = type(arrival.item)
    return arrival.log_ns, -1 if issubclass(kind, Odometry) else rank_of(kind)  # type: ignore[arg-type]
