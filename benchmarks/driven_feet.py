"""The twin's foot IMU driven by markers of real feet, beside the real IMU of the same walk.

`python -m benchmarks.driven_feet [--seeds 10] [--json]`. Both feet of `dual_foot_walk` (three markers a foot, found by
`benchmarks.real_walks`) become rigid motions: markers filtered at 15 Hz without delay, soles and balls pinned to the
ground while they rest (`sim.motion.feet`), quintic splines. Three markers hardly show the roll of a foot whose toes
bend, so its scatter is taken into account. The sensor sits where the real one was (least squares),
on the shoe of the twin, and is a cheap part with the real one's rate and range, whose scale and alignment errors are
those of a calibrated one. Each seed draws a part and a shoe. Rows: the real IMU, the driven one with part and shoe, the
same with forces that are as late as the real ones (`find_delays`), and with part or shoe left out. A figure is good if
it is 0.7-1.4 times the real one. Also the scatter of the height of a stride, each floor new.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from benchmarks.command import answer, command
from benchmarks.people_feet import FootSignals, find_strides, sagittal_rate
from benchmarks.real_walks import MarkerWalk, data_folder, load_markers, match_rests, rests
from benchmarks.realism import matched_part
from stridetwin.estimators.foot_ins import FootIns, FootInsParameters
from stridetwin.sim.gait.heel_strike import SHOE, ShoeParameters, UpperMotion
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.motion.feet import ground_foot
from stridetwin.sim.motion.parameters import MotionParameters
from stridetwin.sim.motion.rests import FootRest, FootTrack, find_stances
from stridetwin.sim.motion.skeleton import Skeleton
from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import ImuPart
from stridetwin.sim.parts.library import make_ideal
from stridetwin.sim.people import Person
from stridetwin.sim.sensors.imu import ImuModel
from stridetwin.sim.walk import Stance
from stridetwin.sim.wearer.dimensions import Shoe
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.rig import ImuCalibration, Mount
from stridetwin.streams.samples import Array, Block, Imu

GOOD = (0.7, 1.4)
PLANE = "2-D RMSE at rests, m"
BANDS_HZ = ((0.0, 5.0), (5.0, 20.0), (20.0, 50.0), (50.0, 100.0))
_MARKERS_HZ = 15.0  # of the filter on the markers
_MOUNT_HZ = 12.0  # of the filter under which the place of the sensor is found
_MARKER_SD_M, _ROLL_SD_RAD = 0.002, np.radians(4.0)  # of a marker on a soft shoe, and of the roll of a foot that walks
# Sway of a standing foot over the twin's: before they set off, the rates of these feet have means over 0.2 s that
# differ by no more than their noise, 0.001 rad/s; the twin's sway has 0.006, which is that of the rests at the end.
_SWAY = 0.15
_HEIGHT_M = 1.75  # of the person, whose shoe pins the feet
_HEEL_OVER_SOLE_M, _HEEL_BEHIND_M = 0.040, 0.010  # the heel marker's centre above and behind the sole's border
# What a calibration leaves: scale and alignment as in `recorded_foot_imu.yaml`; biases as the recorded parts have them
# where they rest longest (0.09 °/s RMS of the axes; forces of 9.82 and 9.84 m/s²).
_SCALE, _MISALIGNMENT_RAD = 0.003, np.radians(0.2)
_GYRO_BIAS_RADPS, _ACCEL_BIAS_MPS2 = np.radians(0.09), 0.02
_G_SENSITIVITY = np.radians(0.01) / NOMINAL_GRAVITY_MPS2  # rad/s per m/s²
_FORCE_LATE_S = 0.0038  # of both real IMUs, after their rates: `find_delays`, and by their filters (docs/sensors.md)
_DELAY_HZ = (0.5, 6.0)  # of the motion by which delays are found: faster ones are the shoe's and the markers' filter's
_SETTINGS = ("part and shoe", "late part and shoe", "part alone", "shoe alone", "ideal")


@dataclass(frozen=True, kw_only=True, eq=False)
class DrivenFoot:
    """The motion of one recorded foot, and where its sensor sits.

    Attributes:
        walk: The recording.
        dt: Time between two rows of the path, s.
        track: Pinned path of the foot at the times of the markers.
        stances: Its stances.
        p_sensor_in_foot: (3,) m.
        R_foot_sensor: (3, 3) sensor to foot.
    """

    walk: MarkerWalk
    dt: float
    track: FootTrack
    stances: Sequence[FootRest]
    p_sensor_in_foot: Array
    R_foot_sensor: Array

    def motion(self, t: Array) -> Track:
        """Track of the rigid foot at (N,) s, by quintic splines."""
        grid = np.arange(len(self.track.p)) * self.dt
        q = Rotation.from_matrix(self.track.R).as_quat(canonical=False)
        q[1:] *= np.cumprod(np.sign((q[1:] * q[:-1]).sum(1)))[:, None]  # no jumps of the sign
        place, turn = make_interp_spline(grid, self.track.p, k=5), make_interp_spline(grid, q, k=5)
        value, rate = turn(t), turn(t, 1)
        size = np.linalg.norm(value, axis=1, keepdims=True)
        value, rate = value / size, rate / size
        rate -= (value * rate).sum(1, keepdims=True) * value
        vector, scalar = value[:, :3], value[:, 3:]
        # ω = 2 q̄ ⊗ q' in the foot's axes
        w = 2.0 * (scalar * rate[:, :3] - rate[:, 3:] * vector - np.cross(vector, rate[:, :3]))
        return Track(
            t_ns=np.round(t * 1e9).astype(np.int64),
            p_body_in_world=place(t),
            q_world_body=np.roll(value, 1, axis=1),
            v_body_in_world=place(t, 1),
            w_body=w,
        )

    def pitch(self, t: Array) -> Array:
        """(N,) rad at (N,) s, toes down positive."""
        pitch = np.arcsin(np.clip(-self.track.R[:, 2, 0], -1.0, 1.0))
        return np.interp(t, np.arange(len(pitch)) * self.dt, pitch)

    def upper(self, shoe: ShoeParameters, rng: np.random.Generator) -> UpperMotion:
        """Motion of the shoe's upper at the sensor."""
        end = len(self.track.p)
        steps = [
            Stance(
                foot=rest.side,
                p_foot_in_world=rest.p,
                R_world_sole=np.eye(3),
                terrain="level",
                mode="LG",
                t_touch=rest.ground[0] * self.dt if rest.ground[0] else -np.inf,
                t_off=rest.ground[1] * self.dt if rest.ground[1] < end else np.inf,
            )
            for rest in self.stances
        ]

        def speed(t: Array) -> Array:
            """(N,) m/s of the foot's origin at (N,) s."""
            return np.linalg.norm(self.motion(np.maximum(t, 0.0)).v_body_in_world, axis=1)

        return UpperMotion.of(steps, self.pitch, speed, self.p_sensor_in_foot, rng, shoe)


