"""The simulation of Jao, Wang, Shkel 2020 (Table I): a hundred identical strides due north of two shoes.

As in the paper: ideal stance, the ADIS16485's noise by its data sheet, g-sensitivity of both gyros equal and opposite,
cameras of 75° at 60 Hz without limit of range, relative positions of 1 mm on each axis, sonars at 25 Hz. Ours gets
points of the board instead, with noise of 1 mm · √points on each axis across the ray: equal information across the line
of sight, less along it. The relative position is in the axes of the camera's foot, as in the paper. The filters assume
the data sheet's noise, no turn-on bias and no g-sensitivity. (A common bias would be observable only in the first
moments, from noise.)

The floor is the error of two gyros with perfectly coupled headings: distance walked times the heading's random walk. A
common yaw drift of both gyros is unobservable: `UNEQUAL` shows it. Both feet move in closed form with identical
strides; the world's axes are north, west and up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.batch.jobs import Row
from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import StartPose
from stridetwin.estimators.foot_ins.parameters import FootInsParameters
from stridetwin.estimators.foot_to_foot import BoardObservation, FootToFoot, RelativePosition
from stridetwin.outputs.parameters import parameter_keywords
from stridetwin.reference.norms import EndErrors, read_reference
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.kinematics.smooth import ease, ease_rate
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.sensors.imu import compute_increments
from stridetwin.sim.sensors.standard_rig import standard_rig
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Block, Imu, Range
from stridetwin.studies.case import ExperimentCase
from stridetwin.studies.placement.visibility import is_in_image
from stridetwin.studies.result import Collected, Figures, LabelledFigures, Result
from stridetwin.studies.tables import table_lines

ESTIMATORS = ("foot_to_foot",)
"""Estimators whose parameters `--set` changes here."""

FEET = ("l", "r")
# methods of the filter in the table: the published ones, then ours
REPORTED_METHODS = ("zupt", "zupt_relative_distance", "zupt_relative_position", "proposed")
STRIDE_M, STRIDE_S, STRIDES = 1.54, 1.07, 100  # length and duration of a stride of one foot; strides of each foot
_SWING_SHARE = 0.55  # of a stride's duration
_SEPARATION_M = 0.20  # from the right foot's line to the left's
_STAND_S = 0.15  # before the left foot starts, and after the right one has landed
_HEEL_RISE_M = 0.18
_HEEL_OFF_RAD, _TOES_UP_RAD = 0.6, 0.25  # largest pitch of a foot: toes down early in swing, and up before it lands
GRAVITY_MPS2 = FootInsParameters().gravity_mps2
"""As the filters assume it."""
_LATITUDE_RAD = math.radians(33.64)
EARTH_RATE_IN_WORLD = 7.292115e-5 * np.array([math.cos(_LATITUDE_RAD), 0.0, math.sin(_LATITUDE_RAD)])  # rad/s
_CAMERA_FOV_RAD = math.radians(75.0)  # horizontal
_RELATIVE_POSITION_SD_M, _SONAR_SD_M = 0.001, 0.01  # on each axis, and of a range
_DATA_SHEET = math.radians(0.009) / STANDARD_GRAVITY_MPS2  # ADIS16485: 0.009 °/s/g; rad/s per m/s²
OPPOSITE = (_DATA_SHEET, -_DATA_SHEET)
"""G-sensitivity of the left and the right gyro, the same on all axes, rad/s per m/s²."""
# g-sensitivity per sideways drift at the end: a yaw rate k g over the time T turns the path by ½ k g T on average
_PER_METRE = 2.0 / (STRIDES * STRIDE_M * STRIDES * STRIDE_S * GRAVITY_MPS2)
UNEQUAL = (2.9687 * _PER_METRE, -1.2354 * _PER_METRE)
"""G-sensitivities that follow from the paper's ZUPT errors, m to the west: the mean of the two is a common drift."""


