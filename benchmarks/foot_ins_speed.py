"""How fast the one-foot inertial navigation is on one core, and whether its memory stays the same over an hour.

`python -m benchmarks.foot_ins_speed [--json] [--minutes 60]`. A walk of a foot IMU at 200 Hz, made from nothing but a
stride that repeats, goes through `run` in blocks of ten seconds, through `update` sample by sample, and through that of
the smoother. Time is the processor's. Memory is the growth of the process's peak from the first minute to the last.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from benchmarks.command import answer, command, show_summary
from stridetwin.estimators.foot_ins import FootIns, FootInsSmoother
from stridetwin.streams.samples import Array, Block, Imu

RATE_HZ = 200
STRIDE_S = 1.1
BLOCK_S = 10
GRAVITY = 9.8029  # m/s²


def stride() -> tuple[Array, Array]:
    """Angular rate (N, 3) and specific force (N, 3) of one stride: a stance, then a swing that pitches and advances."""
    n = round(STRIDE_S * RATE_HZ)
    u = np.clip((np.arange(n) / n - 0.5) / 0.4, 0.0, 1.0)
    rate, ahead = np.zeros((n, 3)), 12.0 * np.sin(2 * np.pi * u)
    rate[:, 1] = 4.0 * np.sin(2 * np.pi * u)
    pitch = np.cumsum(rate[:, 1]) / RATE_HZ
    c, s = np.cos(pitch), np.sin(pitch)
    return rate, np.column_stack([c * ahead - s * GRAVITY, np.zeros(n), s * ahead + c * GRAVITY])


def blocks(minutes: float) -> Iterator[Block[Imu]]:
    """The walk, ten seconds at a time, after a second of rest."""
    rate, force = stride()
    n = BLOCK_S * RATE_HZ
    for start in range(0, round(60 * minutes * RATE_HZ), n):
        k = np.arange(start, start + n)
        row = np.maximum(k - RATE_HZ, 0) % len(rate)  # a stride begins at rest
        columns = {"angular_rate": rate[row], "specific_force": force[row]}
        yield Block(topic="/foot_l/imu", kind=Imu, t_ns=(k + 1) * (10**9 // RATE_HZ), columns=columns)


def peak_mib() -> float:
    """Peak of this process's resident memory so far, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def figures(take: Callable[[Block[Imu]], object], minutes: float) -> dict[str, float]:
    """Speed of what takes the blocks, and the growth of the memory's peak since the first minute."""
    spent_s, before = 0.0, 0.0
    for i, block in enumerate(blocks(minutes)):
        begin = time.process_time()
        take(block)
        spent_s += time.process_time() - begin
        if i == 60 // BLOCK_S - 1:
            before = peak_mib()
    return {
        "times_real_time": 60.0 * minutes / spent_s,
        "microseconds_a_sample": 1e6 * spent_s / (60.0 * minutes * RATE_HZ),
        "memory_growth_mib": peak_mib() - before,
    }


def one_by_one(estimator: FootIns | FootInsSmoother) -> Callable[[Block[Imu]], None]:
    """Feeds a block to `update`."""

    def take(block: Block[Imu]) -> None:
        for sample in block:
            estimator.update(sample)

    return take


def measure(minutes: float) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    first = next(blocks(1.0))
    for estimator in (FootIns(), FootInsSmoother()):
        estimator.run(first)  # compiles
    return {
        "experiment": "foot_ins_speed",
        "minutes": minutes,
        "summary": {
            "run": figures(FootIns().run, minutes),
            "update": figures(one_by_one(FootIns()), minutes),
            "smoother, update": figures(one_by_one(FootInsSmoother()), minutes),
        },
    }


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="length of the walk (60)")
    return answer(parser, lambda a: measure(a.minutes), show_summary(24, "8.1f"))


if __name__ == "__main__":
    sys.exit(main())
