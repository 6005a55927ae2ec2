"""Checks whether a recording is valid: rates, gaps, ranges, clocks and units of every stream, in a table."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NotRequired, TypedDict, TypeVar

import numpy as np
from numpy.typing import NDArray

from stridetwin.scenarios.camera_clock import ClockRow
from stridetwin.scenarios.camera_fit import CameraFit, fit_camera, list_cameras_beside_imus
from stridetwin.scenarios.depth_scale import DepthScale, DepthScaleRow, judge_depth_images, measure_depth_scales
from stridetwin.sim.parts.library import full_scales
from stridetwin.streams.errors import check_type
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2
from stridetwin.streams.plausible import find_implausible_values, force_at_rest
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Accelerometer, Array, Block, Depth, Image, Imu, Sample

_G, _DEG = STANDARD_GRAVITY_MPS2, math.pi / 180  # units of data sheets, in m/s² and rad
# Full scales of parts of public recordings that are not in the library, from their data sheets: text in the part's
# name, then field of a sample, to rad/s or m/s².
_FURTHER_FULL_SCALES = {
    "ADIS16448": {"angular_rate": 1000 * _DEG, "specific_force": 18 * _G},
    "BMI160": {"angular_rate": 2000 * _DEG, "specific_force": 16 * _G},
}
S = TypeVar("S", bound=Sample)
_SHARE_OF_RANGE = 0.999  # from this share of the full scale on a value is at the limit
_MIN_PLATEAU = 5  # samples that share the largest magnitude of an axis, if the full scale is not known


def range_hits_pct(block: Block[S], rig: Rig | None) -> float | None:
    """Share of an IMU's samples with an axis at the end of its range, %.

    Args:
        block: The stream.
        rig: Names the part, whose full scale comes from the library of parts. An unknown part counts as saturated where
            at least `_MIN_PLATEAU` samples share the largest magnitude of an axis.

    Returns:
        None for an empty stream, and for one of another sensor.
    """
    if block.kind is not Imu or not len(block):
        return None
    part = rig.imus[block.topic].part if rig is not None and block.topic in rig.imus else ""
    # full scale by field: of the library's part, else of the part whose name contains a known one, else empty
    limits = full_scales(part) or next((scales for name, scales in _FURTHER_FULL_SCALES.items() if name in part), {})
    is_at_limit = np.zeros(len(block), bool)
    for field in ("angular_rate", "specific_force"):
        is_at_limit |= _at_limit(np.abs(block.columns[field]), limits.get(field))
    return 100.0 * float(is_at_limit.mean())


def _at_limit(magnitude: Array, limit: float | None) -> Array:
    """Whether each sample of an IMU is at the end of its range.

    Without a known limit, an axis counts as at the limit at its largest magnitude, if at least `_MIN_PLATEAU` samples
    share that magnitude and it is not 0.

    Args:
        magnitude: (N, 3) absolute values of the axes, rad/s or m/s².
        limit: Full scale in the same unit; None if it is not known.

    Returns:
        (N,) whether any axis is at the limit.
    """
    if limit is not None:
        return np.asarray((magnitude >= _SHARE_OF_RANGE * limit).any(axis=1))
    largest = magnitude.max(axis=0)  # (3,)
    is_largest = magnitude >= largest - 1e-9 * np.maximum(largest, 1.0)  # (N, 3), with a tolerance for rounding
    has_plateau = is_largest.sum(axis=0) >= _MIN_PLATEAU  # (3,)
    return np.asarray((is_largest & has_plateau & (largest > 0)).any(axis=1))


GAP_PERIODS = 5.0  # a longer step between two samples is a gap
CLIPPED_PCT, RANGE_HITS_PCT = 5.0, 20.0
"""Shares of saturated samples from which a warning and an error are due. On 14 real walks whose samples were clipped at
smaller ranges, the foot's error stays within a factor of 1.2 up to the first (median), doubles by the second, and grows
more than fivefold above it (`python -m benchmarks.foot_ins_clipping`)."""
_MIN_SAMPLES = 10  # fewest samples of a stream whose values are checked
_SHARE_OF_CLOCKS = 0.5  # part of the progress that the check of the cameras' clocks takes


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Something that a check has found in a recording.

    Attributes:
        topic: The stream, or "" for the whole recording.
        what: Its text.
        is_error: Whether it invalidates estimates; otherwise it is a warning.
    """

    topic: str
    what: str
    is_error: bool = True

    @property
    def text(self) -> str:
        """The finding as text that begins with its stream."""
        return self.what if self.what.startswith(self.topic) else f"{self.topic}: {self.what}"


