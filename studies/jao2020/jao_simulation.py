"""The simulation of Jao, Wang, Shkel 2020 (Table I): a hundred identical strides due north of two shoes.

As in the paper: ideal stance, the ADIS16485's noise by its data sheet, g-sensitivity of both gyros equal and opposite,
cameras of 75° at 60 Hz without limit of range, relative positions of 1 mm on each axis, sonars at 25 Hz. Ours gets
points of the board instead, with noise of 1 mm · √points on each axis across the ray: equal information across the line
of sight, less along it. The relative position is in the axes of the camera's foot, as in the paper. The filters assume
the data sheet's noise, no turn-on bias and no g-sensitivity. (A common bias would be observable only in the first
moments, from noise.)

The floor is the error of two gyros with perfectly coupled headings: distance walked times the heading's random walk. A
common yaw drift of both gyros is unobservable: `Setup.unequal` shows it, with the pair of g-sensitivities that follows
from the paper's two ZUPT errors. Both feet move in closed form with identical strides; the world's axes are north, west
and up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import Options
from stridetwin.estimators.foot_ins import StartPose
from stridetwin.estimators.foot_ins.parameters import FootInsParameters
from stridetwin.estimators.foot_to_foot import BoardObservation, FootToFoot, RelativePosition
from stridetwin.reference.norms import reference
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.kinematics.smooth import ease, ease_rate
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.sensors.imu import increments
from stridetwin.sim.sensors.standard_rig import standard_rig
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2
from stridetwin.streams.rig import CameraCalibration, Rig
from stridetwin.streams.samples import Array, Block, Imu, Range
from stridetwin.studies.case import Case
from stridetwin.studies.tables import table_lines

EARTH_RATE = 7.292115e-5  # rad/s


@dataclass(frozen=True, kw_only=True)
class SteadyWalk:
    """Motion of both feet.

    Attributes:
        strides: Number per foot.
        stride_m: Length of a stride.
        stride_s: Duration of a stride.
        swing_share: Swing as a share of it.
        separation_m: From the right foot's line to the left's.
        stand_s: Stationary time before the left foot starts, and after the right one has landed.
        heel_rise_m: Maximum height of the heel.
        heel_off_rad: Largest pitch of the foot, toes down, early in swing.
        toes_up_rad: Largest pitch in the other direction, before it lands.
        latitude_rad: Latitude of the site.
        gravity_mps2: As assumed by the filters.
    """

    strides: int = 100
    stride_m: float = 1.54
    stride_s: float = 1.07
    swing_share: float = 0.55
    separation_m: float = 0.20
    stand_s: float = 0.15
    heel_rise_m: float = 0.18
    heel_off_rad: float = 0.6
    toes_up_rad: float = 0.25
    latitude_rad: float = math.radians(33.64)
    gravity_mps2: float = FootInsParameters().gravity_mps2

    @property
    def duration_s(self) -> float:
        """From the first instant to the last."""
        return 2 * self.stand_s + (self.strides + 0.5) * self.stride_s

    @property
    def earth_rate_in_world(self) -> Array:
        """(3,) rad/s."""
        return EARTH_RATE * np.array([math.cos(self.latitude_rad), 0.0, math.sin(self.latitude_rad)])

    def foot(self, foot: str, t_ns: NDArray[np.int64]) -> Track:
        """Track of a foot's frame (on the sole under the heel).

        The right foot starts half a stride ahead, and half a stride's duration later.

        Args:
            foot: `l` or `r`.
            t_ns: (N,) instants.
        """
        half = 0.5 * (foot == "r")
        strides = (t_ns * 1e-9 - self.stand_s) / self.stride_s - half
        k = np.clip(np.floor(strides), 0, self.strides - 1)
        u = np.clip((strides - k) / self.swing_share, 0.0, 1.0)
        per_s = 1.0 / (self.swing_share * self.stride_s)
        advance, advance_rate = ease(u), ease_rate(u)
        lift, lift_rate = _bump(u, 0.0, 1.0)
        heel_off, heel_off_rate = _bump(u, 0.0, 0.6)
        toes_up, toes_up_rate = _bump(u, 0.45, 1.0)
        side = np.full_like(u, self.separation_m / 2 if foot == "l" else -self.separation_m / 2)
        still = np.zeros_like(u)
        pitch = self.heel_off_rad * heel_off - self.toes_up_rad * toes_up
        turn = (self.heel_off_rad * heel_off_rate - self.toes_up_rad * toes_up_rate) * per_s
        return Track(
            t_ns=t_ns,
            p_body_in_world=np.column_stack([self.stride_m * (k + half + advance), side, self.heel_rise_m * lift]),
            q_world_body=Rotation.from_rotvec(np.column_stack([still, pitch, still])).as_quat(scalar_first=True),
            v_body_in_world=np.column_stack(
                [self.stride_m * advance_rate * per_s, still, self.heel_rise_m * lift_rate * per_s]
            ),
            w_body=np.column_stack([still, turn, still]),
        )

    def inertial(self, sensor: Track) -> tuple[Array, Array]:
        """(N - 1, 3) mean rates (rad/s) and specific forces (m/s²) of an ideal sensor, including Earth rotation.

        Args:
            sensor: Track of the IMU at the N boundaries of its intervals.
        """
        down = np.array([0.0, 0.0, -self.gravity_mps2])
        dt, rate, force = increments(sensor[:1], sensor[1:], down)
        to_sensor = (sensor.rotation[:-1] * Rotation.from_rotvec(0.5 * dt[:, None] * rate)).inv()
        velocity = 0.5 * (sensor.v_body_in_world[:-1] + sensor.v_body_in_world[1:])
        earth = self.earth_rate_in_world
        return rate + to_sensor.apply(earth), force + to_sensor.apply(2.0 * np.cross(earth, velocity))


def _bump(u: Array, start: float, end: float) -> tuple[Array, Array]:
    """From 0 to 1 and back over u in start..end, smooth to the second derivative, and the derivative."""
    x = np.clip((u - start) / (end - start), 0.0, 1.0)
    hill = 4.0 * x * (1.0 - x)
    return hill**3, 12.0 * hill**2 * (1.0 - 2.0 * x) / (end - start)


FEET = ("l", "r")
SEEDS = range(1000, 1100)
REPORTED = ("zupt", "zupt_relative_distance", "zupt_relative_position", "proposed")
G_SENSITIVITY = math.radians(0.009) / STANDARD_GRAVITY_MPS2  # ADIS16485: 0.009 °/s/g; rad/s per m/s²
PAPER_PAIR = (2.9687, -1.2354)  # m to the west, the paper's ZUPT errors; their mean is the common drift


@dataclass(frozen=True, kw_only=True)
class Setup:
    """Configuration of the simulation.

    Attributes:
        walk: Motion of the feet.
        camera_fov_rad: Horizontal.
        relative_position_sd: On each axis, m.
        sonar_sd: Of a range, m.
        g_sensitivity: Left and right, the same on all axes, rad/s per m/s².
    """

    walk: SteadyWalk = field(default_factory=SteadyWalk)
    camera_fov_rad: float = math.radians(75.0)
    relative_position_sd: float = 0.001
    sonar_sd: float = 0.01
    g_sensitivity: tuple[float, float] = (G_SENSITIVITY, -G_SENSITIVITY)

    @classmethod
    def unequal(cls) -> Setup:
        """With a common yaw drift, as in the paper's two ZUPT errors."""
        walk = SteadyWalk()
        per_metre = 2.0 / (walk.strides * walk.stride_m * walk.strides * walk.stride_s * walk.gravity_mps2)
        return cls(g_sensitivity=(PAPER_PAIR[0] * per_metre, PAPER_PAIR[1] * per_metre))