@dataclass(frozen=True)
class SteadyWalk:
    """Motion of both feet in closed form: straight north with identical strides.

    Attributes:
        strides: Number of strides of each foot.
    """

    strides: int = STRIDES

    @property
    def duration_s(self) -> float:
        """Time from the first instant to the last, s."""
        return 2 * _STAND_S + (self.strides + 0.5) * STRIDE_S

    def foot(self, foot: str, t_ns: NDArray[np.int64]) -> Track:
        """Track of a foot's frame, on the sole under the heel, at N instants.

        The right foot starts half a stride ahead, and half a stride's duration later.

        Args:
            foot: `l` or `r`.
            t_ns: (N,) times, ns.
        """
        half = 0.5 * (foot == "r")  # strides that the foot is ahead, and late
        # (N,) strides done; k is the number of the present stride, u the share of its swing that has passed
        strides = (t_ns * 1e-9 - _STAND_S) / STRIDE_S - half
        k = np.clip(np.floor(strides), 0, self.strides - 1)
        u = np.clip((strides - k) / _SWING_SHARE, 0.0, 1.0)
        # the derivatives by u times this are those by time
        per_s = 1.0 / (_SWING_SHARE * STRIDE_S)
        # (N,) shares of the largest rise and pitch, and their derivatives by u
        lift, lift_rate = _bump(u, 0.0, 1.0)
        heel_off, heel_off_rate = _bump(u, 0.0, 0.6)
        toes_up, toes_up_rate = _bump(u, 0.45, 1.0)
        still = np.zeros_like(u)
        side = still + (_SEPARATION_M / 2 if foot == "l" else -_SEPARATION_M / 2)
        pitch = _HEEL_OFF_RAD * heel_off - _TOES_UP_RAD * toes_up
        turn = (_HEEL_OFF_RAD * heel_off_rate - _TOES_UP_RAD * toes_up_rate) * per_s
        speed, climb = STRIDE_M * ease_rate(u) * per_s, _HEEL_RISE_M * lift_rate * per_s
        return Track(
            t_ns=t_ns,
            p_body_in_world=np.column_stack([STRIDE_M * (k + half + ease(u)), side, _HEEL_RISE_M * lift]),
            q_world_body=Rotation.from_rotvec(np.column_stack([still, pitch, still])).as_quat(scalar_first=True),
            v_body_in_world=np.column_stack([speed, still, climb]),
            w_body=np.column_stack([still, turn, still]),
        )


def ideal_imu(sensor: Track) -> tuple[Array, Array]:
    """What an ideal IMU measures between N instants of its track, with Earth rotation and Coriolis acceleration.

    Returns:
        (N - 1, 3) mean rates, rad/s, and (N - 1, 3) mean specific forces, m/s², in the sensor's axes.
    """
    # intervals (N - 1,), s, with mean rates and specific forces, as on an Earth that does not rotate
    dt, rate, force = compute_increments(sensor[:1], sensor[1:], np.array([0.0, 0.0, -GRAVITY_MPS2]))
    # rotation from the world's axes to the sensor's in the middle of each interval, after half of the turn in it
    to_sensor = (sensor.rotation[:-1] * Rotation.from_rotvec(0.5 * dt[:, None] * rate)).inv()
    velocity = 0.5 * (sensor.v_body_in_world[:-1] + sensor.v_body_in_world[1:])
    coriolis = 2.0 * np.cross(EARTH_RATE_IN_WORLD, velocity)
    return rate + to_sensor.apply(EARTH_RATE_IN_WORLD), force + to_sensor.apply(coriolis)


def _bump(u: Array, start: float, end: float) -> tuple[Array, Array]:
    """A bump from 0 to 1 and back between `start` and `end`, smooth to the second derivative: (4 x (1 - x))³.

    Args:
        u: (N,) shares of the swing, 0-1.
        start: Where the bump begins; x is 0 there.
        end: Where it ends; x is 1 there.

    Returns:
        (N,) values at u (N,), and (N,) derivatives by u.
    """
    x = np.clip((u - start) / (end - start), 0.0, 1.0)
    hill = 4.0 * x * (1.0 - x)  # its derivative by u is 4 (1 - 2 x) / (end - start)
    return hill**3, 12.0 * hill**2 * (1.0 - 2.0 * x) / (end - start)