class Timing(TypedDict):
    """Timing of a stream.

    Attributes:
        jitter_ms: Scaled median absolute deviation of the steps between samples.
        gaps: Number of steps beyond `GAP_PERIODS` periods.
        longest_gap_s: The longest step.
        longest_gap_at_s: Where it begins.
    """

    jitter_ms: float
    gaps: int
    longest_gap_s: float
    longest_gap_at_s: float


class CheckedTopic(Timing):
    """Figures of one stream.

    Attributes:
        kind: Name of the type of its samples.
        samples: Number of samples.
        rate_hz: Measured rate.
        declared_hz: Rate in the calibration; 0 without.
        calibrated: Whether the calibration has the sensor; None where it need not.
        range_hits_pct: See `range_hits_pct`.
        force_m_s2: Median specific force at rest, only of an IMU or accelerometer.
        rests: Whether it is ever at rest, only of an IMU or accelerometer.
    """

    kind: str
    samples: int
    rate_hz: float
    declared_hz: float
    calibrated: bool | None
    range_hits_pct: float | None
    force_m_s2: NotRequired[float]
    rests: NotRequired[bool]


class CheckData(TypedDict):
    """Figures and findings of a check, as `check --json` prints them.

    Attributes:
        recording: Path of the recording.
        duration_s: Its duration.
        schema_version: Version of its format; "" for other formats.
        topics: Figures of each stream.
        camera_clocks: Clock of each camera that could be checked.
        depth_scales: Scale of each depth stream that could be compared with a motion.
        findings: Errors and warnings: topic, text, and whether it is an error.
        valid: Whether no finding is an error.
    """

    recording: str
    duration_s: float
    schema_version: str
    topics: dict[str, CheckedTopic]
    camera_clocks: dict[str, ClockRow]
    depth_scales: dict[str, DepthScaleRow]
    findings: list[dict[str, str | bool]]
    valid: bool


@dataclass(frozen=True, kw_only=True)
class Check:
    """Result of `check_recording`.

    Attributes:
        data: Figures of every topic, and the findings, for `--json`.
        findings: Errors and warnings.
    """

    data: CheckData
    findings: tuple[Finding, ...]

    @property
    def is_valid(self) -> bool:
        """Whether no finding is an error."""
        return self.data["valid"]