def rig_of(setup: Setup) -> Rig:
    """Shoes of the standard rig with the paper's field of view, and IMUs without biases (0 means unknown)."""
    rig = standard_rig(replace(load_scenario("jao_straight_53m").config, sensors=("foot_imu", "foot_camera", "sonar")))
    focal = 400.0 / math.tan(setup.camera_fov_rad / 2)
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


class Simulation:
    """Truth of the walk, computed once, and any number of noisy runs of it."""

    def __init__(self, setup: Setup) -> None:
        self.setup, self.rig = setup, rig_of(setup)
        rate_hz = self.rig.imu("/foot_l/imu").rate_hz
        n = math.floor(setup.walk.duration_s * rate_hz)
        self.t_ns = np.round(np.arange(n + 1) * 1e9 / rate_hz).astype(np.int64)
        self.imus = {f: self._mounted(f, self.t_ns) for f in FEET}
        self.ideal = {f: setup.walk.inertial(self.imus[f]) for f in FEET}
        self._views = {f: self._view(f, self.t_ns[2::2]) for f in FEET}
        t_sonar = np.arange(1, math.floor(setup.walk.duration_s * 25.0)) * 40_000_000
        sonar = {f: setup.walk.foot(f, t_sonar).mounted(self._sonar(f)).p_body_in_world for f in FEET}
        self._echoes = t_sonar, np.linalg.norm(sonar["l"] - sonar["r"], axis=1)

    def start(self) -> dict[str, StartPose]:
        """The true poses at the start."""
        return {
            f: StartPose(p_imu_in_world=t.p_body_in_world[0], q_world_imu=t.q_world_body[0])
            for f, t in self.imus.items()
        }

    def inertial(self, rng: np.random.Generator) -> tuple[dict[str, Block[Imu]], dict[str, Array]]:
        """Samples of one run by foot, and the (N, 3) white noise of the rates in them, rad/s."""
        blocks, noises = {}, {}
        for foot, k in zip(FEET, self.setup.g_sensitivity):
            imu = self.rig.imu(f"/foot_{foot}/imu")
            rate, force = self.ideal[foot]
            per_sample = math.sqrt(imu.rate_hz)
            noises[foot] = rng.normal(0.0, imu.gyroscope_noise_density * per_sample, rate.shape)
            measured = force + rng.normal(0.0, imu.accelerometer_noise_density * per_sample, force.shape)
            columns = {"angular_rate": rate + k * force + noises[foot], "specific_force": measured}
            blocks[foot] = Block(topic=imu.topic, kind=Imu, t_ns=self.t_ns[1:], columns=columns)
        return blocks, noises

    def aids(self, rng: np.random.Generator) -> list[BoardObservation | RelativePosition | Range]:
        """Measurements of cameras and sonars in one run."""
        sd = self.setup.relative_position_sd
        aids: list[BoardObservation | RelativePosition | Range] = []
        for foot in FEET:
            t_ns, relative, points, rays, depth = self._views[foot]
            relative = relative + rng.normal(0.0, sd, relative.shape)
            ray_sd = math.sqrt(len(points)) * sd / depth
            rays = rays + rng.standard_normal(rays.shape) * ray_sd[:, :, None]
            topic = f"/foot_{foot}/camera"
            for i, t in enumerate(t_ns.tolist()):
                aids.append(RelativePosition(topic=topic, t_ns=t, p_other_in_imu=relative[i], sd=sd))
                aids.append(
                    BoardObservation(topic=topic, t_ns=t, points_in_board=points, rays=rays[i], ray_sd=ray_sd[i])
                )
        t_sonar, distance = self._echoes
        for foot in FEET:
            heard = distance + rng.normal(0.0, self.setup.sonar_sd, len(distance))
            aids += [Range(topic=f"/foot_{foot}/sonar", t_ns=t, distance=d) for t, d in zip(t_sonar.tolist(), heard)]
        return aids

    def end_error(self, foot: str, p_imu_in_world: Array) -> Array:
        """(3,) north, west, up, m."""
        return p_imu_in_world - self.imus[foot].p_body_in_world[-1]

    def floor_of(self, noises: dict[str, Array]) -> tuple[Array, float]:
        """End error to the west, m, from the gyros' noise: (2,) for each foot alone, and for both coupled."""
        dt = np.diff(self.t_ns)[:, None] * 1e-9
        walked = np.mean([np.diff(t.p_body_in_world[:, 0]) for t in self.imus.values()], axis=0)
        headings = []
        for foot in FEET:
            in_world = self.imus[foot].rotation[1:].apply(noises[foot] * dt)
            headings.append(np.cumsum(in_world[:, 2]))
        alone = [float(h @ np.diff(self.imus[f].p_body_in_world[:, 0])) for f, h in zip(FEET, headings)]
        return np.array(alone), float(np.mean(headings, axis=0) @ walked)

    def analytic_floor(self) -> tuple[float, float]:
        """Mean end error, m, of one gyro alone and of two coupled ones: √(2/π) v σ √(T³/3), and that over √2."""
        walk = self.setup.walk
        density = self.rig.imu("/foot_l/imu").gyroscope_noise_density
        sd = walk.stride_m * walk.strides * density * math.sqrt(walk.strides * walk.stride_s / 3.0)
        one = math.sqrt(2.0 / math.pi) * sd
        return one, one / math.sqrt(2.0)

    def _mounted(self, foot: str, t_ns: NDArray[np.int64]) -> Track:
        return self.setup.walk.foot(foot, t_ns).mounted(self.rig.imu(f"/foot_{foot}/imu").mount.T_body_sensor)

    def _sonar(self, foot: str) -> Array:
        return self.rig.others[f"/foot_{foot}/sonar"].mount.T_body_sensor

    def _view(self, foot: str, t_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array, Array, Array, Array]:
        """Observations of the other foot's board by a foot's camera, when the whole board is in the image.

        Returns:
            (S,) times; (S, 3) the other IMU in this one, m; (4, 3) the board's outer corners in the board's frame, m;
            (S, 4, 2) their rays; (S, 4) their depths, m.
        """
        other = "r" if foot == "l" else "l"
        camera, board = self.rig.cameras[f"/foot_{foot}/camera"], self.rig.boards[f"foot_{other}"]
        half = board.square_m * (np.array(board.squares) / 2 - 1)
        points = np.array([[x, y, 0.0] for x in (-half[0], half[0]) for y in (-half[1], half[1])])
        T_world_camera = self.setup.walk.foot(foot, t_ns).mounted(camera.mount.T_body_sensor).poses()
        T_world_board = self.setup.walk.foot(other, t_ns).mounted(board.mount.T_body_sensor).poses()
        T_camera_board = np.linalg.inv(T_world_camera) @ T_world_board
        in_camera = np.einsum("nij,mj->nmi", T_camera_board[:, :3, :3], points) + T_camera_board[:, None, :3, 3]
        facing = np.einsum("ni,ni->n", T_camera_board[:, :3, 2], T_camera_board[:, :3, 3]) < 0.0
        seen = facing & np.all(_in_image(in_camera, camera), axis=1)
        own, others = self._mounted(foot, t_ns), self._mounted(other, t_ns)
        relative = own.rotation.inv().apply(others.p_body_in_world - own.p_body_in_world)
        in_camera = in_camera[seen]
        return t_ns[seen], relative[seen], points, in_camera[..., :2] / in_camera[..., 2:], in_camera[..., 2]