def _paper_rig() -> Rig:
    """Shoes of the standard rig with the paper's field of view, and IMUs without biases.

    Standard deviations of the biases are nearly 0, because the rig takes 0 for unknown.
    """
    rig = standard_rig(replace(load_scenario("jao_straight_53m").config, sensors=("foot_imu", "foot_camera", "sonar")))
    # 400 pixels are half of an image's width
    focal = 400.0 / math.tan(_CAMERA_FOV_RAD / 2)
    return replace(
        rig,
        imus={
            topic: replace(
                imu,
                gyroscope_bias_sd=1e-7,
                accelerometer_bias_sd=1e-5,
                gyroscope_random_walk=0.0,
                accelerometer_random_walk=0.0,
            )
            for topic, imu in rig.imus.items()
        },
        cameras={
            topic: replace(camera, intrinsics=(focal, focal, *camera.intrinsics[2:]))
            for topic, camera in rig.cameras.items()
        },
    )


class JaoSimulation:
    """The simulation of Jao et al. 2020: the truth of a walk, computed once, and any number of noisy runs of it.

    Args:
        walk: Motion of both feet.

    Attributes:
        walk: Motion of both feet.
        rig: The shoes with the paper's sensors, without calibration errors.
        t_ns: (N + 1,) stamps of the motion; the IMUs have samples at all but the first.
        imus: By foot, track of the IMU at these stamps.
        ideal: By foot, (N, 3) rates, rad/s, and (N, 3) specific forces, m/s², without noise (`ideal_imu`).
    """

    def __init__(self, walk: SteadyWalk) -> None:
        """Computes the noise-free samples of the walk: IMUs, views of the boards, and ranges."""
        self.walk, self.rig = walk, _paper_rig()
        rate_hz = self.rig.imu("/foot_l/imu").rate_hz
        n = math.floor(walk.duration_s * rate_hz)
        # n + 1 stamps of the motion; the n samples of an IMU are means between them
        self.t_ns = np.round(np.arange(n + 1) * 1e9 / rate_hz).astype(np.int64)
        self.imus = {f: self._imu(f, self.t_ns) for f in FEET}
        self.ideal = {f: ideal_imu(self.imus[f]) for f in FEET}
        # by foot, what its camera sees of the other board: an image at every second sample of the IMUs
        self._views = {f: self._view(f, self.t_ns[2::2]) for f in FEET}
        # ranges at 25 Hz: stamps (S,), ns, and true distances (S,), m, between both sonars
        t_sonar = np.arange(1, math.floor(walk.duration_s * 25.0)) * 40_000_000
        mounts = {f: self.rig.others[f"/foot_{f}/sonar"].mount.T_body_sensor for f in FEET}
        left, right = (walk.foot(f, t_sonar).to_sensor(mounts[f]).p_body_in_world for f in FEET)
        self._echoes = t_sonar, np.linalg.norm(left - right, axis=1)  # the same range for both sonars

    def start(self) -> dict[str, StartPose]:
        """The true pose of each foot's IMU at the first instant."""
        return {
            f: StartPose(p_imu_in_world=t.p_body_in_world[0], q_world_imu=t.q_world_body[0])
            for f, t in self.imus.items()
        }

    def inertial(
        self, rng: np.random.Generator, g_sensitivity: tuple[float, float] = OPPOSITE
    ) -> tuple[dict[str, Block[Imu]], dict[str, Array]]:
        """Samples of both IMUs in one run.

        Args:
            rng: Draws the noise.
            g_sensitivity: Of the left and the right gyro, rad/s per m/s².

        Returns:
            Samples by foot, and the (N, 3) white noise of the rates in them, rad/s.
        """
        blocks, noises = {}, {}
        for foot, sensitivity in zip(FEET, g_sensitivity):
            imu = self.rig.imu(f"/foot_{foot}/imu")
            rate, force = self.ideal[foot]
            per_sample = math.sqrt(imu.rate_hz)  # from a noise density to the standard deviation of a sample
            noises[foot] = rng.normal(0.0, imu.gyroscope_noise_density * per_sample, rate.shape)
            measured = force + rng.normal(0.0, imu.accelerometer_noise_density * per_sample, force.shape)
            columns = {"angular_rate": rate + sensitivity * force + noises[foot], "specific_force": measured}
            blocks[foot] = Block(topic=imu.topic, kind=Imu, t_ns=self.t_ns[1:], columns=columns)
        return blocks, noises

    def aiding_measurements(self, rng: np.random.Generator) -> list[BoardObservation | RelativePosition | Range]:
        """Measurements of cameras and sonars in one run: relative positions, points of the boards, and ranges.

        Every image gives both a relative position, for the published methods, and the points of the board, for ours.

        Args:
            rng: Draws the noise.

        Returns:
            Those of the left foot's camera, of the right one's, and then the ranges of both sonars.
        """
        sd = _RELATIVE_POSITION_SD_M
        aiding_measurements: list[BoardObservation | RelativePosition | Range] = []
        for foot in FEET:
            # stamps, positions of the other IMU, the board's corners, and their rays and depths (see `_view`)
            t_ns, relative, points, rays, depth = self._views[foot]
            relative = relative + rng.normal(0.0, sd, relative.shape)
            # noise of 1 mm · √points across the ray, as an angle at the point's depth
            ray_sd = math.sqrt(len(points)) * sd / depth
            rays = rays + rng.standard_normal(rays.shape) * ray_sd[:, :, None]
            topic = f"/foot_{foot}/camera"
            for i, t in enumerate(t_ns.tolist()):
                aiding_measurements += [
                    RelativePosition(topic=topic, t_ns=t, p_other_in_imu=relative[i], sd=sd),
                    BoardObservation(topic=topic, t_ns=t, points_in_board=points, rays=rays[i], ray_sd=ray_sd[i]),
                ]
        t_sonar, distance = self._echoes  # stamps, ns, and true distances, m
        for foot in FEET:
            heard = distance + rng.normal(0.0, _SONAR_SD_M, len(distance))
            aiding_measurements += [
                Range(topic=f"/foot_{foot}/sonar", t_ns=t, distance=d) for t, d in zip(t_sonar.tolist(), heard)
            ]
        return aiding_measurements

    def end_error(self, foot: str, p_imu_in_world: Array) -> Array:
        """(3,) estimated minus true position of a foot's IMU at the end: north, west, up, m."""
        return np.asarray(p_imu_in_world - self.imus[foot].p_body_in_world[-1])

    def noise_floor_m(self, noises: dict[str, Array]) -> tuple[Array, float]:
        """End error to the west that the gyros' white noise causes: Σ heading error × step to the north.

        Args:
            noises: (N, 3) noise of the rates by foot, rad/s.

        Returns:
            (2,) m for each foot alone, and m for both coupled, whose heading errors are averaged.
        """
        dt = np.diff(self.t_ns)[:, None] * 1e-9
        # of each foot, (N,) distances to the north between samples, m, and (N,) heading errors, rad: sums of the noise
        # about the vertical
        north_steps_m = [np.diff(self.imus[f].p_body_in_world[:, 0]) for f in FEET]
        headings = [np.cumsum(self.imus[f].rotation[1:].apply(noises[f] * dt)[:, 2]) for f in FEET]
        alone = np.array([float(heading @ way) for heading, way in zip(headings, north_steps_m)])
        return alone, float(np.mean(headings, axis=0) @ np.mean(north_steps_m, axis=0))

    def analytic_floor(self) -> tuple[float, float]:
        """Mean end error, m, of one gyro alone and of two coupled ones: √(2/π) v σ √(T³/3), and that over √2.

        v is the mean speed, σ the density of the gyro's noise, and T the duration of all strides.
        """
        strides, density = self.walk.strides, self.rig.imu("/foot_l/imu").gyroscope_noise_density
        # v σ √(T³/3) = v T σ √(T/3), where v T is the length of the walk; √(2/π) is the mean absolute value of a
        # standard normal variable
        sd = STRIDE_M * strides * density * math.sqrt(strides * STRIDE_S / 3.0)
        one = math.sqrt(2.0 / math.pi) * sd
        return one, one / math.sqrt(2.0)

    def _imu(self, foot: str, t_ns: NDArray[np.int64]) -> Track:
        """Track of a foot's IMU at (N,) times."""
        return self.walk.foot(foot, t_ns).to_sensor(self.rig.imu(f"/foot_{foot}/imu").mount.T_body_sensor)

    def _view(self, foot: str, t_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array, Array, Array, Array]:
        """Observations of the other foot's board by a foot's camera, when the whole board is in the image.

        Returns:
            (S,) times; (S, 3) the other IMU in this one, m; (4, 3) the board's outer corners in the board's frame, m;
            (S, 4, 2) their rays; (S, 4) their depths, m.
        """
        other_foot = "r" if foot == "l" else "l"
        camera, board = self.rig.cameras[f"/foot_{foot}/camera"], self.rig.boards[f"foot_{other_foot}"]
        # (4, 3) outermost corners between squares, which lie one square inside the board's edge
        half = board.square_m * (np.array(board.squares) / 2 - 1)
        points = np.array([[x, y, 0.0] for x in (-half[0], half[0]) for y in (-half[1], half[1])])
        T_world_camera = self.walk.foot(foot, t_ns).to_sensor(camera.mount.T_body_sensor).poses()
        T_world_board = self.walk.foot(other_foot, t_ns).to_sensor(board.mount.T_body_sensor).poses()
        T_camera_board = np.linalg.inv(T_world_camera) @ T_world_board
        # (S, 4, 3) the corners in the camera's frame
        in_camera = np.einsum("nij,mj->nmi", T_camera_board[:, :3, :3], points) + T_camera_board[:, None, :3, 3]
        # the board's normal, its z axis, points towards the camera
        facing = np.einsum("ni,ni->n", T_camera_board[:, :3, 2], T_camera_board[:, :3, 3]) < 0.0
        is_visible = facing & np.all(is_in_image(camera, in_camera), axis=1)
        imu, other_imu = self._imu(foot, t_ns), self._imu(other_foot, t_ns)
        relative = imu.rotation.inv().apply(other_imu.p_body_in_world - imu.p_body_in_world)
        in_camera = in_camera[is_visible]
        return (
            t_ns[is_visible],
            relative[is_visible],
            points,
            in_camera[..., :2] / in_camera[..., 2:],
            in_camera[..., 2],
        )