def _low_pass(x: Array, hz: float, rate_hz: float) -> Array:
    return np.asarray(sosfiltfilt(butter(4, hz, fs=rate_hz, output="sos"), x, axis=0))


def fit_foot(walk: MarkerWalk, shoe: Shoe, side: str) -> tuple[float, FootTrack, list[FootRest]]:
    """The rigid, pinned motion of a foot from its three markers: time step in s, path and stances.

    The foot's frame follows from the median shape of the markers while the foot is flat: x from the heel's marker to
    the toes', z up, and the sole on the floor.

    Args:
        walk: The recording.
        shoe: Sole of the shoe.
        side: `l` or `r`.
    """
    dt = float(walk.t[1] - walk.t[0])
    points = _low_pass(np.stack([walk.heel, walk.toe, walk.side], axis=1), _MARKERS_HZ, 1.0 / dt)
    speed = np.linalg.norm(np.gradient(points, dt, axis=0), axis=2).max(1)
    flat = speed < np.percentile(speed, 15)
    floor = float(np.median(points[flat][:, 0, 2])) - _HEEL_OVER_SOLE_M
    x = points[:, 1] - points[:, 0]
    x[:, 2] = 0.0
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.stack([-x[:, 1], x[:, 0], np.zeros(len(x))], axis=1)
    heel = points[:, 0] + (_HEEL_BEHIND_M - shoe.heel_back_x) * x
    origin = np.stack([heel[:, 0], heel[:, 1], np.full(len(x), floor)], axis=1)
    level = np.stack([x, y, np.tile([0.0, 0.0, 1.0], (len(x), 1))], axis=2)
    local = np.median(np.einsum("nji,nkj->nki", level, points - origin[:, None])[flat], axis=0)  # (3, 3) m in the foot
    centre = points.mean(1, keepdims=True)
    R = np.stack(
        [Rotation.align_vectors(p - c, local - local.mean(0))[0].as_matrix() for p, c in zip(points, centre[:, 0])]
    )
    ends = [0, 1]  # heel and toes, whose line the foot rolls about
    R = _shrink_roll(R, local)
    p = points[:, ends].mean(1) - R @ local[ends].mean(0)
    p[:, 2] -= floor
    parameters = MotionParameters()
    track = FootTrack(side=side, p=p, R=R, toe=np.zeros(len(p)))
    stances = find_stances(track, shoe, dt, parameters)
    zero = np.zeros(len(stances))
    pinned = ground_foot(track, stances, zero, zero, shoe, lambda xy: np.zeros(np.shape(xy)[:-1]), dt, parameters)
    return dt, pinned, stances