def _in_image(in_camera: Array, camera: CameraCalibration) -> NDArray[np.bool_]:
    """(N, M) whether each point (N, M, 3) in the camera frame projects into its image."""
    fu, fv, pu, pv = camera.intrinsics
    depth = in_camera[..., 2]
    ahead = np.where(depth > 0.0, depth, np.inf)
    u, v = fu * in_camera[..., 0] / ahead + pu, fv * in_camera[..., 1] / ahead + pv
    return (depth > 0.0) & (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)


def run_case(case: Case) -> dict[str, Any]:
    """The paper's set-up, and under `unequal` the same noise with g-sensitivities that cause a common drift."""
    return run_seed(case.seed) | {"unequal": run_seed(case.seed, Setup.unequal())["methods"]}


def run_seed(seed: int, setup: Setup | None = None, methods: tuple[str, ...] = REPORTED) -> dict[str, Any]:
    """One run.

    Args:
        seed: Of all noise; from 1000 on for figures that are reported.
        setup: Configuration; by default the paper's.
        methods: The filter's methods to run.

    Returns:
        `seed`, `floor_m` (west: left alone, right alone, both coupled) and `methods`: method to `end_error_m`
        (left and right, (3,) north, west, up) and `end_nees` (left, right); ready for JSON.
    """
    simulation = _simulation(setup or Setup())
    rng = np.random.default_rng(seed)
    blocks, noises = simulation.inertial(rng)
    aids = simulation.aids(rng)
    alone, together = simulation.floor_of(noises)
    found: dict[str, Any] = {}
    for method in methods:
        estimator = FootToFoot(
            simulation.rig,
            options=Options(method=method),
            start=simulation.start(),
            earth_rate_in_world=simulation.setup.walk.earth_rate_in_world,
        )
        paths = estimator.run(blocks, aids)
        ends = [simulation.end_error(f, paths[f].trajectory.p_frame_in_world[-1]) for f in FEET]
        nees = []
        for f, e in zip(FEET, ends):
            covariance = paths[f].trajectory.covariance
            assert covariance is not None
            nees.append(float(e @ np.linalg.solve(covariance[-1, :3, :3], e)))
        found[method] = {"end_error_m": [e.tolist() for e in ends], "end_nees": nees}
    return {"seed": seed, "floor_m": [*alone.tolist(), together], "methods": found}


