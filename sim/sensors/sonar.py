"""Ultrasonic ranger: distance to the nearest echo in its cone."""

from __future__ import annotations

import math

import numpy as np

from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.noise import Noise
from stridetwin.sim.parts.kinds import SonarPart
from stridetwin.sim.sensors.model import SensorModel
from stridetwin.sim.world.bystanders import Crowd
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.rig import OtherSensor
from stridetwin.streams.samples import Array, Block, Range

# The other shoe as spheres (x, y, z, radius) in its foot frame, m.
SHOE = np.array([[-0.005, 0.0, 0.040, 0.038], [0.060, 0.0, 0.040, 0.036], [0.125, 0.0, 0.030, 0.034]])
# A smooth face reflects sound back only where the beam meets it near its normal: a floor at an oblique angle gives no
# echo.
_ECHO_SLANT_RAD = math.radians(40.0)
_RINGS = ((0.0, 1), (1 / 3, 6), (2 / 3, 12), (1.0, 18))  # rays of the beam: share of its half angle, number


class SonarModel(SensorModel[OtherSensor, SonarPart]):
    """Ultrasonic ranger: distance of the nearest echo in whole steps, 0 without an echo within the range.

    A ghost is an indirect echo: a reading anywhere between the least and the largest range. The x axis of the sensor's
    frame is the axis of the beam.

    Args:
        calibration: Topic, rate and mount.
        part: True parameters of the sensor.
        terrain: Ground and objects that reflect.
        crowd: Bystanders, who reflect, too.
        noise: Source of its errors.
    """

    def __init__(self, calibration: OtherSensor, part: SonarPart, terrain: Terrain, crowd: Crowd, noise: Noise) -> None:
        """Keeps the surroundings, and computes the rays of the beam."""
        super().__init__(calibration, part, noise)
        self._terrain, self._crowd = terrain, crowd
        self._luck = noise.at(0)  # random numbers of the ghosts, apart from the noise
        self._half_beam, self._fan = part.beam / 2, _beam_rays(part.beam / 2)

    def read(self, body: Track, other_foot: Track) -> Block[Range]:
        """The next samples, at the instants of both tracks.

        Args:
            body: Track of the body that carries the sonar.
            other_foot: Track of the other foot's frame, whose shoe reflects.
        """
        T_world_sensor = body.to_sensor(self._calibration.mount.T_body_sensor).poses()
        # spheres of the other shoe in the world, then those of each bystander
        shoe = np.einsum("nij,bj->nbi", other_foot.poses()[:, :3, :3], SHOE[:, :3])
        shoe += other_foot.p_body_in_world[:, None]
        nearest = self._range_of_terrain(T_world_sensor)
        people = [person.sonar_spheres(body.t_ns * 1e-9) for person in self._crowd]  # centres and radii
        for centres, radii in ((shoe, SHOE[:, 3]), *people):
            nearest = np.minimum(nearest, _nearest_ball(T_world_sensor, centres, radii, self._half_beam))
        return self._block(Range, body.t_ns, distance=self._measure(nearest))

    def _measure(self, nearest: Array) -> Array:
        """(N,) m, readings for the distance of the nearest echo (N,), inf for none, with ghosts, noise and steps."""
        part = self._part
        # whether a reading is a ghost, and where the ghost lies between the least and the largest range
        luck, position = self._luck.uniform((len(nearest), 2)).T
        ghost = part.range_min + position * (part.range_max - part.range_min)
        nearest = np.where(luck < part.ghost, ghost, nearest)
        reading = np.maximum(nearest + self._noise.normal(part.noise, len(nearest)), part.range_min)
        reading = np.where(nearest <= part.range_max, reading, 0.0)  # 0 without an echo within the range
        return part.step * np.round(reading / part.step) if part.step else reading

    def _range_of_terrain(self, T_world_sensor: Array) -> Array:
        """(N,) m, distance of the nearest echo from terrain and objects; inf without one.

        Rays that meet a face farther than `_ECHO_SLANT_RAD` from its normal give no echo.
        """
        n, m = len(T_world_sensor), len(self._fan)  # instants, and rays of the beam
        rays = np.einsum("nij,mj->nmi", T_world_sensor[:, :3, :3], self._fan).reshape(-1, 3)
        distance, normal = self._terrain.ray_hit(np.repeat(T_world_sensor[:, :3, 3], m, axis=0), rays)
        echo = -np.sum(rays * normal, axis=-1) > math.cos(_ECHO_SLANT_RAD)
        return np.min(np.where(echo, distance, np.inf).reshape(n, m), axis=-1)


def _nearest_ball(T_world_sensor: Array, centre_in_world: Array, radius: Array, half_beam: float) -> Array:
    """(N,) m, distance of the nearest sphere in the beam; inf for none.

    Args:
        T_world_sensor: (N, 4, 4) pose of the sensor.
        centre_in_world: (N, B, 3) m.
        radius: (B,) m.
        half_beam: Half angle of the beam, rad.
    """
    from_sensor = centre_in_world - T_world_sensor[:, None, :3, 3]  # world axes
    in_sensor = np.einsum("nji,nbj->nbi", T_world_sensor[:, :3, :3], from_sensor)
    return np.min(_range_of_balls(in_sensor, radius, half_beam), -1)


def _range_of_balls(centre: Array, radius: Array, half_beam: float) -> Array:
    """(..., B) m, shortest distance from the apex of a cone about x to each sphere, within the cone; inf for a miss.

    Args:
        centre: (..., B, 3) m, centres in the cone's frame.
        radius: (B,) m.
        half_beam: Half angle of the cone, rad.
    """
    away = np.linalg.norm(centre, axis=-1)
    off_axis = np.arctan2(np.linalg.norm(centre[..., 1:], axis=-1), centre[..., 0])
    slant = np.clip(off_axis - half_beam, 0.0, math.pi / 2)  # between the centre and the cone's nearest ray
    # squared half chord of that ray in the sphere, m²; negative for a miss
    half_chord_squared = radius**2 - (away * np.sin(slant)) ** 2
    hit = (half_chord_squared >= 0) & (off_axis - half_beam < math.pi / 2)  # in front of the cone's nearest ray
    return np.where(hit, away * np.cos(slant) - np.sqrt(np.maximum(half_chord_squared, 0.0)), np.inf)


def _beam_rays(half_beam: float) -> Array:
    """(M, 3) unit rays that fill a cone about x in rings; `half_beam` is its half angle, rad."""
    rays = []
    for share, count in _RINGS:
        # angles of the rays about the axis, and of the ring from the axis, rad
        about, off = 2 * math.pi * np.arange(count) / count, share * half_beam
        aside = math.sin(off)
        rays.append(np.column_stack([np.full(count, math.cos(off)), aside * np.cos(about), aside * np.sin(about)]))
    return np.concatenate(rays)
