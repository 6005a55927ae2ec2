"""Speed and memory of the estimators: foot INS, foot-to-foot, contact terrain and visual-inertial odometry.

Times are CPU times unless a name says otherwise. Memory is the growth of the process's peak from the end of the first
repetition (foot INS: of the first minute) to the end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import takewhile

import numpy as np

from benchmarks.speed.timing import Replay, Stopwatch, Summary, peak_mib, recorded
from stridetwin.estimators.base import Options
from stridetwin.estimators.contact_terrain import METHODS, ContactTerrain, Exoskeleton
from stridetwin.estimators.dvio import Dvio
from stridetwin.estimators.dvio.filter import MAX_WAITING_IMAGES
from stridetwin.estimators.foot_ins import FootIns, FootInsParameters, FootInsSmoother
from stridetwin.estimators.foot_to_foot import FootToFoot
from stridetwin.scenarios.exo_geometry import true_geometry
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.twin import Twin
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Block, Depth, Image, Imu, Range, Sample
from stridetwin.studies.shim2019 import shim_table5
from stridetwin.studies.walks import CAMERAS, IMUS, SHOES, SONARS
from stridetwin.studies.zhao2023 import odometry_walks

RATE_HZ = 200
STRIDE_S = 1.1
BLOCK_S = 10
GRAVITY = FootInsParameters().gravity_mps2
MOUNT = "chest"
WARM_UP_NS = 4_000_000_000


def foot_ins(minutes: float) -> Summary:
    """Foot INS and its smoother on a synthetic foot IMU at 200 Hz: `run` on blocks of 10 s, `update` on samples."""
    first = next(_blocks(1.0))
    for estimator in (FootIns(), FootInsSmoother()):
        estimator.run(first)  # compiles
    return {
        "run": _block_figures(FootIns().run, minutes),
        "update": _block_figures(_sample_by_sample(FootIns()), minutes),
        "smoother, update": _block_figures(_sample_by_sample(FootInsSmoother()), minutes),
    }


def _block_figures(process: Callable[[Block[Imu]], object], minutes: float) -> dict[str, float]:
    watch, first_peak_mib = Stopwatch(), 0.0
    for i, block in enumerate(_blocks(minutes)):
        watch.time(lambda: process(block))  # noqa: B023
        if i == 60 // BLOCK_S - 1:
            first_peak_mib = peak_mib()
    return {
        "times_real_time": 60.0 * minutes / watch.cpu_s,
        "microseconds_per_sample": 1e6 * watch.cpu_s / (60.0 * minutes * RATE_HZ),
        "memory_growth_mib": peak_mib() - first_peak_mib,
    }


def _sample_by_sample(estimator: FootIns | FootInsSmoother) -> Callable[[Block[Imu]], None]:
    def process(block: Block[Imu]) -> None:
        for sample in block:
            estimator.update(sample)

    return process


def _blocks(minutes: float) -> Iterator[Block[Imu]]:
    """Repeated strides in blocks of 10 s, after one second of rest."""
    rate, force = _stride()
    n = BLOCK_S * RATE_HZ
    for start in range(0, round(60 * minutes * RATE_HZ), n):
        k = np.arange(start, start + n)
        row = np.maximum(k - RATE_HZ, 0) % len(rate)  # a stride starts at rest
        columns = {"angular_rate": rate[row], "specific_force": force[row]}
        yield Block(topic="/foot_l/imu", kind=Imu, t_ns=(k + 1) * (10**9 // RATE_HZ), columns=columns)


def _stride() -> tuple[Array, Array]:
    """Angular rate (N, 3), rad/s, and specific force (N, 3), m/s²: a stance, then a swing that pitches and advances."""
    n = round(STRIDE_S * RATE_HZ)
    u = np.clip((np.arange(n) / n - 0.5) / 0.4, 0.0, 1.0)
    rate, forward = np.zeros((n, 3)), 12.0 * np.sin(2 * np.pi * u)
    rate[:, 1] = 4.0 * np.sin(2 * np.pi * u)
    pitch = np.cumsum(rate[:, 1]) / RATE_HZ
    c, s = np.cos(pitch), np.sin(pitch)
    return rate, np.column_stack([c * forward - s * GRAVITY, np.zeros(n), s * forward + c * GRAVITY])


def foot_to_foot(minutes: float, seed: int) -> Summary:
    """Foot-to-foot filter with board detection on both shoe cameras at 60 Hz; the walk `level_20m`, replayed."""
    config = replace(load_scenario("level_20m").config, sensors=SHOES)
    with recorded(config, seed) as walk:
        _two_foot_figures(walk, 1)  # compiles
        return {"both cameras": _two_foot_figures(walk, max(2, round(60.0 * minutes / walk.duration)))}


def _two_foot_figures(walk: Recording, repetitions: int) -> dict[str, float]:
    topics = (*IMUS, *CAMERAS, *SONARS)
    replay = Replay(read=lambda: walk.samples(topics), repetitions=repetitions, span_ns=round(walk.duration * 1e9))
    estimator, filtering, whole = FootToFoot(walk.rig), Stopwatch(), Stopwatch()
    boards = images = 0

    def process() -> None:
        nonlocal boards, images
        for _, sample in replay:
            assert isinstance(sample, Imu | Image | Range)
            estimate = filtering.time(lambda: estimator.update(sample))  # noqa: B023
            images += isinstance(sample, Image)
            boards += len(estimate.observations) if estimate else 0

    whole.time(process)
    length_s = walk.duration * repetitions
    return {
        "times_real_time": length_s / filtering.cpu_s,
        "times_real_time_with_reading": length_s / whole.cpu_s,
        "images_per_s": images / length_s,
        "boards_detected_pct": 100.0 * boards / images,
        "minutes": length_s / 60.0,
        "memory_growth_mib": replay.memory_growth_mib,
    }


def contact_terrain(minutes: float, seed: int) -> Summary:
    """Contact terrain by each method: time of the nine samples of one instant; the walk `shim_stairs`, replayed."""
    config = replace(load_scenario("shim_stairs").config, sensors=("ahrs", "encoder", "insole"), physics="kinematic")
    twin = Twin(config, seed)
    samples, _ = shim_table5.simulate_walk(twin)
    exo, length_s = true_geometry(twin.size, twin.rig), 1e-9 * (samples[-1].t_ns - samples[0].t_ns)
    summary = {}
    for method in METHODS:
        _terrain_figures(exo, method, samples, 1)  # compiles
        summary[method] = _terrain_figures(exo, method, samples, max(2, round(60.0 * minutes / length_s)))
    return summary


def _terrain_figures(exo: Exoskeleton, method: str, samples: Sequence[Sample], repetitions: int) -> dict[str, float]:
    span_ns = samples[-1].t_ns - samples[0].t_ns + 10_000_000
    replay, watch = Replay(read=lambda: samples, repetitions=repetitions, span_ns=span_ns), Stopwatch()
    estimator, instants = (
        ContactTerrain(Rig(), options=Options(method=method), exoskeleton=exo),
        len({s.t_ns for s in samples}) * repetitions,
    )
    for _, sample in replay:
        watch.time(lambda: estimator.update(sample))  # noqa: B023
    return {
        "ms_per_instant": 1e3 * watch.cpu_s / instants,
        "instants": instants,
        "memory_growth_mib": replay.memory_growth_mib,
    }


def dvio(walks: int, seed: int, scenario: str) -> Summary:
    """Visual-inertial odometry per frame, without decoding, on a kinematic closed loop with the camera on the chest.

    `ms_per_frame` is wall-clock time on as many cores as OpenCV uses. `max_latency_ms` is the longest delay from the
    arrival of a sample to its result when samples arrive in real time. `dropped` counts the frames that would find more
    frames waiting than the odometry buffers.
    """
    config = replace(
        load_scenario(scenario).config, sensors=("head_imu", "head_camera"), rig_mount=MOUNT, physics="kinematic"
    )
    with recorded(config, seed) as walk:
        samples = odometry_walks.odometry_samples(walk, MOUNT)
        odometry_walks.run_odometry(
            Dvio(walk.rig, options=Options(mount=MOUNT)), takewhile(lambda s: s.t_ns < WARM_UP_NS, samples)
        )  # compiles
        return {scenario: _frame_figures(walk, max(2, walks))}


def _frame_figures(walk: Recording, repetitions: int) -> dict[str, float]:
    replay = Replay(
        read=lambda: odometry_walks.odometry_samples(walk, MOUNT),
        repetitions=repetitions,
        span_ns=round(walk.duration * 1e9),
    )
    odometry = Dvio(walk.rig, options=Options(mount=MOUNT))
    arrived_s: list[float] = []
    seconds: list[Array] = []
    is_image: list[bool] = []
    watch = Stopwatch()
    for _, sample in replay:
        assert isinstance(sample, Imu | Image | Depth)
        watch.reset()
        watch.time(lambda: odometry.update(sample))  # noqa: B023
        seconds.append(watch.seconds)
        arrived_s.append(sample.t_ns * 1e-9)
        is_image.append(isinstance(sample, Image))
    spent, frames = np.array(seconds), np.flatnonzero(is_image)
    frame_ms = 1e3 * np.add.reduceat(spent, frames)[:-1]
    late = latency(np.array(arrived_s), spent[:, 1])
    period_s = float(np.median(np.diff(np.array(arrived_s)[frames])))
    wall_ms = odometry_walks.time_statistics(frame_ms[:, 1])
    return {
        "ms_per_frame": wall_ms["mean"],
        "ms_per_frame_p99": wall_ms["p99"],
        "cpu_ms_per_frame": float(frame_ms[:, 0].mean()),
        "max_latency_ms": 1e3 * float(late.max()),
        "dropped": int((late[frames] > MAX_WAITING_IMAGES * period_s).sum()),
        "frames": len(frame_ms),
        "memory_growth_mib": replay.memory_growth_mib,
    }


def latency(arrived_s: Array, spent_s: Array) -> Array:
    """Delay from the arrival of each sample to its result.

    Args:
        arrived_s: (N,) when each sample arrives, s.
        spent_s: (N,) time that its processing takes, s.

    Returns:
        (N,) s; a sample waits until those before it are processed.
    """
    done = np.cumsum(spent_s)
    # the last time at which no sample waited decides: done = max over j <= i of arrived[j] + spent[j..i]
    return np.asarray(np.maximum.accumulate(arrived_s - done + spent_s) + done - arrived_s)