_simulation = cache(Simulation)


def collect(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """`summary` and `paper` of `run_case`s; errors in m, left and right."""
    methods = results[0]["methods"]
    errors = {m: np.array([r["methods"][m]["end_error_m"] for r in results]) for m in methods}
    nees = {m: float(np.mean([r["methods"][m]["end_nees"] for r in results])) for m in methods}
    floors = _floors(_simulation(Setup()), np.array([r["floor_m"] for r in results]))
    unequal = {m: np.array([r["unequal"][m]["end_error_m"] for r in results]) for m in methods}
    summary = _summary(errors) | {
        "nees_position_mean": nees,
        "random_walk_floor_m": floors,
        "mean_end_error_unequal_m": _summary(unequal)["mean_end_error_m"],
    }
    paper = reference("jao2020")["jao_simulation"]
    return {"summary": summary, "paper": {k: v for k, v in paper.items() if k in summary}}


def _summary(found: dict[str, Array]) -> dict[str, Any]:
    """Of (runs, foot, axis) errors: horizontal mean (left, right), components, SDs in the order of the paper."""
    return {
        "mean_end_error_m": {m: np.linalg.norm(e[:, :, :2], axis=2).mean(axis=0).tolist() for m, e in found.items()},
        "end_position_sd_m": {
            m: [float(e[:, f, axis].std(ddof=min(1, len(e) - 1))) for f in range(2) for axis in (1, 0)]
            for m, e in found.items()
        },
        "mean_west_error_m": {m: e[:, :, 1].mean(axis=0).tolist() for m, e in found.items()},
        "mean_abs_north_error_m": {m: np.abs(e[:, :, 0]).mean(axis=0).tolist() for m, e in found.items()},
        "mean_abs_up_error_m": {m: np.abs(e[:, :, 2]).mean(axis=0).tolist() for m, e in found.items()},
    }


def _floors(simulation: Simulation, floors: Array) -> dict[str, float]:
    one, two = simulation.analytic_floor()
    return {
        "one_gyro_analytic": one,
        "one_gyro_drawn": float(np.abs(floors[:, :2]).mean()),
        "two_gyros_analytic": two,
        "two_gyros_drawn": float(np.abs(floors[:, 2]).mean()),
    }


_COLUMNS = (
    ("end error", 16, "{mean_end_error_m:.3f}"),
    ("paper", 16, "{paper:.3f}"),
    ("west", 16, "{mean_west_error_m:.3f}"),
    ("north", 16, "{mean_abs_north_error_m:.3f}"),
    ("common drift", 16, "{mean_end_error_unequal_m:.3f}"),
)


def table(result: dict[str, Any]) -> list[str]:
    """Our figures and the paper's, as lines of text; pairs are left and right."""
    summary = {**result["summary"], "paper": result["paper"]["mean_end_error_m"]}
    rows = [(m, {name: of.get(m, "") for name, of in summary.items()}) for m in REPORTED]
    floors = [f"floor, {name:<17}{value:9.3f}" for name, value in summary["random_walk_floor_m"].items()]
    return [f"{len(result['cases'])} runs; m", *table_lines(_COLUMNS, rows, 24), *floors]