def check_recording(recording: Recording, progress: Callable[[float], None] = lambda _: None) -> Check:
    """Checks rates, gaps, ranges, calibration, clocks and units of every stream of a recording.

    Args:
        recording: Opened leniently, so that damage becomes a finding instead of an error.
        progress: Receives the share of the work that is done (0-1).
    """
    check_type(
        "check_recording", "recording", recording, Recording, "a Recording, such as open_any(PATH, lenient=True)"
    )
    _decode_images(recording)
    findings = [Finding(topic=p.topic, what=str(p)) for p in recording.problems]
    findings += [Finding(topic="", what=w, is_error=False) for w in recording.warnings]
    if not recording.has_rig:
        findings.append(Finding(topic="", what="no calibration inside"))
    if not recording.topics:
        findings.append(Finding(topic="", what="no stream that can be read"))
    # streams with a specific force, read at once
    inertial = recording.blocks(t for t, i in recording.topics.items() if i.kind in (Imu, Accelerometer))
    topics: dict[str, CheckedTopic] = {}
    for i, topic in enumerate(sorted(recording.topics)):
        progress(_SHARE_OF_CLOCKS * i / len(recording.topics))
        topics[topic], topic_findings = _check_topic(recording, topic, inertial.get(topic))
        findings += topic_findings
    gyros = {topic: block.as_kind(Imu) for topic, block in inertial.items() if block.kind is Imu}
    # the clocks are the second half of the progress
    fits, camera_findings = _check_cameras(recording, gyros, lambda share: progress(_SHARE_OF_CLOCKS * (1 + share)))
    clocks = {topic: fit.clock for topic, fit in fits.items() if fit.clock is not None}
    scales, depth_findings = _check_depths(recording, gyros, fits.values())
    findings += camera_findings + depth_findings
    # topics that were not read, with the type of their messages; the calibration of cameras is read elsewhere
    unread = {topic: kind for topic, kind in recording.unread.items() if not topic.endswith("/camera_info")}
    findings += [Finding(topic=t, what=f"not read: {kind}", is_error=False) for t, kind in sorted(unread.items())]
    data: CheckData = {
        "recording": str(recording.path),
        "duration_s": recording.duration,
        "schema_version": recording.schema_version,
        "topics": topics,
        "camera_clocks": {topic: clock.row() for topic, clock in clocks.items()},
        "depth_scales": {topic: scale.row() for topic, scale in scales.items()},
        "findings": [{"topic": f.topic, "what": f.what, "is_error": f.is_error} for f in findings],
        "valid": not any(f.is_error for f in findings),
    }
    return Check(data=data, findings=tuple(findings))


def check_table(check: Check) -> list[str]:
    """The result of a check as lines of text: one line per topic and camera, then the findings and the verdict."""
    heads = ("topic", "kind", "samples", "Hz", "declared", "jitter ms", "gaps", "longest s", "at limit %")
    lines = [f"{_format_line(heads)}  remarks"]
    for topic, row in check.data["topics"].items():
        declared, hits = row["declared_hz"], row["range_hits_pct"]
        cells = (
            topic,
            row["kind"],
            str(row["samples"]),
            f"{row['rate_hz']:.2f}",
            f"{declared:g}" if declared else "-",
            f"{row['jitter_ms']:.3f}",
            str(row["gaps"]),
            f"{row['longest_gap_s']:.3f}",
            "-" if hits is None else f"{hits:.2f}",
        )
        lines.append(f"{_format_line(cells)}  {_remark(row)}".rstrip())
    for topic, clock in check.data["camera_clocks"].items():
        shift = f"{clock['shift_s'] * 1e3:+.1f} ± {clock['half_s'] * 1e3:.1f} ms (95 %)"
        lines.append(
            f"{topic}: time of {clock['imu']} = its own {shift}, calibration {clock['calibrated_s'] * 1e3:+.1f} ms"
        )
    for topic, scale in check.data["depth_scales"].items():
        if scale["scale"] is not None and scale["scale_half"] is not None:
            size = f"{scale['scale']:.3g} ± {scale['scale_half']:.2g} (95 %)"
            lines.append(f"{topic}: its motion is {size} times that of {scale['reference']}")
    for finding in check.findings:
        lines.append(f"{'ERROR' if finding.is_error else 'WARNING'}: {finding.text}")
    lines.append("valid" if check.is_valid else "invalid: see ERROR")
    return lines


def _format_line(cells: Sequence[str]) -> str:
    """A line of the table that `check` prints: topic and kind to the left of their columns, numbers to the right."""
    return f"{cells[0]:<32}{cells[1]:<14}" + "".join(f"{c:>12}" for c in cells[2:])


def _remark(row: CheckedTopic) -> str:
    """The typical size of the specific force as text, and whether it is that at rest; "" for streams without it."""
    if "force_m_s2" not in row:
        return ""
    return f"|f| {row['force_m_s2']:.2f} m/s²{' at rest' if row['rests'] else ''}"