def _shrink_roll(R: Array, local: Array) -> Array:
    """(N, 3, 3) orientations whose roll is the most probable one, given its scatter and that of the markers.

    The third marker shows the roll by its distance from the line of the other two alone; where the toes bend it leaves
    that line, although the foot does not roll.

    Args:
        R: (N, 3, 3) orientations that fit the markers, foot to world.
        local: (3, 3) m, places of heel, toes and side in the foot.
    """
    line = (local[1] - local[0]) / np.linalg.norm(local[1] - local[0])
    arm_m = float(np.linalg.norm(np.cross(line, local[2] - local[0])))
    information = 2.0 / 3.0 * (arm_m / _MARKER_SD_M) ** 2  # of three markers whose mean is free
    angles = Rotation.from_matrix(R).as_euler("ZYX")
    angles[:, 2] *= information / (information + _ROLL_SD_RAD**-2)
    return np.asarray(Rotation.from_euler("ZYX", angles).as_matrix())


def find_mount(walk: MarkerWalk, foot: DrivenFoot) -> tuple[Array, Array]:
    """Place (3,) m of the real sensor in the foot, and rotation (3, 3) sensor to foot, by least squares below 12 Hz."""
    t = walk.imu.t_ns * 1e-9
    inside = (t > 0.5) & (t < walk.t[-1] - 0.5)
    hz = 1.0 / float(np.median(np.diff(t)))
    motion = foot.motion(np.clip(t, 0.0, walk.t[-1]))
    real_rate, real_force = (
        _low_pass(walk.imu.columns[name], _MOUNT_HZ, hz) for name in ("angular_rate", "specific_force")
    )
    w = _low_pass(motion.w_body, _MOUNT_HZ, hz)
    R = Rotation.align_vectors(w[inside], real_rate[inside])[0].as_matrix()
    acceleration = np.gradient(motion.v_body_in_world, 1.0 / hz, axis=0) + [0.0, 0.0, NOMINAL_GRAVITY_MPS2]
    force = _low_pass(motion.rotation.inv().apply(acceleration), _MOUNT_HZ, hz)
    spin = np.gradient(w, 1.0 / hz, axis=0)
    # the force at an arm is that of the origin + (α× + ω×ω×) arm
    arm = np.stack([np.cross(spin, e) + np.cross(w, np.cross(w, e)) for e in np.eye(3)], axis=2)
    missing = real_force @ R.T - force
    place = np.linalg.lstsq(arm[inside].reshape(-1, 3), missing[inside].ravel(), rcond=None)[0]
    return place, R


def find_delays(foot: DrivenFoot) -> tuple[float, float]:
    """How much later than the markers the rates and the forces of the real sensor are, s, by correlation.

    Rates on a shoe that settles seem later by 1.4 ms; forces are right within 0.3 ms (driven sensors).
    """
    real, ideal = foot.walk.imu, simulate(foot, "ideal", 0)
    t, n = ideal.t_ns * 1e-9, len(ideal.t_ns)
    band = butter(3, _DELAY_HZ, "bandpass", fs=1.0 / float(np.median(np.diff(t))), output="sos")
    shifts = np.arange(-0.012, 0.0121, 0.0005)
    inside = (t > 1.5) & (t < t[-1] - 1.5)  # without the ends of the filters
    delays: list[float] = []
    for name in ("angular_rate", "specific_force"):
        measured, driven = (sosfiltfilt(band, block.columns[name][:n], axis=0) for block in (real, ideal))
        spline = make_interp_spline(t, driven, k=3)
        likeness = []
        for shift in shifts:
            shifted = spline(t[inside] - shift)
            likeness.append(float((measured[inside] * shifted).sum() / np.sqrt((shifted**2).sum())))
        best = int(np.argmax(likeness[1:-1])) + 1
        before, peak, after = likeness[best - 1 : best + 2]  # the top of a parabola through three points
        delays.append(shifts[best] + 0.0005 * 0.5 * (before - after) / (before - 2.0 * peak + after))
    return float(delays[0]), float(delays[1])


