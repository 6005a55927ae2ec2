"""The twin's foot IMU compared with real ones on level walks.

`python -m benchmarks.realism [--json]`. The real feet are those of `dual_foot_walk` (both shoes, 204.8 Hz, 16 g), found
by `benchmarks.real_walks`. The twin walks `level_20m` six times at their speed, with a cheap part of the same rate and
range at the same place: beside the ankle, where the samples fit the motion of the recorded feet's markers best. Both
are evaluated in the same way; a figure of the twin is realistic if it is 0.5-2 times the real one.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.command import answer, command
from benchmarks.foot_ins_twin import join_blocks
from benchmarks.people_feet import BESIDE_ANKLE_M
from benchmarks.real_walks import data_folder, load_markers
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.config import Gait
from stridetwin.sim.parts.kinds import ImuPart
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Array, Block, Imu

SEEDS = range(1000, 1006)
SPEED_MPS = 1.3  # of the recorded strides
STILL_RADPS, STILL_S = 0.6, 0.10  # stance: the mean rate over this time stays below
STRIDE_S = 1.2
ABOVE_HZ = 20.0
SATURATED = 0.995  # of the range
REALISTIC = (0.5, 2.0)


def matched_part(real: Block[Imu]) -> ImuPart:
    """A cheap part with the rate of a recording and, like it, the full bandwidth of that rate."""
    cheap = load_part("MPU-9250")
    assert isinstance(cheap, ImuPart)
    rate_hz = 1e9 / float(np.median(np.diff(real.t_ns)))
    return replace(
        cheap,
        rate_hz=rate_hz,
        gyroscope=replace(cheap.gyroscope, bandwidth_hz=184.0),  # DLPFCFG 1
        accelerometer=replace(cheap.accelerometer, bandwidth_hz=218.1),
    )


def figures(imu: Block[Imu], range_mps2: float) -> dict[str, float]:
    """Signal figures of a foot's IMU in a walk.

    Returns:
        RMS of rate and of specific force's magnitude minus gravity in stance, 95th percentile over strides of the
        largest rate and of the largest specific force, share of the specific force's variance above 20 Hz, and share of
        samples in saturation.
    """
    rate, force = imu.columns["angular_rate"], imu.columns["specific_force"]
    speed, push = np.linalg.norm(rate, axis=1), np.linalg.norm(force, axis=1)
    hz = 1e9 / float(np.median(np.diff(imu.t_ns)))
    window = round(STILL_S * hz)
    walking = _walking(speed, hz)
    stance = (np.convolve(speed, np.ones(window) / window, mode="same") < STILL_RADPS) & walking
    density = np.abs(np.fft.rfft(force[walking] - force[walking].mean(axis=0), axis=0)) ** 2
    high = np.fft.rfftfreq(int(walking.sum()), 1 / hz) > ABOVE_HZ
    return {
        "stance_rate_rms_radps": float(np.sqrt(np.mean(speed[stance] ** 2))),
        "stance_force_rms_mps2": float(np.sqrt(np.mean((push[stance] - NOMINAL_GRAVITY_MPS2) ** 2))),
        "peak_rate_radps": _peak(speed[walking], hz),
        "peak_force_mps2": _peak(push[walking], hz),
        "force_above_20hz_pct": float(100 * density[high].sum() / density.sum()),
        "saturated_pct": float(100 * np.mean(np.any(np.abs(force[walking]) > SATURATED * range_mps2, axis=1))),
    }


def _walking(speed: Array, hz: float) -> Any:
    """Samples within a stride of a fast one, which excludes standing at the start, in between and at the end."""
    fast = np.flatnonzero(speed > 4.0) / hz
    return np.array([np.min(np.abs(fast - k / hz)) < STRIDE_S / 2 for k in range(len(speed))])


def _peak(values: Array, hz: float) -> float:
    count = int(len(values) / (STRIDE_S * hz))
    return float(np.percentile([piece.max() for piece in np.array_split(values, count)], 95))


def twin_feet(imu: ImuPart) -> list[Block[Imu]]:
    """Both feet of walks on the level."""
    config = replace(
        load_scenario("level_20m").config,
        gait=Gait(speed_mps=SPEED_MPS),
        sensors=("foot_imu",),
        fittings={"foot_imu": SensorConfig(part=imu, position_m=BESIDE_ANKLE_M)},
    )
    feet = []
    for seed in SEEDS:
        chunks = [{b.topic: b for b in chunk if isinstance(b, Block)} for chunk in Twin(config, seed).blocks()]
        feet += [join_blocks([c[f"/foot_{side}/imu"] for c in chunks]) for side in "lr"]
    return feet


def measure() -> dict[str, Any]:
    """Real and simulated figures, means over feet and walks, and their ratio.

    Raises:
        StrideTwinError: The real recordings are missing.
    """
    folder = data_folder()
    if folder is None:
        raise StrideTwinError("the real recordings are not there; set STRIDETWIN_DATA to their folder")
    real = [walk.imu for walk in load_markers(folder)]
    imu = matched_part(real[0])
    limit = imu.accelerometer.range
    rows = {}
    tables = [[figures(b, limit) for b in feet] for feet in (real, twin_feet(imu))]
    for name in tables[0][0]:
        of_real, of_twin = (float(np.mean([t[name] for t in table])) for table in tables)
        ratio = of_twin / of_real if of_real else float("nan")
        rows[name] = {
            "real": of_real,
            "twin": of_twin,
            "ratio": ratio,
            "realistic": REALISTIC[0] <= ratio <= REALISTIC[1],
        }
    return {"experiment": "realism", "summary": rows, "paper": {}, "cases": []}


def show(result: dict[str, Any]) -> None:
    """Prints one line per figure."""
    print(f"{'':26}{'real':>10}{'twin':>10}{'ratio':>8}")
    for name, row in result["summary"].items():
        mark = "" if row["realistic"] else "  beyond 0.5-2"
        print(f"{name:26}{row['real']:10.3f}{row['twin']:10.3f}{row['ratio']:8.2f}{mark}")


def main() -> int:
    """Command line."""
    return answer(command(__doc__), lambda _: measure(), show)


if __name__ == "__main__":
    sys.exit(main())