_simulation = cache(JaoSimulation)  # one simulation per motion, shared by all runs in a process


class MethodEnds(TypedDict):
    """End of one run by one method; lists are of the left and the right foot.

    Attributes:
        end_error_m: Estimated minus true position of each foot's IMU: north, west, up.
        end_nees: NEES of each of these positions.
    """

    end_error_m: list[list[float]]
    end_nees: list[float]


class SeedRow(TypedDict):
    """One run.

    Attributes:
        seed: Seed of the noise.
        floor_m: End errors to the west that the gyros' noise causes: left alone, right alone, both coupled.
        methods: What each method made of the run.
    """

    seed: int
    floor_m: list[float]
    methods: dict[str, MethodEnds]


class SimulationRow(SeedRow):
    """The row of a case.

    Attributes:
        unequal: What each method made of the same run with the g-sensitivities `UNEQUAL`.
    """

    unequal: dict[str, MethodEnds]


Summary = dict[str, dict[str, float | list[float]]]
"""Figures by name, each by method; only `_FLOOR` is by kind of gyro error, such as `one_gyro_drawn`.

Pairs are left and right; `end_position_sd_m` has two axes of each.
"""
_FLOOR = "random_walk_floor_m"  # error that the gyros' noise alone causes


def run_case(case: ExperimentCase) -> Row:
    """Runs the paper's set-up with one seed, and again under g-sensitivities that cause a common drift (`unequal`)."""
    return {**run_seed(case.seed), "unequal": run_seed(case.seed, UNEQUAL)["methods"]}