def drive(walk: MarkerWalk, shoe: Shoe) -> DrivenFoot:
    """The driven foot of a recording."""
    dt, track, stances = fit_foot(walk, shoe, walk.name[0])
    foot = DrivenFoot(
        walk=walk, dt=dt, track=track, stances=stances, p_sensor_in_foot=np.zeros(3), R_foot_sensor=np.eye(3)
    )
    place, R = find_mount(walk, foot)
    return replace(foot, p_sensor_in_foot=place, R_foot_sensor=R)


def make_calibrated_part(real: Block[Imu]) -> ImuPart:
    """A cheap part of a recording's rate with the scale and alignment errors that a calibration leaves."""
    part = matched_part(real)
    left = {"scale_factor": _SCALE, "misalignment": _MISALIGNMENT_RAD}
    return replace(
        part,
        gyroscope=replace(part.gyroscope, turn_on_bias=_GYRO_BIAS_RADPS, g_sensitivity=_G_SENSITIVITY, **left),
        accelerometer=replace(part.accelerometer, turn_on_bias=_ACCEL_BIAS_MPS2, **left),
    )


def simulate(foot: DrivenFoot, setting: str, seed: int) -> Block[Imu]:
    """Samples of the driven sensor at the times of the real one.

    Args:
        foot: The driven foot.
        setting: Of `_SETTINGS`.
        seed: Draws part and strikes.
    """
    has_part, has_shoe = "part" in setting, "shoe" in setting
    t_ns = foot.walk.imu.t_ns
    t_ns = t_ns[t_ns * 1e-9 < (len(foot.track.p) - 1) * foot.dt - 0.05]
    part = make_calibrated_part(foot.walk.imu)
    noise = Noise(None)
    if has_part:
        noise = Noise.of_topic(seed, foot.walk.name)
        if setting.startswith("late"):
            part = replace(part, accelerometer=replace(part.accelerometer, delay_s=_FORCE_LATE_S))
    else:
        part = replace(make_ideal(part), rate_hz=part.rate_hz)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = foot.R_foot_sensor, foot.p_sensor_in_foot
    calibration = ImuCalibration(
        topic="/foot/imu",
        part="",
        rate_hz=part.rate_hz,
        mount=Mount(body="foot", T_body_sensor=T),
        gyroscope_noise_density=0.0,
        gyroscope_random_walk=0.0,
        accelerometer_noise_density=0.0,
        accelerometer_random_walk=0.0,
    )
    model = ImuModel(calibration, part, noise)
    inner = np.interp(
        np.arange((len(t_ns) - 1) * model.steps + 1), np.arange(len(t_ns)) * model.steps, t_ns * 1e-9 + model.delay_s
    )
    body = foot.motion(inner)
    if has_shoe:
        shoe = replace(SHOE, sway_rate=_SWAY * SHOE.sway_rate)
        body = foot.upper(shoe, np.random.default_rng(seed)).upper_track(body)
    return model.read(body, t_ns)


def signal_figures(foot: DrivenFoot, imu: Block[Imu]) -> dict[str, float]:
    """RMS of force and rate by band, and percentiles of the peaks over strides."""
    t = imu.t_ns * 1e-9
    hz = 1.0 / float(np.median(np.diff(t)))
    rate, force = imu.columns["angular_rate"], imu.columns["specific_force"]
    result = {}
    for name, values in (("force_mps2", force), ("rate_radps", rate)):
        power = (np.abs(np.fft.rfft(values - values.mean(0), axis=0)) ** 2).sum(1) * 2.0 / len(values) ** 2
        f = np.fft.rfftfreq(len(values), 1.0 / hz)
        for low, high in BANDS_HZ:
            result[f"{name} {low:g}-{high:g} Hz"] = float(np.sqrt(power[(f >= low) & (f < high)].sum()))
    heel, toe = (
        np.column_stack([np.interp(t, foot.walk.t, m[:, k]) for k in range(3)]) for m in (foot.walk.heel, foot.walk.toe)
    )
    signals = FootSignals(t=t, rate=rate, force=force, heel=heel, toe=toe, planned_touch=np.empty(0))
    size, turning = np.linalg.norm(force, axis=1), sagittal_rate(signals)
    rows = find_strides(signals)
    peaks = [size[after - round(0.04 * hz) : after + round(0.1 * hz)].max() for _, _, after in rows]
    for share in (10, 50, 90):
        result[f"strike peak {share} %, m/s2"] = float(np.percentile(peaks, share))
    result["toe-off rate, median, rad/s"] = float(np.median([turning[off] for _, off, _ in rows]))
    result["swing rate, median, rad/s"] = float(np.median([-turning[off:after].min() for _, off, after in rows]))
    return result