def _decode_images(recording: Recording) -> None:
    """Decodes the images so that damaged ones become problems of the recording.

    An MCAP file is left out, as its checksums show damage without decoding.
    """
    if not recording.is_mcap:
        image_topics = [topic for topic, info in recording.topics.items() if info.kind in (Image, Depth)]
        for _ in recording.samples(image_topics):  # a damaged image is added to `recording.problems` as it is read
            pass


def _check_cameras(
    recording: Recording, gyros: Mapping[str, Block[Imu]], progress: Callable[[float], None]
) -> tuple[dict[str, CameraFit], list[Finding]]:
    """Compares each camera with the IMU on its body: clock, mount, focal length and lever arm.

    Args:
        recording: The recording.
        gyros: Samples of the IMUs by topic.
        progress: Receives the share of the work that is done (0-1).

    Returns:
        The comparisons by the camera's topic. A warning says why a camera was not compared.
    """
    cameras = list(list_cameras_beside_imus(recording))
    fits, findings = dict[str, CameraFit](), list[Finding]()
    for i, (camera, reason) in enumerate(cameras):
        progress(i / len(cameras))
        if reason:
            what = f"its clock and mount were not checked: {reason}"
            findings.append(Finding(topic=camera.topic, what=what, is_error=False))
            continue
        fit = fit_camera(recording, camera, gyros[camera.imu_topic])
        findings += [
            Finding(topic=camera.topic, what=fault.text, is_error=fault.is_certain) for fault in fit.list_faults()
        ]
        if fit.clock is None and not fit.rate_fault:
            what = f"its clock and mount could not be checked with its images and the gyroscope of {camera.imu_topic}"
            findings.append(Finding(topic=camera.topic, what=what, is_error=False))
        fits[camera.topic] = fit
    return fits, findings


def _check_depths(
    recording: Recording, gyros: Mapping[str, Block[Imu]], fits: Collection[CameraFit]
) -> tuple[dict[str, DepthScale], list[Finding]]:
    """Compares the depth of each camera with its motion, and with planes and distances in some images.

    A fault is reported once: a camera that is not as its calibration says has no motion to compare depth with, and a
    focal length that the rotation shows is not asked for again.

    Args:
        recording: The recording.
        gyros: Samples of the IMUs by topic.
        fits: What is known of the cameras.

    Returns:
        The comparisons by the topic of the depth, and the findings.
    """
    faulty = {fit.camera.depth_topic for fit in fits if any(fault.spoils for fault in fit.list_faults())}
    with_focal = {fit.camera.depth_topic for fit in fits if fit.focal is not None and fit.focal.is_certain}
    scales = measure_depth_scales(recording, gyros, skipped=faulty)
    findings = [
        Finding(topic=topic, what=what, is_error=is_error)
        for topic, scale in scales.items()
        for what, is_error in scale.faults(asks_focal=topic not in with_focal)
    ]
    views = judge_depth_images(recording, scales, skipped=faulty)
    findings += [Finding(topic=topic, what=str(implausible), is_error=False) for topic, implausible in views]
    return scales, findings