def run_seed(
    seed: int, g_sensitivity: tuple[float, float] = OPPOSITE, methods: tuple[str, ...] = REPORTED_METHODS
) -> SeedRow:
    """One run with noise of this seed, estimated by some methods of the filter.

    Args:
        seed: Seed of the noise.
        g_sensitivity: Of the left and the right gyro, rad/s per m/s².
        methods: Methods of `FootToFoot`.

    Returns:
        `seed`, `floor_m` (west: left alone, right alone, both coupled) and `methods`: method to `end_error_m`
        (left and right, (3,) north, west, up) and `end_nees` (left, right); ready for JSON.
    """
    simulation, rng = _simulation(SteadyWalk()), np.random.default_rng(seed)
    blocks, noises = simulation.inertial(rng, g_sensitivity)
    aiding_measurements = simulation.aiding_measurements(rng)
    alone, together = simulation.noise_floor_m(noises)  # m: of each gyro, and of both coupled
    figures: dict[str, MethodEnds] = {}
    for method in methods:
        estimator = FootToFoot(
            simulation.rig,
            options=Options(method=method),
            start=simulation.start(),
            earth_rate_in_world=EARTH_RATE_IN_WORLD,
            **parameter_keywords(FootToFoot, method),
        )
        paths = estimator.run(blocks, aiding_measurements)  # by foot
        errors: list[list[float]] = []  # at the end, of left and right
        nees: list[float] = []
        for foot in FEET:
            covariance = paths[foot].trajectory.covariance
            assert covariance is not None
            error = simulation.end_error(foot, paths[foot].trajectory.p_frame_in_world[-1])
            errors.append(error.tolist())
            nees.append(float(error @ np.linalg.solve(covariance[-1, :3, :3], error)))
        figures[method] = {"end_error_m": errors, "end_nees": nees}
    return {"seed": seed, "floor_m": [*alone.tolist(), together], "methods": figures}