def path_figures(foot: DrivenFoot, imu: Block[Imu]) -> dict[str, float]:
    """Errors of the foot INS, without a calibration: at the rests in the plane, at the end, and in height.

    The scatter of the height of a stride from rest to rest is that of the filter with every floor new.
    """
    path = FootIns().run(imu).trajectory
    error, height = match_rests(path.t_ns * 1e-9, path.p_frame_in_world, foot.walk)
    free = FootIns(parameters=FootInsParameters(same_floor=0.0)).run(imu).trajectory
    at_rest = rests(foot.walk)
    rise = np.interp(foot.walk.t[at_rest], free.t_ns * 1e-9, free.p_frame_in_world[:, 2])
    strides = np.diff(rise - foot.walk.middle[at_rest, 2])
    return {
        PLANE: float(np.sqrt((error**2).sum(1).mean())),
        "2-D error at the end, m": float(np.linalg.norm(error[-1] - error[0])),
        "height at the end, m": abs(height),
        "height of a stride, SD, m": float(strides.std()),
    }


def measure(arguments: Namespace) -> dict[str, Any]:
    """Figures of the real and the driven sensors, means over both feet, and medians over seeds."""
    folder = data_folder("dual_foot_walk")
    if folder is None:
        raise StrideTwinError("no recordings: set STRIDETWIN_DATA to the folder that holds dual_foot_walk")
    shoe = Skeleton.of(Person(height_m=_HEIGHT_M)).size.shoe
    cases = []
    for walk in load_markers(folder):
        foot = drive(walk, shoe)
        spread: dict[str, list[float]] = {}
        rows: dict[str, dict[str, float]] = {"real": signal_figures(foot, walk.imu) | path_figures(foot, walk.imu)}
        for setting in _SETTINGS:
            seeds = range(arguments.seeds if setting != "ideal" else 1)
            blocks = [simulate(foot, setting, seed) for seed in seeds]
            each = [signal_figures(foot, b) | path_figures(foot, b) for b in blocks]
            rows[setting] = {name: float(np.median([row[name] for row in each])) for name in each[0]}
            spread[setting] = [row[PLANE] for row in each]
        place = (1e3 * foot.p_sensor_in_foot).round().tolist()
        delays = [1e3 * delay for delay in find_delays(foot)]
        cases.append({"foot": walk.name, "place_mm": place, "delays_ms": delays, "rows": rows, "spread_m": spread})
    names = list(cases[0]["rows"]["real"])
    summary = {
        setting: {name: float(np.mean([case["rows"][setting][name] for case in cases])) for name in names}
        for setting in ("real", *_SETTINGS)
    }
    return {"experiment": "driven_feet", "summary": summary, "paper": {}, "cases": cases}


def show(result: dict[str, Any]) -> None:
    """Prints one line per figure, and the ratio to the real one."""
    summary = result["summary"]
    print(f"{'mean of both feet':34}" + "".join(f"{setting:>22}" for setting in summary))
    for name, real in summary["real"].items():
        cells = f"{real:22.3f}"
        for setting in _SETTINGS:
            ratio = summary[setting][name] / real
            mark = " " if GOOD[0] <= ratio <= GOOD[1] else "*"
            cells += f"{summary[setting][name]:14.3f} ({ratio:4.2f}){mark}"
        print(f"{name:34}{cells}")
    for case in result["cases"]:
        low, middle, high = np.percentile(case["spread_m"]["part and shoe"], (10, 50, 90))
        late_rate, late_force = case["delays_ms"]
        print(f"{case['foot']}: sensor at {case['place_mm']} mm, its rates {late_rate:.1f} ms and its forces ", end="")
        print(f"{late_force:.1f} ms after the markers; {PLANE}: real {case['rows']['real'][PLANE]:.3f}, ", end="")
        print(f"part and shoe {middle:.3f} (10 to 90 % of the draws: {low:.3f} to {high:.3f})")


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="parts and shoes that are drawn")
    return answer(parser, measure, show)


if __name__ == "__main__":
    sys.exit(main())
