"""The twin: a wearer who walks a route, and the samples of all sensors of the rig."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import copy
from dataclasses import replace
from functools import cached_property, partial

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from stridetwin.sim import truth
from stridetwin.sim.acts import Pivot
from stridetwin.sim.choices import BODY_PLACES
from stridetwin.sim.composition import compose
from stridetwin.sim.config import PHYSICS, SIDES, Dynamics, TwinConfig
from stridetwin.sim.dynamics.drive import ControlLaw
from stridetwin.sim.dynamics.plan import Plan, plan_control
from stridetwin.sim.dynamics.simulate import Simulation
from stridetwin.sim.dynamics.simulated_walk import Replay, SimulatedWalk
from stridetwin.sim.faults.faults import plan_faults
from stridetwin.sim.gait.exo_fit import check_legs
from stridetwin.sim.gait.heel_strike import UpperMotion, case_parameters, draw_shoes
from stridetwin.sim.gait.reference import Reference, plan_reference
from stridetwin.sim.motion.fit import FittedWalk
from stridetwin.sim.motion.recorded_walk import make_recorded_walk
from stridetwin.sim.motion.source import apply_motion
from stridetwin.sim.parts.sensor_config import SensorConfig
from stridetwin.sim.playback import Playback
from stridetwin.sim.rendering.camera_processes import CameraProcesses
from stridetwin.sim.rendering.renderer import FilmCamera
from stridetwin.sim.sensors.model import instants
from stridetwin.sim.sensors.mount_slip import MountSlips
from stridetwin.sim.sensors.standard_rig import foot_imu_position, sensor_rig
from stridetwin.sim.sensors.suite import SensorSuite
from stridetwin.sim.walk import GivenWalk
from stridetwin.sim.wearer.body import compile_model
from stridetwin.sim.wearer.imu_places import split_side
from stridetwin.sim.world.bystanders import Crowd, plan_bystanders, pose_crowd
from stridetwin.sim.world.light import LightCourse, plan_light
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Array, Block, Sample

CHUNK_S = 2.0  # length of a chunk of samples
_FILM_SMOOTHING_S = 0.6  # SD of the filter of the film camera's path
# streams of random numbers of a walk; `world.uneven_floor` has number 7
_STEPS, _JOINT_TORQUE, _SHOE, _CROWD, _CASE, _MOUNT, _BODY = range(7)


class Twin:
    """One walk of one wearer; the same configuration and seed give the same samples.

    Args:
        config: Scenario.
        seed: Seed of the walk: steps and sensor noise.
        plan: Plans the motion; another function than `plan_reference` may look it up.
        plan_control: Plans the control of a forward simulation; another function may look it up, too.

    Attributes:
        config: Configuration.
        seed: Seed.
        sensor_rig: The sensors with their true calibration.
        rig: Nominal rig for estimators.
        terrain: Ground.
        model: Compiled MuJoCo model.
        crowd: Bystanders.
        size: Dimensions of the wearer.
        given_walk: The motion as it was given; a forward simulation follows it.

    Raises:
        ConfigError: A value that cannot be built or walked.
    """

    def __init__(
        self,
        config: TwinConfig,
        seed: int,
        *,
        plan: Callable[..., Reference] = plan_reference,
        plan_control: Callable[..., Plan] = plan_control,
    ) -> None:
        """Checks the scenario, composes the model, and plans motion and bystanders; the walk itself comes later."""
        if config.physics not in PHYSICS:
            raise ConfigError(config.name, "physics", config.physics, ", ".join(PHYSICS))
        if config.dynamics is not None and config.physics != "dynamic":
            raise ConfigError(config.name, "dynamics", f"physics {config.physics}", "no dynamics, or physics dynamic")
        if config.exo is not None and config.exo.drive != "idle" and config.physics != "dynamic":
            raise ConfigError(config.name, "exo.drive", config.exo.drive, "idle, or physics dynamic")
        if config.gait.pattern == "run" and config.physics == "dynamic":
            raise ConfigError(config.name, "physics", config.physics, "kinematic: simulated walkers cannot run")
        if any(isinstance(act, Pivot) for act in config.gait.acts):
            valid = "physics kinematic: simulated feet do not turn on the ground"
            if config.exo is not None and config.exo.user_exo is None:
                valid = "exo none: the hips of the exoskeleton rotate by 20°, a pivot needs up to 58°"
            if config.physics == "dynamic" or "exo" in valid:
                raise ConfigError("gait", "acts.kind", Pivot.kind, valid)
        recorded: FittedWalk | None = None
        if config.motion is not None:  # person and terrain follow from the recording
            config, recorded = apply_motion(config)
        self.config, self.seed = config, seed
        composed = compose(config, seed)
        self.terrain, self.size, self.sensor_rig = composed.terrain, composed.size, composed.sensor_rig
        self.rig: Rig = self.sensor_rig.nominal(seed)
        self.model: mujoco.MjModel = compile_model(composed.spec)
        check_legs(self.model, self.size)
        self.given_walk: GivenWalk
        if recorded is None:
            self.given_walk = plan(config, self.model, self.size, self.terrain, self._rng(_STEPS))
        else:
            self.given_walk = make_recorded_walk(recorded, self.model, self.size, self.terrain)
        self._plan_control = plan_control
        grid = self.given_walk.grid
        self.crowd: Crowd = plan_bystanders(
            config.route.bystanders,
            self.terrain,
            grid,
            self.given_walk.progress(grid),
            self.given_walk.splines(grid)[:, :2],  # x and y of the pelvis
            self._rng(_CROWD),
        )

    def _rng(self, *stream: int) -> np.random.Generator:
        """Random numbers of one part of the walk, independent of those of the others.

        `stream` is the number of the part, such as `_STEPS`, and for shoes the number of the side.
        """
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=stream))

    def with_sensors(self, sensors: tuple[str, ...], fittings: Mapping[str, SensorConfig]) -> Twin:
        """Twin of this walk with other sensors at the same places, without planning or simulating the walk again.

        Use it to compare sensors on one motion.

        Args:
            sensors: Groups of this twin's sensors.
            fittings: Differences from the standard sensors by group; those that move an IMU have no effect.
        """
        _ = self.walk  # computed before the copy, so that both share it
        # a shallow copy: motion, model and terrain are common to both twins
        twin = copy(self)
        twin.config = replace(self.config, sensors=sensors, fittings=fittings)
        twin.sensor_rig = sensor_rig(twin.config)
        twin.rig = twin.sensor_rig.nominal(self.seed)
        return twin

    @property
    def total_mass_kg(self) -> float:
        """Mass of the wearer with everything worn: person, exoskeleton and its motors, kg."""
        return float(self.model.body_subtreemass[1])  # body 1 is the root of the wearer

    @property
    def reference(self) -> Reference:
        """The planned motion.

        Raises:
            TypeError: The motion is recorded.
        """
        if not isinstance(self.given_walk, Reference):
            raise TypeError(f"{self.config.name}: a recorded motion has no plan")
        return self.given_walk

    @property
    def duration_s(self) -> float:
        """Length of the walk, s."""
        return self.walk.duration_s

    @cached_property
    def walk(self) -> GivenWalk | SimulatedWalk:
        """The wearer's motion: the given one itself, or its forward simulation with contacts."""
        if self.config.physics == "kinematic":
            return self.given_walk
        simulation = self.simulation()
        while not simulation.is_over:
            simulation.step()
        return simulation.walk()

    @cached_property
    def control_plan(self) -> Plan:
        """Input of the controller of a forward simulation."""
        return self._plan_control(self.reference, self.model)

    def simulation(self, law: ControlLaw | None = None) -> Simulation:
        """A new forward simulation of the walk, to be stepped.

        Args:
            law: Control law that replaces the scenario's drive of the exoskeleton.
        """
        return Simulation(
            self.model,
            self.reference,
            self.control_plan,
            self.config.dynamics or Dynamics(),
            self.config.exo,
            self._rng(_JOINT_TORQUE),
            law,
        )

    @cached_property
    def mount_slips(self) -> MountSlips:
        """Slips of the sensor mounts, and their vibration after heel strikes."""
        faults = plan_faults(self.config.faults, self.rig, self.seed, self.duration_s)
        return replace(MountSlips.of(faults, self.sensor_rig.rig), strikes=self._struck_imus())

    def _struck_imus(self) -> dict[str, UpperMotion]:
        """Vibration of IMUs on segments of the body after heel strikes, by topic; empty for ideal sensors.

        On legs the strikes of that leg reach a sensor, elsewhere those of both.
        """
        struck: dict[str, UpperMotion] = {}
        for i, place in enumerate(BODY_PLACES):
            mounted = self.sensor_rig.sensors.get(f"/body/{place}/imu")
            if mounted is None or not mounted.sensor_config.strike or self.config.ideal:
                continue
            name, side = split_side(place)
            feet = side if name in ("thigh", "shank") else SIDES
            struck[mounted.calibration.topic] = self._shake(mounted.sensor_config.strike, feet, self._rng(_BODY, i))
        return struck

    def _shake(self, strike: float, feet: Iterable[str], rng: np.random.Generator) -> UpperMotion:
        """Vibration of a case after the heel strikes of some feet, which push it upwards by up to `strike` m/s²."""
        # constant pitch and speed: every strike has the reference strength, and no slap follows
        flat = fast = np.ones_like
        return UpperMotion.of(self.walk.stances(feet), flat, fast, np.zeros(3), rng, case_parameters(strike))

    @cached_property
    def light(self) -> LightCourse:
        """Course of the light; a change at a place begins when the given motion gets there."""
        return plan_light(self.config.route, self.given_walk.duration_s, self.given_walk.progress)

    @property
    def fell_at(self) -> float | None:
        """Time at which a simulated walker fell, s; the walk ends there."""
        return self.walk.fell_at if isinstance(self.walk, SimulatedWalk) else None

    def player(self) -> Playback | Replay:
        """Player of the walk, with vibrating shoes and camera case unless the sensors are ideal."""
        return self._player(self._uppers)

    def _player(self, uppers: Mapping[str, UpperMotion]) -> Playback | Replay:
        """Player of the walk on this twin's model.

        A simulated walk gets a `Replay`, whose loads are those that the simulation recorded. A given walk gets a
        `Playback`, whose loads follow from inverse dynamics.

        Args:
            uppers: Vibration of shoes' uppers and of the camera's case relative to their bodies, by name of the body;
                empty for rigid ones.
        """
        carriers = [imu.mount.body for imu in self.sensor_rig.rig.imus.values()]
        if isinstance(self.walk, SimulatedWalk):
            return Replay(self.model, self.walk, uppers, carriers)
        return Playback(self.model, self.walk, uppers, carriers)

    @cached_property
    def _uppers(self) -> dict[str, UpperMotion]:
        """Motion of the shoes' uppers and of the head or chest case, by name of the body; empty for ideal sensors."""
        if self.config.ideal:
            return {}
        return {**(self._shoes() if self.config.shock else {}), **self._case()}

    def _case(self) -> dict[str, UpperMotion]:
        """Vibration of the case with camera and IMU after heel strikes of both feet, by name of the case's body.

        It is empty without an IMU in the case, and if strikes do not reach it.
        """
        mounted = self.sensor_rig.sensors.get(f"/{self.config.rig_mount}/imu")  # the IMU beside the RGB-D camera
        if mounted is None or not mounted.sensor_config.strike:
            return {}
        return {mounted.calibration.mount.body: self._shake(mounted.sensor_config.strike, SIDES, self._rng(_CASE))}

    def _shoes(self) -> dict[str, UpperMotion]:
        """Motion of the upper of each shoe on its foot, by name of the foot."""
        bare, uppers = self._player({}), {}  # rigid shoes: the speed of the foot sets the strength of a strike
        for i, (side, shoe) in enumerate(zip(SIDES, draw_shoes(self._rng(_MOUNT)))):
            foot = f"foot_{side}"

            def speed(t: Array, foot: str = foot) -> Array:
                """(N,) m/s, speed of the foot at (N,) s; the default binds the foot of this turn of the loop."""
                track = bare.motion(np.round(t * 1e9).astype(np.int64)).tracks[foot]
                return np.linalg.norm(track.v_body_in_world, axis=1)

            uppers[foot] = UpperMotion.of(
                self.walk.steps[side],
                partial(self.walk.pitch, side),
                speed,
                foot_imu_position(self.config, side),
                self._rng(_SHOE, i),
                shoe,
            )
        return uppers

    def blocks(self) -> Iterator[list[Block[Sample] | Sample]]:
        """All samples and the ground truth of the walk, in chunks of `CHUNK_S`.

        The images of a chunk follow its other samples one by one. Mount slips are included; the other faults act on
        this output (`sim.faults.faults`).
        """
        playback = self.player()
        suite = SensorSuite(
            self.sensor_rig, self.terrain, self.crowd, self.seed, self.mount_slips, self.config.gravity_mps2
        )
        end_ns = int(self.duration_s * 1e9)
        rates = suite.rates | {c.rate_hz for c in self.rig.cameras.values()} | {truth.RATE_HZ}
        with CameraProcesses(
            self.model, self.sensor_rig, self.crowd, self.seed, self.mount_slips, light=self.light
        ) as rendering:
            after_ns = -1  # so that the first chunk includes the instant 0
            images: Iterator[Sample] = iter(())  # of the chunk before, rendered by other processes in the meantime
            while after_ns < end_ns:
                until_ns = min(after_ns + int(CHUNK_S * 1e9), end_ns)
                t_ns = np.unique(np.concatenate([instants(rate, after_ns, until_ns) for rate in rates]))
                truth_ns = instants(truth.RATE_HZ, after_ns, until_ns)
                if len(truth_ns):  # otherwise the last chunk is too short for any sample
                    motion = playback.motion(t_ns)
                    loads = playback.loads(truth_ns, motion)
                    requested = rendering.request(motion, after_ns, until_ns)  # before waiting for the last ones
                    for image in images:
                        yield [image]
                    images = requested
                    yield [
                        *suite.read(playback, motion, loads, after_ns, until_ns),
                        *truth.truth(
                            self.walk, self.sensor_rig.rig, motion, loads, after_ns, until_ns, self.mount_slips
                        ),
                        *truth.bystander_truth(self.crowd, truth_ns),
                    ]
                after_ns = until_ns
            for image in images:
                yield [image]

    def film(self, fps: float, width: int, height: int) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Third-person film of the walk, frame by frame.

        Args:
            fps: Frames per second of the walk.
            width: Of the images, pixels.
            height: Of the images, pixels.

        Yields:
            Time in s and RGB image (height, width, 3) of every frame.
        """
        data = mujoco.MjData(self.model)
        times = np.arange(0.0, self.duration_s, 1.0 / fps)
        q, _ = self.walk.position_velocity(times)
        # the camera follows the walker on a smooth path, (N, 4) x, y, z and yaw of the root, smoothed: it neither sways
        # nor turns with the pelvis
        rail = gaussian_filter1d(self.walk.splines(times)[:, :4], _FILM_SMOOTHING_S * fps, axis=0, mode="nearest")
        x, y, _, heading = rail.T
        with FilmCamera(self.model, width, height) as camera:
            for i, (t, pose) in enumerate(zip(times.tolist(), q)):
                data.qpos = pose
                pose_crowd(self.model, data, self.crowd, t)
                self.mount_slips.move_housings(self.model, round(t * 1e9))
                mujoco.mj_kinematics(self.model, data)
                mujoco.mj_comPos(self.model, data)  # moving lights and the scene's culling read it
                mujoco.mj_camlight(self.model, data)
                # the camera looks at a point 0.3 m ahead of the walker, 0.1 m below the pelvis, from the side: 68° off
                # the heading, 9° down, and 3.2 m away
                centre = [x[i] + 0.30 * np.cos(heading[i]), y[i] + 0.30 * np.sin(heading[i]), pose[2] - 0.10]
                image = camera.frame(data, centre, 68.0 + np.degrees(heading[i]), -9.0, 3.2)
                if (brightness := self.light.factor(round(t * 1e9))) != 1.0:
                    image = np.clip(image * brightness, 0, 255).astype(np.uint8)
                yield t, image