def collect(results: Sequence[SimulationRow]) -> Collected[Summary, Figures]:
    """Summary of all runs, with the paper's figures; errors in m, left and right."""
    methods = results[0]["methods"]
    one, two = _simulation(SteadyWalk()).analytic_floor()
    # (runs, 3) m, absolute errors by the noise drawn in each run: left alone, right alone, both coupled
    drawn = np.abs([r["floor_m"] for r in results])
    unequal = _end_error_figures([r["unequal"] for r in results])
    summary: Summary = {
        **_end_error_figures([r["methods"] for r in results]),
        "nees_position_mean": {m: float(np.mean([r["methods"][m]["end_nees"] for r in results])) for m in methods},
        _FLOOR: {
            "one_gyro_analytic": one,
            "one_gyro_drawn": float(drawn[:, :2].mean()),
            "two_gyros_analytic": two,
            "two_gyros_drawn": float(drawn[:, 2].mean()),
        },
        "mean_end_error_unequal_m": unequal["mean_end_error_m"],
    }
    paper = read_reference("jao2020")["jao_simulation"]
    return {"summary": summary, "paper": {k: v for k, v in paper.items() if k in summary}}


def _end_error_figures(runs: Sequence[dict[str, MethodEnds]]) -> Summary:
    """Figures of the end errors by method over runs.

    Args:
        runs: Of each run, method to its errors at the end.

    Returns:
        `mean_end_error_m` (horizontal; left, right), `end_position_sd_m` (left west, left north, right west, right
        north), `mean_west_error_m`, `mean_abs_north_error_m` and `mean_abs_up_error_m` (left, right).
    """
    summary: Summary = {}
    for method in runs[0]:
        errors = np.array([run[method]["end_error_m"] for run in runs])  # (runs, feet, axes north, west, up)
        ddof = min(1, len(errors) - 1)  # 0 with a single run, whose standard deviation is 0
        figures = {
            "mean_end_error_m": np.linalg.norm(errors[:, :, :2], axis=2).mean(axis=0),
            # west (axis 1), then north (axis 0), as in the paper
            "end_position_sd_m": np.array([errors[:, f, axis].std(ddof=ddof) for f in range(2) for axis in (1, 0)]),
            "mean_west_error_m": errors[:, :, 1].mean(axis=0),
            "mean_abs_north_error_m": np.abs(errors[:, :, 0]).mean(axis=0),
            "mean_abs_up_error_m": np.abs(errors[:, :, 2]).mean(axis=0),
        }
        for name, values in figures.items():
            summary.setdefault(name, {})[method] = values.tolist()
    return summary


_COLUMNS = (
    ("end error", 16, "{mean_end_error_m:.3f}"),
    ("paper", 16, "{paper:.3f}"),
    ("west", 16, "{mean_west_error_m:.3f}"),
    ("north", 16, "{mean_abs_north_error_m:.3f}"),
    ("common drift", 16, "{mean_end_error_unequal_m:.3f}"),
)


def table(result: Result[Summary, EndErrors, SimulationRow]) -> list[str]:
    """Our figures beside the paper's as lines of text: one per method, then one per floor; pairs are left and right."""
    summary, paper_errors = result["summary"], result["paper"]["mean_end_error_m"]
    rows: list[LabelledFigures] = []
    for method in REPORTED_METHODS:
        # from figures by method to the figures of this one; the floor is of no method
        ours = {name: by_method.get(method, "") for name, by_method in summary.items() if name != _FLOOR}
        rows.append((method, {**ours, "paper": paper_errors.get(method, "")}))
    floors = [f"floor, {name:<17}{value:9.3f}" for name, value in summary[_FLOOR].items()]
    return [f"{len(result['cases'])} runs; m", *table_lines(_COLUMNS, rows, 24), *floors]