def _check_topic(recording: Recording, topic: str, block: Block[S] | None) -> tuple[CheckedTopic, list[Finding]]:
    """Figures and findings of one topic.

    Args:
        recording: The recording.
        topic: The topic.
        block: Samples of an IMU or accelerometer; None for other streams.

    Returns:
        The row of the table, and the findings that are not among the recording's own problems.
    """
    info, t_ns = recording.topics[topic], recording.times(topic)
    is_image = info.kind in (Image, Depth)
    timing = _timing(t_ns)
    declared_hz, is_calibrated = _read_from_rig(recording, topic)
    row: CheckedTopic = {
        "kind": info.kind.__name__,
        "samples": info.count,
        "rate_hz": info.rate_hz,
        "declared_hz": declared_hz,
        "calibrated": is_calibrated,
        "range_hits_pct": None,
        "jitter_ms": timing["jitter_ms"],
        "gaps": timing["gaps"],
        "longest_gap_s": timing["longest_gap_s"],
        "longest_gap_at_s": timing["longest_gap_at_s"],
    }
    findings: list[Finding] = []  # gaps of images are warnings, gaps of other sensors errors
    # other sensors have no section in Kalibr's format, so that a calibration may lack them
    if row["calibrated"] is False and info.kind in (Imu, Image, Depth):
        findings.append(Finding(topic=topic, what="no calibration"))
    gaps = f"{row['gaps']} gaps, the longest {row['longest_gap_s']:.3f} s at {row['longest_gap_at_s']:.3f} s"
    if row["gaps"] and (is_image or not topic.startswith("/truth/")):
        findings.append(Finding(topic=topic, what=gaps, is_error=not is_image))
    if block is not None and not topic.startswith("/truth/"):
        row["range_hits_pct"] = hits = range_hits_pct(block, recording.rig if recording.has_rig else None)
        if hits is not None and hits > CLIPPED_PCT:
            is_error = hits > RANGE_HITS_PCT  # else a warning
            most = RANGE_HITS_PCT if is_error else CLIPPED_PCT
            what = f"{hits:.1f} % of the samples at the end of the range: expected up to {most:g} %"
            findings.append(Finding(topic=topic, what=what, is_error=is_error))
    if block is not None and info.count >= _MIN_SAMPLES:
        row["force_m_s2"], row["rests"] = force_at_rest(t_ns, block.columns["specific_force"])
        for implausible in find_implausible_values(block):
            findings.append(Finding(topic=topic, what=str(implausible), is_error=implausible.is_error))
        if topic.startswith("/foot_") and block.kind is Imu and not row["rests"]:
            what = "never rests as a foot does in every stance, so that foot_ins has no path; is it worn on a foot?"
            findings.append(Finding(topic=topic, what=what, is_error=False))
    return row, [f for f in findings if not _is_known(recording, f)]


def _is_known(recording: Recording, finding: Finding) -> bool:
    """Whether the recording has a finding already: as a problem of the same topic, or as a warning, with its text."""
    if any(problem.topic == finding.topic and finding.what in problem.what for problem in recording.problems):
        return True
    return not finding.is_error and any(finding.what in warning for warning in recording.warnings)


def _timing(t_ns: NDArray[np.int64]) -> Timing:
    """Jitter and gaps of stamps (N,), ns; all zero with fewer than three stamps.

    Jitter is the scaled median absolute deviation of the steps; a gap is a step of more than `GAP_PERIODS` periods.
    """
    if len(t_ns) < 3:
        return {"jitter_ms": 0.0, "gaps": 0, "longest_gap_s": 0.0, "longest_gap_at_s": 0.0}
    step = np.diff(t_ns)
    period = float(np.median(step))
    at = int(np.argmax(step))  # the sample before the longest step
    return {
        # 1.4826 times the median absolute deviation is the standard deviation of a normal distribution
        "jitter_ms": 1.4826 * float(np.median(np.abs(step - period))) * 1e-6,
        "gaps": int(np.sum(step > GAP_PERIODS * period)),
        "longest_gap_s": float(step[at]) * 1e-9,
        "longest_gap_at_s": float(t_ns[at]) * 1e-9,
    }


def _read_from_rig(recording: Recording, topic: str) -> tuple[float, bool | None]:
    """What the calibration of a recording says about a topic.

    Returns:
        The rate that it declares, Hz, or 0 if there is none; and whether it has the sensor. None in place of the latter
        stands for a stream of the truth, which needs no calibration.
    """
    if topic.startswith("/truth/"):
        return 0.0, None
    if not recording.has_rig:
        return 0.0, False
    rig = recording.rig
    for camera in rig.cameras.values():
        if topic in (camera.topic, camera.depth_topic):
            return camera.rate_hz, True
    sensor = rig.imus.get(topic) or rig.others.get(topic)
    return (sensor.rate_hz, True) if sensor is not None else (0.0, False)
